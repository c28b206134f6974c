"""Convex hulls as meshes: closed, outward, and with the points' own coordinates; polytopes, also where Qhull fails."""

import subprocess
import sys

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull, QhullError
from shapes import directions, unit

from scan3d.arrays import highest
from scan3d.errors import InputError
from scan3d.geometry import hulls
from scan3d.geometry.distance import nearest
from scan3d.geometry.hulls import (
    clipped,
    cut_polytope,
    distance_from_hull,
    hull,
    hull_about_mean,
    hull_near,
    support_of,
)

RNG = np.random.default_rng(11)
TURN = trimesh.transformations.random_rotation_matrix(np.array([0.3, 0.6, 0.8]))[:3, :3]


@pytest.mark.parametrize("shift", [0.0, 1000.0])
@pytest.mark.parametrize("scale", [1e-9, 1e-6, 1.0, 1e6])
def test_a_hull_is_closed_and_outward_and_keeps_the_coordinates(scale, shift):
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-2, 2) for z in (-3, 3)], dtype=float)
    points = scale * (np.vstack([corners, RNG.uniform(-1, 1, (30, 3))]) @ TURN.T + shift)
    made = hull(points)
    assert made.is_watertight
    assert made.volume == pytest.approx(48 * scale**3, rel=1e-6)
    outward = np.cross(*(made.triangles[:, i] - made.triangles[:, 0] for i in (1, 2)))
    assert (((made.triangles_center - points.mean(axis=0)) * outward).sum(axis=1) > 0).all()
    # the vertices are the box's corners, to the last digit
    assert {tuple(p) for p in np.asarray(made.vertices)} == {tuple(p) for p in points[:8]}


@pytest.mark.parametrize("shift", [0.0, 7.0])
@pytest.mark.parametrize("thickness", [0.0, 1e-6, 1e-3])
def test_points_in_one_plane_span_no_body(thickness, shift):
    points = np.column_stack([RNG.uniform(-1, 1, (60, 2)), thickness * RNG.uniform(-1, 1, 60)]) @ TURN.T + shift
    if thickness > 1e-9:
        assert hull(points).volume > 0
    else:
        with pytest.raises(InputError, match="the 60 contacts span no body"):
            hull(points)


@pytest.mark.parametrize("move", ["affine", "shifted", "dented", "inside", "flat"])
def test_the_hull_from_a_mesh_that_is_nearly_convex_is_the_hull(monkeypatch, move):
    """A convex mesh is its own hull; where edges or vertices are dents, Qhull finds it."""
    ball = trimesh.creation.icosphere(subdivisions=3)
    points, faces = ball.vertices.view(np.ndarray) @ TURN.T, ball.faces.view(np.ndarray)
    if move == "shifted":
        points = unit(points + 0.05 * directions(len(points)))
    points = points * [1.0, 2.0, 0.3] + [5.0, 0.0, 0.0]
    if move == "dented":
        points[100] *= 0.98
    elif move == "inside":
        points[7] = points.mean(axis=0)
    elif move == "flat":
        points[:, 2] = 0.0
        with pytest.raises(InputError, match="span no body"):
            hull_near(points, faces)
        return
    expected = hull(points)
    if move == "affine":
        monkeypatch.setattr(
            "scan3d.geometry.hulls.hull", lambda _: pytest.fail("the edges prove that this mesh is convex")
        )
    made = hull_near(points, faces)
    assert made.is_watertight
    np.testing.assert_array_equal(made.vertices, expected.vertices)
    assert {tuple(sorted(face)) for face in made.faces.tolist()} == {
        tuple(sorted(face)) for face in expected.faces.tolist()
    }
    assert made.volume == pytest.approx(expected.volume, rel=1e-12)


def test_distances_from_a_hull_are_those_of_the_nearest_points():
    """Of points outside and inside; a facet's sliver must not turn a point inside into one outside."""
    points = 20 * np.vstack([directions(400), directions(400) * (1 - 1e-12)]) * [1.0, 2.0, 0.3] + 5
    sought = 40 * RNG.standard_normal((300, 3)) * [1.0, 2.0, 0.3] * RNG.uniform(size=(300, 1)) + 5
    expected = np.maximum(nearest(sought, hull(points))[0], 0.0)
    assert (expected > 0).any()
    assert (expected == 0).any()
    assert distance_from_hull(points)(sought) == pytest.approx(expected, abs=1e-11)


def many_coplanar(count):
    return np.round(3 * RNG.standard_normal((count, 3)))


def rings(count):
    """Points of a cylinder, whose two caps have many corners."""
    angle = np.linspace(0, 2 * np.pi, 50, endpoint=False)
    ring = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    return np.concatenate([np.add(ring, (0, 0, z)) for z in np.linspace(0, 2e-3, count // 50)])


def nearly_equal(count):
    points = RNG.standard_normal((count // 2, 3))
    return np.concatenate([points, points + 1e-12 * RNG.standard_normal(points.shape)])


@pytest.mark.parametrize(
    "points",
    [directions(500) * [1, 2, 0.1], many_coplanar(500), rings(500), nearly_equal(500)],
    ids=["round", "coplanar", "rings", "nearly equal"],
)
def test_climbing_along_edges_finds_the_highest_of_all_points(points):
    qhull = hull_about_mean(points)
    # those of facets, at whose corners it is the same, as well
    sought = np.concatenate([directions(500), qhull.equations[:, :3], np.eye(3), -np.eye(3), np.zeros((1, 3))])
    found = support_of(qhull)(sought) + sought @ points.mean(axis=0)
    assert found == pytest.approx(highest(points, sought), abs=1e-14 * np.abs(points).max())


@pytest.mark.slow
def test_tangent_planes_cut_what_faces_leave_open():
    normals = unit(np.random.default_rng(2).normal(size=(3000, 3)))
    normals = normals[np.abs(normals[:, 2]) < 0.8]
    caps = np.array([[0.0, 0, 1, 0.8], [0, 0, -1, 0.8]])
    corners = cut_polytope(caps, np.column_stack([normals, np.ones(len(normals))]), np.zeros(3), 2.0, 1e-3)
    assert np.abs(corners[:, 2]).max() == pytest.approx(0.8)
    assert np.linalg.norm(corners, axis=1).min() > 0.99
    assert np.linalg.norm(corners, axis=1).max() < 1.01
    # every remaining cut is shallower than the tolerance
    assert (corners @ normals.T - 1).max() < 1e-3


def test_planes_cut_the_hull_of_points():
    corners = trimesh.creation.box((2, 2, 2)).vertices.view(np.ndarray)
    assert clipped(corners, np.array([[1.0, 0, 0, 1.0], [0, 1.0, 0, 3.0]])) is corners
    cut = clipped(corners, np.array([[1.0, 0, 0, 0.5], [0, 1.0, 0, 3.0]]))
    assert np.ptp(cut, axis=0) == pytest.approx([1.5, 2.0, 2.0])
    assert ConvexHull(cut).volume == pytest.approx(6.0)
    # planes with most of the points beyond them contradict the points
    assert clipped(corners, np.array([[1.0, 0, 0, -0.5]])) is corners


def test_planes_at_which_qhull_fails_still_leave_their_corners(monkeypatch):
    """Qhull calls some hulls of dual points imprecise: the middle alone was then left, which would prove any bound."""

    def fails(*_, **__):
        raise QhullError("large increase in qh.max_outside")

    corners = trimesh.creation.box((2, 2, 2)).vertices.view(np.ndarray)
    faces = np.column_stack([np.concatenate([np.eye(3), -np.eye(3)]), np.ones(6)])
    monkeypatch.setattr(hulls, "ConvexHull", fails)
    found = cut_polytope(faces, np.array([[1.0, 0, 0, 0.5]]), np.zeros(3), 2.0, 1e-9)
    assert len(found) == 8
    assert found.max(axis=0) == pytest.approx([0.5, 1, 1])
    assert found.min(axis=0) == pytest.approx(corners.min(axis=0))


# Dual points of half-spaces of a slab of the Stanford bunny's hull, of which two would replace each other without end.
DUAL = np.array([
    (-3.5659592792585095, -0.4665384984202012, 0.009723910110846544),
    (-1.0346574326683502, -6.3064320164275625, 0.012319606889770239),
    (-0.055112845774426135, -5.681344830034815, 0.01118693867723726),
    (0.3275470854339885, -5.431157381448858, 0.010719070116439851),
    (-0.10078651676191618, -5.711206799579892, 0.011242782712551741),
    (0.37427385544545577, -5.4006068836923795, 0.010661938483750077),
    (0.45396488286981246, -5.3472848058451214, 0.010559340093043776),
    (0.5295081575429131, -5.2967380315952655, 0.010462081735855413),
    (4.9386108250327, 2.605407545523127, 0.0014855202413321775),
    (0.0, 0.0, 2.0),
    (0.0, 0.0, -2.0),
])  # fmt: skip
# In a process of its own, which can be ended; the largest value by which a corner lies outside of a half-space.
CODE = """
import numpy as np
from scan3d.geometry.hulls import half_space_intersection
dual = np.array({})
corners = half_space_intersection(np.column_stack([dual, -np.ones(len(dual))]), np.zeros(3)).intersections
print((corners @ dual.T - 1).max())
"""


@pytest.mark.slow
def test_half_spaces_through_one_corner_end():
    command = [sys.executable, "-c", CODE.format(DUAL.tolist())]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert abs(float(done.stdout)) < 1e-12


def test_what_lies_deep_in_a_body_does_not_depend_on_faces_that_are_turned_over():
    """As those of hulls with many vertices nearly in one plane are."""
    ball = trimesh.creation.icosphere(3, radius=20.0)
    faces = ball.faces.copy()
    faces[::50] = faces[::50, ::-1]
    turned = trimesh.Trimesh(ball.vertices, faces, process=False)
    found, expected = (hulls.offset_inwards(body, 0.15) for body in (turned, ball))
    np.testing.assert_allclose(found.vertices, expected.vertices)
    assert expected.volume == pytest.approx(ball.volume * (1 - 0.15 / 20) ** 3, rel=1e-4)
    thin = trimesh.creation.box((10, 10, 0.2))
    assert hulls.offset_inwards(thin, 0.2) is None
