"""How results show themselves in a notebook: tables in HTML with a small picture, and pictures drawn off screen.

`_repr_html_` and `plot` of results import this module when they are called, so that matplotlib and VTK are not loaded before.
"""

from __future__ import annotations

import base64
import html
import io
import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from scan3d.choices import WITH_OTHER, Color, View, one_of
from scan3d.cloud import Cloud
from scan3d.errors import InputError
from scan3d.files.whole import atomic, check_file
from scan3d.pictures import canvas, views
from scan3d.pictures.figures import Sheet, own_style, save, sheet
from scan3d.pictures.parts import Scene, of_cloud
from scan3d.recording import Recording
from scan3d.shown import Rows
from scan3d.units import Unit, check_unit, unit_of

if TYPE_CHECKING:
    import trimesh
    from PIL.Image import Image


def plot(
    what: Recording | Cloud | trimesh.Trimesh,
    truth: trimesh.Trimesh | None = None,
    *,
    against: trimesh.Trimesh | None = None,
    view: View | None = None,
    color: Color | None = None,
    unit: Unit | None = None,
    size: str | None = None,
    dpi: int | None = None,
    camera: str | None = None,
    path: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
) -> Image:
    """A picture, drawn off screen, of a recording, a cloud or a surface (`trimesh.Trimesh`).

    truth
        the true body, a `trimesh.Trimesh`: a cloud can then be coloured by its error, and a surface is by its deviation.
    against
        another surface, a `trimesh.Trimesh` in the same unit, in the place of the truth: a surface is coloured by its signed
        distance from it.
    view
        one of `scan3d.choices.VIEWS`: by default 'cloud' of a cloud and 'surface' of a surface, or 'compare' for a surface
        and the truth side by side, or 'histogram'; of a recording by default the reactions of all sweeps ('forces'), or 'cloud'
        for its contacts, or 'explain' for the rod along one sweep.
    color
        what contacts are coloured by, one of `scan3d.choices.COLORS`; by default 'force'.
    unit
        of a surface; by default that which the surface states (`Trimesh.units`), or mm.
    size
        ``WIDTH`` or ``WIDTHxHEIGHT`` with a unit, mm, cm, in, pt or px, such as '85mm' or '85x60mm'; by default 7 inches wide,
        and as high as what is drawn needs.
    dpi
        pixels to the inch, from 50 to 2400; by default 200.
    camera
        one of `scan3d.choices.CAMERAS`, such as 'top', or azimuth and elevation in degrees, such as '300,25'; a comma and a
        factor after either of them zoom.
    path
        a file, .png, .pdf or .svg, that the picture is also written to; one that this program did not write is replaced only
        with `overwrite`.

    Returns a `PIL.Image.Image`, which notebooks show.  Raises InputError for other results and values, where the picture can't
    be written, and where nothing can be rendered, which reactions and histograms do not need.
    """
    drawn = sheet(size, dpi, camera)
    import trimesh

    for name, body in (("truth", truth), ("against", against)):
        if body is not None and not isinstance(body, trimesh.Trimesh):
            raise InputError(
                f"{name} must be a trimesh.Trimesh, such as `scan3d.load_mesh` gives, got a {type(body).__name__}"
            )
    check_unit(unit)
    default, scene = _shown(what, truth, view, unit)
    return scene_image(scene, view or default, color or "force", drawn, against=against, path=path, overwrite=overwrite)


def _shown(what: Any, truth: Any, view: str | None, unit: str | None) -> tuple[str, Scene]:
    import trimesh

    from scan3d.geometry.distance import distances
    from scan3d.reconstruction import reconstruct

    if isinstance(what, trimesh.Trimesh):
        return "surface", Scene("the surface", unit_of(what, unit), surface=what, truth=truth)
    if isinstance(what, Recording):
        default, scene = "forces", Scene("the recording", what.unit, truth=truth, recording=what)
        if view in (None, "forces"):
            return default, scene
        cloud = reconstruct(what)
    elif isinstance(what, Cloud):
        default, scene, cloud = "cloud", Scene("the cloud", what.unit, truth=truth), what
    else:
        raise InputError(
            f"only a recording, a cloud or a surface (trimesh.Trimesh) can be plotted, got a {type(what).__name__}"
        )
    error = None if truth is None else distances(cloud.points, truth)
    return default, replace(scene, contacts=of_cloud(cloud, error).contacts)


def scene_image(
    scene: Scene,
    view: str,
    color: str,
    drawn: Sheet | None = None,
    *,
    against: Any = None,
    path: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
) -> Image:
    """A picture of a scene, drawn off screen on a sheet; the other arguments as in `plot`."""
    if path is not None:
        check_file(views.check_path(Path(path)), {}, overwrite, "path")
    if against is not None:
        if view not in WITH_OTHER:
            raise InputError(f"surfaces are compared in the views {one_of(WITH_OTHER)}, got {view!r}")
        scene = scene.against(against)
    from PIL import Image as Pillow

    with own_style():
        figure = views.figure(scene, view, color, drawn)
        if path is not None:
            with atomic(Path(path), "path") as place:
                save(figure, place)
        figure.canvas.draw()
        return Pillow.fromarray(np.asarray(figure.canvas.buffer_rgba())[:, :, :3].copy())


# --- tables ---


def to_html(result: Recording | Cloud) -> str:
    """A table in HTML of what a result states of itself, with a small picture where one can be drawn."""
    title, rows = type(result).__name__, result.summary()
    if isinstance(result, Recording):
        rows = [*rows, *((f"source: {name}", str(value)) for name, value in result.source.items())]
        return _html(title, rows, _small(plot(result)))
    if not canvas.can_render():
        return _html(title, rows, note=canvas.NO_RENDERER)
    return _html(title, rows, _small(plot(result)) if len(result) else "")


def scene_html(title: str, rows: Rows, scene: Scene) -> str:
    """A table in HTML of rows (name, value), with a small picture of a scene where one can be rendered."""
    if canvas.can_render():
        return _html(title, rows, _small(scene_image(scene, "cloud" if scene.surface is None else "surface", "force")))
    return _html(title, rows, note=canvas.NO_RENDERER)


def _html(title: str, rows: Rows, picture: str = "", note: str | None = None) -> str:
    cells = "".join(
        f'<tr><th style="text-align: left">{html.escape(name)}</th>'
        f'<td style="text-align: left">{html.escape(value)}</td></tr>'
        for name, value in rows
    )
    below = f"<p><small>{html.escape(note)}</small></p>" if note else ""
    return f"<div><table><caption>{html.escape(title)}</caption><tbody>{cells}</tbody></table>{picture}{below}</div>"


def _small(image: Image) -> str:
    """An <img> that contains a picture, reduced to 700 pixels, the width of a notebook's column."""
    small, file = image.reduce(2), io.BytesIO()
    small.save(file, "PNG", optimize=True)
    data = base64.b64encode(file.getvalue()).decode()
    return f'<img width="{small.width}" height="{small.height}" alt="" src="data:image/png;base64,{data}">'
