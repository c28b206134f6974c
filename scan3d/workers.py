"""Worker processes of which each may die alone."""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import suppress
from types import TracebackType
from typing import Any

from scan3d.errors import InputError
from scan3d.processes import ALGEBRA, end

# What libraries read when they start: the number of threads of linear algebra, of OpenMP and of Mesa's software renderer.
_THREADS = (*ALGEBRA, "OMP_NUM_THREADS", "LP_NUM_THREADS")


class Workers(Executor):
    """An executor of so many processes, each of which computes with one thread.

    A call whose process dies raises `BrokenExecutor`; other calls are not concerned, unlike those of a
    `ProcessPoolExecutor`, which is lost with the first of its processes.  Leaving the ``with`` block by an exception ends the
    processes at once.  Processes are started when they are first needed, and end with the process that started them, even if
    that is killed.

    Raises InputError unless the number of workers is a whole number of at least 1.
    """

    def __init__(self, jobs: int) -> None:
        if isinstance(jobs, bool) or not isinstance(jobs, int) or jobs < 1:
            raise InputError(f"jobs must be a whole number of at least 1, got {jobs!r}")
        # each thread has a pool of one process, which it replaces when that has died
        self._threads = ThreadPoolExecutor(jobs, thread_name_prefix="scan3d-worker")
        self._of_thread = threading.local()
        self._pools: list[ProcessPoolExecutor] = []
        self._pids: set[int] = set()

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """As `Executor.submit`."""
        return self._threads.submit(self._call, fn, args, kwargs)

    def _call(self, fn: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
        pool, pid = getattr(self._of_thread, "own", (None, 0))
        try:
            if pool is None:
                # a fork would copy the locks of threads; a spawned process starts afresh
                pool = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), initializer=_begin)
                self._pools.append(pool)
                pid = pool.submit(os.getpid).result()
                self._pids.add(pid)
                self._of_thread.own = pool, pid
            return pool.submit(fn, *args, **kwargs).result()
        except BrokenExecutor:
            self._pids.discard(pid)
            self._of_thread.own = None, 0
            raise

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """As `Executor.shutdown`."""
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        for pool in self._pools:
            pool.shutdown(wait)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            self.kill()
        self.shutdown(cancel_futures=kind is not None)

    def kill(self) -> None:
        """End all processes at once, when they have undone what they were about."""
        for pid in self._pids:
            with suppress(OSError):  # it has just ended
                os.kill(pid, signal.SIGTERM)


def _begin() -> None:
    """What a worker does first."""
    for name in _THREADS:
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
