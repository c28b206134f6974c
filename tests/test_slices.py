"""Support functions of slices, and the bounds that concavity sets to their slopes."""

import dataclasses

import numpy as np
import pytest
import trimesh
from sample_bodies import random_body
from scipy.optimize import linprog
from slices_by_hand import slice_of, square

import scan3d
from scan3d.reconstruction.contacts import contacts
from scan3d.reconstruction.normals import height_slopes
from scan3d.reconstruction.slices import SupportFunctions, stacks


@pytest.fixture(scope="module", params=[0, *(pytest.param(seed, marks=pytest.mark.trust) for seed in (4, 8))])
def polytope(request):
    mesh = random_body(request.param)
    cloud = contacts(scan3d.simulate(mesh, scan3d.Plan(slices=10, samples=12, sweeps=5, friction=(0.0, 0.4))))
    return mesh, stacks(cloud)


ANGLES = np.linspace(-np.pi, np.pi, 720, endpoint=False)
NORMALS = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1)


@pytest.mark.slow
def test_between_its_normals_a_slices_support_lies_between_contacts_and_support_lines(polytope):
    """The upper bound by linear programming over the half-planes of the known normals."""
    _, by_axis = polytope
    clipped_below = clipped_above = 0
    for stack in by_axis:
        for section in stack.slices[2:-2]:
            if not section.closed:
                continue
            known = np.stack([np.cos(section.angle), np.sin(section.angle)], axis=1)
            support = SupportFunctions((section,)).at(ANGLES)[0]
            tangential = section.points[section.tangential]
            lower = (NORMALS @ tangential.T).max(axis=1)
            upper = [-linprog(-n, A_ub=known, b_ub=section.value, bounds=(None, None)).fun for n in NORMALS[::24]]
            size = np.ptp(section.points)
            assert (support >= lower - 1e-9 * size).all()
            assert (support[::24] <= np.array(upper) + 1e-9 * size).all()
            clipped_below += np.isclose(support, lower, rtol=0, atol=1e-12 * size).sum()
            clipped_above += np.isclose(support[::24], upper, rtol=0, atol=1e-9 * size).sum()
    # both bounds are met somewhere, or the test would say nothing about them
    assert clipped_below
    assert clipped_above


def test_slopes_in_height_lie_between_the_secants(polytope):
    """Concavity in the height bounds them with certainty; a cubic spline alone exceeds these bounds at a crease."""
    _, by_axis = polytope
    counted = clipped = 0
    for stack in by_axis:
        slices = [(section, slopes) for section, (slopes, _) in zip(stack.slices, height_slopes(stack), strict=True)]
        slices = [(section, slopes) for section, slopes in slices if section.closed]
        for (below, _), (section, slopes), (above, _) in zip(slices[:-2], slices[1:-1], slices[2:], strict=True):
            angle = np.arctan2(section.normals[:, 1], section.normals[:, 0])
            h = SupportFunctions((section,)).at(angle)[0]
            lower = (SupportFunctions((above,)).at(angle)[0] - h) / (above.height - section.height)
            upper = (h - SupportFunctions((below,)).at(angle)[0]) / (section.height - below.height)
            lower, upper = np.minimum(lower, upper), np.maximum(lower, upper)
            assert (slopes >= lower - 1e-9).all()
            assert (slopes <= upper + 1e-9).all()
            counted += len(angle)
            clipped += int(((slopes == lower) | (slopes == upper)).sum())
    assert 0 < clipped < counted


def test_the_support_of_a_smooth_slice_is_close_between_few_normals():
    """An ellipse, whose support function is √(a² cos² + b² sin²), from a few dozen contacts."""
    a, b = 10.0, 6.0
    mesh = trimesh.creation.cylinder(1.0, 40.0, sections=1000)
    mesh.apply_scale((a, b, 1.0))
    (stack,) = stacks(contacts(scan3d.simulate(mesh, scan3d.Plan(slices=3, samples=16, sweeps=4))))
    exact = np.hypot(a * np.cos(ANGLES), b * np.sin(ANGLES))
    for section in stack.slices:
        assert 20 < len(section.angle) < 80
        assert SupportFunctions((section,)).at(ANGLES)[0] == pytest.approx(exact, abs=2e-3 * a)


@pytest.mark.parametrize(
    ("degrees", "closed"),
    [
        ([0, 120, -120], True),
        ([0, 90, 180], False),  # a gap of exactly half a turn
        ([-90, 0, 90], False),  # the gap from the last to the first
        ([0, 100, 170], False),
        ([-170, -80, 95], True),
        ([-170, -80, 105], False),  # a gap of 185° between the last two
        ([-90, 0, 90 + 1e-5], True),
        ([-90, 0, 90 - 1e-5], False),
        ([-90, 0, 90 + np.degrees(3e-9)], True),
        ([-90, 0, 90 + np.degrees(3e-10)], False),  # half a turn to rounding
        ([0, 179], False),
        ([0], False),
        ([], False),
    ],
)
def test_a_slice_is_closed_if_its_normals_leave_no_gap_of_half_a_turn(degrees, closed):
    section = dataclasses.replace(slice_of(square(1.0), 0.0), angle=np.radians(np.sort(np.array(degrees, float))))
    assert section.closed == closed
