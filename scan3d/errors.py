"""What goes wrong with what a user gives, in words a user can act on."""


class InputError(ValueError):
    """What the user gave can't be used.

    The message is one sentence: what was expected, what came, what to do. The command line prints it and exits with 1.
    """
