"""What a run has found: the report's numbers, and a few lines of them for the terminal."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from importlib.metadata import version
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

import planar
from scan3d.bracket import Bracket, Gap
from scan3d.cloud import Array, Cloud
from scan3d.comparison import Comparison
from scan3d.recording import Recording

SCHEMA = 1
# Directions, spread evenly over the sphere, at which the coverage of normals is looked up.
_DIRECTIONS = 5000
# The surface counts as seen where its certified bound is no more than this share of the diagonal.
_SEEN = 1e-3
_PACKAGES = ("scan3d", "numpy", "scipy", "trimesh", "pyvista")


def report(
    *,
    settings: Mapping[str, Any],
    recording: Recording,
    cloud: Cloud,
    surface: Any,
    certificate: tuple[float, Array],
    bracket: Bracket,
    timings_s: Mapping[str, float],
    files: list[str],
    mesh: Any = None,
    contact_error: Array | None = None,
    comparison: Comparison | None = None,
    hull_error: float | None = None,
    friction_set: str | None = None,
) -> dict[str, Any]:
    """The report as it is written to JSON; what needs the true mesh is null without it."""
    tangential = cloud.phase == planar.Phase.TANGENTIAL
    friction = cloud.friction[tangential]
    unit = cloud.unit
    return {
        "schema": SCHEMA,
        "mesh": None if mesh is None else _mesh(mesh, unit),
        "settings": dict(settings),
        "source": dict(recording.source),
        "versions": {"python": platform.python_version(), **{name: version(name) for name in _PACKAGES}},
        "rod": {
            "length_m": recording.rod.length_m,
            "bending_stiffness_Nm2": recording.rod.bending_stiffness_Nm2,
            "length": cloud.rod_length,
        },
        "counts": {
            "slices": len(np.unique(cloud.slice)),
            "empty_slices": len(cloud.slice_height) - len(np.unique(cloud.slice)),
            "sweeps": len(np.unique(recording.sweep)),
            "samples": len(recording),
            "contacts": len(cloud),
            "tangential": int(tangential.sum()),
            "tip": int((cloud.phase == planar.Phase.TIP).sum()),
        },
        "contact_error": _contact_error(contact_error, cloud.rod_length, unit),
        "friction": {
            "set": friction_set,
            "estimated_median": float(np.median(friction)) if len(friction) else None,
            "estimated_range": [float(friction.min()), float(friction.max())] if len(friction) else None,
        },
        "hausdorff": _hausdorff(comparison, unit),
        "certificate": _certificate(certificate[0], bracket, cloud),
        "error_budget": _budget(certificate[0], bracket, cloud, contact_error, hull_error, comparison),
        "coverage": _coverage(cloud, surface, certificate[1]),
        "surface": {
            "method": surface.metadata["method"],
            "reason": surface.metadata["reason"],
            "watertight": bool(surface.is_watertight),
            "faces": len(surface.faces),
            "volume": float(surface.volume),
            "volume_error": None if comparison is None else comparison.volume_error,
        },
        "normals": _normals(comparison),
        "timings_s": {name: round(seconds, 3) for name, seconds in timings_s.items()},
        "files": files,
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
    }


def _contact_error(errors: Array | None, rod_length: float, unit: str) -> dict[str, Any] | None:
    if errors is None:
        return None
    most, rms = float(errors.max()), float(np.sqrt(np.mean(errors**2)))
    return {"max": most, "rms": rms, "unit": unit, "max_rod_lengths": most / rod_length}


def _certificate(bound: float, bracket: Bracket, cloud: Cloud) -> dict[str, Any]:
    """What touch alone guarantees, relative to the diagonal of the contacts' bounding box."""
    diagonal = float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    return {
        "bound": bound,
        "relative": bound / diagonal,
        "unit": cloud.unit,
        "hull_bound": bracket.bound,
        "parts": {gap.name.lower(): bracket.part(gap) for gap in Gap} | {"noise": bracket.margin},
        "volume": list(bracket.volume),
    }


def _budget(
    certified: float,
    bracket: Bracket,
    cloud: Cloud,
    contact_error: Array | None,
    hull_error: float | None,
    comparison: Comparison | None,
) -> dict[str, Any]:
    """Where the error comes from, step by step: what touch alone guarantees, and what it is where the truth is known."""

    def step(guaranteed: float, actual: float | None) -> dict[str, float | None]:
        return {"at_most": guaranteed, "is": actual}

    return {
        "unit": cloud.unit,
        "contacts_off": step(bracket.margin, None if contact_error is None else float(contact_error.max())),
        "between_slices": step(bracket.part(Gap.SLICES), None),
        "between_contacts": step(bracket.part(Gap.CONTACTS), None),
        "past_end_slices": step(bracket.part(Gap.CAPS), None),
        "hull": step(bracket.bound, hull_error),
        "surface": step(certified, None if comparison is None else comparison.hausdorff),
        "sum": "hull, at most = largest of between_slices, between_contacts and past_end_slices, plus contacts_off; "
        "surface: what its method makes of that",
    }


def _coverage(cloud: Cloud, surface: Any, bound: Array) -> dict[str, Any]:
    """Shares of what was seen.

    Of the surface's area, where touch alone leaves less than 0.1 % of the diagonal open; of the sphere of normals, within
    5° of a contact's, by as many directions spread evenly over it.
    """
    diagonal = float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    area = np.asarray(surface.area_faces)
    closed = bound[surface.faces].max(axis=1) <= _SEEN * diagonal
    seen = {"surface": float(area[closed].sum() / area.sum()), "surface_within": _SEEN * diagonal}
    known = cloud.normals[np.isfinite(cloud.normals[:, 0])]
    if not len(known):
        return {**seen, "normals": 0.0}
    turn = np.arange(_DIRECTIONS) + 0.5
    z, angle = 1 - 2 * turn / _DIRECTIONS, np.pi * (1 + np.sqrt(5)) * turn
    sphere = np.column_stack([np.sqrt(1 - z * z) * np.cos(angle), np.sqrt(1 - z * z) * np.sin(angle), z])
    return {**seen, "normals": float(np.mean(cKDTree(known).query(sphere)[0] < 2 * np.sin(np.radians(2.5))))}


def _hausdorff(found: Comparison | None, unit: str) -> dict[str, Any] | None:
    if found is None:
        return None
    return {
        "two_sided": found.hausdorff,
        "surface_to_mesh": found.surface_to_mesh,
        "mesh_to_surface": found.mesh_to_surface,
        "relative": found.relative,
        "exact": found.exact,
        "worst_point": found.worst_point,
        "unit": unit,
    }


def _normals(found: Comparison | None) -> dict[str, Any] | None:
    if found is None:
        return None
    return {"of": "surface", "median_deg": found.normal_median_deg, "p95_deg": found.normal_p95_deg}


def summary(data: Mapping[str, Any]) -> str:
    """A few lines for the terminal."""
    counts, hausdorff, errors = data["counts"], data["hausdorff"], data["contact_error"]
    lines = [
        f"{counts['contacts']} contacts of {counts['samples']} samples, {counts['sweeps']} sweeps in {counts['slices']} slices"
    ]
    if errors:
        lines.append(
            f"contact error      {errors['max']:.3g} {errors['unit']} at most ({errors['max_rod_lengths']:.1e} rod lengths)"
        )
    unreached = data["source"].get("sweeps_out_of_reach")
    if unreached:
        lines.append(f"out of reach       {unreached} sweeps that the rod can't make from its base line")
    median = data["friction"]["estimated_median"]
    if median is not None:
        given = data["friction"]["set"]
        lines.append(f"friction           {median:.4g} (median, found from touch{f'; set: {given}' if given else ''})")
    surface = data["surface"]
    closed = "watertight" if surface["watertight"] else "not watertight"
    lines.append(f"surface            {surface['method']}, {surface['faces']} faces, {closed}")
    if hausdorff:
        lines.append(
            f"Hausdorff distance {hausdorff['two_sided']:.4g} {hausdorff['unit']} ({hausdorff['relative']:.1e} of the diagonal)"
        )
    certified = data["certificate"]
    if certified["bound"] is not None and np.isfinite(certified["bound"]):
        bound = f"{certified['bound']:.4g} {certified['unit']} ({certified['relative']:.1e} of the diagonal)"
        lines.append(f"certified          within {bound}, from touch alone")
    return "\n".join(lines)


def comparison_summary(found: Comparison, unit: str) -> str:
    """The comparison of two meshes for the terminal."""
    where = ", ".join(f"{x:.6g}" for x in found.worst_point)
    exact = "exact" if found.exact else f"certified between {found.lower:.6g} and {found.upper:.6g} {unit}"
    return "\n".join(
        [
            f"Hausdorff distance {found.hausdorff:.6g} {unit} ({found.relative:.3e} of B's diagonal; {exact})",
            f"A to B             {found.surface_to_mesh:.6g} {unit}",
            f"B to A             {found.mesh_to_surface:.6g} {unit}",
            f"worst at           ({where}), on {'A' if found.worst_on == 'surface' else 'B'}",
            f"mean, RMS, 95 %    {found.mean:.4g}, {found.rms:.4g}, {found.p95:.4g} {unit}",
            f"Chamfer, F-score   {found.chamfer:.4g} {unit}, {found.f_score:.4f} at 1 % of B's diagonal",
            f"normals            {found.normal_median_deg:.3g}° median, {found.normal_p95_deg:.3g}° at 95 %",
            f"volume error       {found.volume_error:+.3e}",
        ]
    )
