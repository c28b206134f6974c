"""Tables of samples, one a row: text with any delimiter, sheets, or files of arrays; columns of numbers or of text.

There is one reader of text, which knows the line of each row, so that every message on a cell names the file, the line and the
column.  What it finds by itself is the delimiter; a decimal comma, titles above the names and a row of units must be announced
by a `Layout`, because a table that is read wrongly without a message costs more than a line in a file.

Files of arrays, and sheets of Excel as text, are read by `files.columns`.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import date
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scan3d.arrays import Array, Index
from scan3d.errors import InputError
from scan3d.files.columns import ENDINGS, SHEETS, read_columns, sheet_text
from scan3d.files.text import check_readable, decoded
from scan3d.files.whole import sha256
from scan3d.units import unit_of_cell

# Delimiters in the order in which they are tried; a space stands for any white space.
_DELIMITERS = (";", "\t", ",", " ")
_END_OF_HEADER = "***End_of_Header***"
# A number as Fortran writes it in double precision.
_FORTRAN = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)[dD][+-]?\d+")
# What programs write where there is no value, beside nan.
NO_VALUE = ("", "na", "n/a", "null", "none", "-", "--")


@dataclass(frozen=True)
class Layout:
    """How a text table is written; empty and None where this is to be found from the table."""

    delimiter: str = ""
    decimal: str = "."
    header: int | None = None
    """Number of the line with the names of the columns, from 1; 0 if there is no such line."""
    units_row: bool = False
    """Whether the line below the names states the units."""
    comment: str = "#"
    missing: str = "refuse"
    """What becomes of rows with an empty cell: refuse or drop."""

    def cells(self, line: str) -> list[str]:
        """The cells of a line, also of a comment."""
        bare = line.lstrip().removeprefix(self.comment) if self.comments(line) else line
        try:
            return [cell.strip() for cell in _split([bare], self.delimiter)[0]]
        except csv.Error:  # longer than any cell
            return [bare]

    def comments(self, line: str) -> bool:
        return bool(self.comment) and line.lstrip().startswith(self.comment)

    def holds(self, line: str) -> bool:
        """Whether a line is neither a comment nor empty, as those are below the rows of a sheet."""
        return bool(line.strip(f'{self.delimiter} \t\r\n"')) and not self.comments(line)

    def is_number(self, cell: str) -> bool:
        """Whether a cell is a number with the decimal sign of the table."""
        try:
            _number(cell.replace(",", ".") if self.decimal == "," else cell)
        except ValueError:
            return False
        return not (self.decimal == "," and "." in cell)


_OURS = Layout(",", header=1, comment="")


@dataclass(frozen=True)
class Head:
    """What stands above the data of a text table."""

    layout: Layout
    names: tuple[str, ...]
    """Of the columns; empty if the table has no line with names."""
    units: tuple[str, ...]
    """The cells of the row of units, likewise."""
    first: int
    """Number of the first line of data, from 1."""


@dataclass(frozen=True)
class Table:
    """A table with n rows, before its columns have a meaning."""

    name: str
    """Of the file."""
    names: tuple[str, ...]
    """Of the columns; empty if the table has no names."""
    columns: tuple[NDArray[Any], ...]
    """(n,) of each column: float64, NaN where there is no number, or text as it stands."""
    units: tuple[str, ...] = ()
    """The cells of the row of units, if there is one."""
    layout: Layout | None = None
    """Of a text table."""
    lines: NDArray[np.int64] | None = None
    """(n,) the line of each row of a text table."""
    wrong: Mapping[int, tuple[int, str]] = field(default_factory=dict)
    """The first row and its cell that is no number, of columns of numbers that have one."""
    sha256: str = ""
    left_out: Mapping[str, int] = field(default_factory=dict)
    """Rows of the file that are not in the table, by reason."""
    others: Mapping[str, str] = field(default_factory=dict)
    """What is no column, as in `files.columns.Columns`."""

    def __len__(self) -> int:
        return len(self.columns[0]) if self.columns else 0

    def title(self, column: int) -> str:
        """A column by name, or by number from 1 where it has no name."""
        return f"column {self.names[column]!r}" if self.names and self.names[column] else f"column {column + 1}"

    def refuse_other(self, name: str, where: str = "") -> None:
        """Raise InputError for a name of what the file has, but not as a column; `where` is the clause that asks for it."""
        if name in self.others:
            raise InputError(f"{self.name}: {name!r}{where} {self.others[name]}")

    def place(self, row: int) -> str:
        """Where a row stands, for messages: ``log.csv: line 7``."""
        return f"{self.name}: row {row + 1}" if self.lines is None else f"{self.name}: line {self.lines[row]}"

    def text(self, column: int) -> list[str]:
        """The cells of a column as text."""
        values = self.columns[column]
        return [f"{x:g}" for x in values] if values.dtype.kind == "f" else [str(x).strip() for x in values]

    def numbers(self, column: int, *, gaps: bool = False) -> Array:
        """A column (n,) of finite numbers, NaN in empty cells if `gaps` are allowed.

        Raises InputError with the line and the column of what is no number.
        """
        values, wrong = self.columns[column], self.wrong.get(column)
        if values.dtype.kind != "f":
            values, wrong = _numbers(values, "." if self.layout is None else self.layout.decimal)
        if wrong is not None:
            row, cell = wrong
            advice = "which is no number; correct the cell, or remove the line"
            if self.layout and re.fullmatch(r"\s*[+-]?\d*,\d+([eE][+-]?\d+)?\s*", cell):
                advice = 'a decimal comma; write decimal = "," under [table] in the map'
            raise InputError(f"{self.place(row)} has {cell!r} in {self.title(column)}, {advice}")
        bad = np.isinf(values) if gaps else ~np.isfinite(values)
        if bad.any():
            row = int(np.argmax(bad))
            what = "no value" if np.isnan(values[row]) else f"{values[row]}"
            instead = ""
            if self.layout and np.isnan(values).all():
                instead = ', or write "" for this column in the map if it was not measured'
            elif gaps:
                instead = ", or leave such cells empty"
            elif self.layout and self.layout.missing != "drop":
                instead = ', or write missing = "drop" under [table] in the map to leave such rows out'
            raise InputError(
                f"{self.place(row)} has {what} in {self.title(column)}, where a finite number is expected, and so have "
                f"{int(bad.sum())} of {len(values)} rows; complete the table{instead}"
            )
        return values

    def whole_numbers(self, column: int, *, gaps: bool = False) -> NDArray[np.int64]:
        """A column (n,) of whole numbers that fit into 32 bits, -1 in empty cells if `gaps` are allowed.  Raises InputError."""
        values = self.numbers(column, gaps=gaps)
        whole = np.where(np.isnan(values), -1.0, values)
        bad = (whole != np.round(whole)) | (np.abs(whole) >= 2**31)
        if bad.any():
            row = int(np.argmax(bad))
            raise InputError(
                f"{self.place(row)} has {values[row]:g} in {self.title(column)}, where a whole number is expected"
            )
        return whole.astype(np.int64)

    def words(self, column: int, known: Sequence[str]) -> NDArray[np.int8]:
        """Which of the known words, in small letters, each cell (n,) of a column holds.  Raises InputError for another one."""
        cells = np.char.lower(np.array(self.text(column), dtype=str))
        found = np.full(len(cells), -1, dtype=np.int8)
        for k, word in enumerate(known):
            found[cells == word] = k
        if (found < 0).any():
            row = int(np.argmin(found))
            raise InputError(
                f"{self.place(row)} has {str(cells[row])!r} in {self.title(column)}, where one of {', '.join(known)} is "
                "expected"
            )
        return found

    def rows(self, rows: Index) -> Table:
        """The table with some of its rows (k,), which increase."""
        places = {column: (int(np.searchsorted(rows, row)), row, cell) for column, (row, cell) in self.wrong.items()}
        return replace(
            self,
            columns=tuple(column[rows] for column in self.columns),
            lines=None if self.lines is None else self.lines[rows],
            wrong={column: (k, cell) for column, (k, row, cell) in places.items() if k < len(rows) and rows[k] == row},
        )


def read_table(
    path: str | Path, layout: Layout | None = None, what: str = "table", name: str = "", wanted: Collection[str] = ()
) -> Table:
    """Read a text table as its layout says, or another kind by its ending; messages call it `what` it is, and by its `name`.

    Of arrays of several lengths those of the `wanted` columns are the table.

    Without a layout it is comma-separated, with the names in its first line, as this program writes tables.  Raises InputError
    with the file, the line and the column of an error, and what to do.
    """
    path = Path(path)
    name = name or path.name
    if path.suffix.lower() in ENDINGS:
        with _readable(path, what):
            columns, others = read_columns(path, wanted)
            names, values = tuple(columns), tuple(columns.values())
            return Table(name, names, values, layout=layout, sha256=sha256(path), others=others)
    text = _text(path, what)
    if path.suffix.lower() in SHEETS:
        layout = replace(layout or Layout(), delimiter="\t", decimal=".")
    lines = _first_lines(name, text)
    layout = _labview(lines, layout)
    text = _one_heading(text, lines)
    if layout is None:
        head = Head(_OURS, tuple(_OURS.cells(lines[0])), (), 2)
        return replace(_parsed(name, text, head), layout=None)
    return replace(_parsed(name, text, _announced_head(name, lines, layout)), sha256=sha256(path))


def guessed_layout(path: Path) -> Layout:
    """The layout of a text table as its first lines suggest; arrays have none.  Raises InputError if it can't be read."""
    if path.suffix.lower() in ENDINGS:
        return Layout()
    stated = Layout("\t") if path.suffix.lower() in SHEETS else Layout()
    lines = _first_lines(path.name, _text(path, "table"))
    return stated if _labview(lines, stated) != stated else guessed_head(lines, stated).layout


def _labview(lines: Sequence[str], layout: Layout | None) -> Layout | None:
    """The layout, and what the two headers of LabVIEW's "Write To Measurement File" state, where it leaves that open.

    They have the separators, each ends with a line of its own, and the names follow the last one.
    """
    ends, words = _heading(lines)
    if not ends:
        return layout
    layout = layout or Layout()
    delimiter = {"Tab": "\t", "Comma": ",", "Semicolon": ";"}.get(words.get("Separator", ""), "")
    return replace(
        layout,
        delimiter=layout.delimiter or delimiter,
        decimal="," if words.get("Decimal_Separator") == "," else layout.decimal,
        header=next((k for k in range(ends[-1] + 1, len(lines) + 1) if lines[k - 1].strip()), ends[-1])
        if layout.header is None
        else layout.header,
    )


def _heading(lines: Sequence[str]) -> tuple[list[int], dict[str, str]]:
    """The lines that end LabVIEW's headers, up to the names of the first data, and what these state, of several channels of the
    first one."""
    ends = [number for number, line in enumerate(lines, 1) if line.startswith(_END_OF_HEADER)][:2]
    return ends, _stated(lines[: ends[-1] if ends else 0])


def _stated(lines: Sequence[str]) -> dict[str, str]:
    """What the lines of a header of LabVIEW state, of several channels of the first one."""
    found = (re.match(r"(\w+)([\t;, ])(.*?)(?:\2|$)", line) for line in lines)
    return {pair[1]: pair[3].strip() for pair in found if pair}


def _began(words: Mapping[str, str]) -> float | None:
    """The day and the time of a header of LabVIEW in seconds, from which its relative times count; None if there is none."""
    stated = f"{words.get('Date')} {words.get('Time')}".replace(",", ".")
    found = re.fullmatch(r"(\d+/\d+/\d+) (\d+):(\d+):(\d+\.?\d*)", stated)
    if found is None or words.get("Time_Pref", "Relative") != "Relative":
        return None
    try:
        day = (
            date(*map(int, found[1].split("/"))).toordinal() - date(2000, 1, 1).toordinal()
        )  # small: no digits are lost
    except ValueError:
        return None
    hours, minutes, seconds = map(float, found.groups()[1:])
    return ((24.0 * day + hours) * 60 + minutes) * 60 + seconds


def _one_heading(text: str, lines: Sequence[str]) -> str:
    """The text of LabVIEW's file with empty lines for further headers, and with its times where they are not in a column."""
    ends, words = _heading(lines)
    if not ends:
        return text
    rows = text.splitlines()
    start = next((k for k in range(ends[-1], len(rows)) if rows[k].strip()), ends[-1]) + 1  # below the names
    headings = {start: words}
    if words.get("Multi_Headings") == "Yes":
        begins = [k for k in range(start, len(rows)) if rows[k].startswith("Channels")]
        for k in begins:
            stop = next((j for j in range(k, len(rows)) if rows[j].startswith(_END_OF_HEADER)), len(rows))
            headings[stop + 2] = words | _stated(rows[k:stop])
            rows[k : stop + 2] = [""] * len(rows[k : stop + 2])
    sign = words.get("Decimal_Separator", ".")
    for (begin, own), end in zip(headings.items(), [*[*headings][1:], len(rows)], strict=True):
        x0, step = (own.get(key, "").replace(",", ".") for key in ("X0", "Delta_X"))
        if words.get("X_Columns") == "No" and Layout().is_number(x0) and Layout().is_number(step):
            first, this = _began(words), _began(own)
            later = 0.0 if first is None or this is None else this - first
            data = (k for k in range(begin, end) if rows[k].startswith(("\t", ";", ",")))
            for count, k in enumerate(data):
                rows[k] = f"{later + float(x0) + count * float(step):.15g}".replace(".", sign) + rows[k]
    return "\n".join(rows) + "\n"


def _first_lines(name: str, text: str) -> list[str]:
    # those in which the names and the first data are looked for
    lines = [line.rstrip("\n") for line in islice(io.StringIO(text, newline=None), 100)]
    if not any(line.strip() for line in lines):
        raise InputError(f"{name} is empty; expected a table with one row per sample")
    if "\0" in "".join(lines):
        raise InputError(f"{name} is no text; expected a table as text, or as Parquet (.parquet)")
    return lines


@contextmanager
def _readable(path: Path, what: str) -> Iterator[None]:
    try:
        check_readable(path, memory_per_byte=8)
        yield
    except OSError as error:
        raise InputError(f"can't read the {what} {path}: {error.strerror or error}") from None


def _text(path: Path, what: str) -> str:
    """The text of a sheet, or of a file in UTF-8, UTF-16 with its mark, or Latin-1, with the minus signs of programs."""
    with _readable(path, what):
        if path.suffix.lower() in SHEETS:
            return sheet_text(path)
        data = path.read_bytes()
    try:
        return decoded(data).replace("\u2212", "-")
    except ValueError:
        return data.decode("latin-1")


def _split(lines: Sequence[str], delimiter: str) -> list[list[str]]:
    """The cells of lines that are not empty."""
    if delimiter == " ":
        return [line.split() for line in lines]
    rows = list(csv.reader(lines, delimiter=delimiter, skipinitialspace=True))
    if len(rows) == len(lines):
        return rows
    # a quote that is not closed: each line for itself, so that the one with too few cells is found
    return [next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), []) for line in lines]


def _number(cell: str) -> float:
    """The number in a cell, whose exponent may be Fortran's.  Raises ValueError."""
    return float(cell.lower().replace("d", "e") if _FORTRAN.fullmatch(cell.strip()) else cell)


def _numbers(cells: Iterable[str], decimal: str) -> tuple[Array, tuple[int, str] | None]:
    """Numbers (n,), NaN where a cell holds none, and the first cell, with its row, that holds something else."""
    cells = [cell.replace(",", ".") for cell in cells] if decimal == "," else list(cells)
    try:
        return np.fromiter(map(float, cells), float, len(cells)), None
    except ValueError:
        pass
    values, wrong = np.full(len(cells), np.nan), None
    for row, cell in enumerate(cells):
        try:
            values[row] = _number(cell)
        except ValueError:
            if cell.strip().lower() not in NO_VALUE and wrong is None:
                wrong = row, str(cell)
    return values, wrong


def _parsed(name: str, text: str, head: Head) -> Table:
    """The rows below the head of a text table."""
    layout, wrong = head.layout, {}
    rows = enumerate(io.StringIO(text, newline=None), 1)
    held = {number: line for number, line in rows if number >= head.first and layout.holds(line)}
    if not held and layout is not _OURS:
        raise InputError(f"{name} has no row of data below line {head.first - 1}; expected one row per sample")
    numbers, lines = list(held), list(held.values())
    columns: Sequence[NDArray[Any]] | None = _all_numbers(lines, layout) if lines else [np.empty(0)] * len(head.names)
    if columns is None or len(columns) != (len(head.names) or len(columns)):
        columns = []
        for k, cells in enumerate(_cells(name, numbers, lines, layout, head.names)):
            if not layout.is_number(next((cell for cell in cells if cell.strip()), "0")):  # a column of text
                columns.append(np.array(cells, dtype=object))
                continue
            values, bad = _numbers(cells, layout.decimal)
            columns.append(values)
            if bad is not None:
                wrong[k] = bad
    return Table(name, head.names, tuple(columns), head.units, layout, np.array(numbers, dtype=np.int64), wrong)


def _all_numbers(lines: Sequence[str], layout: Layout) -> Sequence[Array] | None:
    """The columns of lines that hold nothing but numbers, three times as fast as cell by cell; None for other lines."""
    if layout.decimal == layout.delimiter:  # in cells that are quoted
        return None
    if layout.decimal == ",":
        lines = [line.replace(",", ".") for line in lines]
    delimiter = None if layout.delimiter == " " else layout.delimiter
    try:
        values = np.loadtxt(lines, delimiter=delimiter, comments=None, ndmin=2)
    except ValueError:
        return None
    return [np.ascontiguousarray(column) for column in values.T]


def _cells(
    name: str, numbers: Sequence[int], lines: Sequence[str], layout: Layout, names: Sequence[str]
) -> Sequence[tuple[str, ...]]:
    """The columns of lines as text.  Raises InputError for a line without as many cells as there are names, if there are any.

    A last column that most rows do not have is empty in them, as that of LabVIEW's comments.
    """
    try:
        rows = _split(lines, layout.delimiter)
    except csv.Error as error:
        raise InputError(
            f"{name}: lines {numbers[0]} to {numbers[-1]} can't be split into cells: {error}; correct them"
        ) from None
    count = len(names) or len(rows[0])
    # a delimiter after the last cell
    rows = [row[:count] if len(row) == count + 1 and not row[count].strip() else row for row in rows]
    short = sum(len(row) == count - 1 for row in rows)
    # a name that a blank, or a delimiter before its unit, cuts in two would shift the columns
    if 2 * short > len(rows) and layout.delimiter != " " and not any(map(unit_of_cell, names)):
        rows = [[*row, ""] if len(row) == count - 1 else row for row in rows]
    wrong = next(((number, len(row)) for number, row in zip(numbers, rows, strict=True) if len(row) != count), None)
    if wrong is None:
        return list(zip(*rows, strict=True))
    number, found = wrong
    log = "; scan3d import reads the log of a laboratory" if layout is _OURS else ""
    advice = f", from column {count + 1} on; check the delimiter and the names in the header{log}"
    if found < count:
        advice = f"; it ends in column {found}: is it cut off? complete or remove it"
    elif layout.delimiter == "," and found <= 2 * count:
        announced = ', and write decimal = "," under [table] in the map' if layout is not _OURS else ""
        advice = f"; are there decimal commas, first in column 1? separate the columns by semicolons or tabs{announced}"
    raise InputError(f"{name}: line {number} has {found} values, expected {count}{advice}")


def guessed_head(lines: Sequence[str], layout: Layout) -> Head:
    """The head of a table as its first lines suggest, with the whole layout filled in; what `layout` states is kept."""
    data = [line for line in lines if layout.holds(line)]
    best, count, most = replace(layout, delimiter=layout.delimiter or ","), 0, 0.0
    for delimiter in (layout.delimiter,) if layout.delimiter else _DELIMITERS:
        for decimal in (layout.decimal,) if layout.decimal == "," else (".", ","):
            tried = replace(layout, delimiter=delimiter, decimal=decimal)
            tail = [tried.cells(line) for line in data[len(data) // 2 :]]
            columns = len(tail[-1]) if tail else 0
            numbers = sum(tried.is_number(cell) for cells in tail if len(cells) == columns for cell in cells)
            part = numbers / max(sum(map(len, tail)), 1)
            # several columns are likelier than one, and full stops than commas where both fit
            if columns > 1 and part > most + 1e-9:
                best, count, most = tried, columns, part
    above: list[tuple[int, list[str]]] = []
    first = len(lines) + 1
    for number, line in enumerate(lines, 1):
        cells = best.cells(line) if line.strip() else []
        if len(cells) == count - 1 and data[-1].rstrip().endswith(best.delimiter):  # rows may end with a separator
            cells.append("")
        if len(cells) != count:
            continue
        if not best.comments(line) and 2 * sum(_is_any_number(cell) or not cell for cell in cells) > len(cells):
            first = number
            break
        above.append((number, cells))
    filled = [cell for cell in above[-1][1] if cell.strip("[]()-/ ")] if len(above) > 1 else []
    units_row = layout.units_row or (bool(filled) and 2 * sum(map(bool, map(unit_of_cell, filled))) > len(filled))
    names = above[-2:] if units_row else above[-1:]
    if not names:
        return Head(replace(best, header=0), (), (), first)
    units = tuple(names[1][1]) if len(names) == 2 else ()
    return Head(replace(best, header=names[0][0], units_row=bool(units)), tuple(names[0][1]), units, first)


def _is_any_number(cell: str) -> bool:
    return any(Layout(decimal=sign).is_number(cell) for sign in ".,")


def _announced_head(name: str, lines: Sequence[str], layout: Layout) -> Head:
    """The head of a table as its layout says.  Raises InputError where the lines show that it says something wrong."""
    guess = guessed_head(lines, layout)
    found = guess.layout.header or 0
    held = [number for number, line in enumerate(lines, 1) if layout.holds(line)]
    commented = found > 0 and layout.comments(lines[found - 1])
    number = layout.header
    if number is None:
        # names in a comment above the data, and a table without names, need no announcement
        nameless = found == 0 and guess.first <= held[0] if held else True
        number = found if commented or nameless else held[0]
    if number > len(lines):
        raise InputError(f"{name} has no line {number} with the names of its columns; correct header under [table]")
    stated = replace(layout, delimiter=guess.layout.delimiter, header=number)
    below = [k for k in held if k > number]
    first = below[0] if below else len(lines) + 1
    if number == 0:
        return Head(stated, (), (), first)
    names = tuple(stated.cells(lines[number - 1]))
    if below and layout.header is None and found not in (0, number) and len(guess.names) != len(names):
        raise InputError(
            f"{name}: line {number} has {len(names)} cells and the data have {len(guess.names)} columns, whose names stand in "
            f"line {found}; write header = {found} under [table] in the map"
        )
    row = stated.cells(lines[first - 1]) if below else []
    if layout.units_row:
        return Head(stated, names, tuple(row), first + 1)
    if row and not commented and not any(map(_is_any_number, row)):
        column = next((k for k, cell in enumerate(row) if cell), 0)
        raise InputError(
            f"{name}: line {first} has {row[column]!r} in column {column + 1} "
            f"({names[column] if column < len(names) else 'without a name'}), where data are expected: a second header "
            "line; if it states the units, write units_row = true under [table] in the map, else header = "
            f"{first} for the line with the names"
        )
    return Head(stated, names, (), first)
