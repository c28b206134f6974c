"""Contacts of one sweep in one plane: `planar.reconstruct` with the errors that noise and rounding make."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import planar
from scan3d.arrays import Array, Mask
from scan3d.errors import InputError
from scan3d.one_sweep import OneSweep, SweepContacts
from scan3d.reconstruction.errors import FORCE_SIGMAS, contact_tolerance
from scan3d.recording import rounding_sd, together


def reconstruct_sweep(sweep: OneSweep) -> SweepContacts:
    """The contacts of a sweep.

    Errors of the reactions are the noise that the sweep states, and the rounding of its numbers.  Rows whose force does not
    stand out from them have no contact.  Raises InputError if no row has one.
    """
    in_length, in_force, in_moment = sweep.units
    force = together(sweep.noise_force, max(_rounding(sweep.f0x), _rounding(sweep.f0y))) / in_force
    moment = together(sweep.noise_moment, _rounding(sweep.m0z)) / in_moment
    reactions = sweep.f0x / in_force, sweep.f0y / in_force, sweep.m0z / in_moment
    noise = force, moment
    error = planar.errors(*reactions, noise=noise, direction=sweep.direction)
    found = planar.reconstruct(
        sweep.x0 / in_length, *reactions, tolerance=contact_tolerance(error), direction=sweep.direction
    )
    felt = np.hypot(*reactions[:2]) > FORCE_SIGMAS * max(noise)
    point_sd = np.sqrt(np.einsum("nii->ni", error.point))
    found = _without(found, (found.status == planar.Status.OK) & ~felt)
    valid = found.status == planar.Status.OK
    if not valid.any():
        raise InputError(_no_contact(found))
    tangential = found.phase == planar.Phase.TANGENTIAL
    return SweepContacts(
        sweep=sweep,
        contacts=found,
        noise_force=force,
        noise_moment=moment,
        point_sd=np.where(valid[:, None], point_sd, np.nan),
        place_sd=np.where(valid, error.largest, np.nan),
        s1_sd=np.where(valid, error.s1, np.nan),
        slope_sd=np.where(tangential, error.slope, np.nan),
        friction_angle_sd=np.where(tangential, error.friction_angle, np.nan),
    )


def _rounding(column: Array) -> float:
    """Standard deviation of the rounding of a column (n,), by its values that are not missing or infinite."""
    return rounding_sd(column[np.isfinite(column)])


def _without(contacts: planar.Contacts, rows: Mask) -> planar.Contacts:
    """The contacts, without those in rows (n,) whose force does not stand out from the noise."""
    names = ("s1", "force", "force_angle", "friction_angle_bound", "slope")
    return replace(
        contacts,
        point=np.where(rows[:, None], np.nan, contacts.point),
        **{name: np.where(rows, np.nan, getattr(contacts, name)) for name in names},
        phase=np.where(rows, planar.Phase.NONE, contacts.phase).astype(np.int8),
        status=np.where(rows, planar.Status.NO_FORCE, contacts.status).astype(np.int8),
        normal_source=np.where(rows, planar.NormalSource.NONE, contacts.normal_source).astype(np.int8),
    )


def _no_contact(contacts: planar.Contacts) -> str:
    """Why a sweep has no contact, by the most frequent reason."""
    codes, counts = np.unique(contacts.status, return_counts=True)
    most = planar.Status(int(codes[counts.argmax()]))
    return f"the sweep has no contact: of {counts.max()} of its {len(contacts)} rows, {most.sentence}"
