"""Summaries for the eye: a table where a terminal reads, colour where it is welcome, plain text everywhere else."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Mapping
from typing import Any

# A summary's line is a label of 18 characters, a blank and its value; a line that begins with a number is a heading.
_ROW = re.compile(r"(?=\D)(.{18}) (\S.*)")
# What counts in a value: all before the first comma or bracket.
_KEY = re.compile(r"[^,(]*[^,( ]")
_BOLD, _DIM, _OFF = "\x1b[1m", "\x1b[2m", "\x1b[0m"


def is_terminal(stream: Any, environment: Mapping[str, str] = os.environ) -> bool:
    """Whether somebody looks at the stream, through more than a teletype."""
    return stream is not None and stream.isatty() and environment.get("TERM") != "dumb"


def is_colourful(stream: Any, environment: Mapping[str, str] = os.environ) -> bool:
    """Whether the stream's terminal takes colour: not where NO_COLOR is set (no-color.org), nor in Windows' old console."""
    old = sys.platform == "win32" and "WT_SESSION" not in environment
    return is_terminal(stream, environment) and not environment.get("NO_COLOR") and not old


def table(text: str, stream: Any, environment: Mapping[str, str] = os.environ) -> str:
    """A summary as a table, its key figures bold, as far as the stream's terminal can show it; else as it is."""
    if not is_terminal(stream, environment):
        return text
    bold, dim, off = (_BOLD, _DIM, _OFF) if is_colourful(stream, environment) else ("", "", "")
    bar, rule = ("│", "─") if _can_say("│─", stream) else ("|", "-")
    lines = text.splitlines()
    width = max(map(len, lines)) + 2
    out = []
    for line in lines:
        row = _ROW.fullmatch(line)
        if row is None:
            out += [f"{bold}{line}{off}", dim + rule * width + off]
        else:
            key = _KEY.match(row[2])
            end = key.end() if key else 0
            out.append(f"{row[1]} {dim}{bar}{off} {bold}{row[2][:end]}{off}{row[2][end:]}")
    return "\n".join(out)


def _can_say(characters: str, stream: Any) -> bool:
    try:
        characters.encode(getattr(stream, "encoding", None) or "ascii")
    except (UnicodeEncodeError, LookupError):
        return False
    return True
