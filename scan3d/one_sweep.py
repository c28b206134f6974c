"""One sweep in one plane: its reactions, and the contacts that follow from them with their standard deviations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import planar
from scan3d.arrays import Array, Mask
from scan3d.errors import InputError
from scan3d.rods import Rod


@dataclass(frozen=True)
class OneSweep:
    """Base positions and support reactions (n,) of one sweep, of which the frame is that of `planar`.

    They are in m, N and N·m if the rod is given, else in rod lengths, EI/L² and EI/L.  They are kept as they were recorded,
    because their digits tell how they were rounded.  Raises InputError for fewer than two rows, and for base positions that do
    not tell the direction of the sweep.
    """

    x0: Array
    f0x: Array
    f0y: Array
    m0z: Array
    rod: Rod | None = None
    noise_force: float = 0.0
    """Standard deviation of each force component; 0 where it is not known."""
    noise_moment: float = 0.0
    """Standard deviation of the moment; 0 where it is not known."""

    def __post_init__(self) -> None:
        if len(self.x0) < 2:
            raise InputError(
                f"a sweep needs two rows or more, which tell the direction of the base's motion, got {len(self.x0)}"
            )
        for noise in (self.noise_force, self.noise_moment):
            if not (np.isfinite(noise) and noise >= 0):
                raise InputError(f"the standard deviations of the noise must be finite and at least 0, got {noise:g}")
        self.direction  # noqa: B018 - raises InputError

    def __len__(self) -> int:
        return len(self.x0)

    @property
    def units(self) -> tuple[float, float, float]:
        """The units (1) of length, force and moment, by which values are divided to make them dimensionless."""
        rod = self.rod
        return (rod.length_m, rod.force_unit_N, rod.moment_unit_Nm) if rod else (1.0, 1.0, 1.0)

    @property
    def direction(self) -> int:
        """-1 or 1: the sign of the base's motion along x, from the first row to the last one."""
        known = self.x0[np.isfinite(self.x0)]
        if len(known) < 2 or known[0] == known[-1]:
            raise InputError(
                "the base position of a sweep must decrease or increase from the first row to the last one; cut a motion "
                "back and forth into two tables"
            )
        return -1 if known[-1] < known[0] else 1


@dataclass(frozen=True)
class SweepContacts:
    """Contacts (n,) of one sweep, one for every row, and their standard deviations, which are 0 for exact data.

    Dimensionless: lengths are in rod lengths, angles in radians; values of rows without contact are NaN.  The standard
    deviations are those of the first order, from the Jacobian of the closed form.
    """

    sweep: OneSweep
    contacts: planar.Contacts
    noise_force: float
    """Standard deviation of each force component with that of its rounding, in EI/L²."""
    noise_moment: float
    """Standard deviation of the moment with that of its rounding, in EI/L."""
    point_sd: Array
    """(n, 2) of the contact's x and y."""
    place_sd: Array
    """(n,) of the contact's place in its least certain direction."""
    s1_sd: Array
    """(n,)"""
    slope_sd: Array
    """(n,) of the slope angle, in tangential contact."""
    friction_angle_sd: Array
    """(n,) of the friction angle, in tangential contact."""

    @property
    def friction_sd(self) -> Array:
        """(n,) standard deviation of the coefficient of friction, in tangential contact."""
        return np.asarray((1 + self.contacts.friction**2) * self.friction_angle_sd)

    @property
    def noisy(self) -> bool:
        """Whether errors of the reactions are known."""
        return max(self.noise_force, self.noise_moment) > 0

    @property
    def only_rounding(self) -> bool:
        """Whether the known errors are those of the rounding of the numbers alone."""
        return self.noisy and not max(self.sweep.noise_force, self.sweep.noise_moment)

    @property
    def touching(self) -> Mask:
        """(n,) whether the row gives a contact."""
        return np.asarray(self.contacts.status == planar.Status.OK)

    @property
    def tangential(self) -> Mask:
        """(n,) whether the contact is tangential."""
        return np.asarray(self.contacts.phase == planar.Phase.TANGENTIAL)
