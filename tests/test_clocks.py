"""Times of day and dates, against Python's `datetime`."""

import re
from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pytest
from test_laboratory_errors import data, lines, put

from scan3d import InputError, import_table
from scan3d.laboratory.clocks import seconds

SHAPES = {
    "time of day": lambda t: t.strftime("%H:%M:%S.%f"),
    "decimal comma": lambda t: t.strftime("%H:%M:%S,%f"),
    "half days": lambda t: t.strftime("%I:%M:%S.%f %p").lstrip("0"),
    "ISO": lambda t: t.isoformat(),
    "ISO with a space and a zone": lambda t: t.isoformat(sep=" ") + "+02:00",
    "UTC": lambda t: t.isoformat() + "Z",
    "the zone changes": lambda t: (
        t.replace(tzinfo=UTC).astimezone(timezone(timedelta(hours=1 + t.day % 2))).isoformat()
    ),
    "German": lambda t: t.strftime("%d.%m.%Y %H:%M:%S.%f"),
    "German, short": lambda t: t.strftime("%d.%m.%y %H:%M:%S.%f"),
    "American": lambda t: t.strftime("%m/%d/%Y %I:%M:%S.%f %p"),
    "British": lambda t: t.strftime("%d/%m/%Y %H:%M:%S.%f"),
    "Excel": lambda t: t.strftime("%m/%d/%Y, %H:%M:%S.%f"),
    "slashes, year first": lambda t: t.strftime("%Y/%m/%d %H:%M:%S.%f"),
}


def moments(start, count=70, step=0.01):
    return [start + timedelta(seconds=round(step * k, 6)) for k in range(count)]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(
    "start",
    [
        datetime(2026, 5, 1, 10, 0),
        datetime(2026, 5, 1, 23, 59, 59, 600_000),
        datetime(2024, 2, 28, 23, 59, 59, 990_000),
        datetime(2026, 12, 31, 23, 59, 59, 700_000),
        datetime(2026, 1, 12, 11, 59, 59, 700_000),
    ],
)
def test_against_datetime(shape, start):
    times = moments(start)
    found, wrong = seconds([SHAPES[shape](time) for time in times])
    assert wrong is None
    assert np.array_equal(found, [(time - start) / timedelta(microseconds=1) * 1e3 * 1e-9 for time in times])


@pytest.mark.parametrize("shape", SHAPES)
def test_a_log_past_midnight_is_imported(tmp_path, shape):
    def row(k, line):
        cell = SHAPES[shape](moments(datetime(2026, 5, 1, 23, 59, 59, 800_000))[k - 1])
        return re.sub("^[^,]+", f'"{cell}"', line) if k else line

    rows = [row(k, line) for k, line in enumerate(lines())]
    found, expected = import_table(put(tmp_path, rows), data()), import_table(put(tmp_path, lines()), data())
    assert np.array_equal(found.force_N, expected.force_N)


@pytest.mark.parametrize(
    ("row", "cell"), [(5, "25:00:00"), (5, "10:00"), (5, "13:00:00 PM"), (0, "01-May-2026 10:00:00"), (5, "x")]
)
def test_other_times_are_named_with_the_way_out(tmp_path, row, cell):
    rows = [re.sub("^[^,]+", f"10:00:00.{k:03}", line) if k else line for k, line in enumerate(lines())]
    rows[row + 1] = re.sub("^[^,]+", cell, rows[row + 1])
    with pytest.raises(InputError) as error:
        import_table(put(tmp_path, rows), data())
    expected = rf"log\.csv: line {row + 2} has '{cell}' in column 't', where .* a time as .*leave time out of"
    assert re.match(expected, str(error.value))


def test_a_day_that_does_not_exist():
    assert seconds(["28.02.2026 10:00:00", "30.02.2026 10:00:00"])[1] == 1
    assert seconds(["1/13/2026 10:00:00", "13/13/2026 10:00:00"])[1] == 1


def test_times_without_a_value(tmp_path):
    rows = [re.sub("^[^,]+", f"10:00:00.{k:03}", line) if k else line for k, line in enumerate(lines())]
    rows[7] = re.sub("^[^,]+", "", rows[7])
    with pytest.raises(InputError, match="line 8 has no value in column 't'"):
        import_table(put(tmp_path, rows), data())
    import_table(put(tmp_path, rows), data() | {"table": {"missing": "drop"}})


def test_a_clock_that_runs_backwards_is_no_midnight(tmp_path):
    rows = [re.sub("^[^,]+", f"10:00:{59 - k % 60:02}", line) if k else line for k, line in enumerate(lines())]
    with pytest.raises(InputError, match="time runs backwards"):
        import_table(put(tmp_path, rows), data())
