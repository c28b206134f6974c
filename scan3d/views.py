"""Pictures of a scan: drawn off screen by VTK where that works, with bars and letters by matplotlib."""

from __future__ import annotations

import functools
import logging
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import planar
from scan3d import scenes
from scan3d.cloud import Array
from scan3d.errors import InputError
from scan3d.scenes import COLORS, Scene

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
window.SetOffScreenRendering(1)
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
# Pixels to the inch of a picture 7 inches wide, which two columns of a paper are: letters of 12 points stay legible in one.
_DPI = 200
_WIDE = 7.0
_FONT = 12
# Inches: for a bar and its title.
_LEAST_TALL = 3.2
# Rendered so much larger and averaged: smooth edges on any renderer.
_SUPERSAMPLING = 2
# From above the front; and on a sweep from above its base line.
_DIRECTION = (1.0, -1.3, 0.8)
_BODY, _INK, _ROD, _TIP, _TANGENTIAL = "#c3ccd6", "#222222", "#1b6ca8", "#d98200", "#b2182b"
_UNKNOWN, _NORMAL, _SLICE = "#9a9a9a", "#6b6b6b", "#5b6672"
# Normals drawn at most, bent states of the rod in a scene, and corners that are drawn as edges, in degrees.
_MOST_NORMALS = 500
_STATES = 7
_EDGE = 30.0
# Errors are shown over so many powers of ten at most.
_DECADES = 4.0


@functools.cache
def can_render() -> bool:
    """Whether VTK can draw off screen on this machine, tried out in a child process."""
    if sys.platform == "linux" and not os.environ.get("DISPLAY") and _WINDOW not in os.environ:
        # without a display VTK tries X first, and complains
        os.environ[_WINDOW] = "vtkEGLRenderWindow"
        if _renders():
            return True
        del os.environ[_WINDOW]
    return _renders()


def _renders(probe: str = _PROBE) -> bool:
    try:
        # in a session of its own: an interrupt from the terminal is no answer
        tried = subprocess.run(
            [sys.executable, "-c", probe], capture_output=True, timeout=120, check=False, start_new_session=True
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return tried.returncode == 0


def need_renderer() -> None:
    """Raises InputError where nothing can render."""
    if not can_render():
        raise InputError(NO_RENDERER)


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
    rgb = np.tile(np.array(to_rgb(_UNKNOWN)), (len(values), 1))
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

        pair = (255 * np.array([to_rgb(_TANGENTIAL), to_rgb(_TIP)]) + 0.5).astype(np.uint8)
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
    """The surface and the colours of its vertices: the deviation from the truth, or the bound; None if neither is known."""
    if scene.surface is None:
        raise InputError(f"{scene.name} has no surface to show; it has a cloud: give the view cloud")
    if view != "bound" and scene.truth is not None:
        mesh, off = scenes.deviation(scene)
        most = float(np.abs(off).max()) or 1.0
        return mesh, shade(off, f"signed deviation in {scene.unit}", -most, most, map="RdBu_r")
    if scene.bound is not None and np.isfinite(scene.bound).any():
        title = f"certified bound in {scene.unit}"
        return scene.surface, shade(scene.bound, title, 0.0, float(np.nanmax(scene.bound)) or 1.0, map="YlGnBu")
    if view == "bound":
        raise InputError(f"the bound of {scene.name} is not known; show a scan's folder, its surface.ply, or a recording")
    return scene.surface, None


def picture(scene: Scene, path: str | Path, view: str = "cloud", color: str = "force") -> None:
    """Draw a view (of `VIEWS`) of the scene into a .png or a .pdf 7 inches wide; `color` (of `COLORS`) is the contacts'.

    Raises InputError if the scene lacks what the view shows, or where nothing can render.
    """
    path = Path(path)
    if path.suffix.lower() not in PICTURES:
        raise InputError(f"a picture is written as {' or '.join(PICTURES)}, got {path.name!r}")
    if view not in VIEWS:
        raise InputError(f"view must be one of {', '.join(VIEWS)}, got {view!r}")
    with quiet():
        figure = {"cloud": _cloud, "compare": _compare, "explain": _explain}.get(view, _surface)(scene, view, color)
        save(figure, path)


def save(figure: Any, path: Path) -> None:
    """Write a figure without the time of day."""
    pdf = path.suffix.lower() == ".pdf"
    figure.savefig(path, dpi=_DPI, metadata={"CreationDate": None} if pdf else {"Software": "scan3d"})


@contextmanager
def quiet() -> Iterator[None]:
    """matplotlib's remarks on its caches belong to nobody's stderr."""
    log = logging.getLogger("matplotlib")
    before = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(before)


# --- the pictures ---


def _cloud(scene: Scene, view: str, color: str) -> Any:
    if scene.contacts is None:
        raise InputError(f"{scene.name} has no contacts, where the view cloud shows them; give the view surface")
    shaded = shade_contacts(scene, color)
    stage = Stage(scene.corners)
    stage.backdrop(scene)
    stage.add_points(scene.points, shaded.rgb, 7)
    stage.add_lines(normals(scene), _NORMAL, 1)
    figure = sheet(_tall(stage, 0.78))
    show(figure, stage, (0.02, 0.02, 0.78, 0.96), scene.unit)
    if shaded.norm is None:
        both = [("tangential", _TANGENTIAL), ("tip", _TIP)]
        legend(figure, [(f"{name} contact", color, "o") for name, color in both] + [("normal", _NORMAL, "-")], 1)
    else:
        bar(figure, shaded, unknown="tip contact" if np.isnan(scene.column(color)).any() else "")
    return figure


def _surface(scene: Scene, view: str, color: str) -> Any:
    mesh, shaded = shade_surface(scene, view)
    stage = Stage(scene.corners)
    stage.add_body(mesh, _BODY if shaded is None else shaded.rgb, edges=scene.surface)
    figure = sheet(_tall(stage, 0.78))
    show(figure, stage, (0.02, 0.02, 0.78, 0.96), scene.unit)
    if shaded is not None:
        bar(figure, shaded)
    return figure


def _compare(scene: Scene, view: str, color: str) -> Any:
    if scene.truth is None:
        raise InputError(f"the true body of {scene.name} is not at hand, where the view compare shows it; give --truth MESH")
    mesh, shaded = shade_surface(scene)
    figure = sheet(_tall(Stage(scene.corners), 0.40) + 0.3)
    for k, (title, body) in enumerate((("truth", scene.truth), ("reconstruction", mesh))):
        stage = Stage(scene.corners)
        if k and shaded is not None:
            stage.add_body(body, shaded.rgb, edges=scene.surface)
        else:
            stage.add_body(body, _BODY)
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
    figure = sheet(_tall(stage, 1.0) + 0.7)
    share = 0.7 / figure.get_size_inches()[1]
    show(figure, stage, (0.0, share, 1.0, 1 - share), scene.unit)
    entries = [
        ("body", _BODY, "s"),
        ("slices", _SLICE, "-"),
        ("slice of the sweep", _INK, "-"),
        ("contact", _TANGENTIAL, "o"),
        ("bent rod", _ROD, "-"),
        ("clamp", _INK, "s"),
        ("way of the clamp", _INK, "->"),
    ]
    legend(figure, entries, 4)
    return figure


def _tall(stage: Stage, share: float) -> float:
    """Height of a figure, in inches, that suits what the camera sees in a share of its width."""
    wide, tall = np.ptp(stage.corners @ np.stack([stage.right, stage.up], axis=1), axis=0)
    return float(np.clip(_WIDE * share * tall / wide * 0.94 / 0.80, _LEAST_TALL, 0.75 * _WIDE))


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
        stage.add_body(body, _BODY)
    for points in scenes.contours(scene):
        stage.add_lines(points[None], _SLICE, 1)
    ring = next(c for c in scenes.contours(scene) if (np.abs((c - mine[0]) @ z) <= 1e-9 * scene.diagonal).all())
    stage.add_tube(ring, _INK, 0.004)
    stage.add_arrow(line)
    return stage


def normals(scene: Scene, most: int = _MOST_NORMALS) -> Array:
    """(k, 2, 3) short lines along the normals of contacts, evenly chosen."""
    known = np.flatnonzero(np.isfinite(scene.normals).all(axis=1))
    some = known[:: max(1, len(known) // most)]
    points = scene.points[some]
    return np.stack([points, points + 0.035 * scene.diagonal * scene.normals[some]], axis=1)


# --- what they are made of ---


class Stage:
    """Bodies, points and lines before a camera that sees some corners (k, 3) whole, in parallel projection."""

    def __init__(self, corners: Array, direction: Any = _DIRECTION, up: Any = (0.0, 0.0, 1.0)) -> None:
        import pyvista

        self.plotter = pyvista.Plotter(off_screen=True, window_size=[64, 64])
        self.plotter.set_background("white")
        self.corners = corners
        self.size = float(np.linalg.norm(np.ptp(corners, axis=0)))
        toward = np.asarray(direction, dtype=float)
        self.toward = toward / np.linalg.norm(toward)
        right = np.cross(np.asarray(up, dtype=float), self.toward)
        self.right = right / np.linalg.norm(right)
        self.up = np.cross(self.toward, self.right)

    def add_body(self, mesh: Any, color: Any, *, edges: Any = None, ambient: float = 0.45) -> None:
        """A mesh in one colour or in one (v, 3) for each vertex, its sharp edges drawn."""
        import pyvista

        shape = pyvista.wrap(mesh)
        light = dict(ambient=ambient, diffuse=1 - ambient, specular=0.0)
        if isinstance(color, str):
            self.plotter.add_mesh(shape, color=color, **light)
        else:
            shape.point_data["rgb"] = color
            self.plotter.add_mesh(shape, scalars="rgb", rgb=True, **light)
        sharp = pyvista.wrap(mesh if edges is None else edges).extract_feature_edges(
            _EDGE, boundary_edges=False, non_manifold_edges=False, manifold_edges=False
        )
        if sharp.n_cells:
            sharp.points = sharp.points + 1e-3 * self.size * self.toward  # before the faces
            self.plotter.add_mesh(sharp, color="#4a4f55", line_width=_SUPERSAMPLING)

    def backdrop(self, scene: Scene) -> None:
        """A body inside the contacts, so that those behind it do not shine through."""
        from scan3d.surfaces import hull

        body = scene.surface
        if body is None:
            try:
                body = hull(scene.points)
            except InputError:  # contacts in a plane hide nothing
                return
        body = body.copy()
        body.vertices = body.vertices - 3e-3 * self.size * self.toward
        self.add_body(body, "#eef0f3", ambient=0.6)

    def add_points(self, points: Array, color: Any, size: float) -> None:
        """Points (n, 3) as balls of so many pixels, in one colour or in their own (n, 3)."""
        import pyvista

        cloud = pyvista.PolyData(np.asarray(points))
        how = dict(point_size=size * _SUPERSAMPLING, render_points_as_spheres=True, ambient=0.6, diffuse=0.4)
        if isinstance(color, str):
            self.plotter.add_mesh(cloud, color=color, **how)
        else:
            cloud["rgb"] = color
            self.plotter.add_mesh(cloud, scalars="rgb", rgb=True, **how)

    def add_lines(self, lines: Array, color: str, width: float) -> list[Any]:
        """Lines (k, p, 3) of so many pixels.  Returns their actors."""
        import pyvista

        k, p = lines.shape[:2]
        if not k:
            return []
        cells = np.column_stack([np.full(k, p), np.arange(k * p).reshape(k, p)])
        shape = pyvista.PolyData(lines.reshape(-1, 3) + 2e-3 * self.size * self.toward, lines=cells.ravel())
        return [self.plotter.add_mesh(shape, color=color, line_width=width * _SUPERSAMPLING, lighting=False)]

    def add_tube(self, line: Array, color: str, radius: float) -> Any:
        """A line (p, 3) of a thickness relative to the size.  Returns its actor."""
        import pyvista

        step = np.linalg.norm(np.diff(line, axis=0), axis=1)
        distinct = line[np.insert(step > 1e-6 * self.size, 0, True)]
        tube = pyvista.lines_from_points(distinct).tube(radius=radius * self.size, n_sides=12, capping=True)
        return self.plotter.add_mesh(tube, color=color)

    def add_rods(self, one: scenes.Sweep, states: NDArray[np.integer]) -> list[Any]:
        """Bent rods with their clamps and contacts.  Returns their actors."""
        import pyvista

        actors = []
        thick = 0.006 * self.size
        for k in states:
            whole = np.concatenate([one.curved[k], one.straight[k, 1:]])
            actors.append(self.add_tube(whole, _ROD, 0.003))
            clamp = pyvista.Cube(x_length=3 * thick, y_length=3 * thick, z_length=3 * thick)
            clamp.points = one.base[k] + clamp.points @ one.axes - 1.5 * thick * one.axes[1]
            actors.append(self.plotter.add_mesh(clamp, color=_INK))
            ball = pyvista.Sphere(radius=1.7 * thick, center=one.contact[k])
            actors.append(self.plotter.add_mesh(ball, color=_TANGENTIAL))
        return actors

    def add_arrow(self, line: Array) -> None:
        """A line (2, 3) with a head at its end."""
        import pyvista

        self.add_lines(line[None], _INK, 2)
        along = line[1] - line[0]
        head = 0.05 * self.size
        cone = pyvista.Cone(center=line[1], direction=along, height=head, radius=0.28 * head, resolution=24)
        self.plotter.add_mesh(cone, color=_INK)

    def aim(self, width: int, height: int) -> float:
        """Turn the camera so that the corners fill an image; returns the world's length that is as wide as the image."""
        seen = self.corners @ np.stack([self.right, self.up], axis=1)
        low, high = seen.min(axis=0), seen.max(axis=0)
        middle = (low + high) / 2
        depth = self.corners @ self.toward
        # a margin around, and room below for the scale
        tall = max((high[1] - low[1]) / 0.80, (high[0] - low[0]) / 0.94 * height / width)
        center = middle[0] * self.right + (middle[1] - 0.05 * tall) * self.up + depth.mean() * self.toward
        camera = self.plotter.camera
        camera.parallel_projection = True
        camera.focal_point = center
        camera.position = center + 3 * self.size * self.toward
        camera.up = self.up
        camera.parallel_scale = tall / 2
        self.plotter.renderer.ResetCameraClippingRange()
        return float(tall * width / height)

    def image(self, width: int, height: int) -> tuple[NDArray[np.uint8], float]:
        """(height, width, 3) what the camera sees, and the world's length that is as wide."""
        from PIL import Image

        across = self.aim(width, height)
        self.plotter.window_size = [width * _SUPERSAMPLING, height * _SUPERSAMPLING]
        large = Image.fromarray(self.plotter.screenshot(return_img=True)[:, :, :3])
        return np.asarray(large.reduce(_SUPERSAMPLING)), across


def sheet(height: float, dpi: int = _DPI) -> Any:
    """A white figure 7 inches wide."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_WIDE, height), dpi=dpi, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def show(figure: Any, stage: Stage, place: tuple[float, float, float, float], unit: str, *, scaled: bool = True) -> None:
    """Put what a stage's camera sees into a place of the figure, with a scale and the world's axes."""
    left, bottom, wide, tall = place
    width, height = (round(float(v)) for v in figure.get_size_inches() * figure.dpi * (wide, tall))
    image, across = stage.image(width, height)
    stage.plotter.close()
    axes = figure.add_axes(place)
    axes.imshow(image, extent=(0, width, 0, height), interpolation="nearest", aspect="auto")
    axes.set_axis_off()
    if not scaled:
        return
    arm = 0.055 * figure.get_size_inches()[0] * figure.dpi * 0.9
    start = np.array([1.6 * arm, 1.3 * arm])
    for name, axis in zip("xyz", np.eye(3), strict=True):
        end = np.array([axis @ stage.right, axis @ stage.up]) * arm
        if np.hypot(*end) < 0.15 * arm:  # it points at the viewer
            continue
        axes.annotate("", start + end, start, arrowprops=dict(arrowstyle="-|>", color=_INK, lw=1.2, shrinkA=0, shrinkB=0))
        axes.text(*(start + 1.3 * end), name, ha="center", va="center", fontsize=_FONT - 2, color=_INK)
    length = nice(0.22 * across)
    pixels = length / across * width
    begin = 3.4 * arm
    axes.plot([begin, begin + pixels], [0.55 * arm] * 2, color=_INK, lw=2.5, solid_capstyle="butt")
    text = f"{length:g} {unit}" if unit != "um" else f"{length:g} µm"
    axes.text(begin + pixels / 2, 0.75 * arm, text, ha="center", va="bottom", fontsize=_FONT - 1, color=_INK)
    axes.set_xlim(0, width)
    axes.set_ylim(0, height)


def nice(length: float) -> float:
    """The largest 1, 2 or 5 times a power of ten that is no longer."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(max(step * power for step in (1, 2, 5) if step * power <= length * (1 + 1e-9)))


def bar(figure: Any, shaded: Shade, unknown: str = "") -> None:
    """The colours' scale at the right edge, with its title; `unknown` says what is grey."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.patches import Patch

    place = figure.add_axes((0.845, 0.17, 0.025, 0.64))
    drawn = figure.colorbar(ScalarMappable(shaded.norm, shaded.map), cax=place)
    drawn.ax.tick_params(labelsize=_FONT - 1)
    drawn.outline.set_linewidth(0.6)
    if type(shaded.norm).__name__ == "Normalize":
        drawn.formatter.set_powerlimits((-4, 5))
        drawn.formatter.set_useMathText(True)
        drawn.ax.yaxis.get_offset_text().set_fontsize(_FONT - 1)
        drawn.ax.yaxis.set_offset_position("left")
    drawn.set_label(shaded.title, fontsize=_FONT, labelpad=8)
    if unknown:
        figure.legend(
            [Patch(color=_UNKNOWN)], [unknown], loc="lower right", frameon=False, fontsize=_FONT - 2, handlelength=1,
            bbox_to_anchor=(0.995, 0.05),
        )  # fmt: skip


def legend(figure: Any, entries: list[tuple[str, str, str]], columns: int) -> None:
    """What is what: (text, colour, mark) each; in one column right of the picture, in several below it."""
    from matplotlib.lines import Line2D

    marks = {"-": "", "->": ">"}
    handles = [
        Line2D([], [], color=color, lw=2 * (mark in marks), marker=marks.get(mark, mark), markersize=8)
        for _, color, mark in entries
    ]
    place = dict(loc="center right", bbox_to_anchor=(0.985, 0.5)) if columns == 1 else dict(loc="lower center")
    figure.legend(
        handles, [text for text, _, _ in entries], ncols=columns, frameon=False, fontsize=_FONT - 1, handlelength=1.5,
        columnspacing=1.2, **place,
    )  # fmt: skip
