"""Libraries that only some installations have.  An import that fails becomes one sentence, with the command to run."""

from __future__ import annotations

from typing import Any

from scan3d.errors import InputError


def import_open3d(what: str, otherwise: str = "") -> Any:
    """The module open3d.

    what, otherwise
        what needs it, as the beginning of a sentence ("to_open3d needs"), and what else could be done (", or ...").

    Raises InputError with the command to run, if it is not installed, or if a system library that it needs is missing.
    """
    try:
        import open3d
    except (ImportError, OSError) as error:
        # the extra knows which of open3d's two distributions suits the machine
        command = "pip install 'scan3d[open3d]'"
        if not isinstance(error, ModuleNotFoundError):
            command = "install its system libraries (on Debian or Ubuntu apt-get install libgl1 libgomp1)"
        raise InputError(f"{what} open3d, which can't be imported ({error}): {command}{otherwise}") from None
    return open3d
