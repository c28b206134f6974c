"""Heights of the slices, by a rule or by contacts along one axis and several; directions and base lines of plans."""

import functools
import math

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from sample_bodies import MESHES as FOLDER
from scipy.spatial.transform import Rotation

import scan3d
from scan3d import Plan
from scan3d.planning.heights import BEYOND, FIRST_SLICES, cuts, first_heights, heights
from scan3d.planning.plan import AIMED_SLOPE, OPEN_FRACTION, base_fractions, base_line, further_directions
from scan3d.reconstruction.contacts import contacts
from scan3d.simulation.scan import AxisScan
from scan3d.surfaces import Gap, enclosure


def test_cosine_heights_are_chebyshevs_nodes():
    # the textbook's: the roots of the polynomial, which is cos(n arccos x)
    levels = heights(-1.0, 1.0, Plan(slices=9, spacing="cosine"))
    assert np.all(np.diff(levels) > 0)
    roots = np.sort(np.polynomial.chebyshev.chebroots([0] * 9 + [1]))
    assert levels == pytest.approx(roots, abs=1e-12)


def test_uniform_heights_are_the_middles_of_equal_slabs():
    assert heights(10.0, 20.0, Plan(slices=5, spacing="uniform")) == pytest.approx([11, 13, 15, 17, 19], rel=1e-15)


@pytest.mark.parametrize("spacing", ["cosine", "uniform", "adaptive"])
@pytest.mark.parametrize("slices", [1, 4, 64])
def test_a_slice_beyond_either_end_shows_where_the_body_ends(spacing, slices):
    levels = first_heights(-3.0, 7.0, Plan(slices=slices, spacing=spacing))
    beyond = (levels < -3) | (levels > 7)
    assert beyond.sum() == 2
    assert levels[beyond].sum() == pytest.approx(4.0)
    assert np.all((levels[~beyond] > -3) & (levels[~beyond] < 7))
    assert (~beyond).sum() == (min(FIRST_SLICES, slices) if spacing == "adaptive" else slices)


KNOWN = np.array([-0.1, 0.1, 0.5, 0.9, 1.1])


def cut(slab, corner, gap, straight, count=9, **settings):
    straight = np.full(len(slab), straight)
    return cuts(KNOWN, np.array(slab), np.array(corner), np.array(gap, dtype=float), straight, count, **settings)


def test_slabs_are_cut_at_their_worst_corners_the_widest_first():
    slab, corner, gap = [1, 1, 2, 2], [0.2, 0.24, 0.66, 0.7], [1.0, 9.0, 4.0, 0.5]
    assert cut(slab, corner, gap, True).tolist() == [0.24, 0.66]
    assert cut(slab, corner, gap, True, count=1).tolist() == [0.24]
    assert cut(slab, corner, gap, True, enough=5.0).tolist() == [0.24]
    assert len(cut(slab, corner, np.zeros(4), True)) == 0
    # a corner on an end slice, and one on an empty slice, mean only that the body may end there
    assert cut([1], [0.1], [1.0], True) == pytest.approx([0.3], abs=0.1)
    assert cut([3], [1.1], [1.0], True) == pytest.approx([1.0])
    assert cut([0], [-0.1], [1.0], False) == pytest.approx([0.0])


@pytest.mark.slow
def test_no_slices_are_taken_that_buy_nothing():
    """The contacts of few samples leave more open in the planes of slices than lies between them."""
    egg = scan3d.load_mesh(FOLDER / "egg.stl")
    cloud = contacts(scan3d.simulate(egg, Plan(slices=60, sweeps=6, samples=6)))
    found = enclosure(cloud)
    assert len(cloud.slice_height) < 60
    assert found.part(Gap.SLICES) < 1.02 * found.part(Gap.CONTACTS)


@pytest.mark.slow
@pytest.mark.parametrize("turned", [False, True])
def test_of_a_prism_along_the_axis_only_the_ends_are_sliced(turned):
    """Rounding of its gaps decides nothing: between the first slices nothing is left to be found."""
    mesh = trimesh.creation.box((40, 30, 50))
    if turned:
        mesh.apply_transform(trimesh.transformations.rotation_matrix(0.7, (0, 0, 1)))
    plan = Plan(slices=24, sweeps=4, samples=16)
    heights = np.sort(contacts(scan3d.simulate(mesh, plan)).slice_height)
    first = np.sort(first_heights(-25, 25, plan))
    inside = heights[(heights > first[1] + 1e-9) & (heights < first[-2] - 1e-9)]
    np.testing.assert_allclose(inside, first[2:-2])
    assert len(heights) > len(first)


TURN = Rotation.from_rotvec([0.3, -0.5, 0.7]).as_matrix()
POLYTOPE = trimesh.convex.convex_hull(np.random.default_rng(3).normal(size=(20, 3)) * [12, 9, 7])
ELLIPSOID = trimesh.convex.convex_hull(trimesh.creation.icosphere(5).vertices * [20, 14, 9] @ TURN)
CORNERS = np.array([[np.cos(a), np.sin(a)] for a in 2 * np.pi * np.arange(80) / 80])
FRUSTUM = trimesh.convex.convex_hull(
    np.concatenate([np.column_stack([r * CORNERS, np.full(80, h)]) for r, h in ((15, 0), (6, 25))]) @ TURN
)
APEXES = [[0, 0, 25], [0, 0, -9]]
DOUBLE_CONE = trimesh.convex.convex_hull(np.concatenate([np.column_stack([15 * CORNERS[::2], np.zeros(40)]), APEXES]))
MESHES = {"polytope": POLYTOPE, "ellipsoid": ELLIPSOID, "frustum": FRUSTUM, "double cone": DOUBLE_CONE}


@functools.cache
def cloud_of(name, slices, axes, **settings):
    return contacts(scan3d.simulate(MESHES[name], Plan(slices=slices, axis=axes, samples=32, **settings)))


def relative_bound(name, slices, axes, **settings):
    return enclosure(cloud_of(name, slices, axes, **settings)).bound / np.linalg.norm(MESHES[name].extents)


def slices_along(cloud, axis):
    """Number of slices along an axis, in which something was touched or not."""
    return int((cloud.slice_axis @ axis > 0.5).sum())


@pytest.mark.slow
def test_adaptive_slices_are_not_worse_than_any_rule_on_smooth_bodies_and_find_vertices():
    """Of a smooth body cosine spacing is the best rule; a slice just below each tip closes a double cone's caps."""
    smooth, by_rule = (relative_bound("ellipsoid", 16, "z", sweeps=6, spacing=rule) for rule in ("adaptive", "cosine"))
    assert smooth < by_rule
    assert relative_bound("double cone", 12, "z", sweeps=6) < 3e-4


@pytest.mark.slow
@pytest.mark.parametrize(("axis", "slices"), [("z", 60), ("xyz", 20)])
def test_a_tolerance_ends_the_scan(axis, slices):
    plan = Plan(slices=slices, axis=axis, samples=32, sweeps=6, tolerance=2e-2)
    cloud = contacts(scan3d.simulate(POLYTOPE, plan))
    size = np.linalg.norm(np.ptp(cloud.points, axis=0))
    assert len(cloud.slice_height) < 60
    assert enclosure(cloud).bound <= plan.tolerance * size


@pytest.mark.slow
def test_noisy_contacts_are_planned_axis_by_axis():
    cloud = cloud_of("polytope", 4, "xyz", sweeps=4, noise=1e-3)
    assert [slices_along(cloud, axis) for axis in np.eye(3)] == [4 + BEYOND] * 3


FEW_SAMPLES = {"slices": 60, "samples": 10, "friction": (0.0, 0.4)}


@functools.cache
def scanned(name, **settings):
    body = scan3d.load_mesh(FOLDER / name)
    return scan3d.simulate(body, Plan(**FEW_SAMPLES, **settings))


def relative_gaps(recording):
    """The largest gaps of all slices' contours, and of all, over the diagonal of the contacts."""
    cloud = scan3d.reconstruct(recording)
    bounds, diagonal = enclosure(cloud), np.linalg.norm(np.ptp(cloud.points, axis=0))
    return bounds.part(Gap.CONTACTS) / diagonal, bounds.bound / diagonal


@pytest.mark.slow
def test_contours_are_swept_again_until_they_are_known_within_the_tolerance():
    recording = scanned("gem.glb", tolerance=4e-3)
    assert set(np.bincount(recording.sweep)) > {10}
    assert relative_gaps(recording)[1] < 4e-3
    without = scanned("gem.glb")
    assert set(np.bincount(without.sweep)) == {10}
    assert relative_gaps(without)[0] > 4e-3


# Corners of a wing's section.
WING = [
    [-89, -557], [-12, -306], [131, 313], [131, 319], [132, 320], [132, 321], [131, 331], [129, 350], [125, 359], [106, 339],
    [94, 320], [59, 235], [-61, -98], [-138, -321], [-209, -541], [-203, -603], [-198, -613], [-186, -623], [-172, -627],
    [-154, -623], [-117, -597], [-93, -566],
]  # fmt: skip


@pytest.mark.slow
def test_contours_of_which_the_rods_tip_alone_touched_a_part_are_swept_from_further_directions(monkeypatch):
    """No normal is measured there, so that more samples do not help."""
    corners = np.array(WING, dtype=float)
    ends = [np.column_stack([corners, np.full(len(corners), z)]) for z in (0.0, 600.0)]
    body = trimesh.convex.convex_hull(np.concatenate(ends))
    plan = scan3d.Plan(slices=6, samples=16, tolerance=1e-4, friction=(0.0, 0.4))
    recording = scan3d.simulate(body, plan)
    assert relative_gaps(recording)[0] < 1e-4
    monkeypatch.setattr(AxisScan, "sweep_further", lambda *_: False)
    without = scan3d.simulate(body, plan)
    assert relative_gaps(without)[0] > 2e-4
    assert recording.sweep.max() > without.sweep.max()


@pytest.mark.trust
def test_contours_are_known_before_close_slices_are_chosen():
    """The gaps between contacts would make the secants between close slices steep, so that hundreds of slices were needed."""
    body = scan3d.load_mesh(FOLDER / "capsule.stl")
    plan = scan3d.Plan(slices=200, samples=16, tolerance=1e-3)
    recording = scan3d.simulate(body, plan)
    assert relative_gaps(recording)[1] < 1e-3
    assert len(np.unique(scan3d.reconstruct(recording).slice_height.round(6))) < 80
    assert max(np.bincount(recording.sweep)) <= 16 * 16


@pytest.mark.parametrize("samples", [2, 3, 64])
def test_samples_go_from_touch_down_to_the_end_denser_at_the_start(samples):
    shares = base_fractions(samples)
    assert (shares[0], shares[-1]) == (0.0, pytest.approx(1.0))
    assert np.all(np.diff(shares) > 0)
    assert np.all(np.diff(shares, 2) > 0)


def circle(angles):
    normals = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return normals, normals


def test_a_gap_is_aimed_at_in_its_middle():
    angles = np.deg2rad(np.arange(0, 300.5, 0.5))  # nothing between 300° and 360°
    (direction,) = further_directions(*circle(angles), width=2.0)
    # the rod, pointing along the direction, meets the normal n = (sin α̃, -cos α̃) of the clamp's frame at the slope aimed at
    y = np.array([np.cos(direction), np.sin(direction)])
    x = np.array([y[1], -y[0]])
    met = np.sin(AIMED_SLOPE) * x - np.cos(AIMED_SLOPE) * y
    assert met == pytest.approx([np.cos(np.deg2rad(330)), np.sin(np.deg2rad(330))], abs=2e-3)  # rounded to 0.001 rad


def square(reach):
    """Contacts on the sides of the square from -1 to 1, as far as `reach` from their middles."""
    along, side = np.linspace(-reach, reach, 11), np.ones(11)
    sides = [(side, along), (-along, side), (-side, -along), (along, -side)]
    normals = np.repeat([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]], 11, axis=0)
    return np.concatenate([np.stack(places, axis=1) for places in sides]), normals


def test_a_corner_that_was_not_reached_is_open():
    # its triangle is (1 - reach) / sqrt(2) high
    closed, open_ = (1 - fraction * OPEN_FRACTION * 2.0 * math.sqrt(2) for fraction in (0.9, 1.1))
    assert len(further_directions(*square(closed), width=2.0)) == 0
    assert len(further_directions(*square(open_), width=2.0)) == 4


OUTLINE = np.array([[3.0, 1.0], [7.0, 2.0], [6.0, 8.0], [2.0, 5.0]])
angles = st.floats(0.0, 2 * np.pi)


@given(angles, st.floats(1e-3, 50.0))
def test_the_base_line_keeps_its_distance_from_the_outline(angle, clearance):
    line = base_line(OUTLINE, angle, clearance)
    across = (OUTLINE - line.origin) @ line.axes[1]
    assert across.min() == pytest.approx(clearance, abs=1e-12)
