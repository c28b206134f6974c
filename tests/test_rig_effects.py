"""What an uncertain calibration does to contacts and bounds: by finite changes of the rig, and by bodies that are known."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import planar
import scan3d
from scan3d.bounds import allowed, certificate, enclosure, sigmas
from scan3d.reconstruction import checked
from scan3d.reconstruction.contacts import contacts
from scan3d.reconstruction.errors import effects, torsion_sd, with_rig_errors
from scan3d.rigs import GAINS, RIG_QUANTITIES, RigUncertainty
from tests.rig_errors import SENSOR, displaced, typical
from tests.rigs import in_world
from tests.robustness.bounds import false_bounds
from tests.sample_bodies import MESHES
from tests.spatial_scans import recorded

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def egg():
    return scan3d.load_mesh(MESHES / "egg.stl")


@pytest.fixture(scope="module")
def flat(egg):
    recording = scan3d.simulate(egg, scan3d.Plan(slices=16, friction=0.3, samples=24))
    return dataclasses.replace(recording, table_m=egg.bounds[0, 2] / 1000)


@pytest.fixture(scope="module")
def space():
    return recorded(0.3, directions=6, heights=7, samples=40)[0]


def with_rig(recording, rig, seed=None):
    """The recording with an uncertain rig, and, for a seed, with an error that is drawn from its covariance."""
    components = rig.components()
    drawn = 0.0 if seed is None else np.random.default_rng(seed).normal(size=components.shape[1])
    return dataclasses.replace(displaced(recording, components @ (drawn + np.zeros(components.shape[1]))), rig=rig)


def one_off(recording, rig, k):
    return displaced(recording, rig.components()[:, k], rig.sensor)


def touched(recording, model="planar"):
    """Contacts, in slices without the smooth body that is fitted to them, which the bounds do not use."""
    if model == "spatial" or recording.six_axis:
        return scan3d.reconstruct(recording)
    return with_rig_errors(contacts(recording), recording)


def without(cloud):
    return dataclasses.replace(cloud, calibration=None)


OF_SHAPE = {"tip_diameter_relative": 1e-3**2, "curvature_z_per_m": 0.02**2, "curvature_x_per_m": 0.02**2}
"""Variances, about those of a calibration of the rod's shape."""
QUICK = {
    "planar": ("stiffness_relative", "clamp_turn_z_rad", "sensor_z_m"),
    "spatial": ("sensor_y_m", "sensor_turn_y_rad", "gain_mx"),
}


@pytest.mark.parametrize(
    ("model", "name"),
    [
        (model, name) if name in QUICK[model] else pytest.param(model, name, marks=pytest.mark.trust)
        for model in ("planar", "spatial")
        for name in RIG_QUANTITIES + GAINS
        # a length moves contacts to the tip only, a weight needs gravity, and a rod curved about x leaves the plane
        if name not in ("length_relative", "weight_N") and (model, name) != ("planar", "curvature_x_per_m")
    ],
)
def test_contacts_move_as_predicted(request, model, name):
    """One quantity at a time, by one standard deviation: contacts of the rig that is off, less those of the rig as it is."""
    recording = request.getfixturevalue("flat" if model == "planar" else "space")
    of_gain = name in GAINS
    if of_gain:
        rig = RigUncertainty((), [], gains=np.diag(5e-3**2 * (np.array(GAINS) == name)), sensor=SENSOR)
    else:
        variances = dict(zip(typical().names, np.diag(typical().covariance), strict=True)) | OF_SHAPE
        rig = RigUncertainty((name,), [[variances[name]]])
    stated = dataclasses.replace(recording, rig=rig)
    before = touched(recording, model=model)
    moved = touched(one_off(recording, rig, 0), model=model)
    _, one, other = np.intersect1d(before.row, moved.row, return_indices=True)
    assert len(one) > 0.9 * len(before)  # contacts of the tip may lie past it by the other rig
    predicted = before.rod_length * effects(stated, before.row[one], model).place[:, :, 0]
    places = [cloud.points if cloud.centre_points is None else cloud.centre_points for cloud in (before, moved)]
    difference = places[1][other] - places[0][one]
    size = np.linalg.norm(predicted, axis=1).max()
    three_channels = model == "planar" and name in ("sensor_z_m", "sensor_turn_x_rad", "sensor_turn_y_rad")
    assert (size == 0) == three_channels
    # what is left is of the second order, and larger where the rod is about to leave the body
    assert np.percentile(np.linalg.norm(difference - predicted, axis=1), 99) <= 0.02 * size + 2e-4
    cloud = touched(stated, model=model)
    found = cloud.calibration.place_sd[np.isin(cloud.row, before.row[one])]
    assert found.max() == pytest.approx(size, rel=1e-6)


def test_the_length_moves_contacts_to_the_tip_only(flat):
    rig = RigUncertainty(("length_relative",), [[1e-6]])
    cloud = touched(dataclasses.replace(flat, rig=rig))
    assert cloud.calibration.place_sd.max() == 0
    exact = touched(flat)
    assert (cloud.phase == planar.Phase.TIP).sum() > (exact.phase == planar.Phase.TIP).sum()
    # a rod that is stated too long makes tip contacts tangential, unless the uncertainty of the length is known
    longer = displaced(flat, 2e-3 * np.eye(24)[1])
    tips = exact.row[exact.phase == planar.Phase.TIP]
    for uncertain, right in ((None, False), (rig, True)):
        found = touched(dataclasses.replace(longer, rig=uncertain))
        still = np.isin(found.row[found.phase == planar.Phase.TIP], tips).sum() == np.isin(found.row, tips).sum() > 0
        assert still == right


def test_a_rig_without_errors_moves_nothing(flat):
    exact = dataclasses.replace(flat, rig=RigUncertainty(("clamp_x_m",), np.zeros((1, 1))))
    assert effects(exact, np.arange(3), "planar").place.shape == (3, 3, 0)
    assert np.array_equal(
        scan3d.reconstruct(exact).points, scan3d.reconstruct(dataclasses.replace(flat, rig=None)).points
    )


@pytest.mark.parametrize("model", ["planar", "spatial"])
def test_a_turned_and_scaled_world_changes_nothing(request, model):
    recording = request.getfixturevalue("flat" if model == "planar" else "space")
    recording = dataclasses.replace(recording, rig=typical(six=model == "spatial"), table_m=None)
    turned = in_world(
        dataclasses.replace(recording, unit="m"), Rotation.from_rotvec([0.3, -1.1, 0.7]), (0.2, -0.1, 0.3)
    )
    one, other = (touched(part, model=model).calibration for part in (recording, turned))
    for name, unit in (("place_sd", 1e-3), ("across_sd", 1e-3), ("height_sd", 1e-3), ("turn_sd", 1), ("tilt_sd", 1)):
        expected = unit * getattr(one, name)
        np.testing.assert_allclose(getattr(other, name), expected, rtol=1e-4, atol=1e-6 * expected.max())


def test_the_bound_allows_for_the_calibration(flat, egg):
    """A seed in which the bound without the term holds as well, and one in which it is too small."""
    too_small = 0
    for seed in (0, 5):
        cloud = touched(with_rig(flat, typical(3.0, six=False), seed))
        for part in (cloud, without(cloud)):
            bounds = enclosure(part)
            holds = scan3d.compare(bounds.inner, egg).hausdorff <= bounds.bound
            assert holds or part.calibration is None
            too_small += not holds
            if part.calibration is not None:
                assert bounds.confidence == 0.95
                assert false_bounds(egg, bounds) == []
    assert too_small >= 1


def test_noise_and_calibration_share_the_probability(flat):
    noisy = dataclasses.replace(flat, noise_force_N=1e-7, noise_moment_Nm=1e-9)
    cloud = touched(dataclasses.replace(noisy, rig=typical(six=False)))
    allow = allowed(cloud)
    assert allow.kappa == pytest.approx(sigmas(len(cloud), 0.96), rel=1e-12)
    assert allow.factor == pytest.approx(cloud.calibration.factor(0.01), rel=1e-12)
    assert allowed(without(cloud)).kappa == sigmas(len(cloud))
    assert enclosure(cloud).bound > enclosure(without(cloud)).bound


def test_the_spatial_bound_allows_for_the_calibration(space):
    cloud = touched(dataclasses.replace(space, rig=typical(0.05)))
    better = touched(dataclasses.replace(space, rig=typical(0.005)))
    bounds, smaller = enclosure(cloud), enclosure(better)
    assert enclosure(without(cloud)).confidence == 1
    assert bounds.confidence == smaller.confidence == 0.95
    factor = cloud.calibration.factor(0.05)
    assert bounds.margin > 0.3 * factor * cloud.calibration.place_sd.max()
    assert bounds.bound > smaller.bound + 0.3 * factor * cloud.calibration.place_sd.max()
    hull = scan3d.surface(cloud, "hull")
    assert certificate(bounds, hull).bound > certificate(smaller, hull).bound


def test_errors_of_the_calibration_are_no_contradiction(flat, space, undiagnosed):
    """Exact touches of a rig that is off by what is stated: without the statement they contradict the convex body."""
    found = with_rig(flat, typical(six=False), 1)
    cloud = touched(found)
    assert "beyond-tangent" in {warning.code for warning in checked(found, without(cloud)).contradictions}
    assert not checked(found, cloud).contradictions
    found = with_rig(space, typical(), 1)
    cloud = touched(found)
    assert "moment-about-rod" in {warning.code for warning in checked(found, without(cloud)).contradictions}
    assert not checked(found, cloud).contradictions


@pytest.mark.parametrize("rig", [typical(), RigUncertainty((), [], gains=1e-4 * np.eye(6), sensor=SENSOR)])
def test_torsion_is_that_of_finite_changes(space, rig):
    stated = dataclasses.replace(space, rig=rig)
    rows = np.flatnonzero(np.linalg.norm(space.wrench()[0], axis=1) > 0)
    moved = [one_off(space, rig, k).wrench()[1][rows, 1] for k in range(rig.components().shape[1])]
    changes = (np.array(moved) - space.wrench()[1][rows, 1]) / space.rod.moment_unit_Nm
    np.testing.assert_allclose(torsion_sd(stated, rows), np.linalg.norm(changes, axis=0), rtol=0.02, atol=1e-6)
