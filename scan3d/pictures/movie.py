"""Movies: the rod along one sweep with its reactions, and the body growing slice by slice, or sweep by sweep."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from scan3d.arrays import Array
from scan3d.choices import MOVIES
from scan3d.errors import InputError
from scan3d.geometry.hulls import hull
from scan3d.pictures.canvas import DIRECTION, Canvas
from scan3d.pictures.figures import REACTION_LABELS, SPATIAL_LABELS, blank_figure, open_axes, own_style
from scan3d.pictures.parts import (
    BODY,
    INK,
    REACTION_COLORS,
    ROD,
    SLICE,
    TANGENTIAL,
    ShownSweep,
    evenly_chosen,
    has_rods,
    is_spatial,
    outlines,
    shown_sweep,
    sweep_direction,
)
from scan3d.pictures.rendering import need_renderer
from scan3d.pictures.scene import Scene
from scan3d.pictures.sheet import FONT
from scan3d.units import unit_symbol

ENDINGS = (".gif", ".mp4")
NO_FFMPEG = (
    "an .mp4 needs the package imageio-ffmpeg: 'pip install imageio-ffmpeg'; or write a .gif, which needs nothing"
)
_PER_SECOND = 12
FRAMES = {"sweep": 5 * _PER_SECOND, "growth": 8 * _PER_SECOND}
"""Frames of a movie of each subject; a GIF has about a megabyte."""
# The last frame is shown for so many frames, so that the result can be looked at before the movie starts again.
_HELD = 3 * _PER_SECOND // 2
# Inches and pixels to the inch: 980 by 560 pixels, even numbers, which video codecs need.
_SIZE, _DPI = (7.0, 4.0), 140
# Height of the rendered body as a fraction of the frame; the caption is below.
_BODY_HEIGHT = 0.92

MARK = b"scan3d"
"""The comment in a movie, by which it is recognised as written by this program."""

Image = NDArray[np.uint8]


def check_path(path: str | Path) -> Path:
    """The path of a movie.  Raises InputError for an ending other than those in `ENDINGS`, and for .mp4 without ffmpeg."""
    path = Path(path)
    if path.suffix.lower() not in ENDINGS:
        raise InputError(f"a movie is written as {' or '.join(ENDINGS)}, got {path.name!r}")
    if path.suffix.lower() == ".mp4":
        _ffmpeg()
    return path


def movie(scene: Scene, path: str | Path, subject: str = "sweep", frames: int | None = None) -> None:
    """Write a movie (.gif or .mp4) of the scene: its most informative sweep, or the growth of the body.

    subject
        one of `scan3d.choices.MOVIES`.
    frames
        the number of frames; of a sweep at most the number of samples.

    Raises InputError for an unknown subject or ending, where the scene lacks what the movie shows, where nothing can be
    rendered (growth), and for an .mp4 without imageio-ffmpeg.
    """
    path = check_path(path)
    if subject not in MOVIES:
        raise InputError(f"a movie is of {' or '.join(MOVIES)}, got {subject!r}")
    scene = scene.in_shown_unit()
    write = _write_gif if path.suffix.lower() == ".gif" else _write_mp4
    with own_style():
        write(path, (_sweep_frames if subject == "sweep" else _growth_frames)(scene, frames or FRAMES[subject]))


def _write_gif(path: Path, images: Iterator[Image]) -> None:
    from PIL import Image as Pillow

    frames = [Pillow.fromarray(image) for image in images]
    # the last frame has all the colours; 128 show no steps in the shading
    palette = frames[-1].quantize(128, dither=Pillow.Dither.NONE)
    colors = np.array(palette.getpalette()).reshape(-1, 3)
    colors[(colors >= 245).all(axis=1)] = 255  # paper is not grey
    palette.putpalette(colors.ravel().tolist())
    first, *rest = [frame.quantize(palette=palette, dither=Pillow.Dither.NONE) for frame in frames]
    duration_ms = 1000 // _PER_SECOND
    times = [duration_ms] * len(rest) + [duration_ms * _HELD]
    first.save(path, save_all=True, append_images=rest, duration=times, loop=0, optimize=False, comment=MARK)


def _write_mp4(path: Path, images: Iterator[Image]) -> None:
    size = tuple(round(inches * _DPI) for inches in _SIZE)
    writer = _ffmpeg().write_frames(
        str(path),
        size,
        fps=_PER_SECOND,
        macro_block_size=2,
        ffmpeg_log_level="error",
        output_params=["-metadata", f"comment={MARK.decode()}"],
    )
    writer.send(None)
    for image in images:
        writer.send(image)
    for _ in range(_HELD):
        writer.send(image)
    writer.close()


def _ffmpeg() -> Any:
    try:
        return import_module("imageio_ffmpeg")
    except ImportError:
        raise InputError(NO_FFMPEG) from None


def _pixels(figure: Any) -> Image:
    """(height, width, 3) the figure as it is now."""
    figure.canvas.draw()
    return np.ascontiguousarray(np.asarray(figure.canvas.buffer_rgba())[:, :, :3])


def _sweep_frames(scene: Scene, frames: int) -> Iterator[Image]:
    """A slice's plane, or the body in space, with clamp, rod and contacts so far; beside it the reactions over the travel."""
    sweep = shown_sweep(scene)
    assert scene.recording is not None
    rod, x, origin = scene.recording.rod, sweep.axes[0], sweep.base[0]
    moments = sweep.reactions.shape[1] // 2
    units = [1e3 * rod.force_unit_N] * (sweep.reactions.shape[1] - moments) + [1e6 * rod.moment_unit_Nm] * moments
    if sweep.slice is None:
        caption, labels, views = f"sweep {sweep.number}", SPATIAL_LABELS, _projection(sweep)
    else:
        caption, labels = f"slice {sweep.slice}, sweep {sweep.number}", [[label] for label in REACTION_LABELS]
        views = sweep.axes[:2]

    def in_plane(points: Array) -> Array:
        coordinates: Array = (points - origin) @ views.T
        return coordinates

    base, contacts, rods = in_plane(sweep.base), in_plane(sweep.contact), in_plane(sweep.rods)
    travel = -(sweep.base - origin) @ x
    figure = blank_figure(_SIZE[1], _DPI, _SIZE[0])
    axes = _plane_axes(figure, in_plane(_outline(scene, sweep, views)), rods, base)
    curves = _reaction_axes(figure, travel, sweep.reactions * units, labels, unit_symbol(scene.unit))
    figure.text(0.02, 0.03, f"{scene.name}, {caption}", fontsize=FONT - 1, va="center")
    trace = axes.plot([], [], ".", color=TANGENTIAL, ms=4)[0]
    bent = axes.plot([], [], color=ROD, lw=2.5, solid_capstyle="round")[0]
    clamp = axes.plot([], [], "s", color=INK, ms=9)[0]
    contact = axes.plot([], [], "o", color=TANGENTIAL, ms=7)[0]
    for k in evenly_chosen(len(travel), frames):
        bent.set_data(*rods[k].T)
        trace.set_data(*contacts[: k + 1].T)
        clamp.set_data(*base[k : k + 1].T)
        contact.set_data(*contacts[k : k + 1].T)
        for curve, mark, values in curves:
            curve.set_data(travel[: k + 1], values[: k + 1])
            mark.set_data(travel[k : k + 1], values[k : k + 1])
        yield _pixels(figure)


def _projection(sweep: ShownSweep) -> Array:
    """(2, 3) directions to the right and up of a picture of a sweep in space, seen as in the view explain."""
    toward = sweep_direction(sweep)
    toward /= np.linalg.norm(toward)
    right = np.cross(sweep.axes[2], toward)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(toward, right)])


def _outline(scene: Scene, sweep: ShownSweep, views: Array) -> Array:
    """(p, 3) the outline of the sweep's slice, or of the body as it is seen in space."""
    if sweep.slice is not None:
        return next(line for line, number in outlines(scene) if number == sweep.slice)
    points = scene.points if scene.truth is None else np.asarray(scene.truth.vertices)
    corners: Array = points[ConvexHull(points @ views.T).vertices]
    return corners


def _reaction_axes(
    figure: Any, travel: Array, reactions: Array, labels: list[list[str]], unit: str
) -> list[tuple[Any, Any, Array]]:
    """Axes of the reactions (k, c) in mN and mN mm, in grey; of each its coloured curve and mark, still empty, and its values.

    `labels` are those of the axes, each followed by the names of its reactions if there are several.
    """
    all_axes = figure.subplots(
        len(labels), 1, sharex=True, gridspec_kw=dict(left=0.68, right=0.975, top=0.95, bottom=0.14, hspace=0.2)
    )
    curves, columns = [], iter(reactions.T)
    for axes, (label, *names) in zip(all_axes, labels, strict=True):
        group = [next(columns) for _ in names or [label]]
        low, high = min(values.min() for values in group), max(values.max() for values in group)
        margin = 0.06 * ((high - low) or 1.0)
        axes.set_ylim(low - margin, high + margin)
        axes.set_xlim(travel[0], travel[-1])
        axes.set_ylabel(label, fontsize=FONT - 1)
        open_axes(axes, FONT - 3)
        for values, color in zip(group, REACTION_COLORS, strict=False):
            axes.plot(travel, values, color="#dddddd", lw=1)
            curve, mark = axes.plot([], [], color=color, lw=2)[0], axes.plot([], [], "o", color=color, ms=5)[0]
            curves.append((curve, mark, values))
        if names:
            handles = [curve for curve, _, _ in curves[-len(names) :]]
            axes.legend(handles, names, ncols=3, frameon=False, fontsize=FONT - 3, loc="lower center",
                        bbox_to_anchor=(0.5, 0.96), handlelength=1, columnspacing=1, borderpad=0)  # fmt: skip
    figure.align_ylabels(all_axes)
    all_axes[-1].set_xlabel(f"clamp travel in {unit}", fontsize=FONT - 1)
    return curves


def _plane_axes(figure: Any, outline: Array, rods: Array, base: Array) -> Any:
    """Axes of the slice's plane with its outline (p, 2) and the base line, wide enough for all rods (k, p, 2)."""
    axes = figure.add_axes((0.01, 0.10, 0.56, 0.84))
    axes.fill(*outline.T, facecolor=BODY, edgecolor=SLICE, lw=1)
    axes.plot(base[[0, -1], 0], base[[0, -1], 1], color=INK, lw=0.8)
    points = np.concatenate([outline, *rods])
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.05 * (high - low).max()
    axes.set_xlim(low[0] - margin, high[0] + margin)
    axes.set_ylim(low[1] - margin, high[1] + margin)
    axes.set_aspect("equal")
    axes.set_axis_off()
    return axes


def _growth_frames(scene: Scene, frames: int) -> Iterator[Image]:
    """The hull of the contacts of more and more slices, or sweeps where there are no slices, with a rod along one of them."""
    name = "sweep" if is_spatial(scene) else "slice"
    parts = scene.column(name)
    if parts is None:
        raise InputError(
            f"{scene.name} does not say which slices its contacts lie in; show a scan's folder, or a recording"
        )
    need_renderer()
    numbers, points = np.unique(parts), scene.points
    if name == "slice":  # from one end to the other, however they were planned
        middles = np.array([points[parts == number].mean(axis=0) for number in numbers])
        numbers = numbers[np.argsort(middles[:, np.ptp(middles, axis=0).argmax()], kind="stable")]
    order = np.argsort(numbers)
    place = order[np.searchsorted(numbers, parts, sorter=order)]
    sweeps = _front_sweeps(scene, numbers, parts) if has_rods(scene) else []
    figure = blank_figure(_SIZE[1], _DPI, _SIZE[0])
    canvas = Canvas(np.concatenate([points, *(sweep.rods.reshape(-1, 3) for sweep in sweeps)]))
    caption = figure.text(0.02, 0.03, "", fontsize=FONT - 1, va="center")
    axes = figure.add_axes((0, 1 - _BODY_HEIGHT, 1, _BODY_HEIGHT))
    width, height = round(_SIZE[0] * _DPI), round(_BODY_HEIGHT * _SIZE[1] * _DPI)
    for done in np.linspace(0, len(numbers), frames + 1)[1:]:
        k = int(np.ceil(done)) - 1
        rows = np.flatnonzero(place == k)
        so_far = rows[: int(np.ceil((done - k) * len(rows)))]
        selected = np.concatenate([points[place < k], points[so_far]])
        actors = [canvas.add_points(selected, TANGENTIAL, 3)]  # smaller than in pictures, as frames are
        with suppress(InputError):  # the contacts of one slice or sweep span no body yet
            actors.append(canvas.add_body(hull(selected), BODY))
        if sweeps:
            last = len(sweeps[k].base) - 1
            actors += canvas.add_rods(sweeps[k], np.array([round((done - k) * last)]))
        image, _ = canvas.image(width, height)
        for actor in actors:
            canvas.plotter.remove_actor(actor, render=False)
        axes.clear()
        axes.set_axis_off()
        axes.imshow(image, interpolation="nearest", aspect="auto")
        caption.set_text(f"{scene.name}: {k + 1} of {len(numbers)} {name}s, {len(selected):,} contacts")
        yield _pixels(figure)
    canvas.plotter.close()


def _front_sweeps(scene: Scene, numbers: Array, parts: Array) -> list[ShownSweep]:
    """Of each slice the sweep whose contacts face the camera most; where there are no slices, the sweeps themselves."""
    sweeps, toward = scene.column("sweep"), np.asarray(DIRECTION)
    assert sweeps is not None
    depth = (scene.points - scene.points.mean(axis=0)) @ toward
    of_parts = (np.unique(sweeps[parts == number]) for number in numbers)
    return [shown_sweep(scene, max(of_part, key=lambda one: depth[sweeps == one].mean())) for of_part in of_parts]
