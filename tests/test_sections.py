"""Plane sections of convex meshes, against cubes, half-planes and trimesh."""

import itertools

import numpy as np
import pytest
import trimesh
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial import HalfspaceIntersection
from scipy.spatial.transform import Rotation
from shapes import as_mesh, box, rotation

from scan3d.geometry.sections import extent_along, slice_polygons


def is_strictly_convex(polygon):
    before, after = polygon - np.roll(polygon, 1, axis=0), np.roll(polygon, -1, axis=0) - polygon
    return bool((before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0] > 0).all())


def area(polygon):
    x, y = (polygon - polygon.mean(axis=0)).T if len(polygon) else polygon.T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def cube_section_area(normal, height):
    """Area of a section of the unit cube about the origin.

    It is d/dh of the volume below a plane, by inclusion and exclusion over the corners.
    """
    n = np.abs(normal)
    corners = np.array(list(itertools.product([0, 1], repeat=3)))
    below = np.maximum(height + n.sum() / 2 - corners @ n, 0)
    return float((-1.0) ** corners.sum(axis=1) @ below**2) / (2 * n.prod())


@given(seed=st.integers(0, 2**32 - 1), height=st.floats(-1, 1))
def test_slices_of_a_cube_in_any_rotation(seed, height):
    frame = rotation(seed)
    assume(np.abs(frame[2]).min() > 0.02)  # the formula cancels
    (polygon,) = slice_polygons(box(), frame, [height])
    assert area(polygon) == pytest.approx(cube_section_area(frame[2], height), abs=1e-12)
    assert is_strictly_convex(polygon)
    points = np.column_stack([polygon, np.full(len(polygon), height)]) @ frame
    on_faces = np.sort(np.abs(np.abs(points) - 0.5), axis=1)  # an edge is where two faces meet
    assert on_faces[:, :2].max(initial=0) < 1e-14
    assert np.abs(points).max(initial=0) < 0.5 + 1e-14


@given(
    seed=st.integers(0, 2**32 - 1),
    exponent=st.integers(-40, 40),
    shift=st.tuples(*[st.floats(-3, 3)] * 3),
)
@settings(max_examples=15)
def test_slices_move_with_their_body(seed, exponent, shift):
    hull = trimesh.convex.convex_hull(np.random.default_rng(seed).normal(size=(30, 3)))
    frame, scale = rotation(seed + 1), 2.0**exponent
    moved = as_mesh(scale * (hull.vertices + shift), hull.faces)
    low, high = extent_along(hull, frame[2])
    heights = np.linspace(low, high, 9)[1:-1]
    here = slice_polygons(hull, frame, heights)
    there = slice_polygons(moved, frame, scale * (heights + frame[2] @ shift))
    for a, b in zip(here, there, strict=True):
        assert area(b) / scale**2 == pytest.approx(area(a), rel=1e-13, abs=1e-13)
        gap = np.linalg.norm((a + frame[:2] @ shift)[:, None] - b / scale, axis=2)
        # where neighbouring edges are almost parallel, rounding moves their corner
        assert gap.min(axis=1).max() < 1e-12
        assert gap.min(axis=0).max() < 1e-12


@pytest.mark.parametrize("scale", [1, 1e-3, 1e-9])
def test_slices_of_a_sphere_against_half_planes(scale):
    # inside a plane the facets of a convex body are half-planes; this also is the 1 mm sphere in metres
    unit = trimesh.creation.icosphere(4)
    sphere = as_mesh(unit.vertices * scale, unit.faces)
    frame = rotation(8)
    heights = np.cos(np.linspace(0.1, 3, 7))
    polygons = slice_polygons(sphere, frame, scale * heights)
    normals = unit.face_normals @ frame.T
    offsets = np.einsum("fx,fx->f", unit.face_normals, unit.triangles[:, 0])
    for height, polygon in zip(heights, polygons, strict=True):
        planes = np.column_stack([normals[:, :2], normals[:, 2] * height - offsets])
        corners = HalfspaceIntersection(planes, np.zeros(2)).intersections
        gap = np.linalg.norm(corners[:, None] - polygon / scale, axis=2)
        assert gap.min(axis=1).max() < 1e-11  # nearly parallel half-planes meet this sharply
        assert gap.min(axis=0).max() < 1e-11
        assert is_strictly_convex(polygon)
        assert len(polygon) == len(slice_polygons(unit, frame, [height])[0])


def test_slices_against_trimesh():
    hull = trimesh.convex.convex_hull(np.random.default_rng(2).normal(size=(200, 3)))
    frame = rotation(9)
    for height in (-1.2, -0.3, 0.0, 0.8):
        (polygon,) = slice_polygons(hull, frame, [height])
        lines = trimesh.intersections.mesh_plane(hull, frame[2], height * frame[2]).reshape(-1, 3) @ frame.T
        gap = np.linalg.norm(lines[:, None, :2] - polygon, axis=2)
        assert gap.min(axis=1).max() < 1e-13
        assert gap.min(axis=0).max() < 1e-13


def test_slices_through_vertices_and_faces():
    cube = box(2, 2, 2).subdivide().subdivide()  # vertices at the middle, coplanar faces everywhere
    square = {(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)}
    for height in (0, 0.5, 0.3, 1, -1):  # the lid is a section too
        (polygon,) = slice_polygons(cube, np.eye(3), [height])
        assert len(polygon) == 4
        assert {tuple(p) for p in polygon} == square
        assert area(polygon) == 4
    for height in (1 + 1e-13, -1.1, np.nan, np.inf):
        assert slice_polygons(cube, np.eye(3), [height])[0].shape == (0, 2)


def test_a_plane_that_only_touches_gives_an_empty_polygon():
    cube = box(2, 2, 2)
    diagonal = Rotation.align_vectors([[0, 0, 1]], [[1, 1, 1]])[0].as_matrix()
    half = Rotation.from_euler("x", 45, degrees=True).as_matrix()
    assert slice_polygons(cube, diagonal, [np.sqrt(3)])[0].shape == (0, 2)  # a vertex
    assert slice_polygons(cube, half, [np.sqrt(2)])[0].shape == (0, 2)  # an edge
    # just below the vertex there is a triangle, small as it is
    (tip,) = slice_polygons(cube, diagonal, [np.sqrt(3) - 1e-9])
    assert len(tip) == 3
    assert area(tip) == pytest.approx(1.5 * np.sqrt(3) * 1e-18, rel=1e-5)


def test_slices_of_a_plate_and_a_needle():
    frame = rotation(12)
    for sides in ((1, 1, 1e-6), (1, 1e-6, 1e-6)):
        thin = as_mesh(box(*sides).vertices @ frame, box().faces)
        (polygon,) = slice_polygons(thin, frame[[1, 2, 0]], [0.1])
        assert len(polygon) == 4
        assert area(polygon) == pytest.approx(sides[1] * sides[2], rel=1e-9)


@pytest.mark.parametrize(("place", "gap"), [(0, 2**-53), (600, 2**-43)])
def test_coincident_vertices_become_one(place, gap):
    # a prism whose four upright edges are doubled, as near to each other as float64 allows at its place
    pairs = (0.5, 0.5 - gap), (0.5 - gap, 0.5)
    corners = np.array([[x * a, y * b, z] for x, y, z in itertools.product([-1, 1], repeat=3) for a, b in pairs])
    prism = as_mesh(corners + place, list(itertools.combinations(range(16), 3)))  # all edges there can be
    for height in (-1, 0.25, 1):
        (polygon,) = slice_polygons(prism, np.eye(3), [height + place])
        assert len(polygon) == 4
        assert area(polygon) == pytest.approx(1, abs=4 * gap)


def test_slices_come_in_the_order_of_the_heights():
    cone = trimesh.creation.cone(1, 1, sections=32)
    heights = [0.7, 0.1, 2.0, 0.4]
    areas = [area(p) for p in slice_polygons(cone, np.eye(3), heights)]
    full = 16 * np.sin(2 * np.pi / 32)
    np.testing.assert_allclose(areas, [full * 0.3**2, full * 0.9**2, 0, full * 0.6**2], atol=1e-14)
    assert slice_polygons(cone, np.eye(3), []) == []


def test_extent_along():
    body = as_mesh(box(2, 4, 6).vertices + np.array([1, 0, 0]), box().faces)
    assert extent_along(body, [1, 0, 0]) == (0, 2)
    assert extent_along(body, [0, -5, 0]) == (-2, 2)
    assert extent_along(body, [1, 1, 1]) == pytest.approx(np.array([-5, 7]) / np.sqrt(3))
    for bad in ([0, 0, 0], [1, 2], [np.nan, 0, 1], [np.inf, 0, 1]):
        with pytest.raises(ValueError, match="axis"):
            extent_along(body, bad)
