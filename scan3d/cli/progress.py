"""What a run is doing and how long it will take, on stderr: a line that changes on a terminal, a few lines elsewhere.

The first line is there before numerical libraries are imported, which takes a second or more.
"""

from __future__ import annotations

import math
import os
import sys
import threading
import time
from argparse import Namespace
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from types import TracebackType
from typing import Any

from scan3d.cli.terminal import is_terminal, one_line

_WORDS = {
    "load": "reading",
    "simulate": "simulating",
    "reconstruct": "contacts and normals",
    "check": "agreement with the model",
    "bounds": "bounds",
    "surface": "surface",
    "certificate": "certificate",
    "compare": "comparison with the mesh",
    "pictures": "pictures and page",
    "write": "writing",
}
# Shares of the steps in the time of a run, in hundredths, from which the time left is estimated.  Where they are wrong, the
# time left is wrong until it is corrected by the time that was taken.  They are those of scans of the egg with defaults, and
# in space with 24 slices (`timings_s` in report.json).
_SHARES = {
    "planar": {
        "load": 1,
        "simulate": 18,
        "reconstruct": 10,
        "check": 1,
        "bounds": 6,
        "surface": 16,
        "certificate": 10,
        "compare": 10,
        "write": 2,
        "pictures": 26,
    },
    "spatial": {
        "load": 1,
        "simulate": 48,
        "reconstruct": 4,
        "check": 3,
        "bounds": 12,
        "surface": 13,
        "certificate": 4,
        "compare": 3,
        "write": 1,
        "pictures": 11,
    },
}
# Seconds after which the line is drawn again, so that the time left counts down.  Shorter, it flickers; longer, it stands.
_AGAIN_S = 0.5
# Seconds of a run, and the part of it that must be done, before the time left is estimated.  Smaller, the first estimates are
# far off; larger, they come late.
_SURE_S, _SURE = 2.0, 0.05
# Seconds after which a run that has no terminal writes its first line; each further one comes after twice the time of the one
# before.  Shorter, short runs leave lines in logs; longer, a log does not show for long that a run goes on.
_FIRST_LINE_S = 10.0
# Width of a line where that of the terminal is not known.
_WIDTH = 80


class Progress:
    """A context in which stderr shows what a command is doing; nothing with ``--quiet``."""

    def __init__(self, arguments: Namespace) -> None:
        self._name = str(arguments.command)
        # commands without that option are done at once
        self._stream = None if getattr(arguments, "quiet", True) else sys.stderr
        self._terminal = is_terminal(self._stream)
        self._lock, self._ended = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._keep_drawing, daemon=True)
        self._words, self._left = "starting", _TimeLeft({})
        self._width, self._due = 0, _FIRST_LINE_S
        self._begun = time.monotonic()

    def __enter__(self) -> Progress:
        if self._stream is not None:
            self._draw()
            self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, _: BaseException | None, __: TracebackType | None) -> None:
        # an interruption leaves the line, over which the terminal has written ^C
        self.end(erased=kind is None or issubclass(kind, Exception))

    def end(self, *, erased: bool = True) -> None:
        """Nothing more is shown: before a result is printed."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join()
        if erased:
            self._erase()

    def expect(self, model: str, without: Iterable[str] = ()) -> None:
        """The steps of a scan with a model of contact follow, but those that are named."""
        self._left = _TimeLeft({name: share for name, share in _SHARES[model].items() if name not in without})

    def tell(self, words: str) -> None:
        """Show what is being done, in words."""
        self._words = words
        self._draw()

    def step(self, name: str) -> None:
        """Show that a step of a scan begins, by its name in `timings_s` of a report."""
        self._left.begin(name)
        self.tell(_WORDS[name])

    def counter(self, parts: str, *, estimated: bool = True) -> Callable[[int, int], None]:
        """A function that shows how many parts are done, of how many; without an estimate where they may be fewer."""

        def count(done: int, total: int) -> None:
            self._left.counted = done / total if estimated else math.nan
            self.tell(f"simulating {done}/{total} {parts}")

        return count

    def say(self, sentence: str) -> None:
        """Write a message, which stays."""
        with self._lock:
            self._erase()
            print(f"scan3d: {one_line(sentence)}", file=sys.stderr)

    def _keep_drawing(self) -> None:
        while not self._ended.wait(_AGAIN_S):
            self._draw()

    def _draw(self) -> None:
        if self._stream is None or self._ended.is_set():
            return
        # the stream may be closed before the run ends
        with self._lock, suppress(OSError, ValueError):
            if self._terminal:
                line = f"{self._name}: {self._words}{self._left}"[: _columns(self._stream) - 1]
                # blanks over what is left of the line before; other output, such as of a library, begins at the line's start
                self._stream.write(f"\r{line:{self._width}}\r")
                self._width = len(line)
            elif (seconds := time.monotonic() - self._begun) >= self._due:
                self._due = 2 * seconds
                self._stream.write(f"scan3d: {self._words}{self._left or f', {duration(seconds)} so far'}\n")
            self._stream.flush()

    def _erase(self) -> None:
        if self._width and self._stream is not None:
            with suppress(OSError, ValueError):
                self._stream.write(f"\r{'':{self._width}}\r")
                self._stream.flush()
            self._width = 0


class _TimeLeft:
    """How much of a run is done, and how long the rest will take if its steps have their usual shares."""

    def __init__(self, shares: Mapping[str, float]) -> None:
        """`shares` of the steps, in their order; none of a run of which nothing is known."""
        total, self._spans, end = sum(shares.values()), {}, 0.0
        for name, share in shares.items():
            self._spans[name] = (end, end := end + share / total)
        self._first: float | None = None
        self._since = self._begin = self._end = self._done = 0.0
        self.counted: float | None = None
        """Part of the step that is done, if that is counted; NaN where the whole is not known."""

    def begin(self, name: str) -> None:
        """A step begins; one that a run comes back to counts as the last that has begun."""
        self._since = time.monotonic()
        self._first = self._since if self._first is None else self._first
        begin, end = self._spans.get(name, (0.0, 0.0))
        self._begin = max(self._begin, begin)
        self._end, self.counted = max(self._begin, end), None

    def __str__(self) -> str:
        if self._first is None:
            return ""
        now = time.monotonic()
        elapsed, before = now - self._first, self._since - self._first
        if self.counted is not None:
            done = self._begin + (self._end - self._begin) * self.counted
        else:  # as fast as the steps before
            done = self._begin * elapsed / before if before > 0 else 0.0
        if elapsed < _SURE_S:
            return ""
        if not _SURE <= done <= self._end:  # NaN, or a step takes longer than its share
            return f", {duration(elapsed)} so far"
        self._done = max(self._done, done)
        return f", {100 * self._done:.0f} %, {duration(max(elapsed * (1 / self._done - 1), 1))} left"


def duration(seconds: float) -> str:
    """A duration in words: ``12 s``, ``3 min 20 s``, ``2 h 5 min``."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    minutes, rest = divmod(whole, 60)
    if minutes < 60:
        return f"{minutes} min {rest} s"
    return f"{minutes // 60} h {minutes % 60} min"


def _columns(stream: Any) -> int:
    """The width of a terminal."""
    try:
        return os.get_terminal_size(stream.fileno()).columns or _WIDTH
    except (OSError, ValueError):
        return _WIDTH
