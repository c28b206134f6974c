"""Types of the arrays that pass between the modules."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

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
