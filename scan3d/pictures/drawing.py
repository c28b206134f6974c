"""Pictures are drawn in a child process: a renderer that crashes or hangs costs the pictures and nothing else."""

from __future__ import annotations

import atexit
import os
import pickle
import signal
import struct
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import Any

from scan3d.errors import InputError
from scan3d.pictures import rendering
from scan3d.pictures.scene import Scene
from scan3d.pictures.sheet import CHARTS, Sheet
from scan3d.processes import python

Job = tuple[str, dict[str, Any]]
"""What is drawn: the file ending, and the keywords of `views.picture`, or of `movie.movie` for the ending of a movie."""

# A child is ended after this time.  Shorter, a large scan on a slow machine without a graphics card would not get its
# pictures; longer, a driver that hangs would be waited for.
_TIMEOUT_S = 600
# A child that has drawn ends if no further scene comes within this time.  Longer, a worker of a cluster holds its memory for
# longer; shorter, a long computation between two pictures ends it.
_IDLE_S = 120
_CODE = "from scan3d.pictures.drawing import serve; serve(warm={})"
# What goes through the pipes is preceded by its length.
_LENGTH = struct.Struct("<Q")


class DrawingError(InputError):
    """The child process that draws has failed."""


class Drawing:
    """A child process that draws; entered, it begins to import what it needs, and `draw` gives it scenes.

    It ends when the ``with`` block does.

    warm
        whether it also renders something small at once, after which the first pictures take less time.  It must be known that
        pictures can be rendered.
    """

    def __init__(self, *, warm: bool = False) -> None:
        self._warm = warm
        self._watch: threading.Timer | None = None
        self._is_late = False
        self.has_begun = False
        """Whether pictures are being drawn, which `finish` waits for."""

    def __enter__(self) -> Drawing:
        environment = {name: value for name, value in os.environ.items() if name != "MPLBACKEND"}
        self._errors = TemporaryFile()
        # in a separate session: Ctrl-C in the terminal ends this process, which then ends the child without a message
        self._child = subprocess.Popen(
            python(_CODE.format(self._warm)),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            env=environment,
            start_new_session=True,
        )
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    @property
    def is_running(self) -> bool:
        """Whether the child process can draw."""
        return self._child.poll() is None

    def stop(self) -> None:
        """End the child process."""
        self._end_watch()
        self._child.kill()
        self._child.wait()
        for stream in (self._child.stdin, self._child.stdout, self._errors):
            if stream is not None:
                with suppress(OSError):
                    stream.close()

    def draw(self, scene: Scene, jobs: Sequence[Job]) -> list[bytes]:
        """The bytes of each picture, as `begin` and `finish`."""
        self.begin(scene, jobs)
        return self.finish()

    def begin(self, scene: Scene, jobs: Sequence[Job]) -> None:
        """Let the child process draw pictures, which `finish` waits for.  Raises InputError where nothing can be rendered."""
        rendering.need_renderer()
        self.ask(request_of(scene, jobs))

    def ask(self, request: bytes) -> None:
        """`begin` with what `request_of` has returned."""
        self.has_begun = True
        self._begin_watch()  # a child that hangs reads nothing either
        with suppress(OSError, ValueError):  # the child has ended: it sends no answer
            _write(self._child.stdin, request)
        self._end_watch()

    def finish(self) -> list[bytes]:
        """The bytes of each picture that `begin` has asked for.

        Raises InputError for a scene that lacks what is to be shown, and DrawingError if the child process crashes or takes too
        long, after which it is ended.
        """
        self._begin_watch()
        try:
            answer = _received(self._child.stdout)
        finally:
            self._end_watch()
            self.has_begun = False
        if answer is None:
            code = self._child.wait()
            self._errors.seek(0)
            cause = f"drawing took more than {_TIMEOUT_S} s" if self._is_late else _cause(code, self._errors.read())
            self.stop()
            raise DrawingError(cause)
        if isinstance(answer[0], InputError):
            raise answer[0]
        return list(answer[0])

    def _begin_watch(self) -> None:
        def end() -> None:
            self._is_late = True
            self._child.kill()

        self._watch = threading.Timer(_TIMEOUT_S, end)
        self._watch.daemon = True
        self._watch.start()

    def _end_watch(self) -> None:
        if self._watch is not None:
            self._watch.cancel()


_shared: Drawing | None = None


@contextmanager
def shared() -> Iterator[Drawing]:
    """A child process that is kept for the next user of this function: it has imported what it needs."""
    global _shared
    drawing, _shared = _shared, None
    if drawing is not None and not drawing.is_running:
        drawing.stop()
        drawing = None
    if drawing is None:
        drawing = Drawing().__enter__()
    try:
        yield drawing
    except BaseException:
        drawing.stop()
        raise
    stop_shared()
    if drawing.is_running:
        _shared = drawing


@atexit.register
def stop_shared() -> None:
    """End the child process that `shared` keeps."""
    global _shared
    drawing, _shared = _shared, None
    if drawing is not None:
        drawing.stop()


def draw(scene: Scene, jobs: Sequence[Job]) -> list[bytes]:
    """The bytes of pictures, drawn in one child process.  Raises InputError as `Drawing.draw`."""
    rendering.need_renderer()
    with Drawing() as drawing:
        return drawing.draw(scene, jobs)


def picture(scene: Scene, path: Path, view: str, color: str, sheet: Sheet) -> bytes:
    """The bytes of a picture (`views.picture`) for a path: charts are drawn here, and bodies in a child process.

    Raises InputError as `Drawing.draw`.
    """
    from scan3d.pictures import views

    if view not in CHARTS:
        keywords = {"view": view, "color": color, "sheet": sheet}
        return draw(scene, [(path.suffix.lower(), keywords)])[0]
    with TemporaryDirectory() as folder:
        file = Path(folder) / f"chart{path.suffix.lower()}"
        views.picture(scene, file, view, color, sheet)
        return file.read_bytes()


def serve(*, warm: bool = False) -> None:
    """What the child process does: read scenes from the standard input, and write pictures to the standard output.

    With `warm` it first renders something small, while the process that needs the pictures does other work.
    """
    # what libraries print goes elsewhere
    answer = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    # imported now, while the process that needs the pictures does other work
    import matplotlib.backends.backend_agg  # noqa: F401
    import pyvista  # noqa: F401
    import trimesh  # noqa: F401

    from scan3d.pictures import movie, views  # noqa: F401

    rendering.assume_renderer()
    if warm:
        _warm_up()
    with os.fdopen(0, "rb") as source, answer:
        request = _received(source)
        while request is not None:
            window, scene, jobs = request[0]
            os.environ.update(window)
            _write(answer, pickle.dumps(_drawn(scene, jobs)))
            idle = threading.Timer(_IDLE_S, os._exit, (0,))
            idle.daemon = True
            idle.start()
            request = _received(source)
            idle.cancel()


def _warm_up() -> None:
    """Render a sphere and a power of ten, for which the driver, the fonts and the parser of formulas are loaded."""
    import pyvista
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    plotter = pyvista.Plotter(off_screen=True, window_size=[64, 64])
    plotter.add_mesh(pyvista.Sphere())
    plotter.screenshot(None, return_img=True)
    plotter.close()
    figure = Figure(figsize=(1, 1))
    figure.text(0.5, 0.5, "$10^{-1}$")
    FigureCanvasAgg(figure).draw()


def _drawn(scene: Scene, jobs: Any) -> list[bytes] | InputError:
    """The pictures, or why there are none."""
    from scan3d.pictures import movie, views

    result = []
    try:
        with TemporaryDirectory() as folder:
            for number, (ending, keywords) in enumerate(jobs):
                path = Path(folder) / f"{number}{ending}"
                (movie.movie if ending in movie.ENDINGS else views.picture)(scene, path, **keywords)
                result.append(path.read_bytes())
    except InputError as error:
        return error
    return result


def request_of(scene: Scene, jobs: Sequence[Job]) -> bytes:
    """What the child process is sent, for pictures of a scene."""
    window = {rendering.WINDOW: os.environ[rendering.WINDOW]} if rendering.WINDOW in os.environ else {}
    return pickle.dumps((window, scene, list(jobs)))


def _write(stream: Any, data: bytes) -> None:
    stream.write(_LENGTH.pack(len(data)))
    stream.write(data)
    stream.flush()


def _received(stream: Any) -> tuple[Any] | None:
    """What `_write` has sent; None where the stream ends."""
    head = stream.read(_LENGTH.size)
    if len(head) < _LENGTH.size:
        return None
    (size,) = _LENGTH.unpack(head)
    data = stream.read(size)
    return (pickle.loads(data),) if len(data) == size else None


def _cause(code: int, errors: bytes) -> str:
    """Why a child process has ended."""
    lines = [line.strip() for line in errors.decode(errors="replace").splitlines() if line.strip()]
    if code < 0 and sys.platform != "win32":
        try:
            return f"the renderer crashed ({signal.Signals(-code).name})"
        except ValueError:
            return f"the renderer crashed (signal {-code})"
    return f"the process that draws has failed ({lines[-1] if lines else f'exit code {code}'})"
