"""Whether anything can be rendered on this machine."""

from __future__ import annotations

import functools
import os
import subprocess
import sys

from scan3d.errors import InputError

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
window.SetOffScreenRendering(sys.argv[1] == "off screen")
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


@functools.cache
def can_render() -> bool:
    """Whether VTK can draw off screen on this machine, tried out in a child process."""
    if sys.platform == "linux" and not os.environ.get("DISPLAY") and _WINDOW not in os.environ:
        # without a display VTK tries X first, and complains
        os.environ[_WINDOW] = "vtkEGLRenderWindow"
        if renders():
            return True
        del os.environ[_WINDOW]
    return renders()


def renders(*, on_screen: bool = False) -> bool:
    """Whether a child process can draw here."""
    where = "on screen" if on_screen else "off screen"
    try:
        # in a session of its own: an interrupt from the terminal is no answer
        tried = subprocess.run(
            [sys.executable, "-c", _PROBE, where],
            capture_output=True,
            timeout=120,
            check=False,
            start_new_session=True,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return tried.returncode == 0


def need_renderer() -> None:
    """Raises InputError where nothing can render."""
    if not can_render():
        raise InputError(NO_RENDERER)
