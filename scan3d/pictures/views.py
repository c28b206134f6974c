"""Pictures of a scan: bodies are rendered off screen by VTK; matplotlib adds colour bars, legends and labels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import planar
from scan3d.choices import VIEWS
from scan3d.errors import InputError
from scan3d.pictures.canvas import Canvas
from scan3d.pictures.figures import blank_figure, color_bar, figure_height, legend, quiet, save, show_canvas
from scan3d.pictures.parts import ShownSweep, evenly_chosen, normal_lines, sections, shown_sweep, sweep_direction
from scan3d.pictures.rendering import need_renderer
from scan3d.pictures.scene import Scene
from scan3d.pictures.shading import BODY, INK, NORMAL, ROD, SLICE, TANGENTIAL, TIP, shade_contacts, shade_surface

PICTURES = (".png", ".pdf")
# Rods drawn along a sweep: fewer show less of how the rod bends, more would merge.
_STATES = 7
# Fractions of a figure's width: a picture beside a colour bar, beside a legend, and one of two beside a colour bar.
_BESIDE_BAR, _BESIDE_LEGEND, _HALF = 0.78, 0.70, 0.40
# Inches below the picture of a sweep for its legend, and above two pictures for their titles.
_LEGEND_HEIGHT, _TITLE_HEIGHT = 0.7, 0.3
# Radius of the outline of a sweep's slice as a fraction of the size: more than that of a rod, which distinguishes the two.
_OUTLINE_RADIUS = 0.004
# The base line is drawn longer by this fraction of its length at each end, so that its arrow is clear of the clamps.
_BASE_LINE_MARGIN = 0.12
# Diameter of a contact in pixels: neighbours in a slice merge, contacts of neighbouring slices do not.
_CONTACT_SIZE = 7


def check_path(path: str | Path) -> Path:
    """The path of a picture.  Raises InputError for an ending other than those in `PICTURES`."""
    path = Path(path)
    if path.suffix.lower() not in PICTURES:
        raise InputError(f"a picture is written as {' or '.join(PICTURES)}, got {path.name!r}")
    return path


def picture(scene: Scene, path: str | Path, view: str = "cloud", color: str = "force") -> None:
    """Draw a view (of `VIEWS`) of the scene into a .png or a .pdf 7 inches wide; contacts have `color` (of `COLORS`).

    Raises InputError if the scene lacks what the view shows, or where nothing can be rendered.
    """
    path = check_path(path)
    with quiet():
        save(figure(scene, view, color), path)


def figure(scene: Scene, view: str = "cloud", color: str = "force") -> Any:
    """The matplotlib figure that `picture` writes.  Raises InputError as `picture` does."""
    if view not in VIEWS:
        raise InputError(f"view must be one of {', '.join(VIEWS)}, got {view!r}")
    need_renderer()
    return {"cloud": _cloud, "compare": _compare, "explain": _explain}.get(view, _surface)(scene, view, color)


def _cloud(scene: Scene, view: str, color: str) -> Any:
    if scene.contacts is None:
        raise InputError(f"{scene.name} has no contacts to show; it has a surface: give the view surface")
    shaded = shade_contacts(scene, color)
    canvas = Canvas(np.concatenate([scene.corners, *normal_lines(scene)]))
    canvas.add_backdrop(scene)
    canvas.add_points(scene.points, shaded.rgb, _CONTACT_SIZE)
    canvas.add_lines(normal_lines(scene), NORMAL, 1)
    width = _BESIDE_LEGEND if shaded.norm is None else _BESIDE_BAR
    figure = blank_figure(figure_height(canvas, width))
    show_canvas(figure, canvas, (0.02, 0.02, width, 0.96), scene.unit)
    if shaded.norm is None:
        entries = [("tangential contact", TANGENTIAL, "o"), ("tip contact", TIP, "o"), ("normal", NORMAL, "-")]
        legend(figure, entries, 1)
    else:
        is_tip = scene.column("phase") == planar.Phase.TIP
        color_bar(figure, shaded, unknown="tip contact" if color == "friction" and np.any(is_tip) else "")
    return figure


def _surface(scene: Scene, view: str, color: str) -> Any:
    mesh, shaded = shade_surface(scene, view)
    canvas = Canvas(scene.corners)
    canvas.add_body(mesh, BODY if shaded is None else shaded.rgb, edges=scene.surface)
    figure = blank_figure(figure_height(canvas, _BESIDE_BAR))
    show_canvas(figure, canvas, (0.02, 0.02, _BESIDE_BAR, 0.96), scene.unit)
    if shaded is not None:
        color_bar(figure, shaded)
    return figure


def _compare(scene: Scene, view: str, color: str) -> Any:
    if scene.truth is None:
        raise InputError(
            f"the true body of {scene.name} is not known, which the view compare shows: give --truth MESH (in Python truth=)"
        )
    mesh, shaded = shade_surface(scene)
    figure = blank_figure(figure_height(Canvas(scene.corners), _HALF) + _TITLE_HEIGHT)
    for k, (title, body) in enumerate(((scene.truth_name, scene.truth), ("reconstruction", mesh))):
        canvas = Canvas(scene.corners)
        if k and shaded is not None:
            canvas.add_body(body, shaded.rgb, edges=scene.surface)
        else:
            canvas.add_body(body, BODY)
        place = (0.01 + 0.41 * k, 0.02, _HALF, 0.86)
        show_canvas(figure, canvas, place, scene.unit, scaled=k == 0)
        figure.text(place[0] + place[2] / 2, 0.93, title, ha="center", va="center")
    if shaded is not None:
        color_bar(figure, shaded)
    return figure


def _explain(scene: Scene, view: str, color: str) -> Any:
    sweep = shown_sweep(scene)
    canvas = _sweep_canvas(scene, sweep)
    canvas.add_rods(sweep, evenly_chosen(len(sweep.base), _STATES))
    figure = blank_figure(figure_height(canvas, 1.0) + _LEGEND_HEIGHT)
    bottom = _LEGEND_HEIGHT / figure.get_size_inches()[1]
    show_canvas(figure, canvas, (0.0, bottom, 1.0, 1 - bottom), scene.unit)
    lines = "contact path" if sweep.slice is None else "slice"
    entries = [
        ("body", BODY, "s"),
        (f"{lines}s", SLICE, "-"),
        (f"{lines} of the sweep", INK, "-"),
        ("contact", TANGENTIAL, "o"),
        ("bent rod", ROD, "-"),
        ("clamp", INK, "s"),
        ("clamp travel", INK, "->"),
    ]
    legend(figure, entries, 4)
    return figure


def _sweep_canvas(scene: Scene, sweep: ShownSweep) -> Canvas:
    """The canvas of one sweep without its rods: body, slices and base line, seen from above the base line."""
    x, _, z = sweep.axes
    rod_points = np.concatenate([sweep.straight[:, 1], sweep.base, sweep.contact])
    margin = np.array([_BASE_LINE_MARGIN, -_BASE_LINE_MARGIN])
    base_line = sweep.base[[0, -1]] + np.outer(margin, np.linalg.norm(sweep.base[0] - sweep.base[-1]) * x)
    body = scene.truth if scene.truth is not None else scene.surface
    slice_points = sweep.contact if sweep.slice is None else scene.points[scene.column("slice") == sweep.slice]
    size = float(np.linalg.norm(np.ptp(np.concatenate([rod_points, slice_points]), axis=0)))
    # a long body is seen only as far from the slice as the rods reach
    near = scene.corners[np.abs((scene.corners - slice_points[0]) @ z) < size]
    canvas = Canvas(np.concatenate([rod_points, base_line, slice_points, near]), sweep_direction(sweep), z)
    canvas.size = size
    if body is not None:
        canvas.add_body(body, BODY)
    drawn = sweep.number if sweep.slice is None else sweep.slice
    for line, number in sections(scene)[1]:
        canvas.add_lines(line[None], SLICE, 1)
        if number == drawn:
            canvas.add_tube(line, INK, _OUTLINE_RADIUS)
    canvas.add_arrow(base_line)
    return canvas
