"""Summaries: a table on a terminal, coloured where the terminal supports it, and plain text in a pipe or a file."""

from __future__ import annotations

import os
import re
import sys
from argparse import Namespace
from collections.abc import Iterable, Mapping
from typing import Any

# Characters of a label: the longest label, "Hausdorff distance", fits exactly.
_LABEL = 18
# The key figure of a value: the text before the first comma or parenthesis.
_KEY = re.compile(r"[^,(]*[^,( ]")
# Control sequences of ANSI terminals (ECMA-48): bold, dim, and back to normal.
_BOLD, _DIM, _OFF = "\x1b[1m", "\x1b[2m", "\x1b[0m"

# Characters that a terminal obeys instead of showing them: the control characters (C0, DEL, C1), the line and paragraph
# separators, the marks that turn the direction of writing (Unicode's "Trojan source"), and surrogates, which are no characters.
_OBEYED = re.compile("[\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
# Characters of a message; a longer one, such as one that repeats a number of 400 digits, loses its middle.
_LONGEST = 1000


def printable(text: str) -> str:
    """The text with the characters that a terminal would obey written as escapes (\\x1b, \\u202e).

    File names and texts from files may hold such characters.
    """

    def escape(match: re.Match[str]) -> str:
        code = ord(match[0])
        return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"

    return _OBEYED.sub(escape, text)


def printable_json(text: str) -> str:
    """JSON or TOML with the characters in its strings that a terminal would obey written as its own escapes."""
    return _OBEYED.sub(lambda match: match[0] if match[0] == "\n" else f"\\u{ord(match[0]):04x}", text)


def one_line(message: str) -> str:
    """A message in one line of printable characters, without its middle if it is very long."""
    line = printable(" ".join(message.splitlines()))
    return line if len(line) <= _LONGEST else f"{line[: _LONGEST // 2]} ... {line[-_LONGEST // 2 :]}"


def is_terminal(stream: Any, environment: Mapping[str, str] = os.environ) -> bool:
    """Whether the stream is a terminal that can move its cursor."""
    return stream is not None and stream.isatty() and environment.get("TERM") != "dumb"


def is_colourful(stream: Any, environment: Mapping[str, str] = os.environ) -> bool:
    """Whether the stream is a terminal that supports colour.

    Colour is switched off by NO_COLOR (no-color.org), and is not supported by the old console of Windows.
    """
    old_console = sys.platform == "win32" and "WT_SESSION" not in environment
    return is_terminal(stream, environment) and not environment.get("NO_COLOR") and not old_console


def table(
    heading: str, rows: Iterable[tuple[str, str]], stream: Any, environment: Mapping[str, str] = os.environ
) -> str:
    """Rows (label, value) under a heading, which may be empty, as text for the stream.

    On a terminal the key figures are bold, and there is a rule under the heading and between label and value.
    """
    heading = printable(heading)
    rows = [(label, printable(value)) for label, value in rows]
    plain = [f"{label:{_LABEL}} {value}" for label, value in rows]
    if not is_terminal(stream, environment):
        return "\n".join([*([heading] if heading else []), *plain])
    bold, dim, off = (_BOLD, _DIM, _OFF) if is_colourful(stream, environment) else ("", "", "")
    bar, rule = ("│", "─") if _encodes("│─", stream) else ("|", "-")
    lines = []
    if heading:
        width = max(map(len, [heading, *plain])) + 2
        lines = [f"{bold}{heading}{off}", dim + rule * width + off]
    for label, value in rows:
        key = _KEY.match(value)
        end = key.end() if key else 0
        lines.append(f"{label:{_LABEL}} {dim}{bar}{off} {bold}{value[:end]}{off}{value[end:]}")
    return "\n".join(lines)


def _encodes(characters: str, stream: Any) -> bool:
    try:
        characters.encode(getattr(stream, "encoding", None) or "ascii")
    except (UnicodeEncodeError, LookupError):
        return False
    return True


def print_result(arguments: Namespace, data: Any, text: str) -> int:
    """Print a result as JSON or as text, as the options say; the exit code."""
    from scan3d.files.text import to_json

    arguments.progress.end()
    if arguments.json:
        print(printable_json(to_json(data).decode()), end="")
    elif not arguments.quiet:
        print(text)
    return 0


def print_settings(arguments: Namespace, values: Mapping[str, Any]) -> int:
    """Print settings as a TOML file; the exit code."""
    from scan3d.files.text import to_toml

    arguments.progress.end()
    print(printable_json(to_toml(values)), end="")
    return 0
