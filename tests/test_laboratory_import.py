"""Tables of a rig, made from simulated recordings by the inverse of the import, come back as these recordings."""

import numpy as np
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from raw_tables import Rig, disturbed, map_of, sensed, table, track, write
from scipy.spatial.transform import Rotation
from small_scans import EGG

import scan3d
from scan3d import InputError
from scan3d.files.columns import parquet_bytes
from scan3d.laboratory import signals
from scan3d.laboratory.importing import convert, load
from scan3d.laboratory.maps import guess_map, read_map
from scan3d.laboratory.signals import robust_sd
from scan3d.recording import of_rows
from tests.rig_errors import six_axis

pytestmark = pytest.mark.slow

EXACT = Rig()
RIG_WITH_NOISE = Rig(noise=0.002)


@pytest.fixture(scope="module")
def planar():
    return scan3d.simulate(scan3d.load_mesh(EGG), scan3d.Plan(slices=2, sweeps=3, samples=24))


@pytest.fixture(scope="module")
def longer():
    return scan3d.simulate(scan3d.load_mesh(EGG), scan3d.Plan(slices=3, sweeps=3, samples=32))


@pytest.fixture(scope="module")
def spatial():
    return scan3d.simulate(scan3d.load_mesh(EGG), scan3d.Plan(slices=4, model="spatial", sweeps=4, samples=24))


@pytest.fixture(params=["planar", "spatial"])
def recording(request):
    return request.getfixturevalue(request.param)


def imported(path, columns, data, **keywords):
    """By a table of text where its form is given, else of numbers, which is written and read in a tenth of the time."""
    if keywords:
        write(path, columns, **keywords)
    else:
        path = path.with_suffix(".parquet")
        path.write_bytes(parquet_bytes(columns))
    chosen = read_map(data)
    return convert(load(path, chosen), chosen)


def tabled(recording, rig=EXACT):
    """The continuous log of a recording, its table as a rig writes it, and the map of that."""
    log = track(recording)
    return log, table(log, rig), map_of(recording.rod, rig)


@pytest.fixture(scope="module")
def plain(tmp_path_factory, planar):
    """What is imported of the planar recording without noise."""
    return imported(tmp_path_factory.mktemp("plain") / "raw.csv", *tabled(planar)[1:])


def six(recording):
    """(n, 6) reactions, zeros where they were not measured."""
    return np.hstack(six_axis(recording).wrench())


def same_rows(log, found):
    """Rows of both recordings that belong to each other; all rows of the sweeps must have come back, and no others."""
    assert np.array_equal(found.log.row[found.kept], np.flatnonzero(log.row >= 0))
    return log.row[log.row >= 0]


def test_a_wrench_of_the_wrong_sign_is_noted(tmp_path, recording):
    turned = Rig(shows="rod-on-clamp")
    log, right, wrong = track(recording, air=60), map_of(recording.rod, EXACT), map_of(recording.rod, turned)
    columns = table(log, EXACT)
    assert not imported(tmp_path / "a.csv", columns, right).summary.notes
    assert "would pull the rod on (fx above 0)" in " ".join(imported(tmp_path / "b.csv", columns, wrong).summary.notes)


def test_without_noise_the_recording_comes_back_to_rounding(tmp_path, recording):
    log = track(recording, air=60)
    found = imported(tmp_path / "raw.csv", table(log, EXACT), map_of(recording.rod, EXACT))
    assert found.summary.notes == ()  # though retracts hold contacts as well
    rows = same_rows(log, found)
    back = found.recording
    assert back.position_m == pytest.approx(recording.position_m[rows], abs=1e-15)
    assert np.abs(back.axes() - recording.axes()[rows]).max() < 1e-14
    truth = six(recording)[rows]
    largest = np.repeat([np.abs(part).max() for part in np.split(six(recording), 2, axis=1)], 3)
    # the bias is 5 % of the largest reaction, and the wrench is turned and moved: some thousand times its last place
    assert np.abs(six(back) - truth).max(axis=0) / largest == pytest.approx(np.zeros(6), abs=1e-12)
    assert (np.diff(back.sweep) > 0).sum() == (np.diff(recording.sweep) != 0).sum()
    assert (back.noise_force_N, back.noise_moment_Nm) == (0.0, 0.0)
    assert not (found.air & log.wrench.any(axis=1)).any()


def test_with_noise_the_contacts_come_back_within_what_is_stated(tmp_path, recording):
    # of the largest force, which in space is that of a single steep contact
    rig = Rig(noise=0.0002 if recording.six_axis else 0.002)
    log = track(recording)
    found = imported(tmp_path / "raw.csv", table(log, rig), map_of(recording.rod, rig))
    rows = same_rows(log, found)
    _, noise = disturbed(sensed(log.wrench, rig), rig)
    assert found.recording.noise_force_N == pytest.approx(noise[0], rel=0.05)
    # moments have the noise of the sensor's moments, and of its forces times the arm of 20 mm
    moment = np.hypot(noise[3], 0.02 * noise[0])
    assert found.recording.noise_moment_Nm == pytest.approx(moment, rel=0.05)
    error = (six(found.recording) - six(recording)[rows]) / np.repeat([noise[0], moment], 3)
    assert np.sqrt((error**2).mean(axis=0)).max() < 1.1
    assert np.abs(error.mean(axis=0)).max() < 0.2  # the zero
    if not recording.six_axis:
        cloud, truth = (scan3d.reconstruct(one, model="planar") for one in (found.recording, recording))
        _, here, there = np.intersect1d(rows[cloud.row], truth.row, return_indices=True)
        distance = np.linalg.norm(cloud.points[here] - truth.points[there], axis=1)
        assert np.percentile(distance / cloud.place_sd[here], 95) < 2.6  # of two directions: 2.45


SOME = st.floats(-1, 1, allow_nan=False)
UNITS = {
    "time": {"s": 1, "ms": 1e-3, "us": 1e-6}, "length": {"m": 1, "mm": 1e-3, "in": 0.0254},
    "angle": {"deg": np.pi / 180, "rad": 1}, "force": {"N": 1, "mN": 1e-3},
    "moment": {"N m": 1, "N mm": 1e-3, "mN mm": 1e-6},
}  # fmt: skip


@given(
    turn=st.tuples(SOME, SOME, SOME), arm=st.tuples(SOME, SOME, SOME), clamp=st.tuples(SOME, SOME, SOME),
    clamp_arm=st.tuples(SOME, SOME, SOME), shows=st.sampled_from(["clamp-on-rod", "rod-on-clamp"]),
    kind=st.sampled_from(["wxyz", "xyzw", "rotvec", "matrix", "xyz", "ZYX", "zyz", "YXZ"]),
    units=st.fixed_dictionaries({name: st.sampled_from(list(known)) for name, known in UNITS.items()}),
    sign=st.tuples(*[st.sampled_from([1, -1])] * 3), bias=SOME, delimiter=st.sampled_from([",", ";", "\t", " "]),
)  # fmt: skip
@pytest.mark.filterwarnings("ignore:Gimbal lock")  # at the poles of Euler angles
@settings(max_examples=8, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_map_and_its_inverse(
    tmp_path, planar, turn, arm, clamp, clamp_arm, shows, kind, units, sign, bias, delimiter
):
    log = track(planar)
    rig = Rig(tuple(180 * a for a in turn), tuple(50 * a for a in arm), shows, bias, 0.0)
    values, _ = disturbed(sensed(log.wrench, rig), rig)
    time, length, angle, force, moment = (UNITS[name][units[name]] for name in UNITS)
    # the logged frame is that in which the clamp stands as [clamp] says
    inner, shift = Rotation.from_euler("xyz", [120 * a for a in clamp], degrees=True), 0.1 * np.array(clamp_arm)
    logged = Rotation.from_quat(log.quaternion, scalar_first=True) * inner.inv()
    place = log.position - logged.apply(shift)
    names = ["q1", "q2", "q3", "q4"] if len(kind) == 4 else ["q1", "q2", "q3"]
    if len(kind) == 4:
        turned, orientation = logged.as_quat(scalar_first=kind == "wxyz"), {"quaternion": names, "order": kind}
    elif kind == "matrix":
        names = [f"r{k}" for k in range(9)]
        turned, orientation = logged.as_matrix().reshape(-1, 9), {"matrix": names}
    elif kind == "rotvec":
        turned, orientation = logged.as_rotvec() / angle, {"rotvec": names}
    else:
        turned, orientation = logged.as_euler(kind) / angle, {"euler": names, "convention": kind}
    columns = {"t": log.time / time, **dict(zip("xyz", (place / length * sign).T, strict=True))}
    columns |= dict(zip(names, turned.T, strict=True))
    columns |= dict(zip(["Fx", "Fy", "Fz", "Tx", "Ty", "Tz"], (values / np.repeat([force, moment], 3)).T, strict=True))
    data = map_of(planar.rod, rig)
    data["columns"]["orientation"] = orientation
    data["columns"]["position"] = [("-" if s < 0 else "") + n for n, s in zip("xyz", sign, strict=True)]
    data["units"] = units
    data["clamp"] = {"position_mm": (1e3 * shift).tolist(), "euler_deg": [120 * a for a in clamp]}
    found = imported(tmp_path / "raw.csv", columns, data, delimiter=delimiter)
    rows = same_rows(log, found)
    assert np.abs(found.recording.position_m - planar.position_m[rows]).max() < 1e-12
    assert np.abs(found.recording.axes() - planar.axes()[rows]).max() < 1e-7  # Euler angles near their poles
    truth = six(planar)[rows]
    for part in (slice(0, 3), slice(3, 6)):
        assert np.abs(six(found.recording) - truth)[:, part].max() < 1e-11 * np.abs(truth[:, part]).max()


def write_sheet(path, columns):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    for row in (["A title"], [], list(columns), *zip(*(column.tolist() for column in columns.values()), strict=True)):
        book.active.append(row)
    book.save(path)


def write_hdf5(path, columns):
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        for name, column in columns.items():
            file[f"run/{name}"] = column
        file["run/rate"] = 100.0
        file["other/ones"] = np.ones(7)


def write_arrays(path, columns):
    """Position and wrench as matrices, the others as vectors, beside an array of another length."""
    parts = {"p": np.stack([columns[n] for n in "xyz"], axis=1), "w": np.stack([*columns.values()][-6:], axis=1)}
    parts |= {name: columns[name] for name in "tabc"} | {"about": np.ones((3, 2, 1)), "short": np.arange(4.0)}
    if path.suffix == ".npz":
        np.savez(path, **parts)
    else:
        scipy.io.savemat(path, {"log": parts})


FILES_OF_ARRAYS = {
    "raw.parquet": (lambda path, columns: path.write_bytes(parquet_bytes(columns)), {}),
    "raw.xlsx": (write_sheet, {}),
    "raw.h5": (write_hdf5, dict.fromkeys("xyzabct", "run/{}") | {f"{v}{k}": "run/{}" for v in "FT" for k in "xyz"}),
    **{
        name: (
            write_arrays,
            {axis: f"{prefix}p_{k}" for k, axis in enumerate("xyz")}
            | {f"{'FT'[k // 3]}{'xyz'[k % 3]}": f"{prefix}w_{k}" for k in range(6)}
            | dict.fromkeys("abct", prefix + "{}"),
        )
        for name, prefix in (("raw.npz", ""), ("raw.mat", "log."))
    },
    "raw.npy": (
        lambda path, columns: np.save(path, np.stack([*columns.values()], axis=1)),
        {name: k for k, name in enumerate(["t", *"xyzabc", "Fx", "Fy", "Fz", "Tx", "Ty", "Tz"], 1)},
    ),
}


@pytest.mark.parametrize("file", FILES_OF_ARRAYS)
def test_files_of_arrays_give_the_same_recording(tmp_path, planar, plain, file):
    _, columns, data = tabled(planar)
    writer, renamed = FILES_OF_ARRAYS[file]
    writer(tmp_path / file, columns)

    def named(value):
        new = renamed.get(value, value)
        return new.format(value) if isinstance(new, str) else new

    for entry, value in data["columns"].items():
        if entry == "orientation":
            value["euler"] = [named(name) for name in value["euler"]]
        else:
            data["columns"][entry] = named(value) if isinstance(value, str) else [named(name) for name in value]
    data["table"] = {"header": 3} if file == "raw.xlsx" else {}
    other = scan3d.import_table(tmp_path / file, data)
    assert other.position_m == pytest.approx(plain.recording.position_m, abs=1e-12)
    assert other.force_N == pytest.approx(plain.recording.force_N, abs=1e-12)
    if file != "raw.npy":  # without names
        assert "columns" not in guess_map(tmp_path / file).open
    for data_in_it, why in ((b"PK\x03\x04 no such file", "can't read raw"), (b"", "can't read raw")):
        (tmp_path / file).write_bytes(data_in_it)
        with pytest.raises(InputError, match=why):
            scan3d.import_table(tmp_path / file, data)


@pytest.mark.parametrize("rows", [6, 3])
def test_signals_of_a_transducer(tmp_path, planar, plain, rows):
    """Bridges whose volts a matrix makes force and moment of."""
    random, rig = np.random.default_rng(3), EXACT if rows == 6 else Rig((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    _, columns, data = tabled(planar, rig)
    expected = plain if rig is EXACT else imported(tmp_path / "raw.csv", columns, data)
    wanted = ["Fx", "Fy", "Fz", "Tx", "Ty", "Tz"] if rows == 6 else ["Fx", "Fy", "Tz"]
    matrix, offset = random.normal(size=(rows, rows)), random.normal(size=rows)
    values = np.stack([columns[name] for name in wanted], axis=1)
    volts = np.linalg.solve(matrix, values.T).T + offset
    rest = {name: column for name, column in columns.items() if name[0] not in "FT"}
    data["columns"] = {k: v for k, v in data["columns"].items() if k not in ("force", "moment")}
    data["columns"]["signals"] = [f"ch{k}" for k in range(rows)]
    data["sensor"] |= {"matrix": matrix.tolist(), "offset": offset.tolist()}
    columns = rest | {f"ch{k}": column for k, column in enumerate(volts.T)}
    found = imported(tmp_path / "volts.csv", columns, data)
    assert found.recording.six_axis == (rows == 6)
    known = found.log.present
    assert found.log.wrench[:, known] == pytest.approx(expected.log.wrench[:, known], abs=1e-12)
    assert found.recording.force_N == pytest.approx(expected.recording.force_N, abs=1e-12)
    # steps of the converter are those of the volts, and no grid of the wrench
    steps = np.ptp(volts, axis=0) / 100
    coarse = imported(
        tmp_path / "coarse.csv",
        columns | dict(zip(data["columns"]["signals"], (np.round(volts / steps) * steps).T, strict=True)),
        data,
    )
    assert not coarse.recording.noise_independent
    if rows == 3:
        force, moment = np.split(np.sqrt(matrix**2 @ steps**2 / 12), [2])
        assert coarse.recording.noise.force_N >= 0.99 * force.max()
        assert coarse.recording.noise.moment_Nm >= 0.99e-3 * moment[0]
    change = {"matrix": matrix[:2].tolist()}
    with pytest.raises(InputError, match=r"\[sensor\] matrix must have a row for each of fx, fy, fz"):
        imported(tmp_path / "volts.csv", columns, data | {"sensor": data["sensor"] | change})


def test_arrays_that_nobody_named_and_arrays_with_a_row_for_each_channel(tmp_path, planar, plain):
    """As of cameras that log beside the rod, and as MATLAB lays out."""
    _, columns, data = tabled(planar)
    cameras = {f"camera{k}": np.arange(50.0) for k in range(40)}
    places = {
        key: np.stack([columns.pop(name) for name in names])
        for key, names in (("p", "xyz"), ("w", ["Fx", "Fy", "Fz", "Tx", "Ty", "Tz"]))
    }
    np.savez(tmp_path / "raw.npz", **columns, **places, **cameras)
    w = [f"w_{k}" for k in range(6)]
    data["columns"] |= {"position": [f"p_{k}" for k in range(3)], "force": w[:3], "moment": w[3:]}
    chosen = read_map(data)
    found = convert(load(tmp_path / "raw.npz", chosen), chosen).recording
    assert np.array_equal(found.position_m, plain.recording.position_m)
    assert np.array_equal(found.moment_Nm, plain.recording.moment_Nm)


NUMBERED = {
    "from 0 in each slice again": lambda sweep: np.where(sweep >= 0, sweep % 3, -1),
    "by slices": lambda sweep: np.where(sweep >= 0, sweep // 3, -1),
    "0 between": lambda sweep: sweep + 1,
    "until the next one": lambda sweep: np.maximum.accumulate(sweep),
}


@pytest.mark.parametrize("kind", NUMBERED)
def test_numbers_that_come_again_or_stay_are_those_of_strokes(tmp_path, planar, kind):
    log, columns, data = tabled(planar)
    number = NUMBERED[kind](np.where(log.row >= 0, planar.sweep[log.row], -1))
    data["columns"]["sweep"] = "n"
    found = imported(tmp_path / "raw.csv", columns | {"n": number}, data)
    assert found.summary.sweeps == len(np.unique(planar.sweep))
    said = any("sweeps are those of the clamp's motion" in note for note in found.summary.notes)
    assert said == (kind == "until the next one")


@pytest.mark.parametrize("given", ["sweep", "move", "both"])
def test_columns_of_sweeps_and_moves_are_used_where_they_are(tmp_path, planar, given):
    log, columns, data = tabled(planar)
    if given in ("sweep", "both"):
        columns["n"] = np.where(log.row >= 0, planar.sweep[log.row], -1) if given == "sweep" else planar.sweep[log.row]
        data["columns"]["sweep"] = "n"
    if given in ("move", "both"):
        columns["what"] = log.move
        data["columns"]["move"] = "what"
    found = imported(tmp_path / "raw.csv", columns, data)
    rows = same_rows(log, found)
    if given != "move":
        assert np.array_equal(found.recording.sweep, planar.sweep[rows])
    assert np.abs(six(found.recording) - six(planar)[rows]).max() < 1e-12


def test_strokes_back_count_on_request(tmp_path, planar):
    log = track(planar)
    turned = log._replace(
        position=log.position[::-1], quaternion=log.quaternion[::-1], wrench=log.wrench[::-1], row=log.row[::-1]
    )
    columns, data = table(turned, EXACT), map_of(planar.rod, EXACT)
    with pytest.raises(InputError, match=r'mostly along \+x of its own frame.*directions = "both" under \[sweeps\]'):
        imported(tmp_path / "raw.csv", columns, data)
    found = imported(tmp_path / "raw.csv", columns, data | {"sweeps": {"directions": "both"}})
    bent = data | {"sweeps": {"directions": "both"}, "rod": data["rod"] | {"curvature_per_m": 0.2}}
    with pytest.raises(InputError, match=r"is curved, and curves the other way.*import the two directions apart"):
        imported(tmp_path / "raw.csv", columns, bent)
    rows = same_rows(turned, found)
    # the frame is turned by half a turn about the rod: x and z change their signs
    signs = np.tile([-1.0, 1.0, -1.0], 2)
    assert np.abs(six(found.recording) - six(planar)[rows] * signs).max() < 1e-12
    assert found.recording.axes()[:, 1] == pytest.approx(planar.axes()[rows][:, 1], abs=1e-14)
    assert found.recording.axes()[:, 0] == pytest.approx(-planar.axes()[rows][:, 0], abs=1e-14)


def test_stretches_in_the_air_can_be_given(tmp_path, longer):
    log = track(longer)
    free = np.flatnonzero(~log.wrench.any(axis=1))
    runs = np.split(free, np.flatnonzero(np.diff(free) > 1) + 1)
    air = [[float(log.time[run[0]]), float(log.time[run[-1]])] for run in [*runs[:-1:9], runs[-1]]]
    data = map_of(longer.rod, EXACT, tare={"air": air})
    found = imported(tmp_path / "raw.csv", table(log, EXACT), data)
    rows = same_rows(log, found)
    assert found.summary.air == tuple(map(tuple, air))
    assert np.abs(six(found.recording) - six(longer)[rows]).max() < 1e-12


def test_rows_that_stand_twice_count_once(tmp_path, planar, plain):
    log, columns, data = tabled(planar)
    twice = imported(tmp_path / "twice.csv", {name: np.repeat(column, 2) for name, column in columns.items()}, data)
    assert np.array_equal(six(twice.recording), six(plain.recording))
    assert twice.summary.rate_hz == pytest.approx(plain.summary.rate_hz)
    assert twice.summary.left_out["repeated"] == len(log.row)
    assert f"{len(log.row):,} rows stand twice" in twice.summary.notes[0]


def test_a_tared_table_without_time_is_taken_as_it_is(tmp_path, planar):
    rig = Rig((0, 0, 0), (0, 0, 0), bias=0.0, drift=0.0)
    log = track(planar)
    columns = table(log, rig)
    data = map_of(planar.rod, rig, tare={"air": "none"}, noise={"force_N": 1e-6, "moment_Nm": 1e-9})
    del columns["t"], data["columns"]["time"]
    found = imported(tmp_path / "raw.csv", columns, data)
    rows = same_rows(log, found)
    assert np.array_equal(found.recording.force_N, planar.force_N[rows])
    assert (found.recording.noise_force_N, found.recording.noise_moment_Nm) == (1e-6, 1e-9)


@pytest.mark.parametrize("channels", [3, 4, 5])
def test_sensors_with_fewer_channels_give_planar_recordings(tmp_path, planar, channels):
    rig = Rig((0.0, 0.0, 25.0), (4.0, -20.0, 3.0))
    log, columns, data = tabled(planar, rig)
    data["columns"]["force"] = ["Fx", "Fy", "Fz"] if channels == 4 else ["Fx", "Fy"]
    data["columns"]["moment"] = ["Tx", "Ty", "Tz"] if channels == 5 else ["Tz"]
    found = imported(tmp_path / "raw.csv", columns, data)
    rows = same_rows(log, found)
    assert not found.recording.six_axis
    assert np.abs(found.recording.force_N - planar.force_N[rows]).max() < 1e-12
    assert np.abs(found.recording.moment_Nm - planar.moment_Nm[rows]).max() < 1e-13
    assert ("fz are left out" in " ".join(found.summary.notes)) == (channels == 4)


def with_columns(data, **entries):
    return data | {"columns": data["columns"] | entries}


@pytest.mark.parametrize("rig", [EXACT, Rig((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), noise=0.002)])
def test_a_wrench_in_the_frame_of_the_poses_is_turned_back_and_is_noted_where_the_map_says_otherwise(
    tmp_path, planar, rig
):
    log, columns, data = tabled(planar, rig)
    to_world = Rotation.from_quat(log.quaternion, scalar_first=True) * Rotation.from_euler("xyz", rig.turn_deg, True)
    turned = dict(columns)
    for names in (["Fx", "Fy", "Fz"], ["Tx", "Ty", "Tz"]):
        parts = to_world.apply(np.stack([columns[name] for name in names], axis=1))
        turned |= dict(zip(names, parts.T, strict=True))
    in_world = with_columns(data, wrench_in="world")
    right, same = imported(tmp_path / "a.csv", columns, data), imported(tmp_path / "b.csv", turned, in_world)
    assert not any("wrench_in" in note for found in (right, same) for note in found.summary.notes)
    assert six(same.recording) == pytest.approx(six(right.recording), abs=1e-12)
    for rows, wrong, frame in ((turned, data, "world"), (columns, in_world, "sensor")):
        try:
            said = imported(tmp_path / "c.csv", rows, wrong).summary.notes[0]
        except InputError as error:  # a zero that turns with the clamp may leave no rows in the air
            said = str(error)
        assert f'check wrench_in = "{frame}" under [columns]' in said


def test_a_wrench_that_is_stamped_late_is_put_beside_its_pose(tmp_path, planar, plain):
    (_, columns, data), late = tabled(planar), 7
    shifted = {name: np.roll(one, late) if name[0] in "FT" else one for name, one in columns.items()}
    found = imported(tmp_path / "b.csv", shifted, with_columns(data, wrench_delay_s=late / 1000))
    assert found.summary.left_out["without numbers"] == late
    rows = slice(len(found.recording))
    right = six(plain.recording)
    assert six(found.recording) == pytest.approx(right[rows], abs=1e-6 * np.abs(right).max())
    assert found.recording.position_m == pytest.approx(plain.recording.position_m[rows])
    data = with_columns(data, wrench_delay_s=0.1)
    del data["columns"]["time"]
    with pytest.raises(InputError, match="wrench_delay_s of the map needs the time of the rows"):
        imported(tmp_path / "raw.csv", columns, data)


@pytest.mark.parametrize(
    ("jitter_m", "step_m"), [(2e-5, 0.0), (0.0, 1e-5), pytest.param(2e-6, 5e-6, marks=pytest.mark.trust)]
)
def test_sweeps_are_found_under_jitter_and_in_steps(tmp_path, longer, jitter_m, step_m):
    """Slow motion, 20 µm of jitter, and an encoder of 10 µm: the sweeps are whole, but for some rows at their ends."""
    log, slower = track(longer), 12
    at = np.linspace(0, len(log.time) - 1, slower * len(log.time))
    index = np.arange(len(log.time))
    position = np.stack([np.interp(at, index, column) for column in log.position.T], axis=1)
    position += jitter_m * np.random.default_rng(2).standard_normal(position.shape)
    position = np.round(position / step_m) * step_m if step_m else position
    nearest = np.round(at).astype(int)
    long = log._replace(
        time=np.arange(len(at)) / 1000,
        position=position,
        wrench=np.stack([np.interp(at, index, column) for column in log.wrench.T], axis=1),
        quaternion=log.quaternion[nearest],
        row=log.row[nearest],
    )
    found = imported(tmp_path / "raw.csv", table(long, RIG_WITH_NOISE), map_of(longer.rod, RIG_WITH_NOISE))
    truth, mine = np.where(long.row >= 0, longer.sweep[long.row], -1), found.sweep
    assert found.summary.sweeps == len(np.unique(longer.sweep))
    for number, original in enumerate(dict.fromkeys(longer.sweep.tolist())):
        rows = truth == original
        # all of its rows but a few, and others within the 20 standard deviations over which the direction is determined
        assert (mine[rows] == number).mean() > 0.97
        assert (mine == number).sum() < rows.sum() + 200


def test_a_convention_with_which_some_sweeps_are_found_is_doubted(tmp_path, spatial):
    misread = Rotation.from_euler(
        "zyx", Rotation.from_quat(spatial.quaternion, scalar_first=True).as_euler("ZYX", degrees=True), degrees=True
    )
    _, first = np.unique(spatial.sweep, return_index=True)
    last = np.append(first[1:], len(spatial)) - 1
    along = misread[first].apply(spatial.position_m[last] - spatial.position_m[first], inverse=True)
    right = along[:, 0] < -0.99 * np.linalg.norm(along, axis=1)
    # as many sweeps that are found all the same as others
    numbers = np.arange(len(first))
    few = np.isin(spatial.sweep, [*numbers[right], *numbers[~right][: right.sum()]])
    columns = table(track(of_rows(spatial, few)), EXACT, euler="ZYX")
    assert imported(tmp_path / "log.csv", columns, map_of(spatial.rod, EXACT, euler="ZYX")).summary.notes == ()
    found = imported(tmp_path / "log.csv", columns, map_of(spatial.rod, EXACT, euler="zyx")).summary
    assert 2 <= found.sweeps <= right.sum()
    assert 'nearly all do if the convention is "ZYX": check [columns] orientation' in found.notes[0]


def test_a_log_in_which_nothing_is_touched_keeps_its_sweeps(tmp_path, planar):
    """A few rows of noise, of more than four standard deviations, are no contact."""
    log = track(planar)
    columns = table(log._replace(wrench=np.zeros_like(log.wrench)), EXACT)
    random = np.random.default_rng(0)
    for name in ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz"):
        columns[name] = 1e-4 * random.standard_normal(len(log.time))
    columns["Fx"][[300, 700, 1500]] = 5.5e-4
    found = imported(tmp_path / "log.csv", columns, map_of(planar.rod, EXACT))
    assert found.summary.sweeps == len(np.unique(planar.sweep))
    assert found.summary.sweeps_with_contact == 0


def test_filter_and_rate_state_the_noise_that_is_left(tmp_path, planar):
    (tmp_path / "long.parquet").write_bytes(parquet_bytes(table(track(planar, air=150), RIG_WITH_NOISE)))
    data = map_of(planar.rod, RIG_WITH_NOISE)
    full = scan3d.import_table(tmp_path / "long.parquet", data)
    data["filter"] = {"lowpass_hz": 100.0, "rate_hz": 250.0}
    raw = load(tmp_path / "long.parquet", read_map(data))
    found = convert(raw, read_map(data))
    assert found.recording.noise_force_N < 0.75 * full.noise_force_N
    # the rod snaps off within some rows of this log, which the filter blurs
    sharp = len(full) - found.summary.left_out["blurred by the filter"]
    assert 0 < sharp < len(full)
    assert found.summary.samples == pytest.approx(sharp / 4, rel=0.2)
    assert found.summary.left_out["thinned"] == sharp - found.summary.samples
    del data["columns"]["time"]
    with pytest.raises(InputError, match=r"\[filter\] needs the time of the rows"):
        convert(raw, read_map(data))


@pytest.mark.parametrize(("noise", "snap"), [(0.0, 10_000), (1e-2, 10_000), (1e-2, 20_000)])
def test_rows_next_to_a_snap_are_blurred_and_no_others(noise, snap):
    rate, limit, size = 1000.0, 20.0, np.array([1.0, 0.3, 0.1, 20, 5, 40])
    clock = np.arange(20_000) / rate
    exact = size * np.where(np.arange(len(clock)) < snap, np.sin(np.pi * clock / 20), 0.0)[:, None]
    values = exact + size * noise * np.random.default_rng(0).standard_normal(exact.shape)
    filtered = signals.low_pass(values, clock, limit, rate, "log")
    rows = np.flatnonzero(signals.blurred(values, filtered, clock, limit, rate, "log"))
    if snap == len(clock):
        assert not len(rows)
        return
    assert rows.min() < snap - 10
    assert rows.max() > snap + 10
    assert np.abs(rows - snap).max() < 3 * rate / limit
    # what is left is off by little more than the noise that the filter leaves
    kept = np.setdiff1d(np.arange(len(clock)), rows)
    assert (np.abs(filtered - exact)[kept] / size).max() < 2 * noise + 2e-4
    assert np.abs(filtered - exact).max() > 0.4 * 40


@pytest.mark.parametrize("step", [0.0, 0.5, 3.0])
def test_the_noise_is_estimated_with_outliers_and_steps(step):
    values = np.random.default_rng(1).standard_normal((4000, 1))
    values = np.round(values / step) * step if step else values
    values[::400] += 100
    rms = np.sqrt((values[np.abs(values) < 50] ** 2).mean())
    assert robust_sd(values)[0] == pytest.approx(np.hypot(1, step / np.sqrt(12)) if step < 2 else rms, rel=0.1)
