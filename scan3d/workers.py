"""Worker processes of which each may die alone."""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import suppress
from types import ModuleType, TracebackType
from typing import Any

from scan3d.processes import ALGEBRA, end, undone_if_ended

_STARTING = threading.Lock()


def shared(function: Callable[[Sequence[Any]], list[Any]], items: Sequence[Any], least: int) -> list[Any]:
    """`function(items)`, which has a result for each item, computed part by part in as many processes as there are cores.

    The parts, of so many items at `least`, and with them the results, do not depend on the number of processes.  In a worker,
    beside which others have the other cores, all is computed here, as is the part of a process that is lost.
    """
    count = max(len(items) // least, 1)
    ends = [len(items) * k // count for k in range(count + 1)]
    parts = [items[begin:end] for begin, end in zip(ends[:-1], ends[1:], strict=True)]
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    used = 1 if multiprocessing.parent_process() else min(cores, count)
    with Workers(max(used - 1, 1)) as workers, undone_if_ended(workers.kill):
        asked = {k: workers.submit(function, parts[k]) for k in range(count) if k % used}
        found = {k: function(parts[k]) for k in range(0, count, used)}
        for k, answer in asked.items():
            try:
                found[k] = answer.result()
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
