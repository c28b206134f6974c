"""Recordings of a laboratory's rig that touches a reference sphere, with the faults of a good rig.

The sweeps are computed once, by `scan3d.spatial.sweeping`; each seed adds faults to them: a sensor that is turned, displaced
and biased and that drifts, a clamp that is not where the pose says, white noise, and poses that jitter.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

import planar
import scan3d
from scan3d.planning.rig import RigPlan, parse_envelope, plan_poses
from scan3d.simulation.rig import pink_noise, simulate_rig, standing
from scan3d.spatial.bodies import Ellipsoid, RoundedPolyhedron
from scan3d.spatial.sweeping import sweep

ROD = scan3d.Rod(0.06, 1.9e-4, 0.0003)
DIAMETER = 0.030
CENTRE = np.array([0.41, -0.12, 0.23])
# A file of all faults that `scan3d.simulation.rig` knows.
FAULTS = """\
seed = 3
rate_hz = 40
[sensor]
position_mm = [0, -20, 0]
euler_deg = [0, 30, 0]
shows = "rod-on-clamp"
nominal = {position_mm = [0, -19, 0]}
[bias]
fraction = 0.05
[drift]
kind = "random-walk"
fraction = 0.01
[noise]
fraction = 0.002
pink_force_N = 0.001
[quantisation]
force_N = 1e-4
position_um = 1
[lag]
ms = 5
[pose]
jitter_um = 20
clock_ms = -2
[rod]
length_error = 0.001
stiffness_error = -0.02
[missing]
fraction = 0.001
gap_ms = 50
"""
# Distances from the clamp to the sphere's centre along the rod, in rod lengths; the last two give tip contacts.
REACH = (0.7, 0.8, 0.9, 1.0, 1.08)


@dataclass(frozen=True)
class Truth:
    """The rig as it is; lengths in m, angles in degrees, tare and drift in fractions of the largest force and moment."""

    stiffness: float = 1.9e-4 * 1.04
    length: float = 0.06
    clamp: tuple = (0.0006, -0.0011, 0.0008)
    clamp_turn: tuple = (0.9, 0.0, -0.6)
    sensor: tuple = (0.004, -0.019, 0.005)
    sensor_turn: tuple = (12.0, 25.0, -10.0)
    centre: tuple = tuple(CENTRE)
    bias: tuple = (0.05, -0.04, 0.03, -0.05, 0.02, 0.04)
    drift: tuple = (0.01, 0.01, -0.01, -0.005, 0.01, -0.01)
    noise: float = 0.002
    jitter: float = 20e-6
    mixing: float = 0.0
    """Standard deviation of the sensor's gains and cross-talk, in fractions of the largest force and moment."""
    gains: tuple = (0.0,) * 6
    """By how much of itself each channel shows too little."""


EXACT = Truth(noise=0.0, jitter=0.0)


@cache
def orientations(sweeps=30, directions=6, rolls=5):
    """Axes (m, 3, 3) of clamps, as rows: the rod in several directions, and turned about its axis."""
    found = []
    for k in range(sweeps):
        azimuth, roll = 2 * np.pi * (k % directions) / directions, 2 * np.pi * (k // directions) / rolls + 0.4 * k
        tilt = np.radians([-75, -20, -50])[k % 3]
        turn = Rotation.from_euler("z", azimuth) * Rotation.from_euler("x", tilt) * Rotation.from_euler("y", roll)
        found.append(turn.as_matrix().T)
    return np.array(found)


@cache
def swept(samples=120, friction=0.2, sweeps=30, directions=6, rolls=5, reach=REACH, length=ROD.length_m, facets=None):
    """Exact sweeps of a rod about a sphere in the origin, dimensionless: positions (m, n, 3), axes (m, 3, 3), reactions.

    `facets` divides the edges of an icosahedron, which stands for the sphere, so many times into two.
    """
    axes = orientations(sweeps, directions, rolls)
    radius = DIAMETER / 2 / length
    numbers = np.arange(sweeps)
    away = np.array(reach)[(numbers + numbers // directions) % len(reach)]
    height = radius * np.array([0.0, 0.2, -0.3, 0.1, -0.2])[numbers % 5] + 0.02
    start = (radius + 0.12) * axes[:, 0] - away[:, None] * axes[:, 1] + height[:, None] * axes[:, 2]
    travel = (2 * radius + 0.5) * np.linspace(0, 1, samples)
    position = start[:, None] - travel[:, None] * axes[:, :1]
    body = Ellipsoid([radius] * 3, radius=ROD.diameter_m / 2 / length)
    if facets is not None:
        ball = trimesh.creation.icosphere(subdivisions=facets, radius=radius)
        body = RoundedPolyhedron(ball.vertices, ball.faces, ROD.diameter_m / 2 / length)
    return position, axes, *felt(body, position, axes, friction)


def felt(body, position, axes, friction):
    """Reactions (m, n, 3) of sweeps, zero in the air, and the sweeps themselves."""
    result = sweep(body, position, axes, friction, substeps=2)
    touching = np.isfinite(result.s1)[..., None]
    return np.where(touching, result.force, 0), np.where(touching, result.moment, 0), result


def with_wrench(recording, force, moment):
    """The recording with other reactions (n, 3); a planar one keeps its three channels."""
    six = dict(force_z_N=force[:, 2], moment_x_Nm=moment[:, 0], moment_y_Nm=moment[:, 1])
    return replace(recording, force_N=force[:, :2], moment_Nm=moment[:, 2], **(six if recording.six_axis else {}))


def six_axis_recording(rod, sweep, position, quaternion, force, moment, **more):
    """A recording of forces and moments (n, 3) at the clamp."""
    channels = dict(force_N=force[:, :2], force_z_N=force[:, 2], moment_Nm=moment[:, 2])
    channels |= dict(moment_x_Nm=moment[:, 0], moment_y_Nm=moment[:, 1])
    return scan3d.Recording(sweep=sweep, position_m=position, quaternion=quaternion, rod=rod, **channels, **more)


def in_world(recording, turn, shift=(0.0, 0.0, 0.0)):
    """The recording in a world in which everything is turned, and moved by a shift in metres."""
    quaternion = (turn * Rotation.from_quat(recording.quaternion, scalar_first=True)).as_quat(scalar_first=True)
    return replace(recording, position_m=turn.apply(recording.position_m) + shift, quaternion=quaternion)


def in_sensor(truth, force, moment):
    """Reactions (n, 3) at the clamp in the sensor's frame, whose axes are columns in the clamp's frame."""
    turn = Rotation.from_euler("xyz", truth.sensor_turn, degrees=True).as_matrix()
    return force @ turn, (moment - np.cross(truth.sensor, force)) @ turn


def largest(*reactions):
    """(6,) the largest force three times, and the largest moment."""
    return np.repeat([np.linalg.norm(column, axis=1).max() for column in reactions], 3)


def logged(truth, sweep, position, axes, force, moment, rng, *, rod=ROD, stated=True, pink=0.0, mixed=0.0):
    """What a rig logs without knowing of its faults, of clamps (n, 3) with the axes (n, 3, 3) as rows, and of reactions.

    `pink` is the fraction of its noise's variance with the spectrum 1/f, `mixed` (6, 6) the sensor's gains and cross-talk.
    """
    shown = in_sensor(truth, force, moment)
    size, wrench = largest(*shown), np.hstack(shown)
    wrench = wrench @ (np.eye(6) + truth.mixing * mixed * size[:, None] / size).T
    wrench = wrench / (1 + np.array(truth.gains))
    time = np.linspace(-0.5, 0.5, len(wrench))[:, None]
    noise = rng.normal(size=wrench.shape)
    if pink:
        coloured = np.stack([pink_noise(len(wrench), rng) for _ in range(6)], axis=1)
        noise = np.sqrt(1 - pink) * noise + np.sqrt(pink) * coloured
    wrench = wrench + size * (np.array(truth.bias) + time * truth.drift + truth.noise * noise)
    clamp = Rotation.from_euler("xyz", truth.clamp_turn, degrees=True).as_matrix()
    pose = np.einsum("nji,kj->nik", axes, clamp)  # columns: axes of the pose's frame in the world
    place = position - pose @ truth.clamp + truth.jitter * rng.normal(size=position.shape)
    quaternion = Rotation.from_matrix(pose).as_quat(scalar_first=True)
    force_sd, moment_sd = (stated * truth.noise * size[k] for k in (0, 3))
    known = dict(noise_force_N=force_sd, noise_moment_Nm=moment_sd)
    return six_axis_recording(rod, sweep, place, quaternion, wrench[:, :3], wrench[:, 3:], **known)


def recorded(truth=None, seed=0, *, stated=True, pink=0.0, motion=swept, **raster):
    """The recording of a rig; `motion` gives the exact sweeps."""
    truth = Truth() if truth is None else truth
    position, axes, force, moment, _ = motion(length=truth.length, **raster)
    m, n, _ = position.shape
    return logged(
        truth,
        np.repeat(np.arange(m), n),
        position.reshape(-1, 3) * truth.length + truth.centre,
        np.repeat(axes, n, axis=0),
        force.reshape(-1, 3) * truth.stiffness / truth.length**2,
        moment.reshape(-1, 3) * truth.stiffness / truth.length,
        np.random.default_rng(seed),
        stated=stated,
        pink=pink,
        mixed=np.random.default_rng([seed, 36]).normal(size=(6, 6)),
    )


def truth_of(calibration, truth, recording, *, motion=swept, reference=None, **raster):
    """The true values of the quantities of a calibration, by its names; those of the `reference` if it is no sphere."""
    _, _, force, moment, _ = motion(length=truth.length, **raster)
    force = force.reshape(-1, 3) * truth.stiffness / truth.length**2
    values = by_name(truth, force, moment.reshape(-1, 3) * truth.stiffness / truth.length) | (reference or {})
    return np.array([values[name] for name in calibration.names])


def by_name(truth, force, moment):
    """The true values of all quantities of a rig that touches a sphere with reactions (n, 3) at the clamp."""
    size = largest(*in_sensor(truth, force, moment))
    values = {"bending_stiffness_Nm2": truth.stiffness, "length_m": truth.length}
    for title, place in (("clamp", truth.clamp), ("sensor", truth.sensor), ("sphere", truth.centre)):
        values |= {f"{title}_{axis}_mm": 1000 * x for axis, x in zip("xyz", place, strict=True)}
    for title, turn in (("clamp", truth.clamp_turn), ("sensor", truth.sensor_turn)):
        values |= {f"{title}_turn_{axis}_deg": x for axis, x in zip("xyz", turn, strict=True)}
    for k, name in enumerate(("fx_N", "fy_N", "fz_N", "mx_Nm", "my_Nm", "mz_Nm")):
        values |= {f"tare_{name}": truth.bias[k] * size[k], f"drift_{name}": truth.drift[k] * size[k]}
    return values


STEADY = Truth(jitter=0.0, drift=(0.0,) * 6)


def planar_recorded(seed=0, *, noise=0.0, sweeps=16, samples=60, tip=True):
    """Three channels of a rod in a plane through the centre of a sphere: the recording, and the true values by name."""
    rod, radius, base = scan3d.Rod(0.06, 1.9e-4), DIAMETER / 2 / ROD.length_m, np.linspace(0.55, -0.15, samples)
    truth = replace(
        STEADY,
        stiffness=1.05 * rod.bending_stiffness_Nm2,
        clamp=(0.0007, -0.0009, 0.0),
        clamp_turn=(0.0, 0.0, 0.8),
        sensor=(0.003, -0.02, 0.0),
        sensor_turn=(0.0, 0.0, 20.0),
        bias=(0.03, 0.03, 0.0, 0.0, 0.0, -0.04),
        noise=noise,
    )
    reach = [((0.7, 0.85, 0.95, 1.1) if tip else (0.6, 0.7, 0.8, 0.85))[k % 4] for k in range(sweeps)]
    states = [planar.sweep(planar.Circle(radius, (0.0, away)), 0.2, base=base).reactions[1:] for away in reach]
    fx, fy, mz = np.nan_to_num(np.concatenate(states, axis=1))
    number, zero = np.repeat(np.arange(sweeps), samples), 0 * fx
    # every other clamp is turned by half a turn about the rod, which leaves the plane where it is
    pose = Rotation.from_euler("ZY", np.column_stack([2 * np.pi * number / sweeps, np.pi * (number % 2)]))
    place = np.column_stack([np.tile(base, sweeps), -np.repeat(reach, samples), zero])
    force = np.column_stack([fx, fy, zero]) * truth.stiffness / truth.length**2
    moment = np.column_stack([zero, zero, mz]) * truth.stiffness / truth.length
    axes = pose.as_matrix().swapaxes(1, 2)
    position = CENTRE + truth.length * pose.apply(place)
    recording = logged(truth, number, position, axes, force, moment, np.random.default_rng(seed), rod=rod)
    three = replace(recording, force_z_N=None, moment_x_Nm=None, moment_y_Nm=None)
    # how far the plane is from the sphere's centre enters by its square
    known = by_name(truth, force, moment).items()
    return three, {name: value for name, value in known if not name.endswith("_z_mm") and not name.startswith("sphere")}


@cache
def planar_model_log(samples=40, slices=5):
    """The exact log of the planar model past a sphere, slices from four sides, of a rod that is thinner than stated."""
    ball = standing(trimesh.creation.icosphere(subdivisions=5, radius=1000 * DIAMETER / 2))
    rod = scan3d.Rod(0.06, 8.35e-5, 0.0003)
    plan = RigPlan(parse_envelope("sphere:32"), model="planar", rod=rod, samples=samples, slices=slices)
    poses = replace(plan_poses(plan), rod=replace(rod, diameter_m=0.0))
    return replace(simulate_rig(ball, poses, friction=(0.2, 0.2)).recording(), rod=rod)


def planar_model_recorded():
    """That log as a sensor with six channels shows it: turned by 30 degrees, 20 mm away, biased, with noise."""
    log, none = planar_model_log(), (0.0, 0.0, 0.0)
    zero = np.zeros(len(log))
    force = np.nan_to_num(np.column_stack([log.force_N, zero]))
    moment = np.nan_to_num(np.column_stack([zero, zero, log.moment_Nm]))
    beside = dict(clamp=none, clamp_turn=none, sensor=(0.0, -0.02, 0.0), sensor_turn=(0.0, 30.0, 0.0), bias=(0.03,) * 6)
    truth = replace(STEADY, jitter=20e-6, **beside)
    return logged(truth, log.sweep, log.position_m, log.axes(), force, moment, np.random.default_rng(0), rod=log.rod)
