"""Contacts of one sweep in one plane: `planar.reconstruct` with the errors that noise and rounding make."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import planar
from scan3d.arrays import Array, Mask
from scan3d.errors import InputError
from scan3d.one_sweep import OneSweep, SweepContacts
from scan3d.reconstruction.contacts import FORCE_SIGMAS, contact_tolerance
from scan3d.reconstruction.resolution import rounding_sd, together


def reconstruct_sweep(sweep: OneSweep) -> SweepContacts:
    """The contacts of a sweep.

    Errors of the reactions are the noise that the sweep states, and the rounding of its numbers.  Rows whose force does not
    stand out from them have no contact.  Raises InputError if no row has one.
    """
    in_length, in_force, in_moment = sweep.units
    force = together(sweep.noise_force, max(_rounding(sweep.f0x), _rounding(sweep.f0y))) / in_force
    moment = together(sweep.noise_moment, _rounding(sweep.m0z)) / in_moment
    reactions = sweep.f0x / in_force, sweep.f0y / in_force, sweep.m0z / in_moment
    with np.errstate(over="ignore", invalid="ignore"):
        spread = planar.jacobian(*reactions, direction=sweep.direction) * [force, force, moment]
        point_sd, s1_sd = np.linalg.norm(spread[:, :2], axis=2), np.linalg.norm(spread[:, 2], axis=1)
        angle_sd = np.linalg.norm(spread[:, 4], axis=1)
        # the slope is α - β, in the mirror image, where β keeps its sign, α + β
        slope_sd = np.linalg.norm(spread[:, 3] + sweep.direction * spread[:, 4], axis=1)
        place_sd = _largest(spread[:, :2])
        tolerance = contact_tolerance(s1_sd, angle_sd)
        found = planar.reconstruct(sweep.x0 / in_length, *reactions, tolerance=tolerance, direction=sweep.direction)
        felt = np.hypot(*reactions[:2]) > FORCE_SIGMAS * max(force, moment)
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
        place_sd=np.where(valid, place_sd, np.nan),
        s1_sd=np.where(valid, s1_sd, np.nan),
        slope_sd=np.where(tangential, slope_sd, np.nan),
        friction_angle_sd=np.where(tangential, angle_sd, np.nan),
    )


def _rounding(column: Array) -> float:
    """Standard deviation of the rounding of a column (n,), by its values that are not missing or infinite."""
    return rounding_sd(column[np.isfinite(column)])


def _largest(spread: Array) -> Array:
    """(n,) standard deviation in the least certain direction, from the derivatives (n, 2, 3) times standard deviations."""
    covariance = np.einsum("nik,njk->nij", spread, spread)
    mean, half = (covariance[:, 0, 0] + covariance[:, 1, 1]) / 2, (covariance[:, 0, 0] - covariance[:, 1, 1]) / 2
    return np.asarray(np.sqrt(mean + np.hypot(half, covariance[:, 0, 1])))


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
