"""Moving pictures: the rod along one sweep with its reactions, and the body growing slice by slice."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scan3d.arrays import Array
from scan3d.choices import MOVIES
from scan3d.errors import InputError
from scan3d.pictures.canvas import Canvas
from scan3d.pictures.figures import FONT, blank_figure, quiet
from scan3d.pictures.parts import outlines, shown_sweep
from scan3d.pictures.rendering import need_renderer
from scan3d.pictures.scene import Scene
from scan3d.pictures.shading import (
    BODY,
    INK,
    ROD,
    SLICE,
    TANGENTIAL,
)

ENDINGS = (".gif", ".mp4")
NO_FFMPEG = (
    "an .mp4 needs the package imageio-ffmpeg: 'pip install imageio-ffmpeg'; or write a .gif, which needs nothing"
)
FRAMES = 60
_PER_SECOND = 12
# The last picture stays, in pictures.
_HELD = 18
# Inches and dots to the inch: 980 by 560 pixels.
_SIZE, _DPI = (7.0, 4.0), 140
_COLORS = 128
# What is brighter is white.
_WHITE = 245

Image = NDArray[np.uint8]


def check_path(path: str | Path) -> Path:
    """The path of a movie.  Raises InputError unless one can bear the name, and be written here."""
    path = Path(path)
    if path.suffix.lower() not in ENDINGS:
        raise InputError(f"a movie is written as {' or '.join(ENDINGS)}, got {path.name!r}")
    if path.suffix.lower() == ".mp4":
        _mp4()
    return path


def movie(scene: Scene, path: str | Path, of: str = "sweep", frames: int = FRAMES) -> None:
    """Write a movie (.gif or .mp4) of the scene: its telling sweep, or its growth.

    Raises InputError for an unknown subject or ending, where the scene lacks what the movie shows, where no one can render
    (growth), and for an .mp4 without imageio-ffmpeg.
    """
    path = check_path(path)
    if of not in MOVIES:
        raise InputError(f"a movie is of {' or '.join(MOVIES)}, got {of!r}")
    write = _gif if path.suffix.lower() == ".gif" else _mp4()
    with quiet():
        write(path, _sweep_frames(scene, frames) if of == "sweep" else _growth_frames(scene, frames))


def _gif(path: Path, images: Iterator[Image]) -> None:
    from PIL import Image as Pillow

    pictures = [Pillow.fromarray(image) for image in images]
    # the last one has all the colours
    palette = pictures[-1].quantize(_COLORS, dither=Pillow.Dither.NONE)
    mixed = np.array(palette.getpalette()).reshape(-1, 3)
    mixed[(mixed >= _WHITE).all(axis=1)] = 255  # paper is white
    palette.putpalette(mixed.ravel().tolist())
    small = [one.quantize(palette=palette, dither=Pillow.Dither.NONE) for one in pictures]
    each = 1000 // _PER_SECOND
    times = [each] * (len(small) - 1) + [each * _HELD]
    small[0].save(path, save_all=True, append_images=small[1:], duration=times, loop=0, optimize=False)


def _mp4() -> Any:
    try:
        ffmpeg = import_module("imageio_ffmpeg")
    except ImportError:
        raise InputError(NO_FFMPEG) from None

    def write(path: Path, images: Iterator[Image]) -> None:
        size = tuple(round(one * _DPI) for one in _SIZE)
        writer = ffmpeg.write_frames(str(path), size, fps=_PER_SECOND, macro_block_size=2, ffmpeg_log_level="error")
        writer.send(None)
        for image in images:
            writer.send(image)
        for _ in range(_HELD):
            writer.send(image)
        writer.close()

    return write


def _sheet() -> Any:
    figure = blank_figure(_SIZE[1], _DPI)
    assert figure.get_size_inches()[0] == _SIZE[0]
    return figure


def _shot(figure: Any) -> Image:
    """(height, width, 3) the figure as it is now."""
    figure.canvas.draw()
    return np.ascontiguousarray(np.asarray(figure.canvas.buffer_rgba())[:, :, :3])


def _sweep_frames(scene: Scene, frames: int) -> Iterator[Image]:
    """The plane of a slice: contour, clamp, rod and contacts so far; beside it the reactions."""
    one = shown_sweep(scene)
    assert scene.recording is not None
    rod, unit = scene.recording.rod, scene.unit.replace("um", "µm")
    origin, plane = one.base[0], one.axes[:2]

    def flat(points: Array) -> Array:
        return (points - origin) @ plane.T

    way = -flat(one.base)[:, 0]
    reactions = one.reactions * [rod.force_unit_N * 1e3, rod.force_unit_N * 1e3, rod.moment_unit_Nm * 1e6]
    figure = _sheet()
    scene_axes = figure.add_axes((0.01, 0.10, 0.56, 0.84))
    curves = figure.subplots(
        3, 1, sharex=True, gridspec_kw=dict(left=0.68, right=0.975, top=0.95, bottom=0.14, hspace=0.2)
    )
    lines, marks = [], []
    for axes, values, name in zip(
        curves, reactions.T, ("$f_{0x}$ in mN", "$f_{0y}$ in mN", "$m_{0z}$ in mN mm"), strict=True
    ):
        margin = 0.06 * (np.ptp(values) or 1.0)
        axes.set_ylim(values.min() - margin, values.max() + margin)
        axes.set_xlim(way[0], way[-1])
        axes.set_ylabel(name, fontsize=FONT - 1)
        axes.tick_params(labelsize=FONT - 3)
        axes.spines[["top", "right"]].set_visible(False)
        axes.plot(way, values, color="#dddddd", lw=1)
        lines.append(axes.plot([], [], color=ROD, lw=2)[0])
        marks.append(axes.plot([], [], "o", color=ROD, ms=5)[0])
    figure.align_ylabels(curves)
    curves[-1].set_xlabel(f"way of the clamp in {unit}", fontsize=FONT - 1)

    ring = next(ring for ring, mine in outlines(scene) if mine == one.slice)
    outline, base = flat(ring), flat(one.base)
    shapes = [flat(np.concatenate([a, b[1:]])) for a, b in zip(one.curved, one.straight, strict=True)]
    scene_axes.fill(*outline.T, facecolor=BODY, edgecolor=SLICE, lw=1)
    scene_axes.plot(base[[0, -1], 0], base[[0, -1], 1], color=INK, lw=0.8)
    everything = np.concatenate([outline, *shapes])
    low, high = everything.min(axis=0), everything.max(axis=0)
    room = 0.05 * np.ptp(everything, axis=0).max()
    scene_axes.set_xlim(low[0] - room, high[0] + room)
    scene_axes.set_ylim(low[1] - room, high[1] + room)
    scene_axes.set_aspect("equal")
    scene_axes.set_axis_off()
    figure.text(0.02, 0.03, f"{scene.name}, slice {one.slice}, sweep {one.number}", fontsize=FONT - 1, va="center")
    trace = scene_axes.plot([], [], ".", color=TANGENTIAL, ms=4)[0]
    bent = scene_axes.plot([], [], color=ROD, lw=2.5, solid_capstyle="round")[0]
    clamp = scene_axes.plot([], [], "s", color=INK, ms=9)[0]
    contact = scene_axes.plot([], [], "o", color=TANGENTIAL, ms=7)[0]
    touched = flat(one.contact)
    for k in _frame_numbers(len(way), frames):
        bent.set_data(*shapes[k].T)
        trace.set_data(*touched[: k + 1].T)
        clamp.set_data(*base[k : k + 1].T)
        contact.set_data(*touched[k : k + 1].T)
        for line, mark, values in zip(lines, marks, reactions.T, strict=True):
            line.set_data(way[: k + 1], values[: k + 1])
            mark.set_data(way[k : k + 1], values[k : k + 1])
        yield _shot(figure)


def _growth_frames(scene: Scene, frames: int) -> Iterator[Image]:
    """The hull of the contacts of more and more slices."""
    from scan3d.geometry.hulls import hull

    numbers = scene.column("slice")
    if numbers is None:
        raise InputError(
            f"{scene.name} does not say which slices its contacts lie in; show a scan's folder, or a recording"
        )
    need_renderer()
    order, points = np.unique(numbers), scene.points
    figure = _sheet()
    canvas = Canvas(points)
    caption = figure.text(0.02, 0.03, "", fontsize=FONT - 1, va="center")
    axes = None
    for k in _frame_numbers(len(order), frames):
        mine = points[numbers <= order[k]]
        actors = [canvas.add_points(mine, TANGENTIAL, 3)]
        with suppress(InputError):  # the contacts of one slice span no body yet
            actors.append(canvas.add_body(hull(mine), BODY))
        image = canvas.image(*(round(share * one * _DPI) for share, one in zip((1.0, 0.92), _SIZE, strict=True)))[0]
        for actor in actors:
            canvas.plotter.remove_actor(actor, render=False)
        if axes is None:
            axes = figure.add_axes((0, 0.08, 1, 0.92))
            axes.set_axis_off()
            shown = axes.imshow(image, interpolation="nearest", aspect="auto")
        shown.set_data(image)
        caption.set_text(f"{scene.name}: {k + 1} of {len(order)} slices, {len(mine)} contacts")
        yield _shot(figure)
    canvas.plotter.close()


def _frame_numbers(count: int, frames: int) -> NDArray[np.integer]:
    """So many of the numbers below `count`, evenly, the first and the last among them."""
    return np.unique(np.linspace(0, count - 1, min(frames, count)).round().astype(int))
