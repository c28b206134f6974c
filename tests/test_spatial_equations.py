"""The Jacobian of the rod's equations in space agrees with difference quotients, on all branches of Coulomb's law."""

import numpy as np
import pytest

from scan3d.spatial.bodies import Ellipsoid, unit
from scan3d.spatial.equilibrium import Clamp, Law, Mode, bent, system

COUNT, STEP = 300, 1e-6


@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.parametrize("drag", [0.0, 0.7])
def test_jacobian(mode, drag):
    rng = np.random.default_rng(int(mode))
    clamp = Clamp(np.zeros((3, COUNT)), *(np.repeat(np.eye(3)[:, [k]], COUNT, axis=1) for k in range(3)))
    body = Ellipsoid((0.9, 0.675, 0.45), (0, 1.075, 0), radius=0.01)
    state = np.stack([rng.uniform(*limits, COUNT) for limits in ((-1, 1), (0.3, 1.2), (0.02, 0.15), (0.5, 0.95))])
    normal, feature = unit(rng.normal(size=(3, COUNT))), np.zeros(COUNT, dtype=int)
    law = Law(
        np.full(COUNT, 0.3),
        rng.normal(size=(3, COUNT)),
        np.full(COUNT, 0.7),
        np.full(COUNT, mode, dtype=np.int8),
        unit(rng.normal(size=(3, COUNT))),
        np.full(COUNT, 3.0),
        np.full(COUNT, drag),
    )

    def residual(state, normal):
        return system(state, bent(state, clamp), body.patch(feature, normal), law)

    here, patch = residual(state, normal), body.patch(feature, normal)
    # where both sides of a quotient are on one branch
    pressed = here.normal_force > 0.1
    for k in range(6):
        sides = []
        for sign in (1, -1):
            moved, place = state.copy(), normal
            if k < 4:
                moved[k] += sign * STEP
            else:
                place = unit(normal + sign * STEP * (patch.normal_1, patch.normal_2)[k - 4])
            sides.append(residual(moved, place).residual)
        difference = (sides[0] - sides[1]) / (2 * STEP) - here.jacobian[:, k]
        amiss = np.abs(difference)
        if k >= 4:
            # the axes of the tangent plane turn in it with the normal; this turns the two equations of friction, which vanish
            # at the solution, and is left out of the Jacobian
            amiss[3] = np.abs((difference[3:5] * here.residual[3:5]).sum(axis=0)) / np.hypot(*here.residual[3:5])
            amiss[4] = 0.0
            if mode == Mode.FROZEN:
                # the direction that is frozen is fixed in space, but its part in the tangent plane is scaled anew
                amiss[3] = 0.0
        size = 1 + np.abs(here.jacobian).max(axis=(0, 1))
        assert np.quantile((amiss / size)[:, pressed], 0.99, axis=1).max() < 1e-7
