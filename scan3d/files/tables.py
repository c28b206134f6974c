"""The columns of ``cloud.ply`` and ``surface.ply``."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scan3d.arrays import Array
from scan3d.cloud import Cloud


def cloud_table(cloud: Cloud, quality: Array | None = None) -> NDArray[np.void]:
    """Contacts as a structured array for `files.ply`; `quality` (n,) is their distance to the true mesh, NaN if not given.

    Contacts of noisy data have two further columns, the standard deviations of their places and of their normals' angles.
    Contacts of the spatial model lie in no slices; instead of the slice they have the rod's tangent and its bending angle.
    """
    columns: dict[str, NDArray[np.generic]] = {
        **dict(zip("xyz", cloud.points.T, strict=True)),
        **dict(zip(("nx", "ny", "nz"), cloud.normals.astype(np.float32).T, strict=True)),
        "quality": np.full(len(cloud), np.nan) if quality is None else quality,
        "phase": cloud.phase.astype(np.uint8),
        "slice": cloud.slice,
        "sweep": cloud.sweep,
        "row": cloud.row,
        "force": cloud.force_N,
        "friction": cloud.friction.astype(np.float32),
        "normal_source": cloud.normal_source.astype(np.uint8),
    }
    if cloud.place_sd is not None and cloud.normal_sd is not None:
        columns["place_sd"] = cloud.place_sd.astype(np.float32)
        columns["normal_sd"] = np.where(np.isfinite(cloud.normal_sd), cloud.normal_sd, np.nan).astype(np.float32)
    if cloud.tangents is not None and cloud.bending_angle is not None:
        del columns["slice"]
        columns |= dict(zip(("tx", "ty", "tz"), cloud.tangents.astype(np.float32).T, strict=True))
        columns["bending"] = cloud.bending_angle.astype(np.float32)
    rows = np.empty(len(cloud), dtype=[(name, column.dtype) for name, column in columns.items()])
    for name, column in columns.items():
        rows[name] = column
    return rows


def surface_table(surface: Any, bound: Array) -> np.ndarray[Any, np.dtype[np.void]]:
    """Vertices, their normals and the certified local bound (v,) as a structured array for `files.ply`."""
    names = [(name, "f8") for name in "xyz"] + [(f"n{name}", "f4") for name in "xyz"] + [("bound", "f4")]
    rows = np.empty(len(surface.vertices), dtype=names)
    for columns, values in (
        ("x y z", surface.vertices),
        ("nx ny nz", surface.vertex_normals),
        ("bound", bound[:, None]),
    ):
        for column, value in zip(columns.split(), np.asarray(values).T, strict=True):
            rows[column] = value
    return rows
