"""Runs a command in a forked process with limits of time and memory, and says what became of it."""

import io
import logging
import os
import pickle
import re
import resource
import select
import signal
import sys
import time
import traceback
from concurrent.futures import ThreadPoolExecutor
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path

SECONDS = 20
MEMORY = 2 << 30


@dataclass
class Outcome:
    """What a command did."""

    code: int | None = None
    out: str = ""
    err: str = ""
    trace: str = ""
    warnings: list[str] = field(default_factory=list)
    seconds: float = 0.0
    memory: int = 0
    """Bytes beyond those of the process at the start."""

    @property
    def fault(self) -> str:
        """What is wrong with it by itself, empty if nothing is."""
        if self.trace:
            return "traceback"
        if self.code is None:
            return "hang" if self.seconds >= SECONDS else "crash"
        if self.memory > MEMORY:
            return "memory"
        if self.code not in (0, 1, 2):
            return f"exit code {self.code}"
        # without the progress of a slow machine, and the question for the unit
        said = re.sub(r"scan3d: (\d[\w. ]*: |the body measures )[^\n]+\n", "", self.err)
        if self.code and not (said.startswith("scan3d: ") and said.count("\n") == 1):
            return "no sentence"
        if self.code and not said[:-1].isprintable():
            return "control characters"
        return "warning on stderr" if self.code == 0 and "Warning" in self.err else ""


class Threads(ThreadPoolExecutor):
    """Takes the place of `scan3d.workers.Workers` where runs are to stay in this process."""

    def kill(self):
        self.shutdown(wait=False, cancel_futures=True)


def run(argv, folder):
    """The outcome of ``scan3d ARGV`` in a folder; nothing is rendered, which saves seconds."""
    reader, writer = os.pipe()
    start = time.monotonic()
    child = os.fork()
    if child == 0:
        os.close(reader)
        _child([str(part) for part in argv], folder, writer)
    os.close(writer)
    data = b""
    while True:
        left = SECONDS - (time.monotonic() - start)
        ready = left > 0 and select.select([reader], [], [], left)[0]
        piece = os.read(reader, 1 << 16) if ready else b""
        if not piece:
            break
        data += piece
    seconds = time.monotonic() - start
    os.close(reader)
    if seconds >= SECONDS:
        os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    outcome = pickle.loads(data) if data else Outcome()
    outcome.seconds = seconds
    return outcome


def _child(argv, folder, writer):
    """Run the command and write its outcome; never returns."""
    sys.stdin.close()
    # what libraries in C write to the process's own stderr is an answer to the user as well
    spill = Path(folder) / ".stderr"
    descriptor = os.open(spill, os.O_CREAT | os.O_TRUNC | os.O_RDWR)
    os.dup2(descriptor, 2)
    os.dup2(descriptor, 1)
    os.chdir(folder)
    from scan3d import workers
    from scan3d.cli import main
    from scan3d.pictures import canvas

    canvas.can_render = lambda *_: False
    # the runs of a batch are made in this process, whose limits and warnings are seen
    workers.Workers = Threads
    outcome = Outcome()
    handler = logging.Handler()
    handler.emit = lambda record: outcome.warnings.append(record.getMessage()[:300])
    logging.getLogger("py.warnings").addHandler(handler)
    before = _address_space()
    resource.setrlimit(resource.RLIMIT_AS, (before + 2 * MEMORY,) * 2)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    out, err = io.StringIO(), io.StringIO()
    try:
        with redirect_stdout(out), redirect_stderr(err):
            outcome.code = main(argv)
    except SystemExit as stop:
        outcome.code = stop.code if isinstance(stop.code, int) else 1
    except BaseException:
        outcome.trace = traceback.format_exc()
    outcome.memory = 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak)
    outcome.out, outcome.err = out.getvalue()[-4000:], err.getvalue()[-4000:]
    if outcome.code == 0:
        outcome.err += spill.read_text(errors="replace")[-2000:]
    with os.fdopen(writer, "wb") as stream:
        pickle.dump(outcome, stream)
    os._exit(0)


def _address_space():
    pages = Path("/proc/self/statm").read_text(encoding="ascii").split()[0]
    return int(pages) * resource.getpagesize()
