"""Surfaces by a minimum cut, through contacts of straight lines with bodies that a function describes, negative inside."""

import functools

import numpy as np
import pytest
import pyvista
import trimesh

from scan3d.cloud import TOUCHED
from scan3d.errors import InputError
from scan3d.surfaces import cut
from scan3d.surfaces.creases import least_bent
from scan3d.surfaces.cut import BETWEEN, cut_surface

pytestmark = pytest.mark.slow


def torus(points):
    """Distance (...) from a ring of radius 3 whose tube has the radius 1.2."""
    return np.hypot(np.hypot(points[..., 0], points[..., 1]) - 3, points[..., 2]) - 1.2


def shell(points):
    """Distance (...) from the lower half of a hollow ball of radius 3 to 3.3, a bowl."""
    radius = np.linalg.norm(points, axis=-1)
    return np.maximum(np.abs(radius - 3.15) - 0.15, points[..., 2])


def two_balls(points):
    return np.minimum(*(np.linalg.norm(points - [x, 0, 0], axis=-1) - 2 for x in (-1.6, 1.6)))


def bracket(points):
    """About the distance (...) from two plates that meet in an edge."""

    def box(low, high):
        middle, half = np.add(low, high) / 2, np.subtract(high, low) / 2
        return (np.abs(points - middle) - half).max(axis=-1)

    return np.minimum(box([-2.8, -2.2, -2.8], [2.8, 2.2, -1.4]), box([-2.8, -2.2, -2.8], [-1.4, 2.2, 2.8]))


BODIES = {"bracket": (bracket, 2), "torus": (torus, 0), "shell": (shell, 2), "two balls": (two_balls, 2)}


@functools.cache
def probed(name, count=8000, seed=0):
    """Contacts (n, 3), directions (n, 3) and lines (m, 2, 3) of lines drawn at random, which end at the body."""
    random = np.random.default_rng(seed)
    along, start, rest = random.normal(size=(3, count, 3))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    start = 4.5 * np.cbrt(random.uniform(size=(count, 1))) * start / np.linalg.norm(start, axis=1, keepdims=True)
    start -= (start * along).sum(axis=1, keepdims=True) * along + 6 * along
    inside = BODIES[name][0]
    steps = np.linspace(0, 12, 400)
    within = inside(start[:, None] + steps[:, None] * along[:, None]) < 0
    hit, first = within.any(axis=1), within.argmax(axis=1)
    low, high = steps[first - 1], steps[first]
    for _ in range(50):
        middle = (low + high) / 2
        outside = inside(start + middle[:, None] * along) > 0
        low, high = np.where(outside, middle, low), np.where(outside, high, middle)
    end = start + np.where(hit, low, 12.0)[:, None] * along
    return end[hit], along[hit], np.stack([start, end], axis=1)


@functools.cache
def surface_of(name):
    return cut_surface(*probed(name))


@pytest.mark.parametrize("name", BODIES)
def test_surface_is_closed_and_near_the_body(name):
    inside, euler = BODIES[name]
    found = surface_of(name)
    surface = found.surface
    assert surface.is_watertight
    assert surface.is_winding_consistent
    assert surface.volume > 0
    assert surface.euler_number == euler
    size = np.linalg.norm(np.ptp(probed(name)[0], axis=0))
    known = surface.vertex_attributes["known"]
    off = np.abs(inside(surface.vertices))
    assert off[known > 0].max() < BETWEEN * size
    assert off[known == 2].max() < TOUCHED * size
    assert (known == 2).mean() > 0.9
    assert off.mean() < 0.004 * size
    assert not found.off.mean() > 0.01


def test_edges_between_contacts_are_sharp(monkeypatch):
    along = np.linspace(-1.8, 1.8, 50)
    edges = [(2.8, -1.4), (2.8, -2.8), (-2.8, -2.8), (-2.8, 2.8), (-1.4, 2.8), (-1.4, -1.4)]
    places = pyvista.PolyData(
        np.concatenate([np.stack([0 * along + x, along, 0 * along + z], axis=1) for x, z in edges])
    )
    sharp = surface_of("bracket")
    monkeypatch.setattr(cut, "creased", lambda vertices, faces: (vertices, faces))
    plain = cut_surface(*probed("bracket"))
    off, cut_off = (
        np.abs(places.compute_implicit_distance(pyvista.wrap(found.surface))["implicit_distance"])
        for found in (sharp, plain)
    )
    assert np.quantile(off, 0.9) < 0.02 * sharp.spacing
    assert np.quantile(cut_off, 0.5) > 0.2 * plain.spacing
    # and smooth bodies stay as they are
    assert len(cut_surface(*probed("torus")).surface.faces) == len(surface_of("torus").surface.faces)


@pytest.mark.parametrize("name", BODIES)
def test_diagonals_follow_the_body(name, monkeypatch):
    """The faces of tetrahedra zigzag: through the same contacts the surface is nearer to the body with other diagonals."""

    def mean_distance(surface):
        return np.abs(BODIES[name][0](trimesh.sample.sample_surface(surface, 20000, seed=1)[0])).mean()

    found = surface_of(name).surface
    monkeypatch.setattr(cut, "least_bent", lambda vertices, faces: faces)
    zigzag = cut_surface(*probed(name)).surface
    # on balls Delaunay's faces are as good already
    assert mean_distance(found) < (1.0 if name == "two balls" else 0.85) * mean_distance(zigzag)
    assert found.euler_number == zigzag.euler_number
    # no other diagonal is better
    vertices, faces = (np.asarray(part) for part in (zigzag.vertices, zigzag.faces))
    settled = least_bent(vertices, faces)
    assert np.array_equal(least_bent(vertices, settled), settled)
    assert bending(vertices, settled) < bending(vertices, faces)


def bending(vertices, faces):
    """The sum over the edges of their lengths times the angles between their faces."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    ends = vertices[mesh.face_adjacency_edges]
    return (np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) * mesh.face_adjacency_angles).sum()


@pytest.mark.parametrize("name", ["torus", "two balls"])
def test_free_places_count_as_lines_do(name):
    points, along, lines = probed(name)
    share = np.linspace(0, 0.999, 120)[:, None, None]
    places = (lines[:, 0] + share * (lines[:, 1] - lines[:, 0])).reshape(-1, 3)
    surface = cut_surface(points, along, lines[:0], places).surface
    assert surface.euler_number == BODIES[name][1]
    assert surface.volume == pytest.approx(surface_of(name).surface.volume, rel=0.02)


def test_a_hole_that_no_rod_has_passed_is_unknown():
    points, along, lines = probed("torus")
    places = lines[:, :1] + np.linspace(0, 1, 200)[:, None] * (lines[:, 1:] - lines[:, :1])
    through = (np.hypot(places[..., 0], places[..., 1]) < 2.0) & (np.abs(places[..., 2]) < 1.2)
    lines = lines[~through.any(axis=1)]
    touched = np.isin(points, lines[:, 1]).all(axis=1)
    surface = cut_surface(points[touched], along[touched], lines).surface
    assert surface.is_watertight
    # whether it is closed is not known either: the surface there is the smallest that contradicts nothing
    radius = np.hypot(*surface.vertices[:, :2].T)
    known = surface.vertex_attributes["known"]
    assert (known[radius < 1.6] == 0).all()
    assert (radius < 1.6).any()
    assert (known[radius > 3] > 0).all()


def test_nothing_reaches_far_into_free_space():
    points, along, lines = probed("shell", 3000)
    surface = cut_surface(points, along, lines).surface
    assert np.abs(shell(np.asarray(surface.vertices))).max() < 0.02 * np.linalg.norm(np.ptp(points, axis=0))


def test_the_last_digit_decides_nothing():
    points, along, lines = probed("two balls")
    moved = cut_surface(points * (1 + 1e-14), along, lines * (1 + 1e-14)).surface
    assert np.array_equal(moved.faces, surface_of("two balls").surface.faces)


def test_far_from_the_origin_the_surface_is_the_same():
    points, along, lines = probed("two balls")
    away = 1e6 * np.array([1.0, -2.0, 0.5])
    found = cut_surface(points + away, along, lines + away).surface
    assert found.is_watertight
    assert found.euler_number == BODIES["two balls"][1]
    assert np.abs(two_balls(found.vertices - away)).max() < 0.02 * np.linalg.norm(np.ptp(points, axis=0))


def test_wrong_contacts_are_found_and_cost_little():
    points, along, lines = probed("two balls")
    random = np.random.default_rng(1)
    chosen = random.choice(len(points), len(points) // 100, replace=False)
    points = points.copy()
    size = np.linalg.norm(np.ptp(points, axis=0))
    # stopped before they touch
    points[chosen] -= 0.05 * size * along[chosen]
    found = cut_surface(points, along, lines)
    assert found.off[chosen].mean() > 0.9
    assert np.abs(two_balls(found.surface.vertices)).max() < 0.02 * size


def test_contacts_in_a_plane_span_no_body():
    points, along, lines = probed("torus")
    with pytest.raises(InputError, match="in a plane"):
        cut_surface(points * [1, 1, 0], along, lines)
    with pytest.raises(InputError, match="all in a few places"):
        cut_surface(0 * points + 1, along, lines)
