"""Paths of a clamp between sweeps that keep clear of a bounding body and of the table.

Every sweep lies behind a plane: no part of the straight rod is nearer to the body along the rod than where the rod's tip ends
when it is drawn back.  Rods that are drawn back behind the supporting plane of the bounding body across the rod stay there on
straight lines.  To turn from one direction to another, the clamp goes to a place that lies behind both planes by more than a
rod length, where the rod may turn without coming near the body.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from scan3d.arrays import Array, Index
from scan3d.planning.envelopes import Envelope
from scan3d.poses import Move

# Cosine of the angle between two rods that are as good as opposite: no place lies behind both of their planes.
_OPPOSITE = -0.98
_QUARTER = Rotation.from_rotvec([0.0, 0.0, np.pi / 2]).as_matrix()
# Sines of angles below which a rod does not turn.
_SAME = 1e-9


class Sweep(NamedTuple):
    """One sweep: where its clamp goes, in the user's unit."""

    position: Array
    """(n, 3)"""
    axes: Array
    """(3, 3) as rows."""


class Space(NamedTuple):
    """Where a clamp with a rod may go, lengths in the user's unit."""

    envelope: Envelope
    length: float
    """Of the rod."""
    margin: float
    """Distance that the rod keeps from the bounding body when it does not sweep."""
    floor: float
    """Height above which clamp and rod stay."""

    def behind(self, along: Array) -> float:
        """Coordinate along the direction `along` (3,) of a rod behind which its tip is clear of the bounding body."""
        return float((self.envelope.points() @ along).min()) - self.margin


class Path(NamedTuple):
    """Poses of all sweeps and of the paths between them."""

    sweep: Index
    position: Array
    axes: Array
    """(n, 3, 3)"""
    move: Index


def joined(sweeps: list[Sweep], space: Space, first: int = 0) -> Path:
    """All sweeps, each with its approach before it and its retract after it; numbered from `first`."""
    parts: list[tuple[int, Array, Array, Move]] = []
    previous: tuple[Array, Array] | None = None
    for number, (position, axes) in enumerate(sweeps, start=first):
        back = space.behind(axes[1])
        start = _drawn_back(position[0], axes, back, space)
        if previous is not None:
            places, turns = _turn(previous, (start, axes), space)
            parts += [(number, place, turn, Move.APPROACH) for place, turn in zip(places, turns, strict=True)]
        parts.append((number, start, axes, Move.APPROACH))
        parts += [(number, place, axes, Move.SWEEP) for place in position]
        end = _drawn_back(position[-1], axes, back, space)
        parts.append((number, end, axes, Move.RETRACT))
        previous = end, axes
    return Path(
        sweep=np.array([part[0] for part in parts]),
        position=np.array([part[1] for part in parts]),
        axes=np.array([part[2] for part in parts]),
        move=np.array([int(part[3]) for part in parts]),
    )


def _drawn_back(place: Array, axes: Array, back: float, space: Space) -> Array:
    """The place of a clamp that is drawn back along its rod, until the tip is behind the supporting plane."""
    return np.asarray(place - max(place @ axes[1] + space.length - back, 0.0) * axes[1])


def _turn(start: tuple[Array, Array], end: tuple[Array, Array], space: Space) -> tuple[list[Array], list[Array]]:
    """Places and axes at which the clamp turns on its path from one pose, drawn back, to another; none if it need not."""
    (_, before), (_, after) = start, end
    old, new = before[1], after[1]
    cosine = float(old @ new)
    across = np.cross(old, new)
    sine = float(np.linalg.norm(across))
    if sine < _SAME and cosine > 0:
        return [], []
    if cosine < _OPPOSITE:
        # both rods are nearly level, and no place lies behind both planes: a quarter of a turn first
        halfway = start[0], before @ _QUARTER.T
        parts = [_turn(start, halfway, space), _turn(halfway, end, space)]
        return [place for places, _ in parts for place in places], [axes for _, turns in parts for axes in turns]
    points = space.envelope.points()
    middle = (points.max(axis=0) + points.min(axis=0)) / 2
    # the place lies a rod length behind both planes
    depth = max(middle @ along - space.behind(along) for along in (old, new)) + space.length
    place = middle - depth / (1 + cosine) * (old + new)
    lowest = min(0.0, old[2], new[2], *(_between(old, new)[:, 2]))
    place[2] = max(place[2], space.floor - space.length * lowest)
    turned = before @ Rotation.from_rotvec(across / sine * np.arctan2(sine, cosine)).as_matrix().T
    return [place, place, place], [before, turned, after]


def _between(old: Array, new: Array) -> Array:
    """Unit vectors (n, 3) on the shorter arc from one to another."""
    part = np.linspace(0, 1, 33)[:, None]
    mixed = (1 - part) * old + part * new
    return np.asarray(mixed / np.linalg.norm(mixed, axis=1, keepdims=True))
