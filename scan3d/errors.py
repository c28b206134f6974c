"""The errors of this program that a message for the user explains, and libraries that only some installations have."""

from __future__ import annotations

from typing import Any


class InputError(ValueError):
    """An input that can't be used; the message says what was expected, what came, and what to do."""


class NoBodyError(InputError):
    """Contacts that span no body, such as those of one sweep: they have neither surface nor bounds."""


class UsageError(InputError):
    """An option or a setting that can't be used; the command line exits with 2, as for an option that it does not know."""


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
            command = "install its system libraries (on Debian or Ubuntu apt-get install libgl1 libgomp1 libusb-1.0-0)"
        raise InputError(f"{what} open3d, which can't be imported ({error}): {command}{otherwise}") from None
    return open3d
