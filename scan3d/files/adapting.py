"""Clouds and surfaces as other programs want them: in another unit, with colours, with the names of scalars that they know."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scan3d.choices import SCALAR_NAMES
from scan3d.errors import InputError
from scan3d.files.shapes import COLOR, LENGTHS, NORMAL, POINT, Shape
from scan3d.units import UNITS_M

# The map of the colours, and the colour of values that are not known.
_MAP, _UNKNOWN = "viridis", 154
# Scalars whose colours begin at zero, and not at their smallest value: magnitudes.
_FROM_ZERO = (*LENGTHS, "force")
# The scalar that MeshLab shows, and the name that the column of this name then has.
_SHOWN, _SHOWN_BEFORE = "quality", "distance"
# The scalar of a cloud and of a surface that is shown unless another one is named.
_DEFAULT = {"cloud": "force", "surface": "bound"}
# The beginning by which CloudCompare recognises scalar fields.
_CLOUDCOMPARE = "scalar_"


def in_unit(shape: Shape, unit: str | None) -> Shape:
    """The shape with all lengths in another unit; None keeps them.  Raises InputError for an unknown unit."""
    if unit is None or unit == shape.unit:
        return shape
    if unit not in UNITS_M:
        raise InputError(f"unit must be one of {', '.join(UNITS_M)}, got {unit!r}")
    rows = shape.rows.copy()
    for name in POINT + LENGTHS:
        if name in (rows.dtype.names or ()):
            rows[name] = rows[name] * (UNITS_M[shape.unit] / UNITS_M[unit])
    return replace(shape, rows=rows, unit=unit)


def colored(shape: Shape, scalar: str | None) -> Shape:
    """The shape with red, green and blue by one of its scalars, which stays beside them; None leaves it as it is.

    The scale goes from the smallest to the largest value that is known, from 0 for lengths and forces; values that are not
    known are grey.  Raises InputError for a scalar that the shape does not have, or of which no value is known.
    """
    if scalar is None:
        return shape
    if scalar not in shape.scalars:
        raise InputError(f"there is no {scalar!r} to colour the {shape.what} by; it has {', '.join(shape.scalars)}")
    values = shape.scalars[scalar].astype(np.float64)
    known = np.isfinite(values)
    if not known.any():
        raise InputError(f"no value of {scalar} is known, by which the {shape.what} is to be coloured; choose another")
    from matplotlib import colormaps

    low = 0.0 if scalar in _FROM_ZERO else float(values[known].min())
    high = float(values[known].max())
    fraction = (values[known] - low) / ((high - low) or 1.0)
    rgb = np.full((len(values), 3), _UNKNOWN, dtype=np.uint8)
    rgb[known] = np.round(255 * np.asarray(colormaps[_MAP](fraction))[:, :3]).astype(np.uint8)
    columns: dict[str, NDArray[np.generic]] = {name: shape.rows[name] for name in POINT + NORMAL}
    columns |= dict(zip(COLOR, rgb.T, strict=True)) | shape.scalars
    note = f"colour {scalar} from {low:.6g} to {high:.6g}, {_MAP}"
    return replace(shape, rows=_table(columns), notes=(*shape.notes, note))


def named_for(shape: Shape, program: str | None, scalar: str | None = None) -> Shape:
    """The shape with scalars by the names that a program knows, one of `choices.SCALAR_NAMES`; None keeps them.

    MeshLab shows one scalar, ``quality``: it becomes a copy of `scalar`, by default the force of a cloud and the bound of a
    surface, and the column that had this name is then called ``distance``.  CloudCompare recognises scalars whose names begin
    with ``scalar_``.  Raises InputError for another program, and for a scalar that the shape does not have.
    """
    if program is None:
        return shape
    if program not in SCALAR_NAMES:
        raise InputError(f"names of scalars are known for {' and '.join(SCALAR_NAMES)}, got {program!r}")
    spatial = {name: shape.rows[name] for name in shape.rows.dtype.names or () if name not in shape.scalars}
    if program == "cloudcompare":
        return replace(
            shape, rows=_table(spatial | {_CLOUDCOMPARE + name: values for name, values in shape.scalars.items()})
        )
    shown = scalar or _DEFAULT[shape.what]
    if shown not in shape.scalars:
        raise InputError(
            f"there is no {shown!r} for MeshLab to show; name one of {', '.join(shape.scalars) or 'none'} with --color"
        )
    others = {_SHOWN_BEFORE if name == _SHOWN else name: values for name, values in shape.scalars.items()}
    # MeshLab reads it as a floating-point number only
    return replace(shape, rows=_table(spatial | {_SHOWN: shape.scalars[shown].astype(np.float64)} | others))


def _table(columns: dict[str, NDArray[np.generic]]) -> NDArray[np.void]:
    """Columns (n,) as a structured array."""
    count = len(next(iter(columns.values())))
    rows = np.empty(count, dtype=[(name, column.dtype) for name, column in columns.items()])
    for name, column in columns.items():
        rows[name] = column
    return rows
