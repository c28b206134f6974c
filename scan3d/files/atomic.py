"""Files are written completely or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from scan3d.errors import InputError


@contextmanager
def atomic(path: str | Path, option: str = "--out") -> Iterator[Path]:
    """Path of a temporary file in the same folder and with the same ending, which is renamed to `path` at the end.

    If writing fails, an earlier file at `path` is kept.  `option` is the option in which the user gave the path; it is named in
    the InputError that is raised if the file cannot be written.
    """
    path = Path(path)
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}.", suffix=path.suffix, dir=path.parent)
        os.close(handle)
        try:
            yield Path(name)
            os.chmod(name, 0o666 & ~_umask())
            os.replace(name, path)
        except BaseException:
            os.unlink(name)
            raise
    except OSError as error:
        raise InputError(f"can't write {path}: {error.strerror or error}; choose another place with {option}") from None


def write_atomic(path: str | Path, data: bytes) -> None:
    """Write a file so that no reader ever sees an incomplete one."""
    write_together({path: data})


def write_together(files: Mapping[str | Path, bytes]) -> None:
    """Write files that belong together: none is renamed to its path before all of them are on the disk."""
    with ExitStack() as stack:
        for path, data in files.items():
            stack.enter_context(atomic(path)).write_bytes(data)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


@contextmanager
def folder(path: str | Path, option: str = "--out") -> Iterator[Path]:
    """The folder, which is created if it is missing.

    Raises InputError if it cannot be created or written into; `option` is the option in which the user gave the path.  If the
    work in the folder fails before anything is written there, the folders that were created are removed again.
    """
    path = Path(path)
    created: list[Path] = []
    try:
        try:
            created = [parent for parent in (path, *path.parents) if not parent.exists()]
            path.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=path):
                pass
        except OSError as error:
            raise InputError(
                f"can't write into the folder {path}: {error.strerror}; choose another one with {option}"
            ) from None
        yield path
    except BaseException:
        for parent in created:
            with suppress(OSError):  # the folder is not empty, or was never created
                parent.rmdir()
        raise
