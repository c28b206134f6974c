"""Colours of bodies, rods and contacts, and colours of values by a scale."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import planar
from scan3d.arrays import Array
from scan3d.choices import COLORS
from scan3d.errors import InputError
from scan3d.numbers import unit_for
from scan3d.pictures.parts import shown_surface
from scan3d.pictures.scene import Scene, out_of_plane_deg
from scan3d.units import UNITS_M

# A pale body, on which contacts and rods of saturated colours stand out.  Red and orange differ in lightness, so that readers
# with deficient colour vision can distinguish them.
BODY, INK, ROD, TIP, TANGENTIAL = "#c3ccd6", "#222222", "#1b6ca8", "#d98200", "#b2182b"
# Tangential and tip contacts on a surface that is coloured from blue over white to red, from which black and yellow stand out.
ON_DEVIATION = "#161616", "#ffd60a"
# Reactions of the rod, the contacts of the sweep that is shown, and the curves of components along x, y and z.
FORCE, SELECTED, REACTION_COLORS = "#8e24aa", "#00c853", (ROD, TIP, TANGENTIAL)
UNKNOWN, NORMAL, SLICE, EDGE, BACKDROP, BOUND = "#9a9a9a", "#6b6b6b", "#5b6672", "#4a4f55", "#eef0f3", "#3f9e8f"


class Shade(NamedTuple):
    """Values and their colours by a scale."""

    values: Array
    """(n,) in the unit of the title"""
    rgb: NDArray[np.uint8]
    """(n, 3)"""
    title: str
    map: str
    norm: Any
    """A matplotlib norm; None for kinds of contact."""


def largest_known(values: Array) -> float:
    """The largest finite value; 0 if there is none."""
    known = values[np.isfinite(values)]
    return float(known.max()) if len(known) else 0.0


def shade(values: Array, title: str, low: float, high: float, *, map: str = "viridis", log: bool = False) -> Shade:
    """Colours of values (n,) on a scale from `low` to `high`; values that are not finite are grey."""
    import matplotlib
    from matplotlib.colors import LogNorm, Normalize, to_rgb

    norm = LogNorm(low, high, clip=True) if log else Normalize(low, high, clip=True)
    known = np.isfinite(values)
    rgb = np.tile(np.array(to_rgb(UNKNOWN)), (len(values), 1))
    rgb[known] = matplotlib.colormaps[map](norm(values[known]))[:, :3]
    return Shade(values, (255 * rgb + 0.5).astype(np.uint8), title, map, norm)


def shade_contacts(scene: Scene, color: str) -> Shade:
    """Colours of the contacts.  Raises InputError unless `color` is one of `COLORS` and the scene has its values."""
    if color not in COLORS:
        raise InputError(f"contacts are coloured by {', '.join(COLORS)}, got {color!r}")
    values = scene.column(color)
    if values is None:
        known = [name for name in COLORS if scene.column(name) is not None]
        others = f"known are {', '.join(known)}" if known else "its file has points only"
        raise InputError(f"the {color} of the contacts of {scene.name} is not known; {others}")
    if color == "phase":
        from matplotlib.colors import to_rgb

        pair = (255 * np.array([to_rgb(TANGENTIAL), to_rgb(TIP)]) + 0.5).astype(np.uint8)
        return Shade(values, pair[(values == planar.Phase.TIP).astype(int)], "contact", "", None)
    if color == "force":
        return shade(values * 1e3, "contact force in mN", 0.0, largest_known(values) * 1e3 or 1.0)
    if color == "friction":
        low, high = -largest_known(-values), largest_known(values)
        if high - low <= 1e-6:  # one value, but for rounding: in the middle of a scale
            low, high = max(low - 0.05, 0.0), high + 0.05
        return shade(values, "coefficient of friction", low, high)
    if color == "bending":
        angle = out_of_plane_deg(values)
        largest = max(largest_known(np.abs(angle)), 1.0)  # smaller angles are rounding
        # diverging, with a middle that is grey enough to be seen on a white page
        return shade(angle, "bending out of the sweep's plane in °", -largest, largest, map="coolwarm")
    values, unit = shown_lengths(values, scene.unit)
    high = max(largest_known(values), 1.0 if unit == "nm" else 0.0)
    return shade(values, f"distance from the {scene.truth_name} in {unit}", high * 1e-4, high, log=True)


def shown_lengths(values: Array, unit: str) -> tuple[Array, str]:
    """Lengths (n,) in the unit in which the largest of them is written, nm if that is below a nanometre, and that unit."""
    symbol, size = unit_for(max(largest_known(np.abs(values)), 1.001e-9 / UNITS_M[unit]), unit)
    return values * (UNITS_M[unit] / float(size)), symbol


def surface_shades(scene: Scene) -> tuple[Any, list[Shade]]:
    """The surface, and the colours of its vertices by the deviation from the truth and by the bound, of those that are known.

    A body with few vertices, such as a cube, may show one bound everywhere: bounds are known at vertices only, and that of a
    vertex is the largest of the facets around it.
    """
    mesh, deviation, bound = shown_surface(scene)
    shades = []
    if deviation is not None:
        values, unit = shown_lengths(deviation, scene.unit)
        # a body that was found exactly, to a nanometre, is not shown in the colours of a large deviation
        largest = max(float(np.abs(values).max()), 1.0 if unit == "nm" else 0.0)
        shades.append(shade(values, f"{scene.deviation_title} in {unit}", -largest, largest, map="RdBu_r"))
    if scene.bound is not None and bound is not None and np.isfinite(bound).any():
        values, unit = shown_lengths(bound, scene.unit)
        shades.append(shade(values, f"{scene.bound_title} in {unit}", 0.0, largest_known(values) or 1.0, map="YlGnBu"))
    return mesh, shades


def shade_surface(scene: Scene, view: str = "surface") -> tuple[Any, Shade | None]:
    """The surface and the colours of its vertices by the deviation from the truth, or by the bound; None if neither is known.

    Raises InputError without a surface, and for the view "bound" without bounds.
    """
    if scene.surface is None:
        raise InputError(f"{scene.name} has no surface to show; it has a cloud: give the view cloud")
    mesh, shades = surface_shades(scene)
    if view != "bound":
        return mesh, shades[0] if shades else None
    if scene.bound is None or not np.isfinite(scene.bound).any():
        raise InputError(
            f"the bound of {scene.name} is not known; show a scan's folder, its surface.ply, or a recording"
        )
    return mesh, shades[-1]
