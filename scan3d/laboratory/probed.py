"""Probings in what a rig has logged: where the clamp has moved straight along its own +y axis until it felt something.

The log's own word for a move says which rows these are.  Else poses and forces tell.  A sweep that is numbered is a probing if
the clamp moves along +y in it; in a log without numbers a stroke along +y is one if the clamp goes straight back after it.
Approaches of sweeps are along +y as well, but a sweep follows them.  A map that takes the line of the sweeps for the rod makes
sweeps look like probings; but they go on in contact, and a clamp that probes stops.

Rows in which the clamp waits at its end are part of a probing, because the force is felt there, and its way back is not.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scan3d.arrays import NEGLIGIBLE, Array, Index, Mask
from scan3d.errors import InputError
from scan3d.laboratory.logs import OVER_JITTER, ends, jitter_of, strokes

# How far a clamp that probes goes on once a force is felt, at most, in rod lengths.  An end that slides down a steep face goes
# on by a thirtieth, and sweeps go on for longer.
_GOES_ON = 0.1
# The largest force of a rod that is pushed along itself, in EI/L²: more buckles it.
_BUCKLES = np.pi**2 / 4
# Tangent of the largest angle between a probing and the clamp's y axis, as between a sweep and its x axis.
_ASIDE = 0.3
# How far aside the clamp goes at most before it goes back, in rod lengths: less than in a sweep.
_TURNS = 0.02


class Poses(NamedTuple):
    """Where the clamp is in n rows, and whether something is felt."""

    position: Array
    """(n, 3) in metres."""
    quaternion: Array
    """(n, 4)"""
    force: Array
    """(n,) that of the contact in EI/L², 0 where none is felt."""
    length: float
    """Of the rod, in metres."""

    @property
    def slack(self) -> float:
        """How far positions may be off one another where the clamp stands."""
        return max(OVER_JITTER / 4 * jitter_of(self.position, self.length), NEGLIGIBLE * self.length)


class _Forward(NamedTuple):
    """A motion that may be a probing."""

    rows: Index
    """(k,) up to where the clamp turns back."""
    straight: bool
    """Whether it is along +y."""
    feels: bool
    """Whether something is felt."""
    stops: bool
    """Whether it is felt near the end only, as by a clamp that stops then."""


def of_numbers(poses: Poses, sweep: NDArray[np.int64]) -> tuple[NDArray[np.int64], Mask]:
    """Numbered sweeps (n,) without the ways back of probings, and the rows (n,) of probings among them."""
    slack = poses.slack
    motions = [_forward(poses, rows, slack) for rows in _groups(sweep)]
    found = _told([motion for motion in motions if motion.straight])
    return _cut(sweep, found), _rows_of(found, len(sweep))


def of_moves(
    poses: Poses, sweep: NDArray[np.int64], probe: Mask, where: str
) -> tuple[NDArray[np.int64], Mask, list[str]]:
    """As `of_numbers` of a log, with the name `where`, whose moves say which rows (n,) are probings; and notes.

    Raises InputError if most of these are not straight along +y of the clamp.
    """
    slack = poses.slack
    motions = [_forward(poses, rows, slack) for rows in _groups(sweep) if probe[rows[0]]]
    found = [motion for motion in motions if motion.straight]
    left = len(motions) - len(found)
    if 2 * left > len(motions):
        raise InputError(
            f"{where}: in {left} of {len(motions)} runs of rows with the move probe the clamp does not go straight along +y of "
            "its own frame; correct the column of the move, or orientation, position and [clamp] in the map"
        )
    kept = _rows_of(found, len(sweep))
    note = f"{left} probings are left out, because the clamp does not go straight along +y of its own frame in them"
    return np.where(probe & ~kept, -1, sweep), kept, [note] if left else []


def of_strokes(poses: Poses) -> list[Index]:
    """The rows of each probing of a log that numbers neither sweeps nor moves, in order."""
    return [motion.rows for motion in _told([motion for motion in _there_and_back(poses) if motion.straight])]


def ends_of(position: Array, quaternion: Array, length: float) -> Mask:
    """The rows (n,) in which a clamp that went along +y has come to its end, from which it goes straight back.

    In a log of probings the rod may touch there, and nowhere else.
    """
    found = np.zeros(len(position), dtype=bool)
    poses = Poses(position, quaternion, np.zeros(len(position)), length)
    slack = poses.slack
    for motion in _there_and_back(poses):
        away = np.linalg.norm(position[motion.rows] - position[motion.rows[-1]], axis=1)
        found[motion.rows[away <= 2 * slack]] = True
    return found


def _there_and_back(poses: Poses) -> list[_Forward]:
    """The strokes along +y of a log after which the clamp goes straight back, or the log ends."""
    stroke, forth = strokes(poses.position, poses.quaternion, poses.length, axis=1)
    _, first, last = ends(stroke)
    if not len(first):
        return []
    slack = poses.slack
    following = np.append(first[1:], len(stroke) - 1)
    axes = Rotation.from_quat(poses.quaternion[last], scalar_first=True).as_matrix()
    moved = np.einsum("ni,nij->nj", poses.position[following] - poses.position[last], axes)
    aside = np.hypot(moved[:, 0], moved[:, 2])
    turns = forth & ~np.append(forth[1:], False) & (aside <= max(4 * slack, _TURNS * poses.length))
    stop = np.append(last[1:], len(stroke) - 1)
    return [_forward(poses, np.arange(first[k], stop[k] + 1), slack) for k in np.flatnonzero(turns)]


def _told(straight: list[_Forward]) -> list[_Forward]:
    """The probings among motions along +y: none unless most of those that feel something stop there."""
    feel = [motion for motion in straight if motion.feels]
    if not feel or 2 * sum(motion.stops for motion in feel) <= len(feel):
        return []
    return [motion for motion in straight if motion.stops or not motion.feels]


def _forward(poses: Poses, rows: Index, slack: float) -> _Forward:
    """The part of a motion's rows (k,) up to where the clamp turns back along its y axis."""
    axes = Rotation.from_quat(poses.quaternion[rows[0]], scalar_first=True).as_matrix()
    moved = (poses.position[rows] - poses.position[rows[0]]) @ axes
    along = moved[:, 1]
    end = int(np.flatnonzero(along >= along.max() - slack)[-1])
    aside = np.hypot(moved[: end + 1, 0], moved[: end + 1, 2]).max()
    straight = along[end] > 4 * slack and aside <= _ASIDE * along[end] + slack
    force = poses.force[rows[: end + 1]]
    felt = np.flatnonzero(force)
    if not len(felt):
        return _Forward(rows[: end + 1], bool(straight), feels=False, stops=False)
    goes_on = np.linalg.norm(moved[end] - moved[felt[0]])
    stops = felt[0] > 0 and goes_on <= _GOES_ON * poses.length and force.max() <= _BUCKLES
    return _Forward(rows[: end + 1], bool(straight), feels=True, stops=bool(stops))


def _groups(sweep: NDArray[np.int64]) -> list[Index]:
    """The rows of each sweep of numbers (n,), of which negative ones are none."""
    rows = np.argsort(sweep, kind="stable")
    rows = rows[np.searchsorted(sweep[rows], 0) :]
    return np.split(rows, np.flatnonzero(np.diff(sweep[rows])) + 1) if len(rows) else []


def _rows_of(motions: Sequence[_Forward], count: int) -> Mask:
    found = np.zeros(count, dtype=bool)
    for motion in motions:
        found[motion.rows] = True
    return found


def _cut(sweep: NDArray[np.int64], motions: Sequence[_Forward]) -> NDArray[np.int64]:
    """The numbers (n,) of sweeps of which some end where a motion does."""
    ended = np.isin(sweep, [sweep[motion.rows[0]] for motion in motions])
    return np.where(ended & ~_rows_of(motions, len(sweep)), -1, sweep)
