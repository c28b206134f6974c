"""Convexity by edges, against hulls of Qhull, brute force over all vertices, and surfaces that no edge shows to be bad."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull
from shapes import as_mesh, ball, cube, letter_l, moved, rotation, without

from scan3d.files.meshes import load_mesh, read_mesh
from scan3d.geometry.edges import opposite_edges, outward_faces, planes_by_edges, turns
from scan3d.geometry.hull_distance import CONVEX_DEPTH, against_hull, distance_to_hull, prepare_facets

MESHES = sorted(
    path for path in (Path(__file__).parents[1] / "meshes").iterdir() if path.is_file() and path.suffix != ".py"
)


def facets_of(mesh):
    """The facets of a mesh, at unit size about the middle of its bounding box."""
    low, high = mesh.bounds
    return prepare_facets(mesh, (low + high) / 2, float(np.linalg.norm(high - low)))


def by_edges(mesh):
    facets = facets_of(mesh)
    return planes_by_edges(facets.faces, facets.corners, facets.normals)


def dent_of(mesh):
    """The largest depth of a vertex below the hull, at unit size, by all planes of Qhull."""
    vertices = facets_of(mesh).vertices
    equations = ConvexHull(vertices).equations
    return -float((vertices @ equations[:, :3].T + equations[:, 3]).max(axis=1).min())


def denting(depth):
    """A cube with a face whose middle is pushed in by a depth."""
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    body = trimesh.Trimesh([*corners, (0, 0, 1.1)], process=False).convex_hull
    vertices = np.array(body.vertices)
    vertices[vertices[:, 2].argmax(), 2] = 1 - depth
    return as_mesh(vertices, body.faces)


@pytest.mark.parametrize("path", MESHES, ids=[path.name for path in MESHES])
def test_the_meshes_that_come_along_are_as_convex_as_by_qhull(path, monkeypatch):
    facets = facets_of(read_mesh(path))
    planes, bound = planes_by_edges(facets.faces, facets.corners, facets.normals)
    # edges between coplanar faces may be reflex by rounding, each of some thousands by 1e-13
    assert bound < 1e-8
    above = facets.vertices @ planes[:, :3].T - planes[:, 3]
    assert above.max() <= 0  # the planes support the hull
    assert above.max(axis=0).min() > -1e-8
    verdict = against_hull(facets)[1] <= CONVEX_DEPTH
    monkeypatch.setattr("scan3d.geometry.hull_distance.planes_by_edges", lambda *_: (np.empty((0, 4)), np.inf))
    assert verdict
    assert verdict == (against_hull(facets)[1] <= CONVEX_DEPTH)


@pytest.mark.parametrize("inside_out", [False, True])
def test_a_strictly_convex_body_is_its_hull_to_rounding_and_qhull_is_not_asked(inside_out, monkeypatch):
    monkeypatch.setattr("scan3d.geometry.hull_distance.ConvexHull", None)
    body = moved(ball(3, 500), (5.0, 6.0, 7.0), rotation=rotation(2))
    body = trimesh.Trimesh(body.vertices, body.faces[:, ::-1] if inside_out else body.faces, process=False)
    facets = facets_of(body)
    planes, bound = against_hull(facets)
    assert bound <= 1e-15
    height = np.einsum("mx,mkx->mk", planes[:, :3], facets.corners) - planes[:, 3:]
    assert np.abs(height).max() < 1e-12
    assert (facets.vertices @ planes[:, :3].T <= planes[:, 3]).all()
    assert distance_to_hull(body) <= 1e-14


@pytest.mark.parametrize("depth", [1e-3, 1e-5, 1e-7, 1e-9, 1e-11])
def test_a_dent_is_bounded_from_above(depth):
    mesh = denting(depth)
    assert dent_of(mesh) == pytest.approx(depth / mesh.scale, abs=1e-15)
    planes, bound = by_edges(mesh)
    assert bound >= dent_of(mesh)
    # it is proportional to the depth: four edges are reflex by it, divided by their length
    assert bound < 60 * depth + 1e-11
    assert (facets_of(mesh).vertices @ planes[:, :3].T <= planes[:, 3]).all()


def test_random_small_dents_are_bounded_from_above():
    rng = np.random.default_rng(4)
    sphere, proven = trimesh.creation.icosphere(2), 0
    for size in 10.0 ** rng.uniform(-8, -1, 60):
        mesh = as_mesh(sphere.vertices * (1 + size * rng.standard_normal((len(sphere.vertices), 1))), sphere.faces)
        planes, bound = by_edges(mesh)
        assert bound >= dent_of(mesh)
        if len(planes):
            proven += 1
            assert (facets_of(mesh).vertices @ planes[:, :3].T <= planes[:, 3]).all()
    assert proven > 20


def twice_around():
    """A closed surface with convex edges only that winds twice around its axis: a double cone over a pentagram."""
    angle = 4 * np.pi * np.arange(5) / 5
    around = [(x, y, 0.0) for x, y in zip(np.cos(angle), np.sin(angle), strict=True)]
    faces = [(k, (k + 1) % 5, 5) for k in range(5)] + [((k + 1) % 5, k, 6) for k in range(5)]
    return as_mesh(np.array([*around, (0, 0, 1.0), (0, 0, -1.0)]), np.array(faces))


def two_cubes():
    return trimesh.util.concatenate([cube(), moved(cube(), (5.0, 0.0, 0.0))])


NOT_CONVEX = {
    "hole": without(cube(), 1),
    "wound twice": twice_around(),
    "two bodies": two_cubes(),
    "one inside the other": trimesh.util.concatenate([cube(), moved(cube(), scale=0.5)]),
    "letter L": letter_l(),
    "faces wound against each other": trimesh.Trimesh(
        cube().vertices, [face[::-1] if k == 3 else face for k, face in enumerate(cube().faces.tolist())], process=False
    ),
    "face without area": as_mesh(
        np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (0.5, 0.5, 0.0)]),
        np.array([(0, 2, 4), (0, 4, 1), (1, 4, 2), (0, 1, 3), (1, 2, 3), (2, 0, 3)]),
    ),
}


@pytest.mark.parametrize("mesh", NOT_CONVEX.values(), ids=NOT_CONVEX)
def test_what_the_edges_do_not_prove_has_no_bound(mesh):
    planes, bound = by_edges(mesh)
    assert bound == np.inf
    assert planes.shape == (0, 4)


def test_the_opposite_edge_runs_backwards_between_the_same_vertices():
    faces = ball(1, 40).faces.view(np.ndarray)
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    opposite = opposite_edges(faces).ravel()
    assert np.array_equal(start[opposite], end)
    assert np.array_equal(end[opposite], start)


def test_how_often_a_surface_winds_around_a_point():
    sphere = trimesh.creation.icosphere(2)
    corners = sphere.triangles.view(np.ndarray)
    assert turns(corners) == pytest.approx(1, abs=1e-12)
    assert turns(corners[:, ::-1]) == pytest.approx(-1, abs=1e-12)
    assert turns(corners - [3.0, 0, 0]) == pytest.approx(0, abs=1e-12)
    assert turns(twice_around().triangles.view(np.ndarray)) == pytest.approx(2, abs=1e-12)


def rows(faces):
    """Triangles as a set, whichever corner comes first."""
    return {tuple(np.roll(face, -face.argmin()).tolist()) for face in np.asarray(faces)}


@pytest.mark.parametrize("inside_out", [False, True])
def test_the_faces_of_a_strictly_convex_body_are_the_facets_of_its_hull_turned_outwards(inside_out):
    body = ball(7, 300)
    points, faces = body.vertices.view(np.ndarray), body.faces.view(np.ndarray)
    outward = outward_faces(points, faces[:, ::-1] if inside_out else faces)
    hull = ConvexHull(points)
    assert rows(np.sort(outward, axis=1)) == rows(np.sort(hull.simplices, axis=1))
    assert trimesh.Trimesh(points, outward, process=False).volume == pytest.approx(hull.volume, rel=1e-12)


@pytest.mark.parametrize("mesh", [cube(), denting(1e-14), denting(0.1), letter_l(), without(ball(7, 300), 5)])
def test_faces_that_may_not_be_the_facets_of_the_hull_are_left_to_qhull(mesh):
    assert outward_faces(facets_of(mesh).vertices, facets_of(mesh).faces) is None


@pytest.mark.parametrize("path", MESHES, ids=[path.name for path in MESHES])
def test_bodies_are_the_same_as_by_qhull(path, monkeypatch):
    by_edges = load_mesh(path)
    monkeypatch.setattr("scan3d.files.meshes.facets_by_flips", lambda *_: None)
    by_qhull = load_mesh(path)
    assert by_edges.metadata["geometry_sha256"] == by_qhull.metadata["geometry_sha256"]
    assert rows(by_edges.faces) == rows(by_qhull.faces)
    for name in ("hull", "file_faces"):
        assert by_edges.metadata[name] == by_qhull.metadata[name]
    assert by_edges.metadata["dent_relative"] <= by_qhull.metadata["dent_relative"] <= 1e-6


def with_points_on_edges(mesh, count, seed):
    """A mesh with points on some of its edges, up to rounding, and slivers between these edges and the points."""
    points, faces = list(mesh.vertices), mesh.faces.tolist()
    opposite, taken, random = opposite_edges(np.array(faces)).ravel(), set(), np.random.default_rng(seed)
    for edge in random.permutation(opposite.size):
        (one, k), other = divmod(int(edge), 3), int(opposite[edge]) // 3
        if len(points) < len(mesh.vertices) + count and not taken & {one, other}:
            taken |= {one, other}
            start, end, apex = np.roll(faces[one], -k).tolist()
            part, new = random.uniform(0.2, 0.8), len(points)
            points.append((1 - part) * points[start] + part * points[end])
            faces[one] = [start, new, apex]
            faces += [[new, end, apex], [start, end, new]]
    return as_mesh(np.array(points), np.array(faces))


@pytest.mark.parametrize("inside_out", [False, True])
@pytest.mark.parametrize("seed", range(3))
def test_corners_in_line_are_no_matter_for_qhull(seed, inside_out, monkeypatch):
    body = moved(with_points_on_edges(ball(seed, 300), 20, seed), rotation=rotation(seed))
    facets = facets_of(body)
    assert by_edges(body)[1] > 1e-3  # the normals of slivers are rounding
    monkeypatch.setattr("scan3d.geometry.hull_distance.ConvexHull", None)
    if inside_out:
        body = trimesh.Trimesh(body.vertices, body.faces[:, ::-1], process=False)
    facets = facets_of(body)
    planes, bound = against_hull(facets)
    assert dent_of(body) <= bound <= CONVEX_DEPTH / 10
    assert (facets.vertices @ planes[:, :3].T <= planes[:, 3]).all()
    assert np.linalg.norm(planes[:, :3], axis=1) == pytest.approx(1)
