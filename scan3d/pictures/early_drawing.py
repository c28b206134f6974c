"""The process that draws, started before it is needed."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress

from scan3d.pictures import rendering
from scan3d.pictures.drawing import Drawing, Job, request_of
from scan3d.pictures.scene import Scene


class EarlyDrawing:
    """A `Drawing` that is started in the background where pictures can be rendered, so that it is ready after other work.

    Entered, it is waited for; `stop` ends it, or its start.  `begin` gives it what is to be drawn before it is entered.
    """

    def __init__(self) -> None:
        self._drawing: Drawing | None = None
        self._is_over = False
        self._changing = threading.Lock()
        # what fails here fails again, with its message, when the process is needed
        self._starting = threading.Thread(target=self._start, daemon=True)
        self._starting.start()

    def _start(self) -> None:
        with suppress(OSError):
            if rendering.can_render():
                with self._changing:
                    if not self._is_over:
                        self._drawing = Drawing(warm=True).__enter__()

    def begin(self, scene: Scene, jobs: Sequence[Job]) -> None:
        """As `Drawing.begin`, once the process has started, which is not waited for; nothing happens where it can't start."""
        request, started = request_of(scene, jobs), self._starting

        def ask() -> None:
            started.join()
            if self._drawing is not None:
                self._drawing.ask(request)

        self._starting = threading.Thread(target=ask, daemon=True)
        self._starting.start()

    def __enter__(self) -> Drawing:
        self._starting.join()
        if self._drawing is None:
            self._drawing = Drawing().__enter__()
        return self._drawing

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """End the child process."""
        with self._changing:
            self._is_over = True
            if self._drawing is not None:
                self._drawing.stop()


@contextmanager
def prepared(drawing: AbstractContextManager[Drawing] | None) -> Iterator[AbstractContextManager[Drawing]]:
    """What gives a process that draws: `drawing`, or one that starts in the background and ends with the block.

    One that is given is not started early: it may be needed elsewhere until then.
    """
    if drawing is not None:
        yield drawing
        return
    early = EarlyDrawing()
    try:
        yield early
    finally:
        early.stop()
