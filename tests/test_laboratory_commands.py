"""`scan3d import`: files, first maps, the page; and Parquet."""

import json
import os
import shutil
import signal
import sys
import tomllib

import numpy as np
import pytest
import trimesh
from PIL import Image
from raw_tables import Rig, map_of, table, track, write

import scan3d
from scan3d import InputError
from scan3d.cli import main
from scan3d.files.columns import parquet_bytes
from scan3d.files.text import to_toml
from scan3d.laboratory.importing import convert, load
from scan3d.laboratory.maps import guess_map, read_map
from scan3d.pictures.views import import_figure

RIG = Rig(noise=0.002)


@pytest.fixture(scope="module")
def recording():
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=15.0)
    return scan3d.simulate(mesh, scan3d.Plan(slices=2, sweeps=3, samples=24))


@pytest.fixture(scope="module")
def files(tmp_path_factory, recording):
    folder = tmp_path_factory.mktemp("files")
    write(folder / "raw.csv", table(track(recording), RIG))
    (folder / "rig.toml").write_text(to_toml(map_of(recording.rod, RIG)))
    return folder


@pytest.fixture
def place(tmp_path, files, monkeypatch):
    shutil.copytree(files, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.slow
def test_the_command_writes_a_recording_with_its_origin(place, capsys):
    for name in ("log.csv", "log.parquet"):
        assert main(["import", "raw.csv", "--map", "rig.toml", "--out", name]) == 0
        assert f"written to         {name}" in capsys.readouterr().out
        source = scan3d.read_recording(name).source
        assert (source["kind"], source["table"]) == ("import", "raw.csv")
        assert len(source["table_sha256"]) == 64
        assert source["map"] == tomllib.loads((place / "rig.toml").read_text())
    assert (
        main(["import", "raw.csv", "--map", "rig.toml", "--out", "log.csv", "--json"]) == 0
    )  # an earlier import is replaced
    data = json.loads(capsys.readouterr().out)
    assert data["rows"] == len((place / "raw.csv").read_text().splitlines()) - 1
    assert data["noise_force_N"] > 0


@pytest.mark.slow
def test_sweeps_come_after_those_of_an_earlier_recording(place, capsys):
    run = ["import", "raw.csv", "--map", "rig.toml", "--quiet"]
    assert main([*run, "--out", "first.csv"]) == 0
    assert main([*run[:-1], "--after", "first.csv", "--out", "both.csv"]) == 0
    assert "sweeps of first.csv, which are written as well" in capsys.readouterr().out
    first, both = scan3d.read_recording("first.csv"), scan3d.read_recording("both.csv")
    count = len(np.unique(first.sweep))
    assert len(np.unique(both.sweep)) == 2 * count
    assert (both.sweep[len(first) :] == first.sweep + count).all()
    assert (both.force_N == np.concatenate([first.force_N, first.force_N])).all()
    assert main([*run, "--after", "first.csv", "--out", "first.csv"]) == 1
    assert "TOML file of the recording before that this run reads" in capsys.readouterr().err
    text = (place / "first.toml").read_text()
    (place / "first.toml").write_text(text.replace("length_m = ", "length_m = 1", 1))
    assert main([*run, "--after", "first.csv", "--out", "other.csv"]) == 1
    assert "another rod than those before" in capsys.readouterr().err


def test_files_of_others_and_the_input_are_not_replaced(place, capsys):
    (place / "other.csv").write_text("mine")
    for out, more, sentence in (
        ("other.csv", [], "other.csv can't be recognised as"),
        ("raw.csv", ["--overwrite"], "raw.csv is the table that this run reads"),
        ("rig.csv", ["--overwrite"], "rig.toml is the map that"),
    ):
        assert main(["import", "raw.csv", "--map", "rig.toml", "--out", out, *more]) == 1
        assert sentence in capsys.readouterr().err


@pytest.mark.slow
def test_a_dry_run_shows_rows_and_writes_a_picture_only(place, capsys):
    assert main(["import", "raw.csv", "--map", "rig.toml", "--dry-run"]) == 0
    printed = capsys.readouterr().out
    assert sorted(path.name for path in place.iterdir()) == ["raw.csv", "raw.png", "rig.toml"]
    lines = printed.splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith("sweep,x_m,"))
    assert len(lines) - start == 7
    with Image.open(place / "raw.png") as image:
        assert image.size == (2000, 1000)
    drawn = (place / "raw.png").read_bytes()
    assert (
        main(["import", "raw.csv", "--map", "rig.toml", "--dry-run", "--quiet"]) == 0
    )  # a picture of ours is replaced
    assert (place / "raw.png").read_bytes() == drawn


def test_the_picture_of_an_import_shades_the_rows_of_sweeps(place):
    chosen = read_map("rig.toml")
    found = convert(load("raw.csv", chosen), chosen)
    clock = found.clock - found.clock[0]
    for shade in import_figure(found).axes[1].collections:
        for path in shade.get_paths():
            low, high = path.vertices[:, 0].min(), path.vertices[:, 0].max()
            assert (found.sweep[(clock >= low) & (clock <= high)] >= 0).all()


@pytest.mark.slow
def test_a_first_map_is_written_and_completed(place, recording, capsys):
    columns = table(track(recording), RIG)
    units = dict(t="t_s", x="TCP X [mm]", y="TCP Y [mm]", z="TCP Z [mm]", a="Roll", b="Pitch", c="Yaw")
    units |= {f"F{k}": f"F{k} (N)" for k in "xyz"} | {f"T{k}": f"T{k} (N mm)" for k in "xyz"}
    write(place / "robot.csv", {units[name]: column for name, column in columns.items()}, ";", ",")
    assert main(["import", "robot.csv", "--guess"]) == 0
    printed = capsys.readouterr().out
    assert "written to robot.map.toml" in printed
    assert "unit of force" not in printed
    text = (place / "robot.map.toml").read_text()
    data = tomllib.loads(text)
    assert data["table"] == {"decimal": ",", "delimiter": ";"}
    assert data["columns"]["position"] == ["TCP X [mm]", "TCP Y [mm]", "TCP Z [mm]"]
    assert data["units"] == {"time": "s", "length": "mm", "angle": "deg", "force": "N", "moment": "N mm"}
    with pytest.raises(InputError, match=r"robot\.map\.toml: a first map leaves open \[rod\] length_m, \[rod\] bend"):
        scan3d.import_table("robot.csv", "robot.map.toml")
    assert main(["import", "robot.csv", "--guess"]) == 1
    assert "robot.map.toml exists already; give --overwrite" in capsys.readouterr().err
    complete = data | {key: map_of(recording.rod, RIG)[key] for key in ("sensor", "rod")}
    found, known = scan3d.import_table("robot.csv", complete), scan3d.import_table("raw.csv", "rig.toml")
    assert found.force_N.tobytes() == known.force_N.tobytes()


def xyz(before, after=""):
    return [f"{before}{axis}{after}" for axis in "xyz"]


def tcp(kind, numbers=range(6)):
    return [f"actual_TCP_{kind}_{k}" for k in numbers]


def franka(name, *numbers):
    return [f"state.{name}[{k}]" for k in numbers]


PLACE, TURN, WRENCH = "field.pose.position.", "field.pose.orientation.", "field.wrench."
MATRIX = (0, 4, 8, 1, 5, 9, 2, 6, 10)
ROBOTS = {
    "of no robot": (
        ["time", *xyz("p"), *xyz("r"), *xyz("f"), *xyz("m")],
        {"orientation": {"rotvec": xyz("r")}, "moment": xyz("m"), "time": "time"},
        {"unit of moment", "sensor", "rod"},
    ),
    "with units": (
        ["timestamp", "sweep", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz", "force_x_N", "force_y_N", "torque_z_Nm", "move"],
        {"force": ["force_x_N", "force_y_N"], "moment": ["torque_z_Nm"], "sweep": "sweep", "move": "move"},
        {"sensor"},
    ),
    "without names": ([*"abcdefghijklm"], {"force": xyz("(force ", ")")}, {"position", "force", "moment"}),
    "rostopic echo -p": (
        ["%time", "field.header.seq", *xyz(PLACE), *xyz(TURN), f"{TURN}w", *xyz(f"{WRENCH}force."), *xyz(f"{WRENCH}torque.")],
        {"time": "%time", "position": xyz(PLACE), "orientation": {"quaternion": [f"{TURN}w", *xyz(TURN)]},
         "force": xyz(f"{WRENCH}force."), "moment": xyz(f"{WRENCH}torque.")},
        {"unit of time"},
    ),
    "the recorder of Universal Robots": (
        ["timestamp", *tcp("pose"), *tcp("speed"), *tcp("force")],
        {"position": tcp("pose", range(3)), "orientation": {"rotvec": tcp("pose", range(3, 6))},
         "force": tcp("force", range(3)), "moment": tcp("force", range(3, 6)), "wrench_in": "world"},
        {"sensor"},
    ),
    "libfranka": (
        ["time", *franka("O_T_EE", *range(16)), *franka("O_F_ext_hat_K", *range(6)), *franka("K_F_ext_hat_K", *range(6))],
        {"position": franka("O_T_EE", 12, 13, 14), "orientation": {"matrix": franka("O_T_EE", *MATRIX)},
         "force": franka("K_F_ext_hat_K", 0, 1, 2), "moment": franka("K_F_ext_hat_K", 3, 4, 5)},
        {"sensor"},
    ),
    "arrays written column by column": (
        [f"{name}_{k}" for name in ("position", "orientation", "force", "torque") for k in range(3 + (name == "orientation"))],
        {"position": [f"position_{k}" for k in range(3)], "force": [f"force_{k}" for k in range(3)],
         "orientation": {"quaternion": [f"orientation_{k}" for k in range(4)], "order": "xyzw"},
         "moment": [f"torque_{k}" for k in range(3)]},
        {"order of the quaternion"},
    ),
    "ATI": (
        ["Status (hex)", "RDT Sequence", "F/T Sequence", *xyz("F", " (N)"), *xyz("T", " (N-m)"), "Time"],
        {"force": xyz("F", " (N)"), "moment": xyz("T", " (N-m)"), "time": "Time"},
        {"position"},
    ),
    "a moment without y": ([*xyz("F"), "Tx", "Tz"], {"moment": ["Tx", "(moment y)", "Tz"]}, {"moment"}),
    "of a plane": (["Fx", "Fy", "Tz"], {"force": ["Fx", "Fy"], "moment": ["Tz"]}, {"position"}),
}  # fmt: skip


@pytest.mark.parametrize(("names", "entries", "left"), ROBOTS.values(), ids=ROBOTS)
def test_names_of_columns_that_robots_use(tmp_path, names, entries, left):
    (tmp_path / "log.csv").write_text(f"{','.join(names)}\n" + f"{','.join(['0.5'] * len(names))}\n" * 3)
    found = guess_map(tmp_path / "log.csv")
    columns = tomllib.loads(found.text)["columns"]
    assert {name: columns[name] for name in entries} == entries
    assert left <= set(found.open)


@pytest.mark.parametrize(
    ("step", "start", "unit"), [(0.01, 0, "s"), (10, 1e3, "ms"), (1e4, 1e6, "us"), (1e7, 1e9, "ns")]
)
def test_times_state_their_unit_by_their_size(tmp_path, step, start, unit):
    """From zero, and since 1970; milliseconds from zero may be seconds of a slow log."""
    for begin in (1.76e9 * (start or 1), *([0] if unit != "ms" else [])):
        (tmp_path / "log.csv").write_text("time,x\n" + "".join(f"{begin + step * k:.2f},0\n" for k in range(200)))
        assert tomllib.loads(guess_map(tmp_path / "log.csv").text)["units"]["time"] == unit


def test_titles_and_units_are_found_by_the_guess(tmp_path):
    (tmp_path / "log.csv").write_text("A title\n\nt\tx\ty\ns\tmm\tmm\n" + "0,5\t1,5\t2,5\n" * 4)
    data = tomllib.loads(guess_map(tmp_path / "log.csv").text)
    assert data["table"] == {"decimal": ",", "delimiter": "\t", "units_row": True, "header": 3}
    (tmp_path / "log.csv").write_text("time_s,Fx_N\n" + "0.5,1.5,\n" * 4)
    assert tomllib.loads(guess_map(tmp_path / "log.csv").text)["columns"]["time"] == "time_s"


def test_parquet_files_that_can_not_be_read(tmp_path, recording, monkeypatch):
    (tmp_path / "log.parquet").write_bytes(b"no such thing")
    (tmp_path / "log.toml").write_text("[rod]\nlength_m = 0.05\nbending_stiffness_Nm2 = 1e-4\n")
    with pytest.raises(InputError, match=r"can't read log\.parquet as a file of Parquet's format"):
        scan3d.read_recording(tmp_path / "log.parquet")
    columns = {name: np.zeros(2) for name in scan3d.files.recordings.COLUMNS} | {"qw": np.array(["a", "b"])}
    (tmp_path / "log.parquet").write_bytes(parquet_bytes(columns))
    with pytest.raises(InputError, match=r"log.parquet: row 1 has 'a' in column 'qw', which is no number"):
        scan3d.read_recording(tmp_path / "log.parquet")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    for call in (
        lambda: scan3d.read_recording(tmp_path / "log.parquet"),
        lambda: scan3d.write_recording(recording, tmp_path / "new.parquet"),
        lambda: scan3d.import_table(tmp_path / "log.parquet", map_of(recording.rod, RIG)),
    ):
        with pytest.raises(InputError, match=r"Parquet files need pyarrow: pip install 'scan3d\[parquet\]'"):
            call()


@pytest.mark.parametrize(
    "words",
    [
        "import raw.csv --guess",
        "import raw.bag --guess",
        "import raw.bag --map {map} --out r.csv",
        "import raw.mat --guess",
        "reconstruct raw.csv --out r",
    ],
)
def test_pipes_are_refused(tmp_path, words, capsys):
    (tmp_path / "map.toml").write_text("[rod]\nlength_m = 0.1\nbending_stiffness_Nm2 = 1e-4\n[ros]\npose = '/a'\n")
    for name in ("raw.csv", "raw.bag", "raw.mat"):
        os.mkfifo(tmp_path / name)
    command, raw, *rest = words.format(map=tmp_path / "map.toml").split()
    signal.alarm(20)  # ends the tests, instead of waiting without end
    try:
        assert main([command, str(tmp_path / raw), *rest]) == 1
    finally:
        signal.alarm(0)
    assert f"{raw} is a device or a pipe, where a file is expected" in capsys.readouterr().err
