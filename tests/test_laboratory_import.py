"""Tables of a rig, made from simulated recordings by the inverse of the import, come back as these recordings."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from raw_tables import Rig, disturbed, map_of, sensed, table, track, write
from scipy.spatial.transform import Rotation

import scan3d
from scan3d import InputError
from scan3d.files.parquet import parquet_bytes
from scan3d.files.text import to_toml
from scan3d.laboratory.importing import convert, load
from scan3d.laboratory.maps import read_map
from scan3d.laboratory.tables import read_table

EGG = Path(__file__).parents[1] / "meshes" / "egg.stl"
EXACT = Rig()
RIG_WITH_NOISE = Rig(noise=0.002)


@pytest.fixture(scope="module")
def planar():
    return scan3d.simulate(scan3d.load_mesh(EGG), scan3d.Plan(slices=8))


@pytest.fixture(scope="module")
def spatial():
    return scan3d.simulate(scan3d.load_mesh(EGG), scan3d.Plan(slices=8, model="spatial", sweeps=5))


@pytest.fixture(scope="module")
def recordings(planar, spatial):
    return {"planar": planar, "spatial": spatial}


def imported(path, columns, data, **keywords):
    write(path, columns, **keywords)
    chosen = read_map(data)
    return convert(load(path, chosen), chosen)


def six(recording):
    """(n, 6) reactions, zeros where they were not measured."""
    if recording.six_axis:
        return np.concatenate(recording.wrench(), axis=1)
    zero = np.zeros((len(recording), 1))
    return np.concatenate([recording.force_N, zero, zero, zero, recording.moment_Nm[:, None]], axis=1)


def same_rows(log, found):
    """Rows of both recordings that belong to each other; all rows of the sweeps must have come back, and no others."""
    assert np.array_equal(found.log.row[found.kept], np.flatnonzero(log.row >= 0))
    return log.row[log.row >= 0]


@pytest.mark.parametrize("model", ["planar", "spatial"])
def test_without_noise_the_recording_comes_back_to_rounding(tmp_path, recordings, model):
    recording = recordings[model]
    log = track(recording)
    found = imported(tmp_path / "raw.csv", table(log, EXACT), map_of(recording.rod, EXACT))
    rows = same_rows(log, found)
    back = found.recording
    assert back.position_m == pytest.approx(recording.position_m[rows], abs=1e-15)
    assert np.abs(back.axes() - recording.axes()[rows]).max() < 1e-14
    truth, largest = (
        six(recording)[rows],
        np.repeat([np.abs(part).max() for part in np.split(six(recording), 2, axis=1)], 3),
    )
    # the bias is 5 % of the largest reaction, and the wrench is turned and moved: some thousand times its last place
    assert np.abs(six(back) - truth).max(axis=0) / largest == pytest.approx(np.zeros(6), abs=1e-12)
    assert (np.diff(back.sweep) > 0).sum() == (np.diff(recording.sweep) != 0).sum()
    assert (back.noise_force_N, back.noise_moment_Nm) == (0.0, 0.0)
    assert not (found.air & log.wrench.any(axis=1)).any()


@pytest.mark.parametrize("ending", ["\n", "\r\n", "\n\n"])
def test_no_rows_are_lost_where_a_reader_returns_fewer(tmp_path, monkeypatch, ending):
    arrow_csv = pytest.importorskip("pyarrow.csv")
    names = ("t", "x")
    path = tmp_path / "raw.csv"
    path.write_text(ending.join([",".join(names), *(f"{k / 8},{-k}" for k in range(100))]) + ending, newline="")

    def first_block(*arguments, read=arrow_csv.read_csv, **keywords):
        table = read(*arguments, **keywords)
        assert len(table) == 100
        return table.slice(0, 60)

    complete = read_table(path)
    monkeypatch.setattr(arrow_csv, "read_csv", first_block)
    for found in (complete, read_table(path)):
        np.testing.assert_array_equal(found.columns, [np.arange(100) / 8, -np.arange(100)])


@pytest.mark.slow
@pytest.mark.parametrize("model", ["planar", "spatial"])
def test_without_noise_the_contacts_come_back(tmp_path, recordings, model):
    recording = recordings[model]
    log = track(recording)
    found = imported(tmp_path / "raw.csv", table(log, EXACT), map_of(recording.rod, EXACT))
    cloud, truth = (scan3d.reconstruct(one, model=model) for one in (found.recording, recording))
    rows = same_rows(log, found)
    _, here, there = np.intersect1d(rows[cloud.row], truth.row, return_indices=True)
    assert len(here) > 0.999 * len(truth)
    # in space the surface lies half a diameter beside them, along normals from a fit to all contacts
    points, others = (one.points if model == "planar" else one.centre_points for one in (cloud, truth))
    distance = np.linalg.norm(points[here] - others[there], axis=1)
    # light touches have large errors for rounding of a few last places
    assert np.percentile(distance, 95) < 1e-7 * truth.rod_length
    assert distance.max() < 1e-3 * truth.rod_length


@pytest.mark.parametrize("model", ["planar", "spatial"])
def test_with_noise_the_contacts_come_back_within_what_is_stated(tmp_path, recordings, model):
    # of the largest force, which in space is that of a single steep contact
    recording, rig = recordings[model], Rig(noise=0.002 if model == "planar" else 0.0002)
    log = track(recording)
    found = imported(tmp_path / "raw.csv", table(log, rig), map_of(recording.rod, rig))
    rows = same_rows(log, found)
    _, noise = disturbed(sensed(log.wrench, rig), rig)
    assert found.recording.noise_force_N == pytest.approx(noise[0], rel=0.03)
    # moments have the noise of the sensor's moments, and of its forces times the arm of 20 mm
    assert found.recording.noise_moment_Nm == pytest.approx(np.hypot(noise[3], 0.02 * noise[0]), rel=0.03)
    error = (six(found.recording) - six(recording)[rows]) / np.repeat(
        [noise[0], np.hypot(noise[3], 0.02 * noise[0])], 3
    )
    assert np.sqrt((error**2).mean(axis=0)).max() < 1.1
    assert np.abs(error.mean(axis=0)).max() < 0.2  # the zero
    if model == "planar":
        cloud, truth = (scan3d.reconstruct(one, model="planar") for one in (found.recording, recording))
        _, here, there = np.intersect1d(rows[cloud.row], truth.row, return_indices=True)
        distance = np.linalg.norm(cloud.points[here] - truth.points[there], axis=1)
        assert np.percentile(distance / cloud.place_sd[here], 95) < 2.6  # of two directions: 2.45


@pytest.mark.slow
def test_the_reconstruction_of_an_imported_recording_is_the_egg(tmp_path, planar):
    from scan3d.cli import main

    log = track(planar)
    write(tmp_path / "raw.csv", table(log, EXACT))
    (tmp_path / "rig.toml").write_text(to_toml(map_of(planar.rod, EXACT)))
    rec = str(tmp_path / "log.csv")
    assert (
        main(["import", str(tmp_path / "raw.csv"), "--map", str(tmp_path / "rig.toml"), "--out", rec, "--quiet"]) == 0
    )
    out = tmp_path / "out"
    assert (
        main(["reconstruct", rec, "--model", "planar", "--out", str(out), "--truth", str(EGG), "--quiet", "--strict"])
        == 0
    )
    report = json.loads((out / "report.json").read_text())
    assert report["source"]["kind"] == "import"
    assert report["source"]["table"] == "raw.csv"
    direct = scan3d.compare(scan3d.surface(scan3d.reconstruct(planar)), scan3d.load_mesh(EGG))
    assert report["hausdorff"]["two_sided"] == pytest.approx(direct.hausdorff, rel=1e-3)


SOME = st.floats(-1, 1, allow_nan=False)
_RECORDING = {}


def small(mesh):
    if not _RECORDING:
        _RECORDING["one"] = scan3d.simulate(scan3d.load_mesh(mesh), scan3d.Plan(slices=3, sweeps=3, samples=24))
    return _RECORDING["one"]


@given(
    turn=st.tuples(SOME, SOME, SOME), arm=st.tuples(SOME, SOME, SOME), clamp=st.tuples(SOME, SOME, SOME),
    clamp_arm=st.tuples(SOME, SOME, SOME), shows=st.sampled_from(["clamp-on-rod", "rod-on-clamp"]),
    kind=st.sampled_from(["wxyz", "xyzw", "rotvec", "xyz", "ZYX", "zyz", "YXZ"]),
    units=st.tuples(*(st.sampled_from(names) for names in (
        ["s", "ms", "us"], ["m", "mm", "in"], ["deg", "rad"], ["N", "mN"], ["N m", "N mm", "mN mm"]))),
    sign=st.tuples(*[st.sampled_from([1, -1])] * 3), bias=SOME, delimiter=st.sampled_from([",", ";", "\t", " "]),
)  # fmt: skip
@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_map_and_its_inverse(tmp_path, turn, arm, clamp, clamp_arm, shows, kind, units, sign, bias, delimiter):
    recording = small(EGG)
    log = track(recording)
    rig = Rig(tuple(180 * a for a in turn), tuple(50 * a for a in arm), shows, bias, 0.0)
    values, _ = disturbed(sensed(log.wrench, rig), rig)
    factors = dict(zip(("s", "ms", "us"), (1, 1e-3, 1e-6), strict=True)) | {
        "m": 1,
        "mm": 1e-3,
        "in": 0.0254,
        "deg": np.pi / 180,
        "rad": 1,
    }
    factors |= {"N": 1, "mN": 1e-3, "N m": 1, "N mm": 1e-3, "mN mm": 1e-6}
    time, length, angle, force, moment = (factors[unit] for unit in units)
    # the logged frame is that in which the clamp stands as [clamp] says
    inner, shift = Rotation.from_euler("xyz", [120 * a for a in clamp], degrees=True), 0.1 * np.array(clamp_arm)
    logged = Rotation.from_quat(log.quaternion, scalar_first=True) * inner.inv()
    place = log.position - logged.apply(shift)
    if len(kind) == 4:
        turned, names = logged.as_quat(scalar_first=kind == "wxyz"), ["q1", "q2", "q3", "q4"]
        orientation = {"quaternion": names, "order": kind}
    elif kind == "rotvec":
        turned, names, orientation = logged.as_rotvec() / angle, ["r1", "r2", "r3"], {"rotvec": ["r1", "r2", "r3"]}
    else:
        turned, names = logged.as_euler(kind) / angle, ["e1", "e2", "e3"]
        orientation = {"euler": names, "convention": kind}
    columns = {"t": log.time / time, **dict(zip("xyz", (place / length * sign).T, strict=True))}
    columns |= dict(zip(names, turned.T, strict=True))
    columns |= dict(zip(["Fx", "Fy", "Fz", "Tx", "Ty", "Tz"], (values / np.repeat([force, moment], 3)).T, strict=True))
    data = map_of(recording.rod, rig)
    data["columns"] |= {
        "orientation": orientation,
        "position": [("-" if s < 0 else "") + n for n, s in zip("xyz", sign, strict=True)],
    }
    data["units"] = dict(zip(("time", "length", "angle", "force", "moment"), units, strict=True))
    data["clamp"] = {"position_mm": (1e3 * shift).tolist(), "euler_deg": [120 * a for a in clamp]}
    found = imported(tmp_path / "raw.csv", columns, data, delimiter=delimiter)
    rows = same_rows(log, found)
    assert np.abs(found.recording.position_m - recording.position_m[rows]).max() < 1e-12
    assert np.abs(found.recording.axes() - recording.axes()[rows]).max() < 1e-7  # Euler angles near their poles
    truth = six(recording)[rows]
    for part in (slice(0, 3), slice(3, 6)):
        assert np.abs(six(found.recording) - truth)[:, part].max() < 1e-11 * np.abs(truth[:, part]).max()


def test_an_imported_recording_is_read_back_bit_for_bit(tmp_path, planar):
    rig = Rig(noise=0.002)
    back = imported(tmp_path / "raw.csv", table(track(planar), rig), map_of(planar.rod, rig)).recording
    for name in ("log.csv", "log.parquet"):
        scan3d.write_recording(back, tmp_path / name)
        again = scan3d.read_recording(tmp_path / name)
        for field in dataclasses.fields(back):
            one, other = getattr(back, field.name), getattr(again, field.name)
            same = one.tobytes() == other.tobytes() if isinstance(one, np.ndarray) else one == other
            assert same, (name, field.name)


def test_a_table_as_parquet_gives_the_same_recording(tmp_path, planar):
    columns, data = table(track(planar), EXACT), map_of(planar.rod, EXACT)
    write(tmp_path / "raw.csv", columns)
    (tmp_path / "raw.parquet").write_bytes(parquet_bytes(columns))
    one, other = (scan3d.import_table(tmp_path / f"raw.{ending}", data) for ending in ("csv", "parquet"))
    assert one.force_N.tobytes() == other.force_N.tobytes()
    assert one.position_m.tobytes() == other.position_m.tobytes()
    data["columns"]["force"] = ["Fw", "Fy", "Fz"]
    with pytest.raises(
        InputError, match=r"raw\.parquet has no column 'Fw', which \[columns\] force of the map names; it has t, x"
    ):
        scan3d.import_table(tmp_path / "raw.parquet", data)


@pytest.mark.parametrize("given", ["sweep", "move", "both"])
def test_columns_of_sweeps_and_moves_are_used_where_they_are(tmp_path, planar, given):
    log = track(planar)
    columns, data = table(log, EXACT), map_of(planar.rod, EXACT)
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
    rows = same_rows(turned, found)
    # the frame is turned by half a turn about the rod: x and z change their signs
    signs = np.tile([-1.0, 1.0, -1.0], 2)
    assert np.abs(six(found.recording) - six(planar)[rows] * signs).max() < 1e-12
    assert found.recording.axes()[:, 1] == pytest.approx(planar.axes()[rows][:, 1], abs=1e-14)
    assert found.recording.axes()[:, 0] == pytest.approx(-planar.axes()[rows][:, 0], abs=1e-14)


def test_stretches_in_the_air_can_be_given(tmp_path, planar):
    log = track(planar)
    free = np.flatnonzero(~log.wrench.any(axis=1))
    runs = np.split(free, np.flatnonzero(np.diff(free) > 1) + 1)
    air = [[float(log.time[run[0]]), float(log.time[run[-1]])] for run in [*runs[::9], runs[-1]]]
    data = map_of(planar.rod, EXACT, tare={"air": air})
    found = imported(tmp_path / "raw.csv", table(log, EXACT), data)
    rows = same_rows(log, found)
    assert found.summary.air == tuple(map(tuple, air))
    assert np.abs(six(found.recording) - six(planar)[rows]).max() < 1e-12


def test_a_tared_table_without_time_is_taken_as_it_is(tmp_path, planar):
    rig = Rig((0, 0, 0), (0, 0, 0), bias=0.0, drift=0.0)
    log = track(planar)
    columns, data = (
        table(log, rig),
        map_of(planar.rod, rig, tare={"air": "none"}, noise={"force_N": 1e-6, "moment_Nm": 1e-9}),
    )
    del columns["t"], data["columns"]["time"]
    found = imported(tmp_path / "raw.csv", columns, data)
    rows = same_rows(log, found)
    assert np.array_equal(found.recording.force_N, planar.force_N[rows])
    assert (found.recording.noise_force_N, found.recording.noise_moment_Nm) == (1e-6, 1e-9)


@pytest.mark.parametrize("channels", [3, 4, 5])
def test_sensors_with_fewer_channels_give_planar_recordings(tmp_path, planar, channels):
    rig = Rig((0.0, 0.0, 25.0), (4.0, -20.0, 3.0))
    log = track(planar)
    columns, data = table(log, rig), map_of(planar.rod, rig)
    data["columns"]["force"] = ["Fx", "Fy", "Fz"] if channels == 4 else ["Fx", "Fy"]
    data["columns"]["moment"] = ["Tx", "Ty", "Tz"] if channels == 5 else ["Tz"]
    found = imported(tmp_path / "raw.csv", columns, data)
    rows = same_rows(log, found)
    assert not found.recording.six_axis
    assert np.abs(found.recording.force_N - planar.force_N[rows]).max() < 1e-12
    assert np.abs(found.recording.moment_Nm - planar.moment_Nm[rows]).max() < 1e-13
    notes = " ".join(found.summary.notes)
    assert ("fz are left out" in notes) == (channels == 4)


def test_a_fourth_channel_says_that_the_force_leaves_the_plane(tmp_path, spatial):
    rig = Rig((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    columns, data = table(track(spatial), rig), map_of(spatial.rod, rig)
    data["columns"]["moment"] = ["Tz"]
    found = imported(tmp_path / "raw.csv", columns, data)
    assert "% of the force in contact, and the planar model takes it for zero" in " ".join(found.summary.notes)


def test_a_sensor_turned_out_of_the_plane_needs_more_channels(tmp_path, planar):
    columns, data = table(track(planar), EXACT), map_of(planar.rod, EXACT)
    data["columns"] |= {"force": ["Fx", "Fy"], "moment": ["Tz"]}
    with pytest.raises(
        InputError, match=r"raw\.csv: fx of the clamp needs fz of the sensor as well, because \[sensor\] turns"
    ):
        imported(tmp_path / "raw.csv", columns, data)


def test_a_body_on_a_turntable_is_the_example_of_the_manual(tmp_path, monkeypatch):
    """The table of examples/own_measurements.py, which that script converts by hand."""
    monkeypatch.syspath_prepend(str(EGG.parents[1] / "examples"))
    import own_measurements as example

    example.laboratory(tmp_path / "table.csv", slices=6)
    data = {
        "columns": {
            "sweep": "sweep",
            "position": ["-travel_mm", "-distance_mm", "height_mm"],
            "position_in": "clamp",
            "orientation": {"euler": ["turn_deg"], "convention": "z"},
            "force": ["across_mN", "along_mN"],
            "moment": ["moment_uNm"],
        },
        "units": {"length": "mm", "force": "mN", "moment": "uN m"},
        "sensor": {"shows": "rod-on-clamp"},
        "tare": {"air": "none"},
        "rod": {"length_m": 0.06, "diameter_m": 0.3e-3, "modulus_Pa": 210e9},
    }
    found, by_hand = scan3d.import_table(tmp_path / "table.csv", data), example.recording(tmp_path / "table.csv")
    assert np.array_equal(found.sweep, by_hand.sweep)
    assert found.rod == by_hand.rod
    assert found.position_m == pytest.approx(by_hand.position_m, abs=1e-15)
    assert found.axes() == pytest.approx(by_hand.axes(), abs=1e-14)
    assert found.force_N == pytest.approx(by_hand.force_N, rel=1e-14)
    assert found.moment_Nm == pytest.approx(by_hand.moment_Nm, rel=1e-14)


@pytest.mark.parametrize(("jitter_m", "step_m"), [(2e-5, 0.0), (0.0, 1e-5), (2e-6, 5e-6)])
def test_sweeps_are_found_under_jitter_and_in_steps(tmp_path, planar, jitter_m, step_m):
    """Slow motion, 20 µm of jitter, and an encoder of 10 µm: the sweeps are whole, but for some rows at their ends."""
    log, slower = track(planar), 12
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
    found = imported(tmp_path / "raw.csv", table(long, RIG_WITH_NOISE), map_of(planar.rod, RIG_WITH_NOISE))
    truth, mine = np.where(long.row >= 0, planar.sweep[long.row], -1), found.sweep
    count = len(np.unique(planar.sweep))
    assert found.summary.sweeps == count
    for number, original in enumerate(dict.fromkeys(planar.sweep.tolist())):
        rows = truth == original
        # all of its rows but a few, and others within the 20 standard deviations over which the direction is determined
        assert (mine[rows] == number).mean() > 0.97
        assert (mine == number).sum() < 1.25 * rows.sum()


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
    names = ("sweep", "position_m", "quaternion", "force_N", "moment_Nm", "force_z_N", "moment_x_Nm", "moment_y_Nm")
    chosen = dataclasses.replace(spatial, **{name: getattr(spatial, name)[few] for name in names})
    columns = table(track(chosen), EXACT, euler="ZYX")
    assert imported(tmp_path / "log.csv", columns, map_of(spatial.rod, EXACT, euler="ZYX")).summary.notes == ()
    found = imported(tmp_path / "log.csv", columns, map_of(spatial.rod, EXACT, euler="zyx")).summary
    assert 2 <= found.sweeps <= right.sum()
    assert 'nearly all do if the convention is "ZYX": check [columns] orientation' in found.notes[0]


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_log_in_which_nothing_is_touched_keeps_its_sweeps(tmp_path, planar, seed):
    """A few rows of noise, of more than four standard deviations, are no contact."""
    log = track(planar)
    nothing = log._replace(wrench=np.zeros_like(log.wrench))
    columns = table(nothing, EXACT)
    random = np.random.default_rng(seed)
    for name in ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz"):
        columns[name] = 1e-4 * random.standard_normal(len(log.time))
    columns["Fx"][[700, 3000, 9000]] = 5.5e-4
    found = imported(tmp_path / "log.csv", columns, map_of(planar.rod, EXACT))
    assert found.summary.sweeps == len(np.unique(planar.sweep))
    assert found.summary.sweeps_with_contact == 0
