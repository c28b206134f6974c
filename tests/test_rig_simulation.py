"""The rig that is computed: exact without faults, and each fault with the size that its file says."""

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from rigs import FAULTS
from scipy.spatial.transform import Rotation
from small_scans import CUBE, EGG

import scan3d
from scan3d import InputError, Rod
from scan3d.cli import main
from scan3d.files.recordings import read_poses
from scan3d.geometry.distance import distances
from scan3d.geometry.hulls import hull
from scan3d.planning.rig import RigPlan, parse_envelope, plan_poses
from scan3d.poses import Move, PoseList
from scan3d.rigs import axes_of
from scan3d.simulation.rig import (
    BETWEEN,
    Faults,
    Place,
    Size,
    kept,
    lagged,
    logged_positions,
    measured,
    pink_noise,
    read_faults,
    simulate_rig,
    standing,
    true_rod,
)

ROWS = 20000


@pytest.fixture(scope="module")
def egg():
    return standing(scan3d.load_mesh(EGG))


def planned(model, **settings):
    return plan_poses(
        RigPlan(parse_envelope("cylinder:50x60"), model=model, **{**dict(slices=5, samples=48), **settings})
    )


def faulty(**faults):
    """A log of forces and moments of unit size in x and z, as a sensor with these faults shows it."""
    force, moment = np.zeros((ROWS, 3)), np.zeros((ROWS, 3))
    force[:, 0], moment[:, 2] = 2.0, 0.5
    return measured(force, moment, Faults(**faults)) - np.concatenate([force, moment], axis=1)


@pytest.mark.slow
def test_contacts_in_space_lie_on_the_fattened_body():
    mesh = standing(scan3d.load_mesh(CUBE))
    poses = plan_poses(RigPlan(parse_envelope("cylinder:60x60"), model="spatial", sweeps=5, samples=40))
    log = simulate_rig(mesh, poses, friction=(0.2, 0.2))
    cloud = scan3d.reconstruct(log.recording())
    assert len(cloud) > 50
    length, radius = 1000 * log.rod.length_m, 500 * log.rod.diameter_m
    assert np.abs(distances(cloud.centre_points, mesh) - radius).max() < 1e-9 * length


@pytest.mark.slow
def test_the_planar_rig_is_the_planar_scan(egg):
    """The same sweeps as in a simulated scan give the same reactions."""
    plan = scan3d.Plan(slices=3, sweeps=4, samples=20, friction=0.3)
    scan = scan3d.simulate(egg, plan)
    touching = np.array([np.abs(scan.force_N[scan.sweep == k]).max() > 0 for k in np.unique(scan.sweep)])
    rows = np.flatnonzero(touching[scan.sweep])
    # each sweep begins a little before its touch-down
    x = scan.axes()[:, 0]
    position = scan.position_m.copy()
    first = rows[np.flatnonzero(np.diff(scan.sweep[rows], prepend=-1))]
    position[first] += 1e-6 * x[first]
    poses = PoseList(
        scan.sweep[rows], position[rows], scan.quaternion[rows], np.full(len(rows), int(Move.SWEEP)), rod=scan.rod
    )
    log = simulate_rig(egg, poses, friction=(0.3, 0.3))
    other = ~np.isin(rows, first)
    scale = np.abs(scan.force_N).max()
    # at the last sample of a sweep rounding decides whether the rod has snapped off
    last = np.append(np.diff(scan.sweep[rows]) > 0, True)
    np.testing.assert_allclose(log.wrench[other & ~last, :2], scan.force_N[rows[other & ~last]], atol=1e-9 * scale)
    np.testing.assert_allclose(log.wrench[other & ~last, 5], scan.moment_Nm[rows[other & ~last]], atol=1e-9 * scale)


@pytest.mark.slow
def test_a_rod_that_is_in_the_way_is_reported(egg):
    poses = planned("planar")
    with pytest.raises(InputError, match=r"the rod lies in the body where \d+ of 24 sweeps begin, first sweep \d+: "):
        simulate_rig(hull(2.5 * egg.vertices), poses)
    # sweeps that end while the rod is bent
    kept_rows = (poses.move != Move.SWEEP) | (np.arange(len(poses)) % 50 < 22)
    short = replace(poses, **{k: getattr(poses, k)[kept_rows] for k in ("sweep", "position_m", "quaternion", "move")})
    log = simulate_rig(egg, short)
    assert any("sweeps end in contact" in text for text in log.warnings)
    assert any("in approach or retract" in text for text in log.warnings)


def test_sweeps_are_straight(egg):
    poses = planned("planar")
    position = poses.position_m.copy()
    position[poses.sweeps()[2][10:], 2] += 0.003
    with pytest.raises(InputError, match="unlike in sweep 2; give --model spatial"):
        simulate_rig(egg, replace(poses, position_m=position))
    quaternion = poses.quaternion.copy()
    quaternion[poses.sweeps()[2][10:]] = [1.0, 0.0, 0.0, 0.0]
    quaternion[poses.sweeps()[2][:10]] = [0.0, 1.0, 0.0, 0.0]
    for model in ("planar", "spatial"):
        with pytest.raises(InputError, match="the clamp does not turn, unlike in sweep 2; cut it"):
            simulate_rig(egg, replace(poses, quaternion=quaternion), model=model)


def test_logs_have_the_rate_and_the_poses_of_the_plan(egg):
    poses = planned("planar", slices=2)
    log = simulate_rig(egg, poses, faults=Faults(rate_hz=100.0, speed_mm_s=50.0))
    np.testing.assert_allclose(np.diff(log.time_s), 0.01)
    times = replace(poses, speed_m_s=0.05).times()
    assert log.time_s[-1] == pytest.approx(times[-1], abs=0.01)
    for k in range(3):
        np.testing.assert_allclose(
            log.position_m[:, k], np.interp(log.time_s, times, poses.position_m[:, k]), atol=1e-12
        )
    assert np.linalg.norm(log.quaternion, axis=1) == pytest.approx(1)
    assert set(log.sweep) == {BETWEEN, *poses.sweep}
    steps = np.linalg.norm(np.diff(log.position_m, axis=0), axis=1)
    assert steps.max() <= 0.05 * 0.01 * (1 + 1e-9)
    # turns are steady, with the rod's tip at the speed of the clamp
    turns = Rotation.from_quat(log.quaternion, scalar_first=True)
    assert (turns[:-1].inv() * turns[1:]).magnitude().max() * poses.rod.length_m <= 0.05 * 0.01 * (1 + 1e-9)
    with pytest.raises(InputError, match="a log with faults is no recording"):
        log.recording()


@pytest.mark.slow
def test_the_true_rod_differs_from_the_nominal_one(egg):
    poses = planned("planar", slices=2)
    true, wrong = (
        simulate_rig(egg, poses, faults=Faults(rate_hz=50.0, **errors))
        for errors in ({}, {"stiffness_error": 0.1, "length_error": 0.0})
    )
    assert wrong.rod == true.rod == poses.rod
    np.testing.assert_allclose(wrong.wrench, 1.1 * true.wrench, rtol=1e-9, atol=1e-15)
    longer = simulate_rig(egg, poses, faults=Faults(rate_hz=50.0, length_error=0.05))
    assert (longer.wrench != 0).any(axis=1).sum() > (true.wrench != 0).any(axis=1).sum()


@pytest.mark.parametrize(
    "more",
    [
        {"curvature_per_m": 2.0},
        {"diameter_m": ((0.0, 6e-4), (0.06, 2e-4))},
        {"bending_stiffness_Nm2": ((0.0, 1e-4), (0.03, 3e-4), (0.06, 1e-4))},
        {"clamp_compliance_rad_per_Nm": 100.0},
        {"weight_N": 1e-3},
    ],
    ids=lambda more: next(iter(more)),
)
def test_the_true_rod_is_all_that_the_nominal_one_is(egg, more):
    """With any faults it was straight, uniform and weightless in a rigid clamp."""
    rod = Rod(**{"length_m": 0.06, "bending_stiffness_Nm2": 1e-4} | more)
    poses, faults = planned("planar", slices=1, sweeps=1, samples=64, rod=rod), Faults(rate_hz=200.0)
    if rod.weight_N:
        for given in (None, faults):
            with pytest.raises(InputError, match="weight"):
                simulate_rig(egg, poses, faults=given)
        return
    exact, logged = (simulate_rig(egg, poses, faults=given) for given in (None, faults))
    for channel in (0, 1, 5):
        shown = exact.wrench[:, channel]
        off = np.interp(exact.time_s, logged.time_s, logged.wrench[:, channel]) - shown
        assert np.median(np.abs(off[shown != 0] / shown[shown != 0])) < 1e-3
    true = true_rod(rod, Faults(length_error=0.1, stiffness_error=0.2))
    assert true.profile == rod.profile
    assert (true.length_m, true.bending_stiffness_Nm2) == pytest.approx((0.066, 1.2e-4))
    assert true.curvatures == rod.curvatures


def test_rows_without_an_equilibrium_are_left_out_and_are_not_free():
    """They were logged as rows in the air, in which the rod passed through the body."""
    body, rod = standing(trimesh.creation.icosphere(3, 20.0)), Rod(0.06, 1e-4, curvature_per_m=8.0)
    poses = plan_poses(RigPlan(parse_envelope("sphere:70"), slices=2, sweeps=2, samples=80, clearance=0.1, rod=rod))
    exact, logged = simulate_rig(body, poses), simulate_rig(body, poses, faults=Faults(rate_hz=50.0))
    turn = 0.48 * np.linspace(0, 1, 200)
    free = 60 * np.stack([(np.cos(turn) - 1) / 0.48, np.sin(turn) / 0.48, 0 * turn], axis=1)
    for log in (exact, logged):
        assert any("rows are left out" in text for text in log.warnings)
        rows = (log.move == Move.SWEEP) & ~log.wrench.any(axis=1)
        places = 1000 * log.position_m[rows, None] + free @ axes_of(log.quaternion[rows])
        assert np.linalg.norm(places - [0, 0, 20], axis=2).min() > 19.7  # of the facets
        assert log.wrench[log.move == Move.SWEEP].any()
    # rows that follow are another sweep
    swept = exact.recording()
    assert len(np.unique(swept.sweep)) > len(poses.sweeps())
    steps = np.linalg.norm(np.diff(swept.position_m, axis=0), axis=1)[np.diff(swept.sweep) == 0]
    assert steps.max() < 1.01 * np.median(steps)


def test_a_sensor_shows_the_wrench_in_its_frame():
    random = np.random.default_rng(0)
    force, moment = random.standard_normal((2, 5, 3))
    frame = Place(position_mm=(5.0, -20.0, 3.0), euler_deg=(10.0, 30.0, -50.0))
    shown = measured(force, moment, Faults(sensor=frame))
    # back to the clamp: the turn, and the moment of the force about the clamp
    turn = Rotation.from_euler("xyz", [10, 30, -50], degrees=True)
    at_clamp = turn.apply(shown[:, :3])
    np.testing.assert_allclose(at_clamp, force, atol=1e-14)
    arm = np.array([0.005, -0.02, 0.003])
    np.testing.assert_allclose(turn.apply(shown[:, 3:]) + np.cross(arm, at_clamp), moment, atol=1e-14)
    assert (measured(force, moment, Faults(sensor=frame, shows="rod-on-clamp")) == -shown).all()


def test_bias_and_linear_drift_have_their_sizes():
    bias, drift = faulty(bias=Size(fraction=0.05), seed=4), faulty(drift=Size(force_N=0.3, moment_Nm=0.02))
    for row, force, moment in ((bias[0], 0.05 * 2, 0.05 * 0.5), (drift[-1], 0.3, 0.02)):
        assert (np.linalg.norm(row[:3]), np.linalg.norm(row[3:])) == pytest.approx((force, moment))
    assert np.ptp(bias, axis=0).max() < 1e-12
    assert (drift[0] == 0).all()
    np.testing.assert_allclose(drift[ROWS // 2], drift[-1] / 2, rtol=1e-3)
    given = faulty(bias_force_N=(1.0, 2.0, 3.0), bias_moment_Nm=(0.1, 0.2, 0.3))
    np.testing.assert_allclose(given[7], [1, 2, 3, 0.1, 0.2, 0.3])


def test_a_random_walk_has_steps_of_its_size():
    walk = faulty(drift=Size(force_N=0.3), drift_kind="random-walk")
    assert (walk[0] == 0).all()
    steps = np.diff(walk[:, :3], axis=0)
    assert np.sqrt(3 * len(steps)) * steps.std() == pytest.approx(0.3, rel=0.02)
    assert np.abs(np.corrcoef(steps[:-1].T, steps[1:].T)[:3, 3:]).max() < 0.05


def test_noise_jitter_and_steps_have_their_sizes():
    noise = faulty(noise=Size(fraction=0.01))
    assert noise[:, :3].std(axis=0) == pytest.approx(0.02, rel=0.03)
    assert noise[:, 3:].std(axis=0) == pytest.approx(0.005, rel=0.03)
    assert abs(noise.mean(axis=0)).max() < 4 * 0.02 / np.sqrt(ROWS)
    assert np.abs(np.corrcoef(noise.T) - np.eye(6)).max() < 0.04
    assert faulty(noise=Size(force_N=0.1))[:, :3].std() == pytest.approx(0.1, rel=0.03)
    values = faulty(noise=Size(fraction=0.01), quantum=Size(force_N=0.004)) + np.array([2, 0, 0, 0, 0, 0.5])
    np.testing.assert_allclose(values[:, :3] / 0.004, np.round(values[:, :3] / 0.004), atol=1e-9)
    assert len(np.unique(values[:, 0])) < 60
    assert len(np.unique(values[:, 5])) == ROWS
    place = np.tile([0.1, 0.2, 0.3], (ROWS, 1))
    assert (logged_positions(place, Faults(jitter_um=20.0)) - place).std(axis=0) == pytest.approx(20e-6, rel=0.03)
    steps = logged_positions(place, Faults(jitter_um=20.0, quantum_um=5.0)) / 5e-6
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)


def test_pink_noise_falls_with_the_frequency():
    logs = [pink_noise(4096, np.random.default_rng(k)) for k in range(200)]
    power = np.mean([np.abs(np.fft.rfft(log)) ** 2 for log in logs], axis=0)
    frequency = np.arange(1, 2048)
    slope = np.polyfit(np.log(frequency[3:]), np.log(power[4:2048]), 1)[0]
    assert slope == pytest.approx(-1, abs=0.03)
    assert np.mean([log.var() for log in logs]) == pytest.approx(1, rel=0.05)
    assert faulty(pink=Size(force_N=0.1))[:, :3].std() == pytest.approx(0.1, rel=0.3)


def test_a_lag_is_seen_by_cross_correlation():
    rate, lag, clock = 1000.0, 8.0, 30.0
    signal = np.cumsum(np.random.default_rng(2).standard_normal(ROWS))
    signal = (signal - np.convolve(signal, np.ones(500) / 500, "same"))[:, None]
    step = np.zeros((ROWS, 1))
    step[1000:] = 1.0
    settled = lagged(step, Faults(rate_hz=rate, lag_ms=lag))[:, 0]
    # after one time constant a low-pass of the first order has come to 1 - 1/e
    assert np.argmax(settled > 1 - np.exp(-1)) - 1000 == pytest.approx(lag, abs=1)
    for faults, expected in ((Faults(clock_ms=clock), clock), (Faults(lag_ms=lag, clock_ms=clock), lag + clock)):
        late = lagged(signal, faults)[:, 0]
        match = [np.corrcoef(signal[: ROWS - 100, 0], late[k : ROWS - 100 + k])[0, 1] for k in range(80)]
        assert int(np.argmax(match)) == pytest.approx(expected, abs=3)


@pytest.mark.parametrize("gap", [0.0, 10.0])
def test_rows_are_lost(gap):
    lost = ~kept(ROWS, Faults(missing=0.05, gap_ms=gap))
    assert lost.mean() == pytest.approx(0.05, rel=0.3)
    runs = np.diff(np.flatnonzero(np.diff(np.concatenate([[0], lost, [0]]))))[::2]
    assert np.median(runs) == max(gap, 1)
    assert not lost[[0, -1]].any()


def test_files_of_faults_are_read(tmp_path):
    (tmp_path / "f.toml").write_text(FAULTS)
    faults = read_faults(tmp_path / "f.toml")
    assert faults == Faults(
        seed=3,
        rate_hz=40.0,
        sensor=Place((0.0, -20.0, 0.0), (0.0, 30.0, 0.0)),
        nominal=Place((0.0, -19.0, 0.0)),
        shows="rod-on-clamp",
        bias=Size(fraction=0.05),
        drift=Size(fraction=0.01),
        drift_kind="random-walk",
        noise=Size(fraction=0.002),
        pink=Size(force_N=0.001),
        quantum=Size(force_N=1e-4),
        quantum_um=1.0,
        lag_ms=5.0,
        jitter_um=20.0,
        clock_ms=-2.0,
        length_error=0.001,
        stiffness_error=-0.02,
        missing=0.001,
        gap_ms=50.0,
    )
    (tmp_path / "none.toml").write_text("")
    assert read_faults(tmp_path / "none.toml") == Faults()


@pytest.mark.slow
def test_an_exact_log_is_a_recording(rig_folder, egg):
    recording = scan3d.read_recording(rig_folder / "log.csv")
    poses = read_poses(rig_folder / "poses.csv")
    rows = np.concatenate(poses.sweeps())
    assert (recording.position_m == poses.position_m[rows]).all()
    assert (recording.sweep == poses.sweep[rows]).all()
    assert recording.rod == replace(poses.rod, diameter_m=0.0)
    assert recording.source["moved"] == [0, 0, 28]
    header, *lines = (rig_folder / "log.csv").read_text().splitlines()
    assert header == "sweep,x_m,y_m,z_m,qw,qx,qy,qz,fx_N,fy_N,mz_Nm,t_s,move"
    assert len(lines) == len(poses)
    in_the_air = [line.split(",") for line in lines if not line.endswith(",sweep")]
    assert in_the_air
    assert not any(float(value) for row in in_the_air for value in row[8:11])
    placed = scan3d.load_mesh(rig_folder / "placed.ply")
    # the body stands on the table
    low, high = egg.bounds
    np.testing.assert_allclose(placed.bounds, egg.bounds, atol=1e-12)
    np.testing.assert_allclose(low, [*-high[:2], 0], atol=1e-12)
    assert scan3d.load_mesh(EGG).bounds[0, 2] == -28
    assert distances(scan3d.reconstruct(recording).points, placed).max() < 1e-9 * 1000 * recording.rod.length_m


def test_a_log_with_faults_has_a_map_of_what_is_known(rig_folder):
    mapped = tomllib.loads((rig_folder / "raw_map.toml").read_text())
    header = (rig_folder / "raw.csv").read_text().partition("\n")[0].split(",")
    columns = mapped["columns"]
    named = [
        columns["time"],
        *columns["position"],
        *columns["orientation"]["quaternion"],
        *columns["force"],
        *columns["moment"],
    ]
    assert [*named, "sweep"] == header
    assert mapped["units"] == {"time": "s", "length": "mm", "angle": "deg", "force": "N", "moment": "N mm"}
    # the nominal frame and rod, and nothing of the faults
    assert mapped["sensor"] == {"position_mm": [0, -19, 0], "euler_deg": [0, 0, 0], "shows": "rod-on-clamp"}
    assert mapped["rod"]["length_m"] == 0.06
    assert not {"bias", "noise", "lag", "drift", "missing"} & set(mapped)
    table = np.loadtxt(rig_folder / "raw.csv", delimiter=",", skiprows=1)
    steps = np.round(np.diff(table[:, 0]) * 40)
    # rows are lost in gaps of two
    assert set(steps) <= {1, 3, 5}
    turn = Rotation.from_quat(table[:, 4:8], scalar_first=True)
    assert len(turn) == len(table)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes(rig_folder, tmp_path, capsys):
    run = ["simulate", str(EGG), "--poses", str(rig_folder / "poses.csv"), "--quiet", "--faults"]
    assert main([*run, str(rig_folder / "faults.toml"), "--out", str(tmp_path / "raw.csv")]) == 0
    for name in ("raw.csv", "raw_map.toml"):
        assert (tmp_path / name).read_bytes() == (rig_folder / name).read_bytes()
    completed = (tmp_path / "raw_map.toml").read_text() + "# by hand\n"
    (tmp_path / "raw_map.toml").write_text(completed)
    (tmp_path / "other.toml").write_text(FAULTS.replace("seed = 3", "seed = 4"))
    # what may be a rig's own log is not replaced, and the map that was completed stays for another one
    assert main([*run, str(tmp_path / "other.toml"), "--out", str(tmp_path / "raw.csv")]) == 1
    assert "raw.csv can't be recognised as written by scan3d; give --overwrite" in capsys.readouterr().err
    (tmp_path / "raw.csv").unlink()
    assert main([*run, str(tmp_path / "other.toml"), "--out", str(tmp_path / "raw.csv")]) == 0
    assert (tmp_path / "raw.csv").read_bytes() != (rig_folder / "raw.csv").read_bytes()
    assert (tmp_path / "raw_map.toml").read_text() == completed
    # the command line takes precedence over the file, for the faults as well
    other = (tmp_path / "raw.csv").read_bytes()
    (tmp_path / "raw.csv").unlink()
    assert main([*run, str(rig_folder / "faults.toml"), "--out", str(tmp_path / "raw.csv"), "--seed", "4"]) == 0
    assert (tmp_path / "raw.csv").read_bytes() == other


@pytest.mark.slow
def test_the_command_reports_what_it_wrote(rig_folder, tmp_path, capsys):
    run = ["simulate", str(EGG), "--poses", str(rig_folder / "poses.csv"), "--out", str(tmp_path / "raw.csv"), "--json"]
    assert main([*run, "--model", "spatial", "--friction", "0.0:0.2", "--rod", "steel:0.3x50"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["rows"] == len(read_poses(rig_folder / "poses.csv"))
    assert data["moved"] == [0, 0, 28]
    recording = scan3d.read_recording(tmp_path / "raw.csv")
    assert recording.six_axis
    assert recording.rod == Rod.wire(0.05, 0.0003, 210e9)
    assert recording.source["model"] == "spatial"


def test_a_log_without_contact_has_noise():
    """A log of zeros would be refused by the import, and a session may ask for sweeps that touch nothing."""
    plan = RigPlan(parse_envelope("cylinder:46x48"), slices=4, samples=16)
    poses = plan_poses(plan)
    high = replace(poses, position_m=poses.position_m + np.array([0.0, 0.0, 0.2]))
    log = simulate_rig(standing(scan3d.load_mesh(EGG)), high, faults=Faults(rate_hz=50, noise=Size(fraction=0.002)))
    rod = plan.resolved_rod()
    assert log.wrench[:, :3].std() == pytest.approx(0.002 * rod.force_unit_N, rel=0.05)
    assert log.wrench[:, 3:].std() == pytest.approx(0.002 * rod.moment_unit_Nm, rel=0.05)
