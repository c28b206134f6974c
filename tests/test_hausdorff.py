"""The Hausdorff distance and its certified bounds, against authorities that share nothing with the program.

Brute force in extended precision, support functions (for convex bodies the Hausdorff distance is the largest difference of
theirs), and bodies whose distances are known.
"""

import numpy as np
import pytest
import trimesh
from brute_force import EXACT, by_support, certified, far, farthest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapes import PAIRS, cube, dented, inscribed_radius, moved, pinhole, polytope, rotation

from scan3d.comparison import compare


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


@pytest.mark.slow
@pytest.mark.parametrize("pair", PAIRS.values(), ids=PAIRS)
def test_against_support_functions(pair):
    assert compare(*pair).hausdorff == pytest.approx(by_support(*pair), rel=1e-9, abs=1e-11)


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(seeds=st.tuples(*[st.integers(0, 2**32 - 1)] * 2), count=st.integers(4, 40), flat=st.floats(0.01, 1.0))
def test_random_polytopes_against_brute_force(seeds, count, flat):
    surface, mesh = (polytope(seed, count, (1.0, 1.0, flat)) for seed in seeds)
    result = certified(compare(surface, mesh))
    expected = max(far(surface.vertices, mesh).max(), far(mesh.vertices, surface).max())
    assert result.exact
    assert result.hausdorff == pytest.approx(expected, abs=EXACT * result.diagonal)


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
