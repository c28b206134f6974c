"""Ctrl-C and the signals that end a process: the run cleans up, says so in a sentence, and exits with 128 + the signal.

This module is imported before all others, so that Ctrl-C is handled from the first moments on; it needs little itself.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from types import FrameType, TracebackType

TYPE_CHECKING = False  # that of `typing`, whose import takes longer than the rest of this module's
if TYPE_CHECKING:
    from typing import Any

_WORDS = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "terminated: its terminal was closed"}
# Seconds after which a postponed interruption is tried again, and for how many trials it waits for code of this program.
# Longer, a run that is within a library for long ends late; shorter, libraries are interrupted that cannot bear it.
_AGAIN_S, _TRIALS = 0.01, 100
# Seconds after which a run that has not ended is interrupted again, because a library has caught the exception.  Shorter, the
# run could be interrupted while it cleans up; longer, it ends later.
_CAUGHT_S = 2.0
# Folders of this program's packages.
_OURS = tuple(
    os.path.join(os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__)))), name, "")
    for name in ("scan3d", "planar")
)


class Interrupted(KeyboardInterrupt):
    """Ctrl-C.  After a plain KeyboardInterrupt within `exec`, Python would end by the signal even if it is caught."""


class Terminated(BaseException):
    """The process was asked to end."""


class Interruptions:
    """A context in which signals unwind the run; `code` is the exit code, which the run sets unless it is interrupted."""

    def __init__(self, *, ends_process: bool) -> None:
        """`ends_process` states whether the process ends afterwards: nothing is left to interrupt then."""
        self.code = 0
        self._ends_process = ends_process
        self._received: int | None = None
        self._trials = 0
        self._handlers: dict[int, Any] = {}
        self._unraisable = sys.unraisablehook

    def __enter__(self) -> Interruptions:
        global _entered
        _entered = self
        # Python allows handlers in the main thread only
        if threading.current_thread() is threading.main_thread():
            for name in _WORDS:
                number = getattr(signal, name, None)
                # an ignored signal stays so, as with nohup
                if number is not None and signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
                    self._handlers[number] = signal.signal(number, self._receive)
            sys.unraisablehook = self._ignore
        return self

    def _ignore(self, unraisable: Any) -> None:
        """Say nothing of interruptions that end in a destructor or in a callback: the run is interrupted again."""
        if not issubclass(unraisable.exc_type, (Interrupted, Terminated)):
            self._unraisable(unraisable)

    def check(self) -> None:
        """Raises the interruption that was received, if a library has caught it."""
        if self._received is not None:
            raise _error(self._received)

    def _receive(self, number: int, frame: FrameType | None) -> None:
        self._received = number
        error = _error(number)
        if not hasattr(signal, "setitimer"):
            raise error
        signal.signal(signal.SIGALRM, lambda _, frame: self._receive(number, frame))
        self._trials += 1
        # while VTK is being imported an exception ends in a crash, and trimesh would go on without what it was importing;
        # within a library it may be caught, or reach compiled code that does not expect it
        is_ours = frame is not None and frame.f_code.co_filename.startswith(_OURS)
        if _is_importing(frame) or not (is_ours or self._trials > _TRIALS):
            signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)
        else:
            signal.setitimer(signal.ITIMER_REAL, _CAUGHT_S)
            raise error

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> bool:
        global _entered
        _entered = None
        if self._received is not None and hasattr(signal, "setitimer"):
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        sys.unraisablehook = self._unraisable
        for number, handler in self._handlers.items():
            signal.signal(number, signal.SIG_IGN if self._ends_process else handler)
        # a library may turn the interruption into an error of its own
        is_interruption = isinstance(error, (KeyboardInterrupt, Terminated)) or self._received is not None
        if error is None and self._received is not None and self._ends_process:
            # the run was completed although a library caught the interruption
            for stream in (sys.stdout, sys.stderr):
                if stream is not None:
                    stream.flush()
            os._exit(self.code)
        if error is None or not is_interruption or isinstance(error, SystemExit):
            return False
        number = self._received or signal.SIGINT
        if sys.stderr is not None:
            # on a terminal the cursor is behind the progress or behind ^C
            newline = "\n" if sys.stderr.isatty() else ""
            print(f"{newline}scan3d: {_WORDS[signal.Signals(number).name]}", file=sys.stderr)
            sys.stderr.flush()
        self.code = 128 + number
        if self._ends_process:  # at once, as above: a library that was interrupted may crash when Python ends it
            os._exit(self.code)
        return True


_entered: Interruptions | None = None


def check() -> None:
    """Raises the interruption that this process has received, if a library has caught it; between two parts of a long run."""
    if _entered is not None:
        _entered.check()


def _error(number: int) -> type[BaseException]:
    return Interrupted if number == signal.SIGINT else Terminated


def _is_importing(frame: FrameType | None) -> bool:
    """Whether the code of a frame runs within an import."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False
