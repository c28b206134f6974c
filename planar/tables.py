"""Tables of results: a selection of the rows in HTML for notebooks, all of them for pandas."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planar.arrays import Array, Index

if TYPE_CHECKING:
    import pandas

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
    columns = {"phase": words(phase[rows], kinds), **columns}
    body = "".join(
        f"<tr><th>{row}</th>" + "".join(f"<td>{html.escape(_cell(cell))}</td>" for cell in cells) + "</tr>"
        for row, cells in zip(rows, zip(*columns.values(), strict=True), strict=True)
    )
    head = "<th></th>" + "".join(f"<th>{html.escape(name)}</th>" for name in columns)
    caption = counted(title, phase, kinds)
    return f"<table><caption>{caption}</caption><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def words(values: NDArray[np.int8], kinds: type[IntEnum]) -> list[str]:
    """The names (n,) of coded values (n,)."""
    return [kinds(value).name.lower() for value in values.tolist()]


def counted(title: str, phase: NDArray[np.int8], kinds: type[IntEnum]) -> str:
    """How many samples there are, and how many of each phase."""
    counts = ", ".join(f"{np.count_nonzero(phase == kind)} {kind.name.lower()}" for kind in kinds)
    return f"{title}: {len(phase)} samples, {counts}"


def to_frame(columns: Mapping[str, Array | Sequence[str]]) -> pandas.DataFrame:
    """A data frame of the columns (n,) but those of NaN alone.  Raises ImportError without pandas."""
    try:
        import pandas
    except ImportError as error:
        raise ImportError(f"to_pandas needs pandas, which can't be imported ({error}): pip install pandas") from None
    return pandas.DataFrame(
        {
            name: column
            for name, column in columns.items()
            if not len(column) or isinstance(column, list) or not np.isnan(column).all()
        }
    )


def _cell(value: object) -> str:
    if isinstance(value, float):
        return "–" if np.isnan(value) else f"{value + 0.0:.6g}"
    return str(value)
