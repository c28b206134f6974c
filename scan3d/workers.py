"""Worker processes that outlive the death of one of them.

A `concurrent.futures.ProcessPoolExecutor` is lost with the first of its processes that is killed, and does not say which call
that process was busy with.  `Workers` has a pool of one process for each worker instead: a death concerns one call, and the
next call of that worker has a fresh process.

This module needs the standard library only: a worker imports it before numpy, whose number of threads it sets.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from queue import LifoQueue
from types import TracebackType
from typing import Any

from scan3d.errors import InputError
from scan3d.processes import ALGEBRA

# What libraries read when they start: the number of threads of linear algebra, of OpenMP and of Mesa's software renderer.
_THREADS = (*ALGEBRA, "OMP_NUM_THREADS", "LP_NUM_THREADS")

# Keeps the current folder out of the module path of Python's children, so that no file that lies there is executed.  What
# starts them asks neither for `-P` nor for `-I`.
_SAFE_PATH = "PYTHONSAFEPATH"
_STARTING = threading.Lock()


class Workers(Executor):
    """An executor of so many processes, each of which computes with one thread.

    A call whose process dies raises `BrokenExecutor`; other calls are not concerned.  Leaving the ``with`` block by an
    exception ends the processes at once.  Processes are started when they are first needed, and end with the process that
    started them, even if that is killed.

    Raises InputError unless the number of workers is a whole number of at least 1.
    """

    def __init__(self, jobs: int) -> None:
        if isinstance(jobs, bool) or not isinstance(jobs, int) or jobs < 1:
            raise InputError(f"jobs must be a whole number of at least 1, got {jobs!r}")
        self._threads = ThreadPoolExecutor(jobs, thread_name_prefix="scan3d-worker")
        self._all = [_Process() for _ in range(jobs)]
        # the process that was used last is used first: fewer are started than are allowed, if there are few calls
        self._idle: LifoQueue[_Process] = LifoQueue()
        for process in self._all:
            self._idle.put(process)

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """As `Executor.submit`."""
        return self._threads.submit(self._call, fn, args, kwargs)

    def _call(self, fn: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
        process = self._idle.get()
        try:
            return process.call(fn, args, kwargs)
        finally:
            self._idle.put(process)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """As `Executor.shutdown`."""
        self._threads.shutdown(wait, cancel_futures=cancel_futures)
        if wait:
            for process in self._all:
                process.close()

    def kill(self) -> None:
        """End all processes at once; calls that are running or waiting raise `BrokenExecutor`."""
        for process in self._all:
            process.kill()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            self.kill()
        self.shutdown(cancel_futures=kind is not None)


class _Process:
    """A pool of one process, which is replaced when it dies."""

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None
        self._pid: int | None = None
        self._is_killed = False

    def call(self, fn: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
        try:
            if self._pool is None:
                with _safe_path():
                    # a fork would copy the locks of threads; a spawned process starts afresh
                    context = multiprocessing.get_context("spawn")
                    self._pool = ProcessPoolExecutor(1, mp_context=context, initializer=_begin)
                    pid = self._pool.submit(os.getpid)
                self._pid = pid.result()
            if self._is_killed:  # while it was being started
                raise BrokenExecutor("the workers have been ended")
            return self._pool.submit(fn, *args, **kwargs).result()
        except BrokenExecutor:
            self.close()
            raise

    def close(self) -> None:
        pool, self._pool, self._pid = self._pool, None, None
        if pool is not None:
            pool.shutdown()

    def kill(self) -> None:
        self._is_killed = True
        pid = self._pid
        if pid is not None:
            with suppress(OSError):  # it has just ended
                os.kill(pid, getattr(signal, "SIGKILL", signal.SIGTERM))


@contextmanager
def _safe_path() -> Iterator[None]:
    """Processes that are started here do not look for modules in the current folder."""
    with _STARTING:
        before = os.environ.get(_SAFE_PATH)
        os.environ[_SAFE_PATH] = "1"
        try:
            yield
        finally:
            os.environ.pop(_SAFE_PATH)
            if before is not None:
                os.environ[_SAFE_PATH] = before


def _begin() -> None:
    """What a worker does first."""
    for name in _THREADS:
        os.environ.setdefault(name, "1")
    # Ctrl-C in a terminal reaches all its processes: the one that started this one ends it
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    logging.captureWarnings(True)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
