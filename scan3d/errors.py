"""Errors in a user's input."""


class InputError(ValueError):
    """An input that can't be used.

    The message is one sentence that says what was expected, what was given, and what to do.  The command line prints it and
    exits with 1.
    """
