"""Contacts of bodies that are not convex: which ones are none, because the rod touched at a second place as well.

A recording states that its body is not convex.  Without the statement a contact beyond the tangent at another one, or inside
the hull of the others, contradicts the model: a rod that is a tenth too long, or a sensor that is turned, gives contacts as a
hollow body does.  No contact lies inside what the other sweeps have passed, whatever the body's shape (C14), unless the rod,
the sensor or the poses are not as stated; then much of what one sweep touches another one has passed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from functools import partial

import numpy as np
from scipy.spatial import cKDTree

import planar
from planar.arrays import rows_of
from scan3d.arrays import Array, Index, Mask, ratio
from scan3d.cloud import Cloud, NormalSource
from scan3d.reconstruction.errors import SIGMAS, contact_tolerance, felt, tip_tolerance
from scan3d.recording import Recording
from scan3d.units import UNITS_M
from scan3d.workers import shared


def without_second_contacts(cloud: Cloud, recording: Recording) -> Cloud:
    """The contacts of a recording in slices, less those that can't be single ones, if its body is not convex.

    The cloud is returned as it is where its contacts contradict each other whatever the body's shape.
    """
    rows = _Rows(cloud, recording)
    friction = rows.friction()
    refused = rows.refused(friction)
    if not friction > 0:  # then the path alone tells, and of a contact without another one nearby not even that
        refused |= rows.alone()
    passed = rows.passed(refused)
    wrong = refused | passed
    while cloud.covariance is not None and (beside := rows.beside(wrong)).any():
        wrong |= beside
    if cloud.covariance is not None:
        wrong |= rows.bridging(wrong)
    kept = (rows.touching & ~wrong)[cloud.row]
    # most of the rows that feel a force must be those of single contacts, for else nothing speaks for a rig that is right
    # larger shares than those of rods with two contacts are those of a wrong rig
    if passed.sum() > 0.15 * len(cloud) or 2 * kept.sum() < rows.pressed.sum():
        return cloud
    single = cloud.select(kept)
    normals = _estimated_normals(single)
    known = np.isfinite(normals[:, 0])
    source = np.where(known, NormalSource.SLICES, NormalSource.UNKNOWN).astype(np.int8)
    second = int(rows.pressed.sum()) - cloud.light - len(single)
    return replace(single, convex=False, second=second, normals=normals, normal_source=source, fit=None)


class _Rows:
    """The rows (n,) of a recording in slices: their rods in rod lengths, and their sweeps."""

    def __init__(self, cloud: Cloud, recording: Recording) -> None:
        rod, self.axes = recording.rod, recording.axes()
        force, moment = recording.force_N / rod.force_unit_N, recording.moment_Nm / rod.moment_unit_Nm
        place = np.einsum("nij,nj->ni", self.axes, recording.position_m) / rod.length_m
        self.columns = place[:, 0], *force.T, moment
        self.above = place[:, 1]
        """(n,) place of the clamp along the y axis of its frame."""
        noise = recording.noise.of_reactions(rod)
        self.errors = planar.errors(force[:, 0], force[:, 1], moment, noise=noise)
        self.pressed = felt(force, noise)
        tolerance = tip_tolerance(recording, self.pressed, contact_tolerance(self.errors), "planar")
        self.found = planar.reconstruct(*self.columns, tolerance=tolerance)
        self.touching = np.zeros(len(moment), dtype=bool)
        # the cloud allows for noise: some of its rows have no rod as they are
        self.touching[cloud.row] = np.isfinite(self.found.point[cloud.row]).all(axis=1)
        order = np.argsort(recording.sweep, kind="stable")
        self.sweeps = np.split(order, np.flatnonzero(np.diff(recording.sweep[order])) + 1)
        first = np.array([rows[0] for rows in self.sweeps])
        height = (recording.position_m[first] * self.axes[first, 2]).sum(axis=1) / UNITS_M[cloud.unit]
        apart = np.abs(self.axes[first, 2][:, None] - cloud.slice_axis).max(axis=2) * cloud.rod_length
        self.slice = (apart + np.abs(height[:, None] - cloud.slice_height)).argmin(axis=1)

    def friction(self) -> float:
        """The coefficient that the contacts agree on; NaN where they do not."""
        rows = np.flatnonzero(self.touching)
        return float(np.tan(planar.constant_friction_angle(_of(self.found, rows), rows_of(self.errors, rows))))

    def refused(self, friction: float) -> Mask:
        """(n,) contacts that are not those of single ones by friction and path."""
        refused = np.zeros(len(self.touching), dtype=bool)
        for sweep in self.sweeps:
            rows = sweep[self.touching[sweep]]
            if len(rows):
                # without a friction that the contacts agree on this is NaN, and nothing is told by it
                found, errors = _of(self.found, rows), rows_of(self.errors, rows)
                columns = (column[rows] for column in self.columns)
                refused[rows] = planar.second_contacts(*columns, contacts=found, friction=friction, errors=errors)
        return refused

    def alone(self) -> Mask:
        """(n,) contacts next to which no other row has one, and those that are the only ones of their sweep.

        Nothing confirms that they are those of single ones.
        """
        steps = np.concatenate([np.abs(np.diff(self.columns[0][sweep])) for sweep in self.sweeps])
        found = self._unconfirmed(self.touching, self.touching, 5.0 * float(np.median(steps)) if len(steps) else 0.0)
        for sweep in self.sweeps:
            found[sweep] |= self.touching[sweep].sum() == 1
        return found & self.touching

    def beside(self, wrong: Mask) -> Mask:
        """(n,) contacts next to a wrong one of their sweep, with no other contact where they are.

        A rod has a second contact over several rows; at the first and the last ones noise hides it from other tests.
        """
        beside, left = np.zeros(len(wrong), dtype=bool), self.touching & ~wrong
        for sweep in self.sweeps:
            beside[sweep[1:]] |= wrong[sweep[:-1]]
            beside[sweep[:-1]] |= wrong[sweep[1:]]
        return self._unconfirmed(left & beside, left & ~beside, 0.0)

    def _unconfirmed(self, asked: Mask, others: Mask, apart: float) -> Mask:
        """(n,) contacts of those asked that lie farther than that, and than their errors, from all of the others.

        What is known worse than a contact confirms it no better for that.
        """
        found = np.zeros(len(asked), dtype=bool)
        error, own = SIGMAS * np.nan_to_num(self.errors.largest, posinf=np.inf), int(asked is others)
        for plane, members in self._slices():
            rows = np.concatenate(members)
            rows, known = rows[asked[rows]], rows[others[rows]]
            if len(rows) and len(known) > own:
                points, places = (self._in_plane(self.found.point[part], part, plane) for part in (rows, known))
                distance, nearest = cKDTree(places).query(points, k=[1 + own])
                found[rows] = distance[:, 0] > apart + error[rows] + np.minimum(
                    error[rows], error[known[nearest[:, 0]]]
                )
        return found

    def passed(self, refused: Mask) -> Mask:
        """(n,) the fewest contacts, of those not refused, without which no rod has passed a contact of its slice.

        A rod that looks as if it touched elsewhere than it does passes many contacts that others have found, or its contact
        lies where many rods have been.
        """
        found = np.zeros(len(refused), dtype=bool)
        # 16 slices are worth another process
        for rows in shared(partial(self._contradicting, self.touching & ~refused), self._slices(), 16, "slices"):
            found[rows] = True
        return found

    def _contradicting(self, asked: Mask, slices: Sequence[tuple[Array, list[Index]]]) -> list[Index]:
        single = asked | ~self.pressed
        error = SIGMAS * np.nan_to_num(self.errors.largest, posinf=np.inf)
        found: list[Index] = []
        for plane, members in slices:
            rows = np.concatenate(members)
            rows = rows[asked[rows]]
            points = self._in_plane(self.found.point[rows], rows, plane)
            pairs = []
            for sweep in members:
                x0, fx, fy, moment = (column[sweep] for column in self.columns)
                rod, point = planar.passed(
                    x0,
                    fx,
                    fy,
                    moment,
                    self.found.s1[sweep],
                    self._of_sweep(points, sweep, plane),
                    single=single[sweep],
                    error=error[sweep],
                    point_error=error[rows],
                )
                pairs.append(np.stack([sweep[rod], rows[point]]))
            found.append(np.flatnonzero(_cover(np.concatenate(pairs, axis=1), self.pressed)))
        return found

    def bridging(self, wrong: Mask) -> Mask:
        """(n,) contacts, of those not wrong, of rods that may rest on the places of others on either side."""
        found, asked = np.zeros(len(wrong), dtype=bool), self.touching & ~wrong
        for plane, members in self._slices():
            rows = np.concatenate(members)
            rows = rows[asked[rows]]
            points = self._in_plane(self.found.point[rows], rows, plane)
            turn = self.axes[rows, :2] @ plane.T
            spread = np.einsum("nij,nik,nkl->njl", turn, self.errors.point[rows], turn)
            for sweep in members:
                some = sweep[asked[sweep]]
                if len(some):
                    back = self.axes[some[0], :2] @ plane.T
                    x0, fx, fy, moment = (column[some] for column in self.columns)
                    found[some] = planar.bridging(
                        x0,
                        fx,
                        fy,
                        moment,
                        _of(self.found, some),
                        self._of_sweep(points, some, plane),
                        errors=rows_of(self.errors, some),
                        covariance=back @ spread @ back.T,
                    )
        return found

    def _slices(self) -> list[tuple[Array, list[Index]]]:
        """Of each slice the axes (2, 3) of its plane, and the rows of each of its sweeps."""
        every: list[list[Index]] = [
            [self.sweeps[k] for k in np.flatnonzero(self.slice == number)] for number in np.unique(self.slice)
        ]
        return [(self.axes[members[0][0], :2], members) for members in every]

    def _of_sweep(self, points: Array, sweep: Index, plane: Array) -> Array:
        """Points in the axes (2, 3) of a slice's plane, in the frame of one of its sweeps."""
        return np.asarray(points @ (self.axes[sweep[0], :2] @ plane.T).T - [0.0, self.above[sweep[0]]])

    def _in_plane(self, points: Array, rows: Index, plane: Array) -> Array:
        """Points of the clamps' frames at some rows, in the axes (2, 3) of a slice's plane."""
        above = np.stack([np.zeros(len(rows)), self.above[rows]], axis=1)
        turn = self.axes[rows, :2] @ plane.T
        return np.asarray(np.einsum("...i,...ij->...j", points + above, turn))


def _cover(pairs: Index, pressed: Mask) -> Mask:
    """(n,) rows without which nothing is left of pairs (2, p) of a rod and a contact that contradict each other.

    The row with the most contradictions goes first.  Rods that feel no force are known.
    """
    found = np.zeros(len(pressed), dtype=bool)
    while pairs.size:
        ends = np.concatenate([pairs[0][pressed[pairs[0]]], pairs[1]])
        row = int(np.bincount(ends).argmax())
        found[row] = True
        pairs = pairs[:, (pairs != row).all(axis=0)]
    return found


def _of(found: planar.Contacts, rows: Index) -> planar.Contacts:
    return replace(found, **{column.name: getattr(found, column.name)[rows] for column in fields(found)})


def _estimated_normals(cloud: Cloud) -> Array:
    """(n, 3) normals: in the slice's plane as they are known there, tilted as the contacts around lie; NaN where unknown."""
    normals = np.full((len(cloud), 3), np.nan)
    rows = np.flatnonzero(np.isfinite(cloud.in_plane_normals[:, 0]))
    count = min(12, len(cloud))
    near = cKDTree(cloud.points).query(cloud.points[rows], k=range(1, count + 1))[1]
    level, axis = cloud.in_plane_normals[rows], cloud.slice_axis[cloud.slice[rows]]
    offset = cloud.points[near] - cloud.points[rows, None]
    along, across = np.einsum("nki,ni->nk", offset, axis), np.einsum("nki,ni->nk", offset, level)
    spread = (along**2).sum(axis=1)
    tilt = ratio(-(along * across).sum(axis=1), spread)
    known = np.isfinite(tilt)
    tilted = level[known] + tilt[known, None] * axis[known]
    normals[rows[known]] = tilted / np.linalg.norm(tilted, axis=1, keepdims=True)
    return normals
