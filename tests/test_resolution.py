"""The resolution of recorded numbers: decimal digits, single precision, steps of a converter, full precision."""

import dataclasses

import numpy as np
import pytest

import planar
import scan3d
from scan3d.pipeline import analyse
from scan3d.reconstruction.contacts import contacts
from scan3d.recording import rounding_sd
from tests.robustness import bounds
from tests.sample_bodies import MESHES

EGG = MESHES / "egg.stl"


def rounded(values, digits):
    return np.vectorize(lambda value: float(f"{value:.{digits - 1}e}"))(values)


@pytest.fixture(scope="module")
def values():
    rng = np.random.default_rng(0)
    return rng.standard_normal(5000) * 10.0 ** rng.uniform(-3, 0, 5000)


@pytest.fixture(scope="module")
def recording():
    return scan3d.simulate(scan3d.load_mesh(EGG), scan3d.Plan(slices=8, samples=60, friction=0.3))


@pytest.mark.parametrize("digits", [3, 8, 12])
def test_digits_of_a_log(values, digits):
    largest = np.abs(values).max()
    assert rounding_sd(rounded(values, digits)) == pytest.approx(
        10.0 ** (np.floor(np.log10(largest)) + 1 - digits) / 12**0.5
    )


def test_single_precision(values):
    largest = np.float32(np.abs(values).max())
    assert rounding_sd(values.astype(np.float32).astype(float)) == pytest.approx(float(np.spacing(largest)) / 12**0.5)
    assert rounding_sd(values.astype(np.float32)) == pytest.approx(float(np.spacing(largest)) / 12**0.5)


@pytest.mark.parametrize("step", [0.0123456789, 2.0**-9 * np.pi])
def test_steps_of_a_converter(values, step):
    assert rounding_sd(np.round(values / step) * step) == pytest.approx(step / 12**0.5)
    # numbers that skip steps
    few = np.repeat(np.unique(np.round(values[:200] / step)) * 3 * step, 3)
    assert rounding_sd(few) == pytest.approx(3 * step / 12**0.5)


def test_full_precision_and_empty_columns_have_no_rounding(values):
    assert rounding_sd(values) == 0
    assert rounding_sd(np.repeat(values[:100], 50)) == 0  # a symmetric scan repeats its numbers
    assert rounding_sd(np.zeros(10)) == 0
    assert rounding_sd(np.array([0.5])) == 0
    step = np.pi / 2**23  # none of the gaps between 100 numbers of 24 bits is a few steps wide
    fine = np.round(np.random.default_rng(2).uniform(-3, 3, 100) / step) * step
    assert rounding_sd(fine) == pytest.approx(step / 12**0.5)


@pytest.mark.parametrize("digits", [9, 7])
def test_a_log_with_few_digits_keeps_its_contacts(recording, digits):
    """Without an estimate of the digits, tip contacts were lost, 60, 38, 4, 0, and friction read down to 0.12 for 0.3."""
    exact = contacts(recording)
    log = bounds.rounded(recording, str(digits))
    cloud = contacts(log)
    assert len(cloud) + cloud.light == len(exact)
    assert np.isin(exact.row[exact.phase == planar.Phase.TIP], cloud.row[cloud.phase == planar.Phase.TIP]).all()
    tangential = cloud.phase == planar.Phase.TANGENTIAL
    assert np.abs(cloud.friction[tangential] - 0.3).max() < 1e-3
    assert cloud.noise > 0
    noise = log.noise
    assert noise.force_N > 0
    assert noise.moment_Nm > 0
    assert 0 < cloud.pose_error < 1e-3


@pytest.mark.parametrize("ratio", [0.2, 1.0, 5.0])
def test_rounding_adds_to_the_stated_noise(recording, ratio):
    """The larger of the two counted, and left out up to 30 % of the error where they are about equal."""
    step = 2.0**-12 * recording.rod.force_unit_N
    noise = ratio * step / 12**0.5
    rng = np.random.default_rng(1)
    noisy = recording.force_N + noise * rng.standard_normal(recording.force_N.shape)
    log = dataclasses.replace(recording, force_N=step * np.round(noisy / step), noise_force_N=noise)
    error = (log.force_N - recording.force_N)[np.hypot(*recording.force_N.T) > 0]
    assert log.noise.force_N == pytest.approx(error.std(), rel=0.03)
    # errors of rounding repeat from row to row unless the noise is larger than half a step
    assert log.noise.independent == (ratio > 3**0.5)


def test_round_positions_of_a_plan_are_exact(recording):
    """Positions in whole tenths of a millimetre are those of a plan; their digits are no errors."""
    planned = dataclasses.replace(recording, position_m=np.round(recording.position_m, 4))
    assert planned.noise.place_m == 0
    logged = dataclasses.replace(recording, position_m=np.round(recording.position_m, 8))
    assert 1e-9 < logged.noise.place_m < 1e-7


@pytest.mark.slow
@pytest.mark.parametrize("digits", [5, *(pytest.param(k, marks=pytest.mark.trust) for k in (6, 7))])
def test_the_certificate_allows_for_the_digits(recording, digits):
    mesh = scan3d.load_mesh(EGG)
    log = bounds.rounded(recording, str(digits))
    analysis = analyse(log, mesh, "hull")
    assert analysis.warnings == ()
    assert analysis.comparison.hausdorff <= analysis.certificate.bound
    assert analysis.certificate.bound < 1.2 * analyse(recording, mesh, "hull").certificate.bound
