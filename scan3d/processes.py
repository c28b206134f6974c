"""This process and its children: how many threads they compute with, and that they import nothing from the current folder."""

from __future__ import annotations

import os
import sys
from pathlib import Path

# The folder from which this program is imported.  It may be the current one, as in a checkout.
_HOME = Path(__file__).resolve().parents[1]
ALGEBRA = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
"""The numbers of threads that OpenBLAS, MKL and Accelerate read when they start."""


def python(code: str, *arguments: str) -> list[str]:
    """The command line of a Python that runs the code, with its `sys.argv[1:]`.

    The child is isolated (``-I``), so that a file such as ``numpy.py`` in the current folder is not executed.  It gets the
    module path of this process, without the current folder: an editable installation and PYTHONPATH are still found.
    """
    flags = ["-I", "-B"] if sys.dont_write_bytecode else ["-I"]
    return [sys.executable, *flags, "-c", f"import sys; sys.path[:] = {import_path()!r}\n{code}", *arguments]


def import_path() -> list[str]:
    """The folders in which modules are looked for, without the current one unless the program lies in it."""
    return [entry for entry in sys.path if isinstance(entry, str) and not _is_foreign(entry)]


def _is_foreign(entry: str) -> bool:
    """Whether an entry of the module path is the current folder, and the program does not lie in it."""
    try:
        here = Path.cwd()
        return here != _HOME and (not entry or Path(entry).resolve() == here)
    except OSError:  # the current folder has been deleted
        return not entry


def compute_algebra_in_one_thread() -> None:
    """Linear algebra uses one thread, unless the environment states how many; must be called before numpy is imported.

    The matrices of a scan are small: further threads wait for each other while other processes need the processor, and the sums
    would be rounded differently on machines of different numbers of cores.
    """
    for name in ALGEBRA:
        os.environ.setdefault(name, "1")
