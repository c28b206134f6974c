"""Poses for an unknown body: free of the bounding body and the table outside of sweeps, and forces in bounds."""

import itertools
import json

import numpy as np
import pytest
import trimesh

import planar
from planar.elastica import bend
from scan3d import InputError, Rod
from scan3d.cli import main
from scan3d.files.recordings import POSE_COLUMNS, read_poses, write_poses
from scan3d.geometry.distance import segments_meet
from scan3d.geometry.hulls import hull
from scan3d.planning.rig import (
    FARTHEST,
    FORCE_FACTOR,
    TIP_FACTOR,
    Envelope,
    RigPlan,
    largest_force,
    parse_envelope,
    plan_poses,
)
from scan3d.poses import Move
from scan3d.simulation.felt import steps_touch
from scan3d.simulation.rig import simulate_rig, standing
from scan3d.spatial.bodies import sphere_directions

BODIES = ("cylinder:80x90", "sphere:60", "box:40x60x30", "cylinder:10x100", "box:90x20x10")
FEW = dict(slices=6, samples=9)


def planned(around, **settings):
    return plan_poses(RigPlan(parse_envelope(around), **{**FEW, **settings}))


@pytest.mark.parametrize("text", BODIES)
def test_bounding_bodies_lie_in_their_polyhedra(text):
    around = parse_envelope(text)
    assert str(around) == text
    points = around.points()
    assert points[:, 2].min() == 0
    assert points[:, 2].max() == pytest.approx(around.height, rel=0.02)
    random = np.random.default_rng(1)
    inside = random.uniform([-60, -60, 0], [60, 60, 110], (20000, 3))
    (x, y, z), (across, *_) = inside.T, around.sizes
    within = {
        "cylinder": (np.hypot(x, y) <= across / 2) & (z <= around.height),
        "sphere": np.hypot(np.hypot(x, y), z - across / 2) <= across / 2,
        "box": (np.abs(inside[:, :2]) <= np.array(around.sizes[:2]) / 2).all(axis=1) & (z <= around.height),
    }
    inside = inside[within[around.shape]]
    assert len(inside) > 20
    body = hull(points)
    heights = inside @ body.face_normals.T - (body.triangles_center * body.face_normals).sum(axis=1)
    assert heights.max() < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(("around", "model"), list(itertools.product(BODIES[:3], ("planar", "spatial"))))
def test_paths_between_sweeps_keep_clear_of_the_bounding_body_and_the_table(around, model):
    plan = RigPlan(parse_envelope(around), model=model, slices=6, samples=33)
    poses, space = plan_poses(plan), plan.space()
    # the bounding body fattened by the margin that is promised; in the steps within a sweep the rod may touch
    fattened = plan.around.points()[:, None] + 0.999 * space.margin * sphere_directions(200).T
    body = hull(fattened.reshape(-1, 3))
    axes, position = poses.axes(), 1000 * poses.position_m
    touches = steps_touch(body, position, axes, space.length, 0.0)
    sweeping = (poses.move[:-1] == Move.SWEEP) & (poses.move[1:] == Move.SWEEP)
    assert not touches[~sweeping].any()
    assert touches[sweeping].any()
    # most sweeps may touch: of the planar ones not those above the body
    reach = segments_meet(hull(plan.around.points()), position, axes[:, 1], space.length, 0.0)
    assert np.mean([reach[rows].any() for rows in poses.sweeps()]) > 0.8
    # the table is an obstacle for clamp and rod, on the way from pose to pose as well
    part = np.linspace(0, 1, 11)[:, None, None]
    between = (1 - part) * position[:-1] + part * position[1:]
    rods = (1 - part) * axes[:-1, 1] + part * axes[1:, 1]
    lowest = np.minimum(between[..., 2], (between + space.length * rods)[..., 2])
    assert lowest.min() > space.floor - 1e-9
    # the clamp moves against its x axis, on a straight line
    for rows in poses.sweeps():
        steps = np.diff(position[rows], axis=0) @ axes[rows[0]].T
        assert (steps[:, 0] < 0).all()
        assert np.abs(steps[:, 1:]).max() < 1e-9


@pytest.mark.parametrize("model", ["planar", "spatial"])
@pytest.mark.parametrize("curvature", [-20.0, 8.0])
def test_a_curved_rod_is_clear_of_the_bounding_body_before_and_after_a_sweep(model, curvature):
    """It began in the body, by up to its set."""
    rod = Rod(0.06, 1e-4, curvature_per_m=curvature)
    plan = RigPlan(Envelope("sphere", (42.0,)), model=model, slices=3, sweeps=2, samples=9, rod=rod)
    poses = plan_poses(plan)
    turn = 0.06 * curvature * np.linspace(0, 1, 60)
    free = 60 / turn[-1] * np.stack([np.cos(turn) - 1, np.sin(turn), 0 * turn], axis=1)
    ends = [row for rows in poses.sweeps() for row in (rows[0], rows[-1])]
    places = 1000 * poses.position_m[ends, None] + free @ poses.axes()[ends]
    assert np.linalg.norm(places - [0, 0, 21], axis=2).min() > 21 + 0.99 * plan.space().margin


@pytest.mark.slow
def test_sweeps_pass_the_bounding_body_even_with_a_bent_rod():
    # the body fills what is known of it, and the rod is bent until the last sample that touches
    body = hull(Envelope("cylinder", (60.0, 40.0)).points())
    for model in ("planar", "spatial"):
        log = simulate_rig(body, planned("cylinder:61x41", model=model, samples=40), friction=(0.6, 0.6))
        assert not [text for text in log.warnings if "end in contact" in text or "would touch" in text]
        # the forces are not larger than promised, in space as in the plane
        force = np.linalg.norm(log.wrench[:, :3], axis=1).max() / log.rod.force_unit_N
        assert 0.1 < force < FORCE_FACTOR / 0.3**2


def test_planar_plan_has_four_sides_and_closes_the_top():
    poses = planned("cylinder:80x90")
    assert len(poses.sweeps()) == 4 * (6 + 1)
    first = np.array([rows[0] for rows in poses.sweeps()])
    heights = 1000 * poses.position_m[first, 2]
    assert heights.max() > 90
    assert heights.min() > 1.8
    directions = np.unique(np.round(poses.axes()[first, 1], 6) + 0.0, axis=0)
    assert len(directions) == 4
    assert np.abs(directions[:, 2]).max() == 0


@pytest.mark.slow
def test_force_factor_bounds_sweeps_past_circles():
    # thin and thick bodies, near to the clamp and far from it
    largest, rod = 0.0, Rod.wire(0.4, 0.0003, 210e9)
    for radius, distance, friction in itertools.product((0.003, 0.1, 0.5), (0.2, 0.3, 0.5, 0.75), (0.0, 0.3, 1.0)):
        circle = planar.Circle(radius=radius, center=(0.0, distance + radius))
        swept = planar.sweep(circle, friction=friction, samples=200)
        force = np.nanmax(np.hypot(swept.f0x, swept.f0y))
        largest = max(largest, force / max(FORCE_FACTOR / distance**2, TIP_FACTOR))
        # even a bent rod has come off the body where the sweep ends
        touching = swept.x0[swept.phase != planar.Phase.NONE]
        beyond = RigPlan(parse_envelope("cylinder:80x90"), rod=rod, clearance=distance).space().beyond / 400
        assert touching.min() > -radius - beyond
    assert 0.6 < largest < 1


def test_the_force_factor_is_the_most_of_all_bent_rods():
    """Rods of any force whose angle to the rod's normal at the contact is at most 45°; the distance is that along the clamp."""
    alpha, beta = np.meshgrid(np.linspace(0.01, np.pi - 0.01, 400), np.radians(np.linspace(-45, 45, 91)))
    square = (1 + np.sin(beta)) / 2 - np.sin(alpha / 2) ** 2
    shape = bend(alpha[square >= 0], np.sqrt(square[square >= 0]))
    assert 0.95 < (np.maximum(shape.y, 0) ** 2).max() / FORCE_FACTOR < 1


@pytest.mark.slow
def test_a_force_limit_keeps_the_clamp_farther_away():
    rod = Rod.wire(0.08, 0.0003, 210e9)
    free, limited = (
        RigPlan(parse_envelope("cylinder:40x40"), rod=rod, slices=3, samples=24, max_force_N=f) for f in (None, 0.15)
    )
    clearance = limited.resolved_clearance()
    assert free.resolved_clearance() == 0.3 < clearance < FARTHEST
    assert largest_force(rod, clearance) == pytest.approx(0.15)
    log = simulate_rig(hull(limited.around.points() * 0.99 + [0, 0, 0.2]), plan_poses(limited), friction=(0.0, 0.0))
    assert 0.02 < np.linalg.norm(log.wrench[:, :3], axis=1).max() < 0.15
    with pytest.raises(InputError, match=r"may push with up to .* the limit is 10 mN; choose a rod of 0.* times the"):
        plan_poses(RigPlan(parse_envelope("cylinder:40x40"), rod=rod, max_force_N=0.01))


def test_the_force_of_a_rod_that_is_soft_at_its_clamp_is_that_of_its_stiffest_part():
    """The log of a plan with a limit of 0.8 N had a force of 1.7 N."""
    rod = Rod(0.06, ((0, 1e-4), (0.006, 1e-3), (0.06, 1e-3)))
    plan = RigPlan(parse_envelope("sphere:42"), slices=3, sweeps=1, samples=96, rod=rod, max_force_N=4.0)
    assert largest_force(rod, plan.resolved_clearance()) == pytest.approx(4.0)
    log = simulate_rig(standing(trimesh.creation.icosphere(2, 20.0)), plan_poses(plan))
    assert 0.1 < np.linalg.norm(log.wrench[:, :3], axis=1).max() < 4.0


def test_units_and_floor():
    inches = planned("cylinder:2x3", unit="in", floor=0.5)
    millimetres = planned("cylinder:50.8x76.2", floor=12.7)  # a robot moves as fast in any unit
    np.testing.assert_allclose(inches.position_m, millimetres.position_m, atol=1e-15)
    np.testing.assert_allclose(inches.times(), millimetres.times())
    np.testing.assert_allclose(planned("cylinder:2x3", unit="in", speed=20 / 25.4, floor=0.5).times(), inches.times())
    assert inches.position_m[:, 2].min() > 0.0127


def test_times_are_those_of_the_speed():
    slow, fast = planned("cylinder:80x90", speed=10.0), planned("cylinder:80x90", speed=40.0)
    np.testing.assert_allclose(slow.times(), 4 * fast.times(), atol=0.02)  # turns on the spot take a moment at least
    assert (np.diff(slow.times()) > 0).all()
    rows = slow.sweeps()[0]
    path = np.linalg.norm(slow.position_m[rows[-1]] - slow.position_m[rows[0]])
    assert slow.times()[rows[-1]] - slow.times()[rows[0]] == pytest.approx(path / 0.01)


def test_poses_are_read_back_bit_for_bit(tmp_path):
    poses = planned("cylinder:80x90", model="spatial", rod=Rod.wire(0.1, 0.0005, 75e9), max_force_N=2.0)
    write_poses(poses, tmp_path / "poses.csv")
    again = read_poses(tmp_path / "poses.csv")
    for name in ("sweep", "position_m", "quaternion", "move"):
        assert (getattr(again, name) == getattr(poses, name)).all()
    assert (again.rod, again.speed_m_s, again.model, again.unit) == (poses.rod, poses.speed_m_s, "spatial", "mm")
    assert (tmp_path / "poses.csv").read_text().partition("\n")[0] == ",".join(POSE_COLUMNS)
    # without the TOML file nothing is known of the rod
    (tmp_path / "poses.toml").unlink()
    assert read_poses(tmp_path / "poses.csv").rod is None


def test_the_command_writes_poses_without_a_mesh(tmp_path, capsys):
    out = tmp_path / "new" / "poses.csv"
    assert main(["plan", "--around", "cylinder:80x90", "--out", str(out), "--slices", "3", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    poses = read_poses(out)
    assert data["sweeps"] == len(poses.sweeps()) == 16
    assert data["rows"] == len(poses)
    assert data["largest_force_N"] == pytest.approx(2 * poses.rod.force_unit_N / 0.3**2)
    # probings have planes and lines of their own
    for option in ("--slices", "--sweeps", "--samples"):
        assert main(["plan", "--around", "sphere:50", "--out", str(out), "--probing", option, "5"]) == 2
        assert "leave --slices, --sweeps and --samples out" in capsys.readouterr().err
    # its own files are replaced
    assert main(["plan", "--around", "sphere:50", "--out", str(out), "--slices", "3", "--quiet"]) == 0
    assert read_poses(out).source["around"] == "sphere:50"
