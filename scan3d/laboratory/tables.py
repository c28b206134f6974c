"""Tables as laboratories write them: text with any delimiter, and Parquet; columns of numbers or of text.

Text is read by pyarrow where it is installed and can read it, else by numpy; a table that neither can read is read line by
line, which finds the line and the column of an error.
"""

from __future__ import annotations

import csv
import hashlib
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scan3d.arrays import Array
from scan3d.errors import InputError
from scan3d.files.parquet import read_columns
from scan3d.files.reading import check_file
from scan3d.laboratory.layouts import DECIMAL_COMMA, LOOKED_AT, Head, head, split
from scan3d.laboratory.maps import Layout

# Memory per byte of a table while it is read, as for recordings.
_MEMORY_PER_BYTE = 8
_ENDINGS = (".parquet", ".pq")
# Longest text of a cell that numpy reads; longer ones are read line by line.
_LONGEST_CELL = 40


@dataclass(frozen=True)
class RawTable:
    """A table with n rows, before its columns have a meaning."""

    name: str
    """Of the file."""
    names: tuple[str, ...]
    """Of the columns; empty if the table has no names."""
    columns: tuple[NDArray[Any], ...]
    """(n,) of each column: float64, or text as it stands."""
    units: tuple[str, ...] = ()
    """The cells of the row of units, if there is one."""
    layout: Layout | None = None
    """Of a text table."""
    first: int | None = None
    """Number of the first line of data; None if the table is no text."""
    path: Path | None = None
    sha256: str = ""

    def __len__(self) -> int:
        return len(self.columns[0]) if self.columns else 0

    def title(self, column: int) -> str:
        """A column by name, or by number from 1 where it has no name."""
        return f"column {self.names[column]!r}" if self.names and self.names[column] else f"column {column + 1}"

    def place(self, row: int) -> str:
        """Where a row stands, for messages: ``log.csv: line 7``."""
        if self.first is None or self.layout is None or self.path is None:
            return f"{self.name}: row {row + 1}"
        lines = _text(self.path.read_bytes()).split("\n")
        data = [n for n in range(self.first, len(lines) + 1) if _is_data(lines[n - 1], self.layout)]
        return f"{self.name}: line {data[row] if row < len(data) else self.first + row}"

    def text(self, column: int) -> list[str]:
        """The cells of a column as text."""
        values = self.columns[column]
        return [f"{value:g}" for value in values] if values.dtype.kind == "f" else [str(value) for value in values]

    def numbers(self, column: int, *, gaps: bool = False) -> Array:
        """A column (n,) of finite numbers, NaN in empty cells if `gaps` are allowed.

        Raises InputError with the line and the column of what is no number.
        """
        values = self.columns[column]
        if values.dtype.kind != "f":
            values = np.array([self._number(column, row, cell) for row, cell in enumerate(values)], dtype=np.float64)
        bad = np.isinf(values) if gaps else ~np.isfinite(values)
        if bad.any():
            row = int(np.argmax(bad))
            what = "no value" if np.isnan(values[row]) else f"{values[row]}"
            raise InputError(
                f"{self.place(row)} has {what} in {self.title(column)}, where a finite number is expected, and so have "
                f'{int(bad.sum())} of {len(values)} rows; complete the table, or write missing = "drop" under [table] in the '
                "map to leave such rows out"
            )
        return np.asarray(values, dtype=np.float64)

    def _number(self, column: int, row: int, cell: str) -> float:
        comma = self.layout is not None and self.layout.decimal == ","
        text = str(cell).strip()
        if not text:
            return float("nan")
        try:
            return float(text.replace(",", ".") if comma else text)
        except ValueError:
            pass
        if DECIMAL_COMMA.fullmatch(text):
            advice = 'a decimal comma; write decimal = "," under [table] in the map'
        else:
            advice = "which is no number; correct the cell, or remove the line"
        raise InputError(f"{self.place(row)} has {str(cell)!r} in {self.title(column)}, {advice}")


def read_table(path: str | Path, layout: Layout | None = None) -> RawTable:
    """Read a text table or a Parquet file.

    Raises InputError with the file, the line and the column of an error, and what to do.
    """
    path, layout = Path(path), layout or Layout()
    try:
        check_file(path, memory_per_byte=_MEMORY_PER_BYTE)
        if path.suffix.lower() in _ENDINGS:
            by_name = read_columns(path)
            return RawTable(path.name, tuple(by_name), tuple(by_name.values()), path=path, sha256=_digest(path))
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"can't read the table {path}: {error.strerror or error}") from None
    found = _head(path, data, layout)
    columns = _read_text(path, data, found)
    sha256 = hashlib.sha256(data).hexdigest()
    return RawTable(path.name, found.names, columns, found.units, found.layout, found.first, path, sha256)


def _digest(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _head(path: Path, data: bytes, layout: Layout) -> Head:
    lines = first_lines(data)
    if not any(line.strip() for line in lines):
        raise InputError(f"{path.name} is empty; expected a table with one row per sample")
    if "\0" in "".join(lines):
        raise InputError(f"{path.name} is no text; expected a table as text or Parquet (.parquet), or a ROS bag")
    return head(path.name, lines, layout)


def first_lines(data: bytes) -> list[str]:
    """The lines at the beginning of a table."""
    end = -1
    plain = data if data[:2] not in (b"\xff\xfe", b"\xfe\xff") else _text(data).encode()
    for _ in range(LOOKED_AT):
        end = plain.find(b"\n", end + 1)
        if end < 0:
            break
    return _text(plain if end < 0 else plain[:end]).rstrip("\n").split("\n")


def _text(data: bytes) -> str:
    """The text of a file in UTF-8, UTF-16 with its mark, or Latin-1, with lines that end in a newline."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        text = data.decode("utf-16", errors="replace")
    else:
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = data.decode("latin-1")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def _is_data(line: str, layout: Layout) -> bool:
    return bool(line.strip()) and not (layout.comment and line.lstrip().startswith(layout.comment))


def _read_text(path: Path, data: bytes, found: Head) -> tuple[NDArray[Any], ...]:
    """The columns below the head of a text table."""
    layout = found.layout
    cells = next((row for row in (split(line, layout.delimiter) for line in _data_lines(data, found)) if row), None)
    if cells is None:
        raise InputError(f"{path.name} has no row of data below line {found.first - 1}; expected one row per sample")
    count = len(found.names) or len(cells)
    if len(cells) == count:
        kinds = [_is_float(cell, layout.decimal) for cell in cells]
        for read in (_by_arrow, _by_numpy):
            columns = read(data, found, kinds)
            if columns is not None:
                return columns
    return _by_line(path, data, found, count)


def _data_lines(data: bytes, found: Head) -> list[str]:
    """The first lines of data."""
    return [line for line in first_lines(data)[found.first - 1 :] if _is_data(line, found.layout)]


def _is_float(cell: str, decimal: str) -> bool:
    try:
        float(cell.replace(",", ".") if decimal == "," else cell)
    except ValueError:
        return False
    return True


def _by_arrow(data: bytes, found: Head, kinds: Sequence[bool]) -> tuple[NDArray[Any], ...] | None:
    """The columns by pyarrow; None if it is not installed, or can't read every row of the table."""
    layout = found.layout
    if layout.delimiter == " " or data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return None
    try:
        from pyarrow import ArrowInvalid, BufferReader, csv, float64, string
    except ImportError:
        return None
    names = [str(k) for k in range(len(kinds))]
    types = {name: float64() if number else string() for name, number in zip(names, kinds, strict=True)}
    try:
        table = csv.read_csv(
            BufferReader(data),
            # threads gain little, and with them all rows behind the first block have been missing once
            read_options=csv.ReadOptions(skip_rows=found.first - 1, column_names=names, use_threads=False),
            parse_options=csv.ParseOptions(delimiter=layout.delimiter),
            convert_options=csv.ConvertOptions(
                column_types=types, decimal_point=layout.decimal, null_values=[""], strings_can_be_null=False
            ),
        )
    except ArrowInvalid:
        return None
    if len(table) != sum(1 for line in data.splitlines()[found.first - 1 :] if line.strip()):
        return None
    columns = [table.column(name) for name in names]
    return tuple(
        np.asarray(column.to_numpy()) if number else column.to_numpy().astype(str)
        for column, number in zip(columns, kinds, strict=True)
    )


def _by_numpy(data: bytes, found: Head, kinds: Sequence[bool]) -> tuple[NDArray[Any], ...] | None:
    """The columns by numpy; None if it can't read the table."""
    layout = found.layout
    text = _text(data)
    if layout.decimal == ",":
        text = text.replace(",", ".")
    types = np.dtype([(str(k), "f8" if number else f"U{_LONGEST_CELL}") for k, number in enumerate(kinds)])
    try:
        table = np.loadtxt(
            io.StringIO(text),
            dtype=types,
            delimiter=None if layout.delimiter == " " else layout.delimiter,
            comments=layout.comment or None,
            quotechar='"',
            skiprows=found.first - 1,
            ndmin=1,
        )
    except ValueError:
        return None
    columns = tuple(np.ascontiguousarray(table[name]) for name in types.names or ())
    # a longer text would have been cut
    if any(c.dtype.kind == "U" and (np.char.str_len(c) == _LONGEST_CELL).any() for c in columns):
        return None
    return columns


def _by_line(path: Path, data: bytes, found: Head, count: int) -> tuple[NDArray[Any], ...]:
    """The columns as text, line by line.  Raises InputError for a line with another number of cells."""
    layout = found.layout
    lines = _text(data).split("\n")
    rows = []
    for number in range(found.first, len(lines) + 1):
        line = lines[number - 1]
        if not _is_data(line, layout):
            continue
        try:
            cells = split(line, layout.delimiter)
        except csv.Error as error:
            raise InputError(f"{path.name}: line {number} can't be split into cells: {error}; correct it") from None
        if len(cells) != count:
            raise InputError(_wrong_count(path.name, number, cells, count, layout))
        rows.append(cells)
    return tuple(np.array(column, dtype=object) for column in zip(*rows, strict=True))


def _wrong_count(name: str, number: int, cells: list[str], count: int, layout: Layout) -> str:
    expected = f"{name}: line {number} has {len(cells)} values, expected {count}"
    if len(cells) < count:
        return f"{expected}; it ends in column {len(cells)}: is it cut off? complete or remove it"
    if layout.delimiter == "," and count < len(cells) <= 2 * count:
        return (
            f"{expected}; are there decimal commas, first in column 1? separate the columns by semicolons or tabs, and write "
            'decimal = "," under [table] in the map'
        )
    return f"{expected}, from column {count + 1} on; check the delimiter and the names in the header"
