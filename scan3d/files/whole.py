"""Files and folders of results that are written whole or not at all, and the rules by which files are replaced.

The files of a result are written into a hidden folder within that of the result, and flushed to the disk.  One rename then
gives that folder the name `_COMPLETE`: before it there is the earlier result, after it the new one.  Its files are then moved
over the earlier ones, the report, which names the others with their SHA-256, as the last.  Moving what is still to be moved
gives the same result however often it was begun: what a killed run has not moved the next reader or writer of the folder
moves, and a reader who can't write reads it where it is.  No locks are needed, which some file systems do not have.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import platform
import secrets
import shlex
import shutil
import tempfile
import time
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

from scan3d.errors import InputError
from scan3d.files.text import read_small, to_json
from scan3d.workers import undone_if_ended

REPORT = "report.json"
RECORDING = ("recording.csv", "recording.toml")

SCHEMA = 1
"""Number of the formats of reports, and of the TOML files of recordings, poses and rigs."""

Kind = tuple[str, ...]
"""The files of a kind of result, the last of them its report, which names the others with their SHA-256."""
RESULTS: Kind = (
    *RECORDING, "cloud.ply", "surface.ply", "outer.ply", "inner.ply", "view.html", "cloud.png", "surface.png", REPORT
)  # fmt: skip
"""Those of a scan; not every one has pictures, or the two bodies that bound one that is not convex."""
BATCH: Kind = ("summary.csv", "batch.json")
Inputs = Mapping[str, str | os.PathLike[str] | None]
"""What a run reads: the path of each, by what it is, such as ``mesh``."""

# The folder whose files are complete and to be moved, and the beginning of the names of what is being written.
_COMPLETE, _WORK = ".scan3d-complete", ".scan3d-work"
# The column by which a CSV of contacts is recognised: touches, curves and logs of rigs have columns that users write too.
_OWN_COLUMN = b"normal_source"
_ASK = "give --overwrite (overwrite=True) to replace it, or choose another place with"


# --- writing ---


@dataclass(frozen=True)
class Replacement:
    """A result that is being written in the place of the one in a folder."""

    folder: Path
    inputs: Inputs
    kind: Kind
    _work: Path
    _sha256: dict[str, str] = field(default_factory=dict)

    def put(self, name: str, data: bytes) -> None:
        """Add a file, which appears in the folder with all others."""
        with in_a_sentence(self.folder / name, "--out"):
            self._work.mkdir(exist_ok=True)
            (self._work / name).write_bytes(data)
            _flush(self._work / name)
        self._sha256[name] = hashlib.sha256(data).hexdigest()

    def commit(self, report: Mapping[str, Any]) -> dict[str, Any]:
        """Let the result appear, with the report, which is returned with its sections `files` and `sha256`.

        Files of the result before that this one does not have are removed, if they are as the program wrote them.
        """
        # what this run has read of the result before
        of_before = unchanged(self.folder, self.kind)
        kept = [name for name in self.kind if name in of_before and name not in self._sha256 and self._is_input(name)]
        names = [*kept, *self._sha256, self.kind[-1]]
        read = {name: sha256(self.folder / name) for name in RECORDING} if self.reads_recording else {}
        data = {**report, "files": names, "sha256": {**read, **self._sha256}}
        self.put(self.kind[-1], to_json(data))
        del self._sha256[self.kind[-1]]  # a report does not name its own
        with in_a_sentence(self.folder, "--out"):
            _replace(self._work, self.folder)
        return data

    @contextmanager
    def kept(self, files: Mapping[str, bytes], options: Sequence[str]) -> Iterator[str]:
        """A context in which the recording that a scan has just made is in the folder; how to go on, with these options, if the
        scan is ended.

        It is a result of its own, whose report names nothing else, and which a later run replaces.  An earlier result is not
        replaced by it, because half of a new one is worth less: then nothing is kept, and the words are empty.  Nor is it
        kept after an InputError, which would be raised again.
        """
        is_free = not any((self.folder / name).exists() for name in self.kind) or is_unfinished(self.folder)
        if not files or "recording" in self.inputs or not is_free:
            yield ""
            return
        for name, data in files.items():
            self.put(name, data)
        self.commit({"schema": SCHEMA, "versions": {"scan3d": version("scan3d")}, "options": [*options]})
        try:
            yield f"the recording is kept: {_how_to_go_on(self.folder)}"
        except InputError:
            for name in (REPORT, *RECORDING):
                (self.folder / name).unlink(missing_ok=True)
            raise

    @property
    def reads_recording(self) -> bool:
        """Whether the recording in the folder is the one that this run reads, so that it stays as it is."""
        return all(self._is_input(name) for name in RECORDING)

    def _is_input(self, name: str) -> bool:
        return any(_is_same(self.folder / name, source) for source in self.inputs.values())


@contextmanager
def replacing(
    path: str | Path,
    *,
    inputs: Inputs | None = None,
    overwrite: bool = False,
    kind: Kind = RESULTS,
) -> Iterator[Replacement]:
    """A result to be written into a folder, which is created if it is missing.

    inputs
        what the run reads, which is not overwritten.
    overwrite
        whether files that the program did not write may be replaced.

    Raises InputError if the folder can't be written into, and if a file would be replaced that must not be.
    """
    with folder(path) as place, _working(place) as work:
        result = Replacement(place, inputs or {}, kind, work)
        ours, stated = unchanged(place, kind), earlier_files(place, kind)
        for name in kind:
            if name in RECORDING and result.reads_recording:
                continue
            check_path(place / name, inputs or {}, "--out")
            if (place / name).exists() and name not in ours and not overwrite:
                since = " or was changed since" if name in stated else ""
                raise InputError(f"{place / name} was not written by scan3d{since}; {_ASK} --out")
        yield result


@contextmanager
def atomic(path: str | Path, option: str = "--out") -> Iterator[Path]:
    """Path of a file with the same ending beside `path`, which is moved to `path` at the end.

    If writing fails, an earlier file at `path` is kept.  Raises InputError, which names the `option` in which the user gave the
    path, if the file can't be written.
    """
    path = Path(path)
    with in_a_sentence(path, option), _working(path.parent, path.suffix) as work:
        yield work
        _flush(work)
        os.replace(work, path)
        _flush(path.parent)


def write_atomic(path: str | Path, data: bytes, option: str = "--out") -> None:
    """Write a file so that no reader ever sees an incomplete one."""
    with atomic(path, option) as file:
        file.write_bytes(data)


def write_together(path: Path, files: Mapping[str, bytes]) -> None:
    """Write files that belong together, by name, into the folder of `path`, which is one of them: all or none."""
    with in_a_sentence(path, "--out"), _working(path.parent) as work:
        work.mkdir()
        for name, data in files.items():
            if (path.parent / name).is_dir():
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), name)
            (work / name).write_bytes(data)
            _flush(work / name)
        _replace(work, path.parent)


@contextmanager
def in_a_sentence(path: Path, option: str) -> Iterator[None]:
    """Within it an OSError becomes an InputError with the path, the reason and the option to change."""
    try:
        yield
    except OSError as error:
        raise InputError(f"can't write {path}: {error.strerror or error}; choose another place with {option}") from None


@contextmanager
def folder(path: str | Path, option: str = "--out") -> Iterator[Path]:
    """The folder, which is created if it is missing.

    Raises InputError if it cannot be created or written into; `option` is the option in which the user gave the path.  If the
    work in the folder fails before anything is written there, the folders that were created are removed again.
    """
    path = Path(path)
    created: list[Path] = []

    def undo() -> None:
        for parent in created:
            with suppress(OSError):  # the folder is not empty, or was never created
                parent.rmdir()

    try:
        try:
            created += [parent for parent in (path, *path.parents) if not parent.exists()]
            path.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=path):
                pass
        except OSError as error:
            raise InputError(
                f"can't write into the folder {path}: {error.strerror}; choose another one with {option}"
            ) from None
        with undone_if_ended(undo):
            yield path
    except BaseException:
        undo()
        raise


@contextmanager
def _working(place: Path, suffix: str = "") -> Iterator[Path]:
    """A path in a folder for what is being written there, which is removed at the end if it is still there."""
    clean(place)
    work = place / f"{_WORK}-{_machine()}-{os.getpid()}-{secrets.token_hex(4)}{suffix}"

    def undo() -> None:
        finish(place)
        _remove(work)

    with undone_if_ended(undo):
        try:
            yield work
        finally:
            _remove(work)


def clean(place: Path) -> None:
    """Finish and remove what killed runs have left in a folder, never the work of one that is running."""
    finish(place)
    with suppress(OSError):
        for work in place.glob(f"{_WORK}-*"):
            if _is_left(work):
                _remove(work)


def _is_left(work: Path) -> bool:
    """Whether the process that made a work folder has ended; on another machine, whether nothing came for a day."""
    machine, number = work.name.removeprefix(f"{_WORK}-").split("-")[:2]
    if machine != _machine() or os.name == "nt":
        return time.time() - work.stat().st_mtime > 86400
    try:
        os.kill(int(number), 0)
    except ProcessLookupError:
        return True
    except PermissionError:  # it runs, for another user
        pass
    return False


def _machine() -> str:
    return hashlib.sha256(platform.node().encode(errors="replace")).hexdigest()[:8]


def _remove(work: Path) -> None:
    if work.is_dir():
        shutil.rmtree(work, ignore_errors=True)
    else:
        with suppress(OSError):
            work.unlink(missing_ok=True)


def _replace(work: Path, place: Path) -> None:
    """Let the files of a work folder appear in the folder: all, or none."""
    _flush(work)
    try:
        while True:
            try:
                os.rename(work, place / _COMPLETE)  # from here on it is the new result
                break
            except OSError as error:
                if error.errno not in (errno.ENOTEMPTY, errno.EEXIST, errno.EACCES) or not _is_waiting(place):
                    raise
            _move(place)  # that of another run, which has just ended or was killed
        _flush(place)
        _move(place)
    except BaseException:  # after the rename the new files shall be there also for those who list the folder
        finish(place)
        raise


def _move(place: Path) -> None:
    """Move the files that are complete to their places, the report last, and remove what the earlier result had besides."""
    complete = place / _COMPLETE
    try:
        names = os.listdir(complete)
    except FileNotFoundError:
        return
    kinds = {kind[-1]: kind for kind in (RESULTS, BATCH)}
    for name in sorted(names, key=kinds.__contains__):
        if name in kinds:  # unchanged files of the earlier result that the new one does not name
            new = _named_files(complete / name, kinds[name]).keys()
            for earlier, stated in _named_files(place / name, kinds[name]).items():
                if earlier not in new and _has_sha256(place / earlier, stated):
                    (place / earlier).unlink(missing_ok=True)
        with suppress(FileNotFoundError):  # another process has moved it
            os.replace(complete / name, place / name)
    _flush(place)
    with suppress(OSError):  # another run has just come
        complete.rmdir()


def _flush(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk, where the system can do that."""
    is_folder = path.is_dir()
    if is_folder and os.name == "nt":
        return
    handle = os.open(path, os.O_RDONLY if is_folder else os.O_RDWR)
    try:
        os.fsync(handle)
    except OSError as error:
        if not is_folder and error.errno not in (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP):
            raise
    finally:
        os.close(handle)


# --- reading ---


def finish(place: Path) -> None:
    """Finish the moves of a run that was killed, where this is possible."""
    if _is_waiting(place):
        with suppress(OSError):  # the folder is read-only: `locate` knows where the files are
            _move(place)


def locate(path: Path) -> Path:
    """Where a file is read: at its path, or where a run has left it that was killed, if nothing can be written there."""
    finish(path.parent)
    waiting = path.parent / _COMPLETE / path.name
    return waiting if waiting.exists() else path


def _is_waiting(place: Path) -> bool:
    return (place / _COMPLETE).is_dir()


def sha256(path: Path) -> str:
    """The SHA-256 of a file."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def earlier_files(place: Path, kind: Kind = RESULTS) -> dict[str, str | None]:
    """Names of the files that the report in a folder says were written, with their SHA-256 where it is stated.

    Empty if the folder has no report, or one of another program.
    """
    return _named_files(locate(place / kind[-1]), kind)


def _named_files(report: Path, kind: Kind) -> dict[str, str | None]:
    try:
        if not report.is_file():  # a pipe could be read without end
            return {}
        data: Any = json.loads(report.read_text(encoding="utf-8"))
        if kind[-1] not in data["files"] or "scan3d" not in data["versions"]:
            return {}
        stated = data.get("sha256") or {}
        return {name: stated.get(name) for name in data["files"] if name in kind}
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return {}


def is_unfinished(place: Path) -> bool:
    """Whether a folder holds the recording of a scan that was ended before its result was there."""
    return earlier_files(place).keys() == {*RECORDING, REPORT}


def check_finished(place: Path) -> None:
    """Raise InputError, which says how to go on, for the folder of a scan that was ended before its result was there."""
    if is_unfinished(place):
        raise InputError(f"the scan in {place} was ended before its result was there; {_how_to_go_on(place)}")


def _how_to_go_on(place: Path) -> str:
    options = json.loads(locate(place / REPORT).read_text(encoding="utf-8")).get("options", [])
    words = ["scan3d", "reconstruct", str(place / RECORDING[0]), "--out", str(place), *options]
    return f"go on with {shlex.join(words)}"


def unchanged(place: Path, kind: Kind = RESULTS) -> set[str]:
    """The files of the result in a folder that are as the program wrote them."""
    return {name for name, stated in earlier_files(place, kind).items() if _has_sha256(locate(place / name), stated)}


def _has_sha256(path: Path, stated: str | None) -> bool:
    try:
        return path.is_file() and stated in (None, sha256(path))
    except OSError:
        return False


def read_report(place: Path) -> Mapping[str, Any]:
    """A scan's report.json; empty if the file does not exist.  Raises InputError if it can't be read."""
    path = locate(place / REPORT)
    if not path.exists():
        return {}
    try:
        data = json.loads(read_small(path))
    except InputError:
        raise
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"can't read {path}: {error}; run the scan again") from None
    if not isinstance(data, Mapping):
        raise InputError(f"{path} is not a report: expected a JSON object; run the scan again")
    return data


def check_belongs(place: Path, report: Mapping[str, Any], names: Iterable[str]) -> None:
    """Raise InputError if a file in a folder is not the one that the report names; reports without hashes name none."""
    stated = report.get("sha256")
    if not isinstance(stated, Mapping):
        return
    for name in names:
        path = locate(place / name)
        if name in stated and path.is_file() and sha256(path) != stated[name]:
            raise InputError(
                f"{place / name} is not the file that {REPORT} beside it names: it was changed, or is of another run; run "
                "the scan again, or give the path of the file alone"
            )


# --- what may be replaced ---


def check_path(path: Path, inputs: Inputs, option: str) -> None:
    """Raise InputError unless the path is free or a regular file, and no input."""
    if not path.exists():
        return
    for what, source in inputs.items():
        if _is_same(path, source):
            raise InputError(
                f"{path} is the {what} that this run reads, which is never overwritten; choose another place with {option}"
            )
    if path.is_dir():
        raise InputError(f"can't write {path}: {os.strerror(errno.EISDIR)}; choose another place with {option}")
    if not path.is_file():
        raise InputError(f"can't write {path}: it is a device or a pipe; choose another place with {option}")


def _is_same(path: Path, source: str | os.PathLike[str] | None) -> bool:
    return source is not None and path.exists() and os.path.exists(source) and os.path.samefile(path, source)


def _check_single(path: Path, inputs: Inputs, option: str) -> None:
    check_path(path, inputs, option)
    if path.name in RESULTS + RECORDING and earlier_files(path.parent):
        raise InputError(f"{path} belongs to the scan in {path.parent}; choose another place with {option}")


def check_file(path: str | Path, inputs: Inputs, overwrite: bool, option: str, contents: bytes | None = None) -> None:
    """Raise InputError if a single file must not be written at the path; nothing is lost if it has the `contents` already."""
    path = Path(path)
    _check_single(path, inputs, option)
    if path.exists() and not overwrite and not _is_ours(path, contents or b"") and contents != path.read_bytes():
        raise InputError(f"{path} can't be recognised as written by scan3d; {_ASK} {option}")


def _is_ours(path: Path, contents: bytes) -> bool:
    """Whether a file bears the name of the program at its beginning or its end; CSV, which has no place for it, the header of
    the contents, with a column that only the program writes."""
    looked_at = 4096  # bytes at each end, which are more than headers have
    with open(path, "rb") as file:
        begin = file.read(looked_at)
        if path.suffix.lower() == ".csv":
            header = contents.split(b"\n", 1)[0]
            return _OWN_COLUMN in header.split(b",") and begin.split(b"\n", 1)[0] == header
        file.seek(max(len(begin), os.path.getsize(path) - looked_at))
        return b"scan3d" in begin + file.read(looked_at)


def check_pair(
    path: str | Path, sidecar: Path, inputs: Inputs, overwrite: bool, option: str = "--out", kind: str = "simulation"
) -> None:
    """Raise InputError if a table must not be written with its TOML file, which names its `kind`; one of the same kind is
    replaced."""
    for file in (sidecar, Path(path)):
        _check_single(file, inputs, option)
        if file.exists() and not overwrite and source_kind(sidecar) != kind:
            kind = kind or "recording"
            one = f"an {kind}" if kind[0] in "aeiou" else f"a {kind}"
            raise InputError(f"{file} can't be recognised as {one} by scan3d; {_ASK} {option}")


def source_kind(sidecar: Path) -> str | None:
    """What the TOML file beside a table says of its source, "" if nothing; None if it is no such file."""
    try:
        if not sidecar.is_file():
            return None
        data: Any = tomllib.loads(read_small(sidecar))
        return str(data.get("source", {}).get("kind", "")) if "length_m" in data["rod"] else None
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
