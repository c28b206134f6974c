"""Pictures of a scan: drawn off screen by VTK where that works, with bars and letters by matplotlib."""

from __future__ import annotations

import functools
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

import planar
from scan3d import scenes
from scan3d.cloud import Array
from scan3d.errors import InputError
from scan3d.scenes import COLORS, Scene
from scan3d.stages import (
    BODY,
    INK,
    NORMAL,
    ROD,
    SLICE,
    TANGENTIAL,
    TIP,
    Shade,
    Stage,
    bar,
    legend,
    quiet,
    save,
    shade,
    sheet,
    show,
    tall,
)

# Where neither X nor EGL exists VTK takes the process down, so a child goes first.
_PROBE = """
import sys
from vtkmodules.vtkFiltersSources import vtkSphereSource
from vtkmodules.vtkRenderingCore import vtkActor, vtkPolyDataMapper, vtkRenderer, vtkRenderWindow, vtkWindowToImageFilter
import vtkmodules.vtkRenderingOpenGL2
sphere, mapper, actor, renderer, window = vtkSphereSource(), vtkPolyDataMapper(), vtkActor(), vtkRenderer(), vtkRenderWindow()
mapper.SetInputConnection(sphere.GetOutputPort())
actor.SetMapper(mapper)
renderer.AddActor(actor)
window.SetOffScreenRendering(sys.argv[1] == "off screen")
window.SetSize(32, 32)
window.AddRenderer(renderer)
window.Render()
image = vtkWindowToImageFilter()
image.SetInput(window)
image.ReadFrontBufferOff()
image.Update()
low, high = image.GetOutput().GetScalarRange()
sys.exit(0 if high > low else 3)
"""
NO_RENDERER = (
    "no pictures: nothing here can render off screen; on Debian or Ubuntu install it with "
    "'apt-get install libegl1 libgl1', then run again"
)
_WINDOW = "VTK_DEFAULT_OPENGL_WINDOW"

VIEWS = ("cloud", "surface", "bound", "compare", "explain")
"""What a picture can show."""
PICTURES = (".png", ".pdf")
# Normals drawn at most, and bent states of the rod in a picture.
_MOST_NORMALS = 500
_STATES = 7
# Errors are shown over so many powers of ten at most.
_DECADES = 4.0


@functools.cache
def can_render() -> bool:
    """Whether VTK can draw off screen on this machine, tried out in a child process."""
    if sys.platform == "linux" and not os.environ.get("DISPLAY") and _WINDOW not in os.environ:
        # without a display VTK tries X first, and complains
        os.environ[_WINDOW] = "vtkEGLRenderWindow"
        if renders():
            return True
        del os.environ[_WINDOW]
    return renders()


def renders(*, on_screen: bool = False) -> bool:
    """Whether a child process can draw here."""
    where = "on screen" if on_screen else "off screen"
    try:
        # in a session of its own: an interrupt from the terminal is no answer
        tried = subprocess.run(
            [sys.executable, "-c", _PROBE, where],
            capture_output=True,
            timeout=120,
            check=False,
            start_new_session=True,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return tried.returncode == 0


def need_renderer() -> None:
    """Raises InputError where nothing can render."""
    if not can_render():
        raise InputError(NO_RENDERER)


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
        mesh, off, _ = scenes.shown_surface(scene)
        assert off is not None
        most = float(np.abs(off).max()) or 1.0
        return mesh, shade(off, f"signed deviation in {scene.unit}", -most, most, map="RdBu_r")
    if scene.bound is not None and np.isfinite(scene.bound).any():
        mesh, _, bound = scenes.shown_surface(scene)
        assert bound is not None
        title = f"certified bound in {scene.unit}"
        return mesh, shade(bound, title, 0.0, float(np.nanmax(scene.bound)) or 1.0, map="YlGnBu")
    if view == "bound":
        raise InputError(
            f"the bound of {scene.name} is not known; show a scan's folder, its surface.ply, or a recording"
        )
    return scene.surface, None


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


# --- the pictures ---


def _cloud(scene: Scene, view: str, color: str) -> Any:
    if scene.contacts is None:
        raise InputError(f"{scene.name} has no contacts, where the view cloud shows them; give the view surface")
    shaded = shade_contacts(scene, color)
    stage = Stage(np.concatenate([scene.corners, *normals(scene)]))
    stage.backdrop(scene)
    stage.add_points(scene.points, shaded.rgb, 7)
    stage.add_lines(normals(scene), NORMAL, 1)
    wide = 0.70 if shaded.norm is None else 0.78  # a legend takes more room than a bar
    figure = sheet(tall(stage, wide))
    show(figure, stage, (0.02, 0.02, wide, 0.96), scene.unit)
    if shaded.norm is None:
        both = [("tangential", TANGENTIAL), ("tip", TIP)]
        legend(figure, [(f"{name} contact", color, "o") for name, color in both] + [("normal", NORMAL, "-")], 1)
    else:
        tips = scene.column("phase") == planar.Phase.TIP
        bar(figure, shaded, unknown="tip contact" if color == "friction" and np.any(tips) else "")
    return figure


def _surface(scene: Scene, view: str, color: str) -> Any:
    mesh, shaded = shade_surface(scene, view)
    stage = Stage(scene.corners)
    stage.add_body(mesh, BODY if shaded is None else shaded.rgb, edges=scene.surface)
    figure = sheet(tall(stage, 0.78))
    show(figure, stage, (0.02, 0.02, 0.78, 0.96), scene.unit)
    if shaded is not None:
        bar(figure, shaded)
    return figure


def _compare(scene: Scene, view: str, color: str) -> Any:
    if scene.truth is None:
        raise InputError(
            f"the true body of {scene.name} is not at hand, where the view compare shows it; "
            "give --truth MESH (in Python truth=)"
        )
    mesh, shaded = shade_surface(scene)
    figure = sheet(tall(Stage(scene.corners), 0.40) + 0.3)
    for k, (title, body) in enumerate((("truth", scene.truth), ("reconstruction", mesh))):
        stage = Stage(scene.corners)
        if k and shaded is not None:
            stage.add_body(body, shaded.rgb, edges=scene.surface)
        else:
            stage.add_body(body, BODY)
        place = (0.01 + 0.41 * k, 0.02, 0.40, 0.86)
        show(figure, stage, place, scene.unit, scaled=k == 0)
        figure.text(place[0] + place[2] / 2, 0.93, title, ha="center", va="center")
    if shaded is not None:
        bar(figure, shaded)
    return figure


def _explain(scene: Scene, view: str, color: str) -> Any:
    one = scenes.sweep(scene)
    states = np.unique(np.linspace(0, len(one.base) - 1, _STATES).round().astype(int))
    stage = explaining(scene, one)
    stage.add_rods(one, states)
    figure = sheet(tall(stage, 1.0) + 0.7)
    share = 0.7 / figure.get_size_inches()[1]
    show(figure, stage, (0.0, share, 1.0, 1 - share), scene.unit)
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


def explaining(scene: Scene, one: scenes.Sweep) -> Stage:
    """The stage of one sweep without its rods: body, slices, base line; looked at from above the base line."""
    x, y, z = one.axes
    tips = np.concatenate([one.straight[:, 1], one.base, one.contact])
    line = one.base[[0, -1]] + np.outer([0.12, -0.12], np.linalg.norm(one.base[0] - one.base[-1]) * x)
    body = scene.truth if scene.truth is not None else scene.surface
    mine = scene.points[scene.column("slice") == one.slice]
    size = float(np.linalg.norm(np.ptp(np.concatenate([tips, mine]), axis=0)))
    # of a long body as much as the rods are wide
    near = scene.corners[np.abs((scene.corners - mine[0]) @ z) < size]
    stage = Stage(np.concatenate([tips, line, mine, near]), 0.7 * z - 0.6 * y + 0.45 * x, z)
    stage.size = size
    if body is not None:
        stage.add_body(body, BODY)
    for points, _ in scenes.rings(scene):
        stage.add_lines(points[None], SLICE, 1)
    stage.add_tube(next(ring for ring, number in scenes.rings(scene) if number == one.slice), INK, 0.004)
    stage.add_arrow(line)
    return stage


def normals(scene: Scene, most: int = _MOST_NORMALS) -> Array:
    """(k, 2, 3) short lines along the normals of contacts, evenly chosen."""
    known = np.flatnonzero(np.isfinite(scene.normals).all(axis=1))
    some = known[:: max(1, len(known) // most)]
    points = scene.points[some]
    return np.stack([points, points + 0.035 * scene.diagonal * scene.normals[some]], axis=1)
