"""The key figures of a report."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np


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
