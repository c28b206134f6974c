"""The results of a run: the report's numbers, and the most important of them for the terminal."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np

import planar
from scan3d.arrays import Array
from scan3d.bounds import Certificate, Enclosure
from scan3d.budget import calibration_numbers, calibration_off, noise_off
from scan3d.cloud import Cloud
from scan3d.comparison import Comparison
from scan3d.coverage import coverage
from scan3d.geometry.convexity import HULL_OF_MESH
from scan3d.measurands import measurands
from scan3d.reconstruction import Contradiction, Diagnosis, noise_of, radius_errors
from scan3d.recording import Recording

if TYPE_CHECKING:
    import trimesh

SCHEMA = 1
# What the parts of an enclosure's bound are called in the error budget.
_CAUSES = {
    "slices": "between_slices",
    "contacts": "between_contacts",
    "caps": "past_end_slices",
    "rod": "thickness_of_rod",
}
_PACKAGES = ("scan3d", "numpy", "scipy", "trimesh", "pyvista")


@dataclass(frozen=True, repr=False)
class Analysis:
    """Results from a recording: contacts, bounds, surface and certificate; with the truth, also the comparison with it."""

    recording: Recording
    cloud: Cloud
    bounds: Enclosure
    surface: trimesh.Trimesh
    """A `trimesh.Trimesh` in the cloud's unit; `metadata` has its `method` and the `reason` for it."""
    certificate: Certificate
    truth: trimesh.Trimesh | None = None
    """The true body, a `trimesh.Trimesh`."""
    contact_error: Array | None = None
    """(n,) distance of the contacts from the truth."""
    comparison: Comparison | None = None
    """Comparison of the surface with the truth."""
    mesh_comparison: Comparison | None = None
    """Comparison of the surface with the mesh itself, where the truth is the convex hull of a mesh that is not convex."""
    hull_error: float | None = None
    """Hausdorff distance of the contacts' convex hull to the truth."""
    seconds: Mapping[str, float] = field(default_factory=dict)
    """Time spent on each step."""
    warnings: tuple[Contradiction, ...] = ()
    """Contradictions between the recording and the model; with any of them nothing is certified."""
    diagnosis: Diagnosis | None = None
    """The likeliest fault of a recording that contradicts the model; None without warnings."""

    def __repr__(self) -> str:
        return f"Analysis of {len(self.recording)} samples: {len(self.cloud)} contacts, {len(self.surface.faces)} faces"


def report(
    analysis: Analysis,
    *,
    settings: Mapping[str, Any],
    friction_set: str | None = None,
    timings_s: Mapping[str, float] | None = None,
    files: Sequence[str] = (),
) -> dict[str, Any]:
    """The numbers of an analysis as they are written to JSON; those that need the true mesh are None without it.

    settings
        those of the run, which the report repeats.
    friction_set
        the coefficient of friction or its range, if it is known because the recording was simulated.
    timings_s
        time spent on each step, in seconds.
    files
        names of the files written.
    """
    recording, cloud, surface, comparison = analysis.recording, analysis.cloud, analysis.surface, analysis.comparison
    unit = cloud.unit
    return {
        "schema": SCHEMA,
        "model": cloud.model,
        "mesh": None if analysis.truth is None else _mesh(analysis.truth, unit),
        "settings": dict(settings),
        "source": dict(recording.source),
        "versions": {"python": platform.python_version(), **{name: version(name) for name in _PACKAGES}},
        "rod": {
            "length_m": recording.rod.length_m,
            "bending_stiffness_Nm2": recording.rod.bending_stiffness_Nm2,
            "length": cloud.rod_length,
            **_thickness(cloud),
        },
        "counts": _counts(analysis),
        "contact_error": _contact_error(analysis),
        "friction": _friction(cloud, friction_set),
        "hausdorff": _hausdorff(analysis, unit),
        "comparison": None if comparison is None else asdict(comparison),
        "certificate": _certificate(analysis),
        "measurands": measurands(cloud, analysis.bounds, surface, analysis.certificate),
        "warnings": [warning._asdict() for warning in analysis.warnings],
        "diagnosis": None if analysis.diagnosis is None else analysis.diagnosis._asdict(),
        "noise": _noise(analysis),
        **calibration_numbers(recording, cloud),
        "error_budget": _budget(analysis),
        "coverage": coverage(analysis.cloud, analysis.bounds, analysis.surface, analysis.certificate),
        "surface": {
            "method": surface.metadata["method"],
            "reason": surface.metadata["reason"],
            "watertight": bool(surface.is_watertight),
            "faces": len(surface.faces),
            "volume": float(surface.volume),
            "volume_error": None if comparison is None else comparison.volume_error,
        },
        "normals": _normals(comparison),
        "timings_s": {name: round(seconds, 3) for name, seconds in (timings_s or {}).items()},
        "files": list(files),
    }


def _mesh(mesh: Any, unit: str) -> dict[str, Any]:
    return {
        "file": mesh.metadata.get("file"),
        "sha256": mesh.metadata.get("sha256"),
        "faces": mesh.metadata.get("file_faces", len(mesh.faces)),
        "extents": mesh.extents,
        "unit": unit,
        "dent": mesh.metadata.get("dent"),
        "hull": mesh.metadata.get("hull"),
        "scanned": _scanned(mesh),
        "filled": mesh.metadata.get("filled"),
    }


def _counts(analysis: Analysis) -> dict[str, int]:
    recording, cloud = analysis.recording, analysis.cloud
    slices = len(np.unique(cloud.slice[cloud.slice >= 0]))
    return {
        "slices": slices,
        "empty_slices": len(cloud.slice_height) - slices,
        "unproven_slices": 0 if cloud.unresolved is None else int(cloud.unresolved.sum()),
        "sweeps": len(np.unique(recording.sweep)),
        "samples": len(recording),
        "contacts": len(cloud),
        "tangential": int((cloud.phase == planar.Phase.TANGENTIAL).sum()),
        "tip": int((cloud.phase == planar.Phase.TIP).sum()),
        "light": cloud.light,
    }


def _friction(cloud: Cloud, friction_set: str | None) -> dict[str, Any]:
    friction, law = cloud.friction[cloud.phase == planar.Phase.TANGENTIAL], {}
    if cloud.model == "spatial":
        friction = cloud.friction[np.isfinite(cloud.friction)]
        angle = np.empty(0) if cloud.slip_to_path is None else cloud.slip_to_path[np.isfinite(cloud.slip_to_path)]
        law = {"slip_to_path_deg": float(np.degrees(np.median(angle))) if len(angle) else None}
    return {
        "set": friction_set,
        "estimated_median": float(np.median(friction)) if len(friction) else None,
        "estimated_range": [float(friction.min()), float(friction.max())] if len(friction) else None,
        **law,
    }


def _thickness(cloud: Cloud) -> dict[str, Any]:
    """The rod's diameter and what its radius does to the contacts, which the planar model neglects."""
    if cloud.model != "spatial":
        return {}
    return {"diameter": 2 * cloud.rod_radius, "radius": {**radius_errors(cloud)._asdict(), "unit": cloud.unit}}


def _contact_error(analysis: Analysis) -> dict[str, Any] | None:
    errors, cloud = analysis.contact_error, analysis.cloud
    if errors is None:
        return None
    largest, rms = float(errors.max()), float(np.sqrt(np.mean(errors**2)))
    return {"max": largest, "rms": rms, "unit": cloud.unit, "max_rod_lengths": largest / cloud.rod_length}


def _certificate(analysis: Analysis) -> dict[str, Any]:
    """The certified bound and its parts, and the bound relative to the diagonal of the contacts' bounding box."""
    bound, bounds, cloud = analysis.certificate.bound, analysis.bounds, analysis.cloud
    diagonal = float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    return {
        "bound": bound,
        "relative": bound / diagonal,
        "unit": cloud.unit,
        "hull_bound": bounds.bound,
        "confidence": bounds.confidence,
        "table": cloud.table,
        "parts": bounds.parts() | {"noise": noise_off(cloud, bounds)} | calibration_off(cloud, bounds),
        "volume": list(bounds.volume),
    }


def _noise(analysis: Analysis) -> dict[str, float]:
    """Standard deviations of force and moment: those that the recording states, and those that count, with its digits."""
    recording, known = analysis.recording, noise_of(analysis.recording)
    return {
        "force_N": known.force_N,
        "moment_Nm": known.moment_Nm,
        "stated_force_N": recording.noise_force_N,
        "stated_moment_Nm": recording.noise_moment_Nm,
        "stated_pose_m": recording.noise_pose_m,
        "contact_median": analysis.cloud.noise,
    }


def _budget(analysis: Analysis) -> dict[str, Any]:
    """The error of each step: its certified upper bound, and its actual value where the truth is known."""
    bounds, contact_error, comparison = analysis.bounds, analysis.contact_error, analysis.comparison
    parts, calibration = bounds.parts(), calibration_off(analysis.cloud, bounds)
    causes = [_CAUSES[name] for name in parts]

    def step(guaranteed: float, actual: float | None) -> dict[str, float | None]:
        return {"at_most": guaranteed, "is": actual}

    return {
        "unit": analysis.cloud.unit,
        "contacts_off": step(
            noise_off(analysis.cloud, bounds) + sum(calibration.values()),
            None if contact_error is None else float(contact_error.max()),
        ),
        **{name: step(size, None) for name, size in calibration.items()},
        **{_CAUSES[name]: step(gap, None) for name, gap in parts.items()},
        "hull": step(bounds.bound, analysis.hull_error),
        "surface": step(analysis.certificate.bound, None if comparison is None else comparison.hausdorff),
        "sum": f"hull, at most = largest of {', '.join(causes[:-1])} and {causes[-1]}, which contain the errors of the "
        "contacts; surface: what its method makes of that",
    }


def _scanned(truth: trimesh.Trimesh) -> str:
    """What the true body is: the mesh, or its convex hull where that differs."""
    return HULL_OF_MESH if "filled" in truth.metadata else "mesh"


def _hausdorff(analysis: Analysis, unit: str) -> dict[str, Any] | None:
    comparison, to_mesh = analysis.comparison, analysis.mesh_comparison
    if comparison is None or analysis.truth is None:
        return None
    return {
        **_distances(comparison),
        "exact": comparison.exact,
        "worst_point": comparison.worst_point,
        "unit": unit,
        "to": _scanned(analysis.truth),
        "mesh_itself": None if to_mesh is None else _distances(to_mesh),
    }


def _distances(comparison: Comparison) -> dict[str, float]:
    names = ("surface_to_mesh", "mesh_to_surface", "relative")
    return {"two_sided": comparison.hausdorff, **{name: getattr(comparison, name) for name in names}}


def _normals(comparison: Comparison | None) -> dict[str, Any] | None:
    if comparison is None:
        return None
    return {"of": "surface", "median_deg": comparison.normal_median_deg, "p95_deg": comparison.normal_p95_deg}
