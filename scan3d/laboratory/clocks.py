"""Times of day, and dates with them, as loggers, spreadsheets and LabVIEW write them: in seconds."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import date

import numpy as np
from numpy.typing import NDArray

from scan3d.arrays import Array
from scan3d.files.tables import NO_VALUE

FORMS = "2026-05-01T10:00:00.5, 01.05.2026 10:00:00.5, 05/01/2026 10:00:00.5 AM or 10:00:00.5"
"""Those that are read, for messages."""
_CLOCK = re.compile(
    r"(?P<date>\d{1,4}(?P<between>[-./])\d{1,2}(?P=between)\d{1,4}(?:T|[\s,]+))?"
    r"(?P<hour>\d\d?):(?P<minute>[0-5]\d):(?P<second>[0-5]\d|60)(?P<part>[.,]\d*)?"
    r"(?:\s*(?P<half>[AaPp])\.?[Mm]\.?)?\s*(?:Z|UTC|(?P<sign>[+-])(?P<east>\d\d):?(?P<more>\d\d))?"
)
_DAY = 86_400 * 10**9


def seconds(cells: Sequence[str]) -> tuple[Array, int | None] | None:
    """Times (n,) after the first one, NaN in cells without a value, and the first row that is no such time.

    None if the first value is none of the `FORMS`.  Without dates a step back by more than half a day is midnight.  Of dates
    whose day may be their month, that order counts in which the log does not run backwards, and is the shorter.
    """
    given = [cell.strip() for cell in cells]
    rows = [row for row, cell in enumerate(given) if cell.lower() not in NO_VALUE]
    found = [_CLOCK.fullmatch(given[row]) for row in rows]
    if not found or (first := found[0]) is None:
        return None
    values, clock, dates = np.full(len(cells), np.nan), np.zeros(len(rows), dtype=np.int64), []
    for k, one in enumerate(found):
        if one is None or (one["date"] is None) != (first["date"] is None) or (since := _since_midnight(one)) is None:
            return values, rows[k]
        clock[k] = since
        dates.append(one["date"])
    orders: Sequence[str] = ()
    if first["date"] is None:
        days = [np.cumsum(np.diff(clock, prepend=clock[:1]) < -_DAY // 2, dtype=np.int64)]
    else:
        orders = _orders(first["date"].strip(" \tT,"), first["between"])
        days = [known for order in orders if (known := _days(dates, order)) is not None]
    times = [clock + _DAY * one for one in days]
    if not times:
        return values, next((rows[k] for k, one in enumerate(dates) if _days([one], orders[0]) is None), rows[0])
    best = min(times, key=lambda time: (bool((np.diff(time) < 0).any()), int(np.ptp(time))))
    values[rows] = (best - best[0]) * 1e-9
    return values, None


def _since_midnight(clock: re.Match[str]) -> int | None:
    """Nanoseconds after midnight in UTC, or where no zone is stated; None for an hour that does not exist."""
    hour, half = int(clock["hour"]), clock["half"]
    if hour > 23 or (half is not None and not 1 <= hour <= 12):
        return None
    if half is not None:
        hour = hour % 12 + 12 * (half in "Pp")
    east = 60 * int(clock["east"]) + int(clock["more"]) if clock["sign"] else 0
    minute = 60 * hour + int(clock["minute"]) + (east if clock["sign"] == "-" else -east)
    return (60 * minute + int(clock["second"])) * 10**9 + int((clock["part"] or "")[1:10].ljust(9, "0"))


def _orders(day: str, between: str) -> Sequence[str]:
    """The orders that the numbers of a date may have."""
    if len(day.split(between)[0]) == 4:
        return ("ymd",)
    return ("dmy",) if between == "." else ("mdy", "dmy")


def _days(dates: Sequence[str], order: str) -> NDArray[np.int64] | None:
    """The numbers (n,) of days; None if one of them does not exist in the order."""
    number: dict[str, int] = {}
    for one in {*dates}:
        parts = dict(zip(order, map(int, re.findall(r"\d+", one)), strict=True))
        try:
            number[one] = date(parts["y"] + 2000 * (parts["y"] < 100), parts["m"], parts["d"]).toordinal()
        except ValueError:
            return None
    return np.array([number[one] for one in dates], dtype=np.int64)
