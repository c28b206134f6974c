"""Pictures of a scan: drawn off screen by VTK where that works, with colour bars and letters by matplotlib."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import planar
from scan3d.choices import VIEWS
from scan3d.errors import InputError
from scan3d.pictures.canvas import Canvas
from scan3d.pictures.figures import blank_figure, color_bar, figure_height, legend, quiet, save, show_canvas
from scan3d.pictures.parts import ShownSweep, normal_lines, outlines, shown_sweep
from scan3d.pictures.rendering import need_renderer
from scan3d.pictures.scene import Scene
from scan3d.pictures.shading import BODY, INK, NORMAL, ROD, SLICE, TANGENTIAL, TIP, shade_contacts, shade_surface

PICTURES = (".png", ".pdf")
_STATES = 7


def check_path(path: str | Path) -> Path:
    """The path of a picture.  Raises InputError unless one can bear the name."""
    path = Path(path)
    if path.suffix.lower() not in PICTURES:
        raise InputError(f"a picture is written as {' or '.join(PICTURES)}, got {path.name!r}")
    return path


def picture(scene: Scene, path: str | Path, view: str = "cloud", color: str = "force") -> None:
    """Draw a view (of `VIEWS`) of the scene into a .png or a .pdf 7 inches wide; `color` (of `COLORS`) is the contacts'.

    Raises InputError if the scene lacks what the view shows, or where nothing can render.
    """
    path = check_path(path)
    with quiet():
        save(figure(scene, view, color), path)


def figure(scene: Scene, view: str = "cloud", color: str = "force") -> Any:
    """What `picture` writes, as a matplotlib figure.  Raises as it does."""
    if view not in VIEWS:
        raise InputError(f"view must be one of {', '.join(VIEWS)}, got {view!r}")
    need_renderer()
    return {"cloud": _cloud, "compare": _compare, "explain": _explain}.get(view, _surface)(scene, view, color)


def _cloud(scene: Scene, view: str, color: str) -> Any:
    if scene.contacts is None:
        raise InputError(f"{scene.name} has no contacts, where the view cloud shows them; give the view surface")
    shaded = shade_contacts(scene, color)
    canvas = Canvas(np.concatenate([scene.corners, *normal_lines(scene)]))
    canvas.backdrop(scene)
    canvas.add_points(scene.points, shaded.rgb, 7)
    canvas.add_lines(normal_lines(scene), NORMAL, 1)
    wide = 0.70 if shaded.norm is None else 0.78  # a legend takes more room than a bar
    figure = blank_figure(figure_height(canvas, wide))
    show_canvas(figure, canvas, (0.02, 0.02, wide, 0.96), scene.unit)
    if shaded.norm is None:
        both = [("tangential", TANGENTIAL), ("tip", TIP)]
        legend(figure, [(f"{name} contact", color, "o") for name, color in both] + [("normal", NORMAL, "-")], 1)
    else:
        tips = scene.column("phase") == planar.Phase.TIP
        color_bar(figure, shaded, unknown="tip contact" if color == "friction" and np.any(tips) else "")
    return figure


def _surface(scene: Scene, view: str, color: str) -> Any:
    mesh, shaded = shade_surface(scene, view)
    canvas = Canvas(scene.corners)
    canvas.add_body(mesh, BODY if shaded is None else shaded.rgb, edges=scene.surface)
    figure = blank_figure(figure_height(canvas, 0.78))
    show_canvas(figure, canvas, (0.02, 0.02, 0.78, 0.96), scene.unit)
    if shaded is not None:
        color_bar(figure, shaded)
    return figure


def _compare(scene: Scene, view: str, color: str) -> Any:
    if scene.truth is None:
        raise InputError(
            f"the true body of {scene.name} is not at hand, where the view compare shows it; "
            "give --truth MESH (in Python truth=)"
        )
    mesh, shaded = shade_surface(scene)
    figure = blank_figure(figure_height(Canvas(scene.corners), 0.40) + 0.3)
    for k, (title, body) in enumerate((("truth", scene.truth), ("reconstruction", mesh))):
        canvas = Canvas(scene.corners)
        if k and shaded is not None:
            canvas.add_body(body, shaded.rgb, edges=scene.surface)
        else:
            canvas.add_body(body, BODY)
        place = (0.01 + 0.41 * k, 0.02, 0.40, 0.86)
        show_canvas(figure, canvas, place, scene.unit, scaled=k == 0)
        figure.text(place[0] + place[2] / 2, 0.93, title, ha="center", va="center")
    if shaded is not None:
        color_bar(figure, shaded)
    return figure


def _explain(scene: Scene, view: str, color: str) -> Any:
    one = shown_sweep(scene)
    states = np.unique(np.linspace(0, len(one.base) - 1, _STATES).round().astype(int))
    canvas = explaining(scene, one)
    canvas.add_rods(one, states)
    figure = blank_figure(figure_height(canvas, 1.0) + 0.7)
    share = 0.7 / figure.get_size_inches()[1]
    show_canvas(figure, canvas, (0.0, share, 1.0, 1 - share), scene.unit)
    entries = [
        ("body", BODY, "s"),
        ("slices", SLICE, "-"),
        ("slice of the sweep", INK, "-"),
        ("contact", TANGENTIAL, "o"),
        ("bent rod", ROD, "-"),
        ("clamp", INK, "s"),
        ("way of the clamp", INK, "->"),
    ]
    legend(figure, entries, 4)
    return figure


def explaining(scene: Scene, one: ShownSweep) -> Canvas:
    """The canvas of one sweep without its rods: body, slices, base line; looked at from above the base line."""
    x, y, z = one.axes
    tips = np.concatenate([one.straight[:, 1], one.base, one.contact])
    line = one.base[[0, -1]] + np.outer([0.12, -0.12], np.linalg.norm(one.base[0] - one.base[-1]) * x)
    body = scene.truth if scene.truth is not None else scene.surface
    mine = scene.points[scene.column("slice") == one.slice]
    size = float(np.linalg.norm(np.ptp(np.concatenate([tips, mine]), axis=0)))
    # of a long body as much as the rods are wide
    near = scene.corners[np.abs((scene.corners - mine[0]) @ z) < size]
    canvas = Canvas(np.concatenate([tips, line, mine, near]), 0.7 * z - 0.6 * y + 0.45 * x, z)
    canvas.size = size
    if body is not None:
        canvas.add_body(body, BODY)
    for points, _ in outlines(scene):
        canvas.add_lines(points[None], SLICE, 1)
    canvas.add_tube(next(ring for ring, number in outlines(scene) if number == one.slice), INK, 0.004)
    canvas.add_arrow(line)
    return canvas
