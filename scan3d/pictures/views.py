"""Pictures of a scan: bodies are rendered off screen by VTK; matplotlib adds colour bars, legends and labels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import planar
from scan3d.arrays import Array, evenly
from scan3d.choices import VIEWS
from scan3d.errors import InputError
from scan3d.pictures import figures, parts
from scan3d.pictures.canvas import DIRECTION, Canvas
from scan3d.pictures.charts import histograms, reactions
from scan3d.pictures.rendering import need_renderer
from scan3d.pictures.scene import Scene
from scan3d.pictures.sheet import CHARTS, Sheet

PICTURES = (".png", ".pdf", ".svg")
# In sizes of letters: the margin around a picture, and the room of a colour bar or a legend before it is measured.
_MARGIN, _BESIDE = 0.8, 8.0
# The line and the contacts of the sweep are moved toward the camera by this fraction of the size, so that no parts of the line
# are hidden in the body.
_FORWARD = 0.01


def check_path(path: str | Path) -> Path:
    """The path of a picture.  Raises InputError for an ending other than those in `PICTURES`."""
    path = Path(path)
    if path.suffix.lower() not in PICTURES:
        raise InputError(f"a picture is written as {', '.join(PICTURES[:-1])} or {PICTURES[-1]}, got {path.name!r}")
    return path


def picture(
    scene: Scene, path: str | Path, view: str = "cloud", color: str = "force", sheet: Sheet | None = None
) -> None:
    """Draw a view (of `VIEWS`) of the scene into a .png, .pdf or .svg; contacts have `color` (of `COLORS`).

    Without a sheet it is 7 inches wide.  Raises InputError if the scene lacks what the view shows, or where nothing can be
    rendered.
    """
    path = check_path(path)
    with figures.own_style():
        figures.save(figure(scene, view, color, sheet), path)


def figure(scene: Scene, view: str = "cloud", color: str = "force", sheet: Sheet | None = None) -> Any:
    """The matplotlib figure that `picture` writes.  Raises InputError as `picture` does."""
    sheet, scene = sheet or Sheet(), scene.in_shown_unit()
    if view not in VIEWS:
        raise InputError(f"view must be one of {', '.join(VIEWS)}, got {view!r}")
    if view in CHARTS:
        if sheet.camera is not None:
            raise InputError(f"the view {view} shows no body, so that it has no camera: leave the camera out")
        return histograms(scene, sheet) if view == "histogram" else reactions(scene, sheet)
    need_renderer()
    draw = {"cloud": _cloud, "compare": _compare, "explain": _explain}.get(view, _surface)
    return draw(scene, view, color, sheet)


def _canvas(corners: Array, sheet: Sheet, direction: Any = DIRECTION, up: Any = (0.0, 0.0, 1.0)) -> Canvas:
    if sheet.camera is not None:
        direction, up = sheet.camera.toward, sheet.camera.up
    return Canvas(corners, direction, up, scale=sheet.scale, sampling=sheet.sampling)


def _sized(canvas: Canvas, sheet: Sheet, share: float = 1.0, beside: float = _BESIDE, above: float = 0.0) -> Any:
    """A figure, in which the canvas has a share of the width that is left beside a bar or legend."""
    width = share * (sheet.width - beside * sheet.em)
    return figures.blank_figure(figures.picture_height(canvas, sheet, width, above), sheet.dpi, sheet.width)


def _place(figure: Any, sheet: Sheet, right: float, bottom: float = 0.0) -> tuple[float, float, float, float]:
    """Left, bottom, width and height in inches of the picture in a figure, of which `right` inches of the width are left."""
    margin = _MARGIN * sheet.em
    return margin, bottom + margin, right - margin, figure.get_size_inches()[1] - bottom - 2 * margin


def _cloud(scene: Scene, view: str, color: str, sheet: Sheet) -> Any:
    if scene.contacts is None:
        raise InputError(f"{scene.name} has no contacts to show; it has a surface: give the view surface")
    shaded = parts.shade_contacts(scene, color)
    normals = parts.normal_lines(scene)
    canvas = _canvas(np.concatenate([scene.corners, *normals]), sheet)
    canvas.add_backdrop(scene)
    canvas.add_points(scene.points, shaded.rgb)
    canvas.add_lines(normals, parts.NORMAL, 1)
    figure = _sized(canvas, sheet)
    if shaded.norm is None:
        entries = [(f"{name} contact".strip(), kind, "o") for name, kind in shaded.kinds]
        entries += [("normal", parts.NORMAL, "-")] if len(normals) else []
        right = figures.box_of(figure, figures.legend(figure, entries, 1, sheet.font)).x0
    else:
        is_tip = scene.column("phase") == planar.Phase.TIP
        right = figures.color_bar(
            figure, shaded, sheet, unknown="tip contact" if color == "friction" and np.any(is_tip) else ""
        )
    figures.show_canvas(figure, canvas, _place(figure, sheet, right), sheet, scene.unit)
    return figure


def _surface(scene: Scene, view: str, color: str, sheet: Sheet) -> Any:
    mesh, shaded = parts.shade_surface(scene, view)
    canvas = _canvas(scene.corners, sheet)
    canvas.add_body(mesh, parts.BODY if shaded is None else shaded.rgb, edges=scene.surface)
    figure = _sized(canvas, sheet)
    right = sheet.width - _BESIDE * sheet.em if shaded is None else figures.color_bar(figure, shaded, sheet)
    figures.show_canvas(figure, canvas, _place(figure, sheet, right), sheet, scene.unit)
    return figure


def _compare(scene: Scene, view: str, color: str, sheet: Sheet) -> Any:
    if scene.truth is None:
        raise InputError(
            f"the view compare needs the true body of {scene.name}, which is unknown or not found here as it was scanned: "
            "give --truth MESH (in Python truth=)"
        )
    mesh, shaded = parts.shade_surface(scene)
    canvases = [_canvas(scene.corners, sheet) for _ in range(2)]
    canvases[0].add_body(scene.truth, parts.BODY)
    canvases[1].add_body(mesh, parts.BODY if shaded is None else shaded.rgb, edges=scene.surface)
    title, gap = 1.8 * sheet.em, _MARGIN * sheet.em
    figure = _sized(canvases[0], sheet, 0.5, above=title)
    right = sheet.width if shaded is None else figures.color_bar(figure, shaded, sheet)
    left, bottom, width, height = _place(figure, sheet, right)
    result = "this surface" if scene.is_other else "reconstruction"
    for k, (name, canvas) in enumerate(zip((scene.reference, result), canvases, strict=True)):
        place = (left + k * (width + gap) / 2, bottom, (width - gap) / 2, height - title)
        figures.show_canvas(figure, canvas, place, sheet, scene.unit, scaled=k == 0)
        x, y = (place[0] + place[2] / 2) / sheet.width, 1 - (_MARGIN * sheet.em + title / 2) / figure.get_figheight()
        figure.text(x, y, name, ha="center", va="center", fontsize=sheet.font)
    return figure


def _explain(scene: Scene, view: str, color: str, sheet: Sheet) -> Any:
    sweep = parts.shown_sweep(scene)
    canvas = _sweep_canvas(scene, sweep, sheet)
    canvas.add_rods(sweep, evenly(np.arange(len(sweep.base)), 7), _FORWARD)
    lines = "contact path" if sweep.slice is None else "slice"
    entries = [
        ("body", parts.BODY, "s"),
        (f"{lines}s", parts.SLICE, "-"),
        (f"{lines} of the sweep", parts.INK, "-"),
        ("contact", parts.TANGENTIAL, "o"),
        ("bent rod", parts.ROD, "-"),
        ("clamp", parts.INK, "s"),
        ("clamp travel", parts.INK, "->"),
    ]
    figure = _sized(canvas, sheet, beside=0.0, above=4.2 * sheet.em)
    bottom = figures.box_of(figure, figures.legend(figure, entries, 4, sheet.font)).y1
    figures.show_canvas(
        figure, canvas, _place(figure, sheet, sheet.width - _MARGIN * sheet.em, bottom), sheet, scene.unit
    )
    return figure


def _sweep_canvas(scene: Scene, sweep: parts.ShownSweep, sheet: Sheet) -> Canvas:
    """The canvas of one sweep without its rods: body, slices and base line, seen from above the base line."""
    x, _, z = sweep.axes
    rod_points = np.concatenate([sweep.straight[:, 1], sweep.base, sweep.contact])
    margin = np.array([0.12, -0.12])  # its arrow is clear of the clamps
    base_line = sweep.base[[0, -1]] + np.outer(margin, np.linalg.norm(sweep.base[0] - sweep.base[-1]) * x)
    body = scene.truth if scene.truth is not None else scene.surface
    slice_points = sweep.contact if sweep.slice is None else scene.points[scene.column("slice") == sweep.slice]
    size = float(np.linalg.norm(np.ptp(np.concatenate([rod_points, slice_points]), axis=0)))
    # a long body is cut off where the rods do not reach
    middle, reach = slice_points[0], 0.6 * size
    if body is not None:
        body = _cut(body, middle, z, reach)
    near = scene.points[np.abs((scene.points - middle) @ z) < reach] if body is None else np.asarray(body.points)
    corners = np.concatenate([rod_points, base_line, slice_points, near])
    canvas = _canvas(corners, sheet, parts.sweep_direction(sweep), z)
    canvas.size = size
    if body is not None:
        canvas.add_body(body, parts.BODY)
    drawn = sweep.number if sweep.slice is None else sweep.slice
    lines = [(line, number) for line, number in parts.sections(scene)[1] if (np.abs((line - middle) @ z) < reach).all()]
    # paths in space cross each other: more cover the body
    for k in evenly(np.arange(len(lines)), 60 if sweep.slice is None else len(lines)):
        canvas.add_lines(lines[k][0][None], parts.SLICE, 1)
    for line, number in lines:
        if number == drawn:
            # toward the camera, because between samples it lies inside of the body
            canvas.add_tube(line + _FORWARD * size * canvas.toward, parts.INK, 0.004)
    canvas.add_arrow(base_line)
    return canvas


def _cut(body: Any, middle: Array, normal: Array, reach: float) -> Any:
    """A closed body as far as it is from a plane through a point, with faces where it is cut: a `pyvista.PolyData`."""
    import pyvista

    shape = pyvista.wrap(body)
    for side in (1.0, -1.0):
        if (side * (shape.points - middle) @ normal > reach).any():
            shape = shape.clip_closed_surface(normal=-side * normal, origin=middle + side * reach * normal)
    return shape
