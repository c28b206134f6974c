"""What pictures are made of: a stage of bodies, points, tubes and lines before a camera, and sheets with bars and letters."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scan3d.cloud import Array
from scan3d.errors import InputError
from scan3d.scenes import Scene, Sweep

BODY, INK, ROD, TIP, TANGENTIAL = "#c3ccd6", "#222222", "#1b6ca8", "#d98200", "#b2182b"
UNKNOWN, NORMAL, SLICE = "#9a9a9a", "#6b6b6b", "#5b6672"
# Pixels to the inch of a picture 7 inches wide, which two columns of a paper are: letters of 12 points stay legible in one.
DPI = 200
WIDE = 7.0
FONT = 12
# Inches: for a bar and its title.
_LEAST_TALL = 3.2
# Rendered so much larger and averaged: smooth edges on any renderer.
_SUPERSAMPLING = 2
# From above the front.
DIRECTION = (1.0, -1.3, 0.8)
# Corners that are drawn as edges, in degrees.
_EDGE = 30.0


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


class Stage:
    """Bodies, points and lines before a camera that sees some corners (k, 3) whole, in parallel projection."""

    def __init__(
        self, corners: Array, direction: Any = DIRECTION, up: Any = (0.0, 0.0, 1.0), *, off_screen: bool = True
    ) -> None:
        import pyvista

        self.plotter = pyvista.Plotter(off_screen=off_screen, window_size=[64, 64] if off_screen else [1200, 900])
        self.dots = _SUPERSAMPLING if off_screen else 1
        self.plotter.set_background("white")
        self.plotter.suppress_rendering = off_screen  # until an image is asked for
        if off_screen:
            self.plotter.render_window.SetMultiSamples(0)  # the larger image does that
        self.corners = corners
        self.size = float(np.linalg.norm(np.ptp(corners, axis=0))) or 1.0  # one point is as large as you please
        toward = np.asarray(direction, dtype=float)
        self.toward = toward / np.linalg.norm(toward)
        right = np.cross(np.asarray(up, dtype=float), self.toward)
        self.right = right / np.linalg.norm(right)
        self.up = np.cross(self.toward, self.right)

    def add_body(self, mesh: Any, color: Any, *, edges: Any = None, ambient: float = 0.45, opacity: float = 1.0) -> Any:
        """A mesh in one colour or in one (v, 3) for each vertex, its sharp edges drawn.  Returns the mesh's actor."""
        import pyvista

        shape = pyvista.wrap(mesh)
        light = dict(ambient=ambient, diffuse=1 - ambient, specular=0.0, opacity=opacity)
        if isinstance(color, str):
            actor = self.plotter.add_mesh(shape, color=color, **light)
        else:
            shape.point_data["rgb"] = color
            actor = self.plotter.add_mesh(shape, scalars="rgb", rgb=True, **light)
        sharp = pyvista.wrap(mesh if edges is None else edges).extract_feature_edges(
            _EDGE, boundary_edges=False, non_manifold_edges=False, manifold_edges=False
        )
        if sharp.n_cells and opacity == 1:
            sharp.points = sharp.points + 1e-3 * self.size * self.toward  # before the faces
            self.plotter.add_mesh(sharp, color="#4a4f55", line_width=self.dots)
        return actor

    def backdrop(self, scene: Scene) -> None:
        """A body inside the contacts, so that those behind it do not shine through."""
        from scan3d.hulls import hull

        body = scene.surface
        if body is None:
            try:
                body = hull(scene.points)
            except InputError:  # contacts in a plane hide nothing
                return
        body = body.copy()
        body.vertices = body.vertices - 3e-3 * self.size * self.toward
        self.add_body(body, "#eef0f3", ambient=0.6)

    def add_points(self, points: Array, color: Any, size: float) -> Any:
        """Points (n, 3) as balls of so many pixels, in one colour or in their own (n, 3).  Returns their actor."""
        import pyvista

        cloud = pyvista.PolyData(np.asarray(points))
        how = dict(point_size=size * self.dots, render_points_as_spheres=True, ambient=0.6, diffuse=0.4)
        if isinstance(color, str):
            return self.plotter.add_mesh(cloud, color=color, **how)
        cloud["rgb"] = color
        return self.plotter.add_mesh(cloud, scalars="rgb", rgb=True, **how)

    def add_lines(self, lines: Array, color: str, width: float) -> list[Any]:
        """Lines (k, p, 3) of so many pixels.  Returns their actors."""
        import pyvista

        k, p = lines.shape[:2]
        if not k:
            return []
        cells = np.column_stack([np.full(k, p), np.arange(k * p).reshape(k, p)])
        shape = pyvista.PolyData(lines.reshape(-1, 3) + 2e-3 * self.size * self.toward, lines=cells.ravel())
        return [self.plotter.add_mesh(shape, color=color, line_width=width * self.dots, lighting=False)]

    def add_tube(self, line: Array, color: str, radius: float) -> Any:
        """A line (p, 3) of a thickness relative to the size.  Returns its actor."""
        import pyvista

        step = np.linalg.norm(np.diff(line, axis=0), axis=1)
        distinct = line[np.insert(step > 1e-6 * self.size, 0, True)]
        tube = pyvista.lines_from_points(distinct).tube(radius=radius * self.size, n_sides=12, capping=True)
        return self.plotter.add_mesh(tube, color=color)

    def add_rods(self, one: Sweep, states: NDArray[np.integer]) -> list[Any]:
        """Bent rods with their clamps and contacts.  Returns their actors."""
        import pyvista

        actors = []
        thick = 0.006 * self.size
        for k in states:
            whole = np.concatenate([one.curved[k], one.straight[k, 1:]])
            actors.append(self.add_tube(whole, ROD, 0.003))
            clamp = pyvista.Cube(x_length=3 * thick, y_length=3 * thick, z_length=3 * thick)
            clamp.points = one.base[k] + clamp.points @ one.axes - 1.5 * thick * one.axes[1]
            actors.append(self.plotter.add_mesh(clamp, color=INK))
            ball = pyvista.Sphere(radius=1.7 * thick, center=one.contact[k])
            actors.append(self.plotter.add_mesh(ball, color=TANGENTIAL))
        return actors

    def add_arrow(self, line: Array) -> None:
        """A line (2, 3) with a head at its end."""
        import pyvista

        self.add_lines(line[None], INK, 2)
        along = line[1] - line[0]
        head = 0.05 * self.size
        cone = pyvista.Cone(center=line[1], direction=along, height=head, radius=0.28 * head, resolution=24)
        self.plotter.add_mesh(cone, color=INK)

    def aim(self, width: int, height: int, floor: float = 0.0) -> float:
        """Turn the camera so that the corners fill an image; returns the world's length that is as wide as the image."""
        seen = self.corners @ np.stack([self.right, self.up], axis=1)
        low, high = seen.min(axis=0), seen.max(axis=0)
        middle = (low + high) / 2
        depth = self.corners @ self.toward
        # a margin around, and so many pixels of room below
        free = height - floor
        unit = min(0.94 * free / (high[1] - low[1] or 1.0), 0.94 * width / (high[0] - low[0] or 1.0))  # pixels
        center = middle[0] * self.right + (middle[1] - floor / 2 / unit) * self.up + depth.mean() * self.toward
        camera = self.plotter.camera
        camera.parallel_projection = True
        camera.focal_point = center
        camera.position = center + 3 * self.size * self.toward
        camera.up = self.up
        camera.parallel_scale = height / 2 / unit
        self.plotter.renderer.ResetCameraClippingRange()
        return float(width / unit)

    def image(self, width: int, height: int, floor: float = 0.0) -> tuple[NDArray[np.uint8], float]:
        """(height, width, 3) what the camera sees, and the world's length that is as wide."""
        from PIL import Image

        across = self.aim(width, height, floor)
        size = [width * _SUPERSAMPLING, height * _SUPERSAMPLING]
        if list(self.plotter.window_size) != size:
            self.plotter.window_size = size
        self.plotter.suppress_rendering = False
        self.plotter.render()
        large = Image.fromarray(self.plotter.screenshot(return_img=True)[:, :, :3])
        self.plotter.suppress_rendering = True
        return np.asarray(large.reduce(_SUPERSAMPLING)), across


def sheet(height: float, dpi: int = DPI) -> Any:
    """A white figure 7 inches wide."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDE, height), dpi=dpi, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def show(
    figure: Any, stage: Stage, place: tuple[float, float, float, float], unit: str, *, scaled: bool = True
) -> None:
    """Put what a stage's camera sees into a place of the figure, with a scale and the world's axes."""
    left, bottom, wide, tall = place
    width, height = (round(float(v)) for v in figure.get_size_inches() * figure.dpi * (wide, tall))
    arm = 30 + 0.036 * width  # of the world's axes
    image, across = stage.image(width, height, 1.9 * arm)
    stage.plotter.close()
    axes = figure.add_axes(place)
    axes.imshow(image, extent=(0, width, 0, height), interpolation="nearest", aspect="auto")
    axes.set_axis_off()
    if not scaled:
        return
    start, labels = np.array([1.6 * arm, 1.3 * arm]), [np.zeros(2)]
    ends = np.stack([np.stack([stage.right, stage.up]) @ axis for axis in np.eye(3)]) * arm
    for k in np.argsort(-np.linalg.norm(ends, axis=1), kind="stable"):
        at = 1.35 * ends[k]
        # one that points at the viewer, or lies below another
        if min(np.linalg.norm(at - other) for other in labels) < 0.4 * arm:
            continue
        labels.append(at)
        axes.annotate(
            "", start + ends[k], start, arrowprops=dict(arrowstyle="-|>", color=INK, lw=1.2, shrinkA=0, shrinkB=0)
        )
        axes.text(*(start + at), "xyz"[k], ha="center", va="center", fontsize=FONT - 2, color=INK)
    length = nice(0.22 * across)
    pixels = length / across * width
    begin = 3.4 * arm
    axes.plot([begin, begin + pixels], [0.55 * arm] * 2, color=INK, lw=2.5, solid_capstyle="butt")
    text = f"{length:g} {unit.replace('um', 'µm')}"
    axes.text(begin + pixels / 2, 0.75 * arm, text, ha="center", va="bottom", fontsize=FONT - 1, color=INK)
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
    from matplotlib.ticker import MaxNLocator

    place = figure.add_axes((0.832, 0.15, 0.025, 0.70))
    drawn = figure.colorbar(ScalarMappable(shaded.norm, shaded.map), cax=place)
    drawn.ax.tick_params(labelsize=FONT - 1)
    drawn.outline.set_linewidth(0.6)
    if type(shaded.norm).__name__ == "Normalize":
        drawn.locator = MaxNLocator(6, steps=[1, 2, 5, 10])
        drawn.formatter.set_powerlimits((-4, 5))
        drawn.formatter.set_useMathText(True)
        drawn.ax.yaxis.get_offset_text().set_fontsize(FONT - 1)
    title = shaded.title.replace(" um", " µm")
    figure.text(0.992, 0.5, title, rotation="vertical", ha="right", va="center", fontsize=FONT)
    if unknown:
        figure.legend(
            [Patch(color=UNKNOWN)], [unknown], loc="lower right", frameon=False, fontsize=FONT - 2, handlelength=1,
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
        handles, [text for text, _, _ in entries], ncols=columns, frameon=False, fontsize=FONT - 1, handlelength=1.5,
        columnspacing=1.2, **place,
    )  # fmt: skip


def tall(stage: Stage, share: float) -> float:
    """Height of a figure, in inches, that suits what the camera sees in a share of its width."""
    wide, high = np.ptp(stage.corners @ np.stack([stage.right, stage.up], axis=1), axis=0)
    return float(np.clip(WIDE * share * high / (wide or high or 1.0) * 0.94 / 0.80, _LEAST_TALL, 0.75 * WIDE))


def save(figure: Any, path: Path) -> None:
    """Write a figure without the time of day."""
    pdf = path.suffix.lower() == ".pdf"
    figure.savefig(path, dpi=DPI, metadata={"CreationDate": None} if pdf else {"Software": "scan3d"})


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
