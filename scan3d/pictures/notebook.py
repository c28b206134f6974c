"""How results show themselves in a notebook: tables in HTML with a small picture, and pictures drawn off screen.

The results' own `_repr_html_` and `plot` come here, and only when they are called: neither matplotlib nor VTK is loaded before.
"""

from __future__ import annotations

import base64
import functools
import html
import io
from typing import TYPE_CHECKING, Any

import numpy as np

import planar
from scan3d.arrays import Array
from scan3d.cloud import Cloud
from scan3d.comparison import Comparison
from scan3d.errors import InputError
from scan3d.pictures import rendering, views
from scan3d.pictures.figures import FONT, blank_figure, quiet
from scan3d.pictures.scene import Scene, of_cloud
from scan3d.pictures.shading import (
    INK,
    ROD,
    UNKNOWN,
)
from scan3d.recording import Recording
from scan3d.units import UNITS_M

if TYPE_CHECKING:
    from PIL.Image import Image

Rows = list[tuple[str, str]]

# A notebook's column is about 700 pixels wide, half of what a picture has.
_SMALLER = 2
# Sweeps drawn at most, evenly chosen: more are a grey area.
_MOST_SWEEPS = 60
# Bounds this many times as large as their bars are seen beyond them.
_SEEN = 1.01
# Inches.
_CURVES_TALL, _BARS_TALL = 5.0, 3.2
_UNKNOWN_UNIT = "units of the meshes"


def plot(
    what: Any,
    truth: Any = None,
    *,
    view: str | None = None,
    color: str | None = None,
    unit: str = "mm",
) -> Image:
    """A picture, drawn off screen, of a recording, a cloud, a surface (`trimesh.Trimesh`) or a comparison.

    truth
        the true body, a `trimesh.Trimesh`: a cloud can then be coloured by its error, a surface is by its deviation.
    view
        what is seen (of `views.VIEWS`): of a cloud 'cloud', of a surface 'surface', or 'compare' for both bodies side by
        side; of a recording the reactions of all sweeps unless it is 'cloud', or 'explain' for the rod along one sweep.
    color
        what contacts are coloured by (of `scenes.COLORS`): 'force' unless said.
    unit
        of a surface, which does not say it.

    Returns a `PIL.Image.Image`, which notebooks show and `.save("FILE.png")` writes.  Raises InputError for anything else,
    for views that there are not, and, but for recordings and comparisons, where nothing can render.
    """
    import trimesh

    if isinstance(what, Comparison):
        return _image(_distances(what))
    if isinstance(what, Recording) and view is None:
        return _image(_reactions(what))
    if truth is not None and not isinstance(truth, trimesh.Trimesh):
        raise InputError(
            f"truth must be a trimesh.Trimesh, such as `scan3d.load_mesh` gives, got a {type(truth).__name__}"
        )
    if unit not in UNITS_M:
        raise InputError(f"unit must be one of {', '.join(UNITS_M)}, got {unit!r}")
    if isinstance(what, Recording | Cloud):
        return _of_scene(_scene(what, truth), view or "cloud", color or "force")
    if isinstance(what, trimesh.Trimesh):
        return _of_scene(Scene("the surface", unit, surface=what, truth=truth), view or "surface", color or "force")
    raise InputError(
        f"only a recording, a cloud, a surface (trimesh.Trimesh) or a comparison can be plotted, got a {type(what).__name__}"
    )


def _scene(what: Recording | Cloud, truth: Any) -> Any:
    from scan3d.geometry.distance import distances
    from scan3d.reconstruction import reconstruct

    recording = what if isinstance(what, Recording) else None
    cloud = what if isinstance(what, Cloud) else reconstruct(what)
    error = None if truth is None else distances(cloud.points, truth)
    return of_cloud(cloud, error, name="the cloud" if recording is None else "the recording", truth=truth,
                    recording=recording)  # fmt: skip


def _of_scene(scene: Any, view: str, color: str) -> Image:

    with quiet():
        return _image(views.figure(scene, view, color))


def _image(figure: Any) -> Image:
    from PIL import Image

    with quiet():
        figure.canvas.draw()
        return Image.fromarray(np.asarray(figure.canvas.buffer_rgba())[:, :, :3].copy())


# --- tables ---


@functools.singledispatch
def to_html(result: Any) -> str:
    """A table in HTML, with a small picture where there is one, of a recording, a cloud or a comparison."""
    raise InputError(f"only a recording, a cloud or a comparison has a table, got a {type(result).__name__}")


@to_html.register
def _recording_html(recording: Recording) -> str:
    """Counts, rod, noise, and where the samples were taken, with the reactions."""
    rod, unit = recording.rod, recording.unit
    felt = np.any(recording.force_N != 0, axis=1)
    force = np.hypot(*recording.force_N.T)
    rows: Rows = [
        ("samples", f"{len(recording)}, {felt.sum()} with a force"),
        ("sweeps", str(len(np.unique(recording.sweep)))),
        ("normals of the slices", _directions(recording.axes()[:, 2])),
        ("rod", f"{1e3 * rod.length_m:.4g} mm long, EI = {rod.bending_stiffness_Nm2:.4g} N m²"),
        ("largest reactions", f"{1e3 * force.max():.4g} mN, {1e6 * np.abs(recording.moment_Nm).max():.4g} mN mm"),
        ("noise", _noise(recording)),
        ("clamp from", _point(recording.position_m.min(axis=0) / UNITS_M[unit], unit)),
        ("to", _point(recording.position_m.max(axis=0) / UNITS_M[unit], unit)),
    ]
    rows += [(f"source: {name}", str(value)) for name, value in recording.source.items()]
    return _html("Recording", rows, _small(plot(recording)))


@to_html.register
def _cloud_html(cloud: Cloud) -> str:
    """Counts, size and what was felt, with a picture where one can be rendered."""

    tips = int((cloud.phase == planar.Phase.TIP).sum())
    known = np.isfinite(cloud.normals).all(axis=1)
    friction = cloud.friction[np.isfinite(cloud.friction)]
    size = np.ptp(cloud.points, axis=0) if len(cloud) else np.zeros(3)
    rows: Rows = [
        ("contacts", f"{len(cloud)}: {len(cloud) - tips} tangential, {tips} at the tip"),
        ("slices", f"{len(np.unique(cloud.slice))} with contacts of {len(cloud.slice_height)}"),
        ("sweeps", str(len(np.unique(cloud.sweep)))),
        ("size", " × ".join(f"{one:.4g}" for one in size) + f" {_said(cloud.unit)}"),
        ("normals", f"{known.sum()} known"),
    ]
    if len(cloud):
        rows.append(("force", f"{1e3 * cloud.force_N.min():.3g} to {1e3 * cloud.force_N.max():.3g} mN"))
    if len(friction):
        rows.append(
            ("friction", f"{np.median(friction):.4g} (median; {friction.min():.4g} to {friction.max():.4g})"),
        )
    if cloud.noise:
        rows.append(("contacts off by", f"{cloud.noise:.2g} {_said(cloud.unit)} (standard deviation)"))
    if len(cloud) and rendering.can_render():
        return _html("Cloud", rows, _small(plot(cloud)))
    return _html("Cloud", rows, note=None if rendering.can_render() else rendering.NO_RENDERER)


@to_html.register
def _comparison_html(comparison: Comparison) -> str:
    """The figures, in the meshes' unit and in % of the mesh's diagonal."""
    found = comparison

    def length(value: float, more: str = "") -> str:
        return f"{value:.4g} ({_percent(value, found)}){more}"

    certain = ", exact" if found.exact else f", certified between {found.lower:.6g} and {found.upper:.6g}"
    rows: Rows = [
        ("Hausdorff distance", length(found.hausdorff, certain)),
        ("surface to mesh", length(found.surface_to_mesh)),
        ("mesh to surface", length(found.mesh_to_surface)),
        ("worst at", _point(found.worst_point) + f", on the {found.worst_on}"),
        ("mean", length(found.mean)),
        ("RMS", length(found.rms)),
        ("95 % closer than", length(found.p95)),
        ("Chamfer distance", length(found.chamfer)),
        ("F-score", f"{found.f_score:.4f} at 1 % of the diagonal"),
        ("normals differ by", f"{found.normal_median_deg:.3g}° (median), {found.normal_p95_deg:.3g}° (95 %)"),
        ("volume error", f"{100 * found.volume_error:+.3g} %" if np.isfinite(found.volume_error) else "unknown: open"),
    ]
    return _html("Comparison", rows, note=f"Lengths in {_UNKNOWN_UNIT}; in brackets, of the mesh's diagonal.")


def _html(title: str, rows: Rows, picture: str = "", note: str | None = None) -> str:
    cells = "".join(
        f'<tr><th style="text-align: left">{html.escape(what)}</th>'
        f'<td style="text-align: left">{html.escape(much)}</td></tr>'
        for what, much in rows
    )
    below = f"<p><small>{html.escape(note)}</small></p>" if note else ""
    return f"<div><table><caption>{html.escape(title)}</caption><tbody>{cells}</tbody></table>{picture}{below}</div>"


def _small(image: Image) -> str:
    """An <img> that holds its picture."""
    small, file = image.reduce(_SMALLER), io.BytesIO()
    small.save(file, "PNG", optimize=True)
    data = base64.b64encode(file.getvalue()).decode()
    return f'<img width="{small.width}" height="{small.height}" alt="" src="data:image/png;base64,{data}">'


def _directions(normals: Array, most: int = 4) -> str:
    distinct = np.unique(np.round(normals, 3) + 0.0, axis=0)
    more = f" and {len(distinct) - most} more" if len(distinct) > most else ""
    return ", ".join("({:g}, {:g}, {:g})".format(*one) for one in distinct[:most]) + more


def _noise(recording: Recording) -> str:
    if not (recording.noise_force_N or recording.noise_moment_Nm):
        return "none"
    return f"{1e3 * recording.noise_force_N:.2g} mN, {1e6 * recording.noise_moment_Nm:.2g} mN mm (standard deviations)"


def _point(values: Array, unit: str = "") -> str:
    return "({:.4g}, {:.4g}, {:.4g}) ".format(*(values + 0.0)).rstrip() + (f" {_said(unit)}" if unit else "")


def _said(unit: str) -> str:
    return unit.replace("um", "µm")


def _percent(value: float, comparison: Comparison) -> str:
    return f"{100 * value / comparison.diagonal:.2g} %"


# --- pictures without a renderer ---


def _reactions(recording: Recording) -> Any:
    """Support reactions over the way of the clamp, a line for every sweep."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from matplotlib.ticker import MaxNLocator

    numbers = np.unique(recording.sweep)
    some = numbers[np.unique(np.linspace(0, len(numbers) - 1, _MOST_SWEEPS).round().astype(int))]
    colors = ScalarMappable(Normalize(float(numbers[0]), float(max(numbers[-1], numbers[0] + 1))), "viridis")
    values = np.column_stack([1e3 * recording.force_N, 1e6 * recording.moment_Nm])
    figure = blank_figure(_CURVES_TALL)
    places = dict(left=0.13, right=0.80, top=0.96, bottom=0.12, hspace=0.18)
    panels = figure.subplots(3, 1, sharex=True, gridspec_kw=places)
    scale = 1 / UNITS_M[recording.unit]
    for number in some:
        mine = recording.sweep == number
        way = scale * np.linalg.norm(recording.position_m[mine] - recording.position_m[mine][0], axis=1)
        for axes, column in zip(panels, values[mine].T, strict=True):
            axes.plot(way, column, color=colors.to_rgba(number), lw=0.8)
    names = ("$f_{0x}$ in mN", "$f_{0y}$ in mN", "$m_{0z}$ in mN mm")
    for axes, name in zip(panels, names, strict=True):
        axes.set_ylabel(name, fontsize=FONT - 1)
        axes.tick_params(labelsize=FONT - 2)
        axes.spines[["top", "right"]].set_visible(False)
        axes.margins(x=0.01)
    figure.align_ylabels(panels)
    panels[-1].set_xlabel(f"way of the clamp in {_said(recording.unit)}", fontsize=FONT)
    if len(numbers) > 1:
        drawn = figure.colorbar(colors, cax=figure.add_axes((0.842, 0.15, 0.025, 0.70)))
        drawn.locator = MaxNLocator(6, integer=True)
        drawn.ax.tick_params(labelsize=FONT - 1)
        drawn.outline.set_linewidth(0.6)
        figure.text(0.985, 0.5, "number of the sweep", rotation="vertical", ha="right", va="center", fontsize=FONT)
    return figure


def _distances(found: Comparison) -> Any:
    """The distances as bars, with certified bounds where they are not exact."""

    bars = [
        ("Hausdorff", found.hausdorff, found.upper),
        ("surface to mesh", found.surface_to_mesh, found.surface_to_mesh_upper),
        ("mesh to surface", found.mesh_to_surface, found.mesh_to_surface_upper),
        ("95 %", found.p95, None),
        ("RMS", found.rms, None),
        ("mean", found.mean, None),
    ]
    figure = blank_figure(_BARS_TALL)
    axes = figure.add_axes((0.23, 0.19, 0.73, 0.78))
    most = max(max(value, upper or 0.0) for _, value, upper in bars)
    for k, (_, value, upper) in enumerate(bars):
        end = value
        axes.barh(-k, value, color=ROD if k < 3 else UNKNOWN, height=0.62)
        if upper is not None and upper > _SEEN * value:
            axes.plot([value, upper, upper], [-k, -k, -k], color=INK, lw=1.2, marker="|", ms=7)
            end = upper
        axes.annotate(
            f"{value:.3g} ({_percent(value, found)})", (end, -k), (6, 0), textcoords="offset points", va="center",
            fontsize=FONT - 2,
        )  # fmt: skip
    axes.set_xlim(0, 1.4 * most or 1.0)  # room for the figures behind the bars
    axes.set_yticks([-k for k in range(len(bars))], [name for name, _, _ in bars], fontsize=FONT - 1)
    axes.tick_params(axis="y", length=0)
    axes.tick_params(axis="x", labelsize=FONT - 1)
    axes.ticklabel_format(axis="x", scilimits=(-3, 5), useMathText=True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_xlabel(f"distance in {_UNKNOWN_UNIT} (of the mesh's diagonal)", fontsize=FONT - 1)
    return figure
