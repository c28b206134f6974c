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
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scan3d.arrays import Array, ranges, weighted_quantiles
from scan3d.choices import COLORS
from scan3d.errors import InputError
from scan3d.pictures import parts
from scan3d.pictures.figures import own_style
from scan3d.pictures.parts import Scene
from scan3d.recording import Recording
from scan3d.units import FORCES, MOMENTS, UNITS, UNITS_M, reaction_unit, unit_symbol


def page(scene: Scene) -> bytes:
    """The page (HTML, UTF-8) of a scene: its layers, colours by values with scales and histograms, a player of its sweeps.

    The same scene gives the same bytes.  Raises InputError for a scene without anything to show, and for contacts that do not
    come from its recording.
    """
    scene = scene.in_shown_unit()
    return page_of(scene, page_data(scene))


def page_data(scene: Scene, center: Array | None = None) -> dict[str, Any]:
    """What the page shows of a scene, as it stands in the page: layers and player, in coordinates about the `center` (3,).

    By default that is the middle of the scene.  Raises InputError as `page`.
    """
    corners = scene.corners
    if not len(corners):
        raise InputError(f"{scene.name} has nothing to show: neither contacts nor a surface")
    center = (corners.min(axis=0) + corners.max(axis=0)) / 2 if center is None else center
    with own_style():
        layers = list(_layers(scene, center))
    data: dict[str, Any] = {
        "name": scene.name,
        "unit": unit_symbol(scene.unit),
        "units": [[symbol, size / UNITS_M[scene.unit]] for symbol, size in _units(scene.unit)],
        "center": center.tolist(),
        "radius": float(np.linalg.norm(corners - center, axis=1).max()) or 1.0,
        "layers": layers,
    }
    if parts.has_rods(scene):
        data["player"] = player(scene, center)
    return data


def as_json(data: dict[str, Any]) -> str:
    """What a page shows, as the text that it reads."""
    return json.dumps(data, ensure_ascii=False, allow_nan=False, separators=(",", ":"))


def page_of(scene: Scene, data: dict[str, Any]) -> bytes:
    """The page of a scene whose data are known; where they say that it is `live`, it asks for them again and again."""
    # sentences are shown when they are asked for
    heading = [row for row in scene.key_figures if row[0] == "scan"]
    premises = [row for row in scene.key_figures if row[0] in ("assumed", "tested")]
    headline = "".join(html.escape(sentence) for _, sentence in heading)
    shown = _table([row for row in scene.key_figures if row not in (*heading, *premises)])
    if premises:
        shown += f"<details><summary>what this assumes</summary>{_table(premises)}</details>"
    # "</script>" within the data would end the script element that contains them
    text = as_json(data).replace("<", "\\u003c")
    # one script, whose parts see each other's names, in the order in which they run
    names = ["view", "layers", "player", "tools", "main", *(["live"] if data.get("live") else [])]
    parts_of_script = (_part(f"page_{name}.js") for name in names)
    script = '"use strict";\n' + "".join(parts_of_script)
    # the browser runs the script with this hash and no other
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    filled = {
        "NAME": html.escape(scene.name),
        "HEADLINE": headline,
        "KEYFIGURES": shown,
        "DATA": text,
        "STYLE": _part("page.css"),
        "CONNECT": "; connect-src 'self'" if data.get("live") else "",
    }
    filled |= {"SCRIPT": script, "HASH": f"sha256-{digest}"}
    # in one pass, as what is filled in may contain the text of a placeholder
    return re.sub("@([A-Z]+)@", lambda match: filled[match[1]], _part("page.html")).encode(errors="replace")


def _table(rows: list[tuple[str, str]]) -> str:
    cells = (f"<tr><th>{html.escape(name)}</th><td>{html.escape(value)}</td></tr>" for name, value in rows)
    return f"<table>{''.join(cells)}</table>"


def _units(unit: str) -> list[tuple[str, float]]:
    return [("in", UNITS_M["in"])] if unit == "in" else [(symbol, float(size)) for symbol, size in UNITS.items()]


def _part(name: str) -> str:
    """A file beside this module, whose lines end alike on all systems."""
    return files("scan3d.pictures").joinpath(name).read_text(encoding="utf-8")


def _array(values: NDArray[Any], kind: str = "f4") -> dict[str, str]:
    """Numbers as float32, too large ones as infinite, or as uint32 ("u4"): little-endian, in base64."""
    with np.errstate(over="ignore"):
        return {kind: base64.b64encode(np.ascontiguousarray(values, dtype=f"<{kind}").tobytes()).decode()}


# --- layers ---


def _layers(scene: Scene, center: Array) -> list[dict[str, Any]]:
    layers = []
    if scene.surface is not None:
        mesh, shades = parts.surface_shades(scene)
        colors = [_scale(shaded, parts.area_of_vertices(mesh)) for shaded in shades]
        layers.append(_triangles("surface", mesh, center, on=True, colors=colors))
    if scene.contacts is not None:
        layers.append(_contacts(scene, center))
    normals = parts.normal_lines(scene)
    if len(normals):
        layers.append(strips("normals", list(normals), center, parts.NORMAL, 1.0))
    name, lines = parts.sections(scene)
    if lines:
        layers.append(strips(name, [line for line, _ in lines], center, parts.INK, 1.2))
    if scene.truth is not None:
        layers.append(_triangles(scene.reference, scene.truth, center, color=parts.TIP, alpha=0.45))
    return layers


def _triangles(name: str, mesh: Any, center: Array, **options: Any) -> dict[str, Any]:
    return {
        "name": name,
        "kind": "triangles",
        "points": _array(np.asarray(mesh.vertices) - center),
        "faces": _array(np.asarray(mesh.faces), "u4"),
        "color": parts.BODY,
        **options,
    }


def _contacts(scene: Scene, center: Array) -> dict[str, Any]:
    names, alike = {name: scene.column(name) for name in ("sweep", "slice")}, np.ones(len(scene.points))
    known = [color for color in COLORS if scene.column(color) is not None]
    return {
        "name": "contacts",
        "kind": "points",
        "on": True,
        "points": _array(scene.points - center),
        "colors": [_scale(parts.shade_contacts(scene, color, parts.ON_DEVIATION), alike) for color in known],
        "columns": {name: values.astype(int).tolist() for name, values in names.items() if values is not None},
        "color": parts.ON_DEVIATION[0],
    }


def strips(name: str, lines: list[Array], center: Array, color: str, width: float) -> dict[str, Any]:
    starts = np.cumsum([0, *map(len, lines)]).tolist()
    points = _array(np.concatenate(lines) - center)
    return {"name": name, "kind": "lines", "points": points, "starts": starts, "color": color, "width": width}


def _scale(shaded: parts.Shade, weights: Array) -> dict[str, Any]:
    """Values (n,) with their scale of colours, of which the page interpolates 33, or with their kinds.

    The histogram of values by their weights (n,) has 32 bins of equal length on the scale.  Half of them, and 95 %, are below
    the quantiles, in size where the scale is symmetric.
    """
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    if shaded.norm is None:
        sizes = np.bincount(shaded.values, weights, len(shaded.kinds)) / weights.sum()
        kinds = [[*kind, size] for kind, size in zip(shaded.kinds, sizes.tolist(), strict=True)]
        return {"title": shaded.title, "kinds": kinds, "values": _array(shaded.values)}
    stops = [to_hex(color) for color in colormaps[shaded.map](np.linspace(0, 1, 33))]
    known = np.isfinite(shaded.values)
    shown, counts = shaded.values[known], weights[known]
    shares = np.histogram(np.asarray(shaded.norm(shown)), 32, (0, 1), weights=counts)[0] / weights.sum()
    return {
        "title": shaded.title,
        "values": _array(shaded.values),
        "low": float(shaded.norm.vmin),
        "high": float(shaded.norm.vmax),
        "beyond": shaded.beyond,
        "log": type(shaded.norm).__name__ == "LogNorm",
        "stops": stops,
        "shares": shares.tolist(),
        "quantiles": weighted_quantiles(np.abs(shown), counts, (0.5, 0.95)).tolist(),
        "unknown": float(weights[~known].sum() / weights.sum()),
    }


# --- the player ---


class Samples(NamedTuple):
    """The samples of the player, those of a sweep one after the other."""

    rows: NDArray[np.int64]
    """(n,) rows of the recording"""
    starts: NDArray[np.int64]
    """(s,) where each sweep starts"""
    numbers: NDArray[np.int64]
    """(s,) numbers of the sweeps, ascending"""
    of_contact: NDArray[np.int64]
    """(c,) the sample that each contact comes from"""


def player(scene: Scene, center: Array) -> dict[str, Any]:
    """Poses and reactions of the samples, from which the page integrates the rod, for a scene that has rods (`has_rods`).

    Positions are relative to `center` in the scene's unit, forces and moments in those of their sizes.  Raises InputError if
    the contacts do not come from the scene's recording.
    """
    recording = scene.recording
    assert recording is not None
    samples, rod = samples_of(recording, parts.recording_rows(scene, recording)), recording.rod
    rows, spatial = samples.rows, parts.is_spatial(scene)
    force, moment = recording.wrench() if spatial else (recording.force_N, recording.moment_Nm[:, None])
    newton, force_unit = reaction_unit(float(np.abs(force[rows]).max()), FORCES)
    newton_metre, moment_unit = reaction_unit(float(np.abs(moment[rows]).max()), MOMENTS)
    force, moment = force[rows] / float(force_unit), moment[rows] / float(moment_unit)
    if spatial:
        charts = [(f"force in {newton}", ["f0x", "f0y", "f0z"]), (f"moment in {newton_metre}", ["m0x", "m0y", "m0z"])]
    else:
        charts = [(f"{name} in {newton}", [name]) for name in ("f0x", "f0y")] + [(f"m0z in {newton_metre}", ["m0z"])]
    # the samples from which on the clamp has another orientation
    differs = np.diff(recording.quaternion[rows], axis=0) != 0
    turned = np.flatnonzero(np.concatenate([[True], differs.any(axis=1)]))
    axes, position = recording.axes()[rows], recording.position_m[rows] / UNITS_M[scene.unit]
    # the way of the clamp against its x axis, or in probings along its y axis, since the first sample of the sweep, and the
    # sizes of force and moment
    first = np.repeat(samples.starts, np.diff([*samples.starts, len(rows)]))
    along = np.where(recording.in_probings[rows][first, None], axes[first, 1], -axes[first, 0])
    travel = np.einsum("ni,ni->n", position - position[first], along)
    sizes = np.column_stack([np.linalg.norm(force, axis=1), np.linalg.norm(moment, axis=1)])
    shown = int(np.flatnonzero(samples.numbers == parts.most_informative_sweep(scene))[0])
    data: dict[str, Any] = {
        "numbers": samples.numbers.tolist(),
        "starts": samples.starts.tolist(),
        "shown": shown,
        "toward": (parts.SWEEP_DIRECTION @ axes[samples.starts[shown]]).tolist(),
        "position": _array(position - center),
        "turned": _array(turned, "u4"),
        "turns": _array(axes[turned]),
        "reactions": _array(np.column_stack([force, moment])),
        "travel": _array(travel),
        "largest": np.maximum.reduceat(sizes, samples.starts).tolist(),
        "labels": [{"title": title, "names": names} for title, names in charts],
        "contact": _array(samples.of_contact, "u4"),
        "length": recording.rod.length_m / UNITS_M[scene.unit],
        "rod": _rod(recording)
        | {"units": [rod.force_unit_N / float(force_unit), rod.moment_unit_Nm / float(moment_unit)]},
        "colors": {"rod": parts.ROD, "force": parts.FORCE, "selected": parts.SELECTED, "curves": parts.REACTION_COLORS},
    }
    if spatial or rod.weight_N:  # others are bent by their reactions as they are
        data["held"] = _array(np.hstack(parts.at_clamp(recording, rows, spatial, samples.of_contact)))
    return data


def _rod(recording: Recording) -> dict[str, Any]:
    """The rod in rod lengths: diameters and weights past the ends of equal parts, curvature about the clamp's z, x and y."""
    rod = recording.rod.in_space()
    ends = np.linspace(0.0, 1.0, 129)
    return {
        "diameters": rod.profile.diameter(ends).tolist(),
        "weights": rod.profile.weight_past(ends).tolist(),
        "curvature": rod.curvature,
        "torsion": rod.torsion,
        "compliance": rod.compliance,
        "gravity": recording.gravity.direction if rod.profile.weight and recording.gravity else None,
    }


def samples_of(recording: Recording, rows: NDArray[np.int64]) -> Samples:
    """The samples of all sweeps with contacts, `rows` (c,) being those of the contacts in the recording.

    Of the samples in the air, those before the first and after the last contact are shown, as many as a quarter of those
    between the two: the rod comes and leaves, and the page of a log that is mostly air is not large.
    """
    order = np.argsort(recording.sweep, kind="stable")
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    numbers, group = np.unique(recording.sweep[rows], return_inverse=True)
    first = np.full(len(numbers), len(order))
    last = np.full(len(numbers), -1)
    np.minimum.at(first, group, place[rows])
    np.maximum.at(last, group, place[rows])
    air = np.ceil((last - first + 1) / 4).astype(np.int64)
    ordered = recording.sweep[order]
    begin = np.maximum(first - air, np.searchsorted(ordered, numbers, "left"))
    end = np.minimum(last + air + 1, np.searchsorted(ordered, numbers, "right"))
    lengths = end - begin
    starts, (sweep, after) = np.cumsum(lengths) - lengths, ranges(lengths)
    return Samples(order[begin[sweep] + after], starts, numbers, (starts - begin)[group] + place[rows])
