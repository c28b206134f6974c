"""Reading of whole files: what is no regular file, or does not fit into memory, is refused before it is read."""

from __future__ import annotations

import errno
import os
import stat
import tomllib
from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from scan3d.errors import InputError
from scan3d.processes import check_memory


def check_file(path: Path, *, memory_per_byte: float = 2.0) -> None:
    """Raises OSError for a file that does not exist, InputError for what is no regular file or does not fit into memory.

    A device or a pipe could be read without end; `memory_per_byte` is the memory that is needed per byte of the file.
    """
    try:
        state = path.stat()
    except ValueError as error:  # a name with a null character
        raise OSError(str(error)) from None
    if stat.S_ISDIR(state.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(state.st_mode):
        raise InputError(f"{path} is a device or a pipe, where a file is expected; copy its contents into a file")
    check_memory(memory_per_byte * state.st_size, f"reading {path.name}", "take a smaller file")


def read_small(path: Path) -> str:
    """The text of a file of settings or results.  Raises OSError and ValueError, InputError as `check_file`."""
    check_file(path)
    if path.stat().st_size > 50 << 20:  # those of a scan have a few thousand bytes
        raise ValueError(f"it has {path.stat().st_size >> 20} MB, and such files are small")
    return path.read_text(encoding="utf-8-sig")


def read_toml(path: str | Path) -> dict[str, Any]:
    """The contents of a TOML file.  Raises OSError, InputError as `check_file`, and ValueError for what is not TOML."""
    text = read_small(Path(path))
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("its lists are nested too deeply") from None


def to_float(value: float) -> float:
    """A number as a float; a whole number too large for one is infinite, as a decimal number is."""
    try:
        return float(value)
    except OverflowError:
        return float("inf") if value > 0 else float("-inf")


def did_you_mean(unknown: Iterable[str], known: Iterable[str], mark: str = "") -> str:
    """The last clause of a message on unknown names: the known ones that they resemble, or an empty string.

    `mark` is what stands before all names, such as the hyphens of options.
    """
    known = list(known)
    near = [mark + match for name in unknown for match in get_close_matches(name, known, n=1)]
    return f"; did you mean {' and '.join(near)}?" if near else ""
