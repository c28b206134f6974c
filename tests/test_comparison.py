"""Comparison of two surfaces: averages, normals and volume, what must not matter, and what can't be compared."""

import dataclasses

import numpy as np
import pytest
import trimesh
from brute_force import EXACT
from shapes import PAIRS, ball, cube, letter_l, moved, quad, rotation, soup

from scan3d.arrays import SOME
from scan3d.comparison import compare, compare_with_points
from scan3d.geometry.distance import distances


@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1e6])
@pytest.mark.parametrize(
    "pair", [PAIRS["crossing"], (moved(letter_l(), (0.3, 0.2, 0.1)), cube())], ids=["convex", "not convex"]
)
def test_units_do_not_matter(pair, scale):
    plain, scaled = compare(*pair), compare(*(moved(mesh, scale=scale) for mesh in pair))
    for field in dataclasses.fields(plain):
        before, after = getattr(plain, field.name), getattr(scaled, field.name)
        if field.name in ("exact", "worst_on"):
            assert before == after
        elif field.name.startswith("normal"):  # next to a sharp edge, rounding decides which face is meant
            assert after == pytest.approx(before, abs=5.0)
        elif field.name in ("relative", "f_score", "volume_error"):
            assert after == pytest.approx(before, rel=1e-6, abs=1e-9)
        elif field.name in ("mean", "rms", "p95", "chamfer"):
            assert after == pytest.approx(scale * before, rel=1e-9)
        else:
            assert after == pytest.approx(scale * before, rel=1e-6)


def test_a_comparison_of_a_surface_and_points_is_that_of_each_alone():
    mesh, surface = ball(3), moved(ball(2), (0.1, 0.2, 0.3))
    points = np.random.default_rng(0).normal(size=(500, 3))
    both, of_points, reached = compare_with_points(surface, points, mesh)
    assert str(both) == str(compare(surface, mesh))
    assert of_points == pytest.approx(distances(points, mesh), abs=1e-14 * mesh.scale)
    assert not reached


@pytest.mark.slow
def test_averages_are_those_of_places_at_random(all_samples):
    """Surfaces that are off at edges alone: middles of the parts of a face are away from them."""
    box, rounded = (trimesh.creation.box([2, 2, 2]), trimesh.creation.icosphere(4, 0.1))
    rounded = trimesh.convex.convex_hull((0.9 * box.vertices[:, None] + rounded.vertices).reshape(-1, 3))
    found, means, squares = compare(rounded, box), [], []
    for one, other in ((rounded, box), (box, rounded)):
        places = trimesh.sample.sample_surface(one, 200_000, seed=0)[0]
        off = distances(places, other)
        means.append(off.mean())
        squares.append((off**2).mean())
    assert found.mean == pytest.approx(np.mean(means), rel=0.02)
    assert found.rms == pytest.approx(np.sqrt(np.mean(squares)), rel=0.02)


@pytest.mark.slow
def test_what_was_reached_of_a_sphere(all_samples):
    """Archimedes: a cap of the unit sphere within d of its pole has d²/4 of its area; half of the sphere faces away."""
    inner, outer = (trimesh.creation.icosphere(4, radius) for radius in (0.9, 1.0))
    for within, share in ((0.6, 0.09), (3.0, 0.5)):
        reached = compare_with_points(inner, np.array([[0, 0, 1.0]]), outer, within)[2]
        assert reached["share"] == pytest.approx(share, rel=2e-2)
        assert [reached["mean"], reached["max"]] == pytest.approx([0.1, 0.1], abs=2e-3)
        assert reached["in_cavities"] == 0
    hollow = trimesh.util.concatenate([outer, trimesh.creation.icosphere(4, 0.5)])
    hollow.faces[len(outer.faces) :] = hollow.faces[len(outer.faces) :, ::-1]
    reached = compare_with_points(inner, np.array([[0, 0, 1.0]]), hollow, within)[2]
    assert reached["in_cavities"] == pytest.approx(0.5**2 / (1 + 0.5**2), rel=1e-3)


def test_place_and_attitude_do_not_matter():
    turn = rotation(1)
    for pair in (PAIRS["crossing"], PAIRS["needles"]):
        plain, turned = compare(*pair), compare(*(moved(mesh, (30.0, -20.0, 10.0), rotation=turn) for mesh in pair))
        assert turned.hausdorff == pytest.approx(plain.hausdorff, rel=1e-11)
        assert turned.mean == pytest.approx(plain.mean, rel=1e-2)


@pytest.mark.parametrize("mesh", [cube(), ball(0), letter_l(), quad(0), trimesh.creation.torus(1.0, 0.4)])
def test_a_mesh_has_no_distance_from_itself(mesh):
    result = compare(mesh, soup(mesh))
    assert result.upper <= 1e-9 * result.diagonal
    assert result.hausdorff <= EXACT * result.diagonal
    assert result.mean <= EXACT * result.diagonal
    assert result.f_score == pytest.approx(1.0)
    assert result.normal_median_deg == pytest.approx(0.0, abs=1e-6)


def test_seams_unused_vertices_and_faces_without_area_do_not_matter():
    body, mesh = PAIRS["crossing"]
    a, b, c = body.faces[0]
    vertices = np.concatenate([body.vertices, [(9.0, 9.0, 9.0)], body.vertices[[a, b]].mean(axis=0, keepdims=True)])
    middle = len(vertices) - 1
    faces = [*body.faces[1:], (a, a, b), (b, b, b), (a, middle, c), (middle, b, c), (a, b, middle)]
    for surface in (soup(body), trimesh.Trimesh(vertices, faces, process=False)):
        result = compare(surface, mesh)
        assert result.exact
        assert result.hausdorff == pytest.approx(compare(body, mesh).hausdorff, rel=1e-13)
        assert result.volume_error == pytest.approx(body.volume / mesh.volume - 1, rel=1e-9)


@pytest.mark.slow
def test_averages_over_cubes(all_samples):
    """Along an edge of the outer cube the distance bends within 5 % of the side: the samples see that to 1e-3."""
    x = (np.arange(2000) + 0.5) / 2000 * 1.1
    beyond = np.maximum(x - 1.0, 0.0)
    outwards = np.sqrt(0.1**2 + beyond[:, None] ** 2 + beyond**2)
    fine = [trimesh.Trimesh(*trimesh.remesh.subdivide(cube(half).vertices, cube(half).faces)) for half in (1.0, 1.1)]
    for _ in range(5):
        fine = [mesh.subdivide() for mesh in fine]
    assert len(fine[0].faces) > 2 * SOME
    for result in (compare(cube(1.0), cube(1.1)), compare(*fine)):
        assert result.mean == pytest.approx((0.1 + outwards.mean()) / 2, rel=1e-3)
        assert result.chamfer == pytest.approx(0.1 + outwards.mean(), rel=1e-3)
        assert result.rms == pytest.approx(np.sqrt((0.1**2 + (outwards**2).mean()) / 2), rel=2e-3)
        assert result.p95 == pytest.approx(np.quantile(outwards, 0.9), rel=0.05)
        assert result.f_score == 0.0
        assert result.volume_error == pytest.approx(1 / 1.1**3 - 1)


def test_normals_of_a_turned_cube():
    angle = np.radians(5.0)
    turn = np.array([(np.cos(angle), -np.sin(angle), 0), (np.sin(angle), np.cos(angle), 0), (0, 0, 1)])
    result = compare(moved(cube(), rotation=turn), cube())
    assert result.normal_median_deg == pytest.approx(5.0)  # four of six faces
    inside_out = trimesh.Trimesh(cube().vertices, cube().faces[:, ::-1], process=False)
    assert compare(inside_out, cube()).normal_median_deg == pytest.approx(180.0)
