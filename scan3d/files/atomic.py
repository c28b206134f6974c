"""Files written whole or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from scan3d.errors import InputError


@contextmanager
def atomic(path: str | Path, option: str = "--out") -> Iterator[Path]:
    """A temporary file beside the path, with its ending, to write to; in the end it takes the path's place.

    If the writing fails, what stood there before stays.  `option` is where the user gave the path.
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
    """Write a file so that no reader ever sees a part of it."""
    write_together({path: data})


def write_together(files: Mapping[str | Path, bytes]) -> None:
    """Write files that belong together: none takes its place before all of them are on the disk."""
    with ExitStack() as stack:
        for path, data in files.items():
            stack.enter_context(atomic(path)).write_bytes(data)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


@contextmanager
def folder(path: str | Path, option: str = "--out") -> Iterator[Path]:
    """The folder, made if missing and proven writable.  Raises InputError if it can't be; `option` is where it was given.

    If the work in it fails before anything is written there, folders that were made for it go again.
    """
    path = Path(path)
    made: list[Path] = []
    try:
        try:
            made = [one for one in (path, *path.parents) if not one.exists()]
            path.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=path):
                pass
        except OSError as error:
            raise InputError(
                f"can't write into the folder {path}: {error.strerror}; choose another one with {option}"
            ) from None
        yield path
    except BaseException:
        for one in made:
            with suppress(OSError):  # not empty, or never made
                one.rmdir()
        raise
