"""Surfaces of bodies of any shape, against bodies of known shape: the Cassini oval turned about its axis, which has a waist."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from rings import cassini, recording_of
from scipy.spatial import cKDTree
from shapes import letter_l

import scan3d
from scan3d.bounds.free_space import contradicted, outer_contours, sheets_of, spacing_of
from scan3d.cloud import TOUCHED
from scan3d.errors import InputError
from scan3d.geometry.distance import Search
from scan3d.geometry.hulls import hull
from scan3d.planning.plan import aimed_line, aims
from scan3d.poses import Move
from scan3d.reconstruction.contacts import contacts
from scan3d.recording import of_rows
from scan3d.surfaces.any_shape import any_shape

pytestmark = pytest.mark.slow

HEIGHTS = np.linspace(-24.5, 24.5, 17)


@functools.cache
def peanut():
    recording = recording_of(cassini, HEIGHTS, samples=24)
    return recording, contacts(recording)


def off_the_oval(points):
    """Distance in its plane of points (n, 3) from the oval."""
    return np.abs(np.hypot(points[:, 0], points[:, 1]) - cassini(points[:, 2]))


def test_surface_of_a_body_with_a_waist():
    recording, cloud = peanut()
    found = any_shape(recording, cloud)
    surface = found.surface
    assert surface.is_watertight
    assert surface.is_winding_consistent
    between = np.abs(surface.vertices[:, 2]) < 23
    diagonal = np.linalg.norm(np.ptp(surface.vertices, axis=0))
    assert off_the_oval(surface.vertices[between]).max() < 0.01 * diagonal
    # the hull fills the waist, whose radius is 6.3 mm
    assert cassini(0.0) < 6.4
    assert hull(cloud.points).volume > 1.1 * surface.volume
    middle = np.abs(surface.vertices[:, 2]) < 2
    assert np.hypot(*surface.vertices[middle, :2].T).max() < 6.8


def test_surface_of_a_convex_body_is_a_hull_without_folds():
    recording = recording_of(lambda z: np.where(abs(z) < 20, 9.0, 0.0), HEIGHTS, samples=24)
    found = any_shape(recording, contacts(recording))
    assert found.surface.volume == pytest.approx(hull(found.surface.vertices).volume, rel=1e-3)
    one, other = (patch["area"] for patch in found.coverage["unknown"][:2])  # a disc at either end
    assert one == pytest.approx(other, rel=0.01)


def test_no_contact_lies_deep_in_the_body():
    """Not even in the corner of an L, which only tips reach."""
    recording = scan3d.simulate(letter_l(), scan3d.Plan(slices=6, samples=24, friction=0.3, probing="off"))
    cloud = scan3d.reconstruct(recording)
    faces = any_shape(recording, cloud).surface.triangles
    assert Search(np.asarray(faces)).nearest(cloud.points)[0].max() < spacing_of(cloud) / 3


def test_sweeps_of_one_contact_each_resolve_what_their_clamps_pass():
    recording, cloud = peanut()
    alone = cloud.select(np.unique(cloud.sweep, return_index=True)[1])
    with pytest.raises(InputError, match="no sweep with two contacts one after the other"):
        spacing_of(alone)
    same = np.diff(recording.sweep) == 0
    step = 1e3 * np.median(np.linalg.norm(np.diff(recording.position_m, axis=0), axis=1)[same])
    assert spacing_of(alone, recording) == pytest.approx(step)


def test_vertices_that_are_known_lie_near_a_contact():
    recording, cloud = peanut()
    found = any_shape(recording, cloud)
    classes = found.surface.vertex_attributes["known"]
    known = found.surface.vertices[classes == 2]
    size = np.linalg.norm(np.ptp(cloud.points, axis=0))
    assert cKDTree(cloud.points).query(known)[0].max() <= TOUCHED * size
    assert off_the_oval(known[np.abs(known[:, 2]) < 22]).max() < spacing_of(cloud)
    assert np.isin(np.unique(classes), [0, 1, 2]).all()
    # nothing has been felt of the flat ends, next to which slices are farthest apart on the surface, even if every twelfth
    # contact is missing
    for part in (found, any_shape(recording, cloud.select(np.arange(len(cloud)) % 12 > 0))):
        assert sorted(np.sign(patch["center"][2]) for patch in part.coverage["unknown"][:2]) == [-1, 1]
        assert all(abs(patch["center"][2]) > 19 for patch in part.coverage["unknown"])
    area = sum(patch["area"] for patch in found.coverage["unknown"])
    shares = found.coverage["known"] + found.coverage["estimated"] + area / found.surface.area
    assert shares == pytest.approx(1, abs=1e-9)


def test_contours_lie_within_their_bound_of_the_oval():
    recording, cloud = peanut()
    contours = outer_contours(sheets_of(recording, cloud), cloud)
    assert (off_the_oval(contours.points) <= contours.distance).all()
    assert contours.distance.max() < 1.5 * spacing_of(cloud)
    assert any_shape(recording, cloud).contours_bound == contours.distance.max()


def test_no_free_cell_lies_inside_the_oval():
    recording, cloud = peanut()
    (sheet,) = sheets_of(recording, cloud)
    number, y, x = np.nonzero(sheet.free)
    radius = np.hypot(*(sheet.origin[:, None] + sheet.cell * np.stack([x, y])))
    assert (radius > cassini(sheet.height[number]) - sheet.cell).all()
    assert sheet.free.any(axis=(1, 2)).all()


def test_free_space_does_not_depend_on_rows_that_gave_no_contact():
    """Rods that were felt and gave no contact pass nothing: their steps are left out, and the others stay."""
    recording, cloud = peanut()
    (whole,) = sheets_of(recording, cloud)
    kept = np.ones(len(cloud), dtype=bool)
    kept[::7] = False
    (part,) = sheets_of(recording, cloud.select(kept))
    assert part.cell == pytest.approx(whole.cell, rel=0.2)
    assert (part.depth.min(axis=(1, 2)) <= 0).any()
    points = np.random.default_rng(0).uniform(-15, 15, (2000, 3))
    assert (part.at(points)[0] > whole.cell).sum() < (whole.at(points)[0] > whole.cell).sum()


def test_a_contact_in_free_space_is_refused():
    recording, cloud = peanut()
    points = cloud.points.copy()
    wrong = np.array([100, 2000])
    points[wrong, :2] *= 1.6
    false = replace(cloud, points=points)
    assert contradicted(sheets_of(recording, false), false)[wrong].all()
    surface = any_shape(recording, false).surface
    assert off_the_oval(surface.vertices[np.abs(surface.vertices[:, 2]) < 22]).max() < 0.8


def test_what_has_no_free_space_is_refused():
    recording, cloud = peanut()
    curved = replace(recording, rod=replace(recording.rod, curvature_per_m=-3.0))
    flat = recording_of(cassini, [0.0])
    for given, words in (
        ((recording, replace(cloud, model="spatial")), "needs the planar model"),
        ((curved, cloud), "straight, uniform and weightless"),
        ((flat, scan3d.reconstruct(flat)), "in a plane"),
    ):
        with pytest.raises(InputError, match=words):
            any_shape(*given)


def test_the_surface_ends_halfway_to_the_next_slice_without_contact():
    """Where the body ends between two planes is not known: halfway is at most wrong by half of what they are apart."""
    recording = recording_of(cassini, np.linspace(-28.6, 28.6, 12), samples=24)
    cloud = contacts(recording)
    heights = any_shape(recording, cloud).surface.vertices[:, 2]
    top = np.sqrt(18.0**2 + 19.08**2)
    assert cloud.points[:, 2].max() < 24 < heights.max() < 28.6
    assert abs(heights.max() - top) < 2.6
    assert abs(heights.min() + top) < 2.6


@pytest.fixture(scope="module")
def parts():
    flat = letter_l()
    flat.vertices *= (1, 1, 0.1)
    recording = scan3d.simulate(flat, scan3d.Plan(slices=2, samples=24, probing="off"))
    # of twelve sweeps in each slice, and of six beyond either end
    return [(part, scan3d.reconstruct(part)) for part in (of_rows(recording, recording.sweep < 36), recording)]


def test_aimed_sweeps_reach_into_the_bay(parts):
    before, after = (outer_contours(sheets_of(*part), part[1]).distance.max() for part in parts)
    assert after < 0.9 * before
    # the bay's corner, x = y = 1
    before, after = (np.linalg.norm(cloud.points[:, :2] - 1.0, axis=1).min() for _, cloud in parts)
    assert after < 0.4 * before


def test_aims_point_at_the_widest_stretch(parts):
    recording, cloud = parts[0]
    sheets, found = sheets_of(recording, cloud), aims(recording, cloud)
    assert [aim.width for aim in found] == sorted((aim.width for aim in found), reverse=True)
    widest = outer_contours(sheets, cloud).distance.max()
    assert found[0].width == pytest.approx(widest)
    assert min(aim.width for aim in found) > sheets[0].apart
    # into the bay, from the side of x + y = 3, and as far as half of what may lie behind the stretch
    direction = np.array([np.cos(found[0].angle), np.sin(found[0].angle)])
    assert direction @ (-1, -1) > 0.5 * np.sqrt(2)
    line = aimed_line(found[0], letter_l().vertices[:, :2], 10.0, 0.5)
    assert line.origin @ direction + 10.0 == pytest.approx(found[0].tip)
    near = aimed_line(found[0], letter_l().vertices[:, :2], 1.0, 0.5)
    assert near.origin @ direction == pytest.approx((letter_l().vertices[:, :2] @ direction).min() - 0.5)


def sweeps_turned_round(recording):
    """The rows (n,) of a recording, every second sweep backwards."""
    time = np.arange(len(recording))
    return np.lexsort((np.where(recording.sweep % 2, -time, time), recording.sweep))


def test_a_session_probes_a_body_that_is_not_convex(parts):
    recording, _ = parts[0]
    moved = replace(recording, position_m=recording.position_m - np.array([1e-3, 1e-3, 0.0]))
    session = scan3d.Session("cylinder:2.9x0.6", recording.rod, tolerance=0.1)
    session.tell(moved)
    assert "between them nothing" in session.known
    assert session.known in session.summary()[-1][1]
    wrong = scan3d.Session("cylinder:2.9x0.6", recording.rod)
    wrong.tell(of_rows(moved, sweeps_turned_round(moved)))
    assert wrong.warnings
    assert not wrong.cloud.convex
    assert wrong.known == "nothing is certified: the recording contradicts the model"
    poses = session.ask(16)
    moves = poses.move[np.concatenate(poses.sweeps())]
    assert len(moves)
    assert (moves == Move.PROBE).all()
    rods = np.stack([poses.position_m, poses.position_m + recording.rod.length_m * poses.axes()[:, 1]])
    assert 1000 * rods[..., 2].min() > session.plan.space().floor - 1e-9
