"""Plane sections of convex meshes, against cubes, half-planes and trimesh."""

import itertools

import numpy as np
import pytest
import trimesh
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial import HalfspaceIntersection
from scipy.spatial.transform import Rotation
from shapes import as_mesh, box, rotation

from scan3d.geometry.sections import slice_polygons


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


def test_slices_through_vertices_and_faces():
    cube = box(2, 2, 2).subdivide().subdivide()  # vertices at the middle, coplanar faces everywhere
    square = {(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)}
    for height in (0, 0.5, 0.3, 1, -1):  # the lid is a section too
        (polygon,) = slice_polygons(cube, np.eye(3), [height])
        assert len(polygon) == 4
        assert {tuple(p) for p in polygon} == square
        assert area(polygon) == 4
    for height in (1 + 1e-10, -1.1, np.nan, np.inf):
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
