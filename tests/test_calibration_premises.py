"""Calibration on touches that the model does not fit: nothing wrong is called well determined, and the cause is named."""

import dataclasses

import numpy as np
import pytest

import scan3d
from tests import rigs


def of_rig(found):
    return ~np.array([name.startswith(("tare", "drift")) for name in found.names])


def nothing_is_well_determined(found):
    return not np.array(found.well)[of_rig(found)].any()


@pytest.mark.parametrize("seed", [0, 1])
def test_a_sphere_of_1280_facets_is_no_sphere(seed):
    recording = rigs.recorded(seed=seed, facets=3)
    found = scan3d.calibrate(recording, rigs.DIAMETER)
    assert nothing_is_well_determined(found)
    assert "a reference that is no sphere, such as one of facets" in found.sentences[-1]
    error = found.values - rigs.truth_of(found, rigs.Truth(), recording, facets=3)
    assert (np.abs(error) < 3 * found.standard_deviations).all()


def test_facets_are_noticed_without_noise():
    recording = rigs.recorded(rigs.EXACT, facets=3)
    found = scan3d.calibrate(recording, rigs.DIAMETER)
    assert nothing_is_well_determined(found)
    error = found.values - rigs.truth_of(found, rigs.EXACT, recording, facets=3)
    assert (np.abs(error) < 2 * found.standard_deviations).all()


@pytest.mark.parametrize("seed", [0, 1])
def test_a_log_of_the_planar_model_is_recognised(seed):
    found = scan3d.calibrate(rigs.planar_model_recorded(seed), rigs.DIAMETER)
    assert nothing_is_well_determined(found)
    assert "forces lie in one plane, of a planar model" in found.sentences[-1]
    true = {"bending_stiffness_Nm2": 8.35e-5, "clamp_x_mm": 0.0, "sensor_y_mm": -20.0, "sensor_turn_y_deg": 30.0}
    for name, value in true.items():
        k = found.names.index(name)
        assert abs(found.values[k] - value) < 2 * found.standard_deviations[k], name


def test_a_wrong_diameter_is_named_with_one_that_fits():
    found = scan3d.calibrate(rigs.recorded(), 0.031)
    assert nothing_is_well_determined(found)
    assert "The likeliest cause is the diameter: one of 30.0" in found.sentences[-1]


@pytest.mark.parametrize("mixed", [0.003, 0.01])
def test_a_sensor_whose_channels_mix_is_noticed(mixed):
    recording = rigs.recorded()
    wrong = dataclasses.replace(recording, moment_x_Nm=recording.moment_x_Nm + mixed * recording.moment_Nm)
    found = scan3d.calibrate(wrong, rigs.DIAMETER)
    error = found.values - rigs.truth_of(found, rigs.Truth(), recording)
    assert not ((np.abs(error) > 4 * found.standard_deviations) & found.well).any()
