"""What is wrong with a table or a map: one sentence each, with the file, the line, the column, and what to do."""

import copy
import re
from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pytest
from raw_tables import map_of

from scan3d import InputError, Rod, import_table
from scan3d.files.tables import guessed_layout, read_table
from scan3d.files.text import to_toml
from scan3d.laboratory.clocks import seconds
from scan3d.laboratory.maps import guess_map, read_map

ROD = Rod(0.06, 1.9e-4, 0.0003)
NAMES = ["t", "x", "y", "z", "qw", "qx", "qy", "qz", "Fx", "Fy", "Fz", "Tx", "Ty", "Tz"]


def log():
    """A table by hand: air, a stroke along -x with a force that grows, air; 5 mm steps, N and N mm."""
    n, air = 40, 15
    travel = np.concatenate([np.zeros(air), np.linspace(0, 40, n), np.full(air, 40.0)])
    deflected = np.clip(np.concatenate([np.zeros(air), np.linspace(-0.3, 1, n), np.zeros(air)]), 0, None)
    table = np.zeros((n + 2 * air, len(NAMES)))
    table[:, 0] = 0.01 * np.arange(len(table))
    table[:, 1], table[:, 4] = 20 - travel, 1.0
    table[:, 2] = np.concatenate([np.linspace(-20, -10, air), np.full(n, -10.0), np.linspace(-10, -20, air)])
    table[:, 8], table[:, 9] = -0.2 * deflected, 0.05 * deflected
    table[:, 13] = 5.0 * deflected
    return table


def data():
    made = map_of(ROD, SimpleRig)
    made["columns"]["orientation"] = {"quaternion": ["qw", "qx", "qy", "qz"]}
    return made


class SimpleRig:
    turn_deg, position_mm, shows = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), "clamp-on-rod"


HEADER = ",".join(NAMES)


def lines(table=None, header=HEADER):
    rows = [",".join(map(repr, row)) for row in (log() if table is None else table).tolist()]
    return [*([header] if header else []), *rows]


def put(folder, rows):
    path = folder / "log.csv"
    path.write_text("\n".join(rows) + "\n")
    return path


def with_cell(line, column, text):
    rows = lines()
    cells = rows[line - 1].split(",")
    cells[NAMES.index(column)] = text
    rows[line - 1] = ",".join(cells)
    return rows


def empty(column):
    place = NAMES.index(column)
    cells = (line.split(",") for line in lines()[1:])
    return [lines()[0], *(",".join([*row[:place], "", *row[place + 1 :]]) for row in cells)]


def semicolons():
    return [lines()[0].replace(",", ";"), *(line.replace(",", ";").replace(".", ",") for line in lines()[1:])]


def backwards():
    rows = lines()
    rows[20], rows[21] = rows[21], rows[20]
    return rows


UNITS = "s,mm,mm,mm,,,,,N,N,N,N mm,N mm,N mm"


def scaled(names, factor):
    table = log()
    table[:, [NAMES.index(name) for name in names]] *= factor
    return lines(table)


def changed(section, **entries):
    made = data()
    made[section] = made.get(section, {}) | entries
    return made


def without_time():
    made = changed("tare", air=[[0.0, 0.1]])
    del made["columns"]["time"]
    return made


def without_air():
    table = log()
    table[:, 8:] += np.linspace(0, 1, len(table))[:, None] ** [2, 3, 2, 3, 2, 3] * [1, 1, 1, 30, 30, 30]
    return lines(table[25:55])


def timed(time):
    """The lines with other times, of their numbers from 1."""
    return [re.sub("^[^,]+", time(k), line) if k else line for k, line in enumerate(lines())]


def one_time(row, cell):
    return timed(lambda k: cell if k == row + 1 else f"10:00:00.{k:03}")


@pytest.mark.parametrize(
    "case",
    [
        (with_cell(7, "Fx", "o.5"), r"log\.csv: line 7 has 'o\.5' in column 'Fx', which is no number; correct the cell"),
        (with_cell(7, "Fx", ""), r"line 7 has no value in column 'Fx'.*1 of 70 rows; .*missing = \"drop\" under \[table\]"),
        (empty("Fx"), r"no value in column 'Fx'.*70 of 70 rows; complete the table, or write \"\" for this column in the map"),
        (lines()[:1], r"log\.csv has no row of data below line 1; expected one row per sample"),
        ([*lines(), "0.7,1,2"], r"log\.csv: line 72 has 3 values, expected 14; it ends in column 3: is it cut off\?"),
        ([lines()[0], UNITS, *lines()[1:]], r"line 2 has 's' in column 1 \(t\), .*a second header line; .*units_row = true"),
        ([lines()[0], *lines()], r"line 2 has 't' in column 1 \(t\).*a second header line; .*else header = 2"),
        (semicolons(), r"log\.csv: line 2 has '20,0' in column 'x', a decimal comma; write decimal = \",\" under \[table\]"),
        ([HEADER, *(line.replace(".", ",") for line in lines()[1:])], r"line 2 has 28 values, expected 14; are there decimal"),
        (backwards(), r"line 22 has a time 0\.01 s before that of the row above, and time runs backwards in 1 of 70"),
        (scaled(["Tx", "Ty", "Tz"], 0), r"the moment is zero in all 70 rows: nothing was measured; check \[columns\] moment"),
        (lines(header=HEADER.replace("Fx", "Fx [mN]")), r"line 1 has no column 'Fx', which .*; did you mean Fx \[mN\]\?"),
        (scaled(["x"], 1e3), r"log\.csv: the sweeps are 667 rod lengths long.*check \[units\] length"),
        (scaled(["x", "y", "z"], 1e-3), r"the clamp moves over 0\.000667 rod lengths only; check \[units\] length"),
        (scaled(["x"], 0), r"the clamp moves in contact mostly along \+y of its own frame, and not along -x as in a sweep"),
        (scaled(["Tz"], 1e3), r"the moments in contact are .* times the largest that the rod can have.*\[units\]"),
        # what the header says of units
        (lines(header=HEADER.replace("Tx,", "Tx_Nm,")),
         r"line 1 says that column 'Tx_Nm' is in N m, and \[units\] moment .* says N mm",
         changed("columns", moment=["Tx_Nm", "Ty", "Tz"])),
        (lines(header=HEADER.replace("Tx,", "Tx [m N],")),
         r"line 1 says that column 'Tx \[m N\]' is in N m, and \[units\] moment .* says N mm",
         changed("columns", moment=["Tx [m N]", "Ty", "Tz"])),
        ([HEADER, UNITS.replace("mm", "m", 3), *lines()[1:]],
         r"line 2 says that column 'x' is in m, and \[units\] length .* says mm", changed("table", units_row=True)),
        (lines(), r"log\.csv has 14 columns, and \[columns\] force of the map names column 15",
         changed("columns", force=[9, 10, 15])),
        # a delimiter before the unit would shift the columns; a row that is cut off stays one
        ([lines(header=HEADER.replace("Fx", "Fx,N"))[0], *lines()[1:]], "line 2 has 14 values, expected 15"),
        ([f"{HEADER},note", *(f"{line}," for line in lines()[1:-1]), lines()[-1]],
         "line 71 has 14 values, expected 15; it ends in column 14: is it cut off"),
        # air that is not there
        (without_air(), r'log\.csv: no stretch is found in which the rod is in the air.*air = "none"'),
        (lines(), r"no row from 5 s to 6 s, which \[tare\] air of the map names; the table covers 0 s to 0\.69 s",
         changed("tare", air=[[5.0, 6.0]])),
        (lines(), r"the stretches of \[tare\] air overlap at 0\.05 s", changed("tare", air=[[0.0, 0.1], [0.05, 0.12]])),
        (lines(), r"\[tare\] air in seconds needs the time of the rows", without_time()),
        # times of day
        *((one_time(row, cell), rf"log\.csv: line {row + 2} has '{cell}' in column 't', where .* a time as .*leave time out of")
          for row, cell in ((5, "25:00:00"), (5, "10:00"), (5, "13:00:00 PM"), (0, "01-May-2026 10:00:00"), (5, "x"))),
        (one_time(6, ""), "line 8 has no value in column 't'"),
        (timed(lambda k: f"10:00:{59 - k % 60:02}"), "time runs backwards"),
    ],
    ids=range(33),
)  # fmt: skip
def test_tables(tmp_path, case):
    rows, words, made = case if len(case) == 3 else (*case, data())
    with pytest.raises(InputError, match=words) as error:
        import_table(put(tmp_path, rows), made)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 500


def test_what_a_map_announces_is_read(tmp_path):
    expected = import_table(put(tmp_path, lines()), data())
    assert (len(expected), expected.six_axis, expected.moment_Nm.max()) == (40, True, pytest.approx(5e-3))
    dates = [f"{np.datetime64(round(1e3 * t), 'ms')}+02:00" for t in log()[:, 0].tolist()]
    midnight = moments(datetime(2026, 5, 1, 23, 59, 59, 800_000))
    cases = [
        ([HEADER, UNITS, *lines()[1:]], {"units_row": True}),
        (semicolons(), {"decimal": ","}),
        (
            [line.replace(",", '";"').replace(".", ",").replace(";", ",").join('""') for line in lines()],
            {"decimal": ","},
        ),
        (["Experiment 7", "by A. Person", *lines()], {"header": 3}),
        (["# a comment", *lines()[:5], "# another one", *lines()[5:]], {}),
        ([line.replace(",", "\t") for line in lines()], {}),
        ([line.replace(",", "  ") for line in lines()], {}),
        ([f'"{line}"'.replace(",", '","') for line in lines()], {}),
        (with_cell(3, "Fy", ""), {"missing": "drop"}),
        (with_cell(3, "Fy", "N/A"), {"missing": "drop"}),
        ([HEADER, *(f"{line}," for line in lines()[1:])], {}),
        ([*lines(), *3 * [",," * 7]], {}),
        ([HEADER, *(line.replace("-", "\u2212") for line in lines()[1:])], {}),
        ([HEADER, *(re.sub(r"([^,]+)", lambda cell: f"{float(cell[1])!r}D+00", line) for line in lines()[1:])], {}),
        (timed(lambda k: dates[k - 1]), {}),
        (timed(lambda k: f'"{SHAPES["decimal comma"](midnight[k - 1])}"'), {}),
        (one_time(6, ""), {"missing": "drop"}),
    ]
    for text, table in cases:
        found = import_table(put(tmp_path, text), data() | {"table": table})
        assert np.array_equal(found.force_N, expected.force_N), table
        assert np.array_equal(found.position_m, expected.position_m), table
    for encoding in ("utf-8-sig", "utf-16"):
        (tmp_path / "log.csv").write_bytes("\r\n".join(lines()).encode(encoding))
        assert np.array_equal(import_table(tmp_path / "log.csv", data()).force_N, expected.force_N)


def test_columns_by_number_and_without_names(tmp_path):
    expected = import_table(put(tmp_path, lines()), data())
    made = data()
    turn = {"quaternion": [5, 6, 7, 8]}
    made["columns"] |= dict(time=1, position=[2, 3, 4], orientation=turn, force=[9, 10, 11], moment=[12, 13, 14])
    assert np.array_equal(import_table(put(tmp_path, lines(header="")), made).force_N, expected.force_N)


def test_quaternions_of_wrong_order(tmp_path):
    # the clamp's x axis is the world's y axis: half a right angle in each of w and z
    table = log()
    half = np.sqrt(0.5)
    table[:, 4:8] = [half, 0, 0, half]
    table[:, [1, 2]] = np.stack([-table[:, 2], table[:, 1]], axis=1)
    import_table(put(tmp_path, lines(table)), data())
    wrong = copy.deepcopy(data())
    wrong["columns"]["orientation"]["order"] = "xyzw"
    with pytest.raises(
        InputError, match=r'log\.csv: the clamp moves .* right if qw is the first of the four columns, order = "wxyz"'
    ):
        import_table(put(tmp_path, lines(table)), wrong)


def test_sweeps_that_the_filter_blurs_are_named(tmp_path):
    table = log()
    table[:, 8:] = 0.0
    table[34:37, [8, 9, 13]] = [-0.2, 0.05, 5.0]
    sweep = np.full(len(table), -1)
    sweep[33:38] = 0
    rows = [f"{row},{number}" for row, number in zip(lines(table, ""), sweep.tolist(), strict=True)]
    made = changed("columns", sweep="sweep") | {"filter": {"lowpass_hz": 5.0}}
    with pytest.raises(InputError, match=r"no row of a sweep that can be used: the filter blurs all.*raise lowpass_hz"):
        import_table(put(tmp_path, [f"{HEADER},sweep", *rows]), made)


@pytest.mark.parametrize(
    ("made", "sentence"),
    [
        (changed("units", moment="Nmmm"), r"map\.toml: \[units\] moment must be a unit of moment: N m, N cm, .*; got 'Nmmm'"),
        (changed("units", lenght="mm"), r"map\.toml: \[units\] has unknown names: lenght; .*; did you mean length\?"),
        (changed("columns", force=["Fx"]), r"\[columns\] force must be a list of 2 or 3 columns; got"),
        (changed("columns", orientation={"quat": []}), r"\[columns\] orientation needs one of quaternion, euler, rotvec"),
        (
            changed("columns", orientation={"euler": ["a", "b", "c"], "convention": "xYz"}),
            r"\[columns\.orientation\] convention must be one to three axes.*got 'xYz'",
        ),
        (changed("sensor", shows="rod on clamp"), r"\[sensor\] shows must be one of clamp-on-rod, rod-on-.*did you mean"),
        (
            changed("columns", force=["Fx", "Fy"], moment=["Tz"]) | {"sensor": {"euler_deg": [0, 30, 0]}},
            r"log\.csv: fx of the clamp needs fz of the sensor as well, because \[sensor\] turns",
        ),
        (
            changed("columns", wrench_in="world", moment=["", "", "Tz"]),
            r"needs all six channels.* mx, my is missing",
        ),
        (changed("tare", air="automatic"), r"\[tare\] air must be 'auto', 'none', or stretches in seconds"),
        (changed("tare", air=[[2.0, 1.0]]), r"\[tare\] air must be 'auto', .*; got \[2\.0, 1\.0\]"),
        (changed("filter", lowpass_hz=80), r"log\.csv: \[filter\] lowpass_hz = 80 must be below half of .* rate of 100 Hz"),
        (changed("rod", length_m=0.0), r"map\.toml: \[rod\] a rod needs a positive length in metres, got 0\.0"),
        (data() | {"rod": {"length_m": 0.05}}, r"map\.toml: \[rod\] needs length_m and bending_stiffness_Nm2, or length_m"),
        (data() | {"unit": "furlong"}, r"map\.toml: unit must be one of m, cm, mm, um, in; got 'furlong'"),
        ({k: v for k, v in data().items() if k != "columns"}, r"map\.toml: \[columns\] is missing; it says which columns hold"),
        ({"Rod" if k == "rod" else k: v for k, v in data().items()}, r"\[rod\] needs length_m and .*; did you mean Rod\?"),
        (changed("columns", orientation={"quaterion": []}), r"orientation needs one of .*; did you mean quaternion\?"),
        ({"columns": {"positon": ["x", "y", "z"]}}, r"\[columns\] position is missing; .*; did you mean positon\?"),
    ],
    ids=range(18),
)  # fmt: skip
def test_maps(tmp_path, made, sentence):
    (tmp_path / "map.toml").write_text(to_toml(made))
    with pytest.raises(InputError, match=sentence) as error:
        import_table(put(tmp_path, lines()), tmp_path / "map.toml")
    assert "\n" not in str(error.value)


def test_maps_that_can_not_be_read(tmp_path):
    with pytest.raises(
        InputError, match=r"can't read the map .*map\.toml: No such file.*; scan3d import RAW --map map\.toml --guess"
    ):
        read_map(tmp_path / "map.toml")
    (tmp_path / "map.toml").write_text("[columns\n")
    with pytest.raises(InputError, match=re.escape("map.toml is not a TOML file: ")):
        read_map(tmp_path / "map.toml")
    with pytest.raises(InputError, match=r"can't read the table .*none\.csv: No such file"):
        import_table(tmp_path / "none.csv", data())


def test_blanks_before_quotes(tmp_path):
    """The sign of the delimiter and a blank before a quoted cell, as of the tools of many databases."""
    expected = import_table(put(tmp_path, lines()), data())
    names = [", ".join(f'"{name}"' for name in NAMES)]
    for rows in ([*names, *lines()[1:]], [*names, *(line.replace(",", ", ") for line in lines()[1:])]):
        assert np.array_equal(import_table(put(tmp_path, rows), data()).force_N, expected.force_N)
        assert "Fx" in guess_map(tmp_path / "log.csv").text
        assert '\\"' not in guess_map(tmp_path / "log.csv").text


def labview(rows, delimiter="\t", decimal=".", comment="", more=""):
    """What "Write To Measurement File" makes of a table, after National Instruments' specification of the text format."""
    separator = {"\t": "Tab", ",": "Comma", ";": "Semicolon"}[delimiter]
    head = ["LabVIEW Measurement", "Writer_Version\t2", "Reader_Version\t2", f"Separator\t{separator}"]
    head += [f"Decimal_Separator\t{decimal}", "Multi_Headings\tNo", "X_Columns\tOne", "***End_of_Header***", ""]
    head += ["Channels\t13", "Samples\t70", "X_Dimension\tTime", "***End_of_Header***"]
    names, *values = ([cell.replace(".", decimal) for cell in row.split(",")] for row in rows)
    table = [[*("X_Value" if name == "t" else name for name in names), "Comment"], [*values[0], comment], *values[1:]]
    lines = [f"{line}\t".replace("\t", delimiter) for line in head]
    if more == "no times":
        lines[6:6] = [
            f"X0\t0{decimal}0\t".replace("\t", delimiter),
            f"Delta_X\t0{decimal}01\t".replace("\t", delimiter),
        ]
        lines = [line.replace("One", "No") for line in lines]
        table = [table[0], *(["", *row[1:]] for row in table[1:])]
    rows = [delimiter.join(row) for row in table]
    if more == "headers":
        lines = [line.replace(f"Headings{delimiter}No", f"Headings{delimiter}Yes") for line in lines]
        rows[20:20] = ["", *lines[-4:], rows[0]]
    return [*lines, *rows]


@pytest.mark.slow
@pytest.mark.parametrize("comment", ["", "the first"])
@pytest.mark.parametrize("more", ["", "headers", "no times"])
@pytest.mark.parametrize(("delimiter", "decimal"), [("\t", "."), ("\t", ","), (",", "."), (";", ",")])
def test_files_of_labview(tmp_path, delimiter, decimal, comment, more):
    expected, made = import_table(put(tmp_path, lines()), data()), data()
    made["columns"]["time"] = "X_Value"
    rows = labview(lines(), delimiter, decimal, comment, more)
    for table in ({}, {"header": rows.index(next(row for row in rows if row.startswith("X_Value"))) + 1}):
        found = import_table(put(tmp_path, rows), made | {"table": table})
        assert np.array_equal(found.force_N, expected.force_N)
    guess = guess_map(tmp_path / "log.csv")
    assert not {"time", "position", "orientation", "force", "moment"} & {*guess.open}
    assert 'time = "X_Value"' in guess.text


@pytest.mark.parametrize(
    ("first", "second", "later"),
    [
        ("X0\t0.5", "X0\t9", 8.5),
        ("Date\t2026/05/01\nTime\t23:59:58.25\nX0\t0", "Date\t2026/05/02\nTime\t00:00:01.5\nX0\t0", 3.25),
        ("Date\t2026/13/01\nTime\t23:59:58.25\nX0\t0", "Date\t2026/05/02\nX0\t2", 2),
    ],
)
def test_each_heading_of_labview_states_its_own_times(first, second, later, tmp_path):
    """After National Instruments' specification: X0 counts from the date and the time of the same heading."""
    end, names = "***End_of_Header***", "X_Value\tFx"
    head = ["LabVIEW Measurement", "Separator\tTab", "Multi_Headings\tYes", "X_Columns\tNo", "Time_Pref\tRelative", end]
    blocks = [
        ["", "Channels\t1", *stated.split("\n"), f"Delta_X\t{step}", end, names, "\t1", "\t2"]
        for stated, step in ((first, 0.25), (second, 0.5))
    ]
    path = put(tmp_path, [*head, *blocks[0], *blocks[1]])
    time = read_table(path, guessed_layout(path)).numbers(0)
    assert (time - time[0]).tolist() == [0, 0.25, later, later + 0.5]


def test_a_quote_that_is_never_closed_is_no_cell(tmp_path):
    """Also where it would hold more than a cell may."""
    rows = [*lines()[:30], '"' + "1," * 100_000, *lines()[30:]]
    with pytest.raises(InputError, match=r"log\.csv: line"):
        import_table(put(tmp_path, rows), data())
    with pytest.raises(InputError, match=r"log\.csv: line"):
        guess_map(tmp_path / "log.csv")


def test_a_first_map_that_is_not_completed_says_at_once_all_that_is_open(tmp_path):
    (tmp_path / "log.csv").write_text("a,b,c,Fx,Fy,d\n" + "0,1,2,0.1,0.2,1\n" * 4)
    (tmp_path / "map.toml").write_text(guess_map(tmp_path / "log.csv").text)
    with pytest.raises(InputError) as caught:
        read_map(tmp_path / "map.toml")
    for entry in ("[columns] position", "[columns] moment", "[rod] length_m", "[rod] bending_stiffness_Nm2"):
        assert entry in str(caught.value)
    assert "force" not in str(caught.value)


# --- times of day and dates, against datetime of Python ---

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


def test_a_day_that_does_not_exist():
    assert seconds(["28.02.2026 10:00:00", "30.02.2026 10:00:00"])[1] == 1
    assert seconds(["1/13/2026 10:00:00", "13/13/2026 10:00:00"])[1] == 1
