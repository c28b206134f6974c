"""A page that shows a scan in any browser: one file, which needs WebGL 2 and no access to the network.

`page.html` beside this module is the page without a scan: ``@NAME@``, ``@KEYFIGURES@`` and the like are filled in here, and so
are the style and the scripts, `page.css` and `page_*.js`.
"""

from __future__ import annotations

import base64
import hashlib
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
from scan3d.pictures.encoding import floats, integers
from scan3d.pictures.figures import quiet
from scan3d.pictures.parts import has_rods, normal_lines, sections, shown_surface
from scan3d.pictures.player import player
from scan3d.pictures.scene import Scene
from scan3d.pictures.shading import (
    BODY,
    INK,
    NORMAL,
    ON_DEVIATION,
    TIP,
    deviation_limit,
    largest_known,
    shade_contacts,
)
from scan3d.pictures.words import out_of_plane_deg, unit_symbol

# Colours of a scale in the page, which interpolates between them: the difference to the exact scale is not visible.
_STOPS = 33
# The scripts in the order in which they run: one script, whose parts see each other's names.
_SCRIPTS = ("view", "layers", "rod", "player", "tools", "main")
# Opacity of the truth: the surface is seen through it.
_TRUTH_OPACITY = 0.45


def page(scene: Scene) -> bytes:
    """The page (HTML, UTF-8) of a scene: its layers, colours by values with scales and histograms, a player of its sweeps.

    The same scene gives the same bytes.  Raises InputError for a scene without anything to show, and for contacts that do not
    come from its recording.
    """
    if not len(scene.corners):
        raise InputError(f"{scene.name} has nothing to show: neither contacts nor a surface")
    corners = scene.corners
    center = (corners.min(axis=0) + corners.max(axis=0)) / 2
    with quiet():
        layers = [layer for layer in _layers(scene, center) if layer is not None]
    data: dict[str, Any] = {
        "name": scene.name,
        "unit": unit_symbol(scene.unit),
        "center": center.tolist(),
        "radius": float(np.linalg.norm(corners - center, axis=1).max()) or 1.0,
        "layers": layers,
    }
    if has_rods(scene):
        data["player"] = player(scene, center)
    rows = "".join(
        f"<tr><th>{html.escape(name)}</th><td>{html.escape(value)}</td></tr>" for name, value in scene.key_figures
    )
    # "</script>" within the data would end the script element that contains them
    text = json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    script = '"use strict";\n' + "".join(_part(f"page_{name}.js") for name in _SCRIPTS)
    # the browser runs the script with this hash and no other
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    filled = {"NAME": html.escape(scene.name), "KEYFIGURES": rows, "DATA": text, "STYLE": _part("page.css")}
    filled |= {"SCRIPT": script, "HASH": f"sha256-{digest}"}
    # in one pass, as what is filled in may contain the text of a placeholder
    return re.sub("@([A-Z]+)@", lambda match: filled[match[1]], _part("page.html")).encode(errors="replace")


def _part(name: str) -> str:
    """A file beside this module, whose lines end alike on all systems."""
    return files("scan3d.pictures").joinpath(name).read_text(encoding="utf-8")


def _layers(scene: Scene, center: Array) -> list[dict[str, Any] | None]:
    """The layers in the order in which they are drawn, None for those that the scene does not have."""
    return [_surface(scene, center), _contacts(scene, center), *_lines(scene, center), _truth(scene, center)]


def _surface(scene: Scene, center: Array) -> dict[str, Any] | None:
    if scene.surface is None:
        return None
    mesh, deviation, bound = shown_surface(scene)
    colors = []
    if deviation is not None:
        largest = deviation_limit(scene, deviation)
        colors.append(_scale(scene.deviation_title, deviation, -largest, largest, "RdBu_r"))
    if bound is not None and scene.bound is not None:
        largest = largest_known(scene.bound) or 1.0
        colors.append(_scale(f"certified bound in {scene.unit}", bound, 0.0, largest, "YlGnBu"))
    return _triangles("surface", mesh, center, on=True, colors=colors)


def _truth(scene: Scene, center: Array) -> dict[str, Any] | None:
    if scene.truth is None:
        return None
    return _triangles(scene.reference, scene.truth, center, color=TIP, alpha=_TRUTH_OPACITY)


def _triangles(name: str, mesh: Any, center: Array, **options: Any) -> dict[str, Any]:
    corners = np.asarray(mesh.vertices) - center
    return {
        "name": name,
        "kind": "triangles",
        "position": floats(corners),
        "index": integers(np.asarray(mesh.faces)),
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
            kinds = [[name, color] for name, color in zip(("tangential", "tip"), ON_DEVIATION, strict=True)]
            colors.append(
                {"title": "kind of contact", "kinds": kinds, "values": floats(planar.Phase.TANGENTIAL - values)}
            )
        else:
            shown = values * 1e3 if color == "force" else out_of_plane_deg(values) if color == "bending" else values
            log = type(shaded.norm).__name__ == "LogNorm"
            low, high = float(shaded.norm.vmin), float(shaded.norm.vmax)
            colors.append(_scale(shaded.title, shown, low, high, shaded.map, log=log))
    names = {name: scene.column(name) for name in ("sweep", "slice")}
    columns = {name: values.astype(int).tolist() for name, values in names.items() if values is not None}
    position = floats(scene.points - center)
    return {"name": "contacts", "kind": "points", "on": True, "position": position, "colors": colors, "columns": columns,
            "color": ON_DEVIATION[0]}  # fmt: skip


def _lines(scene: Scene, center: Array) -> list[dict[str, Any] | None]:
    """Normals, and slices or paths of contacts, where they are known."""
    layers: list[dict[str, Any] | None] = []
    normals = normal_lines(scene)
    if len(normals):
        layers.append(_strips("normals", list(normals), center, NORMAL, 1.0))
    name, lines = sections(scene)
    if lines:
        layers.append(_strips(name, [line for line, _ in lines], center, INK, 1.2))
    return layers


def _strips(name: str, lines: list[Array], center: Array, color: str, width: float) -> dict[str, Any]:
    starts = np.cumsum([0, *map(len, lines)]).tolist()
    points = floats(np.concatenate(lines) - center)
    return {"name": name, "kind": "lines", "position": points, "starts": starts, "color": color, "width": width}


def _scale(title: str, values: Array, low: float, high: float, map: str, *, log: bool = False) -> dict[str, Any]:
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    stops = [to_hex(color) for color in colormaps[map](np.linspace(0, 1, _STOPS))]
    return {"title": title.replace(" um", " µm"), "values": floats(values), "low": low, "high": high, "log": log,
            "stops": stops}  # fmt: skip
