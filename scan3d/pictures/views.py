"""Pictures of a scan: bodies are rendered off screen by VTK; matplotlib adds colour bars, legends and labels, and draws charts.

In movies the body grows slice by slice, or sweep by sweep, and the rod moves along it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

import planar
from scan3d.arrays import Array, Index, evenly, weighted_quantiles
from scan3d.choices import CHARTS, VIEWS, one_of
from scan3d.errors import InputError
from scan3d.geometry.hulls import hull
from scan3d.pictures import figures, parts
from scan3d.pictures.canvas import Canvas, need_renderer
from scan3d.pictures.figures import FONT, Sheet, blank_figure, own_style
from scan3d.pictures.parts import DIRECTION, TANGENTIAL, Scene, ShownSweep, has_rods, shown_sweep
from scan3d.units import FORCES, MOMENTS, UNITS_M, number, reaction_unit, share, unit_symbol
from scan3d.workers import told

if TYPE_CHECKING:
    from scan3d.laboratory.importing import Imported
    from scan3d.laboratory.one_sweep import SweepContacts

PICTURES = (".png", ".pdf", ".svg")
# In sizes of letters: the margin around a picture, and the room of a colour bar or a legend before it is measured.
_MARGIN, _BESIDE = 0.8, 8.0
# The line and the contacts of the sweep are moved toward the camera by this fraction of the size, so that no parts of the line
# are hidden in the body.
_FORWARD = 0.01


def check_path(path: str | Path, endings: tuple[str, ...] = PICTURES, what: str = "picture") -> Path:
    """The path of a picture, or of what else has these endings.  Raises InputError for others."""
    path = Path(path)
    if path.suffix.lower() not in endings:
        raise InputError(f"a {what} is written as {one_of(endings)}, got {path.name!r}")
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
        is_tip = color == "friction" and np.any(scene.column("phase") == planar.Phase.TIP)
        right = figures.color_bar(figure, shaded, sheet, unknown="tip contact" if is_tip else "")
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
            f"the view compare needs the true body of {scene.name}, which is unknown, or was not found as it was scanned in "
            "this folder and those in it: give --truth MESH (in Python truth=)"
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
    place = _place(figure, sheet, sheet.width - _MARGIN * sheet.em, bottom)
    figures.show_canvas(figure, canvas, place, sheet, scene.unit)
    return figure


def _sweep_canvas(scene: Scene, sweep: parts.ShownSweep, sheet: Sheet) -> Canvas:
    """The canvas of one sweep without its rods: body, slices and base line, seen from above the base line."""
    x, _, z = sweep.axes
    rod_points = sweep.rods.reshape(-1, 3)
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
    lines = [(line, of) for line, of in parts.sections(scene)[1] if (np.abs((line - middle) @ z) < reach).all()]
    # paths in space cross each other: more cover the body
    for k in evenly(np.arange(len(lines)), 60 if sweep.slice is None else len(lines)):
        canvas.add_lines(lines[k][0][None], parts.SLICE, 1)
    for line, of in lines:
        if of == drawn:
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


# --- charts by matplotlib alone, which need no renderer ---


# Share of a histogram's height that its axes have.
_HISTOGRAM_HEIGHT = 0.6


def reactions(scene: Scene, sheet: Sheet) -> Any:
    """A figure of the support reactions over the clamp travel, with a curve for every sweep: three panels, or six.

    Probings are drawn where there is nothing else.  Of more than 60 sweeps, which merge into a grey area, as many are drawn.
    Raises InputError without a recording.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.ticker import MaxNLocator

    if (recording := scene.recording) is None:
        raise InputError(
            f"{scene.name} has no recording, whose reactions the view forces shows: show a scan's folder, or a recording"
        )
    probing = recording.in_probings  # which are two samples each
    numbers = np.unique(recording.sweep[~probing] if not probing.all() else recording.sweep)
    colors = ScalarMappable(Normalize(float(numbers[0]), float(max(numbers[-1], numbers[0] + 1))), "viridis")
    force, moment = recording.wrench() if recording.six_axis else (recording.force_N, recording.moment_Nm)
    wrench = np.column_stack([force, moment])
    names, units, sizes = _reactions(wrench)
    values = wrench / sizes
    figure = figures.chart(7 / 5, sheet)
    columns = figure.subplots(3, len(names) // 3, sharex=True, squeeze=False).T
    panels = columns.ravel()
    scale = 1 / UNITS_M[recording.unit]
    for sweep in evenly(numbers, 60):
        rows = recording.sweep == sweep
        position = recording.position_m[rows]
        travel = scale * np.linalg.norm(position - position[0], axis=1)
        for axes, column in zip(panels, values[rows].T, strict=True):
            axes.plot(travel, column, color=colors.to_rgba(sweep), lw=0.8 / 12 * sheet.font)
    for axes, name, unit in zip(panels, names, units, strict=True):
        # above the panel, because panels may be lower than their label is long
        axes.set_title(f"{name} in {unit}", fontsize=sheet.font - 1, loc="left", pad=0.25 * sheet.font)
        figures.open_axes(axes, sheet.font - 2)
        axes.margins(x=0.01)
        axes.yaxis.set_major_locator(figures.ticks(0.7 * figure.get_figheight() / 3, sheet, 1.8, 4))
        axes.xaxis.set_major_locator(figures.ticks(0.7 * sheet.width / len(columns), sheet, 4.0, 8))
    for column in columns:
        column[-1].set_xlabel(f"clamp travel in {unit_symbol(recording.unit)}", fontsize=sheet.font)
    if len(numbers) > 1:
        bar = figure.colorbar(colors, ax=panels, shrink=0.85, aspect=30, pad=0.02)
        bar.locator = MaxNLocator(6, integer=True)
        bar.ax.tick_params(labelsize=sheet.font - 1)
        bar.outline.set_linewidth(0.05 * sheet.font)
        bar.set_label("number of the sweep", fontsize=sheet.font)
    return figure


def _reactions(wrench: Array) -> tuple[list[str], list[str], Array]:
    """Names of support reactions (n, 6) in space or (n, 3) in a plane, the units of their size, and these in SI units (c,)."""
    names = [f"${quantity}_{{0{axis}}}$" for quantity in "fm" for axis in "xyz"]
    names = names if wrench.shape[1] == 6 else [names[0], names[1], names[5]]
    shown = {}
    for kind, units in (("f", FORCES), ("m", MOMENTS)):
        columns = wrench[:, [kind in name for name in names]]
        shown[kind] = reaction_unit(float(np.nanmax(np.abs(columns), initial=0.0)), units)
    return names, [shown[name[1]][0] for name in names], np.array([float(shown[name[1]][1]) for name in names])


def histograms(scene: Scene, sheet: Sheet) -> Any:
    """A figure with the histograms of the deviation and of the bound, of those that are known.

    Values at the vertices count by the area around them, and vertices without a finite bound are left out, with their share of
    the area stated.  Raises InputError without a surface, and without either of the two.
    """
    if scene.surface is None:
        raise InputError(f"{scene.name} has no surface, whose deviation and bound the view histogram shows")
    mesh, deviation, bound, _ = parts.shown_surface(scene)
    shown: list[tuple[str, Array, str]] = []
    if deviation is not None:
        shown.append((scene.deviation_title, deviation, parts.ROD))
    if bound is not None and np.isfinite(bound).any():
        shown.append((scene.bound_title, bound, parts.BOUND))
    if not shown:
        raise InputError(
            f"neither the deviation nor the bound of {scene.name} is known, which the view histogram shows: give --truth MESH "
            "(in Python truth=), or show a scan's folder"
        )
    area = parts.area_of_vertices(mesh)
    figure = figures.chart((1.8, 2.3)[len(shown) - 1], sheet)
    panels = figure.subplots(1, len(shown), squeeze=False)[0]
    for axes, (title, lengths, color) in zip(panels, shown, strict=True):
        values, unit = parts.shown_lengths(lengths, scene.unit)
        _histogram(axes, values, area, sheet, 0.8 * sheet.width / len(shown), f"{title} in {unit}", color)
    height = _HISTOGRAM_HEIGHT * figure.get_figheight()
    panels[0].set_ylabel(figures.wrapped("share of the surface in %", height, sheet), fontsize=sheet.font)
    return figure


def _histogram(axes: Any, values: Array, area: Array, sheet: Sheet, width: float, title: str, color: str) -> None:
    """A histogram of values (v,), by area (v,), with its quantiles, about so many inches wide."""
    known = np.isfinite(values)
    low, high = min(float(values[known].min()), 0.0), max(float(values[known].max()), 0.0)
    if low == high:
        high = 1.0
    shares, edges = np.histogram(values[known], 40, (low, high), weights=100 * area[known] / area.sum())
    axes.stairs(shares, edges, fill=True, color=color)
    if low < 0 < high:
        axes.axvline(0.0, color=parts.INK, lw=0.06 * sheet.font)
    axes.set_xlim(low, high)
    axes.set_ylim(0.0)
    figures.open_axes(axes, sheet.font - 1)
    axes.xaxis.set_major_locator(figures.ticks(width, sheet, 3.3, 5))
    axes.yaxis.set_major_locator(figures.ticks(_HISTOGRAM_HEIGHT * axes.figure.get_figheight(), sheet, 2.0, 5))
    figures.in_powers(axes.xaxis, sheet)
    axes.set_xlabel(figures.wrapped(title, width, sheet), fontsize=sheet.font)
    quantiles = weighted_quantiles(values[known], area[known], (0.05, 0.5, 0.95))
    digits = 2 - int(np.floor(np.log10(high - low)))
    lower, median, upper = (number(round(value, digits)) for value in quantiles)
    text = f"median {median}, 90 % from {lower} to {upper}".replace("-", "−")
    if not known.all():
        text += f", unknown on {share(area[~known].sum() / area.sum())}"
    axes.set_title(figures.wrapped(text, width, sheet), fontsize=sheet.font - 1)


def draw(figure: Callable[[Any], Any], found: SweepContacts | Imported, path: str | Path) -> None:
    """Draw the `sweep_figure` of a sweep, or the `import_figure` of a table, into a file."""
    with figures.own_style():
        figures.save(figure(found), Path(path))


def sweep_figure(found: SweepContacts) -> Any:
    """A matplotlib figure of a sweep: the contour to scale, and below it the friction over x.

    Where errors are known, some contacts have bars of two standard deviations.
    """
    scale, unit = (1e3 * found.sweep.rod.length_m, "mm") if found.sweep.rod else (1.0, "rod lengths")
    points, friction, tangential = scale * found.contacts.point, found.contacts.friction, found.tangential
    figure = figures.blank_figure(6.0)
    figure.set_layout_engine("constrained")
    above, below = figure.subplots(2, 1, height_ratios=(3, 2))
    replace(found.contacts, point=points).plot(axes=above).legend(frameon=False)
    below.plot(points[tangential, 0], friction[tangential], "o", color=parts.TANGENTIAL, markersize=3.5)
    # contacts at which the rod touched lightly do not determine the limits
    certain = found.touching & ~(found.errors.largest > 4 * np.median(found.errors.largest[found.touching]))
    low, high = points[certain].min(axis=0), points[certain].max(axis=0)
    room = 0.06 * (float((high - low).max()) or 1.0)
    above.set(xlim=(low[0] - room, high[0] + room), ylim=(low[1] - room, high[1] + room), ylabel=f"y in {unit}")
    below.set(xlim=above.get_xlim(), xlabel=f"x in {unit}", ylabel="friction $\\mu$")
    above.set_xlabel("")
    if (certain & tangential).any():
        median = float(np.median(friction[certain & tangential]))
        half = max(1.1 * float(np.abs(friction[certain & tangential] - median).max()), 0.05)
        below.set_ylim(median - half, median + half)
    if found.noisy:
        chosen = np.flatnonzero(found.touching)
        some = evenly(chosen, 60)  # more would merge into an area
        # an expanded uncertainty, about 95 %
        sd, x = 2 * scale * found.point_sd[some], points[some, 0]
        bars: dict[str, Any] = {"fmt": "none", "ecolor": parts.UNKNOWN, "elinewidth": 0.8, "zorder": 0}
        above.errorbar(x, points[some, 1], sd[:, 1], sd[:, 0], **bars)
        below.errorbar(x, friction[some], 2 * found.friction_sd[some], **bars)
    return figure


def import_figure(imported: Imported) -> Any:
    """A matplotlib figure of what became of a laboratory's table.

    Left what the sensor showed, with its stretches in the air and its zero; right the support reactions in the clamp's frame,
    with the sweeps.
    """
    clock = imported.clock - imported.clock[0]
    figure = figures.chart(2.0, Sheet(width=10.0))
    panels = figure.subplots(2, 2, sharex=True)
    within = imported.sweep >= 0
    sweeps = [within, within & (imported.sweep % 2 == 1)]  # neighbours in two shades
    sides = (
        ("the sensor; blue: in the air, dashed: zero", imported.log.wrench, imported.zero, [imported.air], parts.ROD),
        ("at the clamp; grey: sweeps", imported.wrench, None, sweeps, parts.UNKNOWN),
    )
    for side, (title, wrench, zero, marked, shade) in enumerate(sides):
        names, units, sizes = _reactions(wrench)
        for part, axes in enumerate(panels[:, side]):
            across = axes.get_xaxis_transform()
            for rows in marked:
                axes.fill_between(clock, 0, 1, where=rows, color=shade, alpha=0.25, lw=0, transform=across)
            for column, color in zip(range(3 * part, 3 * part + 3), parts.REACTION_COLORS, strict=True):
                axes.plot(clock, wrench[:, column] / sizes[column], color=color, lw=0.8, label=names[column])
                if zero is not None and len(zero) == len(clock):
                    axes.plot(clock, zero[:, column] / sizes[column], color=parts.INK, lw=0.9, ls="--")
            axes.set_ylabel(f"{('force', 'moment')[part]} in {units[3 * part]}", fontsize=FONT - 2)
            figures.open_axes(axes, FONT - 3)
            above = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.0}
            axes.legend(fontsize=FONT - 3, frameon=False, ncols=3, columnspacing=1.0, handlelength=1.2, **above)
        panels[0, side].set_title(title, loc="left", fontsize=FONT - 1, pad=18)
        panels[1, side].set_xlabel("row" if imported.log.time_s is None else "time in s", fontsize=FONT - 2)
    return figure


# --- movies ---


MOVIES = (".gif",)
_PER_SECOND = 12
# The last frame is shown for so many frames, so that the result can be looked at before the movie starts again.
_HELD = 3 * _PER_SECOND // 2
# Inches and pixels to the inch: 980 by 560 pixels.
_SIZE, _DPI = (7.0, 4.0), 140

MARK = b"scan3d"
"""The comment in a movie, by which it is recognised as written by this program."""

Image = NDArray[np.uint8]


def movie(scene: Scene, path: str | Path, frames: int = 8 * _PER_SECOND) -> None:
    """Write a movie (.gif) of the body as it grows, with so many frames; one of 96 has about a megabyte.

    Raises InputError for another ending, where the scene has no contacts, and where nothing can be rendered.
    """
    from PIL import Image as Pillow

    path = check_path(path, MOVIES, "movie")
    with own_style():
        images = [Pillow.fromarray(image) for image in _frames_of_movie(scene.in_shown_unit(), frames)]
    # the colours of thin rods, which cover little, count as well
    some = Pillow.fromarray(np.vstack([np.asarray(image) for image in images[:: max(1, len(images) // 6)]]))
    palette = some.quantize(256, Pillow.Quantize.MAXCOVERAGE, dither=Pillow.Dither.NONE)
    colors = np.array(palette.getpalette()).reshape(-1, 3)
    colors[(colors >= 245).all(axis=1)] = 255  # paper is not grey
    palette.putpalette(colors.ravel().tolist())
    first, *rest = [image.quantize(palette=palette, dither=Pillow.Dither.NONE) for image in images]
    duration_ms = 1000 // _PER_SECOND
    times = [duration_ms] * len(rest) + [duration_ms * _HELD]
    first.save(path, save_all=True, append_images=rest, duration=times, loop=0, optimize=False, comment=MARK)


class _Stage(NamedTuple):
    """What a frame of a movie shows."""

    contacts: Index
    """(c,) row of each contact so far"""
    body: Any
    """None where the contacts span none yet"""
    color: Any
    rod: ShownSweep | None
    sample: int
    """of the rod's sweep"""
    caption: str


def _frames_of_movie(scene: Scene, frames: int) -> Iterator[Image]:
    if parts.is_hollow(scene):
        stages, middle = list(_by_touches(scene, frames)), scene.points.mean(axis=0)
        corners = middle + 1.3 * (scene.points - middle)  # room for a part of the rods
    else:
        stages = list(_by_slices(scene, frames))
        corners = np.concatenate([scene.points, *(stage.rod.rods.reshape(-1, 3) for stage in stages if stage.rod)])
    need_renderer()
    figure = blank_figure(_SIZE[1], _DPI, _SIZE[0])
    canvas = Canvas(corners)
    caption = figure.text(0.02, 0.03, "", fontsize=FONT - 1, va="center")
    part = 0.92  # of the height, above the caption
    axes = figure.add_axes((0, 1 - part, 1, part))
    width, height = round(_SIZE[0] * _DPI), round(part * _SIZE[1] * _DPI)
    for stage in told(stages, "frames"):
        actors = [
            canvas.add_points(scene.points[stage.contacts], TANGENTIAL, 3)
        ]  # smaller than in pictures, as frames are
        if stage.body is not None:
            actors.append(
                canvas.add_body(stage.body, stage.color, edges=scene.surface if parts.is_hollow(scene) else None)
            )
        if stage.rod is not None:
            actors += canvas.add_rods(stage.rod, np.array([stage.sample]))
        image, _ = canvas.image(width, height)
        for actor in actors:
            canvas.plotter.remove_actor(actor, render=False)
        axes.clear()
        axes.set_axis_off()
        axes.imshow(image, interpolation="nearest", aspect="auto")
        caption.set_text(f"{scene.name}: {stage.caption}, {len(stage.contacts):,} contacts")
        figure.canvas.draw()
        yield np.ascontiguousarray(np.asarray(figure.canvas.buffer_rgba())[:, :, :3])
    canvas.plotter.close()


def _by_touches(scene: Scene, frames: int) -> Iterator[_Stage]:
    """The surface of a body that is not convex, as far as it was touched up to one sweep after another; at last the rest."""
    import pyvista

    stated = scene.column("sweep")
    sweeps = np.arange(float(len(scene.points))) if stated is None else stated
    order, of_all = np.argsort(sweeps, kind="stable"), len(np.unique(sweeps))
    mesh, shaded = parts.shade_surface(scene)
    color = parts.BODY if shaded is None else shaded.rgb
    touched = np.argsort(order)[cKDTree(scene.points).query(mesh.vertices)[1]]
    touched[np.asarray(parts.shown_surface(scene)[3]) < 2] = len(order) - 1  # what is estimated or unknown
    for count in np.ceil(np.linspace(0, len(order), frames + 1)[1:]).astype(int):
        faces = mesh.faces[(touched[mesh.faces] < count).all(axis=1)]
        so_far = sweeps[order[:count]]
        rod = shown_sweep(scene, int(so_far[-1])) if has_rods(scene) else None
        samples = 0 if rod is None else min(int((so_far == so_far[-1]).sum()), len(rod.base))
        yield _Stage(
            contacts=order[:count],
            body=pyvista.PolyData.from_regular_faces(mesh.vertices, faces) if len(faces) else None,
            color=color,
            rod=rod if samples else None,
            sample=samples - 1,
            caption=f"{len(np.unique(so_far)):,} of {of_all:,} sweeps and probings with contact",
        )


def _by_slices(scene: Scene, frames: int) -> Iterator[_Stage]:
    """The hull of the contacts of more and more slices, or sweeps where not all are in slices, with a rod along one of them."""
    of_slice = scene.column("slice")
    name = "sweep" if of_slice is None or (of_slice < 0).any() else "slice"
    of_part = scene.column(name)
    if of_part is None:
        raise InputError(
            f"{scene.name} does not say which slices its contacts lie in; show a scan's folder, or a recording"
        )
    numbers, points = np.unique(of_part), scene.points
    if name == "slice":  # from one end to the other, however they were planned
        middles = np.array([points[of_part == number].mean(axis=0) for number in numbers])
        numbers = numbers[np.argsort(middles[:, np.ptp(middles, axis=0).argmax()], kind="stable")]
    order = np.argsort(numbers)
    place = order[np.searchsorted(numbers, of_part, sorter=order)]
    steps = np.linspace(0, len(numbers), frames + 1)[1:]
    shown = np.unique(np.ceil(steps).astype(int)) - 1
    sweeps = dict(zip(shown, _front_sweeps(scene, numbers[shown], of_part), strict=True)) if has_rods(scene) else {}
    for done in steps:
        k = int(np.ceil(done)) - 1
        rows = np.flatnonzero(place == k)
        so_far = rows[: int(np.ceil((done - k) * len(rows)))]
        selected, body = np.concatenate([np.flatnonzero(place < k), so_far]), None
        with suppress(InputError):  # the contacts of one slice or sweep span no body yet
            body = hull(points[selected])
        rod = sweeps.get(k)
        sample = 0 if rod is None else round((done - k) * (len(rod.base) - 1))
        yield _Stage(selected, body, parts.BODY, rod, sample, f"{k + 1} of {len(numbers)} {name}s")


def _front_sweeps(scene: Scene, numbers: Array, parts: Array) -> list[ShownSweep]:
    """Of each slice the sweep whose contacts face the camera most; where there are no slices, the sweeps themselves."""
    sweeps, toward = scene.column("sweep"), np.asarray(DIRECTION)
    assert sweeps is not None
    depth = (scene.points - scene.points.mean(axis=0)) @ toward
    of_parts = (np.unique(sweeps[parts == number]) for number in numbers)
    return [shown_sweep(scene, max(of_part, key=lambda one: depth[sweeps == one].mean())) for of_part in of_parts]
