"""From a mesh to a simulated tactile scan, and from any tactile scan to a closed surface with its error.

The flow, in one direction::

    mesh ─ slice ─ plan ─ simulate ─▶ recording ─▶ reconstruct ─▶ cloud ─▶ surface ─▶ compare
                       (or a laboratory)

World coordinates are the mesh's (`Plan.unit`, mm unless said); recordings are in SI units.  A clamp's frame has its y axis
along the undeformed rod, its x axis along the line of the sweep (the base moves in -x) and its z axis normal to the slice.

The model is quasi-static and planar: forces out of the slice's plane, which push a real rod sideways where the surface is
inclined to the slice, are ignored.
"""

from __future__ import annotations

from importlib import import_module

from scan3d.shown import register as _register

TYPE_CHECKING = False  # that of `typing`, whose import would be the longest part of this one
if TYPE_CHECKING:
    from typing import Any

    from scan3d.batches import Batch as Batch
    from scan3d.batches import batch as batch
    from scan3d.calibration.report import Calibration as Calibration
    from scan3d.calibration.report import calibrate as calibrate
    from scan3d.calibration.report import read_rig as read_rig
    from scan3d.calibration.report import write_rig as write_rig
    from scan3d.cloud import Cloud as Cloud
    from scan3d.comparison import Comparison as Comparison
    from scan3d.errors import InputError as InputError
    from scan3d.files.meshes import load_mesh as load_mesh
    from scan3d.files.recordings import read_recording as read_recording
    from scan3d.files.recordings import write_recording as write_recording
    from scan3d.files.shapes import Shape as Shape
    from scan3d.laboratory.importing import import_table as import_table
    from scan3d.laboratory.places import calibrate_signals as calibrate_signals
    from scan3d.live import Live as Live
    from scan3d.live import LiveContact as LiveContact
    from scan3d.live_page import LivePage as LivePage
    from scan3d.pictures.notebook import plot as plot
    from scan3d.planning import Plan as Plan
    from scan3d.recording import Recording as Recording
    from scan3d.results import Result as Result
    from scan3d.results import compare as compare
    from scan3d.results import load as load
    from scan3d.results import open as open
    from scan3d.results import reconstruct as reconstruct
    from scan3d.results import save as save
    from scan3d.results import scan as scan
    from scan3d.results import simulate as simulate
    from scan3d.results import surface as surface
    from scan3d.results import touches as touches
    from scan3d.rods import Gravity as Gravity
    from scan3d.rods import Rod as Rod
    from scan3d.session import Session as Session

# Loaded when first used: `import scan3d` and `scan3d --help` stay quick.
_NAMES = {
    "batches": "Batch batch",
    "calibration.report": "Calibration calibrate read_rig write_rig",
    "cloud": "Cloud",
    "comparison": "Comparison",
    "errors": "InputError",
    "files.meshes": "load_mesh",
    "files.recordings": "read_recording write_recording",
    "files.shapes": "Shape",
    "laboratory.importing": "import_table",
    "laboratory.places": "calibrate_signals",
    "live": "Live LiveContact",
    "live_page": "LivePage",
    "pictures.notebook": "plot",
    "planning.plan": "Plan",
    "recording": "Recording",
    "results": "Result compare load open reconstruct save scan simulate surface touches",
    "rods": "Gravity Rod",
    "session": "Session",
}
_HOME = {name: module for module, names in _NAMES.items() for name in names.split()}

# `from scan3d import *` leaves Python's own `open` as it is
__all__ = sorted(_HOME.keys() - {"open"})


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("scan3d")
    if name in _HOME:
        return getattr(import_module(f"scan3d.{_HOME[name]}"), name)
    import sys

    # with name and object, from which Python tells what was probably meant
    raise AttributeError(f"module 'scan3d' has no attribute {name!r}", name=name, obj=sys.modules[__name__])


def __dir__() -> list[str]:
    return sorted([*_HOME, "__version__"])


_register(
    drawn=lambda: import_module("scan3d.pictures.notebook"),
    saved=lambda: import_module("scan3d.results"),
)
