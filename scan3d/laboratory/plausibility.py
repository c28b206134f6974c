"""Whether lengths, forces and moments fit the rod: a wrong unit makes them wrong by a factor of a thousand."""

from __future__ import annotations

import numpy as np

from scan3d.arrays import Array, Mask
from scan3d.errors import InputError
from scan3d.laboratory.maps import Map
from scan3d.recording import Recording

# Rows touch the body if their force exceeds this many standard deviations of the noise, and this fraction of the largest.
_SIGMAS, _OF_LARGEST = 8.0, 1e-3
# Standard deviations that noise in three components rarely exceeds, and a considerable part of the largest force.
_RARE, _CONSIDERABLE = 4.5, 0.05
# Median travel of the sweeps in rod lengths.  Sweeps past a body are some rod lengths long; 1000 times as much is a wrong unit.
_SHORTEST, _LONGEST = 5e-3, 50.0
# Range of all positions in rod lengths: the clamp moves that far at least.
_SMALLEST_RANGE = 0.02
# Largest force in EI/L².  A rod whose contact has slid to a tenth of its length has a few hundred.
_STRONGEST, _WEAKEST = 2e3, 1e-4
# Clamping moment over its largest possible value 2 √(f EI), which follows from the energy of the bent rod with a free end.
_LARGEST_MOMENT, _SMALLEST_MOMENT = 2.0, 0.01


def felt(recording: Recording) -> Mask:
    """Rows (n,) whose force stands out from the noise."""
    return touches(recording.force_N, recording.noise_force_N)


def stands_out(force_N: Array, noise_N: float) -> Mask:
    """Rows (n,) whose force (n, 3) is rarely due to noise; several of them never are."""
    force = np.linalg.norm(force_N, axis=1)
    rows: Mask = force > max(_RARE * noise_N, _OF_LARGEST * float(force.max()))
    return rows


def in_contact(force_N: Array, noise_N: float) -> Mask:
    """Rows (n,) whose force (n, 3) is a considerable part of the largest one."""
    force = np.linalg.norm(force_N, axis=1)
    rows: Mask = force > max(_SIGMAS * noise_N, _CONSIDERABLE * float(force.max()))
    return rows


def touches(force_N: Array, noise_N: float) -> Mask:
    """Rows (n,) whose force (n, 2) stands out from noise of a given standard deviation."""
    force = np.linalg.norm(force_N, axis=1)
    touching: Mask = force > max(_SIGMAS * noise_N, _OF_LARGEST * float(force.max()))
    return touching


def check_range(position_m: Array, map: Map, table: str) -> None:
    """Raise InputError if the clamp hardly moves, for the length of the rod."""
    reach = float(np.ptp(position_m, axis=0).max()) / map.rod.length_m
    if reach < _SMALLEST_RANGE:
        raise InputError(
            f"{table}: the clamp moves over {reach:.3g} rod lengths only; check [units] length, [columns] position and [rod] "
            f"length_m of {map.name}"
        )


def check_sizes(recording: Recording, map: Map, table: str) -> None:
    """Raise InputError if travel, force or moment can't be those of the rod, with the entry of the map to check."""
    rod = recording.rod
    _, first = np.unique(recording.sweep, return_index=True)
    last = len(recording) - 1 - np.unique(recording.sweep[::-1], return_index=True)[1]
    travel = np.linalg.norm(recording.position_m[last] - recording.position_m[first], axis=1) / rod.length_m
    median = float(np.median(travel))
    if median > _LONGEST or median < _SHORTEST:
        raise InputError(
            f"{table}: the sweeps are {median:.3g} rod lengths long, where {_SHORTEST:g} to {_LONGEST:g} are expected; check "
            f"[units] length, [columns] position and [rod] length_m of {map.name}"
        )
    touching = felt(recording)
    if not touching.any():
        return
    force = np.linalg.norm(recording.force_N[touching], axis=1)
    largest = float(force.max()) / rod.force_unit_N
    if not _WEAKEST < largest < _STRONGEST:
        raise InputError(
            f"{table}: the largest force, {force.max():.3g} N, is {largest:.3g} times EI/L² of the rod, where {_WEAKEST:g} to "
            f"{_STRONGEST:g} are expected; check [units] force, the columns of the force, [tare] and [rod] of {map.name}"
        )
    strong = force >= np.median(force)
    moment = np.abs(recording.moment_Nm[touching][strong])
    ratio = float(np.median(moment / (2 * np.sqrt(force[strong] * rod.bending_stiffness_Nm2))))
    if not _SMALLEST_MOMENT < ratio < _LARGEST_MOMENT:
        raise InputError(
            f"{table}: the moments in contact are {ratio:.3g} times the largest that the rod can have under such forces, where "
            f"{_SMALLEST_MOMENT:g} to 1 are expected; check [units] force and moment, the columns of mz, [tare], [sensor] and "
            f"[rod] of {map.name}"
        )
