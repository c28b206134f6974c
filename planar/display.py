"""How results show themselves in a notebook: some of their rows as a table in HTML."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

# Rows of a table at most.
_MOST_ROWS = 12


def some_rows(count: int) -> NDArray[np.intp]:
    """Which of so many rows a table has, evenly chosen, the first and the last among them."""
    return np.unique(np.linspace(0, max(count - 1, 0), min(count, _MOST_ROWS)).round().astype(np.intp))


def table_html(
    what: str, phase: NDArray[np.int8], kinds: type[IntEnum], columns: Mapping[str, Sequence[object]]
) -> str:
    """The columns of `some_rows` by name; above them how many rows (n,) there are of each kind of contact.

    Numbers have six digits, NaN is a dash.
    """
    counts = ", ".join(f"{np.count_nonzero(phase == kind)} {kind.name.lower()}" for kind in kinds)
    columns = {"phase": [kinds(int(one)).name.lower() for one in phase[some_rows(len(phase))]], **columns}
    body = "".join(
        f"<tr><th>{row}</th>" + "".join(f"<td>{html.escape(_cell(cell))}</td>" for cell in cells) + "</tr>"
        for row, cells in zip(some_rows(len(phase)), zip(*columns.values(), strict=True), strict=True)
    )
    head = "<th></th>" + "".join(f"<th>{html.escape(name)}</th>" for name in columns)
    caption = f"{what}: {len(phase)} samples, {counts}"
    return f"<table><caption>{caption}</caption><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _cell(value: object) -> str:
    if isinstance(value, float):
        return "–" if np.isnan(value) else f"{value + 0.0:.6g}"
    return str(value)
