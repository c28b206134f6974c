"""Pictures are drawn in a child process: a renderer that crashes or hangs costs the pictures and nothing else."""

from __future__ import annotations

import atexit
import contextvars
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError, Future
from contextlib import contextmanager, suppress
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryDirectory, TemporaryFile
from typing import Any

from scan3d.choices import CHARTS
from scan3d.errors import InputError
from scan3d.pictures import canvas
from scan3d.pictures.figures import Sheet, blank_figure, own_style
from scan3d.pictures.parts import Scene
from scan3d.workers import heard, python, tell

Job = tuple[str, dict[str, Any]]
"""What is drawn: the file ending, and the keywords of `views.picture`, or of `views.movie` for the ending of a movie."""

# A driver that hangs is not waited for any longer; a large scan on a slow machine gets its pictures before.
_TIMEOUT_S = 600
# A child that has drawn waits so long for another scene, as of a batch or a notebook.
_IDLE_S = 60
_READY = b"ready"
_CODE = "from scan3d.pictures.drawing import serve; serve()"


class DrawingError(InputError):
    """The child process that draws has failed."""


class _Child:
    """A process that draws one scene after another, once it is ready."""

    def __init__(self) -> None:
        environment = {name: value for name, value in os.environ.items() if name != "MPLBACKEND"}
        self._errors = TemporaryFile()  # noqa: SIM115 - closed by `end`
        # in a separate session: Ctrl-C in the terminal ends this process, which then ends the child without a message
        self.process = subprocess.Popen(
            python(_CODE),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._errors,
            env=environment,
            start_new_session=True,
        )
        self._ready: bool | None = None
        self.drawn_s = 0.0
        """When it has drawn last (`time.monotonic`)."""

    def is_ready(self, within_s: float) -> bool:
        """Wait until the child can draw; false if it ends before, or takes longer."""
        if self._ready is None:
            with self._ending_after(within_s):
                assert self.process.stdout is not None
                self._ready = self.process.stdout.read(len(_READY)) == _READY
        return self._ready

    def ask(self, request: bytes) -> list[bytes] | InputError:
        """What the child answers.  Raises DrawingError if it crashes or takes too long."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        with self._ending_after(_TIMEOUT_S) as late:
            try:
                self.process.stdin.write(request)
                self.process.stdin.flush()
                if self.is_ready(_TIMEOUT_S):
                    answer: list[bytes] | InputError | tuple[str, int, int]
                    while isinstance(answer := pickle.load(self.process.stdout), tuple):
                        tell(*answer)
                    self.drawn_s = time.monotonic()
                    return answer
            except (OSError, EOFError, pickle.UnpicklingError):
                pass
        code = self.process.wait()
        self._errors.seek(0)
        errors = self._errors.read()
        self.end()
        raise DrawingError(f"drawing took more than {_TIMEOUT_S} s" if late.is_set() else _cause(code, errors))

    @contextmanager
    def _ending_after(self, seconds: float) -> Iterator[threading.Event]:
        late = threading.Event()

        def end() -> None:
            late.set()
            self.process.kill()

        timer = threading.Timer(seconds, end)
        timer.start()
        try:
            yield late
        finally:
            timer.cancel()

    def end(self) -> None:
        """End the process."""
        self.process.kill()
        with suppress(OSError), self.process:  # what it was to be told may not be gone
            self._errors.close()


# At most one child that has drawn, for the next scene.
_IDLE: list[_Child] = []


def _taken() -> _Child | None:
    """The idle child, if it does not end soon."""
    while _IDLE:
        child = _IDLE.pop()
        if time.monotonic() - child.drawn_s < _IDLE_S / 2:
            return child
        child.end()
    return None


@atexit.register
def _end_idle() -> None:
    while _IDLE:
        _IDLE.pop().end()


class Drawing:
    """A child process that draws a scene.

    It is started in the background, and gets ready while this process does other work; one that has just drawn another scene is
    taken instead.  It ends with the ``with`` block, unless it has drawn, and soon after that if nothing else is drawn.
    """

    def __init__(self) -> None:
        self._request: SimpleQueue[bytes] = SimpleQueue()
        self._changing = threading.Lock()
        self._child: _Child | None = None
        self._is_over = False
        self._drawn: Future[list[bytes]] = Future()
        # what the child tells is heard where it was asked for
        threading.Thread(target=contextvars.copy_context().run, args=(self._work,), daemon=True).start()

    def __enter__(self) -> Drawing:
        return self

    def __exit__(self, *_: object) -> None:
        with self._changing:
            self._is_over = True
            if self._child is not None:
                self._child.process.kill()
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
        finally:
            if self._child is not None:
                self._child.end()

    def _start(self) -> _Child:
        """The child, an idle one or a new one.  Raises CancelledError if the block has been left."""
        with self._changing:
            if self._is_over:
                raise CancelledError
            if self._child is None:
                self._child = _taken() or _Child()
            return self._child

    def _is_ready(self) -> bool:
        """Whether a child has rendered, which is the trial of the renderer as well."""
        # a busy machine may take as long to import VTK; a display that accepts the connection may never answer
        child = self._start()
        if child.is_ready(120):
            return True
        with self._changing:
            if self._is_over:
                raise CancelledError
            child.end()
            self._child = None
        return False

    def _answer(self) -> list[bytes]:
        canvas.need_renderer(self._is_ready)
        child, request = self._start(), self._request.get()
        if not request:
            return []
        answer = child.ask(request)
        with self._changing:
            self._child = None
            _IDLE.append(child)
            while len(_IDLE) > 1:  # of several threads
                _IDLE.pop(0).end()
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
    """What the child process does: get ready, read scenes from the standard input, write pictures to the standard output.

    It ends when nothing has been asked for a while.
    """
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print goes elsewhere

    def answer(what: list[bytes] | InputError | tuple[str, int, int]) -> None:
        pickle.dump(what, answers)
        answers.flush()

    canvas.assume_renderer()
    _warm_up()
    answers.write(_READY)
    answers.flush()
    idle = threading.Timer(_IDLE_S, os._exit, [0])
    while True:
        try:
            scene, jobs = pickle.load(sys.stdin.buffer)
        except EOFError:  # the process that asks has ended
            os._exit(0)
        idle.cancel()
        try:
            with heard(lambda *told: answer(told)):
                drawn: list[bytes] | InputError = _pictures(scene, jobs)
        except InputError as error:
            drawn = error
        answer(drawn)
        idle = threading.Timer(_IDLE_S, os._exit, [0])
        idle.start()


def _warm_up() -> None:
    """Render a sphere and a power of ten, for which the driver, the fonts and the parser of formulas are loaded."""
    import pyvista

    from scan3d.pictures import views  # noqa: F401 - imported before they are needed

    plotter = pyvista.Plotter(off_screen=True, window_size=[64, 64])
    plotter.add_mesh(pyvista.Sphere())
    image = plotter.screenshot(None, return_img=True)
    plotter.close()
    if image.min() == image.max():  # as where VTK falls back to a window that is never shown
        sys.exit(3)
    with own_style():
        figure = blank_figure(1.0, width=1.0)
        figure.text(0.5, 0.5, "$10^{-1}$")
        figure.canvas.draw()


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
