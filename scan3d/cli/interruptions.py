"""Ctrl-C and the signals that end a process: the run cleans up, says so in a sentence, and exits with 128 + the signal."""

from __future__ import annotations

import signal
import sys
import threading
from types import FrameType, TracebackType
from typing import Any

_WORDS = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "terminated: its terminal was closed"}


class Terminated(BaseException):
    """The process was asked to end."""


class Interruptions:
    """A context in which signals unwind the run; afterwards `code` is the exit code of a run that was interrupted."""

    def __init__(self, *, ends_process: bool) -> None:
        """`ends_process` states whether the process ends afterwards: nothing is left to interrupt then."""
        self.code = 0
        self._ends_process = ends_process
        self._received: int | None = None
        self._handlers: dict[int, Any] = {}

    def __enter__(self) -> Interruptions:
        # Python allows handlers in the main thread only
        if threading.current_thread() is threading.main_thread():
            for name in _WORDS:
                number = getattr(signal, name, None)
                # an ignored signal stays so, as with nohup
                if number is not None and signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
                    self._handlers[number] = signal.signal(number, self._receive)
        return self

    def _receive(self, number: int, _: FrameType | None) -> None:
        self._received = number
        raise KeyboardInterrupt if number == signal.SIGINT else Terminated

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> bool:
        for number, handler in self._handlers.items():
            signal.signal(number, signal.SIG_IGN if self._ends_process else handler)
        # a library that is being imported may turn the interruption into an error of its own
        is_interruption = isinstance(error, (KeyboardInterrupt, Terminated)) or self._received is not None
        if error is None or not is_interruption or isinstance(error, SystemExit):
            return False
        number = self._received or signal.SIGINT
        if sys.stderr is not None:
            # on a terminal the cursor is behind the progress or behind ^C
            newline = "\n" if sys.stderr.isatty() else ""
            print(f"{newline}scan3d: {_WORDS[signal.Signals(number).name]}", file=sys.stderr)
        self.code = 128 + number
        return True
