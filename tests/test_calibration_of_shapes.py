"""Tapered and curved rods are found by touches of a sphere, which DOP853 integrates from the contact back to the clamp."""

from dataclasses import dataclass

import numpy as np
import pytest
import scipy
from scipy.spatial.transform import Rotation

import scan3d
from scan3d.calibration import fit
from scan3d.calibration.model import Kind, Rig, Touches, contacts, equations
from scan3d.calibration.references import Sphere
from scan3d.calibration.report import _rod, read_rig, write_rig
from scan3d.errors import InputError
from scan3d.rods import Rod
from scan3d.spatial import inverse
from tests import rigs
from tests.rigs import CENTRE, DIAMETER, ROD, Truth, logged


@dataclass(frozen=True)
class Shaped(Truth):
    tip: float = 1.0
    curvature: tuple = (0.0, 0.0)
    """About the clamp's z and x axes, in the inverse of rod lengths."""


def shot(rod, s1, force, torsion=1 / 1.3):
    """Clamps of rods (n,) that touch in the origin with the axes as d1, d2, d3, under forces (n, 3): places (n, 3),
    axes (n, 3, 3) as columns, and force and moment (n, 3) in these axes."""
    n, curvature = len(s1), np.array([*rod.curvature, 0.0])

    def rates(part, values):
        values = values.reshape(n, 15)
        frame, moment = values[:, 3:12].reshape(n, 3, 3), values[:, 12:]
        s = s1 * (1 - part)
        stiffness = (1 + (rod.tip - 1) * s)[:, None] ** 4 * [1.0, 1.0, torsion]
        bend = np.einsum("nij,nj->ni", frame, np.einsum("nji,nj->ni", frame, moment) / stiffness + curvature)
        change = np.concatenate(
            [frame[:, :, 2], np.cross(bend[:, None], frame.swapaxes(1, 2)).swapaxes(1, 2).reshape(n, 9),
             -np.cross(frame[:, :, 2], force)], axis=1
        )  # fmt: skip
        return (-s1[:, None] * change).ravel()

    start = np.tile(np.concatenate([np.zeros(3), np.eye(3).ravel(), np.zeros(3)]), (n, 1))
    ends = scipy.integrate.solve_ivp(rates, (0, 1), start.ravel(), method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    ends = ends.reshape(n, 15)
    frame = ends[:, 3:12].reshape(n, 3, 3)
    # the clamp's axes x, y, z are d2, d3, d1
    axes = frame[:, :, [1, 2, 0]]
    return ends[:, :3], axes, *(np.einsum("nji,nj->ni", axes, -vector) for vector in (force, ends[:, 12:]))


def recorded(rod, seed=0, *, sweeps=30, samples=60, friction=0.2, nominal=ROD):
    """The recording of a rig with the rod, as it logs without knowing of its faults, and the true contacts on the sphere."""
    rng = np.random.default_rng(seed)
    n, touching = sweeps * samples, np.arange(sweeps * samples) % samples >= samples // 4
    along = np.clip((np.arange(n) % samples - samples // 4) / (samples - samples // 4), 0, 1)
    number = np.arange(n) // samples

    def each(low, high):
        return rng.uniform(low, high, sweeps)[number]

    is_tip = (number % 3 == 0) & (along > 0.5)
    s1 = np.where(is_tip, 1.0, np.clip(each(0.5, 0.8) + each(0.05, 0.35) * along, 0, 0.999))
    # forces of the size that bends such a rod by some tenths of a radian
    strength = along * each(0.4, 1.4) * (1 + (rod.tip - 1) * s1) ** 2 / s1**2
    about, slip = each(0, 2 * np.pi) + 0.5 * along, each(0, 2 * np.pi)
    normal = np.stack([np.cos(about), np.sin(about), 0 * about], axis=1)
    lift = np.where(is_tip, each(0.1, 0.5) * (along - 0.5), 0.0)[:, None]  # at the tip the rod is not tangent
    normal = np.cos(lift) * normal + np.sin(lift) * [0, 0, 1.0]
    across = np.cross(normal, [0, 0, 1.0])
    side = np.cos(slip)[:, None] * across + np.sin(slip)[:, None] * np.cross(normal, across)
    force = strength[:, None] * (normal + friction * side)
    place, axes, reaction, moment = shot(rod, s1, force)
    # all clamps of a sweep are turned alike; the sphere lies below the contact
    turn = Rotation.random(sweeps, random_state=rng).as_matrix()[number]
    turn = turn @ axes.swapaxes(1, 2)
    radius = (DIAMETER + nominal.diameter_m * (1 + (rod.tip - 1) * s1))[:, None] / 2 / rod.length
    clamp = np.einsum("nij,nj->ni", turn, place + radius * normal) * rod.length + CENTRE
    world = turn @ axes
    unit = rod.stiffness / rod.length**2
    force, moment = reaction * unit * touching[:, None], moment * unit * rod.length * touching[:, None]
    return logged(rod, number, clamp, world.swapaxes(1, 2), force, moment, rng, rod=nominal)


def found_of(rod, seed=0, **more):
    recording = recorded(rod, seed, **more)
    return recording, scan3d.calibrate(recording, rigs.DIAMETER)


def shape_errors(found, rod):
    """Errors of the tip's diameter over the clamp's and of both curvatures in the inverse of rod lengths, and deviations."""
    rows = [found.names.index(name) for name in ("tip_diameter_ratio", "curvature_z_per_m", "curvature_x_per_m")]
    units = np.array([1.0, rod.length, rod.length])
    return found.values[rows] * units - [rod.tip, *rod.curvature], found.standard_deviations[rows] * units


def off_sphere(recording, rig, rod):
    """Distances of contacts from the true sphere, in rod lengths."""
    corrected = rig.applied(recording)
    force, moment = corrected.reactions(True)
    found = inverse.reconstruct(force, moment, tolerance=0.1, rod=corrected.rod.in_space())
    known = (found.status == inverse.Status.OK) & (np.linalg.norm(force, axis=1) > 0.3)
    place = corrected.position_m + corrected.rod.length_m * np.einsum("nji,nj->ni", corrected.axes(), found.point)
    radius = rigs.DIAMETER / 2 + rigs.ROD.diameter_m / 2 * corrected.rod.profile.diameter(found.s1[known])
    return np.abs(np.linalg.norm(place[known] - rigs.CENTRE, axis=1) - radius) / rod.length


def at_sphere(nominal, stiffness, force, moment, position, axes):
    """The rig of a nominal rod with a sphere in the origin, and touches (n,) of it."""
    zero, one, n = np.zeros(3), np.eye(3), len(force)
    of = Sphere.of(DIAMETER, nominal)
    rig = Rig(stiffness, zero, np.zeros(2), one, zero, of, 1.0, np.zeros((6, 1)), np.zeros(6), np.zeros((6, 6)),
              nominal.in_space(), zero, True)  # fmt: skip
    wrench, number = np.hstack([force, moment]), np.arange(n)
    kind = np.full(n, Kind.TANGENTIAL, dtype=np.int8)
    return rig, Touches(wrench, position, axes, np.zeros((n, 1)), number, number, wrench, kind)


def test_a_cone_touches_at_its_radius_there():
    """The radius at the clamp was taken along the whole rod."""
    rod, nominal = Shaped(tip=0.5), Rod(0.06, 1.9e-4, 0.003, tip_diameter_m=0.0015)
    s1, normal = np.array([0.4, 0.6, 0.8, 0.95]), np.tile([1.0, 0, 0], (4, 1))
    force = (0.6 / s1**2 * (1 - 0.5 * s1) ** 2)[:, None] * normal
    place, axes, reaction, moment = shot(rod, s1, force)
    away = (DIAMETER / 2 + nominal.radius_m(s1))[:, None] / nominal.length_m * normal
    found = equations(*at_sphere(nominal, 0.0, reaction, moment, place + away, axes))
    assert np.abs(found.value).max() < 1e-7


def test_the_clamp_of_a_calibration_gives_as_that_of_its_fit():
    """With another stiffness than the nominal one contacts were 3 mm apart."""
    nominal = Rod(0.1, 1e-3, clamp_compliance_rad_per_Nm=20.0)
    force, moment = np.array([[-1.5, -0.3, 0.0]]), np.array([[0.0, 0.0, 0.9]])
    rig, touches = at_sphere(nominal, np.log(1.3), force, moment, np.zeros((1, 3)), np.eye(3)[None])
    rod = _rod(nominal, rig)
    force, moment = (
        force * nominal.force_unit_N / rod.force_unit_N,
        moment * nominal.moment_unit_Nm / rod.moment_unit_Nm,
    )
    found = inverse.reconstruct(force, moment, rod=rod.in_space())
    np.testing.assert_allclose(found.point * rod.length_m, contacts(rig, touches)[0] * 0.1, atol=1e-8)


@pytest.mark.slow
def test_a_tapered_and_curved_rod_is_found(tmp_path):
    rod = Shaped(tip=0.7, curvature=(-0.1, 0.05), noise=5e-4)
    recording = recorded(rod, sweeps=8, samples=20)
    # so few rows do not tell a shape from gains of half a per cent
    found = scan3d.calibrate(recording, rigs.DIAMETER, accuracy=1e-3)
    error, deviation = shape_errors(found, rod)
    assert np.abs(error[0]) < 0.03 * rod.tip
    assert np.abs(error[1:]).max() < 0.02
    assert (np.abs(error) < 4 * deviation).all()
    assert np.median(off_sphere(recording, found, rod)) < 0.002
    write_rig(found, tmp_path / "rig.toml")
    again = read_rig(tmp_path / "rig.toml")
    assert again.rod == found.rod
    # lengths are written in millimetres
    one, other = again.uncertainty(), found.uncertainty()
    assert (one.names, one.exact) == (other.names, other.exact)
    assert one.sensor == pytest.approx(other.sensor, rel=1e-14)
    for name in ("covariance", "gains"):
        written, known = getattr(one, name), getattr(other, name)
        np.testing.assert_allclose(written, known, rtol=1e-12, atol=1e-14 * np.abs(known).max())
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
