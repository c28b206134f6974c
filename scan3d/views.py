"""Pictures: off screen by VTK where that works, and a page for the browser everywhere."""

from __future__ import annotations

import functools
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

import planar
from scan3d.cloud import Array, Cloud

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
_SIZE = (1400, 1050)


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


def _renders() -> bool:
    try:
        # in a session of its own: an interrupt from the terminal is no answer
        tried = subprocess.run(
            [sys.executable, "-c", _PROBE], capture_output=True, timeout=120, check=False, start_new_session=True
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return tried.returncode == 0


def draw_cloud(cloud: Cloud, path: str | Path) -> None:
    """Picture of the contacts, coloured by the contact force."""
    import pyvista

    points = pyvista.PolyData(cloud.points)
    points["contact force in mN"] = cloud.force_N * 1e3
    plotter = _plotter()
    plotter.add_mesh(
        points,
        scalars="contact force in mN",
        cmap="viridis",
        point_size=4,
        render_points_as_spheres=True,
        scalar_bar_args=_bar("contact force in mN"),
    )
    _shoot(plotter, path, cloud.unit)


def draw_surface(surface: Any, deviation: Array | None, unit: str, path: str | Path) -> None:
    """Picture of the surface; `deviation` (faces,) from the truth, positive outside, colours it where known."""
    import pyvista

    shape = pyvista.wrap(surface)
    plotter = _plotter()
    if deviation is None:
        plotter.add_mesh(shape, color="lightsteelblue", split_sharp_edges=True)
    else:
        title = f"signed deviation in {unit}"
        shape.cell_data[title] = deviation
        most = float(np.abs(deviation).max()) or 1.0
        plotter.add_mesh(
            shape,
            scalars=title,
            cmap="RdBu_r",
            clim=(-most, most),
            ambient=0.4,
            diffuse=0.7,
            scalar_bar_args=_bar(title),
        )
    _shoot(plotter, path, unit)


def _bar(title: str) -> dict[str, Any]:
    return dict(
        title=title,
        vertical=True,
        position_x=0.86,
        position_y=0.2,
        width=0.06,
        height=0.6,
        color="black",
        fmt="%.2g",
        title_font_size=24,
        label_font_size=22,
    )


def _plotter() -> Any:
    import pyvista

    plotter = pyvista.Plotter(off_screen=True, window_size=list(_SIZE))
    plotter.set_background("white")
    return plotter


def _shoot(plotter: Any, path: str | Path, unit: str) -> None:
    """A view from above the front, with the body's size at its axes."""
    plotter.show_bounds(
        color="black",
        xtitle=f"x in {unit}",
        ytitle=f"y in {unit}",
        ztitle=f"z in {unit}",
        n_xlabels=2,
        n_ylabels=2,
        n_zlabels=2,
        fmt="%.3g",
        font_size=20,
        location="outer",
    )
    plotter.enable_parallel_projection()
    plotter.view_vector((1.0, -1.3, 0.8))
    plotter.camera.zoom(0.9)
    plotter.screenshot(str(path))
    plotter.close()


def page(surface: Any, cloud: Cloud) -> bytes:
    """A page that shows the surface and the contacts and needs no network."""
    import trimesh
    from trimesh.scene.cameras import Camera
    from trimesh.viewer.notebook import scene_to_html

    body = surface.copy()
    body.visual = trimesh.visual.ColorVisuals(body, face_colors=[176, 196, 222, 255])
    colors = np.where((cloud.phase == planar.Phase.TIP)[:, None], [33, 102, 172, 255], [178, 24, 43, 255])
    contacts = trimesh.PointCloud(cloud.points, colors=colors.astype(np.uint8))
    # names of its own, where trimesh would draw them at random
    scene = trimesh.Scene({"surface": body, "contacts": contacts}, camera=Camera(name="camera", fov=(60, 45)))
    return scene_to_html(scene).encode()
