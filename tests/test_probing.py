"""Probings: rods that move along themselves until they touch, against rays cast face by face and integrations of the rod."""

from dataclasses import replace

import numpy as np
import pytest
import pyvista
import trimesh
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from small_scans import ring

import planar
import scan3d
from scan3d.cloud import NormalSource
from scan3d.geometry.crossings import first_crossings, first_met
from scan3d.pipeline import analyse
from scan3d.planning.probing import Probings, Unknown
from scan3d.planning.rig import RigPlan, parse_envelope, plan_poses
from scan3d.poses import Move
from scan3d.reconstruction import checked
from scan3d.reconstruction.probings import free_lines
from scan3d.recording import joined, of_rows
from scan3d.report import report, summary
from scan3d.rods import Gravity, Rod
from scan3d.simulation import rig
from scan3d.simulation.probing import felt_along, recorded_probings
from scan3d.spatial import inverse
from scan3d.spatial.bodies import sphere_directions
from scan3d.spatial.march import SpatialRod, shapes
from tests.robustness.probing import signed


def _bodies(rng):
    """Bodies that are not convex, turned at random, in several parts, with walls along the axes."""
    ring = trimesh.creation.annulus(r_min=8, r_max=11, height=6)
    bars = trimesh.util.concatenate([trimesh.creation.box((20, 1, 1), np.eye(4) + _shift(0, y, 3)) for y in (-2, 0, 2)])
    both = trimesh.util.concatenate([ring, bars.copy().apply_translation((0, 0, 5))])
    for body in (ring, bars, both, trimesh.creation.torus(10, 4)):
        turn = np.eye(4)
        turn[:3, :3] = Rotation.random(rng=rng).as_matrix()
        yield body
        yield body.copy().apply_transform(turn)


def _shift(x, y, z):
    moved = np.zeros((4, 4))
    moved[:3, 3] = x, y, z
    return moved


def _brute_force(mesh, start, along):
    a, b, c = mesh.triangles.transpose(1, 0, 2)
    across = np.cross(along, c - a)
    scale = ((b - a) * across).sum(axis=1)
    found = np.full(len(start), np.inf)
    for k, point in enumerate(start):
        offset = point - a
        with np.errstate(divide="ignore", invalid="ignore"):
            u = (offset * across).sum(axis=1) / scale
            beside = np.cross(offset, b - a)
            v = (beside @ along) / scale
            t = ((c - a) * beside).sum(axis=1) / scale
            inside = (u >= 0) & (v >= 0) & (u + v <= 1) & (np.abs(scale) > 1e-12)
        found[k] = t[inside].min(initial=np.inf)
    return found


def _lines(mesh, rng, count=300):
    """Starts of parallel lines outside of a mesh, beside places of its surface and through them, and their direction."""
    along = Rotation.random(rng=rng).as_matrix()[0]
    middle, size = mesh.bounds.mean(axis=0), float(np.linalg.norm(mesh.extents))
    places = trimesh.sample.sample_surface(mesh, count, seed=int(rng.integers(1000)))[0]
    places = places + rng.normal(0, 0.05, (count, 3)) * size
    return places - ((places - middle) @ along + size)[:, None] * along, along


def test_lines_first_meet_a_mesh_where_they_meet_its_nearest_face():
    rng = np.random.default_rng(0)
    for mesh in _bodies(rng):
        start, along = _lines(mesh, rng)
        found, face = first_crossings(mesh, start, along)
        expected = _brute_force(mesh, start, along)
        assert np.isfinite(expected).sum() >= 10
        np.testing.assert_array_equal(np.isfinite(found), np.isfinite(expected))
        met = np.isfinite(found)
        np.testing.assert_allclose(found[met], expected[met], atol=1e-12 * np.linalg.norm(mesh.extents))
        normal = mesh.face_normals[face[met]]
        assert (normal @ along <= 1e-9).all()  # nothing is met from behind


def test_no_line_passes_between_the_faces_at_an_edge_or_a_vertex():
    rng = np.random.default_rng(1)
    for mesh in _bodies(rng):
        along, size = Rotation.random(rng=rng).as_matrix()[0], float(np.linalg.norm(mesh.extents))
        ends = mesh.vertices[mesh.edges_unique]
        targets = np.concatenate([mesh.vertices, ends.mean(axis=1), ends[:, 0] + 0.3 * (ends[:, 1] - ends[:, 0])])
        found, _ = first_crossings(mesh, targets - 2 * size * along, along)
        passed = found > 2 * size * (1 + 1e-12)
        # what passes grazes the body: beside it, by as little as rounding may move it, there is nothing behind either
        beside = np.cross(along, Rotation.random(8, rng=rng).as_matrix()[:, 0])
        beside *= 1e-6 * size / np.linalg.norm(beside, axis=1, keepdims=True)
        near = (targets[passed][:, None] + beside - 2 * size * along).reshape(-1, 3)
        behind = (first_crossings(mesh, near, along)[0] > 2 * size * (1 + 1e-5)).reshape(-1, 8)
        assert passed.mean() < 0.3
        assert behind.any(axis=1).all()


def test_lines_along_walls_stop_at_the_rim_and_pass_between_bars_that_are_close():
    box = trimesh.creation.box((2, 2, 2))
    across = np.linspace(-1, 1, 9)
    start = np.stack([np.ones(9), across, np.full(9, 5.0)], axis=1)
    found, _ = first_crossings(box, start, np.array([0.0, 0, -1]))
    np.testing.assert_allclose(found, 4.0, atol=1e-14)
    outside, _ = first_crossings(box, start + np.array([1e-9, 0, 0]), np.array([0.0, 0, -1]))
    assert np.isinf(outside).all()
    bars = trimesh.util.concatenate(
        [trimesh.creation.box((10, 1, 1), np.eye(4) + _shift(0, y, 0)) for y in np.arange(5) * 1.001]
    )
    gap = np.array([[0.0, 0.5005, 9.0], [0.0, 1.5015, 9.0], [0.0, 1.0, 9.0]])
    np.testing.assert_allclose(first_crossings(bars, gap, np.array([0.0, 0, -1]))[0], [np.inf, np.inf, 8.5])


def test_lines_in_the_planes_of_faces_meet_these_where_they_are():
    disc = trimesh.creation.cylinder(10, 6, sections=64)
    mesh = trimesh.util.concatenate([disc, trimesh.creation.box((50, 8, 4), np.eye(4) + _shift(20, 0, 0))])
    size = float(np.linalg.norm(mesh.extents))
    moves = Unknown(*mesh.bounds, 1.1 * size).first_round().moves
    flat = np.abs(moves.axes[:, 2, 2]) == 1
    start, along = moves.start[flat], moves.axes[flat, 1]
    # in the planes of the box's faces, which the disc's walls cross, up to rounding
    start[:, 2] = np.where(start[:, 2] > 0, 2.0, -2.0) + np.spacing(2.0) * np.random.default_rng(0).integers(
        -1, 2, len(start)
    )
    found, _ = first_met(mesh, start, along)
    met = np.isfinite(found)
    places = start[met] + found[met, None] * along[met]
    distance = pyvista.wrap(places).compute_implicit_distance(pyvista.wrap(mesh))["implicit_distance"]
    assert len(places) > 300
    assert np.abs(distance).max() < 1e-9 * size


RODS = {
    "uniform": Rod.of_length(0.05).without_thickness(),
    "tapered": Rod(0.05, 1e-4, diameter_m=3e-4, tip_diameter_m=1e-4).without_thickness(),
    "soft clamp": Rod(0.05, 1e-4, clamp_compliance_rad_per_Nm=20.0),
    "heavy": Rod(0.05, 1e-4, weight_N=0.004),
}


def _moves(mesh, rng, count, length):
    start, along = _lines(mesh, rng, count)
    first = np.cross(along, [1.0, 0.2, 0.1])
    first /= np.linalg.norm(first)
    axes = np.broadcast_to(np.stack([first, along, np.cross(first, along)]), (count, 3, 3))
    return Probings(start - length * along, axes, np.full(count, 3.0 * length))


def _recording(mesh, rod, rng, *, noise=0.0, model="spatial", friction=0.3, gravity=None, stop=None, samples=200):
    plan = scan3d.Plan(
        probing="only", noise=noise, model=model, rod=rod, friction=friction, gravity=gravity, slices=1, **(stop or {})
    )
    length = rod.length_m * 1000
    return recorded_probings(mesh, _moves(mesh, rng, samples, length), plan, rod, length, int(rng.integers(1000)))


# gravity leaves the planes of the planar model
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "model"), [*((name, "planar") for name in list(RODS)[:3]), *((n, "spatial") for n in RODS)]
)
def test_contacts_of_probings_lie_on_the_body_and_their_lines_outside(name, model):
    rng = np.random.default_rng(2)
    gravity = Gravity((0.2, -0.3, -1.0), tared=True) if name == "heavy" else None
    for mesh in _bodies(rng):
        recording = _recording(mesh, RODS[name], rng, model=model, gravity=gravity, friction=(0.0, 0.6))
        cloud = scan3d.reconstruct(recording, model=model)
        assert cloud.probed.all()
        assert (cloud.phase == planar.Phase.TIP).all()
        assert len(cloud) > 5
        assert np.abs(signed(mesh, cloud.points)).max() < 1e-9 * cloud.rod_length
        lines = free_lines(recording, cloud)
        part = lines[:, 0] + rng.uniform(0, 1, (len(lines), 1)) * (lines[:, 1] - lines[:, 0])
        # the end slides aside by a three hundredth of the rod at most, and what hangs is beside its line
        beside = 0.06 if gravity else 0.01 / 3
        assert signed(mesh, part).min() > -beside * cloud.rod_length


def test_rods_stick_within_the_friction_angle_and_slide_beyond_it():
    """The contact is the crossing of the ray if the end sticks; else the force is on the edge of the friction cone."""
    rng = np.random.default_rng(3)
    rod, length = RODS["uniform"], 50.0
    plane = trimesh.creation.box((200, 200, 20))
    for degrees, friction in ((0, 0.0), (20, 0.5), (20, 0.2), (60, 0.3), (80, 0.0)):
        turn = Rotation.from_euler("x", degrees, degrees=True).as_matrix()
        along = -turn[2]  # the plane's top is met at that angle to its normal
        axes = np.stack([[1.0, 0, 0], along, np.cross([1.0, 0, 0], along)])
        top = np.column_stack([rng.uniform(-5, 5, (10, 2)), np.full(10, 10.0)])
        moves = Probings(top - 2 * length * along, np.broadcast_to(axes, (10, 3, 3)), np.full(10, 2 * length))
        felt = felt_along(plane, moves, rod, length, np.full(10, friction), 0.02, None, False)
        assert felt.touches.all()
        np.testing.assert_allclose(np.linalg.norm(felt.force, axis=1), 0.02)
        on_rod = -felt.force @ axes
        angle = np.degrees(np.arccos(np.clip(on_rod @ [0, 0, 1] / 0.02, -1, 1)))
        slides = degrees > np.degrees(np.arctan(friction))
        np.testing.assert_allclose(angle, np.degrees(np.arctan(friction)) if slides else degrees, atol=1e-5)
        if not slides:
            np.testing.assert_allclose(felt.travel, length, rtol=1e-12)
            np.testing.assert_allclose(felt.moment, 0, atol=1e-15)
        else:  # the rod bends aside as its differential equations say
            np.testing.assert_allclose(felt.moment[0], _integrated(felt.force[0]), atol=1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["uniform", "tapered"])
def test_where_the_end_slips_over_a_bump_the_rod_does_not_go_through_it(name):
    """What is felt is only stated where the rod, bent as its equations say, lies nowhere in the body."""
    rod, length, stop = RODS[name], 50.0, 0.02
    bump = trimesh.creation.icosphere(5, radius=10.0)
    wall = trimesh.creation.box((40, 2, 90), trimesh.transformations.translation_matrix([0, 20, 0]))
    wall.apply_transform(trimesh.transformations.rotation_matrix(np.radians(-40), [1, 0, 0], [0, 20, 0]))
    mesh = trimesh.util.concatenate([bump, wall])
    depth = np.geomspace(1e-3, 0.6, 200)
    start = np.column_stack([np.zeros(200), np.full(200, -70.0), 10 - depth])
    moves = Probings(start, np.broadcast_to(np.eye(3), (200, 3, 3)), np.full(200, 2 * length))
    felt = felt_along(mesh, moves, rod, length, np.zeros(200), stop, None, False)
    places = length * shapes(rod.in_space(), felt.force.T, felt.moment.T, None, 200)[0]
    places = (start.T + felt.travel * [[0], [1], [0]])[:, None] + places
    deepest = signed(bump, places.reshape(3, -1).T).reshape(200, 200).min(axis=0)
    # those that come to the wall clear of the bump are kept, and those that would go through it left out
    at_wall = felt.touches & (places[1, -1] > 10)
    assert (at_wall & (deepest > 1e-4)).sum() > 20
    assert felt.resolved[at_wall & (deepest > 1e-4)].all()
    through = deepest < -1e-4
    assert not felt.resolved[through].any()
    assert through.sum() > 20


def _integrated(force):
    """The support moment of a rod that is touched at its end alone, by shooting along φ'' = N_x sin φ - N_y cos φ."""
    aside = np.array([force[0], 0, force[2]])
    size = np.linalg.norm(aside)
    inner = -np.array([size, force[1]])

    def rate(_, state):
        phi, kappa = state
        return kappa, inner[0] * np.sin(phi) - inner[1] * np.cos(phi)

    def left(kappa):
        return solve_ivp(rate, (0, 1), [np.pi / 2, kappa], rtol=1e-12, atol=1e-14).y[1, -1]

    kappa = brentq(left, -2 * size, 2 * size, xtol=1e-14)
    # the moment -κ is about the axis across the plane of the rod's axis and the force aside
    return -kappa * np.cross(aside / size, [0.0, 1.0, 0.0])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "model", "noise"),
    [
        pytest.param(name, model, noise, marks=() if (i + j + k) % 2 else pytest.mark.trust)
        for i, name in enumerate(["uniform", "tapered"])
        for j, model in enumerate(["planar", "spatial"])
        for k, noise in enumerate([1e-4, 1e-3])
    ],
)
def test_probed_contacts_lie_within_their_stated_errors(name, model, noise):
    rng = np.random.default_rng(4)
    body = trimesh.creation.icosphere(5, radius=20.0)
    recording = _recording(body, RODS[name], rng, noise=noise, model=model, samples=1600)
    cloud = scan3d.reconstruct(recording, model=model)
    exact = scan3d.reconstruct(
        _recording(body, RODS[name], np.random.default_rng(4), model=model, samples=1600,
                   stop={"stop_force": max(0.01, 16 * noise)}), model=model)  # fmt: skip
    assert len(cloud) > 500
    both, ours, theirs = np.intersect1d(cloud.row, exact.row, return_indices=True)
    assert len(both) >= 0.99 * len(exact)
    off = cloud.points[ours] - exact.points[theirs]
    covariance = cloud.covariance[ours]
    # in the plane the noise moves the end in two directions, in space in two across the rod as well
    values, vectors = np.linalg.eigh(covariance)
    across = np.einsum("nij,ni->nj", vectors[:, :, 1:] if model == "spatial" else vectors[:, :, 2:], off)
    scaled = across / np.sqrt(values[:, 1:] if model == "spatial" else values[:, 2:])
    assert 0.93 < (np.abs(scaled) < 1.96).mean() < 0.97
    assert 0.93 < scaled.std() < 1.07


@pytest.mark.parametrize("size", [1e3, 1e8, 1e30])
def test_reactions_that_no_rod_has_give_no_contact(size):
    """Numbers overflow along the way, without a warning."""
    reactions = size * np.random.default_rng(8).normal(size=(6, 5))
    found = inverse.at_ends(reactions[:3], reactions[3:], (0.0, 0.0), rod=SpatialRod())
    assert not (found.chance > 0).any()


def test_contacts_have_errors_where_the_noise_of_the_force_alone_is_stated():
    force = np.array([[0.0, 1e-4], [-0.01, -0.01], [0.0, 0.0]])
    found = inverse.at_ends(force, np.zeros((3, 2)), (1e-4, 0.0), rod=SpatialRod())
    np.testing.assert_allclose(found.point[:, 0], [0, 1, 0], atol=1e-9)
    assert np.isfinite(found.covariance).all()
    assert found.chance[0] > 0.99


def test_a_rod_that_is_touched_elsewhere_than_at_its_end_gives_no_contact():
    rng = np.random.default_rng(5)
    body = trimesh.creation.icosphere(4, radius=20.0)
    recording = _recording(body, RODS["uniform"], rng, noise=1e-4, friction=0.0)
    right = scan3d.reconstruct(recording)
    rows = right.row[:5]
    moment = recording.moment_Nm.copy()
    moment[rows] += 0.02 * recording.rod.moment_unit_Nm
    wrong = scan3d.reconstruct(replace(recording, moment_Nm=moment))
    assert wrong.second == right.second + 5
    assert not np.isin(rows, wrong.row).any()


def test_a_curved_rod_is_refused():
    rng = np.random.default_rng(6)
    body = trimesh.creation.icosphere(2, radius=20.0)
    recording = _recording(body, RODS["uniform"], rng)
    with pytest.raises(scan3d.InputError, match="curved does not follow its end"):
        scan3d.reconstruct(replace(recording, rod=Rod(0.05, 1e-4, curvature_per_m=2.0)))


def _explored(mesh, planes, seed):
    """What the planner touches of a body that it can only feel: contacts, and the moves that it asked for."""
    diagonal = float(np.linalg.norm(mesh.extents))
    length = 1.1 * diagonal
    unknown = Unknown(mesh.bounds[0], mesh.bounds[1], length, [seed])
    points, starts, done, planned = [], [], 0, unknown.first_round()
    while planned.planes:
        moves = planned.moves
        start = moves.start + length * moves.axes[:, 1]
        distance = first_met(mesh, start, moves.axes[:, 1])[0]
        met = distance <= moves.travel
        end = start + np.minimum(distance, moves.travel)[:, None] * moves.axes[:, 1]
        unknown.add(end[met], moves.axes[met, 1], np.stack([moves.start, end], axis=1))
        points.append(end[met])
        starts.append(moves.start)
        done += planned.planes
        planned = unknown.next_round(min(8, planes - done))
    return np.concatenate(points), np.concatenate(starts), unknown


@pytest.mark.slow
def test_the_planner_finds_what_is_unknown_by_feeling_alone():
    mesh = trimesh.creation.torus(10, 3.5, major_sections=24, minor_sections=12)
    points, starts, unknown = _explored(mesh, 57, seed=0)
    places = trimesh.sample.sample_surface(mesh, 2000, seed=0)[0]
    near = cKDTree(points).query(places)[0] <= 0.02 * np.linalg.norm(mesh.extents)
    assert near.mean() > 0.98
    assert unknown.known() > 0.95
    again, _, _ = _explored(mesh, 9, seed=0)
    np.testing.assert_array_equal(again, points[: len(again)])


@pytest.mark.slow
def test_plans_far_from_the_origin_take_no_more_memory():
    mesh = trimesh.creation.torus(10, 3.5, major_sections=24, minor_sections=12)
    near = _explored(mesh, 17, seed=0)[0]
    mesh.apply_translation([1e8, 0, -1e8])
    assert len(_explored(mesh, 17, seed=0)[0]) == pytest.approx(len(near), rel=0.1)


def test_nothing_is_probed_where_all_is_touched():
    points = sphere_directions(12000).T
    unknown = Unknown(np.full(3, -1.2), np.full(3, 1.2), 5.0)
    unknown.add(points, -points, np.stack([2 * points, points], axis=1))
    planned = unknown.next_round()
    assert unknown.known() == 1
    assert planned.planes == 0
    assert len(planned.moves.travel) == 0


def test_the_clamp_stays_outside_of_the_body():
    mesh = trimesh.creation.annulus(r_min=8, r_max=11, height=6)
    length = 1.1 * float(np.linalg.norm(mesh.extents))
    unknown = Unknown(mesh.bounds[0], mesh.bounds[1], length)
    moves = unknown.first_round().moves
    for clamp in (moves.start, moves.start + moves.travel[:, None] * moves.axes[:, 1]):
        outside = np.maximum(mesh.bounds[0] - clamp, clamp - mesh.bounds[1]).max(axis=1)
        assert (outside > 0).all()


@pytest.mark.slow
def test_a_scan_of_a_hollow_body_reaches_into_it_and_says_what_it_touched():
    body = trimesh.creation.annulus(r_min=8, r_max=11, height=20, sections=24)
    result = scan3d.scan(body, slices=16, samples=16, friction=(0.0, 0.4))
    report = result.report
    counts, coverage = report["counts"], report["coverage"]
    assert 0 < counts["probings"] < counts["sweeps"]
    assert coverage["known"] > 0.9
    assert report["contact_error"]["max_rod_lengths"] < 1e-3  # but for a hidden second contact of a sweep
    assert result.surface.euler_number == 0
    assert report["hausdorff"]["relative"] < 0.04
    assert "% of the surface touched" in str(result).splitlines()[0]
    probed = result.cloud.probed
    assert (result.cloud.normal_source[probed] == NormalSource.SURFACE).all()
    assert 0.15 < report["friction"]["estimated_median"] < 0.25


@pytest.mark.slow
def test_a_rig_probes_a_body_round_after_round():
    ring = trimesh.creation.annulus(r_min=8, r_max=11, height=12, sections=24)
    body = rig.standing(ring)
    session = scan3d.Session("cylinder:26x14", rod=Rod.of_length(0.045).without_thickness(), probing=True)
    known = []
    for _ in range(3):
        poses = session.ask(sweeps=16)
        log = rig.simulate_rig(body, poses, friction=(0.0, 0.4))
        session.tell(log.recording())
        known.append(session._known.any_shape.coverage["known"])
        above = poses.position_m[:, 2] * 1000 + np.minimum(45 * poses.axes()[:, 1, 2], 0)
        assert above.min() >= session.plan.space().floor - 1e-6
    assert known[0] < known[1] < known[2]
    assert "of the surface touched" in session.known


@pytest.mark.slow
def test_rods_that_cannot_sweep_a_hollow_body_probe_it_alone_if_they_are_straight():
    body = trimesh.creation.annulus(r_min=8, r_max=11, height=20, sections=16)
    few = {"slices": 2, "samples": 8}
    for plan in (scan3d.Plan(rod=RODS["tapered"], **few), scan3d.Plan(model="spatial", **few)):
        recording = scan3d.simulate(body, plan)
        assert recording.in_probings.all()
        assert recording.stated_hollow
        assert recording.six_axis == (plan.model == "spatial")
    with pytest.raises(scan3d.InputError, match="straight at rest"):
        scan3d.simulate(body, scan3d.Plan(rod=Rod(0.05, 1e-4, curvature_per_m=1.0), **few))
    with pytest.raises(scan3d.InputError, match="does not have; leave the tolerance out"):
        scan3d.simulate(body, scan3d.Plan(tolerance=1e-3))


def test_a_stop_force_has_a_unit_or_that_of_the_rod():
    rod = RODS["uniform"]
    by_unit = scan3d.Plan(stop_force=f"{20 * rod.force_unit_N} mN").stop_force_of(rod)
    assert by_unit == pytest.approx(0.02)
    assert scan3d.Plan(stop_force="0.02").stop_force_of(rod) == 0.02
    assert scan3d.Plan(noise=1e-3).stop_force_of(rod) == pytest.approx(0.016)


@pytest.mark.parametrize("model", ["planar", "spatial"])
def test_probings_that_touch_nothing_give_no_contact(model):
    rng = np.random.default_rng(7)
    recording = _recording(trimesh.creation.icosphere(2, radius=20.0), RODS["uniform"], rng, model=model)
    free = of_rows(recording, np.linalg.norm(recording.force_N, axis=1) == 0)
    # each probing goes on, and feels nothing
    moved = replace(free, position_m=free.position_m + 1e-3 * free.axes()[:, 1])
    both = replace(joined([free, moved]), sweep=np.concatenate([free.sweep, free.sweep]))
    assert both.in_probings.any()
    with pytest.raises(scan3d.InputError, match="touched at its end"):
        scan3d.reconstruct(both, model=model)


def test_a_sweep_of_poses_is_either_swept_or_probed():
    poses = plan_poses(RigPlan(parse_envelope("cylinder:26x14"), probing=True))
    move = poses.move.copy()
    move[np.flatnonzero(move == Move.PROBE)[0]] = Move.SWEEP
    with pytest.raises(scan3d.InputError, match="of another move than the sweep"):
        replace(poses, move=move)


@pytest.mark.slow
def test_a_folder_has_the_normals_of_its_probed_contacts(tmp_path, no_pictures):
    """They were unknown in the cloud of an opened folder, and probings were counted as sweeps in a slice of their own."""
    mesh = trimesh.creation.torus(10.0, 4.0, major_sections=24, minor_sections=12)
    made = scan3d.scan(mesh, slices=3, samples=16, known=0.3)
    made.save(tmp_path / "ring")
    found, made = scan3d.open(tmp_path / "ring").cloud, made.cloud
    assert np.isfinite(made.normals[made.probed]).all()
    assert np.array_equal(found.normal_source, made.normal_source)
    assert found.normals == pytest.approx(made.normals, abs=1e-6, nan_ok=True)
    counts = dict(found.summary())
    assert counts["sweeps"] == f"{len(np.unique(made.sweep[~made.probed]))} and {made.probed.sum()} probings"
    assert int(counts["slices"].split()[0]) == len(np.unique(made.slice[~made.probed]))


@pytest.mark.slow
def test_a_stop_force_that_pushes_the_end_off_is_told():
    body = trimesh.creation.torus(10, 3.5, major_sections=24, minor_sections=12)
    for force, told in ((0.3, True), (0.01, False)):
        rows = dict(scan3d.scan(body, slices=2, probing="only", stop_force=force).summary())
        assert ("unresolved" in rows) == told, rows
    poses = plan_poses(RigPlan(parse_envelope("cylinder:28x8"), probing=True))
    log, planned = rig.simulate_rig(rig.standing(body), poses, stop_force=0.3), len(poses.sweeps())
    left = planned - len(np.unique(log.sweep))
    assert left > 0
    assert any(f"{left} of {planned} sweeps are left out" in warning for warning in log.warnings)


def test_a_rod_whose_end_sticks_is_drawn_straight():
    force, nothing = np.array([[0.0], [0.01], [0.0]]), np.zeros((3, 1))
    line = shapes(Rod(0.05, 1e-4).in_space(), force, nothing, None, 9)[0][..., 0]
    np.testing.assert_allclose(line[:, [0, -1]].T, [[0, 0, 0], [0, 1, 0]], atol=1e-12)


@pytest.mark.slow
def test_what_is_known_is_not_told_of_a_surface_by_another_method():
    body = trimesh.creation.torus(10, 3.5, major_sections=24, minor_sections=12)
    recording = scan3d.simulate(body, scan3d.Plan(slices=1, probing="only"))
    for method, told in (("auto", True), ("hull", False)):
        heading, rows = summary(report(analyse(recording, body, method=method), settings={}))
        assert ("of the surface touched" in heading) == told
        assert told or "off the surface" not in dict(rows)


def test_sweeps_that_contradict_themselves_do_so_beside_probings():
    recording = ring().recording
    wrong = replace(recording, moment_Nm=1.1 * recording.moment_Nm)
    swept = of_rows(wrong, ~wrong.in_probings)
    codes = [
        [found.code for found in checked(each, scan3d.reconstruct(each)).contradictions] for each in (swept, wrong)
    ]
    assert codes[0] == codes[1] != []


def test_the_end_of_a_thick_rod_touches_somewhere_on_it():
    recording = ring().recording
    thick = replace(recording, rod=replace(recording.rod, diameter_m=4e-4))
    cloud = scan3d.reconstruct(thick)
    assert cloud.lever == pytest.approx(0.2)
    assert len(cloud.fattened) == len(cloud)
    assert analyse(thick).surface.is_watertight


@pytest.mark.parametrize("digits", [12, 14])
def test_errors_of_few_digits_are_those_of_sweeps_and_of_probings(digits):
    recording = ring().recording
    rounded = replace(
        recording, force_N=np.round(recording.force_N, digits), moment_Nm=np.round(recording.moment_Nm, digits)
    )
    cloud = scan3d.reconstruct(rounded)
    assert np.isfinite(cloud.place_sd).all()
    assert np.isfinite(cloud.noise)


@pytest.mark.slow
def test_sweeps_and_probings_of_six_axes_have_a_surface():
    mesh = trimesh.creation.icosphere(3, 10.0)
    swept = scan3d.simulate(mesh, scan3d.Plan(model="spatial", slices=6, samples=20))
    probed = scan3d.simulate(mesh, scan3d.Plan(model="spatial", slices=2, probing="only", rod=swept.rod))
    both = replace(joined([swept, replace(probed, rod=swept.rod)]), source={})
    assert analyse(both).surface.is_watertight


@pytest.mark.slow
def test_bodies_that_are_not_convex_are_probed_whatever_the_planes():
    plan = scan3d.Plan(slices=8, samples=16, axis="free", spacing="adaptive", known=0.3)
    assert scan3d.simulate(trimesh.creation.torus(10.0, 4.0, 24, 12), plan).in_probings.any()


@pytest.mark.parametrize("setting", [{"noise": 0.2}, {"stop_force": "1N"}])
def test_forces_that_buckle_the_rod_end_no_probing(setting):
    with pytest.raises(scan3d.InputError, match="far below what buckles"):
        scan3d.simulate(trimesh.creation.icosphere(2, 10.0), scan3d.Plan(probing="only", **setting))
