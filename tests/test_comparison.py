"""Comparison of two surfaces, against authorities that share nothing with it.

Brute force in extended precision, support functions (for convex bodies the Hausdorff distance is the largest difference of
theirs), and bodies whose distances can be read off.
"""

import dataclasses
import subprocess
import sys

import mpmath
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.distance import directed_hausdorff

from scan3d import comparison
from scan3d.comparison import SAMPLES, _areas, _longest_first, _Search, compare, distances, nearest, signed_distances
from scan3d.errors import InputError

EXACT = 1e-12  # of the diagonal: a few roundings
GAP = 1.001  # certified bounds are this close, unless out of time


@pytest.fixture(scope="module", autouse=True)
def few_samples():
    """The averages take most of the time on small meshes; where they aren't what is tested, fewer points do."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(comparison, "SAMPLES", 1000)
        yield


@pytest.fixture
def all_samples(monkeypatch):
    monkeypatch.setattr(comparison, "SAMPLES", SAMPLES)


# --- authorities ---


def far(points, mesh, kind=np.longdouble):
    """Distance (n,) of points to a mesh by trying all its triangles, region by region, in extended precision."""
    points = np.asarray(points, dtype=kind)[:, None]
    a, b, c = np.moveaxis(np.asarray(mesh.vertices, dtype=kind)[mesh.faces], 1, 0)
    normal = np.cross(b - a, c - a)
    square = (normal**2).sum(axis=-1)
    inside, least = square > 0, np.inf
    for start, end in ((a, b), (b, c), (c, a)):
        edge, away = end - start, points - start
        inside = inside & ((np.cross(edge, away) * normal).sum(axis=-1) >= 0)
        along = (away * edge).sum(axis=-1) / np.maximum((edge**2).sum(axis=-1), 1e-300)
        least = np.minimum(least, np.sqrt(((away - np.clip(along, 0, 1)[..., None] * edge) ** 2).sum(axis=-1)))
    height = np.abs(((points - a) * normal).sum(axis=-1)) / np.sqrt(np.maximum(square, 1e-300))
    return np.where(inside, np.minimum(height, least), least).min(axis=1).astype(float)


def farthest(source, target, steps):
    """The largest distance to the target from the nodes of a grid on each of the source's faces, in double precision."""
    points = spread(source, steps)
    parts = np.array_split(points, 1 + len(points) * len(target.faces) // 100_000)
    return max(far(part, target, np.float64).max() for part in parts)


def far_in_60_digits(point, a, b, c):
    """Distance of a point to one triangle."""

    def dot(x, y):
        return x[0] * y[0] + x[1] * y[1] + x[2] * y[2]

    def cross(x, y):
        return [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]]

    def minus(x, y, times=1):
        return [u - times * v for u, v in zip(x, y, strict=True)]

    with mpmath.workdps(60):
        p, a, b, c = ([mpmath.mpf(float(x)) for x in corner] for corner in (point, a, b, c))
        normal = cross(minus(b, a), minus(c, a))
        inside, least = dot(normal, normal) > 0, mpmath.inf
        for start, end in ((a, b), (b, c), (c, a)):
            edge, away = minus(end, start), minus(p, start)
            inside = inside and dot(cross(edge, away), normal) >= 0
            length = dot(edge, edge)
            away = minus(away, edge, min(max(dot(away, edge) / length, 0), 1) if length else 0)
            least = min(least, mpmath.sqrt(dot(away, away)))
        return float(abs(dot(minus(p, a), normal)) / mpmath.sqrt(dot(normal, normal)) if inside else least)


def by_support(first, second):
    """Hausdorff distance of two convex bodies: the largest difference of their support functions, over directions."""
    rng = np.random.default_rng(0)

    def difference(u):
        return np.abs((u @ first.vertices.T).max(axis=1) - (u @ second.vertices.T).max(axis=1))

    u = unit(rng.standard_normal((20_000, 3)))
    best = u[np.argsort(difference(u))[-20:]]
    spread = 0.05
    for _ in range(70):  # narrower and narrower about the best directions
        u = unit(
            np.concatenate([best, np.repeat(best, 40, axis=0) + spread * rng.standard_normal((40 * len(best), 3))])
        )
        best = u[np.argsort(difference(u))[-20:]]
        spread *= 0.7
    return difference(best).max()


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def spread(mesh, steps):
    """Points (m, 3) all over a mesh: the nodes of a grid on each face."""
    i, j = np.mgrid[: steps + 1, : steps + 1].reshape(2, -1) / steps
    i, j = i[i + j <= 1 + 1e-9], j[i + j <= 1 + 1e-9]
    return np.einsum("gk,mkx->mgx", np.column_stack([1 - i - j, i, j]), mesh.triangles).reshape(-1, 3)


# --- bodies ---


def polytope(seed, count=30, stretch=(1.0, 1.0, 1.0), shift=(0.0, 0.0, 0.0)):
    points = np.random.default_rng(seed).standard_normal((count, 3)) * stretch + shift
    return trimesh.Trimesh(points, process=False).convex_hull


def ball(seed, count=200, radius=1.0):
    return trimesh.Trimesh(
        radius * unit(np.random.default_rng(seed).standard_normal((count, 3))), process=False
    ).convex_hull


def cube(half=1.0, shift=(0.0, 0.0, 0.0)):
    mesh = trimesh.creation.box(np.broadcast_to(2 * np.asarray(half), 3))
    return moved(mesh, shift)


def moved(mesh, shift=(0.0, 0.0, 0.0), scale=1.0, rotation=None):
    vertices = np.asarray(mesh.vertices) @ (np.eye(3) if rotation is None else rotation).T * scale + shift
    return trimesh.Trimesh(vertices, mesh.faces, process=False)


def soup(mesh):
    """The same surface with no two triangles joined, as an STL file has it."""
    return trimesh.Trimesh(mesh.triangles.reshape(-1, 3), np.arange(3 * len(mesh.faces)).reshape(-1, 3), process=False)


def quad(diagonal, height=0.5):
    """A bent quadrilateral, cut along one diagonal or the other."""
    corners = [(0.0, 0.0, 0.0), (1.0, 0.0, height), (1.0, 1.0, 0.0), (0.0, 1.0, height)]
    faces = {0: [(0, 1, 2), (0, 2, 3)], 1: [(0, 1, 3), (1, 2, 3)]}[diagonal]
    return trimesh.Trimesh(corners, faces, process=False)


def angle_bracket():
    """An L: the box 2 x 2 x 1 without the part x, y > 1."""
    outline = np.array([(0, 0), (1, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2), (0, 1)], dtype=float)
    flat = [(0, 1, 4), (0, 4, 7), (1, 2, 3), (1, 3, 4), (7, 4, 5), (7, 5, 6)]
    vertices = np.concatenate([np.column_stack([outline, np.full(8, z)]) for z in (0.0, 1.0)])
    faces = [f[::-1] for f in flat] + [tuple(i + 8 for i in f) for f in flat]
    for i in range(8):
        j = (i + 1) % 8
        faces += [(i, j, j + 8), (i, j + 8, i + 8)]
    return trimesh.Trimesh(vertices, faces, process=False)


def rotation(seed):
    return np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))[0]


PAIRS = {
    "apart": (polytope(0), polytope(1, shift=(5.0, 1.0, 0.0))),
    "crossing": (polytope(2), polytope(3, shift=(0.3, 0.0, 0.1))),
    "nested": (ball(4, 80, 0.5), ball(5, 120)),
    "alike": (ball(6, 100), moved(ball(6, 100), scale=1.001, shift=(1e-4, 0.0, 2e-4))),
    "needles": (polytope(7, stretch=(1.0, 0.01, 0.01)), polytope(8, stretch=(1.0, 0.01, 0.01))),
    "plates": (polytope(9, stretch=(1.0, 1.0, 1e-4)), polytope(10, stretch=(1.0, 1.0, 1e-4))),
    "few and many": (cube(0.6), ball(11, 300)),
}


def certified(result):
    """The bounds are in order, and as close as promised."""
    assert result.hausdorff == result.lower == max(result.surface_to_mesh, result.mesh_to_surface)
    assert result.upper == max(result.surface_to_mesh_upper, result.mesh_to_surface_upper)
    for lower, upper in (
        (result.surface_to_mesh, result.surface_to_mesh_upper),
        (result.mesh_to_surface, result.mesh_to_surface_upper),
        (result.lower, result.upper),
    ):
        # the absolute gap is one of the box around both, which is larger than the mesh's by what they are apart
        assert lower <= upper <= GAP * lower + 1e-9 * (result.diagonal + 2 * result.hausdorff)
    return result


# --- convex bodies ---


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


@settings(max_examples=15, deadline=None)
@given(seeds=st.tuples(*[st.integers(0, 2**32 - 1)] * 2), count=st.integers(4, 40), flat=st.floats(0.01, 1.0))
def test_random_polytopes_against_brute_force(seeds, count, flat):
    surface, mesh = (polytope(seed, count, (1.0, 1.0, flat)) for seed in seeds)
    result = certified(compare(surface, mesh))
    expected = max(far(surface.vertices, mesh).max(), far(mesh.vertices, surface).max())
    assert result.exact
    assert result.hausdorff == pytest.approx(expected, abs=EXACT * result.diagonal)


def test_distance_is_not_from_vertex_to_vertex():
    sphere = trimesh.creation.icosphere(2)
    turned = moved(sphere, rotation=rotation(2))
    between_vertices = max(
        directed_hausdorff(a.vertices, b.vertices)[0] for a, b in ((sphere, turned), (turned, sphere))
    )
    assert compare(turned, sphere).hausdorff < 0.2 * between_vertices


def test_concentric_cubes():
    result = compare(cube(1.0), cube(1.1))
    assert result.exact
    assert result.hausdorff == result.mesh_to_surface == pytest.approx(np.sqrt(3) * 0.1, rel=1e-13)
    assert result.surface_to_mesh == pytest.approx(0.1, rel=1e-13)
    assert result.worst_on == "mesh"
    assert np.abs(result.worst_point) == pytest.approx([1.1] * 3)
    assert result.diagonal == pytest.approx(2.2 * np.sqrt(3))
    assert result.relative == pytest.approx(0.1 / 2.2)


@pytest.mark.parametrize(
    "shift", [(0.1, 0.0, 0.0), (0.1, -0.2, 0.0), (0.1, 0.2, 0.3), (7.0, 0.0, 0.0), (1e-7, 0.0, 0.0)]
)
def test_translation_of_a_body_is_its_length(shift):
    result = compare(cube(1.0, shift), cube(1.0))
    assert result.hausdorff == pytest.approx(np.linalg.norm(shift), rel=1e-8)


def test_the_farthest_point_inside_a_face():
    """A plate's middle is farthest from the cube around it, though its corners nearly touch that."""
    plate, around = cube((0.9, 0.9, 0.01)), cube(1.0)
    result = certified(compare(plate, around))
    assert result.surface_to_mesh == pytest.approx(0.99, rel=1e-3)
    assert result.surface_to_mesh <= 0.99 * (1 + EXACT) <= result.surface_to_mesh_upper * (1 + 2 * EXACT)
    assert far(plate.vertices, around).max() == pytest.approx(0.1)
    assert result.hausdorff == pytest.approx(np.sqrt(0.99**2 + 2 * 0.1**2), rel=1e-13)


# --- what must not matter ---


@pytest.mark.parametrize("scale", [1e-6, 1e-3, 1e6])
@pytest.mark.parametrize("pair", [PAIRS["crossing"], (angle_bracket(), cube(1.0))], ids=["convex", "not convex"])
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
        elif field.name in ("mean", "rms", "p95", "chamfer"):  # rounding decides which of two equal edges is cut
            assert after == pytest.approx(scale * before, rel=1e-4)
        else:
            assert after == pytest.approx(scale * before, rel=1e-6)


@pytest.mark.parametrize("pair", PAIRS.values(), ids=PAIRS)
def test_order_does_not_matter(pair):
    one, other = compare(*pair), compare(*pair[::-1])
    assert one.hausdorff == other.hausdorff
    assert (one.surface_to_mesh, one.mesh_to_surface) == (other.mesh_to_surface, other.surface_to_mesh)
    assert (one.mean, one.rms, one.chamfer, one.p95) == pytest.approx((other.mean, other.rms, other.chamfer, other.p95))


def test_place_and_attitude_do_not_matter():
    turn = rotation(1)
    for pair in (PAIRS["crossing"], PAIRS["needles"]):
        plain, turned = compare(*pair), compare(*(moved(mesh, (30.0, -20.0, 10.0), rotation=turn) for mesh in pair))
        assert turned.hausdorff == pytest.approx(plain.hausdorff, rel=1e-11)
        assert turned.mean == pytest.approx(plain.mean, rel=1e-2)


def test_same_meshes_same_figures():
    pair = PAIRS["crossing"]
    one, other = (dataclasses.asdict(compare(*pair)) for _ in range(2))
    assert np.array_equal(one.pop("worst_point"), other.pop("worst_point"))
    assert one == other


@pytest.mark.parametrize("mesh", [cube(), ball(0), angle_bracket(), quad(0), trimesh.creation.torus(1.0, 0.4)])
def test_zero_from_itself(mesh):
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


# --- almost convex ---


def dented(depth):
    """A cube of side 2 with one face pushed in at its middle."""
    mesh = cube().subdivide()
    vertices = np.array(mesh.vertices)
    vertices[np.linalg.norm(vertices - [1.0, 0.0, 0.0], axis=1) < 1e-9, 0] -= depth
    return trimesh.Trimesh(vertices, mesh.faces, process=False)


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


def test_single_precision_is_almost_convex():
    tube = trimesh.creation.cylinder(1.0, 3.0, sections=200)
    pair = moved(tube, rotation=rotation(3)), moved(tube, (0.01, 0.0, 0.02), rotation=rotation(3))
    rounded = [moved(mesh) for mesh in pair]
    for mesh in rounded:
        mesh.vertices = np.asarray(mesh.vertices, dtype=np.float32).astype(float)
    result = certified(compare(*rounded))
    expected = compare(*pair)
    assert expected.exact
    assert not result.exact
    assert result.hausdorff == pytest.approx(expected.hausdorff, abs=1e-6)


# --- surfaces that are not convex ---


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
def test_bounds_of_tori_bracket_dense_points(shift):
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


def test_open_and_flat_surfaces(all_samples):
    square = trimesh.Trimesh([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(0, 1, 2), (0, 2, 3)], process=False)
    result = certified(compare(moved(square, (0.0, 0.0, 0.25)), square))
    assert not result.exact
    assert np.isnan(result.volume_error)
    assert (result.hausdorff, result.mean, result.rms, result.p95) == pytest.approx((0.25,) * 4, rel=1e-9)
    assert result.chamfer == pytest.approx(0.5)
    assert compare(moved(square, (0.5, 0.0, 0.0)), square).f_score == pytest.approx(0.5 + 0.01 * np.sqrt(2), abs=0.01)
    line = trimesh.Trimesh([(0, 0, 0), (1, 0, 0), (2, 0, 0)], [(0, 1, 2)], process=False)
    result = certified(compare(line, square))
    assert (result.surface_to_mesh, result.mesh_to_surface) == pytest.approx((1.0, 1.0))
    assert np.isnan(result.normal_median_deg)


def test_a_box_without_lid_is_not_taken_for_a_convex_body():
    lid = cube().face_normals[:, 2] > 0.5
    result = certified(compare(trimesh.Trimesh(cube().vertices, cube().faces[~lid], process=False), cube()))
    assert not result.exact
    assert result.mesh_to_surface == pytest.approx(1.0, rel=1e-3)  # from the middle of the lid
    assert np.isnan(result.volume_error)


# --- averages ---


def test_averages_over_cubes(all_samples):
    """Along an edge of the outer cube the distance bends within 5 % of the side: the samples see that to 1e-3."""
    x = (np.arange(2000) + 0.5) / 2000 * 1.1
    beyond = np.maximum(x - 1.0, 0.0)
    outwards = np.sqrt(0.1**2 + beyond[:, None] ** 2 + beyond**2)
    fine = [trimesh.Trimesh(*trimesh.remesh.subdivide(cube(half).vertices, cube(half).faces)) for half in (1.0, 1.1)]
    for _ in range(5):
        fine = [mesh.subdivide() for mesh in fine]
    assert len(fine[0].faces) > 2 * SAMPLES
    for result in (compare(cube(1.0), cube(1.1)), compare(*fine)):
        assert result.mean == pytest.approx((0.1 + outwards.mean()) / 2, rel=1e-3)
        assert result.chamfer == pytest.approx(0.1 + outwards.mean(), rel=1e-3)
        assert result.rms == pytest.approx(np.sqrt((0.1**2 + (outwards**2).mean()) / 2), rel=2e-3)
        assert result.p95 == pytest.approx(np.quantile(outwards, 0.9), rel=0.05)
        assert result.f_score == 0.0
        assert result.volume_error == pytest.approx(1 / 1.1**3 - 1)


def test_a_quantile_is_the_least_value_that_enough_weight_does_not_exceed():
    values, weights = np.array([3.0, np.nan, 1.0, 2.0]), np.array([0.6, 5.0, 0.1, 0.3])
    for share, expected in ((0.05, 1.0), (0.15, 2.0), (0.39, 2.0), (0.5, 3.0), (1.0, 3.0)):
        assert comparison._quantile(values, weights, share) == expected
    assert np.isnan(comparison._quantile(np.full(2, np.nan), np.ones(2), 0.5))


def test_normals_of_a_turned_cube():
    angle = np.radians(5.0)
    turn = np.array([(np.cos(angle), -np.sin(angle), 0), (np.sin(angle), np.cos(angle), 0), (0, 0, 1)])
    result = compare(moved(cube(), rotation=turn), cube())
    assert result.normal_median_deg == pytest.approx(5.0)  # four of six faces
    inside_out = trimesh.Trimesh(cube().vertices, cube().faces[:, ::-1], process=False)
    assert compare(inside_out, cube()).normal_median_deg == pytest.approx(180.0)


# --- the search beneath ---


@pytest.mark.parametrize("height", [1e-1, 1e-3, 1e-6, 1e-8, 1e-9, 1e-11, 1e-13, 1e-15, 0.0])
def test_distances_to_slivers_against_60_digits(height):
    rng = np.random.default_rng(2)
    a, along = rng.random((200, 3)), 0.5 * rng.standard_normal((200, 3))
    c = a + rng.random((200, 1)) * along + height * rng.standard_normal((200, 3))
    c[:5], along[:2] = a[:5], 0.0  # single segments and points
    corners = np.stack([a, a + along, c], axis=1)
    close = corners[:100].mean(axis=1) + 10.0 ** rng.uniform(-10, -1, (100, 1)) * rng.standard_normal((100, 3))
    points = np.concatenate([close, rng.random((30, 3)), a[:20] + 1e-9])
    sorted_corners = np.take_along_axis(corners, _longest_first(corners)[:, :, None], axis=1)
    distance, face = _Search(sorted_corners).nearest(points)
    assert distance == pytest.approx(
        [far_in_60_digits(p, *corners[f]) for p, f in zip(points, face, strict=True)], abs=1e-15
    )
    # No triangle is nearer: the few that might be, from their edges, are tried.
    edges = [trimesh.Trimesh(corner, [(0, 1, 1), (1, 2, 2), (2, 0, 0)], process=False) for corner in corners]
    from_edges = np.column_stack([far(points, edge) for edge in edges])
    width = 2 * _areas(corners) / np.maximum(np.linalg.norm(np.diff(sorted_corners[:, :2], axis=1)[:, 0], axis=1), 1e-9)
    for i, j in np.argwhere(from_edges - width < distance[:, None]):
        assert far_in_60_digits(points[i], *corners[j]) >= distance[i] - 1e-15


def test_distances_of_points_to_a_body():
    body = PAIRS["crossing"][0]
    points = np.random.default_rng(1).standard_normal((500, 3)) * 2
    hull = ConvexHull(body.vertices)
    above = (points @ hull.equations[:, :3].T + hull.equations[:, 3]).max(axis=1)
    signed, face, foot = nearest(points, body)
    assert np.array_equal(signed < 0, above < 0)
    assert signed[above < 0] == pytest.approx(above[above < 0], rel=1e-12)
    assert np.abs(signed) == pytest.approx(far(points, body), rel=1e-12)
    one_face = [
        far(p[None], trimesh.Trimesh(body.vertices, [body.faces[f]], process=False))[0]
        for p, f in zip(points, face, strict=True)
    ]
    assert np.abs(signed) == pytest.approx(one_face, rel=1e-12)
    assert np.linalg.norm(points - foot, axis=1) == pytest.approx(np.abs(signed), rel=1e-12)
    assert np.abs(signed_distances(foot, body)).max() < 1e-12
    assert np.array_equal(signed_distances(points, body), signed)
    assert np.array_equal(distances(points, body), np.abs(signed))
    square = trimesh.Trimesh([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(0, 1, 2), (0, 2, 3)], process=False)
    assert distances(points, square) == pytest.approx(far(points, square), rel=1e-12)
    assert len(distances(np.empty((0, 3)), body)) == 0


def test_nothing_that_draws_is_loaded():
    code = """
import sys, trimesh
from scan3d.comparison import compare
compare(trimesh.creation.box(), trimesh.creation.icosphere(1))
drawing = [name for name in sys.modules if "Rendering" in name or name in ("pyvista", "open3d", "matplotlib")]
assert not drawing, drawing
"""
    subprocess.run([sys.executable, "-c", code], check=True)


# --- what can't be compared ---

BROKEN = {
    "no faces": (
        trimesh.Trimesh([(0, 0, 0), (1, 0, 0)], process=False),
        "at least one triangle, but it has 2 vertices",
    ),
    "empty": (trimesh.Trimesh(), "at least one triangle, but it has 0 vertices"),
    "not a number": (
        trimesh.Trimesh([(0, 0, 0), (1, 0, np.nan), (0, 1, 0)], [(0, 1, 2)], process=False),
        "finite coordinates, but 1 of its 3 vertices",
    ),
    "infinite": (
        trimesh.Trimesh([(0, 0, 0), (1, 0, np.inf), (0, 1, 0)], [(0, 1, 2)], process=False),
        "finite coordinates, but 1 of its 3 vertices",
    ),
    "no extent": (trimesh.Trimesh([(3, 2, 1)] * 3, [(0, 1, 2)], process=False), r"all its 3 vertices are at \[3"),
}


@pytest.mark.parametrize(("mesh", "words"), BROKEN.values(), ids=BROKEN)
def test_what_cannot_be_compared_is_refused(mesh, words):
    with pytest.raises(InputError, match=f"the surface should .*{words}"):
        compare(mesh, cube())
    with pytest.raises(InputError, match=f"the mesh should .*{words}"):
        compare(cube(), mesh)
