"""Rows that hold no measurement: repeated, saturated and re-tared channels and held poses, against the logs without the fault.

What was done to a log is known, and so is the body; right logs, and those of coarse converters, must not be doubted.
"""

import numpy as np
import pytest
from robustness.unmeasured_rows import FAULTS, NAMES, ROD, Rows, imported, kept, logged, outcome
from scipy.spatial.transform import Rotation

from scan3d.errors import InputError
from scan3d.files.tables import Table
from scan3d.laboratory.importing import convert
from scan3d.laboratory.maps import read_map
from scan3d.laboratory.one_sweep import OneSweep, reconstruct_sweep
from scan3d.pipeline import analyse
from scan3d.unmeasured import gaps, held_poses, jumps_of, of_all, parts, silent, steps_of
from tests.raw_tables import si_map
from tests.robustness.bounds import false_statements

SEED = 1


@pytest.fixture(scope="module")
def log():
    return logged(SEED)


def rows_of(log):
    return Rows(np.hstack([log.position_m, log.quaternion]), log.wrench)


# --- values alone ---


def values(noise, step, count=4000, seed=0):
    """Six channels in the air, with two touches, in steps of a converter."""
    draw = np.random.default_rng(seed)
    shape = np.clip(np.sin(np.linspace(0, 4 * np.pi, count)), 0, None) ** 2
    signal = 100 * shape[:, None] * [1.0, 0.5, 0.2, 3.0, 1.0, 2.0] + noise * draw.standard_normal((count, 6))
    return step * np.round((signal + draw.uniform(-3, 3, 6)) / step), shape == 0


def moving(count):
    return np.arange(count)[:, None] * np.ones(7)


@pytest.mark.parametrize("step", [1e-9, 0.05, 0.2, 1.0, 3.0, 10.0])
def test_no_converter_is_taken_for_a_sensor_that_stopped(step):
    """Rounding to steps, from far below to far above the noise, is all that makes values repeat."""
    for seed in range(4):
        shown, air = values(0.3, step, seed=seed)
        assert gaps(shown, air, moving(len(shown))) == []


def test_logs_without_noise_have_nothing_that_stopped():
    shown, air = values(0.0, 1e-12)
    assert gaps(shown, air, moving(len(shown))) == []
    # a rod that rings in one half of its time in the air, as in a simulation
    shown, air = values(0.3, 1e-9)
    shown[air & (np.arange(len(shown)) // 50 % 2 == 0)] = 0
    assert not any(gap.every for gap in gaps(shown, air, moving(len(shown))))


@pytest.mark.parametrize("channel", [0, 2, 4])
def test_a_dead_channel_of_a_log_with_noise_is_named(log, channel):
    _, log = log
    rows, name = rows_of(log), NAMES[8 + channel]
    dead = rows.wrench.copy()
    dead[:, channel] = 0.3 * (channel == 2)
    (_, right), (_, notes) = imported(log, rows), imported(log, rows._replace(wrench=dead))
    assert not any("in all rows" in note for note in right)
    assert sum(note.startswith(f"{name} is ") and "in all rows" in note for note in notes) == 1


@pytest.mark.parametrize(("noise", "told"), [(0.3, [1]), (0.0, [])])
def test_of_a_log_without_noise_no_channel_is_called_dead(noise, told):
    shown, air = values(noise, 1e-12)
    shown[:, 1] = 0.0
    assert silent(shown, air).tolist() == told


@pytest.mark.parametrize(("step", "rate"), [(1e-9, 5.0), (0.05, 5.0), (1e-9, 30.0), (0.2, 1.7), (1e-9, 1.01)])
def test_a_sensor_slower_than_its_log_is_seen_to_the_row(step, rate):
    """What repeats while the clamp stands is no fault."""
    shown, air = values(0.3, step)
    last = (np.arange(len(shown)) // rate * rate).astype(int)
    pose = moving(len(shown))
    (found,) = gaps(shown[last], air[last], pose)
    assert found.every == pytest.approx(rate, rel=0.02)
    repeated = np.append(False, (shown[last][1:] == shown[last][:-1]).all(axis=1))
    assert np.array_equal(found.rows, np.flatnonzero(repeated))
    assert gaps(shown[last], air[last], pose[last]) == []


@pytest.mark.parametrize("step", [1e-9, 0.05, 0.2])
@pytest.mark.parametrize("to_the_end", [True, False])
@pytest.mark.parametrize("channels", [range(6), [5]])
@pytest.mark.parametrize("start", [1200, 2450])
def test_channels_that_repeat_are_seen_to_the_row(step, to_the_end, channels, start):
    shown, air = values(0.3, step)
    stop = len(shown) if to_the_end else start + 900
    rows = (np.arange(len(shown)) > start) & (np.arange(len(shown)) < stop)
    shown[rows[:, None] & np.isin(np.arange(6), channels)] = np.tile(shown[start, list(channels)], rows.sum())
    if len(channels) > 1:
        air = air | rows
    found = of_all(gaps(shown, air, moving(len(shown))), len(shown))
    # the row after the last may have the same value by chance
    assert (found != rows).sum() <= 1
    at_rest = gaps(shown, air, np.zeros((len(shown), 7)))
    assert at_rest == []


@pytest.mark.parametrize("code", [9999.0, -1e3])
def test_an_error_code_is_left_out_from_its_first_row(code):
    shown, air = values(0.3, 1e-9)
    rows = (np.arange(len(shown)) >= 1200) & (np.arange(len(shown)) < 1500)
    shown[rows] = code
    assert np.array_equal(of_all(gaps(shown, air & ~rows, moving(len(shown))), len(shown)), rows)


STOPPED = {
    "rounded by another program": lambda shown, rows: (
        shown * (1 + 1e-13 * np.random.default_rng(5).normal(size=shown.shape))
    ),
    "a drift taken off": lambda shown, rows: shown - 1e-3 * np.arange(len(shown))[:, None],
    "a line across the gap": lambda shown, rows: np.where(
        rows[:, None], np.linspace(shown[rows][0], shown[rows][0] + 9, len(shown)), shown
    ),
    "each value twice": lambda shown, rows: np.where(rows[:, None], shown, shown[np.arange(len(shown)) // 2 * 2]),
}


@pytest.mark.parametrize("done", STOPPED)
def test_a_sensor_that_stopped_is_seen_whatever_was_done_to_its_rows(done):
    shown, air = values(0.3, 1e-9)
    rows = np.arange(len(shown)) > 2500
    shown[rows] = shown[2500]
    shown = STOPPED[done](shown, rows)
    found = [gap for gap in gaps(shown, air | rows, moving(len(shown))) if not gap.every]
    assert (of_all(found, len(shown)) != rows).sum() <= 2


def test_a_saturated_channel_is_seen_and_a_peak_is_not():
    for step in (1e-9, 0.1):
        shown, air = values(0.1, step)
        assert gaps(shown, air, moving(len(shown))) == []
        limit = step * np.round(0.8 * shown[:, 0].max() / step)
        at = shown[:, 0] >= limit
        shown[:, 0] = np.minimum(shown[:, 0], limit)
        (found,) = gaps(shown, air, moving(len(shown)))
        assert (found.channel, found.saturated, found.value) == (0, True, limit)
        np.testing.assert_array_equal(found.rows, np.flatnonzero(at))


@pytest.mark.slow
def test_jumps_of_the_zero_are_found_to_the_row():
    for seed in range(8):
        draw = np.random.default_rng(seed)
        shown = np.tile(values(0.3, 1e-9, seed=seed)[0], (2, 1))
        at = np.sort(draw.choice(np.arange(600, 7400), 2, replace=False))
        sizes = draw.choice([-1, 1], (2, 6)) * draw.uniform(6, 30, (2, 6))
        assert jumps_of(shown, np.ones(len(shown), dtype=bool)) == []
        moved = shown + sum(
            np.where(np.arange(len(shown)) >= row, 1, 0)[:, None] * size for row, size in zip(at, sizes, strict=True)
        )
        found = jumps_of(moved, np.ones(len(shown), dtype=bool))
        assert [jump.stop for jump in found] == at.tolist()
        assert np.abs(moved - steps_of(found, len(moved)) - shown).max() < 2  # of blocks that are not all air


def test_poses_that_a_logger_holds_are_interpolated_and_stops_are_not():
    count, every = 3000, 10
    shown = values(0.3, 1e-9, count)[0]
    position = np.stack([-1e-4 * np.arange(count), np.zeros(count), np.zeros(count)], axis=1)
    quaternion = np.tile([1.0, 0, 0, 0], (count, 1))
    assert held_poses(position, quaternion, shown, 0.06) is None
    step = np.arange(count) // every * every
    found = held_poses(position[step], quaternion, shown, 0.06)
    assert found.every == every
    assert np.abs(found.position - position)[: count - every].max() < 1e-12
    # a clamp that stops for each reading has the same wrench, but for noise, in each of them
    stopped = shown[step] + 0.3 * np.random.default_rng(1).standard_normal(shown.shape)
    assert held_poses(position[step], quaternion, stopped, 0.06) is None
    # a logger that stops twice
    lost = np.zeros(count, dtype=bool)
    lost[501:700] = lost[1801:2200] = True
    found = held_poses(kept(position, lost), quaternion, shown, 0.06)
    np.testing.assert_array_equal(found.stale, np.flatnonzero(lost))


def test_sweeps_are_cut_where_rows_were_not_measured():
    sweep = np.array([7, 7, 7, 7, 7, 7, -1, -1, -1, 3, 3, 3, 3])
    measured = np.array([0, 1, 0, 0, 1, 1, 1, 0, 1, 1, 1, 0, 1], dtype=bool)
    assert parts(sweep, measured)[measured].tolist()[:2] != [7, 7]
    found = parts(sweep, measured)
    assert found[[1, 6, 8, 9, 10]].tolist() == [7, -1, -1, 3, 3]
    assert found[4] == found[5] not in (7, 3, found[12])
    assert found[12] not in (7, 3)


# --- logs and recordings ---

# Logs of all faults but zeros, which are another sensor that stopped; and recordings of those that are not read alike.
BOTH = ["none", "stopped", "saturated", "jumps", "held"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "of_log"),
    [
        pytest.param(name, of_log, marks=() if name in BOTH or (of_log and name != "zeros") else pytest.mark.trust)
        for name in FAULTS
        for of_log in (True, False)
    ],
)
def test_a_fault_at_random_is_named_and_nothing_certified_is_false(name, of_log, undiagnosed):
    found = outcome(SEED, name, of_log)
    assert found.false == []
    if name == "none":
        assert (found.said, found.certified) == ("", True)
    elif name == "coarse":
        assert not found.named, found.said
    elif name != "jumps" or of_log:  # whose cause the diagnosis names
        assert found.named, found.said


@pytest.mark.slow
def test_steps_that_taring_hides_are_stated(log):
    """Of a sensor whose steps are ten times its noise, the air tells little of the errors in contact, and these are shared."""
    _, logged_ = log
    rows = rows_of(logged_)
    fine = imported(logged_, rows)[0]
    step = 10 * np.repeat([fine.noise_force_N, fine.noise_moment_Nm], 3)
    coarse = imported(logged_, rows._replace(wrench=step * np.round(rows.wrench / step)))[0]
    assert (fine.noise_independent, coarse.noise_independent) == (True, False)
    assert coarse.noise.force_N >= 0.99 * step[0] / 12**0.5
    assert coarse.noise.moment_Nm >= 0.99 * step[3] / 12**0.5


@pytest.mark.slow
def test_a_log_of_which_only_repeated_rows_can_be_read_is_refused(log):
    """The places before the sensor stopped are none: what is left of the log was not measured."""
    rows = rows_of(log[1])
    stopped = np.arange(len(rows.pose)) > len(rows.pose) // 2
    pose = np.where(stopped[:, None], rows.pose, 1e200)
    with pytest.raises(InputError, match=r"no row that was measured: .*the sensor stopped"):
        imported(log[1], Rows(pose, kept(rows.wrench, stopped)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("named", "zero"),
    [(True, True), (False, False), *(pytest.param(on, not on, marks=pytest.mark.trust) for on in (True, False))],
)
def test_sweeps_of_a_sensor_that_stopped_are_not_empty(log, named, zero):
    """The highest slice that was touched, after the sensor stopped in it: the body does not end below."""
    mesh, logged_ = log
    rows = rows_of(logged_)
    right, _ = imported(logged_, rows)
    cloud = analyse(right, None, "hull", "planar").cloud
    top = np.unique(cloud.sweep[cloud.slice == cloud.slice[cloud.points[:, 2].argmax()]])
    lost = np.isin(logged_.sweep, top)
    wrench = np.where(lost[:, None], 0.0, rows.wrench) if zero else kept(rows.wrench, lost)
    recording, notes = imported(logged_, rows._replace(wrench=wrench), named)
    assert any("the sensor stopped" in note for note in notes)
    analysis = analyse(recording, mesh, "hull", "planar")
    assert analysis.warnings == ()
    assert false_statements(mesh, analysis) == []


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["quaternion", "matrix", "euler", "pose"])
def test_inverse_orientations_are_named_and_read(log, kind):
    _, logged_ = log
    turn = Rotation.from_quat(logged_.quaternion, scalar_first=True)
    place, back = logged_.position_m, turn.inv()
    if kind == "pose":
        place = -back.apply(place)
    values = {"matrix": lambda: back.as_matrix().reshape(-1, 9), "euler": lambda: back.as_euler("xyz", degrees=True)}
    values = values.get(kind, lambda: back.as_quat(scalar_first=True))()
    names = [f"o{k}" for k in range(values.shape[1])]
    columns = np.hstack([logged_.time_s[:, None], place, values, logged_.wrench])
    table = Table("log.csv", ("t", "x", "y", "z", *names, *NAMES[8:]), tuple(columns.T))

    def a_map(**more):
        sections = si_map(ROD, tare={"air": "auto"})
        orientation = {"quaternion" if kind == "pose" else kind: names, **more}
        sections["columns"] = sections["columns"] | {"time": "t", "orientation": orientation}
        del sections["columns"]["sweep"]
        sections["units"]["time"] = "s"
        if kind == "pose" and more:
            sections["columns"]["position_in"] = "inverse"
        return read_map(sections)

    try:
        said = " ".join(convert(table, a_map()).summary.notes)
    except InputError as error:
        said = str(error)
    assert "of the world in the clamp's frame" in said
    found = convert(table, a_map(of="world"))
    assert not any("of the rows in contact" in note for note in found.summary.notes)
    rows = found.log.row[found.kept]
    np.testing.assert_allclose(found.recording.position_m, logged_.position_m[rows], atol=1e-12)


def test_a_table_of_one_sweep_leaves_repeated_rows_out():
    draw, count = np.random.default_rng(3), 400
    x0 = np.linspace(0.6, 0.0, count)
    shape = np.clip(np.linspace(-1, 1, count), 0, None)
    reactions = [column + 1e-4 * draw.standard_normal(count) for column in (-1.5 * shape, 0.2 * shape, 1.1 * shape)]
    noise = dict(noise_force=1e-4, noise_moment=1e-4)
    right = reconstruct_sweep(OneSweep(x0, *reactions, **noise))
    assert right.unmeasured == ()
    for column in reactions:
        column[321:] = column[320]
    found = reconstruct_sweep(OneSweep(x0, *reactions, **noise))
    (words,) = found.unmeasured
    assert "the sensor stopped" in words
    assert not found.touching[321:].any()
    np.testing.assert_array_equal(found.touching[:321], right.touching[:321])
