"""Changes of a folder that happen completely or not at all, even if the process is killed.

A run writes its files into a hidden work folder beside the old ones.  When all of them are on the disk, a journal that lists
them appears in the work folder by one rename: this is the commit point.  Then the files are moved over the old ones.  A run
that is killed before the commit point has changed nothing; the moves of a run that is killed after it are finished by the next
reader or writer of the folder, because moving what is still to be moved gives the same result however often it was begun.

The work folder holds a lock of the operating system, which ends with the process: a second run is told who is there, and what
a killed run has left is recognised and removed.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import platform
import stat
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

from scan3d.errors import InputError
from scan3d.files.locks import lock

# The work folder of a folder of results; that of a single file begins with the file's name.
WORK = ".scan3d-run"
_LOCK, _JOURNAL = ".scan3d-lock", ".scan3d-journal.json"
# Bytes of a file's name that all file systems allow.
_LONGEST_NAME = 255
# A reader waits so many seconds for a run that is just moving its files.  Moving takes milliseconds; shorter, a slow network
# disk would count as a failure.
_PATIENCE_S = 10.0
# Errors of file systems on which a folder can't be flushed to the disk.
_NO_FOLDER_FLUSH = {errno.EINVAL, errno.EBADF, errno.ENOTSUP, errno.EACCES, errno.EISDIR}


class BusyError(InputError):
    """Another run is writing the same files."""


@dataclass
class Work:
    """The work folder of a run, locked by this process."""

    folder: Path
    """Where the files are to appear."""
    path: Path
    handle: int
    """Of the lock."""
    sha256: dict[str, str] = field(default_factory=dict)
    """Of the files that were put, by name."""

    def put(self, name: str, data: bytes) -> None:
        """Write a file that is to appear in the folder, and flush it to the disk."""
        (self.path / name).write_bytes(data)
        flush(self.path / name)
        self.sha256[name] = hashlib.sha256(data).hexdigest()

    def commit(self, obsolete: Mapping[str, str] | None = None) -> None:
        """Let all files that were put appear in the folder, in this order, and remove what is obsolete (name: SHA-256)."""
        for name in self.sha256:
            if (self.folder / name).is_dir():
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(self.folder / name))
        flush_folder(self.path)
        journal, new = self.path / _JOURNAL, self.path / f"{_JOURNAL}.new"
        new.write_text(json.dumps({"files": [*self.sha256], "obsolete": dict(obsolete or {})}), encoding="utf-8")
        flush(new)
        os.replace(new, journal)  # the commit point
        flush_folder(self.path)
        _roll_forward(self)

    def release(self) -> None:
        """Remove the work folder and end the lock; a journal whose moves could not be finished stays for the next run."""
        is_done = not (self.path / _JOURNAL).exists()
        try:
            if is_done:
                _remove(self.path, os.name == "nt")
        except BaseException:  # once more, so that an interruption leaves nothing behind
            _remove(self.path, os.name == "nt")
            raise
        finally:
            os.close(self.handle)
            if os.name == "nt" and is_done:  # an open file can't be removed there
                with suppress(OSError):
                    _remove(self.path, False)


@contextmanager
def work_in(folder: Path, owner: str = "") -> Iterator[Work]:
    """The work folder for the results in a folder, or for one file `owner` in it.

    Earlier moves are finished and leftovers removed.  Raises BusyError if another run is there, and OSError.
    """
    work = claim(folder, owner)
    try:
        yield work
    except BaseException:
        # after the commit point the new files shall be there also for those who list the folder
        with suppress(OSError, InputError):
            _roll_forward(work)
        raise
    finally:
        work.release()


def claim(folder: Path, owner: str = "") -> Work:
    """Lock the work folder, which is created, and bring it and the folder in order."""
    try:
        return _claim(folder, owner)
    except (OSError, InputError):
        raise
    except BaseException:  # an interruption between the creation of the work folder and its lock leaves nothing behind
        with suppress(OSError, InputError):
            _claim(folder, owner).release()
        raise


def _claim(folder: Path, owner: str) -> Work:
    path = work_path(folder, owner)
    while True:
        try:
            with suppress(FileExistsError):
                path.mkdir()
            _check_is_ours(path)
            handle = os.open(path / _LOCK, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
        except (
            FileNotFoundError
        ):  # another run has just ended and removed the work folder, if its parent is still there
            if not folder.is_dir():
                raise
            continue
        except BaseException:
            with suppress(OSError):  # it holds files
                path.rmdir()
            raise
        work = Work(folder, path, handle)
        try:
            if not lock(handle):
                raise BusyError(_who(path, folder / owner))
            is_there = _is_same(handle, path / _LOCK)
        except BaseException:
            os.close(handle)
            raise
        if not is_there:
            os.close(handle)
            continue
        try:
            os.truncate(handle, 0)
            os.write(handle, _introduction().encode(errors="replace"))
            _roll_forward(work)
            _remove(path, True)
            return work
        except BaseException:
            work.release()
            raise


def finish(folder: Path, owner: str = "") -> None:
    """Finish the moves of a run that has ended or is just moving, where this is possible.  Raises BusyError."""
    path = work_path(folder, owner)
    end = time.monotonic() + _PATIENCE_S
    while (path / _JOURNAL).exists():
        try:
            claim(folder, owner).release()
        except BusyError:
            if time.monotonic() > end:
                raise
            time.sleep(0.02)
        except OSError:  # the folder is read-only: `locate` knows where the files are
            return


def locate(path: Path, owner: str | None = None) -> Path:
    """Where a file is read: at its path, or in a work folder if its move could not be finished because nothing can be written.

    `owner` is the name of the file with which it was written, if not its own.
    """
    for name in ("", path.name if owner is None else owner):
        finish(path.parent, name)
        work = work_path(path.parent, name)
        if (work / _JOURNAL).exists():
            journal = _journal(work)
            is_to_be_moved = path.name in journal["files"] and (work / path.name).exists()
            if is_to_be_moved or path.name in journal["obsolete"]:
                return work / path.name
    return path


def sweep(folder: Path) -> None:
    """Remove what killed runs have left in a folder, never the files of one that is running."""
    for name in os.listdir(folder):
        owner = name.removesuffix(WORK).removeprefix(".")
        # finishing the moves of another user would be done with this user's rights
        if name == work_path(folder, owner).name and _is_my_folder(folder / name):
            with suppress(OSError, InputError):
                claim(folder, owner).release()


def work_path(folder: Path, owner: str = "") -> Path:
    """The work folder of a folder of results, or of one file `owner` in it."""
    name = f".{owner}{WORK}" if owner else WORK
    if len(os.fsencode(name)) > _LONGEST_NAME:
        name = f".{hashlib.sha256(os.fsencode(owner)).hexdigest()[:16]}{WORK}"
    return folder / name


def flush(path: Path) -> None:
    """Wait until a file is on the disk."""
    with open(path, "r+b") as file:
        os.fsync(file.fileno())


def flush_folder(path: Path) -> None:
    """Wait until the names in a folder are on the disk, where the operating system can do that."""
    if os.name == "nt":
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in _NO_FOLDER_FLUSH:
            raise
    finally:
        os.close(handle)


def digest(path: Path) -> str:
    """The SHA-256 of a file."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _roll_forward(work: Work) -> None:
    """Finish what the journal says, if there is one."""
    if not (work.path / _JOURNAL).exists():
        return
    journal = _journal(work.path)
    for name in journal["files"]:
        with suppress(FileNotFoundError):  # it was moved before
            os.replace(work.path / name, work.folder / name)
    for name, sha256 in journal["obsolete"].items():
        path = work.folder / name
        if path.is_file() and digest(path) == sha256:
            path.unlink()
    flush_folder(work.folder)
    (work.path / _JOURNAL).unlink()


def _journal(path: Path) -> dict[str, Any]:
    """The journal in a work folder.  Raises InputError for one that is damaged, or that names other folders."""
    try:
        journal = json.loads((path / _JOURNAL).read_text(encoding="utf-8"))
        files, obsolete = list(journal["files"]), dict(journal["obsolete"])
        names: Iterable[Any] = [*files, *obsolete]
        if all(isinstance(name, str) and name not in ("", ".", "..") and Path(name).name == name for name in names):
            return {"files": files, "obsolete": obsolete}
    except FileNotFoundError:  # the run that moved its files has just finished
        return {"files": [], "obsolete": {}}
    except (OSError, ValueError, TypeError, KeyError):
        pass
    raise InputError(f"{path} was left by a run and is damaged; remove it, and run the scan again")


def _check_is_ours(path: Path) -> None:
    """Raise InputError if the work folder is something else."""
    with suppress(FileNotFoundError):
        names = os.listdir(path) if path.is_dir() and not path.is_symlink() else ["file"]
        if names and _LOCK not in names:
            raise InputError(f"{path} is not a work folder of scan3d, which needs this name; move it away")


def _remove(path: Path, keep_lock: bool) -> None:
    """Remove the files in a work folder, and unless the lock is kept the folder itself."""
    with suppress(FileNotFoundError):
        for name in sorted(os.listdir(path)):
            if name != _LOCK:
                (path / name).unlink()
        if not keep_lock:
            (path / _LOCK).unlink(missing_ok=True)
            with suppress(OSError):  # another run has just come
                path.rmdir()


def _is_same(handle: int, path: Path) -> bool:
    """Whether the path still leads to the open file."""
    try:
        return os.path.samestat(os.fstat(handle), os.stat(path))
    except FileNotFoundError:
        return False


def _is_my_folder(path: Path) -> bool:
    with suppress(OSError):
        state = os.lstat(path)
        return stat.S_ISDIR(state.st_mode) and (os.name == "nt" or state.st_uid == os.geteuid())
    return False


def _introduction() -> str:
    since = datetime.now().isoformat(sep=" ", timespec="seconds")
    return f"process {os.getpid()} on {platform.node() or 'this machine'}, since {since}"


def _who(path: Path, target: Path) -> str:
    who = ""
    with suppress(OSError):
        who = (path / _LOCK).read_text(encoding="utf-8", errors="replace")
    return f"{target} is being written by another run ({who or 'which has just begun'}); wait until it has ended"
