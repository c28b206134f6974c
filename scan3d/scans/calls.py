"""`scan3d.scan` and `scan3d.open`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from scan3d.errors import InputError
from scan3d.files.whole import REPORT
from scan3d.pictures import stored
from scan3d.scans.performing import perform
from scan3d.scans.results import Scan, StoredScan
from scan3d.settings import Given, shows_settings
from scan3d.settings import settings as chosen_settings
from scan3d.simulation.scan import Progress

if TYPE_CHECKING:
    import trimesh


@shows_settings
def scan(
    mesh: str | os.PathLike[str] | trimesh.Trimesh,
    out: str | os.PathLike[str] | None = None,
    *,
    overwrite: bool = False,
    progress: Progress | None = None,
    **settings: Unpack[Given],
) -> Scan:
    """Scan a convex body: simulate its recording, reconstruct contacts and surface, certify and compare them.

    mesh
        path of a mesh file (STL, PLY, OBJ, OFF or GLB), or a `trimesh.Trimesh`, in the unit of the setting ``unit``.
    out
        folder for the results, as ``scan3d scan`` writes them; None: nothing is written, and `Scan.save` does so later.
    overwrite
        whether files in the folder that the program did not write may be replaced.
    progress
        called with the numbers of slices that are done and of all slices.

    The same mesh and settings give the same results as the command, byte for byte apart from times.

    Raises InputError for unknown settings and values out of range, for a mesh that can't be read or is not closed and convex,
    and if the folder can't be written into.
    """
    chosen = chosen_settings(settings, source="scan3d.scan")
    return Scan(*perform(mesh, chosen, None if out is None else Path(out), overwrite=overwrite, progress=progress))


def open(folder: str | os.PathLike[str]) -> StoredScan:
    """The results in a folder of ``scan3d scan``, ``scan3d reconstruct``, a batch, or `Scan.save`.

    The report is read at once, everything else when it is asked for.  Raises InputError if the folder holds no results, or a
    report that can't be read.
    """
    path = Path(folder)
    if not path.is_dir():
        raise InputError(f"there is no folder {path}; name one that scan3d scan has written")
    data = stored.read_report(path)
    if not data:
        raise InputError(f"{path} holds no {REPORT}, so it is no scan; name a folder that scan3d scan has written")
    return StoredScan(path, data)
