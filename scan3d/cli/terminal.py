"""Summaries on the terminal: a table where somebody reads it, colour where it is supported, plain text everywhere else."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterable, Mapping
from typing import Any

# Characters of a label.
_LABEL = 18
# The most important part of a value: everything before the first comma or bracket.
_KEY = re.compile(r"[^,(]*[^,( ]")
_BOLD, _DIM, _OFF = "\x1b[1m", "\x1b[2m", "\x1b[0m"


def is_terminal(stream: Any, environment: Mapping[str, str] = os.environ) -> bool:
    """Whether the stream is a terminal that can do more than print lines."""
    return stream is not None and stream.isatty() and environment.get("TERM") != "dumb"


def is_colourful(stream: Any, environment: Mapping[str, str] = os.environ) -> bool:
    """Whether the stream's terminal supports colour: not where NO_COLOR is set (no-color.org), nor in Windows' old console."""
    old = sys.platform == "win32" and "WT_SESSION" not in environment
    return is_terminal(stream, environment) and not environment.get("NO_COLOR") and not old


def table(
    heading: str, rows: Iterable[tuple[str, str]], stream: Any, environment: Mapping[str, str] = os.environ
) -> str:
    """Rows (label, value) under a heading, which may be empty, as far as the stream's terminal can show them.

    On a terminal the key figures are bold, and a rule stands under the heading and between label and value.
    """
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
