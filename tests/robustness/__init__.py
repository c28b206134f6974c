"""Odd files and options, with what the commands should answer to them, and a fuzzer that looks for more."""

import argparse


def options(doc, **defaults):
    """The options of a program: for each its default, of whose type it is; of several where that is a list."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in defaults.items():
        several = isinstance(default, (list, tuple))
        kind = type(default[0] if several else default)
        taken = {"action": "store_true"} if kind is bool else {"type": kind, "nargs": "+" if several else None}
        parser.add_argument(f"--{name}", default=default, **taken)
    return parser.parse_args()
