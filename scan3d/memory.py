"""The memory of this machine, and refusals of work that does not fit into it."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from scan3d.errors import InputError

# Where Linux states the limit of a container.
_CONTAINER_LIMIT = Path("/sys/fs/cgroup/memory.max")


def memory_bytes() -> float:
    """Memory that this process can have at most: that of the machine, of its container, or of the limit set for it."""
    limits = [float("inf")]
    with suppress(OSError, ValueError, AttributeError):  # not on every system
        limits.append(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    with suppress(OSError, ValueError):  # "max" is no number
        limits.append(int(_CONTAINER_LIMIT.read_text(encoding="ascii")))
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
