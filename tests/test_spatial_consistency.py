"""Six-axis recordings that contradict the model are remarked on, right ones are not, whatever their noise and digits."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from spatial_scans import recorded

import scan3d
from scan3d.errors import InputError
from scan3d.reconstruction import NoContactError, cause_of_no_contact, contradictions

RASTER = {"directions": 5, "heights": 6, "substeps": 2}


@pytest.fixture(scope="module")
def right():
    return recorded(0.3, **RASTER)[0]


def changed(recording, change):
    """The recording with force and moment (n, 3) changed by a function of both."""
    force, moment = change(*recording.wrench())
    return replace(
        recording,
        force_N=force[:, :2],
        force_z_N=force[:, 2],
        moment_x_Nm=moment[:, 0],
        moment_y_Nm=moment[:, 1],
        moment_Nm=moment[:, 2],
    )


def remarks(recording):
    try:
        cloud = scan3d.reconstruct(recording)
    except InputError:
        return ["no contact"]
    return [warning.code for warning in contradictions(recording, cloud)]


def misaligned(f, m):
    turn = Rotation.from_rotvec([0.03, 0.0, 0.02])
    return turn.apply(f), turn.apply(m)


def lever(f, m):
    """The sensor's origin lies 2 mm beside the clamp."""
    return f, m + np.cross([0.002, 0.0, 0.0], f)


FAULTS = {
    "signs of the wrench": lambda f, m: (-f, -m),
    "signs of the forces": lambda f, m: (-f, m),
    "sign of fx": lambda f, m: (f * [-1, 1, 1], m),
    "sign of fy": lambda f, m: (f * [1, -1, 1], m),
    "sign of fz": lambda f, m: (f * [1, 1, -1], m),
    "sign of mx": lambda f, m: (f, m * [-1, 1, 1]),
    "sign of mz": lambda f, m: (f, m * [1, 1, -1]),
    "left-handed": lambda f, m: (f * [1, 1, -1], m * [-1, -1, 1]),
    "N mm": lambda f, m: (f, 1000 * m),
    "mN": lambda f, m: (1000 * f, m),
    "fx and fz exchanged": lambda f, m: (f[:, ::-1], m),
    "axes y and z exchanged": lambda f, m: (f[:, [0, 2, 1]], m[:, [0, 2, 1]]),
    "untared": lambda f, m: (f + 0.01 * np.abs(f).max(), m + 0.01 * np.abs(m).max()),
    "misaligned": misaligned,
    "lever arm": lever,
    "late by two samples": lambda f, m: (np.roll(f, 2, axis=0), np.roll(m, 2, axis=0)),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_wrong_recordings_are_remarked_on(right, fault):
    assert remarks(changed(right, FAULTS[fault]))


def test_a_rod_of_another_stiffness_is_remarked_on(right):
    assert remarks(replace(right, rod=scan3d.Rod(right.rod.length_m, 0.8 * right.rod.bending_stiffness_Nm2)))


@pytest.mark.parametrize(
    ("fault", "cause"),
    [
        ("signs of the wrench", "the wrench has the opposite sign"),
        ("sign of fz", "fz has the opposite sign"),
        ("sign of mx", "mx has the opposite sign"),
        ("N mm", "the moments are in N mm"),
        ("mN", "the forces are in mN"),
        ("untared", "were not tared"),
    ],
)
def test_the_likeliest_cause_is_named(right, fault, cause):
    wrong = changed(right, FAULTS[fault])
    try:
        messages = [warning.message for warning in contradictions(wrong, scan3d.reconstruct(wrong))]
    except NoContactError:
        messages = [cause_of_no_contact(wrong)]
    assert any(cause in message for message in messages), messages


@pytest.mark.parametrize("noise", [(0.0, 0.0), (1e-5, 1e-5), (1e-3, 1e-3), (1e-2, 1e-3), (1e-4, 1e-2)])
@pytest.mark.parametrize("friction", [0.0, (0.0, 0.4)])
def test_right_recordings_are_not_remarked_on(noise, friction):
    for seed in range(3):
        assert remarks(recorded(friction, noise=noise, diameter=0.01, seed=seed, **RASTER)[0]) == []


@pytest.mark.parametrize("digits", [4, 6])
def test_rounded_recordings_are_not_remarked_on(right, digits):
    largest = {name: np.abs(getattr(right, name)).max() for name in ("force_N", "force_z_N")}
    step = 10.0 ** (np.ceil(np.log10(max(largest.values()))) - digits)
    assert remarks(changed(right, lambda f, m: (np.round(f / step) * step, np.round(m / step * 20) * step / 20))) == []


def test_friction_across_a_thick_rod_is_not_remarked_on_but_a_larger_torsion_is(right):
    """Friction across the rod acts at its radius, and twists it by no more than the force times the radius."""
    thick = replace(right, rod=replace(right.rod, diameter_m=0.02 * right.rod.length_m))
    arm = 0.01 * right.rod.length_m

    def twisted(part):
        return changed(thick, lambda f, m: (f, m + part * arm * np.linalg.norm(f, axis=1)[:, None] * [0, 1, 0]))

    assert "moment-about-rod" not in remarks(twisted(0.5))
    assert "moment-about-rod" in remarks(twisted(2.0))


def test_a_second_contact_is_remarked_on(right):
    def doubled(f, m):
        """A further force of a tenth at a third of the rod, across."""
        size = 0.1 * np.linalg.norm(f, axis=1)
        extra = np.stack([size, 0 * size, size], axis=1)
        return f + extra, m + np.cross([0, right.rod.length_m / 3, 0], extra)

    assert "moment-along-force" in remarks(changed(right, doubled))


def test_six_axes_read_as_planar_say_how_wrong_that_is(right):
    cloud = scan3d.reconstruct(right, model="planar")
    warning = next(w for w in contradictions(right, cloud) if w.code == "out-of-plane")
    assert "choose the spatial model" in warning.message
    force, _ = right.wrench()
    felt = np.linalg.norm(force, axis=1) > 0
    assert warning.value == pytest.approx(np.median(np.abs(force[felt, 2]) / np.linalg.norm(force[felt], axis=1)))


def test_a_planar_recording_with_six_axes_may_be_read_as_planar():
    body = scan3d.load_mesh("meshes/egg.stl")
    plain = scan3d.simulate(body, scan3d.Plan(slices=6, samples=30, friction=0.3))
    zero = np.zeros(len(plain))
    recording = replace(plain, force_z_N=zero, moment_x_Nm=zero, moment_y_Nm=zero)
    cloud = scan3d.reconstruct(recording, model="planar")
    assert contradictions(recording, cloud) == contradictions(plain, scan3d.reconstruct(plain)) == []
