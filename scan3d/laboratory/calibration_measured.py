"""The rows of a recording that a calibration uses: those in contact and those in the air, dimensionless."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scan3d.arrays import Array
from scan3d.errors import InputError
from scan3d.laboratory.calibration_air import Unloaded, unloaded
from scan3d.laboratory.calibration_colour import Colour, colour
from scan3d.laboratory.calibration_fit import Air, Problem
from scan3d.laboratory.calibration_model import (
    CENTRE,
    CLAMP,
    LENGTH,
    SENSOR,
    SPIN,
    STIFFNESS,
    TARE,
    TILT,
    TURN,
    Kind,
    Rig,
    Touches,
)
from scan3d.laboratory.calibration_reference import Reference, Spherical
from scan3d.laboratory.calibration_rows import neighbours
from scan3d.recording import Recording

FEWEST = 30
"""Rows in contact that a calibration needs."""
# Forces in standard deviations of their noise from which a row is used for the first estimate.
_FELT = 20.0
# Widths within which parameters are known without any touch: those that the touches leave less certain are not determined.
# Of the stiffness's logarithm, lengths in rod lengths, angles in radians, and the tare in EI/L² and EI/L.
_WIDTHS = {STIFFNESS: 0.5, CLAMP: 0.1, TILT: 0.3, TURN: 0.5, SENSOR: 0.3, CENTRE: 1.0, SPIN: 0.5}
_WIDTHS |= {LENGTH: 0.1, TARE: 1.0}
# Spread of the planes of planar sweeps, over the sphere's radius, up to which they count as one plane through the centre.
_PLANE = 0.1


class Measured(NamedTuple):
    problem: Problem
    sweep: NDArray[np.int64]
    """(n,) of the rows in contact."""
    rows: NDArray[np.intp]
    """(n,) their numbers in the recording."""
    colours: tuple[Colour, Colour]
    """Of the noise of force and moment."""
    around: Array
    """(n, 6) wrench of the neighbours of each row, which decides whether the row is used."""
    unloaded: Unloaded
    nominal: Rig
    world: Array
    """(3, 3) from the world to the frame of the equations."""

    def thinned(self, step: int) -> Measured:
        """Every so many rows in contact and in the air."""
        problem, air = self.problem, self.problem.air
        kept = np.arange(0, len(self.rows), step)
        return self._replace(
            problem=replace(
                problem,
                touches=problem.touches.rows(kept),
                air=Air(air.wrench[::step], air.basis[::step], air.rows[::step]),
            ),
            sweep=self.sweep[kept],
            rows=self.rows[kept],
            around=self.around[kept],
        )


def measured(recording: Recording, reference: Reference, tare: str) -> Measured:
    """The rows in contact and in the air, dimensionless."""
    rod, known = recording.rod, recording.noise
    channels = np.full(6, recording.six_axis)
    if not recording.six_axis and not isinstance(reference, Spherical):
        raise InputError(
            f"a calibration by touches of {reference.title} needs forces and moments with all six components; with three, "
            "touch a sphere"
        )
    if recording.six_axis:
        wrench = np.hstack(recording.wrench())
    else:
        channels[[0, 1, 5]] = True
        zero = np.zeros((len(recording), 3))
        wrench = np.column_stack([recording.force_N, zero, recording.moment_Nm])
    unit = np.repeat([rod.force_unit_N, rod.moment_unit_Nm], 3)
    wrench = wrench / unit
    noise = known.force_N / unit[0], known.moment_Nm / unit[3]
    found = unloaded(recording.sweep, wrench, channels, noise, tare)
    around = neighbours(wrench, recording.sweep, found.contact)
    force = np.linalg.norm((around - found.basis @ found.tare.T)[:, :3], axis=1)
    rows = np.flatnonzero(found.contact & (force > _FELT * found.force_noise))
    if len(rows) < FEWEST:
        raise InputError(
            f"the recording has {len(rows)} rows in contact that stand out from the noise, and a calibration needs {FEWEST}: "
            f"touch the {reference.noun} in more sweeps, and bend the rod more"
        )
    # sweeps in a plane do not determine how far the sphere's centre is from it: the plane's normal is one of the axes
    world = np.eye(3) if recording.six_axis else recording.axes()[rows[0]]
    touches = Touches(
        wrench[rows],
        recording.position_m[rows] / rod.length_m @ world.T,
        world @ recording.axes()[rows].swapaxes(1, 2),
        found.basis[rows],
        np.full(len(rows), Kind.EITHER, dtype=np.int8),
    )
    k = found.basis.shape[1]
    free = np.ones(TARE + 6 * k, dtype=bool)
    free[CENTRE:LENGTH] = reference.free
    if not recording.six_axis:
        free[[TILT, TURN, TURN + 1, SENSOR + 2]] = False
        free[TARE:] = np.repeat(channels, k)
        free[CENTRE + 2] = np.ptp(touches.position[:, 2]) > _PLANE * reference.size
    problem = Problem(
        touches,
        Air(wrench[found.air], found.basis[found.air], np.flatnonzero(found.air)),
        reference,
        channels,
        free,
        by_parameter(_WIDTHS, len(free)),
    )
    middle = touches.position.mean(axis=0)
    nominal = Rig(0.0, np.zeros(3), np.zeros(2), np.eye(3), np.zeros(3), middle, np.eye(3), 1.0, found.tare)
    colours = (
        colour(wrench, found, channels, slice(0, 3), found.force_noise),
        colour(wrench, found, channels, slice(3, 6), found.moment_noise),
    )
    return Measured(problem, recording.sweep[rows], rows, colours, around[rows], found, nominal, world)


def by_parameter(table: dict[int, float], count: int) -> Array:
    """(p,) values of parameters from those of the groups that begin at the keys."""
    first = np.array(sorted(table))
    return np.array([table[first[first <= number][-1]] for number in range(count)])
