"""How the command line is parsed and what is printed where it is used wrongly."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from typing import Any, NoReturn

from scan3d.cli.terminal import one_line
from scan3d.files.reading import did_you_mean


class Parser(argparse.ArgumentParser):
    """A parser whose error messages are one line, which names what was probably meant and ends with a reference to the help."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        # by default "-60,25" would be an option
        self._negative_number_matcher = re.compile(r"-[\d.][\d.,eE+-]*$")

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        found, unknown = self.parse_known_args(args, namespace)
        if unknown:
            found.parser.error(f"unrecognized arguments: {' '.join(unknown)}{found.parser.options_like(unknown)}")
        return found

    def options_like(self, unknown: Sequence[str]) -> str:
        """The last clause of a message on unknown arguments: the options that they resemble."""
        given = [word[2:].partition("=")[0] for word in unknown if word.startswith("--")]
        return did_you_mean(given, [name[2:] for name in self._option_string_actions if name.startswith("--")], "--")

    def error(self, message: str) -> NoReturn:
        choice = re.search(r"invalid choice: '(.*)' \(choose from (.*)\)$", message)
        if choice:
            message += did_you_mean([choice[1]], [value.strip("'") for value in choice[2].split(", ")])
        self.exit(2, f"scan3d: {one_line(message)}; see '{self.prog} --help'\n")


class Version(argparse.Action):
    """Prints the version, which is looked up only when it is needed."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from importlib.metadata import version

        print(version("scan3d"))
        parser.exit()
