"""Movies: the body grows slice by slice, or sweep by sweep, and the rod moves along it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scan3d.arrays import Array
from scan3d.errors import InputError
from scan3d.geometry.hulls import hull
from scan3d.pictures.canvas import DIRECTION, Canvas
from scan3d.pictures.figures import blank_figure, own_style
from scan3d.pictures.parts import (
    BODY,
    TANGENTIAL,
    ShownSweep,
    has_rods,
    is_spatial,
    shown_sweep,
)
from scan3d.pictures.rendering import need_renderer
from scan3d.pictures.scene import Scene
from scan3d.pictures.sheet import FONT

ENDINGS = (".gif", ".mp4")
NO_FFMPEG = (
    "an .mp4 needs the package imageio-ffmpeg: 'pip install imageio-ffmpeg'; or write a .gif, which needs nothing"
)
_PER_SECOND = 12
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


def movie(scene: Scene, path: str | Path, frames: int = 8 * _PER_SECOND) -> None:
    """Write a movie (.gif or .mp4) of the body as it grows, with so many frames; a GIF of 96 frames has about a megabyte.

    Raises InputError for an unknown ending, where the scene has no contacts, where nothing can be rendered, and for an .mp4
    without imageio-ffmpeg.
    """
    path = check_path(path)
    write = _write_gif if path.suffix.lower() == ".gif" else _write_mp4
    with own_style():
        write(path, _frames(scene.in_shown_unit(), frames))


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


def _frames(scene: Scene, frames: int) -> Iterator[Image]:
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
        figure.canvas.draw()
        yield np.ascontiguousarray(np.asarray(figure.canvas.buffer_rgba())[:, :, :3])
    canvas.plotter.close()


def _front_sweeps(scene: Scene, numbers: Array, parts: Array) -> list[ShownSweep]:
    """Of each slice the sweep whose contacts face the camera most; where there are no slices, the sweeps themselves."""
    sweeps, toward = scene.column("sweep"), np.asarray(DIRECTION)
    assert sweeps is not None
    depth = (scene.points - scene.points.mean(axis=0)) @ toward
    of_parts = (np.unique(sweeps[parts == number]) for number in numbers)
    return [shown_sweep(scene, max(of_part, key=lambda one: depth[sweeps == one].mean())) for of_part in of_parts]
