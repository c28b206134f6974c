"""Bodies on which a rod is hard to follow: nothing of it is in the body, and what is not known is not called free."""

import numpy as np
import pytest

import planar
from planar import SweepStatus
from planar.any_body import follow
from planar.contours import Outlines
from planar.several import shapes


def block(*lower_side, height=0.35, up=0.7):
    """A block whose lower side has the given corners (k, 2) between its ends at (∓0.3, 0)."""
    corners = [(-0.3, 0), *lower_side, (0.3, 0), (0.3, height), (-0.3, height)]
    return planar.Polygon(np.array(corners) + np.array([0, up]))


def teeth(pitch, count):
    x = (np.arange(count) - count / 2) * pitch
    return [corner for place in x for corner in ((place, 0), (place + pitch / 2, pitch))]


HOOK = [[-0.25, 0], [0.05, 0], [0.05, 0.1], [-0.15, 0.1], [-0.15, 0.3], [0.3, 0.3], [0.3, 0.4], [-0.25, 0.4]]
CORNERS = {
    "a slot narrower than the bent rod": block((-0.02, 0), (-0.02, 0.25), (0.02, 0.25), (0.02, 0)),
    "a wedge of 20 degrees": block((-0.044, 0), (0, 0.25), (0.044, 0)),
    "a hook": planar.Polygon(np.array(HOOK) + np.array([0, 0.6])),
    "a hook the other way": planar.Polygon(np.array(HOOK) * np.array([-1, 1]) + np.array([0, 0.6])),
    "one behind the other": planar.Contours([planar.Circle(0.15, (0.25, 0.8)), planar.Circle(0.15, (-0.25, 0.8))]),
    "a ring": planar.Contours([planar.Circle(0.3, (0, 0.8)), planar.Circle(0.2, (0, 0.8))]),
    "an upright edge and a flat bay": block((-0.1, 0), (-0.1, 0.1), (0.1, 0.1), (0.1, 0)),
    "a sliver": planar.Polygon(np.array([[-0.3, 0.8], [0.3, 0.801], [-0.3, 0.802]])),
}
QUICK = ["a wedge of 20 degrees", "a hook", "one behind the other"]


def passed(contours, frictions, count):
    outlines = Outlines([contour.loops() for contour in contours])
    m = len(contours)
    bases = [np.linspace(outlines.touch_down(i) - 1e-3, outlines.low[i, 0] - 0.9, count) for i in range(m)]
    swept = follow(outlines, bases, [np.full(count, np.arctan(friction)) for friction in frictions])
    at = np.broadcast_to(np.linspace(0, 1, 400), (count, 400))
    for body, found in enumerate(swept):
        known = found.status != SweepStatus.UNRESOLVED
        shape = shapes(outlines, found.rods, at)
        points = np.stack([shape.x[known].ravel(), shape.y[known].ravel()], axis=1)
        # the rods are outside, though corners may come between the places at which they are tested by what the step allows
        assert outlines.nearest(np.full(len(points), body), points, 0.01).gap.min() > -1e-7
        assert (found.rods.force[known] >= 0).all()
        # free rods are straight, and clear of the body; far from it they are
        free = found.status == SweepStatus.FREE
        assert np.ptp(shape.x[free], axis=1).max(initial=0) < 1e-15
        assert free[-1]
        # past its last contact the rod carries no moment
        assert np.abs(shape.kappa[known, -1]).max() < 1e-12
    return np.stack([found.status for found in swept])


@pytest.mark.slow
def test_hard_corners():
    status = passed([CORNERS[name] for name in QUICK], [0.0, 0.3, 0.3], 24)
    assert (status != SweepStatus.UNRESOLVED).all()


@pytest.mark.trust
@pytest.mark.parametrize("friction", [0.0, 0.3, 1.0])
def test_all_hard_corners(friction):
    status = passed(list(CORNERS.values()), [friction] * len(CORNERS), 60)
    assert (status != SweepStatus.UNRESOLVED).mean() > 0.97


def test_teeth_finer_than_the_chain_are_touched_one_after_the_other():
    saw = block(*teeth(0.01, 40))
    outlines = Outlines([saw.loops()])
    base = np.linspace(outlines.touch_down(0) - 1e-3, -0.15, 30)
    found = follow(outlines, [base], [np.full(30, np.arctan(0.3))])[0]
    assert ((found.status == SweepStatus.ONE_CONTACT) | (found.status == SweepStatus.SEVERAL_CONTACTS)).all()


@pytest.mark.slow
def test_friction_that_changes_from_sample_to_sample():
    rng = np.random.default_rng(20)
    swept = planar.sweep(CORNERS["a hook"], rng.uniform(0, 0.5, 12), base=np.linspace(0.2, -0.5, 12))
    assert (swept.status != SweepStatus.FREE).all()
    touching = swept.status == SweepStatus.ONE_CONTACT
    first = swept.contacts[touching, 0]
    np.testing.assert_allclose(
        np.abs(first["force_angle"] - first["slope"]), np.arctan(swept.friction[touching]), atol=1e-9
    )


@pytest.mark.parametrize("moved", [-1e-13, 0.0, 1e-13])
def test_a_rod_that_stands_along_an_edge_up_to_rounding_touches_its_near_end(moved):
    block = planar.Polygon([(0.0, 0.3), (0.4, 0.3), (0.4 + moved, 0.7), (0.0, 0.7)])
    np.testing.assert_allclose(planar.sweep(block, 20).point[0], (0.4, 0.3), atol=1e-9)
