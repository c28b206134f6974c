"""Sessions and `scan3d next`: further sweeps where what was measured leaves most room, until the bound is small enough."""

import json
from dataclasses import replace

import numpy as np
import pytest
from rigs import in_world
from scipy.spatial.transform import Rotation
from small_scans import CUBE, EGG

import scan3d
from scan3d import InputError, Rod, Session
from scan3d.cli import main
from scan3d.files.recordings import POSE_COLUMNS, read_poses
from scan3d.geometry.distance import distances, segments_meet
from scan3d.geometry.hulls import distance_from_hull, hull
from scan3d.poses import Move
from scan3d.session import around_contacts
from scan3d.simulation.rig import simulate_rig, standing

pytestmark = pytest.mark.slow

HULL = ("--method", "hull", "--quiet")


@pytest.fixture(scope="module")
def egg():
    return standing(scan3d.load_mesh(EGG))


def recorded(mesh, poses):
    return simulate_rig(mesh, poses, friction=(0.3, 0.3)).recording()


@pytest.fixture(scope="module")
def batches(egg):
    """A planar session after three batches, with its bounds after each."""
    session, bounds = Session("cylinder:60x60", slices=5, samples=32), []
    for _ in range(3):
        session.tell(recorded(egg, session.ask(16)))
        bounds.append(session.relative_bound)
    return session, bounds


def test_the_bound_shrinks_and_holds(batches, egg):
    session, bounds = batches
    assert bounds[1] < 0.75 * bounds[0]
    assert bounds[2] < bounds[0]
    assert session.warnings == ()
    assert scan3d.compare(session.surface, egg).hausdorff < session.certificate.bound
    assert distances(session.cloud.points, egg).max() < 1e-9 * 60
    assert session.surface.is_watertight


def test_further_sweeps_lie_where_none_were(batches):
    session, _ = batches
    heights = np.unique(np.round(1000 * session.recording.position_m[:, 2], 6))
    poses = session.ask(8)
    rows = np.concatenate(poses.sweeps())
    new = np.unique(np.round(1000 * poses.position_m[rows, 2], 6))
    assert len(set(new) - set(heights)) >= 1
    assert poses.sweep.min() == session.recording.sweep.max() + 1
    assert len(poses.sweeps()) <= 16
    # asking changes nothing
    assert (session.ask(8).position_m == poses.position_m).all()


def test_a_session_in_space(egg):
    session = Session("cylinder:60x60", model="spatial", slices=8, samples=32, seed=3)
    session.tell(recorded(egg, session.ask()))
    before = session.relative_bound
    session.tell(recorded(egg, session.ask(16)))
    assert session.relative_bound < before
    assert session.cloud.model == "spatial"
    assert scan3d.compare(session.surface, egg).hausdorff < session.certificate.bound


def test_recordings_with_their_own_numbers_are_numbered_anew(egg):
    session = Session("cylinder:60x60", slices=3, samples=20)
    first = recorded(egg, session.ask())
    session.tell(first)
    session.tell(first)
    count = len(np.unique(first.sweep))
    assert len(np.unique(session.recording.sweep)) == 2 * count
    assert (session.recording.sweep[len(first) :] == first.sweep + count).all()


def test_what_a_session_refuses(egg):
    session = Session("cylinder:60x60", slices=3, samples=20)
    with pytest.raises(InputError, match="there is no recording yet"):
        session.surface  # noqa: B018
    recording = recorded(egg, session.ask())
    with pytest.raises(InputError, match="the session is in mm, and the recording in m"):
        session.tell(replace(recording, unit="m"))
    session.tell(recording)
    with pytest.raises(InputError, match="another rod than those before"):
        session.tell(replace(recording, rod=Rod(0.06, 1e-4)))
    low = Session("cylinder:60x60")
    low.tell(replace(recording, position_m=recording.position_m - [0, 0, 0.01]))
    with pytest.raises(InputError, match="where the table is at 0 mm; move the frame"):
        low.ask()


def test_a_bounding_body_of_contacts(egg, batches):
    session, _ = batches
    body = around_contacts(session.recording, "planar")
    x, y, z = session.cloud.points.T
    assert np.hypot(x, y).max() <= body.width / 2
    assert 0 <= z.min() <= z.max() <= body.height
    assert body.sizes[0] == pytest.approx(1.1 * 42.3, rel=0.03)
    with pytest.raises(InputError, match=r"stands on z = 0 .*contacts lie down to z = "):
        around_contacts(scan3d.simulate(scan3d.load_mesh(EGG), scan3d.Plan(slices=4)), "planar")
    # what noise explains lies on the table
    cube = standing(scan3d.load_mesh(CUBE))
    plan = scan3d.Plan(slices=6, sweeps=8, samples=24, axis="x", noise=1e-4)
    noisy = scan3d.simulate(cube, plan)
    assert scan3d.reconstruct(noisy).points[:, 2].min() < -0.01
    assert around_contacts(noisy, "planar").height == pytest.approx(1.1 * np.ptp(cube.vertices[:, 2]), rel=0.02)


def test_next_gives_poses_until_the_tolerance_is_met(egg, rig_folder, tmp_path, capsys, no_pictures):
    assert main(["reconstruct", str(rig_folder / "log.csv"), "--out", str(tmp_path / "first"), *HULL]) == 0
    run = ["next", str(tmp_path / "first"), "--out", str(tmp_path / "p.csv")]
    assert main([*run, "--json", "--samples", "40"]) == 0
    data = json.loads(capsys.readouterr().out)
    poses = read_poses(tmp_path / "p.csv")
    assert data["sweeps"] == len(poses.sweeps()) > 0
    # the bounding body is that of the plan, in the unit of the recording
    assert data["around"] == "cylinder:60x60"
    in_m, planned = egg.copy().apply_scale(1e-3), read_poses(rig_folder / "poses.csv")
    assert simulate_rig(in_m, planned, unit="m").source["around"] == "cylinder:0.06x0.06"
    assert poses.sweep.min() == 20
    # the rows of the next log go on the earlier one
    log = tmp_path / "log.csv"
    assert main(["simulate", str(EGG), "--poses", str(tmp_path / "p.csv"), "--out", str(log), "--quiet"]) == 0
    lines = log.read_text().splitlines(keepends=True)
    log.write_text((rig_folder / "log.csv").read_text() + "".join(lines[1:]))
    assert main(["reconstruct", str(log), "--out", str(tmp_path / "out"), *HULL]) == 0
    again = ["next", str(tmp_path / "out"), "--out", str(tmp_path / "p2.csv")]
    assert main([*again, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["bound"] < data["bound"]
    assert main([*again, "--tolerance", "0.5"]) == 0
    assert (tmp_path / "p2.csv").read_text() == ",".join(POSE_COLUMNS) + "\n"
    assert "0 further sweeps" in capsys.readouterr().out


def check_clear(poses, session):
    """Clamp and straight rod stay above the floor, and clear of the contacts' hull but where the rod sweeps."""
    space, known, axes = session.plan.space(), hull(session.cloud.points), poses.axes()
    place, length = 1000 * poses.position_m, space.length
    tips = place + length * axes[:, 1]
    assert min(place[:, 2].min(), tips[:, 2].min()) >= space.floor - 1e-6
    assert distance_from_hull(session.cloud.points)(place).min() > 0.1 * length
    moved = poses.move != Move.SWEEP
    assert not segments_meet(known, place[moved], axes[moved, 1], length).any()
    # between two poses the rod moves parallel to itself, or turns in one place
    along = (moved[:-1] | moved[1:]) & (np.abs(np.diff(axes[:, 1], axis=0)).max(axis=1) < 1e-9)
    for part in np.linspace(0, 1, 9):
        between = place[:-1] + part * np.diff(place, axis=0)
        assert (
            min((between[along] + length * axes[:-1][along, 1])[:, 2].min(), between[:, 2].min()) >= space.floor - 1e-6
        )
        backwards = along & (moved[:-1] & moved[1:])
        assert not segments_meet(known, between[backwards], axes[:-1][backwards, 1], length).any()


ROD = Rod.of_length(0.08).without_thickness()
AXES = {"x": (1, 0, 0), "down": (0, 0, -1), "oblique": (0.3, -0.2, 1), "level and oblique": (1, 2, 0), "two": None}


@pytest.mark.parametrize(
    "axis", [pytest.param(axis, marks=() if axis in ("oblique", "two") else pytest.mark.trust) for axis in AXES]
)
def test_further_poses_follow_the_frames_of_the_recording_above_the_floor(egg, axis):
    plan = scan3d.Plan(slices=4, samples=16, axis="xz" if axis == "two" else AXES[axis], rod=ROD)
    recording = scan3d.simulate(egg, plan)
    session = Session("cylinder:60x60", rod=recording.rod, samples=16, floor=1.0)
    session.tell(recording)
    poses = session.ask(16)
    check_clear(poses, session)
    of_slices = np.unique(np.round(recording.axes()[:, 2], 9), axis=0)
    for rows in poses.sweeps():
        assert np.abs(of_slices - poses.axes()[rows[0], 2]).max(axis=1).min() < 1e-8
    # they touch the body where they are told to
    session.tell(recorded(egg, poses))
    assert distances(session.cloud.points, egg).max() < 1e-6


def test_further_poses_in_a_log_that_is_turned_and_shifted(egg):
    """They keep away from what is known; where the bounding body or the table is elsewhere, there is a sentence."""
    recording = scan3d.simulate(egg, scan3d.Plan(slices=5, samples=24, rod=ROD))
    session = Session("cylinder:80x70", rod=recording.rod, samples=24)
    session.tell(in_world(recording, Rotation.from_rotvec((0.12, -0.1, 0.7)), (0.004, -0.003, 0.008)))
    check_clear(session.ask(12), session)
    elsewhere = Session("cylinder:60x60", rod=recording.rod)
    elsewhere.tell(in_world(recording, Rotation.from_rotvec((0, 0, 0.3)), (0.04, 0.0, 0.0)))
    with pytest.raises(InputError, match=r"contacts lie up to .* outside of the bounding body cylinder:60x60"):
        elsewhere.ask()


def test_next_writes_no_file_where_no_sweep_stays_above_the_floor(egg, tmp_path, capsys, no_pictures):
    plan = scan3d.Plan(slices=3, samples=16, axis="x", rod=Rod.of_length(0.08))
    scan3d.write_recording(scan3d.simulate(egg, plan), tmp_path / "log.csv")
    assert main(["reconstruct", str(tmp_path / "log.csv"), "--out", str(tmp_path / "x"), *HULL]) == 0
    run = ["next", str(tmp_path / "x"), "--out", str(tmp_path / "p.csv"), "--around", "cylinder:60x60"]
    assert main([*run, "--floor", "59"]) == 1
    assert "stay above z = 59" in capsys.readouterr().err
    assert not (tmp_path / "p.csv").exists()
    assert main(run) == 0
    assert read_poses(tmp_path / "p.csv").position_m[:, 2].min() > 0
