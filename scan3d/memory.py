"""The memory of this machine, and refusals of work that does not fit into it."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

from scan3d.errors import InputError

# Taken where a system does not say how much it has, in bytes.  Larger, some machines would be brought to swap; smaller, large
# recordings would be refused that could be computed.
_UNKNOWN = 16 << 30
# Numbers of bytes that are not printed, because their digits mean nothing.
_MOST = 1e18
# Where Linux states the limit of a container.
_CONTAINER_LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")


def memory_bytes() -> int:
    """Memory that this process can have at most: that of the machine, of its container, or of the limit set for it."""
    limits = []
    with suppress(OSError, ValueError, AttributeError):  # not on every system
        limits.append(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    for path in _CONTAINER_LIMITS:
        with suppress(OSError, ValueError):  # "max" is no number
            limits.append(int(Path(path).read_text(encoding="ascii")))
    with suppress(ImportError):
        import resource

        address_space = resource.getrlimit(resource.RLIMIT_AS)[0]
        if address_space != resource.RLIM_INFINITY:
            limits.append(address_space)
    return min((limit for limit in limits if limit > 0), default=_UNKNOWN)


def check_memory(needed: float, what: str, advice: str) -> None:
    """Raises InputError if something needs more bytes than this machine has.

    what
        is the subject of the sentence, such as "a scan of 10 slices".
    advice
        is what to do instead, its last clause.
    """
    limit = memory_bytes()
    if needed > limit:
        amount = f"about {_in_words(needed)}" if needed < _MOST else "more memory than any machine has"
        raise InputError(f"{what} needs {amount}, and this machine has {_in_words(limit)}; {advice}")


def _in_words(count: float) -> str:
    """A number of bytes in a unit that leaves few digits."""
    for factor, unit in ((1e12, "TB"), (1e9, "GB"), (1e6, "MB")):
        if count >= factor:
            return f"{count / factor:.3g} {unit}"
    return "less than 1 MB"
