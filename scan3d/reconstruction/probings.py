"""Contacts of probings: sweeps in which the clamp moves along its own y axis, that of the undeformed rod, until it touches.

A straight rod that moves along itself stays where its end has been.  So, until a force is felt, the line that the rod and its
end have passed is free, and the first contact is that of its end, and the only one: its arc length is known, no second contact
can hide, and nothing has to be planar.  The end is where the reactions bend the rod to.  They are conditioned on the moment at
the end, which vanishes: weighted by their noise they are moved by the least that makes it zero, and where that is more than
noise explains, the rod was touched elsewhere.

Friction does not enter.  The force lies within the friction angle of the surface's normal, which is not known by itself.

Premises: the rod is straight at rest, so that it follows its end, and as thin as the distance in which its end is known.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from planar.arrays import rows_of
from scan3d.arrays import Array, Index, ranges
from scan3d.cloud import PER_CONTACT, Cloud
from scan3d.errors import InputError
from scan3d.reconstruction.contacts import at_rows
from scan3d.reconstruction.errors import RIGHT_ROWS, NoContactError, felt
from scan3d.recording import Recording
from scan3d.rigs import RigErrors
from scan3d.spatial import inverse
from scan3d.units import UNITS_M


def contacts(recording: Recording, model: str, among: int | None = None) -> Cloud:
    """The contacts of a recording of probings, one of each that felt something: that of its first row with a force.

    They are judged as some of so many, by default as all there are.  Their clouds have no slices.  Raises NoContactError if no
    row gives one, and InputError for rods that are not straight.
    """
    six_axis, rod, scale = model == "spatial", recording.rod, UNITS_M[recording.unit]
    if any(rod.curvatures):
        raise InputError(
            "a rod that is curved does not follow its end when it moves along its clamp's y axis: probe with a straight "
            "one, or leave the sweeps along y out of the recording"
        )
    if rod.bead_diameter_m and not six_axis:
        raise InputError(
            "a bead is touched beside the plane of any sweep: of a rod with bead_diameter_m measure six axes, for the "
            "spatial model"
        )
    noise = recording.noise.of_reactions(rod)
    pressed = np.flatnonzero(felt(recording.pressing(six_axis), noise))
    rows = np.sort(pressed[np.unique(recording.sweep[pressed], return_index=True)[1]])
    nothing = NoContactError(
        f"the recording has no contact: none of its {len(recording)} rows has reactions of a rod that is touched at its end"
    )
    if not len(rows):
        raise nothing
    force, moment = (part[rows].T for part in recording.reactions(six_axis))
    down, bead = recording.down(), rod.bead_diameter_m / 2 / rod.length_m
    found = inverse.at_ends(
        force,
        moment,
        noise,
        rod=rod.in_space(),
        gravity=None if down is None else down[rows].T,
        in_plane=not six_axis,
        bead=bead,
    )
    # of one of all contacts, in the mean of twenty recordings, noise says so wrongly
    alone = found.chance >= RIGHT_ROWS / (among or len(rows))
    elsewhere, rows = int((~alone).sum()), rows[alone]
    if not len(rows):
        raise nothing
    axes, length, n = recording.axes()[rows], rod.length_m / scale, len(rows)
    centres = recording.position_m[rows] / scale + length * np.einsum("ni,nij->nj", found.point[:, alone].T, axes)
    points = centres - bead * length * np.einsum("ni,nij->nj", found.normal[alone], axes)
    pose = recording.noise.pose_m / scale
    noisy = max(*noise, pose / length) > 0
    of_centre, covariance = (
        length**2 * np.einsum("nij,nik,njl->nkl", part[alone], axes, axes) + pose**2 * np.eye(3)
        for part in (found.covariance, found.covariance + bead**2 * found.normal_covariance)
    )
    bead_sd, place_sd = (np.sqrt(np.linalg.eigvalsh(part)[:, 2]) for part in (of_centre, covariance))
    touched = at_rows(
        recording,
        rows,
        points,
        force_N=np.linalg.norm(recording.pressing(six_axis)[rows], axis=1) * rod.force_unit_N,
        noise=float(np.median(place_sd)),
        covariance=covariance if noisy else None,
        place_sd=place_sd if noisy else None,
        normal_sd=np.full(n, np.inf) if noisy else None,
        second=elsewhere,
        convex=False,
        model=model,
        independent=recording.noise.independent,
        probed=np.ones(n, dtype=bool),
        bead_radius=bead * length,
        bead_centres=centres if bead else None,
        bead_sd=bead_sd if bead and noisy else None,
    )
    # the end of a thick rod touches somewhere on it, as the rod's centre line touches the body that is fattened by it
    thick = 0.0 if bead else float(rod.radius_m(np.ones(1))[0]) / scale
    return replace(touched, rod_radius=thick, lever=thick, fattened=touched) if thick else touched


class Passed(NamedTuple):
    """Where the centre lines of rods of probings (m,) have been, in the cloud's unit."""

    begin: Array
    """(m, 3) the clamp at the first place."""
    axis: Array
    """(m, 3) unit vector along which it moved."""
    end: Array
    """(m, 3) the rod's end at the last place: in contact, if that is in the cloud, and before it otherwise."""
    touching: Index
    """(m,) the contact in the cloud; -1 if there is none."""

    def places(self, apart: float, rod_length: float = np.inf) -> Array:
        """(n, 3) places at most so far apart on the axes, from where the clamp began to where the end came.

        With a `rod_length` the last part is that of the rod, a cantilever, ``(3 s² - s³)/2``, whose end is aside of the axis.
        """
        reach, aside = self.reach()
        count = np.ceil(reach / apart).astype(np.intp) + 1
        line, rank = ranges(count)
        # backwards from the end, which a contact may have
        back = rank / np.maximum(count - 1, 1)[line] * reach[line]
        places = self.begin[line] + (reach[line] - back)[:, None] * self.axis[line]
        if np.isfinite(rod_length):
            s = np.maximum(1 - back / rod_length, 0.0)[:, None]
            places += s**2 * (3 - s) / 2 * aside[line]
        return np.asarray(places)

    def reach(self) -> tuple[Array, Array]:
        """How far (m,) along the axis the end went, and by how much (m, 3) it is aside of it there."""
        step = self.end - self.begin
        along = (step * self.axis).sum(axis=1)
        return along, step - along[:, None] * self.axis


def passed_in_probings(recording: Recording, cloud: Cloud) -> Passed:
    """Where the rods of all probings of a recording have been: on their axes, until a force bent them.

    Where a contact that was felt is not in the cloud, the end is that of the last row before.
    """
    rows = np.flatnonzero(recording.in_probings)
    rows = rows[np.argsort(recording.sweep[rows], kind="stable")]
    begins = np.flatnonzero(np.diff(recording.sweep[rows], prepend=-1))
    if not len(rows):
        nothing = np.empty((0, 3))
        return Passed(nothing, nothing, nothing, np.empty(0, dtype=np.intp))
    scale, rod, axes = UNITS_M[recording.unit], recording.rod, recording.axes()
    pressed = felt(recording.pressing(recording.six_axis), recording.noise.of_reactions(rod))[rows]
    number = np.cumsum(np.diff(recording.sweep[rows], prepend=-1) != 0) - 1
    before: Index = np.cumsum(pressed) - pressed  # rows that felt something, before each
    free = ~pressed & (before == before[begins][number])
    count = np.add.reduceat(free.astype(int), begins)
    first, last = rows[begins], rows[begins + np.maximum(count, 1) - 1]
    end = (recording.position_m[last] + rod.length_m * axes[last, 1]) / scale
    probed = np.flatnonzero(np.zeros(len(cloud), dtype=bool) if cloud.probed is None else cloud.probed)
    ends = cloud.points if cloud.bead_centres is None else cloud.bead_centres
    where, touching = np.searchsorted(recording.sweep[first], cloud.sweep[probed]), np.full(len(first), -1)
    end[where], touching[where] = ends[probed], probed
    return rows_of(Passed(recording.position_m[first] / scale, axes[first, 1], end, touching), count > 0)


def free_lines(recording: Recording, cloud: Cloud) -> Array:
    """(m, 2, 3) the lines from where the clamps of all probings began to where their rods' ends came, in the cloud's unit."""
    passed = passed_in_probings(recording, cloud)
    return np.stack([passed.begin, passed.end], axis=1)


def with_probings(swept: Cloud | None, probed: Cloud) -> Cloud:
    """The contacts of sweeps, if there are any, and of probings in one cloud; the body counts as one that is not convex."""
    if swept is None:
        return probed
    n, m = len(swept), len(probed)
    filled: dict[str, Any] = {"normal_sd": np.inf}
    columns: dict[str, Any] = {}
    for name in PER_CONTACT:
        parts = [getattr(swept, name), getattr(probed, name)]
        if all(part is None for part in parts):
            continue
        like = next(part for part in parts if part is not None)
        missing = filled.get(name, np.nan)
        parts = [
            np.full((count, *like.shape[1:]), missing, dtype=like.dtype) if part is None else part
            for part, count in zip(parts, (n, m), strict=True)
        ]
        columns[name] = np.concatenate(parts)
    columns["probed"] = np.arange(n + m) >= n
    calibration = None
    if swept.calibration is not None or probed.calibration is not None:
        calibration = RigErrors.joined([swept.calibration, probed.calibration], [n, m])
    noise = 0.0 if columns.get("place_sd") is None else float(np.median(columns["place_sd"]))
    second = swept.second + probed.second
    thick: dict[str, Any] = {}
    if swept.fattened is not None or probed.fattened is not None:
        thick["fattened"] = with_probings(swept.fattened or swept, probed.fattened or probed)
        thick |= {name: max(getattr(swept, name), getattr(probed, name)) for name in ("rod_radius", "lever")}
    joined = replace(swept, **columns, noise=noise, convex=False, second=second, calibration=calibration, **thick)
    return replace(joined, of_sweeps=swept)
