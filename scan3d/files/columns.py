"""The numbers in the columns of a text table."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from scan3d.arrays import Array
from scan3d.errors import InputError


def plain_numbers(data: bytes, columns: int) -> Array | None:
    """The numbers (n, columns) below the header of a table that holds nothing else; None for any other table.

    It is three times as fast as reading line by line, which names the line and the column of an error.
    """
    header, _, body = data.partition(b"\n")
    body = body.replace(b"\r\n", b"\n").rstrip(b"\n") + b"\n"
    separators = body.translate(None, b"0123456789+-.eE ")
    line = b"," * (columns - 1) + b"\n"
    if b'"' in header or separators != line * (len(separators) // columns):
        return None
    with warnings.catch_warnings():
        warnings.simplefilter(
            "error", DeprecationWarning
        )  # on text that is no number older versions of numpy only warn
        try:
            values = np.fromstring(body.replace(b"\n", b","), sep=",")
        except (ValueError, DeprecationWarning):
            return None
    return values.reshape(-1, columns) if len(values) == len(separators) else None


def numbers_of(path: Path, name: str, column: int, body: list[tuple[int, list[str]]]) -> Array:
    """A column (n,) of a table, from its lines with their numbers.  Raises InputError for text."""
    try:
        return np.array([float(line[column]) for _, line in body])
    except ValueError:
        number, text = next((number, line[column]) for number, line in body if not _is_number(line[column]))
        raise InputError(f"{path.name}: line {number} has {text!r} for {name}, where a number is expected") from None


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
