"""How a text table is written: its delimiter, its decimal sign, and the lines above the data."""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass, replace

from scan3d.errors import InputError
from scan3d.laboratory.maps import Layout
from scan3d.laboratory.quantities import unit_of_cell

# Lines at the beginning of a table in which its names and its first data are looked for.
LOOKED_AT = 100
# Delimiters in the order in which they are tried; a space stands for any white space.
_DELIMITERS = (";", "\t", ",", " ")
_NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*|\s*[+-]?(nan|inf)\s*", re.IGNORECASE)
DECIMAL_COMMA = re.compile(r"\s*[+-]?\d*,\d+([eE][+-]?\d+)?\s*")


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


def split(line: str, delimiter: str) -> list[str]:
    """The cells of a line."""
    if delimiter == " ":
        return line.split()
    return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), [])]


def is_number(cell: str, decimal: str = ".") -> bool:
    if decimal == ",":
        return DECIMAL_COMMA.fullmatch(cell) is not None or (_NUMBER.fullmatch(cell) is not None and "." not in cell)
    return _NUMBER.fullmatch(cell) is not None


def sniffed(lines: list[str], layout: Layout) -> Head:
    """The head of a table as its lines suggest, with the whole layout filled in; what `layout` states is kept."""
    rows = [(number, line) for number, line in enumerate(lines, start=1) if line.strip()]
    data = [
        (number, line) for number, line in rows if not (layout.comment and line.lstrip().startswith(layout.comment))
    ]
    best = replace(layout, delimiter=layout.delimiter or ","), 0, 0.0
    for delimiter in (layout.delimiter,) if layout.delimiter else _DELIMITERS:
        for decimal in (layout.decimal,) if layout.decimal == "," or delimiter == "," else (".", ","):
            tail = [split(line, delimiter) for _, line in data[len(data) // 2 :]]
            count = len(tail[-1]) if tail else 0
            fits = [cells for cells in tail if len(cells) == count]
            numbers = sum(is_number(cell, decimal) for cells in fits for cell in cells)
            score = numbers / max(sum(map(len, tail)), 1)
            # several columns are likelier than one, and full stops than commas where both fit
            if count > 1 and score > best[2] + 1e-9:
                best = replace(layout, delimiter=delimiter, decimal=decimal), count, score
    return _head(rows, best[0], best[1])


def _head(rows: list[tuple[int, str]], layout: Layout, count: int) -> Head:
    """The head of a table whose delimiter and number of columns are known."""
    cells = [(number, _cells(line, layout), _is_comment(line, layout)) for number, line in rows]
    start = next(
        (k for k, (_, row, comment) in enumerate(cells) if not comment and len(row) == count and _is_data(row, layout)),
        len(cells),
    )
    first = cells[start][0] if start < len(cells) else (cells[-1][0] + 1 if cells else 1)
    above = [(number, row) for number, row, _ in cells[:start] if len(row) == count]
    units_row = layout.units_row
    if len(above) > 1 and _are_units(above[-1][1]):
        units_row = True
    names = above[-2:] if units_row else above[-1:]
    if not names:
        return Head(replace(layout, header=0), (), (), first)
    units = tuple(names[-1][1]) if units_row and len(names) == 2 else ()
    return Head(replace(layout, header=names[0][0], units_row=bool(units)), tuple(names[0][1]), units, first)


def _cells(line: str, layout: Layout) -> list[str]:
    text = line.lstrip().removeprefix(layout.comment).lstrip() if _is_comment(line, layout) else line
    return split(text, layout.delimiter)


def _is_comment(line: str, layout: Layout) -> bool:
    return bool(layout.comment) and line.lstrip().startswith(layout.comment)


def _is_data(row: list[str], layout: Layout) -> bool:
    """Whether most cells are numbers, also with the other decimal sign."""
    return 2 * sum(is_number(cell) or is_number(cell, ",") or not cell for cell in row) > len(row)


def _are_units(row: list[str]) -> bool:
    """Whether most cells that are not empty are units."""
    filled = [cell for cell in row if cell.strip("[]()-/ ")]
    return bool(filled) and 2 * sum(unit_of_cell(cell) is not None for cell in filled) > len(filled)


def head(name: str, lines: list[str], layout: Layout) -> Head:
    """The head of a table as its layout says.  Raises InputError where the lines show that it says something wrong."""
    found = sniffed(lines, layout)
    delimiter = layout.delimiter or found.layout.delimiter
    commented = found.layout.header and _is_comment(lines[found.layout.header - 1], layout)
    first_line = next(
        (n for n, line in enumerate(lines, 1) if line.strip() and not _is_comment(line, layout)), len(lines) + 1
    )
    number = layout.header
    if number is None:
        nameless = found.layout.header == 0 and found.first <= first_line
        number = found.layout.header if commented or nameless else first_line
    assert number is not None
    if number > len(lines):
        raise InputError(f"{name} has no line {number} with the names of its columns; correct header under [table]")
    stated = replace(layout, delimiter=delimiter, header=number)
    if number == 0:
        return Head(stated, (), (), first_line)
    names = tuple(_cells(lines[number - 1], stated))
    if layout.header is None and found.layout.header not in (0, number) and len(found.names) != len(names):
        raise InputError(
            f"{name}: line {number} has {len(names)} cells and the data have {len(found.names)} columns, whose names stand in "
            f"line {found.layout.header}; write header = {found.layout.header} under [table] in the map"
        )
    below = next(
        (n for n, line in enumerate(lines, 1) if n > number and line.strip() and not _is_comment(line, layout)), 0
    )
    units: tuple[str, ...] = ()
    first = below or len(lines) + 1
    if layout.units_row and below:
        units = tuple(_cells(lines[below - 1], stated))
        first = below + 1
    elif below and not commented:
        row = _cells(lines[below - 1], stated)
        if not any(is_number(cell) or is_number(cell, ",") for cell in row):
            column = next((k for k, cell in enumerate(row) if cell), 0)
            raise InputError(
                f"{name}: line {below} has {row[column] if row else ''!r} in column {column + 1} "
                f"({names[column] if column < len(names) else 'without a name'}), where data are expected: a second header "
                "line; if it states the units, write units_row = true under [table] in the map, else header = "
                f"{below} for the line with the names"
            )
    return Head(stated, names, units, first)
