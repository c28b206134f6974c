"""Calls that are computed side by side in threads, for functions that release Python's lock, as those of Qhull do.

What they return does not depend on the number of threads.  A function that is called here must not be the first to import VTK.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from typing import TypeVar

Part = TypeVar("Part")
Result = TypeVar("Result")


def number() -> int:
    """OMP_NUM_THREADS, which this program sets to 1 in the processes of a batch, or the number of cores."""
    stated = os.environ.get("OMP_NUM_THREADS", "")
    return max(1, int(stated)) if stated.isdecimal() else os.cpu_count() or 1


def begun(function: Callable[..., Result], *arguments: object) -> Callable[[], Result]:
    """Begins a call in a thread of its own, and returns a function that waits for its result or raises its exception.

    With one thread the call is made when its result is asked for, which should be done once.
    """
    if number() == 1:
        return lambda: function(*arguments)
    pool = ThreadPoolExecutor(1)
    future = pool.submit(copy_context().run, function, *arguments)
    pool.shutdown(wait=False)  # the thread ends with its call
    return future.result


def each(function: Callable[[Part], Result], parts: Iterable[Part]) -> Iterator[Result]:
    """The results of a function for each of several parts, in their order, as `map`; the parts are all made at the first."""
    if number() == 1:
        yield from map(function, parts)
    else:
        with ThreadPoolExecutor(number()) as pool:
            # what numpy does about floating-point errors is a part of the context, of which every call needs a copy
            contexts = iter(copy_context, None)
            yield from pool.map(lambda context, part: context.run(function, part), contexts, parts)
