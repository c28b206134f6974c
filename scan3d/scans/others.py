"""Another surface, that of a result, a folder or a file, to compare a surface with."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from scan3d.errors import InputError
from scan3d.files.meshes import FORMATS, read_mesh
from scan3d.pictures import stored
from scan3d.units import UNITS_M

_WANTED = f"expected a scan's folder, or a surface or mesh file (.{', .'.join(FORMATS)})"


def other_surface(given: Any, unit: str, file_unit: str = "mm") -> trimesh.Trimesh:
    """The surface of a result of `scan3d.scan` or `scan3d.open`, of a folder or of a file, in `unit`; or a `trimesh.Trimesh`.

    `file_unit` is the unit of a file that does not state its own, and of a mesh without `Trimesh.units`.

    Raises InputError for what has no surface, and for files that can't be read.
    """
    if isinstance(given, (str, os.PathLike)):
        mesh, own = _read(Path(given), file_unit)
    else:
        mesh = getattr(given, "surface", given)
        if not isinstance(mesh, trimesh.Trimesh):
            raise InputError(
                f"there is no surface in a {type(given).__name__}: {_WANTED}, a result, or a trimesh.Trimesh"
            )
        own = mesh.units if mesh.units in UNITS_M else file_unit
    if not len(mesh.faces) or not np.isfinite(mesh.vertices).all():
        raise InputError(f"the other surface has no triangles, or vertices that are not numbers: {_WANTED}")
    return trimesh.Trimesh(np.asarray(mesh.vertices) * (UNITS_M[own] / UNITS_M[unit]), mesh.faces, process=False)


def _read(path: Path, unit: str) -> tuple[Any, str]:
    """The surface of a folder or a file, and its unit."""
    if not path.exists():
        raise InputError(f"there is no {path} to compare the surface with: {_WANTED}")
    if path.is_dir():
        scene: Any = stored.read_folder(path, unit)[0]
    elif path.suffix.lower() == ".ply":
        scene = stored.read_ply_scene(path, unit)
    elif path.suffix[1:].lower() in FORMATS:
        scene = None
    else:
        raise InputError(f"{path} has no surface to compare with: {_WANTED}")
    if scene is None:
        return read_mesh(path), unit
    if scene.surface is None:
        raise InputError(f"{path} has no surface to compare with, but contacts only: {_WANTED}")
    return scene.surface, scene.unit
