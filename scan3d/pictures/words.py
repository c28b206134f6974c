"""A scene in words: the key figures of a report, and what was measured at a contact."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

import planar
from scan3d.pictures.scene import Scene


def key_figures(report: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    """The key figures of a report, those that it has; distances also in % of the diagonal."""

    def of(section: str, name: str) -> Any:
        part = report.get(section)
        return part.get(name) if isinstance(part, Mapping) else None

    found: list[tuple[str, str]] = []
    extents, unit = of("mesh", "extents"), of("certificate", "unit") or of("mesh", "unit") or ""
    if extents is not None:
        found.append(("size", " × ".join(f"{one:.4g}" for one in extents) + f" {unit}"))
    found += [
        (name, str(of("counts", name))) for name in ("contacts", "slices", "sweeps") if of("counts", name) is not None
    ]
    if of("contact_error", "max") is not None:
        found.append(("contact error", f"{of('contact_error', 'max'):.2g} {unit} at most"))
    if of("friction", "estimated_median") is not None:
        found.append(("friction", f"{of('friction', 'estimated_median'):.4g} (median)"))
    if of("surface", "method") is not None:
        found.append(("surface", f"{of('surface', 'method')}, {of('surface', 'faces')} faces"))
    for what, section, name in (
        ("Hausdorff distance", "hausdorff", "two_sided"),
        ("certified within", "certificate", "bound"),
    ):
        value, relative = of(section, name), of(section, "relative")
        if value is not None and np.isfinite(value):
            found.append((what, f"{value:.3g} {unit} ({100 * relative:.2g} %)"))
    return tuple(found)


def contact_sentence(scene: Scene, contact: int) -> str:
    """What was felt at a contact."""
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
    normal = scene.normals[contact]
    if np.isfinite(normal).all():
        parts.append("normal ({})".format(", ".join(f"{x:.4f}" for x in normal)))
    return ", ".join(parts)
