"""The most important numbers of a report, and of a comparison, as short tables for the terminal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from scan3d.budget import calibration_rows
from scan3d.comparison import Comparison
from scan3d.geometry.convexity import HULL_OF_MESH


class Summary(NamedTuple):
    """A table of a few rows for the terminal."""

    heading: str
    """A line above the table, or an empty string."""
    rows: list[tuple[str, str]]
    """Name and value of each quantity."""


def summary(data: Mapping[str, Any]) -> Summary:
    """The most important numbers of a report."""
    counts, hausdorff, errors = data["counts"], data["hausdorff"], data["contact_error"]
    where = "space" if data.get("model") == "spatial" else f"{counts['slices']} slices"
    heading = f"{counts['contacts']} contacts of {counts['samples']} samples, {counts['sweeps']} sweeps in {where}"
    rows = _filled(data)
    of_hull = f" from the {HULL_OF_MESH}" if rows else ""
    if errors:
        error = f"{errors['max']:.3g} {errors['unit']} at most ({errors['max_rod_lengths']:.1e} rod lengths){of_hull}"
        rows.append(("contact error", error))
    unreached = data["source"].get("sweeps_out_of_reach")
    if unreached:
        rows.append(("out of reach", f"{unreached} sweeps that the rod can't make from its base line"))
    median = data["friction"]["estimated_median"]
    if median is not None:
        given = data["friction"]["set"]
        rows.append(("friction", f"{median:.4g} (median, estimated from touch{f'; set: {given}' if given else ''})"))
    if counts["light"]:
        rows.append(("light touches", f"{counts['light']} contacts left out, whose place the noise hides"))
    radius = data.get("rod", {}).get("radius", {})
    if radius.get("moved"):
        unit = radius["unit"]
        left = max(radius["left"] or 0.0, radius["left_unknown"] or 0.0)
        moved = f"contacts moved by {radius['moved']:.3g} {unit} from the rod's centre line"
        rows.append(("rod's radius", f"{moved}, which leaves errors up to {left:.1g} {unit}"))
    rows += calibration_rows(data)
    surface = data["surface"]
    closed = "watertight" if surface["watertight"] else "not watertight"
    rows.append(("surface", f"{surface['method']}, {surface['faces']} faces, {closed}"))
    if hausdorff:
        to_hull = f" to the {HULL_OF_MESH}" if of_hull else ""
        rows.append(("Hausdorff distance", _distance(hausdorff, hausdorff["unit"]) + to_hull))
        if hausdorff.get("mesh_itself"):
            rows.append(("to the mesh itself", _distance(hausdorff["mesh_itself"], hausdorff["unit"])))
    volume = next((known for known in data.get("measurands", ()) if known["quantity"] == "volume"), None)
    if volume and None not in volume["interval"] and np.isfinite(volume["interval"]).all() and not data["warnings"]:
        low, high = volume["interval"]
        rows.append(("volume", f"{volume['value']:.4g} {volume['unit']}, certified between {low:.4g} and {high:.4g}"))
    certified = data["certificate"]
    if data["warnings"]:
        rows.append(("certified", "nothing, because the recording contradicts the model: see the warnings"))
    elif certified["bound"] is not None and np.isfinite(certified["bound"]):
        bound = f"{certified['bound']:.4g} {certified['unit']} ({certified['relative']:.1e} of the diagonal)"
        confidence = f" with {100 * certified['confidence']:g} % confidence" if certified["confidence"] < 1 else ""
        table = certified.get("table")
        on_table = "" if table is None else f", and the table at z = {table:.4g} {certified['unit']}"
        rows.append(("certified", f"within {bound}, from touch alone{on_table}{confidence}"))
    else:
        nothing = "nothing, because no contact bounds the body on some side of it"
        hint = "" if certified.get("table") is not None else "; if it stands on a table, state the height by --table"
        count = data["counts"].get("unproven_slices", 0)
        unproven = f"; {count} slices without contact prove no end, because their sweeps miss places that it may reach"
        rows.append(("certified", nothing + (unproven if count else "") + hint))
    return Summary(heading, rows)


def _distance(part: Mapping[str, Any], unit: str) -> str:
    return f"{part['two_sided']:.4g} {unit} ({part['relative']:.1e} of the diagonal)"


def _filled(data: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The row on what was scanned in the place of a mesh that is not convex, and what that fills; none for a convex mesh."""
    mesh = data.get("mesh") or {}
    filled = mesh.get("filled")
    if not filled:
        return []
    volume = filled["volume_relative"]
    dents = f", which fills dents up to {filled['depth']:.3g} {mesh['unit']} deep" if filled["depth"] else ""
    part = "" if volume is None else f", {100 * volume:.2g} % of its volume"
    closes = "; the mesh is open" if filled["open"] else ""
    return [("scanned", f"the {HULL_OF_MESH}{dents}{part}{closes}")]


def comparison_summary(comparison: Comparison, unit: str) -> Summary:
    """The comparison of two meshes, whose lengths are in `unit`."""
    exact = (
        "exact" if comparison.exact else f"certified between {comparison.lower:.6g} and {comparison.upper:.6g} {unit}"
    )
    where = ", ".join(f"{x:.6g}" for x in comparison.worst_point)
    averages = f"{comparison.mean:.4g}, {comparison.rms:.4g}, {comparison.p95:.4g} {unit}"
    normals = f"{comparison.normal_median_deg:.3g}° median, {comparison.normal_p95_deg:.3g}° at 95 %"
    return Summary(
        "",
        [
            (
                "Hausdorff distance",
                f"{comparison.hausdorff:.6g} {unit} ({comparison.relative:.3e} of B's diagonal; {exact})",
            ),
            ("A to B", f"{comparison.surface_to_mesh:.6g} {unit}"),
            ("B to A", f"{comparison.mesh_to_surface:.6g} {unit}"),
            ("worst at", f"({where}), on {'A' if comparison.worst_on == 'surface' else 'B'}"),
            ("mean, RMS, 95 %", averages),
            ("Chamfer, F-score", f"{comparison.chamfer:.4g} {unit}, {comparison.f_score:.4f} at 1 % of B's diagonal"),
            ("normals", normals),
            ("volume error", f"{comparison.volume_error:+.3e}"),
        ],
    )
