"""How far a mesh is from its convex hull: hulls, dents of known depth, holes of known size."""

import numpy as np
import pytest
import trimesh
from brute_force import far
from shapes import (
    as_mesh,
    ball,
    cube,
    dented,
    inscribed_radius,
    letter_l,
    moved,
    pinhole,
    polytope,
    rotation,
    soup,
    without,
)

from scan3d.errors import InputError
from scan3d.geometry import hull_distance
from scan3d.geometry.hull_distance import CONVEX_DEPTH, NEAR_CONVEX_DEPTH, distance_to_hull

BODIES = {
    "cube": cube(),
    "ball": ball(0, 300),
    "needle": polytope(1, stretch=(1.0, 0.01, 0.01)),
    "plate": polytope(2, stretch=(1.0, 1.0, 1e-3)),
    "many coplanar faces": cube().subdivide().subdivide(),
}


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("body", BODIES.values(), ids=BODIES)
def test_a_hull_is_its_own_hull(body, scale):
    turned = moved(body, (3.0, -2.0, 1.0), rotation=rotation(4))
    for mesh in (body, turned, soup(turned)):
        mesh = moved(mesh, scale=scale)
        assert 0 <= distance_to_hull(mesh) <= CONVEX_DEPTH * scale * body.scale


def pushed_in(depth):
    """A ball of radius 1 with one vertex pushed in by a depth, and the distance that the surface then has from its hull."""
    sphere = trimesh.creation.icosphere(2)
    vertices = np.array(sphere.vertices)
    vertices[7] *= 1 - depth
    mesh = as_mesh(vertices, sphere.faces)
    return mesh, far(vertices[7:8], as_mesh(*convex_hull(np.delete(vertices, 7, axis=0))))[0]


def convex_hull(points):
    hull = trimesh.Trimesh(points, process=False).convex_hull
    return hull.vertices, hull.faces


@pytest.mark.parametrize("depth", [0.05, 0.1, 0.3])
def test_a_vertex_pushed_in_is_bounded_from_above(depth):
    mesh, dent = pushed_in(depth)
    # without the vertex the hull has a facet there, 0.04 below the ball
    assert depth - 0.05 < dent < depth - 0.03
    assert dent <= distance_to_hull(mesh) <= 3 * dent


def test_a_vertex_pushed_in_less_than_the_next_facet_leaves_a_hull():
    mesh, _ = pushed_in(0.03)
    assert mesh.volume < trimesh.creation.icosphere(2).volume
    assert distance_to_hull(mesh) < 1e-9


@pytest.mark.parametrize("depth", [1e-10, 1e-8, 1e-6, 1e-4])
def test_a_shallow_dent_is_bounded_from_above_and_not_by_much(depth):
    body = dented(depth)
    bound = distance_to_hull(body)
    # the dent's own depth; the argument allows for three times that of a face's middle, which lies at a third, and R / r
    assert depth * (1 - 1e-3) <= bound <= 2 * np.sqrt(3) * depth * (1 + 1e-3)


def test_a_surface_too_large_to_be_examined_counts_as_not_convex_from_a_depth_on(monkeypatch):
    # as if the time allowed for one face only
    monkeypatch.setattr(hull_distance, "_MAX_DISTANCES", 1)
    diagonal = 2 * np.sqrt(3)
    # the middle of a dented face lies at a third of the dent's depth
    assert np.isfinite(distance_to_hull(dented(2.9 * NEAR_CONVEX_DEPTH * diagonal)))
    assert distance_to_hull(dented(3.1 * NEAR_CONVEX_DEPTH * diagonal)) == np.inf


def test_bodies_far_from_convex():
    # the notch's edge lies 1/√2 below the hull
    assert 1 / np.sqrt(2) <= distance_to_hull(letter_l()) < np.inf
    assert distance_to_hull(trimesh.creation.torus(1.0, 0.4)) == np.inf  # it does not wind around its middle
    two = trimesh.util.concatenate([cube(), cube(shift=(5.0, 0.0, 0.0))])
    assert distance_to_hull(two) == np.inf


def test_an_open_surface_is_infinitely_far():
    body = cube()
    assert distance_to_hull(without(body, body.face_normals[:, 2] < 0.5)) == np.inf  # a box without lid
    assert distance_to_hull(without(body, np.arange(12) > 0)) == np.inf  # without one triangle
    square = as_mesh([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(0, 1, 2), (0, 2, 3)])
    assert distance_to_hull(square) == np.inf


def test_a_surface_that_covers_its_body_twice_is_infinitely_far():
    body = cube()
    assert distance_to_hull(as_mesh(body.vertices, np.vstack([body.faces, body.faces]))) == np.inf


@pytest.mark.parametrize("side", [1e-3, 1e-4, 1e-5])
def test_a_pinhole_counts_by_its_size(side):
    mesh, hole = pinhole(side)
    # the middle of the hole lies on the hull's surface, and the mesh is at its edge
    assert inscribed_radius(hole) <= distance_to_hull(mesh) < 20 * side


@pytest.mark.parametrize("mesh", [trimesh.Trimesh(), as_mesh([(0, 0, 0), (1, 0, 0), (0, 1, np.nan)], [(0, 1, 2)])])
def test_what_has_no_hull_is_refused(mesh):
    with pytest.raises(InputError, match=r"^the surface should have "):
        distance_to_hull(mesh)


@pytest.mark.parametrize("step", [2, 3, 7])
def test_faces_wound_against_the_others_do_not_open_a_surface(step):
    body = BODIES["ball"]
    faces = body.faces.copy()
    faces[::step] = faces[::step, ::-1]
    assert distance_to_hull(as_mesh(body.vertices, faces)) <= CONVEX_DEPTH * body.scale


def test_only_the_faces_that_are_too_many_to_be_examined_must_be_shallow(monkeypatch):
    """With a limit of twelve faces: the dent has fewer, and the other faces lie in those of the hull."""
    body = dented(0.3)
    unlimited = distance_to_hull(body)
    planes = 6
    monkeypatch.setattr(hull_distance, "_MAX_DISTANCES", 12 * planes)
    assert distance_to_hull(body) == unlimited < np.inf
