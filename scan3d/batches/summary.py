"""The summary of a batch: its rows as tables, and the best, the median and the worst run."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scan3d.batches.runs import COLUMNS, DONE, FAILED, Row
from scan3d.files.parquet import parquet_bytes
from scan3d.files.reading import to_float

# Largest whole number of a column of whole numbers in Parquet; settings of runs that fail may be larger.
_LARGEST_WHOLE = 2**63 - 1
RANKED_BY = "hausdorff_relative"
"""The column that says which run is best."""


class Ranks(NamedTuple):
    """Rows of the best, the median and the worst of the runs that are done; None if none is."""

    best: Row | None
    median: Row | None
    worst: Row | None


def ranks(rows: Sequence[Row]) -> Ranks:
    """The best, the median and the worst run by the Hausdorff distance relative to the diagonal.

    Of an even number of runs the better one of the two in the middle counts as the median.
    """
    known = sorted((row for row in rows if row["status"] == DONE and row[RANKED_BY] is not None), key=_rank)
    if not known:
        return Ranks(None, None, None)
    return Ranks(known[0], known[(len(known) - 1) // 2], known[-1])


def _rank(row: Row) -> float:
    return float(row[RANKED_BY])


def failures(rows: Sequence[Row]) -> list[Row]:
    """The rows of the runs that have failed."""
    return [row for row in rows if row["status"] == FAILED]


def csv_bytes(rows: Sequence[Row]) -> bytes:
    """The rows as CSV in UTF-8, with a header; what is not known is empty, and numbers have all digits."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows([_text(row[name]) for name in COLUMNS] for row in rows)
    # file names may hold bytes that are no characters
    return stream.getvalue().encode(errors="replace")


def _text(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value) if isinstance(value, float) else str(value)


def parquet_table(rows: Sequence[Row]) -> bytes | None:
    """The rows as Parquet, numbers that are not known as NaN; None where pyarrow is not installed."""
    if find_spec("pyarrow") is None:
        return None
    return parquet_bytes({name: _column([row[name] for row in rows], kind) for name, kind in COLUMNS.items()})


def _column(values: list[Any], kind: type) -> NDArray[Any]:
    if kind is str:
        return np.array([str(value).encode(errors="replace").decode() for value in values], dtype=object)
    if kind is float:
        return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
    if kind is int and any(abs(value) > _LARGEST_WHOLE for value in values):
        return np.array([to_float(value) for value in values])
    return np.array(values, dtype=kind)
