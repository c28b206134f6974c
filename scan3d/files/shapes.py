"""Clouds and surfaces as tables with named columns, which is what their files hold."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scan3d.arrays import Array
from scan3d.errors import InputError
from scan3d.files.ply import read_ply
from scan3d.units import UNITS_M

FRAME = "world coordinates of the recording's poses, right-handed; for a simulated scan those of the mesh"
POINT, NORMAL, COLOR = ("x", "y", "z"), ("nx", "ny", "nz"), ("red", "green", "blue")
LENGTHS = ("quality", "bound", "place_sd", "distance")
"""Scalars that are lengths, in the unit of the file."""


@dataclass(frozen=True)
class Shape:
    """A cloud or a surface as in a PLY file written by scan3d."""

    rows: NDArray[Any]
    """(n,) structured: x, y, z, nx, ny, nz, in exports with colours red, green, blue, then the scalars."""
    faces: NDArray[np.int32] | None
    """(m, 3) corners of a surface's triangles, counterclockwise from outside; None for a cloud."""
    unit: str
    notes: tuple[str, ...] = ()
    """What else stands in the comments of the file."""

    @property
    def what(self) -> str:
        return "cloud" if self.faces is None else "surface"

    @property
    def points(self) -> Array:
        """(n, 3)"""
        return np.stack([self.rows[name] for name in POINT], axis=1).astype(np.float64)

    @property
    def normals(self) -> NDArray[np.float32]:
        """(n, 3), NaN where unknown."""
        return np.stack([self.rows[name] for name in NORMAL], axis=1)

    @property
    def colors(self) -> NDArray[np.uint8] | None:
        """(n, 3) red, green and blue, None without colours."""
        if not set(COLOR) <= set(self.rows.dtype.names or ()):
            return None
        return np.stack([self.rows[name] for name in COLOR], axis=1).astype(np.uint8)

    @property
    def scalars(self) -> dict[str, NDArray[Any]]:
        """(n,) each, by name."""
        names = self.rows.dtype.names or ()
        return {name: np.ascontiguousarray(self.rows[name]) for name in names if name not in POINT + NORMAL + COLOR}

    @property
    def remarks(self) -> tuple[str, ...]:
        """Comments for the file: what it contains, its unit and its frame."""
        return f"scan3d {self.what}", f"unit {self.unit}", f"frame {FRAME}", *self.notes


def read_shape(path: str | Path) -> Shape:
    """Read a cloud or a surface from a PLY file written by scan3d.  Raises InputError for other files."""
    rows, faces, comments = read_ply(path)
    missing = [name for name in POINT + NORMAL if name not in (rows.dtype.names or ())]
    if missing:
        raise InputError(
            f"{Path(path).name} is not a PLY file written by scan3d: its vertices lack {', '.join(missing)}"
        )
    units = [words[1] for words in (line.split() for line in comments) if words[:1] == ["unit"] and len(words) == 2]
    if len(units) != 1 or units[0] not in UNITS_M:
        raise InputError(
            f"{Path(path).name} is not a PLY file written by scan3d: expected a comment such as 'unit mm', "
            f"with one of {', '.join(UNITS_M)}"
        )
    return Shape(rows, faces, units[0])
