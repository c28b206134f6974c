"""The accuracy of sweeps with friction, checked by halving their steps."""

import numpy as np
import pytest
from rods_in_space import random_ellipsoid, random_paths

from scan3d.spatial.bodies import Ellipsoid
from scan3d.spatial.sweeping import sweep


@pytest.fixture(scope="module")
def scene():
    """Sweeps over the near side of an ellipsoid, without snaps."""
    body = Ellipsoid((0.9, 0.675, 0.45), (0.0, 1.075, 0.0))
    position = np.zeros((3, 24, 3))
    position[:, :, 0], position[:, :, 2] = np.linspace(0.92, 0.2, 24), np.linspace(0.08, 0.2, 3)[:, None]
    return body, position, np.broadcast_to(np.eye(3), (3, 3, 3))


@pytest.fixture(scope="module")
def exact(scene):
    body, position, axes = scene
    return sweep(body, position, axes, 0.3, substeps=128)


@pytest.mark.slow
@pytest.mark.parametrize("accuracy", [1e-2, 1e-3])
def test_what_is_left_is_within_the_accuracy(scene, exact, accuracy):
    body, position, axes = scene
    swept = sweep(body, position, axes, 0.3, accuracy=accuracy)
    assert (swept.step_error <= accuracy).all()
    error = np.abs(swept.point - exact.point)
    assert np.nanmax(error) < 1.2 * accuracy
    relative = np.linalg.norm(swept.force - exact.force, axis=2) / np.maximum(1, np.linalg.norm(exact.force, axis=2))
    # of first order: what is left is as large as the last halving's change
    assert np.nanmax(relative) < 1.2 * accuracy
    assert np.nanmax(relative) > 0.02 * accuracy


@pytest.mark.slow
def test_an_accuracy_that_is_out_of_reach_is_reported(scene):
    body, position, axes = scene
    swept = sweep(body, position[:1], axes[:1], 0.3, accuracy=1e-9)
    assert (swept.step_error > 1e-9).all()
    assert (swept.step_error < 1e-3).all()
    assert np.nanmax(swept.steps) >= 64


def test_without_friction_steps_leave_no_error(scene):
    body, position, axes = scene
    swept, plain = sweep(body, position, axes, accuracy=1e-6), sweep(body, position, axes)
    assert (swept.step_error == 0).all()
    assert np.array_equal(swept.point, plain.point, equal_nan=True)
    assert np.isnan(plain.step_error).all()


def test_only_sweeps_that_need_it_are_repeated(scene):
    body, _, _ = random_ellipsoid(0)
    position, axes = random_paths(body, 12, 20, np.random.default_rng(0))
    friction = np.where(np.arange(12) % 2, 0.3, 0.0)
    swept, plain = sweep(body, position, axes, friction, accuracy=0.05), sweep(body, position, axes, friction)
    assert (swept.step_error[::2] == 0).all()
    assert np.array_equal(swept.force[::2], plain.force[::2], equal_nan=True)


def test_impossible_accuracies_are_refused(scene):
    body, position, axes = scene
    for accuracy in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="accuracy"):
            sweep(body, position, axes, 0.3, accuracy=accuracy)
    with pytest.raises(ValueError, match="substeps"):
        sweep(body, position, axes, 0.3, substeps=0)
