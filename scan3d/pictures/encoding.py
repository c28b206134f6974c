"""Arrays as text, as the page's scripts read them."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scan3d.arrays import Array


def floats(values: Array) -> str:
    """Numbers as float32, little-endian, in base64.  What is too large for float32 becomes infinite."""
    with np.errstate(over="ignore"):
        return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode()


def integers(values: NDArray[Any]) -> str:
    """Numbers from 0 to 2³² - 1 as uint32, little-endian, in base64."""
    return base64.b64encode(np.ascontiguousarray(values, dtype="<u4").tobytes()).decode()
