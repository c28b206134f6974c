"""A page that shows a scan in any browser: one file, which needs WebGL 2 and no access to the network.

`page.html` beside this module is the page without a scan: ``@NAME@``, ``@KEYFIGURES@`` and ``@DATA@`` are filled in here.
"""

from __future__ import annotations

import base64
import html
import json
import re
from importlib.resources import files
from typing import Any

import numpy as np

import planar
from scan3d.arrays import Array
from scan3d.choices import COLORS
from scan3d.errors import InputError
from scan3d.pictures.figures import quiet
from scan3d.pictures.parts import evenly_chosen, has_rods, normal_lines, sections, shown_surface, shown_sweep
from scan3d.pictures.scene import Scene
from scan3d.pictures.shading import (
    BODY,
    INK,
    NORMAL,
    ROD,
    TANGENTIAL,
    TIP,
    largest_known,
    shade_contacts,
)
from scan3d.pictures.words import out_of_plane_deg, unit_symbol

# Colours of a scale in the page, which interpolates between them: the difference to the exact scale is not visible.
_STOPS = 33
# Rods drawn along a sweep, as in the window, and points on each: no corners are seen, and the page stays small.
_STATES, _ROD_POINTS = 9, 40
# Opacity of the truth: the surface is seen through it.
_TRUTH_OPACITY = 0.45


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
        "unit": unit_symbol(scene.unit),
        "center": center.tolist(),
        "radius": float(np.linalg.norm(corners - center, axis=1).max()) or 1.0,
        "layers": layers,
    }
    rows = "".join(
        f"<tr><th>{html.escape(name)}</th><td>{html.escape(value)}</td></tr>" for name, value in scene.key_figures
    )
    # "</script>" within the data would end the script element that contains them
    text = json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    filled = {"NAME": html.escape(scene.name), "KEYFIGURES": rows, "DATA": text}
    # in one pass, as what is filled in may contain the text of a placeholder
    blank = files("scan3d.pictures").joinpath("page.html").read_text(encoding="utf-8")
    return re.sub("@([A-Z]+)@", lambda match: filled[match[1]], blank).encode(errors="replace")


def _layers(scene: Scene, center: Array) -> list[dict[str, Any] | None]:
    """The layers in the order in which they are drawn, None for those that the scene does not have."""
    return [_surface(scene, center), _contacts(scene, center), *_lines(scene, center), _truth(scene, center)]


def _surface(scene: Scene, center: Array) -> dict[str, Any] | None:
    if scene.surface is None:
        return None
    mesh, deviation, bound = shown_surface(scene)
    colors = []
    if deviation is not None:
        largest = float(np.abs(deviation).max()) or 1.0
        colors.append(_scale(scene.deviation_title, deviation, -largest, largest, "RdBu_r"))
    if bound is not None and scene.bound is not None:
        largest = largest_known(scene.bound) or 1.0
        colors.append(_scale(f"certified bound in {scene.unit}", bound, 0.0, largest, "YlGnBu"))
    return _triangles("surface", mesh, center, on=True, colors=colors)


def _truth(scene: Scene, center: Array) -> dict[str, Any] | None:
    if scene.truth is None:
        return None
    return _triangles(scene.truth_name, scene.truth, center, color=TIP, alpha=_TRUTH_OPACITY)


def _triangles(name: str, mesh: Any, center: Array, **options: Any) -> dict[str, Any]:
    corners = np.asarray(mesh.vertices) - center
    return {
        "name": name,
        "kind": "triangles",
        "position": _floats(corners),
        "index": base64.b64encode(np.asarray(mesh.faces).astype("<u4").tobytes()).decode(),
        "color": BODY,
        **options,
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
            colors.append(
                {"title": "kind of contact", "kinds": kinds, "values": _floats(planar.Phase.TANGENTIAL - values)}
            )
        else:
            shown = values * 1e3 if color == "force" else out_of_plane_deg(values) if color == "bending" else values
            log = type(shaded.norm).__name__ == "LogNorm"
            low, high = float(shaded.norm.vmin), float(shaded.norm.vmax)
            colors.append(_scale(shaded.title, shown, low, high, shaded.map, log=log))
    names = {name: scene.column(name) for name in ("sweep", "slice")}
    columns = {name: values.astype(int).tolist() for name, values in names.items() if values is not None}
    position = _floats(scene.points - center)
    return {"name": "contacts", "kind": "points", "on": True, "position": position, "colors": colors, "columns": columns,
            "color": TANGENTIAL}  # fmt: skip


def _lines(scene: Scene, center: Array) -> list[dict[str, Any] | None]:
    """Normals, slices or paths of contacts, and the rod along one sweep, where they are known."""
    layers: list[dict[str, Any] | None] = []
    normals = normal_lines(scene)
    if len(normals):
        layers.append(_strips("normals", list(normals), center, NORMAL, 1.0))
    name, lines = sections(scene)
    if lines:
        layers.append(_strips(name, [line for line, _ in lines], center, INK, 1.2))
    if has_rods(scene):
        sweep = shown_sweep(scene, points=_ROD_POINTS)
        rods = sweep.rods[evenly_chosen(len(sweep.base), _STATES)]
        layers.append(_strips("rod in one sweep", [*rods, sweep.base[[0, -1]]], center, ROD, 3.0))
    return layers


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
    with np.errstate(over="ignore"):  # what is too large for float32 is drawn as infinite
        return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode()
