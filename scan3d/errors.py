"""The errors of this program that a message for the user explains."""

from __future__ import annotations


class InputError(ValueError):
    """An input that can't be used; the message says what was expected, what came, and what to do."""


class UsageError(InputError):
    """An option or a setting that can't be used; the command line exits with 2, as for an option that it does not know."""
