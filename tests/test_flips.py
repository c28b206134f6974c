"""Facets of nearly convex meshes by flips of their edges, against Qhull."""

import numpy as np
import pytest
import trimesh
from brute_force import farthest
from scipy.spatial import ConvexHull
from shapes import ball, cube, dented, letter_l, without

from scan3d.files.meshes import judge_mesh
from scan3d.geometry.edges import opposite_edges
from scan3d.geometry.flips import facets_by_flips, without_slivers


def rows(faces):
    """Triangles as a set, whichever corner comes first."""
    return {tuple(np.roll(face, -face.argmin()).tolist()) for face in np.asarray(faces)}


def rounded(seed, count=2000, decimals=4):
    """A body of random points whose coordinates were rounded, so that edges between close points are reflex."""
    mesh = ball(seed, count)
    mesh.vertices = np.round(mesh.vertices, decimals)
    return mesh


def turned_edges(points, faces, seed, count):
    """A hull with some of its edges flipped inwards: other diagonals of pairs of faces that share no face."""
    faces, opposite = faces.copy(), opposite_edges(faces).ravel()
    taken = np.zeros(len(faces), dtype=bool)
    for edge in np.random.default_rng(seed).permutation(faces.size)[:count]:
        (one, k), (other, j) = divmod(edge, 3), divmod(opposite[edge], 3)
        if not taken[[one, other]].any():
            taken[[one, other]] = True
            (start, end, left), right = np.roll(faces[one], -k), faces[other, (j + 2) % 3]
            faces[one], faces[other] = (left, start, right), (right, end, left)
    return faces


@pytest.mark.parametrize("inside_out", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_reflex_edges_of_rounded_coordinates_are_flipped_to_the_hull(seed, inside_out):
    mesh = rounded(seed)
    points, faces = mesh.vertices.view(np.ndarray), mesh.faces.view(np.ndarray)
    facets, replaced = facets_by_flips(points, faces[:, ::-1] if inside_out else faces)
    assert replaced.any()
    hull = ConvexHull(points)
    assert rows(np.sort(facets, axis=1)) == rows(np.sort(hull.simplices, axis=1))
    assert trimesh.Trimesh(points, facets, process=False).volume == pytest.approx(hull.volume, rel=1e-12)
    assert rows(facets[~replaced]) <= rows(faces)


@pytest.mark.parametrize("seed", range(5))
def test_edges_that_were_turned_inwards_are_turned_back(seed):
    body = ball(seed, 300)
    points, faces = body.vertices.view(np.ndarray), body.faces.view(np.ndarray)
    turned = turned_edges(points, faces, seed, 40)
    found = facets_by_flips(points, turned)
    # flips of random diagonals need not lead back, but what is found is the hull
    assert found is None or rows(found[0]) == rows(faces)
    assert rows(turned) != rows(faces)


def test_a_convex_body_keeps_its_faces():
    body = ball(7, 300)
    facets, replaced = facets_by_flips(body.vertices.view(np.ndarray), body.faces.view(np.ndarray))
    assert np.array_equal(facets, body.faces)
    assert not replaced.any()


@pytest.mark.parametrize("mesh", [cube(), dented(0.1), letter_l(), without(ball(7, 300), slice(5, None))])
def test_what_flips_do_not_make_strictly_convex_is_left_to_qhull(mesh):
    points = mesh.vertices.view(np.ndarray)
    assert facets_by_flips((points - points.mean(axis=0)) / 10, mesh.faces.view(np.ndarray)) is None


@pytest.mark.parametrize("decimals", [3, 4, 5])
def test_a_body_has_the_same_dent_as_by_qhull(decimals, monkeypatch):
    by_flips = judge_mesh(rounded(3, decimals=decimals), hull=True)
    monkeypatch.setattr("scan3d.files.meshes.facets_by_flips", lambda *_: None)
    by_qhull = judge_mesh(rounded(3, decimals=decimals), hull=True)
    assert rows(by_flips.faces) == rows(by_qhull.faces)
    # the precision to which dents are searched
    assert 0 < by_flips.metadata["dent"] == pytest.approx(by_qhull.metadata["dent"], rel=1e-3)
    assert by_flips.metadata["geometry_sha256"] == by_qhull.metadata["geometry_sha256"]


def over_square(height):
    """A pyramid over a square whose base has been divided by the one diagonal, with the other at a height above it."""
    points = np.array([(-1, 0, 0), (1, 0, 0), (0.3, -1e-12, height), (0.3, 1, height), (0, 0.3, -3.0)])
    return points, np.array([(0, 1, 3), (1, 0, 2), (0, 3, 4), (3, 1, 4), (1, 2, 4), (2, 0, 4)])


@pytest.mark.parametrize("inside_out", [False, True])
@pytest.mark.parametrize("height", [0.0, 1e-13, 5e-12])
def test_a_sliver_is_removed_by_the_flip_of_its_longest_edge(height, inside_out):
    points, faces = over_square(height)
    faces = faces[:, ::-1] if inside_out else faces
    flipped, opposite, moved = without_slivers(points, faces, opposite_edges(faces), 1e-10)
    assert rows(flipped) == rows([(3, 0, 2), (2, 1, 3), *over_square(height)[1][2:].tolist()])
    assert np.array_equal(opposite, opposite_edges(flipped))
    before, after = (trimesh.Trimesh(points, part, process=False) for part in (faces, flipped))
    true = max(farthest(before, after, 10), farthest(after, before, 10))
    assert true <= moved + 1e-15
    assert moved <= np.hypot(height, 1e-12) + 1e-15


def test_triangles_higher_than_the_limit_stay():
    points, faces = over_square(1e-3)
    flipped, opposite, moved = without_slivers(points, faces, opposite_edges(faces), 1e-10)
    assert np.array_equal(flipped, faces)
    assert np.array_equal(opposite, opposite_edges(faces))
    assert moved == 0.0
