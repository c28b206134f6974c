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

from scan3d.choices import Color, View
from scan3d.cloud import Cloud
from scan3d.comparison import UNKNOWN_UNIT, Comparison
from scan3d.errors import InputError
from scan3d.pictures import charts, rendering, views
from scan3d.pictures.figures import quiet
from scan3d.pictures.scene import Scene, of_cloud
from scan3d.recording import Recording
from scan3d.shown import Rows
from scan3d.units import UNITS_M, Unit, unit_of

if TYPE_CHECKING:
    import trimesh
    from PIL.Image import Image

# Pictures in tables are reduced by this factor, to 700 pixels: the width of a notebook's column.
_REDUCTION = 2


def plot(
    what: Recording | Cloud | trimesh.Trimesh | Comparison,
    truth: trimesh.Trimesh | None = None,
    *,
    view: View | None = None,
    color: Color | None = None,
    unit: Unit | None = None,
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
        of a surface; by default that which the surface states (`Trimesh.units`), or mm.

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
    if unit not in (None, *UNITS_M):
        raise InputError(f"unit must be one of {', '.join(UNITS_M)}, got {unit!r}")
    if isinstance(what, Recording | Cloud):
        return scene_image(_scene(what, truth), view or "cloud", color or "force")
    if isinstance(what, trimesh.Trimesh):
        scene = Scene("the surface", unit_of(what, unit), surface=what, truth=truth)
        return scene_image(scene, view or "surface", color or "force")
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
    """What the recording states of itself and its source, with the reactions."""
    rows = [*recording.summary(), *((f"source: {name}", str(value)) for name, value in recording.source.items())]
    return _html("Recording", rows, _small(plot(recording)))


@to_html.register
def _cloud_html(cloud: Cloud) -> str:
    """What the cloud states of itself, with a picture where one can be rendered."""
    if len(cloud) and rendering.can_render():
        return _html("Cloud", cloud.summary(), _small(plot(cloud)))
    return _html("Cloud", cloud.summary(), note=None if rendering.can_render() else rendering.NO_RENDERER)


def scene_html(title: str, rows: Rows, scene: Scene) -> str:
    """A table in HTML of rows (name, value), with a small picture of a scene where one can be rendered."""
    if rendering.can_render():
        return _html(title, rows, _small(scene_image(scene, "cloud" if scene.surface is None else "surface", "force")))
    return _html(title, rows, note=rendering.NO_RENDERER)


@to_html.register
def _comparison_html(comparison: Comparison) -> str:
    """The distances in the meshes' unit and in % of the mesh's diagonal."""
    note = f"Lengths in {UNKNOWN_UNIT}; in brackets, of the mesh's diagonal."
    return _html("Comparison", comparison.summary(), note=note)


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
