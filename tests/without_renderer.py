"""A child process in which nothing can be rendered: VTK would take down the process that tries."""

import os

MISSING = ("libraries", "display")
"""Either the OpenGL libraries are missing, or VTK is set to open its window on an X server, which does not run."""
_LIBRARIES = (
    "libEGL.so.1",
    "libEGL.so",
    "libGL.so.1",
    "libGL.so",
    "libOpenGL.so.0",
    "libGLX.so.0",
    "libOSMesa.so.8",
)


def headless(**more):
    """The environment of this process without a display, and without settings of VTK."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("DISPLAY", "WAYLAND", "VTK_"))}
    return {**kept, **more}


def hidden_renderer(missing, place):
    """An environment without a renderer; `missing` is one of `MISSING`, and the folder `place` holds empty files for it."""
    if missing == "display":
        return headless(VTK_DEFAULT_OPENGL_WINDOW="vtkXOpenGLRenderWindow")
    place.mkdir(exist_ok=True)
    for name in _LIBRARIES:
        (place / name).touch()  # empty files are found before the libraries
    return headless(LD_LIBRARY_PATH=str(place))
