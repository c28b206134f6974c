"""A scene in words: the key figures of a report, and what was measured at a contact."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

import planar
from scan3d.arrays import Array
from scan3d.pictures.scene import Scene


def out_of_plane_deg(bending_angle: Array) -> Array:
    """(n,) angles in degrees between the directions to which the rod bends and the plane of the sweep, from -90 to 90.

    In contrast to the angle of the bending plane, from -180° to 180°, it does not jump, and is 0 for rods that bend backward.
    """
    return np.rad2deg(np.arcsin(np.sin(bending_angle)))


def key_figures(report: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    """The key figures that a report has, as pairs of name and value; distances also in % of the diagonal."""

    def entry(section: str, name: str) -> Any:
        part = report.get(section)
        return part.get(name) if isinstance(part, Mapping) else None

    rows: list[tuple[str, str]] = []
    scanned, to_hull = entry("mesh", "scanned"), ""
    if scanned not in (None, "mesh"):
        rows.append(("scanned", f"the {scanned}"))
        to_hull = f" from the {scanned}"
    extents, unit = entry("mesh", "extents"), entry("certificate", "unit") or entry("mesh", "unit") or ""
    if extents is not None:
        rows.append(("size", " × ".join(f"{extent:.4g}" for extent in extents) + f" {unit}"))
    rows += [
        (name, str(entry("counts", name)))
        for name in ("contacts", "slices", "sweeps")
        if entry("counts", name) is not None and not (name == "slices" and entry("counts", name) == 0)
    ]
    if entry("contact_error", "max") is not None:
        rows.append(("contact error", f"{entry('contact_error', 'max'):.2g} {unit} at most{to_hull}"))
    if entry("friction", "estimated_median") is not None:
        rows.append(("friction", f"{entry('friction', 'estimated_median'):.4g} (median)"))
    if entry("surface", "method") is not None:
        rows.append(("surface", f"{entry('surface', 'method')}, {entry('surface', 'faces')} faces"))
    warnings = report.get("warnings")
    if isinstance(warnings, list) and warnings:
        codes = [str(warning.get("code")) for warning in warnings if isinstance(warning, Mapping)]
        rows.append(("not certified", ", ".join(codes)))
    if entry("diagnosis", "message") is not None:
        rows.append(("diagnosis", str(entry("diagnosis", "message"))))
    for label, section, name in (
        ("Hausdorff distance", "hausdorff", "two_sided"),
        ("certified within", "certificate", "bound"),
    ):
        value, relative = entry(section, name), entry(section, "relative")
        if value is not None and np.isfinite(value):
            share = "" if relative is None else f" ({100 * relative:.2g} %)"
            rows.append((label, f"{value:.3g} {unit}{share}{to_hull if section == 'hausdorff' else ''}"))
        itself = entry("hausdorff", "mesh_itself")
        if section == "hausdorff" and isinstance(itself, Mapping):
            distance, share = itself["two_sided"], f"{100 * itself['relative']:.2g} %"
            rows.append(("distance from the mesh itself", f"{distance:.3g} {unit} ({share})"))
    return tuple(rows)


def contact_sentence(scene: Scene, contact: int) -> str:
    """What was measured at a contact, given by its row in the scene's contacts."""
    parts = [
        "contact {}: ({})".format(contact, ", ".join(f"{x:.6g}" for x in scene.points[contact])) + f" {scene.unit}"
    ]
    for name in ("sweep", "slice"):
        values = scene.column(name)
        if values is not None:
            parts.append(f"{name} {values[contact]:.0f}")
    phase, force, friction = (scene.column(name) for name in ("phase", "force", "friction"))
    if phase is not None:
        parts.append(f"{planar.Phase(int(phase[contact])).name.lower()} contact")
    if force is not None:
        parts.append(f"force {1e3 * force[contact]:.4g} mN")
    if friction is not None and np.isfinite(friction[contact]):
        parts.append(f"friction {friction[contact]:.4g}")
    bending = scene.column("bending")
    if bending is not None:
        parts.append(f"bending {out_of_plane_deg(bending)[contact]:.1f}° out of the sweep's plane")
    normal = scene.normals[contact]
    if np.isfinite(normal).all():
        parts.append("normal ({})".format(", ".join(f"{x:.4f}" for x in normal)))
    return ", ".join(parts)
