"""A page of its own that shows a scan in any browser: one file, no network, WebGL 2 and nothing else.

`page.html` beside this module is the page without a scan: ``@NAME@``, ``@FIGURES@`` and ``@DATA@`` are filled in here.
"""

from __future__ import annotations

import base64
import html
import json
import re
from importlib.resources import files
from typing import Any

import numpy as np

from scan3d.arrays import Array
from scan3d.choices import COLORS
from scan3d.errors import InputError
from scan3d.pictures.figures import quiet
from scan3d.pictures.parts import normal_lines, outlines, shown_surface, shown_sweep
from scan3d.pictures.scene import Scene
from scan3d.pictures.shading import (
    INK,
    NORMAL,
    ROD,
    TANGENTIAL,
    TIP,
    shade_contacts,
)

# Colours of a scale that the page gets; it interpolates between them.
_STOPS = 33
# Bent states of the rod, and points on each.
_STATES = 9
_ROD_POINTS = 40


def page(scene: Scene) -> bytes:
    """The page (HTML, UTF-8) of a scene: its layers to switch, colours by values with their scales, and its key figures.

    The same scene gives the same bytes.  Raises InputError for a scene without anything to show.
    """
    if not len(scene.corners):
        raise InputError(f"{scene.name} has nothing to show: neither contacts nor a surface")
    corners = scene.corners
    center = (corners.min(axis=0) + corners.max(axis=0)) / 2
    with quiet():
        layers = [layer for layer in _layers(scene, center) if layer is not None]
    data = {
        "unit": scene.unit.replace("um", "µm"),
        "center": center.tolist(),
        "radius": float(np.linalg.norm(corners - center, axis=1).max()) or 1.0,
        "layers": layers,
    }
    rows = "".join(
        f"<tr><th>{html.escape(what)}</th><td>{html.escape(much)}</td></tr>" for what, much in scene.key_figures
    )
    # "<" would end the script that the data stand in
    text = json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    filled = {"NAME": html.escape(scene.name), "FIGURES": rows, "DATA": text}
    # in one pass: what is filled in may look like a mark
    blank = files("scan3d.pictures").joinpath("page.html").read_text(encoding="utf-8")
    return re.sub("@([A-Z]+)@", lambda mark: filled[mark[1]], blank).encode(errors="replace")


def _layers(scene: Scene, center: Array) -> list[dict[str, Any] | None]:
    """What can be switched on and off, drawn in this order."""
    return [_surface(scene, center), _contacts(scene, center), *_lines(scene, center), _truth(scene, center)]


def _surface(scene: Scene, center: Array) -> dict[str, Any] | None:
    if scene.surface is None:
        return None
    mesh, off, bound = shown_surface(scene)
    colors = []
    if off is not None:
        most = float(np.abs(off).max()) or 1.0
        colors.append(_scale(f"signed deviation in {scene.unit}", off, -most, most, "RdBu_r"))
    if bound is not None and scene.bound is not None:
        most = float(np.nanmax(scene.bound)) or 1.0
        colors.append(_scale(f"certified bound in {scene.unit}", bound, 0.0, most, "YlGnBu"))
    return _triangles("surface", mesh, center, on=True, colors=colors)


def _truth(scene: Scene, center: Array) -> dict[str, Any] | None:
    if scene.truth is None:
        return None
    return _triangles("truth", scene.truth, center, color="#d98200", alpha=0.45)


def _triangles(name: str, mesh: Any, center: Array, **more: Any) -> dict[str, Any]:
    corners = np.asarray(mesh.vertices) - center
    return {
        "name": name,
        "kind": "triangles",
        "position": _floats(corners),
        "index": base64.b64encode(np.asarray(mesh.faces).astype("<u4").tobytes()).decode(),
        "color": "#c3ccd6",
        **more,
    }


def _contacts(scene: Scene, center: Array) -> dict[str, Any] | None:
    if scene.contacts is None:
        return None
    colors = []
    for color in COLORS:
        if scene.column(color) is None:
            continue
        shaded, values = shade_contacts(scene, color), scene.column(color)
        assert values is not None
        if shaded.norm is None:
            kinds = [["tangential", TANGENTIAL], ["tip", TIP]]
            colors.append({"title": "kind of contact", "kinds": kinds, "values": _floats(2 - values)})
        else:
            shown = values * 1e3 if color == "force" else values
            log = type(shaded.norm).__name__ == "LogNorm"
            low, high = float(shaded.norm.vmin), float(shaded.norm.vmax)
            colors.append(_scale(shaded.title, shown, low, high, shaded.map, log=log))
    names = {name: scene.column(name) for name in ("sweep", "slice")}
    columns = {name: values.astype(int).tolist() for name, values in names.items() if values is not None}
    position = _floats(scene.points - center)
    return {"name": "contacts", "kind": "points", "on": True, "position": position, "colors": colors, "columns": columns,
            "color": TANGENTIAL}  # fmt: skip


def _lines(scene: Scene, center: Array) -> list[dict[str, Any] | None]:
    """Normals, slices, and the rod along one sweep, where they are known."""
    found: list[dict[str, Any] | None] = []
    short = normal_lines(scene)
    if len(short):
        found.append(_strips("normals", list(short), center, NORMAL, 1.0))
    rings = [ring for ring, _ in outlines(scene)]
    if rings:
        found.append(_strips("slices", rings, center, INK, 1.2))
    if scene.recording is not None:
        one = shown_sweep(scene, points=_ROD_POINTS)
        states = np.unique(np.linspace(0, len(one.base) - 1, _STATES).round().astype(int))
        rods = [np.concatenate([one.curved[k], one.straight[k, 1:]]) for k in states]
        found.append(_strips("rod in one sweep", [*rods, one.base[[0, -1]]], center, ROD, 3.0))
    return found


def _strips(name: str, lines: list[Array], center: Array, color: str, width: float) -> dict[str, Any]:
    starts = np.cumsum([0, *map(len, lines)]).tolist()
    points = _floats(np.concatenate(lines) - center)
    return {"name": name, "kind": "lines", "position": points, "starts": starts, "color": color, "width": width}


def _scale(title: str, values: Array, low: float, high: float, map: str, *, log: bool = False) -> dict[str, Any]:
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    stops = [to_hex(color) for color in colormaps[map](np.linspace(0, 1, _STOPS))]
    return {"title": title.replace(" um", " µm"), "values": _floats(values), "low": low, "high": high, "log": log,
            "stops": stops}  # fmt: skip


def _floats(values: Array) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode()
