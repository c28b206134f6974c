"""Rows that are pushed one by one give what the whole recording gives, to the last bit."""

import functools
import sys
from dataclasses import replace

import numpy as np
import pytest
import rigs
from small_scans import EGG

import planar
import scan3d
from scan3d import InputError
from scan3d.reconstruction.agreement import checked
from scan3d.reconstruction.contacts import contacts, readings, without_normals
from scan3d.recording import Known, of_rows
from scan3d.rigs import Frame, euler_of
from tests.rig_errors import six_axis

RODS = {
    "straight": None,
    "thick": scan3d.Rod(0.06, 2e-4, 0.002),
    "tapered": scan3d.Rod(0.06, 2e-4, 0.0004, tip_diameter_m=0.0002),
}


def pushed(live, recording):
    """The contacts of all rows, None where there is none, and the states."""
    wrench = np.hstack(six_axis(recording).wrench())
    found, states = [], []
    for k in range(len(recording)):
        found.append(
            live.push(0.01 * k, recording.position_m[k], recording.quaternion[k], wrench[k], recording.sweep[k])
        )
        states.append(live.state)
    return found, np.array(states)


@functools.cache
def scanned(model, rod=None, noise=1e-4, **more):
    samples = 40 if model == "planar" else 10  # of many more sweeps
    plan = scan3d.Plan(
        slices=2, sweeps=3, samples=samples, model=model, rod=rod, noise=noise, friction=(0.0, 0.4), **more
    )
    recording = scan3d.simulate(scan3d.load_mesh(EGG), plan)
    # numbers without a grid, as of a converter, by which the batch widens the noise
    return replace(recording, position_m=recording.position_m + 1e-9 / 3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rod", "model", "noise"),
    [
        pytest.param(rod, model, noise, marks=() if noise or rod == "straight" else pytest.mark.trust)
        for rod, model in [*((rod, "planar") for rod in RODS), ("straight", "spatial"), ("thick", "spatial")]
        for noise in (0.0, 1e-4)
    ],
)
def test_the_contacts_are_those_of_the_whole_recording(rod, model, noise):
    recording = scanned(model, RODS[rod], noise)
    if rod == "tapered":
        recording = of_rows(recording, np.arange(0, len(recording), 8))
    live = scan3d.Live(recording, model=model)
    found, states = pushed(live, recording)
    same = live.recording
    for name in ("sweep", "position_m", "quaternion", "force_N", "moment_Nm"):
        np.testing.assert_array_equal(getattr(same, name), getattr(recording, name))
    cloud = contacts(same) if model == "planar" else without_normals(same, readings(same))
    touching = np.flatnonzero(states == "touching")
    assert len(cloud) > 10
    assert np.isin(cloud.row, touching).all()
    assert len(touching) <= len(cloud) + cloud.light
    of = [found[row] for row in cloud.row]
    if rod == "tapered":  # rods that are integrated together take the same steps
        np.testing.assert_allclose([one.point for one in of], cloud.points, atol=1e-8 * live.cloud.rod_length)
        return
    np.testing.assert_array_equal([one.point for one in of], cloud.points)
    np.testing.assert_array_equal([one.force_N for one in of], cloud.force_N)
    np.testing.assert_array_equal([one.phase for one in of], cloud.phase)
    if noise:
        np.testing.assert_array_equal([one.covariance for one in of], cloud.covariance)
    if model == "planar":
        tangential = cloud.phase == planar.Phase.TANGENTIAL
        np.testing.assert_array_equal(np.array([one.friction for one in of])[tangential], cloud.friction[tangential])
        normals = np.array([one.normal for one in of])[tangential]
        np.testing.assert_allclose(normals, cloud.in_plane_normals[tangential], atol=1e-12)
    assert live.cloud.points.shape[1] == 3


@pytest.mark.slow
@pytest.mark.parametrize("bead", [0.0, 1.0])
@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_the_contacts_of_probings_are_those_of_the_whole_recording(bead, noise):
    plan = scan3d.Plan(model="spatial", probing="only", known=0.5, bead=bead, noise=noise)
    recording = scan3d.simulate(scan3d.load_mesh(EGG), plan)
    recording = of_rows(recording, recording.sweep < 200)
    found, states = pushed(scan3d.Live(recording), recording)
    cloud = scan3d.reconstruct(recording)
    assert (states == "touching").sum() == len(cloud) > 50
    of = [found[row] for row in cloud.row]
    assert {one.phase for one in of} == {planar.Phase.TIP}
    # rods that are integrated together take the same steps
    np.testing.assert_allclose([one.point for one in of], cloud.points, rtol=0, atol=1e-12 * cloud.rod_length)
    np.testing.assert_allclose([one.force_N for one in of], cloud.force_N, rtol=1e-12)
    if noise:
        np.testing.assert_allclose([one.covariance for one in of], cloud.covariance, rtol=1e-8, atol=1e-12)


@pytest.mark.slow
def test_a_calibrated_rig_corrects_the_rows_as_it_corrects_a_recording(tmp_path):
    raw = rigs.recorded(seed=1, samples=60)
    calibration = scan3d.calibrate(raw, rigs.DIAMETER)
    live = scan3d.Live(calibration, air_rows=5)
    # what hangs free shows zero and noise
    rng, wrench = np.random.default_rng(0), np.hstack(raw.wrench())
    bias = calibration.tare
    for k in range(5):
        assert (
            live.push(-0.1 + 0.01 * k, raw.position_m[0], raw.quaternion[0], bias + 1e-9 * rng.normal(size=6)) is None
        )
        assert live.state == "unknown"
    some = np.arange(0, len(raw), 35)
    found = [live.push(0.01 * k, raw.position_m[k], raw.quaternion[k], wrench[k], int(raw.sweep[k])) for k in some]
    corrected = of_rows(calibration.applied(raw, tare="calibration"), some)
    np.testing.assert_allclose(live.recording.position_m, corrected.position_m, atol=1e-12)
    np.testing.assert_allclose(live.recording.force_N, corrected.force_N, atol=1e-6)
    known = readings(live.recording)
    alone = np.array([one is not None for one in found])
    assert alone[known.touching].all()
    cloud = without_normals(live.recording, known)
    np.testing.assert_array_equal([found[k].point for k in cloud.row], cloud.points)
    # a map that states frames and sign leaves less to the rig, and the rows of the sensor are what they were
    stated = {"position_mm": [1.0, -20.0, 3.0], "euler_deg": [5.0, 20.0, -8.0]}
    own, (sensor, clamp) = Frame.of((0.001, -0.02, 0.003), (5.0, 20.0, -8.0)), calibration.frames()
    turns = sensor.turn @ own.turn.T, own.turn.T @ clamp.turn
    mapped = replace(
        calibration,
        sensor_position_m=sensor.position_m - turns[0] @ own.position_m,
        sensor_euler_deg=euler_of(turns[0]),
        clamp_position_m=own.turn.T @ (clamp.position_m - own.position_m),
        clamp_euler_deg=euler_of(turns[1]),
        map_frames={"sensor": {**stated, "shows": "rod-on-clamp"}, "clamp": stated},
    )
    scan3d.write_rig(mapped, tmp_path / "rig.toml")
    other, k, rng = (
        scan3d.Live(tmp_path / "rig.toml", air_rows=5),
        int(some[known.touching][20]),
        np.random.default_rng(0),
    )
    for time in range(-5, 0):
        other.push(time, raw.position_m[0], raw.quaternion[0], -(bias + 1e-9 * rng.normal(size=6)))
    again = other.push(0.0, raw.position_m[k], raw.quaternion[k], -wrench[k], int(raw.sweep[k]))
    assert again.point == pytest.approx(found[list(some).index(k)].point, abs=1e-5)
    # they lie on the sphere that was touched
    away = np.linalg.norm(cloud.points / 1000 - rigs.CENTRE, axis=1) - rigs.DIAMETER / 2
    assert np.median(np.abs(away)) < 5e-4


def test_a_state_stays_until_the_next_row_is_known(monkeypatch):
    """A page may ask for it at any time."""
    module, recording, seen = sys.modules[scan3d.Live.__module__], scanned("planar"), []
    contact, live = module._contact, scan3d.Live(recording)
    monkeypatch.setattr(module, "_contact", lambda *row: seen.append(live.state) or contact(*row))
    _, states = pushed(live, recording)
    assert "unknown" not in states
    assert set(seen) == {"air", "touching"}


@pytest.mark.slow
def test_states_tell_air_dropped_values_and_what_no_rod_has(tmp_path):
    recording = scanned("spatial")
    scan3d.write_recording(recording, tmp_path / "rec.csv")
    live = scan3d.Live(tmp_path / "rec.toml", air_rows=25)
    still = (0.0, recording.position_m[0], recording.quaternion[0])
    rng = np.random.default_rng(0)
    for k in range(25):
        assert live.push(0.01 * k, *still[1:], 1e-6 * rng.normal(size=6) + 0.5) is None
    assert live.push(1.0, *still[1:], np.full(6, 0.5)) is None
    assert live.state == "air"
    assert live.push(1.1, *still[1:], [np.nan] * 6) is None
    assert live.state == "unknown"
    assert live.push(1.2, *still[1:], np.array([1e-3, 0.0, 0.0, 0.0, 0.0, 1.0]) + 0.5) is None
    assert live.state == "unknown"
    assert len(live.recording) == 2
    # a rod that swings about its rest
    states = []
    for k in range(60):
        swing = np.exp(-0.01 * k) * np.cos(1.7 * k) * np.array([1e-2, 0.0, 0.0, 0.0, 0.0, 5e-4])
        live.push(2 + 0.01 * k, *still[1:], swing + 0.5 + 1e-6 * rng.normal(size=6))
        states.append(live.state)
    assert states[20:].count("ringing") > 35


@pytest.mark.slow
def test_a_low_pass_leaves_less_noise():
    recording = scanned("spatial", noise=0.0)
    rng = np.random.default_rng(0)
    plain, smooth = scan3d.Live(recording, air_rows=200), scan3d.Live(recording, air_rows=200, lowpass_hz=5)
    for k in range(201):
        row = 0.01 * k, recording.position_m[0], recording.quaternion[0], 1e-3 * rng.normal(size=6)
        plain.push(*row)
        smooth.push(*row)
    assert smooth.recording.noise.force_N < 0.6 * plain.recording.noise.force_N
    assert (plain.recording.noise_independent, smooth.recording.noise_independent) == (True, False)


def test_a_zero_that_is_found_again_makes_no_earlier_row_more_exact():
    live, rng, noises = scan3d.Live(scanned("planar"), air_rows=30), np.random.default_rng(0), []
    for sweep, sd in enumerate((1e-4, 1e-6, 1e-5)):
        live.tare()
        for _ in range(31):
            live.push(0.0, [0, 0, 0], [1, 0, 0, 0], sd * rng.normal(size=3), sweep)
        noises.append(live.recording.noise)
    assert noises[0].force_N > 5e-5
    assert noises == noises[:1] * 3
    assert replace(live.recording).noise[:2] == noises[0][:2]


@pytest.mark.parametrize("model", ["planar", "spatial"])
def test_before_the_first_contact_there_is_nothing_to_see(model):
    live = scan3d.Live(scanned(model), model=model)
    assert len(live.recording) == len(live.cloud) == 0
    assert "none" in str(live.recording)
    assert "contacts" in str(live.cloud)
    assert live.push(0.0, [0, 0, 0], [1, 0, 0, 0], np.zeros(6)) is None
    assert (live.state, len(live.last_row), len(live.recording), len(live.cloud)) == ("air", 1, 0, 0)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_sweeps_are_found_where_the_rod_goes_through_the_air_between_them(noise):
    recording = scanned("planar", None, noise)
    live, length, up, rng = (
        scan3d.Live(recording, model="planar"),
        recording.rod.length_m,
        np.eye(3)[2],
        np.random.default_rng(0),
    )
    sd = recording.noise.force_N, recording.noise.force_N, recording.noise.moment_Nm
    last = None
    for sweep in np.unique(recording.sweep):
        rows = np.flatnonzero(recording.sweep == sweep)
        if last is not None:  # back along the rod, far above the body, down, and forward to where the next sweep begins
            for row, shares in ((last, np.linspace(0.1, 1, 6)), (rows[0], np.linspace(1, 0.1, 6))):
                back = -1.5 * length * recording.axes()[row, 1]
                above = [back + 3 * length * share * up for share in shares]
                way = [share * back for share in shares]
                for step in [*way, *above] if row == last else [*above, *way]:
                    live.push(0.0, recording.position_m[row] + step, recording.quaternion[row], sd * rng.normal(size=3))
        for row in rows:
            wrench = [*recording.force_N[row], recording.moment_Nm[row]]
            live.push(0.0, recording.position_m[row], recording.quaternion[row], wrench)
        last = rows[-1]
    cloud, whole = live.cloud, scan3d.reconstruct(recording, model="planar")
    assert cloud.convex
    np.testing.assert_allclose(cloud.points, whole.points, atol=1e-9)
    assert len(np.unique(cloud.sweep)) == len(np.unique(whole.sweep))
    assert len(cloud.slice_height) == len(np.unique(whole.slice))


@pytest.mark.parametrize("lost", [12, 20, 21, 27], ids=["ahead", "deepest", "at the turn", "on the way back"])
def test_a_probing_whose_force_is_lost_in_one_row_remains_one(lost):
    """There are as many contacts as probings, where the ends were when a force was felt first."""
    sd, rng = np.repeat([1e-7, 1e-8], 3), np.random.default_rng(0)
    live = scan3d.Live(scanned("spatial"), noise=(sd[0], sd[-1]))
    length, depth = live.recording.rod.length_m, np.append(np.arange(-10, 11), np.arange(9, -21, -1)) / 1000
    for x in (0.0, 0.1, 0.2):
        for k, deep in enumerate(depth):
            wrench = sd * rng.normal(size=6)
            wrench[1] += 0.1 * max(deep, 0.0) * (k != lost)
            live.push(0.0, [x * length, deep * length, 0.0], [1, 0, 0, 0], wrench)
            if live.state == "touching":
                there = [x * length, (1 + deep) * length, 0.0]
                np.testing.assert_allclose(live.contacts[-1].point / 1000, there, rtol=0, atol=1e-6)
    assert len(live.contacts) == 3 * 18
    assert live.recording.in_probings.all()
    ends = [[x * length, 1.001 * length, 0.0] for x in (0.0, 0.1, 0.2)]
    np.testing.assert_allclose(live.cloud.points / 1000, ends, rtol=0, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("model", ["planar", "spatial"])
def test_a_rod_that_returns_in_its_own_plane_sweeps_again(model):
    recording = scanned(model)
    whole, length = scan3d.reconstruct(recording, model=model), recording.rod.length_m
    live, wrench = scan3d.Live(recording), np.hstack(six_axis(recording).wrench())
    for sweep in np.unique(recording.sweep)[:20]:
        rows = np.flatnonzero(recording.sweep == sweep)
        first, last = recording.position_m[rows[[0, -1]]]
        for again in range(2):
            for row in rows:
                live.push(0.0, recording.position_m[row], recording.quaternion[row], wrench[row])
            # out of the body's way, back, and forward to where the sweep began
            out = -1.5 * length * recording.axes()[rows[0], 1] * (1 + again)
            for place in (last + out / 2, last + out, first + out, first + out / 2):
                live.push(0.0, place, recording.quaternion[rows[0]], np.zeros(6))
    found = live.cloud
    there = np.isin(whole.sweep, np.unique(recording.sweep)[:20])
    assert "sweep-direction" not in [one.code for one in checked(live.recording, found).contradictions]
    assert len(found) == 2 * there.sum()
    assert len(np.unique(found.sweep)) == 2 * len(np.unique(whole.sweep[there]))


@pytest.mark.slow
def test_a_rod_that_is_parked_in_the_air_fills_no_memory():
    """Where the clamp stands for long, before a touch and after it, the contacts are those of a clamp that does not."""
    recording = scanned("planar", noise=0.0)
    rows, found = np.flatnonzero(recording.sweep == 0), []
    way = 1e-3 * recording.axes()[rows[0], 0]
    places = recording.position_m[rows]
    kept = []
    for stays in (1, 300):
        live, wrench = scan3d.Live(recording), np.hstack([recording.force_N, recording.moment_Nm[:, None]])[rows]
        air = np.linspace(20, 1, 8)[:, None] * way
        steps = [(places[0] + step, np.zeros(3), stays if k == 4 else 1) for k, step in enumerate(air)]
        steps += [(place, shown, 1) for place, shown in zip(places, wrench, strict=True)]
        steps += [(places[-1] - step, np.zeros(3), stays if k == 4 else 1) for k, step in enumerate(air[::-1])]
        for place, shown, times in steps:
            for _ in range(times):
                live.push(0.0, place, recording.quaternion[rows[0]], shown)
        found.append(live)
        kept.append(len(live.recording))
    assert kept[0] >= len(steps) - 1  # the way to the first place is none of a sweep
    assert kept[0] < kept[1] < kept[0] + 150
    np.testing.assert_array_equal(*([one.point for one in live.contacts] for live in found))
    np.testing.assert_array_equal(*(live.cloud.points for live in found))
    unique = [np.unique(live.recording.position_m, axis=0) for live in found]
    np.testing.assert_array_equal(*unique)
    # in the air alone
    before = len(live.recording)
    for _ in range(1000):
        live.push(0.0, places[0] + 0.3, recording.quaternion[rows[0]], np.zeros(3))
    assert len(live.recording) == before
    assert len(live._waiting_rows) <= 65


@pytest.mark.parametrize("stated", [0, 7])
def test_sweeps_that_are_found_have_other_numbers_than_those_that_are_stated(stated):
    recording = scanned("planar", noise=0.0)
    live, rows = scan3d.Live(recording), np.flatnonzero(recording.sweep == 0)
    for sweep in (stated, None, stated + 5, None):
        for row in rows:
            wrench = [*recording.force_N[row], recording.moment_Nm[row]]
            live.push(0.0, recording.position_m[row], recording.quaternion[row], wrench, sweep)
    numbers = live.recording.sweep
    begins = np.diff(numbers, prepend=-1) != 0
    assert numbers[begins].tolist() == [stated, stated + 1, stated + 5, stated + 6]


def test_what_is_no_row_is_refused():
    live = scan3d.Live(scanned("planar"), model="planar")
    assert live.push(0.0, [0, 0, 0], [1, 0, 0, 0], [0, 0, 0]) is None
    for wrong, message in (
        ({"position": [0, 0]}, r"a row has a position \(3,\)"),
        ({"quaternion": [1, 1, 0, 0]}, "must have the length 1"),
        ({"sweep": 1.5}, "sweep must be a whole number of at least 0"),
        ({"wrench": [1e300, 0, 0]}, "the wrench holds 1e"),
        ({"position": [1e200, 0, 0]}, "position_m holds 1"),
        ({"t": "noon"}, "a row is made of numbers"),
        ({"t": -0.1}, "the time -0.1 s is before that of the row before, 0 s"),
        ({"position": "here"}, "a row is made of numbers"),
    ):
        row = {"t": 0.0, "position": [0, 0, 0], "quaternion": [1, 0, 0, 0], "wrench": [0, 0, 0], **wrong}
        with pytest.raises(InputError, match=message):
            live.push(**row)
    with pytest.raises(InputError, match="the recording has no rows"):
        scan3d.reconstruct(live.recording)
    with pytest.raises(InputError, match="the recording has no rows"):
        scan3d.save(live.recording, "nothing.csv")
    live.tare()
    for _ in range(100):
        live.push(0.0, [0, 0, 0], [1, 0, 0, 0], [0.01, 0.02, 1e-4])
    live.push(0.0, [0, 0, 0], [1, 0, 0, 0], [0.01, 0.02, 1e-4])
    assert live.state == "air"
    with pytest.raises(InputError, match="a rig is a calibration, a recording"):
        scan3d.Live(scan3d.Rod(0.05, 1e-4))
    with pytest.raises(InputError, match="lowpass_hz must be above 0, and needs air_rows"):
        scan3d.Live(scanned("planar"), lowpass_hz=5)
    with pytest.raises(InputError, match="noise is two numbers, of force and of moment"):
        scan3d.Live(scanned("planar"), noise=1e-3)
    assert scan3d.Live(scanned("planar")).model == "planar"
    with pytest.raises(InputError, match="of a rod with bead_diameter_m measure six axes"):
        scan3d.Live(replace(scanned("planar"), rod=scan3d.Rod(0.06, 2e-4, bead_diameter_m=0.001))).push(
            0.0, [0, 0, 0], [1, 0, 0, 0], [0, 1e-2, 0]
        )


def test_a_zero_that_can_not_be_found_is_refused(tmp_path):
    heavy = replace(
        scanned("spatial"),
        rod=scan3d.Rod(0.06, 2e-4, 0.0004, weight_N=1e-3),
        gravity=scan3d.Gravity((0.0, 0.0, -1.0), tared=False),
    )
    for begun in (lambda: scan3d.Live(heavy, air_rows=100), scan3d.Live(heavy).tare):
        with pytest.raises(InputError, match="the zero of a sensor that carries a rod with a weight turns with it"):
            begun()
    live = scan3d.Live(scanned("spatial"), air_rows=30, lowpass_hz=20)
    rows = [(0.1 * k, [0, 0, 0], [1, 0, 0, 0], np.zeros(6)) for k in range(30)]
    for row in rows[:-1]:
        live.push(*row)
    for t in (2.9, 3.0, 9.0):  # no row is read without a zero and its noise
        with pytest.raises(
            InputError, match="the rows come at 10 Hz, and lowpass_hz must be below half of that, got 20"
        ):
            live.push(t, *rows[-1][1:])
    path = tmp_path / "recording.toml"
    path.write_text("[rod]\nlength_m = 0.06\nbending_stiffness_Nm2 = 2e-4\n[known]\nfriction = 0.3\n", encoding="utf-8")
    with pytest.raises(InputError, match="a channel that was not measured, which needs the whole recording"):
        scan3d.Live(path)
    completed = replace(scanned("planar"), completed=Known(friction=0.3, channel="m0z"))
    with pytest.raises(InputError, match="a channel that was not measured, which needs the whole recording"):
        scan3d.Live(completed)


def test_a_rig_that_makes_forces_of_signals_corrects_no_rows(tmp_path):
    """Counts would be read as newtons."""
    path = tmp_path / "rig.toml"
    sensor = 'channels = ["fx", "fy", "mz"]\nmatrix = [[1e-3, 0, 0], [0, 1e-3, 0], [0, 0, 1e-5]]\noffset = [9, 9, 9]'
    path.write_text(
        f"schema = 1\n[rod]\nlength_m = 0.06\nbending_stiffness_Nm2 = 2e-4\n[sensor]\n{sensor}\n", encoding="utf-8"
    )
    for rig in (path, scan3d.read_rig(path)):
        with pytest.raises(InputError, match="the matrix of a sensor's signals, and rows have forces"):
            scan3d.Live(rig, model="planar")


def test_noise_may_be_an_array():
    live = scan3d.Live(scanned("planar"), noise=np.array([1e-3, 1e-5]))
    assert live.push(0.0, [0, 0, 0], [1, 0, 0, 0], [1e-3, 0, 0]) is None
    assert live.state == "air"
