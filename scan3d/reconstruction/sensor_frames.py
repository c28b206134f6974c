"""Faults of the sensor's frame: it is turned, its moments refer to a point beside the clamp, or both.

The sensor shows the force F' and the moment m'.  With its turn R and its place p in the clamp's frame, the reactions are
``F = R F'`` and ``m = R m' + p × F``.  Where both are unknown, a first estimate follows from a linear equation: the moment
about the undeformed rod vanishes, ``<e, m> = 0`` with e = (0, 1, 0), and hence ``<a, m'> + <c, F'> = 0`` for all rows, with
``a = Rᵀ e`` and ``c = Rᵀ (e × p)``.  The right singular vector of the rows (m', F') with the smallest singular value is (a, c).
The turn about the rod and the offset along it remain open, and are tried.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from scan3d.arrays import Array
from scan3d.frames import euler_of, to_outer
from scan3d.reconstruction.faults import Fault, Hypothesis
from scan3d.reconstruction.misfits import Reactions, felt, noise
from scan3d.recording import Recording
from scan3d.rods import Rod

TURNED_AND_MOVED = "turned-and-moved"
FRAME_CODES = ("turned", "moment-not-moved")
"""Beginnings of the codes of all faults of the frame."""
# Starts of the search: angles in degrees, and distances in rod lengths.
_ANGLES = (-165, -135, -110, -90, -70, -50, -35, -25, -15, -7, -2, 2, 7, 15, 25, 35, 50, 70, 90, 110, 135, 165)
_DISTANCES = (0.03, 0.1, 0.25, 0.5)
# Turns about the rod in degrees, and offsets along it in rod lengths, that are tried where both are unknown.
_ABOUT_ROD = tuple(range(-180, 180, 30))
_ALONG_ROD = (-0.5, -0.2, 0.0, 0.2, 0.5)
# Parts of the largest axis of a turn below which the others are not named.
_ABOUT_ONE = 0.15
_NOWHERE = np.zeros(3)
_AXES = ("x", "y", "z")
_ABOUT = ("about the clamp's x axis", "about the rod (the clamp's y axis)", "about the clamp's z axis")


def frame_faults(recording: Recording, model: str, measured: Reactions) -> list[Hypothesis]:
    """The faults of the sensor's frame that a recording of the model may have; `measured` are its reactions."""
    found = [*_turns(model), _offset(recording, model)]
    if model == "spatial":
        found.append(_turned_and_moved(recording, measured))
    return found


def _turns(model: str) -> list[Hypothesis]:
    """Sensors that are turned about one axis, and in space about any."""
    angles = np.radians(_ANGLES)[:, None]

    def about(axis: int) -> Hypothesis:
        unit = np.eye(3)[axis]
        return Hypothesis(
            angles, lambda r, rows, n: _at_clamp(r, n[0] * unit, _NOWHERE), lambda n: _turned_fault(n[0] * unit), 1
        )

    if model != "spatial":
        return [about(2)]
    small = np.radians([[2, 2, 2], [10, 0, 10], [10, 0, -10], [20, 5, 5], [-10, 20, 5], [5, -20, -10]])
    anywhere = Hypothesis(small, lambda r, rows, n: _at_clamp(r, n, _NOWHERE), lambda n: _turned_fault(n), 3)
    return [about(0), about(1), about(2), anywhere]


def _turned_fault(vector: Array) -> Fault:
    angle = float(np.degrees(np.linalg.norm(vector)))
    axis = int(np.argmax(np.abs(vector)))
    others = np.delete(np.abs(vector), axis)
    single = bool(others.max() <= _ABOUT_ONE * np.abs(vector[axis]))
    angles = np.degrees(vector) if single else euler_of(Rotation.from_rotvec(vector).as_matrix())
    euler = ", ".join(f"{value:.3g}" for value in angles + 0.0)
    signed = float(np.degrees(vector[axis])) if single else angle
    where = _ABOUT[axis] if single else "about an axis across several of the clamp's"
    return Fault(
        f"turned-{_AXES[axis]}" if single else "turned",
        signed,
        "deg",
        f"the sensor is turned by {signed:.3g}° {where}: state euler_deg = [{euler}] under [sensor], or calibrate",
    )


def _offset(recording: Recording, model: str) -> Hypothesis:
    """The moment about a point beside the clamp; numbers are its place in the clamp's frame, in rod lengths."""
    count = 3 if model == "spatial" else 2
    starts = np.concatenate([sign * distance * np.eye(count) for distance in _DISTANCES for sign in (-1, 1)])

    def place(numbers: Array) -> Array:
        return np.append(numbers, np.zeros(3 - count))

    return Hypothesis(
        starts,
        lambda r, rows, n: _at_clamp(r, _NOWHERE, place(n)),
        lambda n: _offset_fault(place(n), recording.rod),
        count,
    )


def _offset_fault(place: Array, rod: Rod) -> Fault:
    millimetres = 1000 * rod.length_m * place
    distance = float(np.linalg.norm(millimetres))
    where = ", ".join(f"{value:.3g}" for value in millimetres)
    return Fault(
        "moment-not-moved",
        distance,
        "mm",
        f"the moment was not moved to the clamp: it refers to a point {distance:.3g} mm from it; state position_mm = "
        f"[{where}] under [sensor], or calibrate",
    )


def _turned_and_moved(recording: Recording, measured: Reactions) -> Hypothesis:
    """A sensor that is turned and beside the clamp; numbers are the vector of its turn, and its place in rod lengths."""
    return Hypothesis(
        _frames(recording, measured),
        lambda r, rows, n: _at_clamp(r, n[:3], n[3:]),
        lambda n: _turned_and_moved_fault(n[:3], n[3:], recording.rod),
        6,
    )


def _at_clamp(r: Reactions, vector: Array, place: Array) -> Reactions:
    """The reactions that a sensor with the turn `vector` at a place shows as `r`."""
    return Reactions(*to_outer(r.force, r.moment, Rotation.from_rotvec(vector).as_matrix(), place), r.length)


def _frames(recording: Recording, measured: Reactions) -> Array:
    """First estimates (s, 6) of turns and places in which no moment is about the rod."""
    rows = felt(measured.force, noise(recording))
    _, _, right = np.linalg.svd(np.hstack([measured.moment[rows], measured.force[rows]]), full_matrices=False)
    axis, arm = right[-1, :3], right[-1, 3:]
    size = float(np.linalg.norm(axis))
    if not rows.any() or size == 0:
        return np.zeros((1, 6))
    starts = []
    along_rod = np.array([0.0, 1.0, 0.0])
    for sign in (1.0, -1.0):
        to_rod = Rotation.align_vectors(along_rod[None], sign * axis[None] / size)[0]
        for angle in np.radians(_ABOUT_ROD):
            turn = Rotation.from_rotvec(angle * along_rod) * to_rod
            across = np.cross(turn.apply(sign * arm / size), along_rod)
            starts += [[*turn.as_rotvec(), *(across + along * along_rod)] for along in _ALONG_ROD]
    return np.array(starts)


def _turned_and_moved_fault(vector: Array, place: Array, rod: Rod) -> Fault:
    angle = float(np.degrees(np.linalg.norm(vector)))
    euler = ", ".join(f"{value + 0.0:.3g}" for value in euler_of(Rotation.from_rotvec(vector).as_matrix()))
    millimetres = 1000 * rod.length_m * place
    where = ", ".join(f"{value:.3g}" for value in millimetres)
    return Fault(
        TURNED_AND_MOVED,
        angle,
        "deg",
        f"the sensor is turned by {angle:.3g}°, and its moments refer to a point {np.linalg.norm(millimetres):.3g} mm from the "
        f"clamp: state euler_deg = [{euler}] and position_mm = [{where}] under [sensor], or calibrate",
    )
