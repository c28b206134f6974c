"""The steps of a scan as `scan3d` offers them: meshes and recordings may be given as the paths of their files.

The functions that do the work know nothing of files.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

from scan3d import comparison
from scan3d.calibration import report
from scan3d.calibration.report import Calibration
from scan3d.choices import Method, Model, Tare
from scan3d.comparison import Comparison
from scan3d.files.meshes import common_unit, load_mesh, read_mesh
from scan3d.files.recordings import read_recording
from scan3d.planning import Plan
from scan3d.reconstruction import reconstruct as reconstruct_contacts
from scan3d.recording import Recording
from scan3d.simulation import scan
from scan3d.surfaces import choice
from scan3d.units import UNITS_M, unit_remark

if TYPE_CHECKING:
    import trimesh

    from scan3d.cloud import Cloud
    from scan3d.surfaces import Enclosure

_Path = str | os.PathLike[str]
_Step = TypeVar("_Step", bound=Callable[..., Any])


def _recording(given: Recording | _Path) -> Recording:
    return read_recording(Path(given)) if isinstance(given, (str, os.PathLike)) else given


def _described_by(inner: Callable[..., Any], further: str) -> Callable[[_Step], _Step]:
    """Gives a step the description of the function that does its work, and a further sentence."""

    def describe(step: _Step) -> _Step:
        step.__doc__ = f"{inner.__doc__}\n    {further}\n"
        return step

    return describe


@_described_by(scan.simulate, "The mesh may be given as the path of its file, which is read by `scan3d.load_mesh`.")
def simulate(
    mesh: trimesh.Trimesh | _Path, plan: Plan | None = None, progress: scan.Progress | None = None
) -> Recording:
    if isinstance(mesh, (str, os.PathLike)):
        mesh = load_mesh(mesh, unit=(plan or Plan()).unit)
    return scan.simulate(mesh, plan, progress)


@_described_by(reconstruct_contacts, "The recording may be given as the path of its ``.csv`` or ``.parquet`` file.")
def reconstruct(recording: Recording | _Path, method: str = "closed-form", model: Model | None = None) -> Cloud:
    return reconstruct_contacts(_recording(recording), method, model)


@_described_by(choice.surface, "`Trimesh.units` is the unit of the cloud.")
def surface(cloud: Cloud, method: Method = "auto", *, bounds: Enclosure | None = None) -> trimesh.Trimesh:
    mesh: trimesh.Trimesh = choice.surface(cloud, method, bounds=bounds)
    mesh.units = cloud.unit
    return mesh


@_described_by(
    comparison.compare,
    "Either may be given as the path of a mesh file, whose triangles are taken as they are.  A warning says so if the sizes"
    "\n    differ by a factor between units, such as 10, 25.4 or 1000.",
)
def compare(surface: trimesh.Trimesh | _Path, mesh: trimesh.Trimesh | _Path) -> Comparison:
    paths = [Path(given) for given in (surface, mesh) if isinstance(given, (str, os.PathLike))]
    stated = [getattr(given, "units", None) for given in (surface, mesh)]
    known = [unit for unit in stated if unit in UNITS_M]
    unit = known[0] if known else common_unit(*paths)
    first, second = (
        read_mesh(given, unit) if isinstance(given, (str, os.PathLike)) else given for given in (surface, mesh)
    )
    compared = comparison.compare(first, second)
    if remark := unit_remark(first.extents, second.extents):
        warnings.warn(remark, stacklevel=2)
    return compared


@_described_by(report.calibrate, "The recording may be given as the path of its file.")
def calibrate(
    recording: Recording | _Path,
    reference: float | Literal["plane"] | None = None,
    *,
    sphere: float | None = None,
    tare: Tare = "auto",
    pose_noise_m: float | None = None,
) -> Calibration:
    return report.calibrate(_recording(recording), reference, sphere=sphere, tare=tare, pose_noise_m=pose_noise_m)
