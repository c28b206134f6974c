"""Colours: of bodies, rods and contacts, and of values by a scale."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import planar
from scan3d.arrays import Array
from scan3d.choices import COLORS
from scan3d.errors import InputError
from scan3d.pictures.parts import shown_surface
from scan3d.pictures.scene import Scene

BODY, INK, ROD, TIP, TANGENTIAL = "#c3ccd6", "#222222", "#1b6ca8", "#d98200", "#b2182b"
UNKNOWN, NORMAL, SLICE = "#9a9a9a", "#6b6b6b", "#5b6672"
# Errors are shown over so many powers of ten at most.
_DECADES = 4.0


class Shade(NamedTuple):
    """Colours of some values and their scale."""

    rgb: NDArray[np.uint8]
    """(n, 3)"""
    title: str
    map: str
    norm: Any
    """A matplotlib norm; None for kinds of contact."""


def shade(values: Array, title: str, low: float, high: float, *, map: str = "viridis", log: bool = False) -> Shade:
    """Colours of values (n,), those that are no numbers grey."""
    import matplotlib
    from matplotlib.colors import LogNorm, Normalize, to_rgb

    norm = LogNorm(low, high, clip=True) if log else Normalize(low, high, clip=True)
    known = np.isfinite(values)
    rgb = np.tile(np.array(to_rgb(UNKNOWN)), (len(values), 1))
    rgb[known] = matplotlib.colormaps[map](norm(values[known]))[:, :3]
    return Shade((255 * rgb + 0.5).astype(np.uint8), title, map, norm)


def shade_contacts(scene: Scene, color: str) -> Shade:
    """Colours of the contacts.  Raises InputError for an unknown colour, or one of which the scene knows nothing."""
    if color not in COLORS:
        raise InputError(f"contacts are coloured by {', '.join(COLORS)}, got {color!r}")
    values = scene.column(color)
    if values is None:
        known = [name for name in COLORS if scene.column(name) is not None]
        others = f"known are {', '.join(known)}" if known else "its file has points only"
        raise InputError(f"{scene.name} says nothing of its contacts' {color}; {others}")
    if color == "phase":
        from matplotlib.colors import to_rgb

        pair = (255 * np.array([to_rgb(TANGENTIAL), to_rgb(TIP)]) + 0.5).astype(np.uint8)
        return Shade(pair[(values == planar.Phase.TIP).astype(int)], "contact", "", None)
    if color == "force":
        return shade(values * 1e3, "contact force in mN", 0.0, float(np.nanmax(values)) * 1e3 or 1.0)
    if color == "friction":
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
        # one coefficient everywhere is no reason to magnify rounding
        low, high = (low, high) if high - low > 1e-6 else (max(low - 0.05, 0.0), high + 0.05)
        return shade(values, "coefficient of friction", low, high)
    high = float(np.nanmax(values)) or 1.0
    return shade(values, f"distance from the truth in {scene.unit}", high * 10**-_DECADES, high, log=True)


def shade_surface(scene: Scene, view: str = "surface") -> tuple[Any, Shade | None]:
    """The surface and the colours of its vertices: the deviation from the truth, or the bound; None if neither is known.

    A body with few vertices, such as a cube, may show one bound everywhere: it is kept for vertices only, and each has the
    largest of the facets around it.
    """
    if scene.surface is None:
        raise InputError(f"{scene.name} has no surface to show; it has a cloud: give the view cloud")
    if view != "bound" and scene.truth is not None:
        mesh, off, _ = shown_surface(scene)
        assert off is not None
        most = float(np.abs(off).max()) or 1.0
        return mesh, shade(off, f"signed deviation in {scene.unit}", -most, most, map="RdBu_r")
    if scene.bound is not None and np.isfinite(scene.bound).any():
        mesh, _, bound = shown_surface(scene)
        assert bound is not None
        title = f"certified bound in {scene.unit}"
        return mesh, shade(bound, title, 0.0, float(np.nanmax(scene.bound)) or 1.0, map="YlGnBu")
    if view == "bound":
        raise InputError(
            f"the bound of {scene.name} is not known; show a scan's folder, its surface.ply, or a recording"
        )
    return scene.surface, None
