"""What the commands share: options, results on stdout, and on stderr what a command is doing and how long it will take.

No numerical library is imported here, so that ``scan3d --help`` is quick.
"""

from __future__ import annotations

import codecs
import json
import os
import re
import sys
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field, fields, make_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

from cyclopts import Group, Parameter, Token

from scan3d.settings import Settings, settings
from scan3d.workers import heard, undone_if_ended


def _whole(_: Any, tokens: Sequence[Token]) -> int:
    """A whole number: cyclopts would take 4.5 as 4."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise ValueError(f"expected a whole number, got {tokens[0].value!r}") from None


File = Annotated[Path, Parameter(metavar="FILE")]
Folder = Annotated[Path, Parameter(metavar="DIR")]
Mesh = Annotated[Path, Parameter(metavar="MESH")]
Rig = Annotated[Path | None, Parameter(metavar="RIG")]
Number = Annotated[int, Parameter(metavar="N", converter=_whole)]
Body = Annotated[str, Parameter(metavar="BODY")]
Overwrite = Annotated[
    bool, Parameter(help="replace also files that scan3d did not write, or that were changed since", show_default=False)
]
Strict = Annotated[
    bool,
    Parameter(help="exit with 1 if the recording contradicts the model (results are written)", show_default=False),
]
Flag = Annotated[bool, Parameter(show_default=False)]


@Parameter(name="*")
@dataclass(frozen=True)
class Output:
    """How a command prints its result."""

    json: Annotated[bool, Parameter(help="print the result as JSON", show_default=False)] = False
    quiet: Annotated[bool, Parameter(help="print no progress and no summary", show_default=False)] = False
    progress: Annotated[Any, Parameter(parse=False)] = None


@dataclass(frozen=True)
class _Chosen:
    """The settings of a scan as the command line and a file give them."""

    config: Annotated[File | None, Parameter(help="settings from a TOML file")] = None
    print_config: Annotated[Flag, Parameter(help="print the resulting settings as such a file, and exit")] = False

    def given(self) -> dict[str, Any]:
        """Those of the command line."""
        values = {one.name: getattr(self, one.name) for one in fields(Settings)}
        return {name: value for name, value in values.items() if value is not None and value is not False}

    def chosen(self) -> Settings:
        """All settings.  Raises InputError as `scan3d.settings.settings`."""
        return settings(self.given(), self.config)


def _options() -> Any:
    """A class with an option for each field of `Settings`, None or False where it is not given."""
    kinds = get_type_hints(Settings)
    made: list[tuple[str, Any, Any]] = []
    for one in fields(Settings):
        shown: Any = False if one.default is False else lambda _, default=one.default: default
        kind, meaning = Number if kinds[one.name] is int else kinds[one.name], one.metadata["meaning"]
        parameter = Parameter(help=meaning, show_default=shown, allow_leading_hyphen=kind is str)
        if kind is bool:
            made.append((one.name, Annotated[bool, parameter], False))
        else:
            made.append((one.name, Annotated[kind | None, parameter], field(default=None)))
    group = Group("Settings", help="The command line takes precedence over --config, and --config over the defaults.")
    options = make_dataclass("Options", made, bases=(_Chosen,), namespace={"__module__": __name__}, frozen=True)
    return Parameter(name="*", group=group)(options)


if TYPE_CHECKING:
    Options = _Chosen
else:
    Options = _options()


# Characters that a terminal obeys instead of showing them: the control characters (C0, DEL, C1), the line and paragraph
# separators, the marks that turn the direction of writing (Unicode's "Trojan source"), and surrogates, which are no characters.
_OBEYED = re.compile("[\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
EVERY_S = 20.0
"""Seconds from line to line on what a command is doing, where there is no terminal."""
# The steps of a scan, by their names in `timings_s` of a report.
_STEPS = {
    "load": "reading",
    "simulate": "simulating",
    "reconstruct": "contacts and normals",
    "check": "agreement with the model",
    "bounds": "bounds",
    "surface": "surface",
    "certificate": "certificate",
    "compare": "comparison with the mesh",
    "pictures": "pictures and page",
    "write": "writing",
}


SPELLED = "scan3d.spelled"
"""The handler of characters that the encoding of a stream lacks: neither GBK nor the code page of Japanese Windows has µ."""
_SPELLINGS = {
    "µ": "u",
    "μ": "u",
    "°": " deg",
    "±": "+/-",
    "×": "x",
    "·": "*",
    "⋅": "*",
    "−": "-",
    "–": "-",
    "²": "2",
    "³": "3",
}


def _spelled(error: UnicodeError) -> tuple[str, int]:
    """The missing characters in ASCII: signs as one writes them without, others as JSON escapes them."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    missing = error.object[error.start : error.end]
    return "".join(_SPELLINGS.get(one) or json.dumps(one)[1:-1] for one in missing), error.end


codecs.register_error(SPELLED, _spelled)


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
    """A message in one line of printable characters, without its middle if it repeats, say, a number of 400 digits."""
    line = printable(" ".join(message.splitlines()))
    return line if len(line) <= 1000 else f"{line[:500]} ... {line[-500:]}"


def say(sentence: str) -> None:
    """Write a message to stderr."""
    print(f"scan3d: {one_line(sentence)}", file=sys.stderr)


def is_terminal(stream: Any) -> bool:
    """Whether the stream is a terminal that can move its cursor."""
    return stream is not None and stream.isatty() and os.environ.get("TERM") != "dumb"


def table(heading: str, rows: Iterable[tuple[str, str]]) -> str:
    """Rows (label, value) under a heading, which may be empty, as text for stdout.

    On a terminal heading and key figures are bold, unless NO_COLOR (no-color.org) is set or it is the old console of Windows.
    """
    old_console = sys.platform == "win32" and "WT_SESSION" not in os.environ
    is_bold = is_terminal(sys.stdout) and not os.environ.get("NO_COLOR") and not old_console
    bold, off = ("\x1b[1m", "\x1b[0m") if is_bold else ("", "")
    lines = [f"{bold}{printable(heading)}{off}"] if heading else []
    for label, value in rows:
        shown = printable(value)
        key = re.match(r"[^,(]*[^,( ]", shown)  # the key figure ends at the first comma or parenthesis
        end = key.end() if key else 0
        lines.append(f"{label:18} {bold}{shown[:end]}{off}{shown[end:]}")
    return "\n".join(lines)


def print_result(output: Output, data: Any, text: str) -> int:
    """Print a result as JSON or as text, as the options say; the exit code."""
    from scan3d.files.text import to_json

    output.progress.end()
    if output.json:
        print(printable_json(to_json(data).decode()), end="")
    elif not output.quiet:
        print(text)
    return 0


def print_settings(values: Mapping[str, Any]) -> int:
    """Print settings as a TOML file; the exit code."""
    from scan3d.files.text import to_toml

    print(printable_json(to_toml(values)), end="")
    return 0


class Progress:
    """A context in which stderr shows what a command is doing, how far it is, for how long, and how long it will take.

    It is a line that changes on a terminal; elsewhere a line for each step of a scan, and one every `EVERY_S`.
    """

    def __init__(self, command: str, quiet: bool) -> None:
        self._command, self._quiet = command, quiet
        self._begun = self._since = time.monotonic()
        self._step, self._parts, self._before, self._done, self._total = "starting", "", 0, 0, 0
        self._lines: list[str] = []  # the steps that began in the first second, which most commands do not last
        self._bar: Any = None
        self._over = threading.Event()
        self._context = ExitStack()

    def __enter__(self) -> Progress:
        self._context.enter_context(undone_if_ended(self.end))
        self._context.enter_context(heard(self.tell))
        if self._quiet:
            return self
        if is_terminal(sys.stderr):
            from rich.console import Console
            from rich.live import Live
            from rich.text import Text

            self._bar = Live(
                get_renderable=lambda: Text(f"{self._command}: {self.line()}"),
                console=Console(file=sys.stderr),
                transient=True,
                refresh_per_second=2,
                redirect_stdout=False,
                redirect_stderr=False,
            )
            self._bar.start(refresh=True)
        else:
            threading.Thread(target=self._say_every, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self.end()
        self._context.close()

    def end(self) -> None:
        """Nothing more is shown: before a result is printed."""
        self._quiet = True
        self._over.set()
        if self._bar is not None:
            with suppress(OSError, ValueError):  # the stream may be closed before the run ends
                self._bar.stop()
            self._bar = None

    def _say_every(self) -> None:
        while not self._over.wait(EVERY_S):
            self._say_lines()
            say(self.line())

    def line(self) -> str:
        """What is being done, how many parts of it are done, of how many, for how long, and how long it will take."""
        now = time.monotonic()
        words = f"{duration(now - self._begun)}: {self._step}"
        if self._total:
            words += f", {self._done} of {self._total} {self._parts}"
        if self._before < self._done < self._total:
            left = (now - self._since) * (self._total - self._done) / (self._done - self._before)
            words += f", about {duration(left)} left of this"
        return words

    def tell(self, words: str, done: int = 0, total: int = 0) -> None:
        """Hear that a step begins, by its name in `timings_s` of a report or in words, or how many parts of it are done."""
        if total:
            if total != self._total or done < self._done:
                self._since, self._before = time.monotonic(), done
            self._parts, self._done, self._total = words, done, total
            return
        self._step, self._total = _STEPS.get(words, words), 0
        if words in _STEPS and self._bar is None:
            self._lines.append(self.line())
        self._say_lines()

    def _say_lines(self) -> None:
        while self._lines and not self._quiet and time.monotonic() - self._begun >= 1:
            say(self._lines.pop(0))

    def say(self, sentence: str) -> None:
        """Write a message, which stays."""
        if self._bar is None:
            say(sentence)
        else:
            self._bar.console.print(f"scan3d: {one_line(sentence)}", markup=False, highlight=False, soft_wrap=True)


def duration(seconds: float) -> str:
    """A duration in words: ``3.4 s``, ``12 s``, ``3 min 20 s``, ``2 h 5 min``."""
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    minutes, rest = divmod(whole, 60)
    if minutes < 60:
        return f"{minutes} min {rest} s"
    return f"{minutes // 60} h {minutes % 60} min"
