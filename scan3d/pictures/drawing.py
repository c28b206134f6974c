"""Pictures are drawn in a child process: a renderer that crashes or hangs costs the pictures and nothing else."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from concurrent.futures import Future
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryDirectory
from typing import Any

from scan3d.choices import CHARTS
from scan3d.errors import InputError
from scan3d.pictures import canvas
from scan3d.pictures.figures import Sheet
from scan3d.pictures.parts import Scene
from scan3d.workers import python

Job = tuple[str, dict[str, Any]]
"""What is drawn: the file ending, and the keywords of `views.picture`, or of `views.movie` for the ending of a movie."""

# A driver that hangs is not waited for any longer; a large scan on a slow machine gets its pictures before.
_TIMEOUT_S = 600
_CODE = "from scan3d.pictures.drawing import serve; serve()"


class DrawingError(InputError):
    """The child process that draws has failed."""


class Drawing:
    """A child process that draws a scene.

    It is started in the background, and gets ready while this process does other work.  It ends with the ``with`` block.
    """

    def __init__(self) -> None:
        self._request: SimpleQueue[bytes] = SimpleQueue()
        self._changing = threading.Lock()
        self._child: subprocess.Popen[bytes] | None = None
        self._is_over = False
        self._drawn: Future[list[bytes]] = Future()
        threading.Thread(target=self._work, daemon=True).start()

    def __enter__(self) -> Drawing:
        return self

    def __exit__(self, *_: object) -> None:
        with self._changing:
            self._is_over = True
            if self._child is not None:
                self._child.kill()
        self._request.put(b"")

    def begin(self, scene: Scene, jobs: Sequence[Job]) -> None:
        """Let pictures be drawn, which `finish` waits for."""
        self._request.put(pickle.dumps((scene, list(jobs))))

    def finish(self) -> list[bytes]:
        """The bytes of each picture that `begin` has asked for.

        Raises NoRendererError where nothing can be rendered, InputError for a scene that lacks what is to be shown, and
        DrawingError if the child process crashes or takes too long.
        """
        return self._drawn.result()

    def _work(self) -> None:
        try:
            self._drawn.set_result(self._answer())
        except Exception as error:  # raised where the pictures are waited for
            self._drawn.set_exception(error)

    def _answer(self) -> list[bytes]:
        canvas.need_renderer()
        environment = {name: value for name, value in os.environ.items() if name != "MPLBACKEND"}
        with self._changing:
            if self._is_over:
                return []
            # in a separate session: Ctrl-C in the terminal ends this process, which then ends the child without a message
            self._child = subprocess.Popen(
                python(_CODE),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                env=environment,
                start_new_session=True,
            )
        with self._child as child:
            try:
                output, errors = child.communicate(self._request.get(), _TIMEOUT_S)
            except subprocess.TimeoutExpired:
                child.kill()
                raise DrawingError(f"drawing took more than {_TIMEOUT_S} s") from None
        if child.returncode:
            raise DrawingError(_cause(child.returncode, errors))
        answer: list[bytes] | InputError = pickle.loads(output)
        if isinstance(answer, InputError):
            raise answer
        return answer


def draw(scene: Scene, jobs: Sequence[Job]) -> list[bytes]:
    """The bytes of pictures, drawn in a child process.  Raises InputError as `Drawing.finish`."""
    with Drawing() as drawing:
        drawing.begin(scene, jobs)
        return drawing.finish()


def picture(scene: Scene, path: Path, view: str, color: str, sheet: Sheet) -> bytes:
    """The bytes of a picture (`views.picture`) for a path: charts are drawn here, and bodies in a child process.

    Raises InputError as `Drawing.finish`.
    """
    job = (path.suffix.lower(), {"view": view, "color": color, "sheet": sheet})
    return (_pictures if view in CHARTS else draw)(scene, [job])[0]


def serve() -> None:
    """What the child process does: get ready, read a scene from the standard input, write pictures to the standard output."""
    answer = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print goes elsewhere
    canvas.assume_renderer()
    _warm_up()
    request = sys.stdin.buffer.read()
    try:
        drawn: list[bytes] | InputError = _pictures(*pickle.loads(request))
    except InputError as error:
        drawn = error
    with answer:
        pickle.dump(drawn, answer)


def _warm_up() -> None:
    """Render a sphere and a power of ten, for which the driver, the fonts and the parser of formulas are loaded."""
    import pyvista
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from scan3d.pictures import views  # noqa: F401 - imported before they are needed
    from scan3d.pictures.figures import own_style

    plotter = pyvista.Plotter(off_screen=True, window_size=[64, 64])
    plotter.add_mesh(pyvista.Sphere())
    plotter.screenshot(None, return_img=True)
    plotter.close()
    with own_style():
        figure = Figure(figsize=(1, 1))
        figure.text(0.5, 0.5, "$10^{-1}$")
        FigureCanvasAgg(figure).draw()


def _pictures(scene: Scene, jobs: Sequence[Job]) -> list[bytes]:
    from scan3d.pictures import views

    with TemporaryDirectory() as folder:
        paths = [Path(folder) / f"{number}{ending}" for number, (ending, _) in enumerate(jobs)]
        for path, (ending, keywords) in zip(paths, jobs, strict=True):
            (views.movie if ending in views.MOVIES else views.picture)(scene, path, **keywords)
        return [path.read_bytes() for path in paths]


def _cause(code: int, errors: bytes) -> str:
    lines = [line.strip() for line in errors.decode(errors="replace").splitlines() if line.strip()]
    if code < 0:
        known = {number.value: number.name for number in signal.Signals}
        return f"the renderer crashed ({known.get(-code, f'signal {-code}')})"
    return f"the process that draws has failed ({lines[-1] if lines else f'exit code {code}'})"
