"""Support functions of slices, and their slopes over the height, on bodies that have them in closed form."""

import numpy as np
import pytest
import trimesh

import scan3d
from scan3d.cloud import contacts
from scan3d.layers import height_slopes, stacks

ANGLES = np.linspace(-np.pi, np.pi, 721)


def unit(angles):
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)


def sliced(mesh, **plan):
    """The slices of a scan along the z axis."""
    (stack,) = stacks(contacts(scan3d.simulate(mesh, scan3d.Plan(**plan))))
    return stack


def body_of(points):
    return trimesh.Trimesh(np.asarray(points, dtype=float), process=False).convex_hull


def prism(sides, radius=10.0, height=40.0):
    turn = 2 * np.pi * (np.arange(sides) + 0.3) / sides
    ring = radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return ring, body_of([(*p, z) for p in ring for z in (-height / 2, height / 2)])


def house():
    """An upright box, 20 wide and 20 high, under a pyramid of height 10."""
    walls = [(x, y, z) for x in (-10, 10) for y in (-10, 10) for z in (-20, 0)]
    return body_of([*walls, (0, 0, 10)])


# --- in a slice ---


@pytest.mark.parametrize("sides", [3, 4, 7])
@pytest.mark.parametrize("samples", [4, 8, 64])
def test_between_the_normals_the_support_is_that_of_a_body_that_may_be(sides, samples):
    """At least that of the contacts, at most that of the support lines' corner, which on a polygon is its own vertex."""
    ring, mesh = prism(sides)
    true = (unit(ANGLES) @ ring.T).max(axis=1)
    complete = 0
    for one in sliced(mesh, slices=4, samples=samples).layers:
        support = one.support(ANGLES)
        assert one.support(one.angle) == pytest.approx(one.value, abs=1e-9)
        assert (support >= (unit(ANGLES) @ one.points[one.lying].T).max(axis=1) - 1e-9).all()
        edges = np.roll(ring, -1, axis=0) - ring
        off = np.arctan2(-edges[:, 0], edges[:, 1])[:, None] - one.angle
        if (np.abs(np.exp(1j * off) - 1).min(axis=1) < 1e-6).all():
            complete += 1
            assert (support <= true + 1e-9).all()
    assert complete or samples < 64


def test_the_support_of_a_smooth_slice_is_close_between_few_normals():
    """An ellipse, whose support function is √(a² cos² + b² sin²), from a few dozen contacts: cubics err by their 4th power."""
    a, b = 10.0, 6.0
    mesh = trimesh.creation.cylinder(1.0, 40.0, sections=4000)
    mesh.apply_scale((a, b, 1.0))
    stack = sliced(mesh, slices=3, samples=16, sweeps=4)
    true = np.hypot(a * np.cos(ANGLES), b * np.sin(ANGLES))
    for one in stack.layers:
        assert 20 < len(one.angle) < 80
        assert one.support(ANGLES) == pytest.approx(true, abs=2e-3 * a)


def test_the_steiner_point_of_a_slice_moves_with_it():
    """That of a centrally symmetric slice is its centre."""
    mesh = trimesh.creation.cylinder(8.0, 40.0, sections=200)
    mesh.apply_translation((3.0, -5.0, 0.0))
    for one in sliced(mesh, slices=3).layers:
        assert one.steiner_point() == pytest.approx([3.0, -5.0], abs=1e-3)


# --- from slice to slice ---


def test_walls_stay_upright_below_a_roof():
    """Where the slices below and above are as wide, concavity leaves the slope 0 alone, though a spline swings there."""
    stack = sliced(house(), slices=12, spacing="uniform")
    slopes = height_slopes(stack)
    walls = [i for i in range(1, len(stack.layers) - 1) if stack.heights[i + 1] < 0]
    assert len(walls) >= 3
    for i in walls:
        assert np.abs(slopes[i][0]).max() < 1e-9


@pytest.mark.parametrize("mesh", [house(), trimesh.creation.icosphere(1, 15.0)], ids=["house", "polyhedron"])
@pytest.mark.parametrize("spacing", ["uniform", "cosine"])
def test_slopes_lie_between_the_secants_to_the_slices_below_and_above(mesh, spacing):
    stack = sliced(mesh, slices=12, spacing=spacing)
    closed = [one for one in stack.layers if one.closed]
    assert len(closed) > 6
    for below, one, above in zip(closed, closed[1:], closed[2:], strict=False):
        (slope,) = (s[0] for s, other in zip(height_slopes(stack), stack.layers, strict=True) if other is one)
        angle = np.arctan2(one.normals[:, 1], one.normals[:, 0])
        here = one.support(angle)
        lower = (here - below.support(angle)) / (one.height - below.height)
        upper = (above.support(angle) - here) / (above.height - one.height)
        # where the support between normals is interpolated, the secants may be the wrong way round
        assert (slope >= np.minimum(lower, upper) - 1e-12).all()
        assert (slope <= np.maximum(lower, upper) + 1e-12).all()


def test_the_roofs_slope_is_found():
    """Half the width over the pyramid's height, on the slices of the pyramid that have another on either side."""
    stack = sliced(house(), slices=20, spacing="uniform")
    slopes = height_slopes(stack)
    found = 0
    for i in range(1, len(stack.layers) - 1):
        if stack.heights[i - 1] > 0:
            along_axis = np.abs(stack.layers[i].normals).max(axis=1) > 1 - 1e-9
            assert slopes[i][0][along_axis] == pytest.approx(-1.0, abs=1e-6)
            found += np.count_nonzero(along_axis)
    assert found > 8


def test_one_slice_alone_has_no_slope():
    slopes = height_slopes(sliced(house(), slices=1))
    assert len(slopes) == 1
    assert all(np.isnan(part).all() for part in slopes[0])
