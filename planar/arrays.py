"""Types of the arrays that pass between the modules, and the observables of a sweep as columns."""

from __future__ import annotations

from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
"""Lengths, forces, moments and angles."""
Index = NDArray[np.intp]
"""Row numbers."""
Mask = NDArray[np.bool_]
"""One truth value per row."""
ROUNDING = 1e-13
"""Rounding of lengths, in rod lengths or relative to the size of a contour."""
BLOCK = 8192
"""Rows processed at once, whose intermediate results stay in the processor's cache."""


def ratio(over: Array | float, under: Array) -> Array:
    """`over / under`, infinite or NaN without a warning where `under` is 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return over / under


def finite(*values: ArrayLike) -> bool:
    """Whether all values, numbers or arrays, are finite numbers: what is no number, such as a text, is not finite."""
    return all(given.dtype.kind in "biuf" and bool(np.isfinite(given).all()) for given in map(np.asarray, values))


def ranges(count: NDArray[np.integer[Any]]) -> tuple[Index, Index]:
    """Of numbers from 0 that repeat so many times each (n,): which number it is, and how often it came before.

    Of the counts 2 and 1 these are ``0 0 1`` and ``0 1 0``.
    """
    number = np.repeat(np.arange(len(count)), count)
    return number, np.arange(len(number)) - np.repeat(np.cumsum(count) - count, count)


Columns = TypeVar("Columns", bound=NamedTuple)


def rows_of(columns: Columns, rows: NDArray[np.integer[Any]] | Mask | slice) -> Columns:
    """Some of the rows of columns (n, ...) of the same length."""
    return columns._make(column[rows] for column in columns)


class Reactions(NamedTuple):
    """Base positions and support reactions (n,), dimensionless."""

    x0: Array
    f0x: Array
    f0y: Array
    m0z: Array


NAMES = ("f0x", "f0y", "m0z")
"""Of the reactions."""


def checked_reactions(x0: ArrayLike, f0x: ArrayLike, f0y: ArrayLike, m0z: ArrayLike) -> Reactions:
    """Columns (n,) of floats; single numbers become columns of length 1.  Raises ValueError if their shapes differ.

    Masked values, which would count as measured, and numbers that are not real are a ValueError as well.
    """
    columns = [np.atleast_1d(_real(column)) for column in (x0, f0x, f0y, m0z)]
    if any(column.shape != columns[0].shape or column.ndim != 1 for column in columns):
        raise ValueError(
            f"x0, f0x, f0y and m0z must have one shape (n,), got {', '.join(str(column.shape) for column in columns)}"
        )
    return Reactions(*columns)


def check_direction(direction: int) -> None:
    """Raise ValueError for what is no sign of the base's motion along x."""
    if direction not in (-1, 1):
        raise ValueError(f"direction must be -1 or 1, the sign of the base's motion, got {direction!r}")


def checked_friction(friction: ArrayLike, count: int | None = None) -> Array:
    """A coefficient of friction, or one for each of so many samples, of any number if that is None.  Raises ValueError."""
    mu = np.asarray(friction)
    right = mu.ndim < 2 and (not mu.ndim or count in (None, len(mu)))
    if not (right and finite(mu) and (mu >= 0).all()):
        raise ValueError(f"friction must be one number >= 0 or one for each sample, got {shortened(mu)}")
    return mu.astype(float)


def shortened(values: Array) -> str:
    """Values in an error's words."""
    return np.array2string(values, threshold=6, precision=6)


def _real(column: ArrayLike) -> Array:
    if np.ma.isMaskedArray(column):
        raise ValueError("x0, f0x, f0y and m0z must be plain arrays, got a masked one; leave the masked rows out")
    array = np.asarray(column)
    if array.dtype.kind not in "iufb":
        raise ValueError(f"x0, f0x, f0y and m0z must hold real numbers, got {array.dtype.name}")
    return array.astype(float, copy=False)
