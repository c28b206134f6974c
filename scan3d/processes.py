"""This process and its children: how they compute, what they import, what memory they have, and how they end."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NoReturn

from scan3d.errors import InputError

ALGEBRA = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
"""The numbers of threads that OpenBLAS, MKL and Accelerate read when they start."""
_UNDONE: list[Callable[[], object]] = []
_SIGNALS = {
    getattr(signal, name): words
    for name, words in {
        "SIGINT": "interrupted",
        "SIGTERM": "terminated",
        "SIGHUP": "terminated: its terminal was closed",
    }.items()
    if hasattr(signal, name)
}


def python(code: str, *arguments: str) -> list[str]:
    """The command line of a Python that runs the code, with its `sys.argv[1:]`.

    The child does not look for modules in the current folder (``-P``), where a file such as ``numpy.py`` would be executed; it
    finds this program also in a checkout that is not installed.
    """
    flags, home = ["-P", "-B"] if sys.dont_write_bytecode else ["-P"], str(Path(__file__).resolve().parents[1])
    return [sys.executable, *flags, "-c", f"import sys; sys.path.append({home!r})\n{code}", *arguments]


def compute_algebra_in_one_thread() -> None:
    """Linear algebra uses one thread, unless the environment states how many; must be called before numpy is imported.

    The matrices of a scan are small: further threads wait for each other while other processes need the processor, and the sums
    would be rounded differently on machines of different numbers of cores.
    """
    for name in ALGEBRA:
        os.environ.setdefault(name, "1")


@contextmanager
def undone_if_ended(undo: Callable[[], object]) -> Iterator[None]:
    """Within it `undo` is called if a signal ends the process: what is written half is removed, and children are ended."""
    _UNDONE.append(undo)
    try:
        yield
    finally:
        _UNDONE.remove(undo)


def end(code: int) -> NoReturn:
    """End the process at once, when all that it was about is undone."""
    while _UNDONE:
        with suppress(Exception):
            _UNDONE.pop()()
    os._exit(code)


def end_on_signals() -> None:
    """Let Ctrl-C, and the signals that ask a process to end, end this one in a sentence, with the exit code 128 + signal.

    No exception is raised for that: libraries would catch it and go on, and the import of VTK would end in a crash.
    """

    def receive(number: int, _: object) -> None:
        for other in _SIGNALS:
            signal.signal(other, signal.SIG_IGN)
        # on a terminal the cursor is behind the progress or behind ^C
        newline = "\n" if sys.stderr is not None and sys.stderr.isatty() else ""
        with suppress(OSError):
            os.write(2, f"{newline}scan3d: {_SIGNALS[number]}\n".encode())
        end(128 + number)

    for number in _SIGNALS:
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):  # not under nohup
            signal.signal(number, receive)


def memory_bytes() -> float:
    """Memory that this process can have at most: that of the machine, of its container, or of the limit set for it."""
    limits = [float("inf")]
    with suppress(OSError, ValueError, AttributeError):  # not on every system
        limits.append(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    with suppress(OSError, ValueError):  # where Linux states the limit of a container; "max" is no number
        limits.append(int(Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii")))
    with suppress(ImportError):
        import resource

        limits.append(resource.getrlimit(resource.RLIMIT_AS)[0])
    return min(limit for limit in limits if limit > 0)  # no limit of the address space is -1


def check_memory(needed: float, what: str, advice: str) -> None:
    """Raises InputError if something needs more bytes than this machine has.

    what
        is the subject of the sentence, such as "a scan of 10 slices".
    advice
        is what to do instead, its last clause.
    """
    limit = memory_bytes()
    if needed > limit:
        gigabytes = min(needed, 1e300) / 1e9  # a whole number may be larger than any float
        raise InputError(f"{what} needs about {gigabytes:.3g} GB, and this machine has {limit / 1e9:.3g} GB; {advice}")
