"""The Hausdorff distance and its certified bounds, against authorities that share nothing with the program.

Brute force in extended precision, support functions (for convex bodies the Hausdorff distance is the largest difference of
theirs), and bodies whose distances are known.
"""

import dataclasses

import numpy as np
import pytest
import trimesh
from brute_force import EXACT, GAP, by_support, certified, far, farthest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import directed_hausdorff
from shapes import PAIRS, angle_bracket, cube, dented, inscribed_radius, moved, pinhole, polytope, quad, rotation

from scan3d.comparison import compare
from scan3d.geometry.hausdorff import one_sided_distances, prepare

pytestmark = pytest.mark.usefixtures("few_samples")


@pytest.mark.parametrize("pair", PAIRS.values(), ids=PAIRS)
def test_against_brute_force_in_extended_precision(pair):
    surface, mesh = pair
    result = certified(compare(surface, mesh))
    expected = max(far(surface.vertices, mesh).max(), far(mesh.vertices, surface).max())
    assert result.exact
    assert result.hausdorff == pytest.approx(expected, abs=EXACT * result.diagonal, rel=1e-11)
    source, target = pair if result.worst_on == "surface" else pair[::-1]
    assert far(result.worst_point[None], source)[0] <= EXACT * result.diagonal
    assert far(result.worst_point[None], target)[0] == pytest.approx(result.hausdorff, abs=EXACT * result.diagonal)


@pytest.mark.parametrize("pair", PAIRS.values(), ids=PAIRS)
def test_against_support_functions(pair):
    assert compare(*pair).hausdorff == pytest.approx(by_support(*pair), rel=1e-9, abs=1e-11)


@pytest.mark.parametrize("pair", PAIRS.values(), ids=PAIRS)
@pytest.mark.slow
def test_one_sided_distances_against_dense_points(pair):
    result = compare(*pair)
    for source, target, lower, upper in (
        (*pair, result.surface_to_mesh, result.surface_to_mesh_upper),
        (*pair[::-1], result.mesh_to_surface, result.mesh_to_surface_upper),
    ):
        dense = farthest(source, target, 6)
        assert dense <= upper + EXACT * result.diagonal
        assert dense <= lower * GAP + 1e-9 * result.diagonal
        assert lower <= result.hausdorff


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(seeds=st.tuples(*[st.integers(0, 2**32 - 1)] * 2), count=st.integers(4, 40), flat=st.floats(0.01, 1.0))
def test_random_polytopes_against_brute_force(seeds, count, flat):
    surface, mesh = (polytope(seed, count, (1.0, 1.0, flat)) for seed in seeds)
    result = certified(compare(surface, mesh))
    expected = max(far(surface.vertices, mesh).max(), far(mesh.vertices, surface).max())
    assert result.exact
    assert result.hausdorff == pytest.approx(expected, abs=EXACT * result.diagonal)


@pytest.mark.parametrize(
    "shift", [(0.1, 0.0, 0.0), (0.1, -0.2, 0.0), (0.1, 0.2, 0.3), (7.0, 0.0, 0.0), (1e-7, 0.0, 0.0)]
)
def test_translation_of_a_body_is_its_length(shift):
    result = compare(cube(1.0, shift), cube(1.0))
    assert result.hausdorff == pytest.approx(np.linalg.norm(shift), rel=1e-8)


@pytest.mark.parametrize(("depth", "exact"), [(0.0, True), (1e-12, True), (1e-7, False), (1e-3, False), (0.3, False)])
def test_dents_deeper_than_rounding_count(depth, exact):
    result = certified(compare(dented(depth), cube()))
    assert result.exact == exact
    assert result.lower <= depth + EXACT
    assert result.upper >= depth - EXACT
    # One side of the dent is not enough: the farthest point of the cube from the dented one is over the dent.
    larger = certified(compare(dented(depth), cube(1.1)))
    assert larger.exact == exact
    assert larger.lower <= max(np.sqrt(3) * 0.1, 0.1 + depth) + EXACT
    assert larger.upper >= np.sqrt(3) * 0.1 - EXACT


def test_bent_quad_cut_both_ways():
    """All vertices are shared; the diagonals pass each other at half the bend, less for its slope."""
    height = 0.5
    result = certified(compare(quad(0, height), quad(1, height)))
    truth = height / np.sqrt(1 + 2 * height**2)
    assert not result.exact
    assert result.lower <= truth * (1 + 1e-12)
    assert result.upper >= truth * (1 - 1e-12)
    assert directed_hausdorff(quad(0).vertices, quad(1).vertices)[0] == 0.0


def test_an_angle_bracket_and_the_box_around_it():
    box = cube((1.0, 1.0, 0.5), (1.0, 1.0, 0.5))
    result = certified(compare(angle_bracket(), box))
    assert not result.exact
    # The box's edge x = y = 2 is 1 from the notch; halfway up the notch's edge, the lids are 0.5 away.
    assert result.mesh_to_surface <= 1.0 <= result.mesh_to_surface_upper * (1 + 1e-12)
    assert result.surface_to_mesh <= 0.5 <= result.surface_to_mesh_upper * (1 + 1e-12)
    assert result.surface_to_mesh == pytest.approx(0.5, rel=1e-3)
    assert result.volume_error == pytest.approx(-0.25)


@pytest.mark.parametrize("shift", [(0.02, 0.0, 0.01), (0.0, 0.3, 0.1), (0.0, 0.0, 3.0)])
@pytest.mark.slow
def test_bounds_for_tori_enclose_the_distances_of_dense_points(shift):
    torus = trimesh.creation.torus(1.0, 0.4, 16, 8)
    other = moved(torus, shift, rotation=rotation(5))
    result = certified(compare(other, torus))
    for source, target, lower, upper in (
        (other, torus, result.surface_to_mesh, result.surface_to_mesh_upper),
        (torus, other, result.mesh_to_surface, result.mesh_to_surface_upper),
    ):
        dense = farthest(source, target, 6)
        assert dense <= upper * (1 + 1e-12)
        assert lower >= dense * (1 - 1e-3)
    source, target = (other, torus) if result.worst_on == "surface" else (torus, other)
    assert far(result.worst_point[None], source)[0] <= EXACT * result.diagonal
    assert far(result.worst_point[None], target)[0] == pytest.approx(result.lower, rel=1e-12)


def test_a_box_without_lid_is_not_taken_for_a_convex_body():
    lid = cube().face_normals[:, 2] > 0.5
    result = certified(compare(trimesh.Trimesh(cube().vertices, cube().faces[~lid], process=False), cube()))
    assert not result.exact
    assert result.mesh_to_surface == pytest.approx(1.0, rel=1e-3)  # from the middle of the lid
    assert np.isnan(result.volume_error)


@pytest.mark.parametrize("depth", [1e-7, 1e-6, 1e-5])
def test_the_upper_bound_includes_a_dent_too_shallow_to_be_searched(depth):
    """A square 0.5 above the dented face: its vertices are 0.5 away from the body, the point above the dent a little more."""
    body = dented(depth)
    corners = [(1.5, -1.0, -1.0), (1.5, 1.0, -1.0), (1.5, 1.0, 1.0), (1.5, -1.0, 1.0)]
    square = trimesh.Trimesh(corners, [(0, 1, 2), (0, 2, 3)], process=False)
    truth = far(np.array([[1.5, 0.0, 0.0]]), body)[0]
    assert truth == pytest.approx(0.5 + depth, rel=1e-9)
    for source in (square, cube((1.5, 1.0, 1.0))):
        result = certified(compare(source, body))
        assert not result.exact
        assert result.surface_to_mesh_upper >= truth


@pytest.mark.parametrize("side", [1e-3, 1e-4])
def test_the_upper_bound_includes_a_pinhole(side):
    mesh, hole = pinhole(side)
    above = hole.mean(axis=0) + np.array([0.0, 0.0, 0.5])
    truth = far(above[None], mesh)[0]
    assert truth == pytest.approx(np.hypot(0.5, inscribed_radius(hole)), rel=1e-6)
    assert truth > 0.5
    result = certified(compare(cube((1.0, 1.0, 1.5)), mesh))
    assert not result.exact
    assert result.surface_to_mesh_upper >= truth


# --- bodies that are convex up to a shallow valley, or closed up to a pinhole ---


def box_with_a_valley(depth):
    """A cube, two corners of whose top lie `depth` lower, and so does the edge between them."""
    cube = trimesh.creation.box((2, 2, 2))
    vertices = np.array(cube.vertices)
    top = vertices[:, 2] > 0
    low = top & (vertices[:, 0] * vertices[:, 1] < 0)
    vertices[low, 2] -= depth
    (a, c), (b, d) = np.flatnonzero(top & ~low), np.flatnonzero(low)
    sides = [face for face in cube.faces if not top[face].all()]
    for face in ([a, b, d], [c, d, b]):
        upward = np.cross(vertices[face[1]] - vertices[face[0]], vertices[face[2]] - vertices[face[0]])[2] > 0
        sides.append(face if upward else face[::-1])
    return trimesh.Trimesh(vertices, sides, process=False)


def test_the_bound_allows_for_a_depth_below_the_hull():
    """A ridge over a valley: the distance is `height` at all vertices, and larger by the valley's depth in the middle."""
    depth, height = 2e-6, 0.1
    valley = box_with_a_valley(depth)
    raised = np.array(valley.vertices)
    raised[raised[:, 2] > 0, 2] += height
    ridge = trimesh.Trimesh(raised, process=False).convex_hull
    result = compare(ridge, valley)
    assert not result.exact
    assert result.lower <= height + depth
    assert result.upper >= height + depth * (1 - 1e-3)
    assert result.upper <= height * 1.001


def test_the_bound_of_the_smaller_one_sided_distance_allows_for_a_depth_below_the_hull():
    """A wedge whose ridge runs across the valley, with its other vertices lower; the cube's bottom is farther from it."""
    depth, height = 2e-6, 0.1
    valley = box_with_a_valley(depth)
    upper = valley.vertices[(valley.vertices[:, 2] > 0) & (valley.vertices[:, 0] * valley.vertices[:, 1] > 0)]
    beside = [(0.2, -0.2, 1 + height / 2), (-0.2, 0.2, 1 + height / 2)]
    wedge = trimesh.Trimesh(np.vstack([upper + np.array([0, 0, height]), beside]), process=False).convex_hull
    result = compare(wedge, valley)
    assert not result.exact
    assert result.surface_to_mesh_upper < 0.5 * result.mesh_to_surface
    assert result.surface_to_mesh <= height + depth
    assert result.surface_to_mesh_upper >= height + depth * (1 - 1e-3)
    # in the middle of the upper faces the surface lies 2/3 of the depth below its hull, and three times
    # this depth is allowed for, along rays from the middle of the cube, whose corners are √3 times as far as its faces
    assert result.surface_to_mesh_upper == pytest.approx(height + 2 * np.sqrt(3) * depth, abs=1e-3 * depth)


@pytest.mark.slow
def test_a_pinhole_between_two_cubes_counts():
    """A hole that is smaller than the winding number resolves: its middle is as far from the surface as from the rim."""
    side = 2e-3
    cube = trimesh.creation.box((2, 2, 2))
    rim = side / np.sqrt(3) * np.array([(np.cos(t), np.sin(t)) for t in 2 * np.pi * np.arange(3) / 3])
    vertices = np.vstack([cube.vertices, np.column_stack([rim, np.ones(3)])])
    top = [face for face in cube.faces if (cube.vertices[face, 2] > 0).all()]
    rest = [face for face in cube.faces if not (cube.vertices[face, 2] > 0).all()]
    corners = np.unique(top)
    corners = corners[np.argsort(np.arctan2(*cube.vertices[corners, 1::-1].T))]
    outer, inner = list(corners), [8, 9, 10]
    ring = ring_between(vertices, outer, inner)
    holed = trimesh.Trimesh(vertices, np.array([*rest, *ring]), process=False)
    assert holed.area == pytest.approx(24 - np.sqrt(3) / 4 * side**2, rel=1e-12)
    truth = side / (2 * np.sqrt(3))
    for result in (compare(cube, holed), compare(holed, cube)):
        assert not result.exact
        assert result.lower <= truth * (1 + 1e-12)
        assert result.upper >= truth * (1 - 1e-12)


def ring_between(vertices, outer, inner):
    """Upward triangles between two rings of vertices around the z axis, in the order of the angle."""

    def angle(k):
        return np.arctan2(vertices[k, 1], vertices[k, 0]) % (2 * np.pi)

    outer, inner = sorted(outer, key=angle), sorted(inner, key=angle)
    i = j = 0
    faces = []
    while i < len(outer) or j < len(inner):
        a, b = outer[i % len(outer)], inner[j % len(inner)]
        next_a = angle(outer[(i + 1) % len(outer)]) + 2 * np.pi * ((i + 1) // len(outer))
        next_b = angle(inner[(j + 1) % len(inner)]) + 2 * np.pi * ((j + 1) // len(inner))
        if j == len(inner) or (i < len(outer) and next_a <= next_b):
            faces.append((a, outer[(i + 1) % len(outer)], b))
            i += 1
        else:
            faces.append((a, inner[(j + 1) % len(inner)], b))
            j += 1
    return faces


def test_the_slack_of_both_bodies_widens_the_bound():
    """Each body's hull is within its slack, and the vertices' distances are those from the larger slack's surface."""
    smaller, larger = (prepare(cube(half), np.zeros(3), 1.0) for half in (1.0, 1.1))
    bodies = dataclasses.replace(smaller, slack=1e-5), dataclasses.replace(larger, slack=3e-5)
    for pair in (bodies, bodies[::-1]):
        worst = max(one_sided_distances((pair, pair[::-1]), exact=False), key=lambda side: side.lower)
        assert worst.lower == pytest.approx(0.1 * np.sqrt(3), rel=1e-12)
        assert worst.upper == pytest.approx(worst.lower + 1e-5 + 3e-5 + 3e-5, rel=1e-12)
