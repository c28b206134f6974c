"""This process and its workers: how they compute, what they tell of it, what memory they have, and how they end."""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import AbstractContextManager, ContextDecorator, ExitStack, contextmanager, nullcontext, suppress
from contextvars import ContextVar
from pathlib import Path
from types import ModuleType, TracebackType
from typing import Any, NoReturn

from scan3d.errors import InputError

ALGEBRA = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
"""The numbers of threads that OpenBLAS, MKL and Accelerate read when they start."""
Heard = Callable[[str, int, int], object]
"""Is called with what is computed, how many parts of it are done, and of how many, 0 where they are not counted."""
_HEARD: ContextVar[Heard] = ContextVar("_HEARD", default=lambda *_: None)
_UNDONE: list[Callable[[], object]] = []
_SAID: list[str] = []
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


class _OneThread(ContextDecorator):
    """Within it linear algebra uses one thread, unless the environment states how many; afterwards as many as before.

    The command needs it less, whose libraries begin with one, than programs whose processes have other work as well.
    """

    def __init__(self) -> None:
        self._lock, self._inside, self._limit = threading.Lock(), 0, ExitStack()

    def __enter__(self) -> None:
        with self._lock:
            self._inside += 1
            if self._inside == 1 and not any(name in os.environ for name in ALGEBRA):
                import scipy.linalg  # noqa: F401 - what is loaded later is not limited
                from threadpoolctl import threadpool_limits

                self._limit.enter_context(threadpool_limits(1, user_api="blas"))

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._inside -= 1
            if not self._inside:  # by any thread; after several at a time OpenBLAS may stay with one
                self._limit.close()


in_one_thread = _OneThread()


@contextmanager
def heard(by: Heard) -> Iterator[None]:
    """Within it `by` is called with what `tell` tells."""
    before = _HEARD.set(by)
    try:
        yield
    finally:
        _HEARD.reset(before)


def counted(by: Callable[[int, int], object] | None) -> AbstractContextManager[None]:
    """`heard` by a function of the numbers alone, or by those before if there is none."""
    return nullcontext() if by is None else heard(lambda _, done, total: by(done, total) if total else None)


def tell(words: str, done: int = 0, total: int = 0) -> None:
    """Tell who hears of it that a step begins, by its name, or how many parts of it are done, of how many, by their noun."""
    _HEARD.get()(words, done, total)


def told(items: Any, words: str) -> Iterator[Any]:
    """The items, one after the other; tells how many `words` are done before each."""
    for done, item in enumerate(items):
        tell(words, done, len(items))
        yield item


@contextmanager
def undone_if_ended(undo: Callable[[], object]) -> Iterator[None]:
    """Within it `undo` is called if a signal ends the process: what is written half is removed, and children are ended."""
    _UNDONE.append(undo)
    try:
        yield
    finally:
        _UNDONE.remove(undo)


@contextmanager
def said_if_ended(words: str) -> Iterator[None]:
    """Within it `words` are said as well if a signal ends the process; none if they are empty."""
    _SAID.append(words)
    try:
        yield
    finally:
        _SAID.remove(words)


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
            os.write(2, f"{newline}scan3d: {'; '.join(filter(None, [_SIGNALS[number], *_SAID]))}\n".encode())
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


_STARTING = threading.Lock()


def shared(function: Callable[[Sequence[Any]], list[Any]], items: Sequence[Any], least: int, words: str) -> list[Any]:
    """`function(items)`, which has a result for each item, computed part by part in as many processes as there are cores.

    The parts, of so many items at `least`, and with them the results, do not depend on the number of processes.  In a worker,
    beside which others have the other cores, all is computed here, as is the part of a process that is lost.  Tells how many
    `words`, such as sweeps, are done.
    """
    count = max(len(items) // least, 1)
    ends = [len(items) * k // count for k in range(count + 1)]
    parts = [items[begin:end] for begin, end in zip(ends[:-1], ends[1:], strict=True)]
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    used = 1 if multiprocessing.parent_process() else min(cores, count)
    with Workers(max(used - 1, 1)) as workers, undone_if_ended(workers.kill):
        asked = {k: workers.submit(function, parts[k]) for k in range(count) if k % used}
        found: dict[int, list[Any]] = {}
        for k in [*range(0, count, used), *asked]:
            done = {*found, *(other for other, answer in asked.items() if answer.done())}
            tell(words, sum(len(parts[other]) for other in done), len(items))
            try:
                found[k] = asked[k].result() if k in asked else function(parts[k])
            except BrokenExecutor:
                found[k] = function(parts[k])
    return [result for k in range(count) for result in found[k]]


class Workers(Executor):
    """An executor of so many processes, each of which computes with one thread.

    A call whose process dies raises `BrokenExecutor`; other calls are not concerned, unlike those of a
    `ProcessPoolExecutor`, which is lost with the first of its processes.  Leaving the ``with`` block by an exception ends the
    processes at once.  Processes are started when they are first needed, and end with the process that started them, even if
    that is killed.
    """

    def __init__(self, jobs: int) -> None:
        # each thread has a pool of one process, which it replaces when that has died
        self._threads = ThreadPoolExecutor(jobs, thread_name_prefix="scan3d-worker")
        self._of_thread = threading.local()
        self._all: dict[int, ProcessPoolExecutor] = {}
        self._is_over = False

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """As `Executor.submit`."""
        return self._threads.submit(self._call, fn, args, kwargs)

    def _call(self, fn: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
        if self._is_over:
            raise BrokenExecutor("the workers have been ended")
        pool: ProcessPoolExecutor | None = getattr(self._of_thread, "pool", None)
        try:
            if pool is None:
                # a fork would copy the locks of threads
                pool = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), _get_ready)
                with _STARTING:  # a script that calls this is not to be run again by its children
                    main, sys.modules["__main__"] = sys.modules["__main__"], ModuleType("__main__")
                    try:
                        asked = pool.submit(os.getpid)
                    finally:
                        sys.modules["__main__"] = main
                pid = asked.result()
                self._of_thread.pool, self._of_thread.pid, self._all[pid] = pool, pid, pool
                if self._is_over:  # while it was being started
                    self.kill()
            return pool.submit(fn, *args, **kwargs).result()
        except BrokenExecutor:
            self._of_thread.pool = None
            self._all.pop(getattr(self._of_thread, "pid", 0), None)
            raise

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """As `Executor.shutdown`."""
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        if wait:
            for pool in self._all.values():
                pool.shutdown()

    def kill(self) -> None:
        """End all processes, when they have undone what they were about; no further calls are answered."""
        self._is_over = True
        for pid in self._all:
            with suppress(OSError):  # it has ended
                os.kill(pid, signal.SIGTERM)
        for pool in self._all.values():
            pool.shutdown()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            self._threads.shutdown(wait=False, cancel_futures=True)
            self.kill()
        self.shutdown()


def _get_ready() -> None:
    # what libraries read when they start, of linear algebra, of OpenMP and of Mesa's software renderer
    for name in (*ALGEBRA, "OMP_NUM_THREADS", "LP_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    # Ctrl-C in a terminal reaches all its processes: the one that started this one ends it
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: end(128 + signal.SIGTERM))
    logging.captureWarnings(True)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        end(1)
