"""Sweeps agree with the paper's method: its boundary value problems (3) with (5)-(7), solved by shooting.

The reference, `shooting`, integrates (3) numerically and shares no formula with the closed form.  Both satisfy their
conditions to some 1e-14; 1e-10 allows for places next to folds, where errors are square roots of those.
"""

import numpy as np
import pytest
import shooting

import planar

pytestmark = pytest.mark.slow

AGREES = 1e-10

CIRCLE = planar.Circle(radius=0.9, center=(0.0, 1.3))
ELLIPSE = planar.Ellipse(semi_axes=(0.7, 0.4), center=(0.1, 1.0), angle=np.radians(20))
HEPTAGON = planar.Polygon(
    np.array([[0.1, 0.95]]) + 0.55 * np.stack([f(0.2 + np.arange(7) * 2 * np.pi / 7) for f in (np.cos, np.sin)], axis=1)
)


def assert_agree(state, swept, i, tolerance=AGREES):
    assert state.success, swept.x0[i]
    for name in ("f0x", "f0y", "m0z", "s1", "slope"):
        assert abs(getattr(state, name) - getattr(swept, name)[i]) < tolerance, (name, swept.x0[i])
    assert np.abs(state.point - swept.point[i]).max() < tolerance


def states_by_continuation(contour, friction, swept):
    """States at the sweep's base positions, each starting from the previous state, the first from a cantilever's deflection."""
    touch_down = planar.events(contour, friction)
    slope = touch_down.slope[0, 1]
    deflection = touch_down.x0[0] - swept.x0[0]
    force = 3 * deflection / np.sin(slope + np.arctan(friction))
    state = [force, -3 * deflection, 1.0, slope]
    for x0, phase in zip(swept.x0, swept.phase, strict=True):
        state = shooting.shoot(shooting.along(contour), friction, x0, planar.Phase(phase), state)
        yield state


@pytest.mark.parametrize("friction", [0.0, 0.5])
@pytest.mark.parametrize("contour", [CIRCLE, ELLIPSE], ids=["circle", "ellipse"])
def test_smooth_contours(contour, friction):
    events = planar.events(contour, friction)
    swept = planar.sweep(contour, friction, base=np.linspace(events.x0[0] - 0.01, events.x0[-1] + 0.005, 14))
    assert set(swept.phase) == {planar.Phase.TIP, planar.Phase.TANGENTIAL}
    for i, state in enumerate(states_by_continuation(contour, friction, swept)):
        assert_agree(state, swept, i)


@pytest.mark.parametrize("friction", [0.0, 0.5])
def test_a_polygon_of_seven_sides(friction):
    swept = planar.sweep(HEPTAGON, friction, samples=20)
    vertices = HEPTAGON.vertices
    edges = np.roll(vertices, -1, axis=0) - vertices
    slopes = np.arctan2(edges[:, 1], edges[:, 0])
    rng = np.random.default_rng(40)
    seen = set()
    # there is no force at touch-down, and x0 has its minimum at the end: neither is a regular solution
    for i in range(1, len(swept) - 1):
        at = np.linalg.norm(vertices - swept.point[i], axis=1) < 1e-9
        on = np.abs(slopes - swept.slope[i]) < 1e-9
        if at.any():
            place, parameter = shooting.at_vertex(vertices[at][0]), swept.slope[i]
        else:
            first, last = vertices[on][0], vertices[np.flatnonzero(on)[0] + 1 - len(vertices)]
            place = shooting.on_edge(first, last)
            parameter = np.linalg.norm(swept.point[i] - first) / np.linalg.norm(last - first)
        # Continuation fails at snaps: every solution starts next to the expected state, but not at it.
        perturbation = 1 + rng.uniform(-0.02, 0.02, 4)
        start = perturbation * [np.hypot(swept.f0x[i], swept.f0y[i]), -swept.m0z[i], swept.s1[i], parameter]
        phase = planar.Phase(swept.phase[i])
        state = shooting.shoot(place, friction, swept.x0[i], phase, start)
        assert_agree(state, swept, i)
        seen.add((phase, bool(at.any())))
    assert {(planar.Phase.TIP, False), (planar.Phase.TANGENTIAL, False), (planar.Phase.TANGENTIAL, True)} <= seen


def test_collocation():
    # the same problems by scipy.integrate.solve_bvp: its tolerance of 1e-8 holds for the defect; reactions are less accurate
    events = planar.events(CIRCLE, 0.3)
    swept = planar.sweep(CIRCLE, 0.3, base=np.linspace(events.x0[0] - 0.05, events.x0[-1] + 0.1, 12))
    previous = None
    for i, state in enumerate(states_by_continuation(CIRCLE, 0.3, swept)):
        start = previous if previous and previous.state.phase == state.phase else state
        previous = shooting.solve_by_collocation(shooting.along(CIRCLE), 0.3, swept.x0[i], state.phase, start, tol=1e-8)
        assert previous.values.shape == (4, len(previous.mesh))
        assert_agree(previous.state, swept, i, tolerance=1e-7)
