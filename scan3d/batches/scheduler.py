"""A Dask cluster as an executor; dask.distributed is imported only here."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager

from scan3d.errors import InputError

# Seconds for which a scheduler is looked for.  Shorter, one that is just starting would not be found; longer, a wrong address
# is slow to be told.
_TIMEOUT_S = 20


@contextmanager
def scheduled(address: str) -> Iterator[Executor]:
    """The executor of a Dask cluster, given the address of its scheduler, such as ``tcp://node1:8786``.

    Its workers need this program in the same version, and the folders of meshes and results under the same paths.  Leaving the
    block cancels what is not finished.

    Raises InputError if dask.distributed is not installed, or if no scheduler answers.
    """
    try:
        from distributed import Client
    except ImportError:
        raise InputError("a scheduler needs dask.distributed: pip install 'scan3d[cluster]'") from None
    try:
        client = Client(address, timeout=_TIMEOUT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"no Dask scheduler answers at {address} ({error}); start one with 'dask scheduler', and give the address it prints"
        ) from None
    with client:
        executor = client.get_executor(pure=False)
        try:
            yield executor
        finally:
            executor.shutdown(wait=False)
