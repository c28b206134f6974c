"""Whether this machine can render, off screen or in a window."""

from __future__ import annotations

import functools
import os
import subprocess
import sys

from scan3d.errors import InputError
from scan3d.processes import python

# Without X and EGL, VTK ends the process that renders: a child process tries first, by drawing a sphere on a black image.
# Where a display does not answer, VTK falls back to a window that is never shown.
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
if sys.argv[1] == "on screen" and not window.GetShowWindow():
    sys.exit(3)
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
WINDOW = "VTK_DEFAULT_OPENGL_WINDOW"
"""The environment variable that names the class of VTK's windows."""
_is_assumed = False


class NoRendererError(InputError):
    """Nothing can be rendered on this machine."""


@functools.cache
def can_render() -> bool:
    """Whether VTK can render off screen on this machine, tried in a child process once."""
    if sys.platform == "linux" and not os.environ.get("DISPLAY") and WINDOW not in os.environ:
        # by default VTK tries X first, and prints warnings without a display
        os.environ[WINDOW] = "vtkEGLRenderWindow"
        if renders():
            return True
        del os.environ[WINDOW]
    return renders()


def renders(*, on_screen: bool = False) -> bool:
    """Whether a child process can render, on screen or off."""
    target = "on screen" if on_screen else "off screen"
    try:
        # in a separate session: Ctrl-C in the terminal would end the child, which would look like a failure to render
        done = subprocess.run(
            python(_PROBE, target),
            capture_output=True,
            # a busy machine may take as long to import VTK; a display that accepts the connection may never answer
            timeout=20 if on_screen else 120,
            check=False,
            start_new_session=True,
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0


def assume_renderer() -> None:
    """Let `need_renderer` try nothing, in a process that has been started to render."""
    global _is_assumed
    _is_assumed = True


def need_renderer() -> None:
    """Raises NoRendererError where `can_render` is false."""
    if not (_is_assumed or can_render()):
        raise NoRendererError(NO_RENDERER)
