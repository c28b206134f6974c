"""The rods that `tests.robustness.faults` bends solve the boundary value problem, by an integration of scipy."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.robustness.shot_rods import Bent, equilibria, free, path

ZETA = np.arctan(0.3)
RODS = {
    "straight": Bent(),
    "tapered": Bent(tip=0.6),
    "curved": Bent(curvature=-0.3),
    "in a clamp that gives": Bent(compliance=0.05),
    "heavy": Bent(weight=0.1),
    "all but heavy": Bent(tip=0.8, curvature=-0.2, compliance=0.02),
}
DOWN = np.array([0.6, -0.8])


def states(rod):
    """Places on a circle, and the states there."""
    slope = np.radians([60.0, 40.0, 20.0, 0.0, -20.0])
    places = np.array([0.0, 1.3]) + 0.9 * np.stack([np.sin(slope), -np.cos(slope)], axis=1)
    return slope, places, equilibria(rod, places[:, 1], slope, ZETA, np.tile(DOWN[:, None], 5), homotopy=4, steps=24)


def slopes(rod, internal):
    """The equations of a rod for the force beyond each place s."""

    def found(s, state):
        (fx, fy), phi = internal(s), state[0]
        bent = state[1] / (1 + (rod.tip - 1) * s) ** 4 + rod.curvature
        return np.array([bent, fx * np.sin(phi) - fy * np.cos(phi), np.cos(phi), np.sin(phi)])

    return found


@pytest.mark.slow
@pytest.mark.parametrize("rod", RODS.values(), ids=RODS)
def test_rods_reach_their_contact_from_the_clamp(rod):
    slope, places, found = states(rod)
    assert np.isfinite(found.x0).all()
    assert (found.s1 < 1).any()
    for k, (s1, reactions) in enumerate(zip(found.s1, found.reactions, strict=True)):
        moment = -reactions[2]
        start = [np.pi / 2 + rod.compliance * moment, moment, found.x0[k] + places[k, 0], 0.0]
        equations = slopes(rod, lambda s, r=reactions: -r[:2] - rod.weight * s * DOWN)
        end = solve_ivp(equations, (0, s1), start, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
        assert end[2:] == pytest.approx(places[k], abs=1e-9)
        assert end[0] == pytest.approx(found.angle[k], abs=1e-9)
        if s1 < 1:
            assert end[0] == pytest.approx(slope[k], abs=1e-9)
        # below the contact the force on the rod has the angle of friction to the normal
        contact = -reactions[:2] - rod.weight * DOWN
        assert np.arctan2(contact[0], -contact[1]) == pytest.approx(slope[k] + ZETA, abs=1e-9)
        if not rod.weight:
            assert end[1] == pytest.approx(0.0, abs=1e-9)
            continue
        # the rod beyond the contact bends under its own weight, down to its free end
        beyond = slopes(rod, lambda s: rod.weight * (1 - s) * DOWN)
        assert solve_ivp(beyond, (s1, 1), end, method="DOP853", rtol=1e-12, atol=1e-13).y[1, -1] == pytest.approx(
            0, abs=1e-9
        )


def test_a_free_rod_has_its_weight_and_moment():
    force_x, force_y, moment = free(Bent(weight=1e-3), DOWN[:, None])[:, 0]
    assert [force_x, force_y] == pytest.approx(-1e-3 * DOWN)
    assert moment == pytest.approx(1e-3 * DOWN[0] / 2, rel=1e-3)


def test_a_path_passes_vertices_by_turning_and_sides_by_moving():
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    places, slopes = path(square, 600)
    turning = (np.diff(places, axis=0) == 0).all(axis=1)
    assert (np.diff(slopes) <= 1e-12).all()
    assert np.abs(slopes[1:][~turning]).max() == pytest.approx(0.0, abs=0.01)
    assert (places[slopes > 1e-9] == [1.0, 0.0]).all()
    assert (places[slopes < -1e-9] == [0.0, 0.0]).all()
