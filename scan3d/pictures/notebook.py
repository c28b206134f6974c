"""How results show themselves in a notebook: tables in HTML with a small picture, and pictures drawn off screen.

`_repr_html_` and `plot` of results import this module when they are called, so that matplotlib and VTK are not loaded before.
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
from scan3d.pictures import charts, rendering, views
from scan3d.pictures.figures import quiet
from scan3d.pictures.scene import Scene, of_cloud
from scan3d.pictures.words import unit_symbol
from scan3d.recording import Recording
from scan3d.units import UNITS_M

if TYPE_CHECKING:
    from PIL.Image import Image

Rows = list[tuple[str, str]]

# Pictures in tables are reduced by this factor, to 700 pixels: the width of a notebook's column.
_REDUCTION = 2
# Distinct normals of slices that a table lists: scans along the three axes have three.
_MOST_NORMALS = 4


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
        the true body, a `trimesh.Trimesh`: a cloud can then be coloured by its error, and a surface is by its deviation.
    view
        one of `scan3d.choices.VIEWS`: by default 'cloud' of a cloud and 'surface' of a surface, or 'compare' for a surface
        and the truth side by side; of a recording by default the reactions of all sweeps, or 'cloud' for its contacts, or
        'explain' for the rod along one sweep.
    color
        what contacts are coloured by, one of `scan3d.choices.COLORS`; by default 'force'.
    unit
        of a surface, which does not state its unit.

    Returns a `PIL.Image.Image`, which notebooks show and `.save("FILE.png")` writes.  Raises InputError for other results and
    views, and where nothing can be rendered, which reactions and comparisons do not need.
    """
    import trimesh

    if isinstance(what, Comparison):
        return _image(charts.distances(what))
    if isinstance(what, Recording) and view is None:
        return _image(charts.reactions(what))
    if truth is not None and not isinstance(truth, trimesh.Trimesh):
        raise InputError(
            f"truth must be a trimesh.Trimesh, such as `scan3d.load_mesh` gives, got a {type(truth).__name__}"
        )
    if unit not in UNITS_M:
        raise InputError(f"unit must be one of {', '.join(UNITS_M)}, got {unit!r}")
    if isinstance(what, Recording | Cloud):
        return scene_image(_scene(what, truth), view or "cloud", color or "force")
    if isinstance(what, trimesh.Trimesh):
        return scene_image(Scene("the surface", unit, surface=what, truth=truth), view or "surface", color or "force")
    raise InputError(
        f"only a recording, a cloud, a surface (trimesh.Trimesh) or a comparison can be plotted, got a {type(what).__name__}"
    )


def _scene(result: Recording | Cloud, truth: Any) -> Scene:
    from scan3d.geometry.distance import distances
    from scan3d.reconstruction import reconstruct

    recording = result if isinstance(result, Recording) else None
    cloud = result if isinstance(result, Cloud) else reconstruct(result)
    error = None if truth is None else distances(cloud.points, truth)
    return of_cloud(cloud, error, name="the cloud" if recording is None else "the recording", truth=truth,
                    recording=recording)  # fmt: skip


def scene_image(scene: Scene, view: str, color: str) -> Image:
    """A picture of a scene, drawn off screen; `view` and `color` as in `plot`."""
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
    """A table in HTML of a recording, a cloud or a comparison, with a small picture where one can be drawn."""
    raise InputError(f"only a recording, a cloud or a comparison has a table, got a {type(result).__name__}")


@to_html.register
def _recording_html(recording: Recording) -> str:
    """Counts, rod, noise, and where the samples were taken, with the reactions."""
    rod, unit = recording.rod, recording.unit
    force, moment = np.linalg.norm(recording.force_N, axis=1), np.abs(recording.moment_Nm)
    if recording.six_axis:
        force, moment = (np.linalg.norm(reaction, axis=1) for reaction in recording.wrench())
    rows: Rows = [
        ("samples", f"{len(recording)}, {(force > 0).sum()} with a force"),
        ("sweeps", str(len(np.unique(recording.sweep)))),
        ("z axes of the clamp" if recording.six_axis else "normals of the slices", _directions(recording.axes()[:, 2])),
        ("rod", f"{1e3 * rod.length_m:.4g} mm long, EI = {rod.bending_stiffness_Nm2:.4g} N m²"),
        ("largest reactions", f"{1e3 * force.max():.4g} mN, {1e6 * moment.max():.4g} mN mm"),
        ("noise", _noise(recording)),
        ("clamp from", _point(recording.position_m.min(axis=0) / UNITS_M[unit], unit)),
        ("to", _point(recording.position_m.max(axis=0) / UNITS_M[unit], unit)),
    ]
    rows += [(f"source: {name}", str(value)) for name, value in recording.source.items()]
    return _html("Recording", rows, _small(plot(recording)))


@to_html.register
def _cloud_html(cloud: Cloud) -> str:
    """Counts, size and what was measured, with a picture where one can be rendered."""
    tips = int((cloud.phase == planar.Phase.TIP).sum())
    known = np.isfinite(cloud.normals).all(axis=1)
    friction = cloud.friction[np.isfinite(cloud.friction)]
    size = np.ptp(cloud.points, axis=0) if len(cloud) else np.zeros(3)
    rows: Rows = [
        ("contacts", f"{len(cloud)}: {len(cloud) - tips} tangential, {tips} at the tip"),
        *_slices(cloud),
        ("sweeps", str(len(np.unique(cloud.sweep)))),
        ("size", " × ".join(f"{extent:.4g}" for extent in size) + f" {unit_symbol(cloud.unit)}"),
        ("normals", f"{known.sum()} known"),
    ]
    if len(cloud):
        rows.append(("force", f"{1e3 * cloud.force_N.min():.3g} to {1e3 * cloud.force_N.max():.3g} mN"))
    if len(friction):
        rows.append(
            ("friction", f"{np.median(friction):.4g} (median; {friction.min():.4g} to {friction.max():.4g})"),
        )
    if cloud.noise:
        rows.append(("position noise", f"{cloud.noise:.2g} {unit_symbol(cloud.unit)} (standard deviation)"))
    if len(cloud) and rendering.can_render():
        return _html("Cloud", rows, _small(plot(cloud)))
    return _html("Cloud", rows, note=None if rendering.can_render() else rendering.NO_RENDERER)


def _slices(cloud: Cloud) -> Rows:
    """The row about slices, in which contacts of the spatial model do not lie."""
    if cloud.model == "spatial":
        return [("model", "spatial: the rod may leave the plane of its sweep")]
    return [("slices", f"{len(np.unique(cloud.slice))} with contacts of {len(cloud.slice_height)}")]


def scene_html(title: str, rows: Rows, scene: Scene) -> str:
    """A table in HTML of rows (name, value), with a small picture of a scene where one can be rendered."""
    if rendering.can_render():
        return _html(title, rows, _small(scene_image(scene, "cloud" if scene.surface is None else "surface", "force")))
    return _html(title, rows, note=rendering.NO_RENDERER)


@to_html.register
def _comparison_html(comparison: Comparison) -> str:
    """The distances in the meshes' unit and in % of the mesh's diagonal."""

    def length(value: float) -> str:
        return f"{value:.4g} ({charts.percent_of_diagonal(value, comparison)})"

    certified = f", certified between {comparison.lower:.6g} and {comparison.upper:.6g}"
    certainty = ", exact" if comparison.exact else certified
    error = comparison.volume_error
    rows: Rows = [
        ("Hausdorff distance", length(comparison.hausdorff) + certainty),
        ("surface to mesh", length(comparison.surface_to_mesh)),
        ("mesh to surface", length(comparison.mesh_to_surface)),
        ("worst at", _point(comparison.worst_point) + f", on the {comparison.worst_on}"),
        ("mean", length(comparison.mean)),
        ("RMS", length(comparison.rms)),
        ("95 % closer than", length(comparison.p95)),
        ("Chamfer distance", length(comparison.chamfer)),
        ("F-score", f"{comparison.f_score:.4f} at 1 % of the diagonal"),
        ("normals differ by", f"{comparison.normal_median_deg:.3g}° (median), {comparison.normal_p95_deg:.3g}° (95 %)"),
        ("volume error", f"{100 * error:+.3g} %" if np.isfinite(error) else "unknown: open"),
    ]
    return _html("Comparison", rows, note=f"Lengths in {charts.UNKNOWN_UNIT}; in brackets, of the mesh's diagonal.")


def _html(title: str, rows: Rows, picture: str = "", note: str | None = None) -> str:
    cells = "".join(
        f'<tr><th style="text-align: left">{html.escape(name)}</th>'
        f'<td style="text-align: left">{html.escape(value)}</td></tr>'
        for name, value in rows
    )
    below = f"<p><small>{html.escape(note)}</small></p>" if note else ""
    return f"<div><table><caption>{html.escape(title)}</caption><tbody>{cells}</tbody></table>{picture}{below}</div>"


def _small(image: Image) -> str:
    """An <img> that contains a picture, reduced."""
    small, file = image.reduce(_REDUCTION), io.BytesIO()
    small.save(file, "PNG", optimize=True)
    data = base64.b64encode(file.getvalue()).decode()
    return f'<img width="{small.width}" height="{small.height}" alt="" src="data:image/png;base64,{data}">'


def _directions(normals: Array) -> str:
    """The distinct normals, the first few if there are many."""
    distinct = np.unique(np.round(normals, 3) + 0.0, axis=0)
    rest = f" and {len(distinct) - _MOST_NORMALS} more" if len(distinct) > _MOST_NORMALS else ""
    return ", ".join("({:g}, {:g}, {:g})".format(*normal) for normal in distinct[:_MOST_NORMALS]) + rest


def _noise(recording: Recording) -> str:
    if not (recording.noise_force_N or recording.noise_moment_Nm):
        return "none"
    return f"{1e3 * recording.noise_force_N:.2g} mN, {1e6 * recording.noise_moment_Nm:.2g} mN mm (standard deviations)"


def _point(values: Array, unit: str = "") -> str:
    return "({:.4g}, {:.4g}, {:.4g}) ".format(*(values + 0.0)).rstrip() + (f" {unit_symbol(unit)}" if unit else "")
