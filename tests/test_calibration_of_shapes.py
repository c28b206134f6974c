"""Tapered and curved rods are found by touches of a sphere, which DOP853 integrates from the contact back to the clamp."""

import numpy as np
import pytest

import scan3d
from scan3d.calibration import fit
from scan3d.calibration.report import read_rig, write_rig
from scan3d.errors import InputError
from scan3d.spatial import inverse
from tests import rigs
from tests.shaped_rigs import Shaped, recorded


def found_of(rod, seed=0, **more):
    recording = recorded(rod, seed, **more)
    return recording, scan3d.calibrate(recording, sphere=rigs.DIAMETER)


def shape_errors(found, rod):
    """Errors of the tip's diameter over the clamp's and of both curvatures in the inverse of rod lengths, and deviations."""
    rows = [found.names.index(name) for name in ("tip_diameter_ratio", "curvature_z_per_m", "curvature_x_per_m")]
    units = np.array([1.0, rod.length, rod.length])
    return found.values[rows] * units - [rod.tip, *rod.curvature], found.standard_deviations[rows] * units


def off_sphere(recording, found, rod):
    """Distances of contacts from the true sphere, in rod lengths."""
    corrected = found.applied(recording)
    force, moment = corrected.reactions(True)
    contacts = inverse.reconstruct(force, moment, tolerance=0.1, rod=corrected.rod.in_space())
    known = (contacts.status == inverse.Status.OK) & (np.linalg.norm(force, axis=1) > 0.3)
    place = corrected.position_m + corrected.rod.length_m * np.einsum("nji,nj->ni", corrected.axes(), contacts.point)
    radius = (rigs.DIAMETER + rigs.ROD.diameter_m) / 2
    return np.abs(np.linalg.norm(place[known] - rigs.CENTRE, axis=1) - radius) / rod.length


@pytest.mark.slow
def test_a_tapered_and_curved_rod_is_found(tmp_path):
    rod = Shaped(tip=0.7, curvature=(-0.1, 0.05), noise=5e-4)
    recording, found = found_of(rod, sweeps=8, samples=20)
    error, deviation = shape_errors(found, rod)
    assert np.abs(error[0]) < 0.03 * rod.tip
    assert np.abs(error[1:]).max() < 0.02
    assert (np.abs(error) < 4 * deviation).all()
    assert np.median(off_sphere(recording, found, rod)) < 0.002
    write_rig(found, tmp_path / "rig.toml")
    again = read_rig(tmp_path / "rig.toml")
    assert again.rod == found.rod
    assert again.uncertainty() == found.uncertainty()
    assert {"tip_diameter_relative", "curvature_z_per_m", "curvature_x_per_m"} <= set(found.uncertainty().names)


@pytest.mark.slow
def test_a_straight_rod_is_not_given_a_shape():
    found = found_of(Shaped(), sweeps=20, samples=40)[1]
    assert not found.rod.varies
    assert not any(found.rod.curvatures)
    assert "tip_diameter_ratio" not in found.names


def test_no_shape_is_sought_where_touches_are_too_light_for_any_rod(monkeypatch):
    sought = []
    monkeypatch.setattr(fit, "_shaped", lambda *given: sought.append(given))
    with pytest.raises(InputError, match="touch it too lightly"):
        found_of(Shaped(noise=0.02), sweeps=12, samples=24)
    assert not sought


@pytest.mark.trust
@pytest.mark.parametrize(
    ("tip", "curvature"), [(0.4, (-0.3, 0)), (0.5, (0, 0)), (1.0, (0, 0.2)), (0.7, (-0.1, 0.05)), (0.6, (0.15, -0.1))]
)
def test_shapes_hold_within_their_intervals(tip, curvature):
    rod, scaled = Shaped(tip=tip, curvature=curvature), []
    for seed in range(5):
        recording, found = found_of(rod, seed)
        error, deviation = shape_errors(found, rod)
        scaled.append(error / deviation)
        assert np.abs(error[0]) < 0.03 * rod.tip
        assert np.abs(error[1:]).max() < 0.02
        assert np.median(off_sphere(recording, found, rod)) < 0.002
    assert (np.abs(scaled) < 2).mean() > 0.8
