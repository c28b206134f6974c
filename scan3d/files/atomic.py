"""Files are written completely or not at all."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from scan3d.errors import InputError
from scan3d.files.journal import BusyError, flush, flush_folder, sweep, work_in


@contextmanager
def atomic(path: str | Path, option: str = "--out") -> Iterator[Path]:
    """Path of a file of the same name in a hidden folder beside `path`, which is moved to `path` at the end.

    If writing fails, an earlier file at `path` is kept.  `option` is the option in which the user gave the path; it is named in
    the InputError that is raised if the file cannot be written.
    """
    path = Path(path)
    with in_a_sentence(path, option):
        sweep(path.parent)
        with work_in(path.parent, path.name) as work:
            file = work.path / path.name
            yield file
            flush(file)
            os.replace(file, path)
            flush_folder(path.parent)


def write_atomic(path: str | Path, data: bytes, option: str = "--out") -> None:
    """Write a file so that no reader ever sees an incomplete one."""
    with atomic(path, option) as file:
        file.write_bytes(data)


def write_together(path: Path, files: Mapping[str, bytes], option: str = "--out") -> None:
    """Write files that belong together into the folder of `path`, which is one of them: all or none.

    files
        the bytes of each file, by name, in the order in which they appear.
    """
    with in_a_sentence(path, option):
        sweep(path.parent)
        with work_in(path.parent, path.name) as work:
            for name, data in files.items():
                work.put(name, data)
            work.commit()


@contextmanager
def in_a_sentence(path: Path, option: str) -> Iterator[None]:
    """Within it an OSError becomes an InputError with the path, the reason and the option to change."""
    try:
        yield
    except BusyError as error:
        raise BusyError(f"{error}, or choose another place with {option}") from None
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
