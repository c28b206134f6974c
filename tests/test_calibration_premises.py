"""Calibration on touches that the model does not fit: nothing wrong is called well determined, and the cause is named."""

import dataclasses

import numpy as np
import pytest
from scipy.signal import lfilter

import scan3d
from scan3d.laboratory.calibration_air import Unloaded
from scan3d.laboratory.calibration_colour import WHITE, Colour, colour, summed
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
    # without tip contacts the length stays at its nominal value, whatever an earlier round has taken for the tip
    assert found.rod.length_m == 0.06 or np.isfinite(found.standard_deviations[found.names.index("length_m")])
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


def in_the_air(noise, sweeps=30):
    """Rows of noise (n, 6) in the air at the ends of sweeps, with a tare for each sweep taken off, as `unloaded` finds them."""
    number = np.repeat(np.arange(sweeps), len(noise) // sweeps)
    place = np.arange(len(noise)) % (len(noise) // sweeps)
    air = (place < 30) | (place >= len(noise) // sweeps - 30)
    basis = np.asarray(number[:, None] == np.unique(number), dtype=float)
    tare = np.linalg.lstsq(basis[air], noise[air], rcond=None)[0].T
    return Unloaded(air, ~air, 1.0, 1.0, basis, tare, "sweep", 1.0)


@pytest.mark.parametrize(("keep", "name"), [(0.0, "white"), (0.5, "low-pass"), (0.8, "low-pass")])
def test_the_colour_of_noise_is_found_in_the_air(keep, name):
    shocks = np.random.default_rng(4).normal(size=(3700, 6))
    noise = lfilter([np.sqrt(1 - keep**2)], [1, -keep], shocks, axis=0)[100:]
    found = in_the_air(noise)
    for part in (slice(0, 3), slice(3, 6)):
        result = colour(noise, found, np.ones(6, dtype=bool), part, 1.0)
        if name == "white":
            assert result is WHITE
        else:
            # noise that is alike over a whole sweep is the tare's: only differences of rows are determined
            differences = [result.at(0) - result.at(lag) for lag in (1, 2, 4)]
            assert differences == pytest.approx([1 - keep**lag for lag in (1, 2, 4)], abs=0.08)


def test_sums_of_coloured_noise_have_the_stated_covariance():
    rng = np.random.default_rng(1)
    shape = Colour(np.array([0.0, 0.6, 0.95]), np.array([0.5, 0.3, 0.2]))
    values = rng.normal(size=(200, 3))
    lag = np.abs(np.arange(200)[:, None] - np.arange(200))
    dense = np.array([shape.at(k) for k in range(200)])[lag]
    assert np.allclose(summed(values, shape), values.T @ dense @ values)


@pytest.mark.slow
def test_the_stated_intervals_hold_for_1_f_noise():
    """Half of the noise's variance is 1/f: errors are as stated, and none of the deviations counts as systematic."""
    deviations = []
    for seed in range(300, 308):
        recording = rigs.recorded(seed=seed, pink=0.5, stated=False)
        found = scan3d.calibrate(recording, rigs.DIAMETER)
        assert found.details["noise_colour"] == "coloured"
        assert not any("noise does not explain" in sentence for sentence in found.sentences)
        names = tuple(np.array(found.names)[of_rig(found)])
        true = rigs.truth_of(dataclasses.replace(found, names=names), rigs.Truth(), recording)
        deviations.append((found.values[of_rig(found)] - true) / found.standard_deviations[of_rig(found)])
    assert (np.abs(deviations) < 1.96).mean() > 0.85
    assert np.abs(deviations).max() < 4.5


def test_good_touches_have_no_sentence_on_deviations():
    for seed in range(400, 405):
        assert scan3d.calibrate(rigs.recorded(seed=seed), rigs.DIAMETER).sentences == ()
