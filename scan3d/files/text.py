"""Files of text: TOML that is read entry by entry, and TOML, JSON and tables that are written from plain values.

What is no regular file, or does not fit into memory, is refused before it is read.  In tables of TOML files types, ranges and
words are checked, and names that nothing reads are refused.  Each message names the file, the table and the entry, and says
what was expected and what came.  Settings are read here, and help must not wait for numpy.
"""

from __future__ import annotations

import codecs
import errno
import json
import math
import os
import re
import stat
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from scan3d.errors import InputError
from scan3d.rods import MODULI_PA, Rod
from scan3d.units import is_finite
from scan3d.workers import check_memory

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from scan3d.rigs import Frame


def check_readable(path: Path, *, memory_per_byte: float = 2.0) -> None:
    """Raises OSError for a file that does not exist, InputError for what is no regular file or does not fit into memory.

    A device or a pipe could be read without end; `memory_per_byte` is the memory that is needed per byte of the file.
    """
    try:
        state = path.stat()
    except ValueError as error:  # a name with a null character
        raise OSError(str(error)) from None
    if stat.S_ISDIR(state.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(state.st_mode):
        raise InputError(f"{path} is a device or a pipe, where a file is expected; copy its contents into a file")
    check_memory(memory_per_byte * state.st_size, f"reading {path.name}", "take a smaller file")


def decoded(data: bytes) -> str:
    """The text of a file in UTF-8, or in UTF-16 with its mark, as Windows writes it.

    Raises ValueError that names the line of other bytes; a null character is no text, and UTF-16 without its mark is full of
    them.
    """
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", errors="replace")  # a log may be cut off within a character
    try:
        text = data.decode("utf-8-sig")
        place = data.find(b"\0")
    except UnicodeDecodeError as error:
        text, place = "", error.start
    if place < 0:
        return text
    line = data.count(b"\n", 0, place) + 1
    raise ValueError(f"line {line} is no UTF-8: save it as UTF-8")


def read_small(path: Path) -> str:
    """The text of a file of settings or results.  Raises OSError and ValueError, InputError as `check_readable`."""
    check_readable(path)
    if path.stat().st_size > 50 << 20:  # those of a scan have a few thousand bytes
        raise ValueError(f"it has {path.stat().st_size >> 20} MB, and such files are small")
    return decoded(path.read_bytes()).replace("\r\n", "\n").replace("\r", "\n")


def to_float(value: float) -> float:
    """A number as a float; a whole number too large for one is infinite, as a decimal number is."""
    try:
        return float(value)
    except OverflowError:
        return float("inf") if value > 0 else float("-inf")


def did_you_mean(unknown: Iterable[str], known: Iterable[str]) -> str:
    """The last clause of a message on unknown names: the known ones that they resemble, or an empty string."""
    names = {name.lower(): name for name in known}
    near = [names[match] for name in unknown for match in get_close_matches(name.lower(), list(names), n=1)]
    return f"; did you mean {' and '.join(near)}?" if near else ""


T = TypeVar("T")
REQUIRED: Any = object()
"""The default of an entry that must be there."""


class Section:
    """A table of a TOML file whose entries are taken by name; those without a default must be there."""

    def __init__(self, file: str, data: Mapping[str, Any], name: str = "", near: str = "") -> None:
        self.file, self.data, self.name, self._near = file, data, name, near
        self._asked: dict[str, None] = {}
        self._inner: list[Section] = []

    def __contains__(self, key: str) -> bool:
        return key in self.data

    def __bool__(self) -> bool:
        return bool(self.data)

    def error(self, key: str, sentence: str) -> InputError:
        """The error of an entry, or of the whole table if `key` is empty; where that is missing, with a name that is near."""
        sentence += (self._likely(key) if self.data else self._near) if key not in self.data else ""
        return InputError(" ".join(filter(None, (f"{self.file}:", self.name and f"[{self.name}]", key, sentence))))

    @contextmanager
    def errors_named(self) -> Iterator[None]:
        """Let errors of values that are made of the table name the file and the table."""
        try:
            yield
        except InputError as error:
            raise self.error("", str(error)) from None

    def finish(self, advice: str = "") -> None:
        """Raise InputError for names, here and in the tables within, that nobody asked for."""
        known = list(self._asked)
        unknown = sorted(set(self.data) - set(known))
        if unknown:
            what = f"unknown names: {', '.join(unknown)}; known are {', '.join(known)}{advice}"
            raise self.error("", f"{'has ' if self.name else ''}{what}{did_you_mean(unknown, known)}")
        for section in self._inner:
            section.finish(advice)

    def any(self, key: str, default: Any = None) -> Any:
        """The value of an entry, whatever its type."""
        self._asked[key] = None
        return self.data.get(key, default)

    def _value(self, key: str, default: Any, what: str, is_right: Callable[[Any], bool]) -> Any:
        """The value of an entry, or its default.  Raises InputError if it has neither, and for one that is not right."""
        value = self.any(key, default)
        if value is REQUIRED:
            raise self.error(key, "is missing")
        if key in self.data and not is_right(value):
            raise self.error(key, f"must be {what}, got {value!r}")
        return value

    def notes(self, key: str) -> Mapping[str, Any]:
        """A table within this one that may hold anything; an empty one if it is not there."""
        value = self.any(key, {})
        if not isinstance(value, Mapping):
            raise self.error(key, f"must be a section [{self._path(key)}] or a table in braces, got {value!r}")
        return value

    def section(self, key: str) -> Section:
        """A table within this one, with entries of its own; an empty one if it is not there."""
        near = "" if key in self.data else self._likely(key)
        self._inner.append(Section(self.file, self.notes(key), self._path(key), near))
        return self._inner[-1]

    def _likely(self, key: str) -> str:
        return did_you_mean([key], [name for name in self.data if name not in self._asked])

    def _path(self, key: str) -> str:
        return f"{self.name}.{key}" if self.name else key

    def text(self, key: str, default: str = REQUIRED) -> str:
        """A text."""
        return str(self._value(key, default, "text", lambda value: isinstance(value, str)))

    def word(self, key: str, words: Sequence[str], default: str | None = None) -> str:
        """One of some words; by default the first of them."""
        value = self.any(key, words[0] if default is None else default)
        if value not in words:
            near = did_you_mean([value], words) if isinstance(value, str) else ""
            raise self.error(key, f"must be one of {', '.join(words)}; got {value!r}{near}")
        return str(value)

    def boolean(self, key: str, default: bool = REQUIRED) -> bool:
        """True or false."""
        return bool(self._value(key, default, "true or false", lambda value: isinstance(value, bool)))

    def number(
        self,
        key: str,
        default: float | T = REQUIRED,
        *,
        above: float = -math.inf,
        at_least: float = -math.inf,
        below: float = math.inf,
    ) -> float | T:
        """A finite number in a range; a default may lie outside."""
        limits = (("above", above), ("of at least", at_least), ("below", below))
        bounds = " and ".join(f"{word} {bound:g}" for word, bound in limits if math.isfinite(bound))

        def is_right(given: Any) -> bool:
            return is_finite(given) and above < given < below and given >= at_least

        value = self._value(key, default, f"a finite number {bounds}".rstrip(), is_right)
        return to_float(value) if key in self.data else value

    def table(self, key: str, default: T) -> float | tuple[tuple[float, ...], ...] | T:
        """A number, or a table of rows of numbers, which who takes it checks."""
        value = self.any(key)
        if not isinstance(value, list):
            return self.number(key, default)
        if not all(isinstance(row, list) for row in value):
            raise self.error(key, f"must be a number or a list of rows, got {value!r}")
        return tuple(map(tuple, value))

    def integer(self, key: str, default: int | T = REQUIRED, *, at_least: int) -> int | T:
        """A whole number."""
        what = f"a whole number of at least {at_least}"
        return self._value(key, default, what, lambda value: type(value) is int and value >= at_least)

    def numbers(self, key: str, count: int, default: T = REQUIRED) -> tuple[float, ...] | T:
        """A list of so many finite numbers."""

        def is_right(given: Any) -> bool:
            return isinstance(given, (list, tuple)) and len(given) == count and all(map(is_finite, given))

        value = self._value(key, default, f"a list of {count} finite numbers", is_right)
        return tuple(map(to_float, value)) if key in self.data else value

    def texts(self, key: str, count: int | None = None) -> tuple[str, ...]:
        """A list of texts; empty if there is no such entry."""
        what = f"a list of {'' if count is None else f'{count} '}names"

        def is_right(given: Any) -> bool:
            right = isinstance(given, (list, tuple)) and count in (None, len(given))
            return right and all(isinstance(one, str) for one in given)

        return tuple(self._value(key, (), what, is_right))


def read_section(path: str | os.PathLike[str], what: str, advice: str = "", name: str = "") -> Section:
    """The whole of a TOML file; messages name the file as it is, or by `name`.

    Raises InputError with `what` the file is if it can't be read, and with the clause `advice` if it is not there.
    """
    path = Path(path)
    try:
        return Section(name or path.name, tomllib.loads(read_small(path)))
    except OSError as error:
        raise InputError(f"can't read the {what} {path}: {error.strerror or error}{advice}") from None
    except InputError:
        raise
    except (ValueError, RecursionError) as error:
        raise InputError(f"{name or path.name} is not a TOML file: {error}") from None


def read_frame(section: Section) -> Frame:
    """The frame that `position_mm` and `euler_deg` ("xyz") describe, as in the sections [clamp] and [sensor] of a map."""
    from scan3d.rigs import Frame  # which takes numpy: help and settings do not wait for it

    position = [1e-3 * x for x in section.numbers("position_mm", 3, (0.0, 0.0, 0.0))]
    return Frame.of(position, section.numbers("euler_deg", 3, (0.0, 0.0, 0.0)))


WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
"""The channels of a sensor, by number of rows of its matrix where they are not stated: six, or fx, fy and mz."""


class Transducer(NamedTuple):
    """What makes channels of a sensor's q signals: ``matrix (signals - offset)``; all empty without a matrix."""

    channels: tuple[str, ...]
    """(c,) some of `WRENCH`."""
    matrix: tuple[tuple[float, ...], ...]
    """(c, q)"""
    offset: tuple[float, ...]
    """(q,)"""


def read_transducer(section: Section, count: int | None = None) -> Transducer:
    """The `channels`, `matrix` and `offset` of a section [sensor], of so many signals; channels may stand without a matrix."""
    rows, channels = section.any("matrix"), section.texts("channels")
    wrong = [name for name in channels if name not in WRENCH]
    if wrong or len(set(channels)) < len(channels):
        what = did_you_mean(wrong, WRENCH) if wrong else ""
        raise section.error(
            "channels", f"must be some of {', '.join(WRENCH)}, each once; got {', '.join(channels)}{what}"
        )
    if rows is None:
        return Transducer(channels, (), ())
    listed = isinstance(rows, (list, tuple)) and all(isinstance(row, (list, tuple)) for row in rows)
    if count is None:
        count = len(rows[0]) if listed and rows else 0
    if listed and not channels and len(rows) in (3, 6):
        channels = WRENCH if len(rows) == 6 else ("fx", "fy", "mz")
    if (
        not listed
        or len(rows) != len(channels)
        or not all(len(row) == count and all(map(is_finite, row)) for row in rows)
    ):
        raise section.error(
            "matrix",
            "must have a row for each of fx, fy, fz, mx, my, mz, of fx, fy, mz, or of those that channels names, with "
            f"{count} numbers, one for each signal",
        )
    return Transducer(
        channels, tuple(tuple(map(float, row)) for row in rows), section.numbers("offset", count, (0.0,) * count)
    )


def read_rod(section: Section) -> Rod:
    """The rod of a table [rod]: its length, its stiffness or a wire's diameter and modulus, and in what it is not simple."""
    length, modulus = section.number("length_m", None), section.number("modulus_Pa", None)
    stiffness: Any
    diameter: Any
    stiffness, diameter = (section.table(name, None) for name in ("bending_stiffness_Nm2", "diameter_m"))
    curvature: Any = section.any("curvature_per_m", 0.0)
    further: dict[str, Any] = {
        "tip_diameter_m": section.number("tip_diameter_m", None),
        "curvature_per_m": tuple(curvature) if isinstance(curvature, list) else curvature,
        "weight_N": section.number("weight_N", 0.0),
        "clamp_compliance_rad_per_Nm": section.number("clamp_compliance_rad_per_Nm", 0.0),
        "bead_diameter_m": section.number("bead_diameter_m", 0.0),
    }
    with section.errors_named():
        if length is not None and stiffness is not None:
            return Rod(length, stiffness, 0.0 if diameter is None else diameter, **further)
        if length is not None and diameter is not None and modulus is not None:
            at_clamp = diameter if isinstance(diameter, float) else diameter[0][1]
            wire = Rod.wire(length, at_clamp, modulus)
            return Rod(length, wire.bending_stiffness_Nm2, diameter, **further)
    section.finish()  # a name that is nearly right is the likelier reason
    raise section.error("", "needs length_m and bending_stiffness_Nm2, or length_m, diameter_m and modulus_Pa")


def rod_section(rod: Rod) -> dict[str, Any]:
    """The table [rod] of a rod, without what is as for a straight, uniform, weightless rod."""
    table: dict[str, Any] = {
        "length_m": rod.length_m,
        "bending_stiffness_Nm2": rod.stiffness_table or rod.bending_stiffness_Nm2,
        "diameter_m": rod.diameter_table or rod.diameter_m,
    }
    further = ("tip_diameter_m", "curvature_per_m", "weight_N", "clamp_compliance_rad_per_Nm", "bead_diameter_m")
    return table | {name: value for name in further if (value := getattr(rod, name))}


def parse_rod(text: str) -> Rod | None:
    """The rod named by ``MATERIAL:DIAMETERxLENGTH`` in mm (``steel:0.3x50``) or by `rod_text`, or None for ``auto``.

    Raises InputError for any other text.
    """
    if text == "auto":
        return None
    match = re.fullmatch(r"(\w+):([0-9.eE+-]+)x([0-9.eE+-]+)", text)
    try:
        if match and match[1] in MODULI_PA:
            return Rod.wire(float(match[3]) / 1000, float(match[2]) / 1000, MODULI_PA[match[1]])
        table = Section("rod", tomllib.loads(f"rod = {text}")["rod"]) if text.startswith("{") else None
    except (ValueError, RecursionError) as error:
        raise InputError(f"rod {text!r}: {error}") from None
    if table is None:
        raise InputError(
            "a rod is 'auto', MATERIAL:DIAMETERxLENGTH in mm, such as steel:0.3x50, with a material of "
            f"{', '.join(MODULI_PA)}, or a table like [rod] of a recording in braces; got {text!r}"
        )
    rod = read_rod(table)
    table.finish()
    return rod


def rod_text(rod: Rod | Mapping[str, Any]) -> str:
    """A rod, or its table [rod], as `parse_rod` reads it: an inline table of TOML."""
    return _toml_value(rod_section(rod) if isinstance(rod, Rod) else rod)


def to_json(data: Mapping[str, Any]) -> bytes:
    """JSON with NaN and infinities as null."""
    return (json.dumps(_plain(data), indent=2, ensure_ascii=False, allow_nan=False) + "\n").encode(errors="replace")


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):  # a number or an array of numpy
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if isinstance(value, (str, int, float, NoneType)) else str(value)


def rows_as_text(columns: Iterable[NDArray[Any]], separator: str = ",", start: str = "") -> bytes:
    """Lines of columns (n,), with as few digits as are needed to read the same bits back."""
    # numpy writes float32 with fewer digits, Python the others faster
    cells = (map(str, column if column.dtype == "float32" else column.tolist()) for column in columns)
    return "".join(f"{start}{separator.join(row)}\n" for row in zip(*cells, strict=True)).encode()


def to_toml(data: Mapping[str, Any]) -> str:
    """TOML of plain values and tables."""
    tables = {key: value for key, value in data.items() if isinstance(value, Mapping)}
    lines = [f"{_toml_key(key)} = {_toml_value(value)}" for key, value in data.items() if key not in tables]
    for key, table in tables.items():
        lines += ["", f"[{_toml_key(key)}]"]
        lines += [f"{_toml_key(name)} = {_toml_value(item)}" for name, item in table.items()]
    return "\n".join(lines) + "\n"


def _toml_key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _toml_value(key)


def _toml_value(value: Any) -> str:
    if hasattr(value, "item"):  # a number of numpy
        value = value.item()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_toml_value, value)) + "]"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_toml_key(key)} = {_toml_value(item)}" for key, item in value.items()) + "}"
    if isinstance(value, str):
        # JSON strings are basic strings of TOML, except for one control character
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    # repr gives all digits of a float, str the date format of TOML
    return repr(value) if isinstance(value, (int, float)) else str(value)
