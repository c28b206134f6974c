"""Pictures are drawn in a child process: a renderer that crashes or hangs costs the pictures and nothing else."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from scan3d.errors import InputError
from scan3d.pictures import rendering
from scan3d.pictures.scene import Scene
from scan3d.processes import python

Job = tuple[str, dict[str, str]]
"""What is drawn: the file ending, and the keywords of `views.picture`, or of `movie.movie` for the ending of a movie."""

# A child is ended after this time.  Shorter, a large scan on a slow machine without a graphics card would not get its
# pictures; longer, a driver that hangs would be waited for.
_TIMEOUT_S = 600
_CODE = "from scan3d.pictures.drawing import serve; serve()"


class DrawingError(InputError):
    """The child process that draws has failed."""


class Drawing:
    """A child process that draws; entered, it begins to import what it needs, and `draw` gives it the scene.

    It ends when the ``with`` block does.
    """

    def __enter__(self) -> Drawing:
        environment = {name: value for name, value in os.environ.items() if name != "MPLBACKEND"}
        # in a separate session: Ctrl-C in the terminal ends this process, which then ends the child without a message
        self._child = subprocess.Popen(
            python(_CODE),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=environment,
            start_new_session=True,
        )
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """End the child process."""
        self._child.kill()
        self._child.wait()
        for stream in (self._child.stdin, self._child.stdout, self._child.stderr):
            if stream is not None:
                with suppress(OSError):
                    stream.close()

    def draw(self, scene: Scene, jobs: Sequence[Job]) -> list[bytes]:
        """The bytes of each picture.

        Raises InputError where nothing can be rendered and for a scene that lacks what is to be shown, and DrawingError if the
        child process crashes or takes too long.
        """
        rendering.need_renderer()
        window = {rendering.WINDOW: os.environ[rendering.WINDOW]} if rendering.WINDOW in os.environ else {}
        try:
            answer, errors = self._child.communicate(pickle.dumps((window, scene, list(jobs))), _TIMEOUT_S)
        except subprocess.TimeoutExpired:
            raise DrawingError(f"drawing took more than {_TIMEOUT_S} s") from None
        except OSError as error:
            raise DrawingError(f"the process that draws has failed: {error}") from None
        if self._child.returncode:
            raise DrawingError(_cause(self._child.returncode, errors))
        result = pickle.loads(answer)
        if isinstance(result, InputError):
            raise result
        return list(result)


def draw(scene: Scene, jobs: Sequence[Job]) -> list[bytes]:
    """The bytes of pictures, drawn in one child process.  Raises InputError as `Drawing.draw`."""
    rendering.need_renderer()
    with Drawing() as drawing:
        return drawing.draw(scene, jobs)


def serve() -> None:
    """What the child process does: read a scene from the standard input, and write pictures to the standard output."""
    # what libraries print goes elsewhere
    answer = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    # imported now, while the process that needs the pictures does other work
    import matplotlib.backends.backend_agg  # noqa: F401
    import pyvista  # noqa: F401
    import trimesh  # noqa: F401

    from scan3d.pictures import movie, views

    with os.fdopen(0, "rb") as source:
        data = source.read()
    if not data:  # no pictures are wanted
        return
    window, scene, jobs = pickle.loads(data)
    os.environ.update(window)
    rendering.assume_renderer()
    result: Any = []
    try:
        with TemporaryDirectory() as folder:
            for number, (ending, keywords) in enumerate(jobs):
                path = Path(folder) / f"{number}{ending}"
                (movie.movie if ending in movie.ENDINGS else views.picture)(scene, path, **keywords)
                result.append(path.read_bytes())
    except InputError as error:
        result = error
    with answer:
        answer.write(pickle.dumps(result))


def _cause(code: int, errors: bytes) -> str:
    """Why a child process has ended."""
    lines = [line.strip() for line in errors.decode(errors="replace").splitlines() if line.strip()]
    if code < 0 and sys.platform != "win32":
        try:
            return f"the renderer crashed ({signal.Signals(-code).name})"
        except ValueError:
            return f"the renderer crashed (signal {-code})"
    return f"the process that draws has failed ({lines[-1] if lines else f'exit code {code}'})"
