"""Types of arrays by their elements; shapes are given in the docstrings."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.integer[Any]]
Mask = NDArray[np.bool_]
Image = NDArray[np.uint8]
Table = NDArray[np.void]
"""A structured array: one row per contact or vertex, one named column per quantity."""
