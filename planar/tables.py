"""Tables of results for notebooks: a selection of the rows, in HTML."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from planar.arrays import Index

# Upper bound of the rows of a table.
_MAX_ROWS = 12


def selected_rows(count: int) -> Index:
    """The rows that a table of `count` samples shows: evenly spaced, the first and the last included."""
    return np.unique(np.linspace(0, max(count - 1, 0), min(count, _MAX_ROWS)).round().astype(np.intp))


def table_html(
    title: str, phase: NDArray[np.int8], kinds: type[IntEnum], columns: Mapping[str, Sequence[object]]
) -> str:
    """A table with the columns, already reduced to `selected_rows`, and a caption that counts the phases (n,) of all samples.

    Numbers have six digits, NaN is a dash.
    """
    rows = selected_rows(len(phase))
    counts = ", ".join(f"{np.count_nonzero(phase == kind)} {kind.name.lower()}" for kind in kinds)
    columns = {"phase": [kinds(int(value)).name.lower() for value in phase[rows]], **columns}
    body = "".join(
        f"<tr><th>{row}</th>" + "".join(f"<td>{html.escape(_cell(cell))}</td>" for cell in cells) + "</tr>"
        for row, cells in zip(rows, zip(*columns.values(), strict=True), strict=True)
    )
    head = "<th></th>" + "".join(f"<th>{html.escape(name)}</th>" for name in columns)
    caption = f"{title}: {len(phase)} samples, {counts}"
    return f"<table><caption>{caption}</caption><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _cell(value: object) -> str:
    if isinstance(value, float):
        return "–" if np.isnan(value) else f"{value + 0.0:.6g}"
    return str(value)
