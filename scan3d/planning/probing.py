"""Where a rod is sent along itself: by what of a body is unknown, of which nothing but contacts and free places is known.

On a grid over the box around the body a cell is believed to be of the body if a place just inside a contact is nearer than a
free one.  What the border of these cells lacks is a contact nearby.  The border is looked at from many directions, turned at
random from round to round: the first cell on each line is what a probing along it would touch.  A plane along the direction is
a line of that image, so that the best plane is the maximum of the image's Radon transform.  In it probings come from a few
directions, side by side.  A place counts for less the more often it was aimed at, because no rod may reach it.

The planner believes, and the rod feels: a probing through what is believed to be free gives a contact where it is not.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from scan3d.arrays import NEGLIGIBLE, OCTANTS, Array, Index, Mask, ranges
from scan3d.cloud import TOUCHED
from scan3d.geometry.sections import slice_frame
from scan3d.poses import AWAY
from scan3d.spatial.bodies import sphere_directions

# Size of the grid's cells, relative to the diagonal of the box: two are as wide as a place that is touched.  Cells around it.
_CELL, _MARGIN = TOUCHED / 2, 2
# How far apart the probings in a plane are, relative to the diagonal.
_APART = 0.015
# Directions, and those of them that are looked along in a round, as places tell, of which so many are asked; angles of the
# planes along each of them; directions in a plane, and how many of them are probed along, the first one included.
_DIRECTIONS, _LOOKED_AT, _ASKED, _ANGLES, _IN_PLANE, _PROBED = 192, 20, 256, 24, 16, 4
_TURNS = np.pi / _ANGLES * np.arange(_ANGLES)
# Directions that are looked along again in the next round, turned by so much in radians, because most was seen along them.
_BEST, _BESIDE = 8, 0.1
# Gain of a place without a contact nearby, at most, in multiples of that of one as far from a contact as counts as near.
_MOST = 3.0
# Half the width of a cell in an image, in pixels.
_HALF = 0.2
# Gain of a row of probings, at least: about as much as two places far from any contact; or, where no row gains that, of one.
_LEAST, _LAST = 2.5, 1.0
# Components of axes that differ by no more are those of one plane.
_ALIKE = 0.01
# Digits of places in cells and of gains that decide: rounding does not.
_DIGITS = 6
PLANES = 3
"""Planes in which a scan probes at most, for each slice that is asked for."""
PER_ROUND = 8
"""Planes that are planned at once."""


class Probings(NamedTuple):
    """Moves (n,) of a clamp along its y axis, in one unit of length."""

    start: Array
    """(n, 3) where the clamp begins."""
    axes: Array
    """(n, 3, 3) its axes in the world, as rows."""
    travel: Array
    """(n,) how far it goes, if nothing is felt."""


class Planned(NamedTuple):
    """The probings of a round, and the number of planes in which they are."""

    moves: Probings
    planes: int


class _Image(NamedTuple):
    """What is seen along a direction, in pixels as large as a cell."""

    normals: Array
    """(a, 3) those of the planes along the direction."""
    rows: Index
    """(p,) numbers of the places that are seen."""
    offset: Index
    """(a, p) number of the plane in which each place is, for each of the normals."""
    least: Index
    """(a,) where the first of these planes is, in pixels."""


class Unknown:
    """What is unknown of a body in a box, and the probings that gain most."""

    def __init__(
        self,
        low: Array,
        high: Array,
        length: float,
        seed: Sequence[int] = (0,),
        floor: float = -np.inf,
        away: float | None = None,
    ) -> None:
        """The box from `low` to `high` (3,), and the length of the rod, in one unit.

        Clamp and rod stay above the height `floor`, and the clamp's distance `away` from the hull.
        """
        self._low, self._high, self._length, self._floor = low, high, length, floor
        self._away = AWAY * length if away is None else away
        self._diagonal = float(np.linalg.norm(high - low))
        self._cell = _CELL * self._diagonal
        shape = np.ceil(np.round((high - low) / self._cell, _DIGITS)).astype(int) + 2 * _MARGIN
        self._origin = (low + high) / 2 - (shape - 1) / 2 * self._cell
        self._free, self._inside = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool)
        self._tried = np.zeros(shape, dtype=np.int32)
        self._contacts = np.empty((0, 3))
        self._random = np.random.default_rng([*seed, 4])
        self._best_seen = np.empty((0, 3))

    def add(self, points: Array, inward: Array, lines: Array) -> None:
        """Add contacts (n, 3) with unit vectors (n, 3) into the body, and lines (m, 2, 3) that are free."""
        self._contacts = np.concatenate([self._contacts, points])
        self._mark(self._inside, points + 0.9 * self._cell * inward)
        reach = np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1)
        count = np.ceil(np.round(2 * reach / self._cell, _DIGITS)).astype(np.intp)
        line, rank = ranges(count)
        # a contact at the end is not free
        part = (rank / count[line])[:, None]
        self._mark(self._free, lines[line, 0] + part * (lines[line, 1] - lines[line, 0]))

    def aimed(self, start: Array, axes: Array) -> None:
        """Count what probings (n) aimed at whose clamps, with axes (n, 3, 3), began at places (n, 3).

        Those side by side in a plane follow each other, and count once, however noisy their poses are.
        """
        cells, _, _ = self._border()
        places = self._origin + self._cell * cells
        height = np.einsum("ni,ni->n", axes[:, 2], start)
        turned = np.abs(np.diff(axes, axis=0)).max(axis=(1, 2)) > _ALIKE
        moved = np.abs(np.diff(height)) > self._cell / 2
        for k in np.flatnonzero(np.append(True, turned | moved)[: len(start)]):
            normal, along = axes[k, 2], axes[k, 1]
            near = np.flatnonzero(np.round(np.abs(places @ normal - height[k]) / self._cell, _DIGITS) <= 0.5)
            self._tried[tuple(cells[self._first(places, near, normal, along)].T)] += 1

    def _mark(self, cells: Mask, places: Array) -> None:
        index = _whole((places - self._origin) / self._cell)
        inside = ((index >= 0) & (index < cells.shape)).all(axis=1)
        cells[tuple(index[inside].T)] = True

    def first_round(self) -> Planned:
        """Three planes across each axis, in each of which probings come from six directions."""
        found = []
        for axis in np.eye(3):
            frame = slice_frame(axis)
            # in thirds, but not where bodies have faces and edges
            for part in (np.arange(3) + self._random.uniform(0.3, 0.7, 3)) / 3:
                height = float((self._low + part * (self._high - self._low)) @ axis)
                directions = [np.cos(angle) * frame[0] + np.sin(angle) * frame[1] for angle in np.pi / 3 * np.arange(6)]
                found += [self._row(axis, height, along) for along in self._allowed(np.array(directions))]
        return _together(found, 9)

    def known(self) -> float:
        """The share of the border of what is believed to be of the body that has a contact nearby."""
        _, gain, _ = self._border()
        return float((gain == 0).mean()) if len(gain) else 0.0

    def next_round(self, most: int = PER_ROUND) -> Planned:
        """The probings in at most so many planes that gain most; none if nothing is left to gain."""
        planned = self._along(_LEAST, most)
        # through a narrow neck few directions lead, and from each little is seen
        return planned if planned.planes else self._along(_LAST, most)

    def _along(self, least: float, most: int) -> Planned:
        """The probings in planes in which rows gain so much."""
        cells, gain, body = self._border()
        if not gain.any():
            return _together([], 0)
        places = self._origin + self._cell * cells
        turn = Rotation.random(rng=self._random).as_matrix()
        beside = Rotation.from_rotvec(self._random.normal(0, _BESIDE, (len(self._best_seen), 3)))
        directions = np.concatenate([(turn @ sphere_directions(_DIRECTIONS)).T, beside.apply(self._best_seen)])
        directions = self._promising(self._allowed(directions), cells, gain, body)
        seen = [self._seen(places, along) for along in directions]
        # through a narrow neck few directions lead, and those beside them see more
        value = [float(gain[image.rows].sum()) for image in seen]
        self._best_seen = directions[np.argsort(np.round(value, _DIGITS), kind="stable")[-_BEST:]]
        found: list[Probings] = []
        for number in range(most):
            best = [self._best(image, gain) for image in seen]
            k = int(np.argmax(np.round([total for total, *_ in best], _DIGITS)))
            total, normal, height = best[k]
            if total < least:
                most = number
                break
            near = np.flatnonzero(np.round(np.abs(places @ normal - height) / self._cell, _DIGITS) <= 0.5)
            for along in self._directions(places, gain, near, normal, directions[k]):
                rows = self._first(places, near, normal, along)
                self._tried[tuple(cells[rows].T)] += 1
                gain[rows] = 0.0
                found.append(self._row(normal, height, along, places))
        return _together(found, most)

    def _allowed(self, directions: Array) -> Array:
        """Those of the directions (n, 3) in which a rod that comes from outside stays above the floor: not upwards."""
        return directions[directions[:, 2] <= NEGLIGIBLE] if np.isfinite(self._floor) else directions

    def _promising(self, directions: Array, cells: Index, gain: Array, body: Mask) -> Array:
        """Those of directions (n, 3) along which most is gained, as told by some of the border's cells (b, 3): which of the
        directions lead there, free of the cells of the body.  What one direction sees counts for less in the others."""
        asked = self._random.choice(len(cells), min(_ASKED, int((gain > 0).sum())), replace=False, p=gain / gain.sum())
        start, shape = cells[asked], np.array(body.shape)
        free = np.ones((len(asked), len(directions)), dtype=bool)
        ray = np.arange(free.size)
        for step in 1 + np.arange(2 * int(np.linalg.norm(shape))) / 2:
            of, along = np.divmod(ray, len(directions))
            index = _whole(start[of] - (step + 0.5) * directions[along])
            inside = ((index >= 0) & (index < shape)).all(axis=1)
            ray, index = ray[inside], index[inside]
            hit = body[tuple(index.T)]
            free.flat[ray[hit]] = False
            ray = ray[~hit]
            if not len(ray):
                break
        chosen: list[int] = []
        left = gain[asked]
        for _ in range(min(_LOOKED_AT, len(directions))):
            value = np.round(left @ free, _DIGITS)
            value[chosen] = -1.0
            chosen.append(int(value.argmax()))
            left = np.where(free[:, chosen[-1]], left / 2, left)
        return directions[chosen]

    def _border(self) -> tuple[Index, Array, Mask]:
        """The cells (b, 3) of the border, what a contact there gains (b,), and the cells of the body."""
        to_free = ndimage.distance_transform_edt(~self._free) if self._free.any() else np.inf
        body = self._inside.copy()
        if self._inside.any():
            body = ndimage.distance_transform_edt(~self._inside) <= to_free
        border = body & ~ndimage.binary_erosion(body)
        cells = np.argwhere(border)
        distance, near = np.full(len(cells), np.inf), TOUCHED * self._diagonal
        if len(self._contacts) and len(cells):
            near = TOUCHED * float(np.linalg.norm(np.ptp(self._contacts, axis=0)))
            distance = cKDTree(self._contacts).query(self._origin + self._cell * cells)[0]
        distance = np.round(distance / near, _DIGITS) * near
        gain = np.where(distance > near, np.minimum(distance / near, _MOST), 0.0)
        return cells, gain * 0.5 ** self._tried[tuple(cells.T)], body

    def _seen(self, places: Array, along: Array) -> _Image:
        """The image of places along a direction: of those in the same pixel the first one."""
        frame = slice_frame(along)
        flat = places @ frame.T
        first, pixel = self._nearest(flat[:, :2], flat[:, 2])
        turned = np.stack([np.cos(_TURNS), np.sin(_TURNS)], axis=1)
        offset = _whole(turned @ pixel.T)
        least = offset.min(axis=1) if len(first) else np.zeros(len(offset), dtype=np.int64)
        offset -= least[:, None]
        return _Image(turned @ frame[:2], first, offset, least)

    def _nearest(self, flat: Array, depth: Array) -> tuple[Index, Index]:
        """Of places in the same pixels (n, k) the first one, if nothing hides it and rods reach it, and its pixel."""
        flat, depth = flat / self._cell, np.round(depth / self._cell, _DIGITS)
        if not len(flat):
            return np.empty(0, dtype=np.int64), np.empty(flat.shape, dtype=np.int64)
        # cells hide what is behind them also where their middles are in other pixels, so that no wall has holes
        pixel, *ends = (_whole(flat + beside) for beside in (0.0, -_HALF, _HALF))
        least = ends[0].min(axis=0)
        shape = ends[1].max(axis=0) - least + 1
        rows_of = np.cumprod([1, *shape[:0:-1]])[::-1]
        key = (pixel - least) @ rows_of
        # (2 or 4, n) the pixels of the corners of a square around each place
        covered = np.zeros((1, len(flat)), dtype=np.int64)
        for low, high, row in zip(*((end - least).T for end in ends), rows_of, strict=True):
            covered = np.concatenate([covered + row * low, covered + row * high])
        nearest = np.full(int(np.prod(shape)), np.inf)
        np.minimum.at(nearest, covered.ravel(), np.tile(depth, len(covered)))
        # rods end where the clamp comes near the hull
        reached = depth - depth.min() <= (self._length - self._away) / self._cell
        rows = np.flatnonzero((depth <= nearest[key] + 1) & reached)
        rows = rows[np.argsort(depth[rows], kind="stable")]
        # the first one of each pixel is written last
        first = np.full(len(nearest), -1)
        first[key[rows[::-1]]] = rows[::-1]
        first = first[first >= 0]
        return first, pixel[first]

    def _best(self, image: _Image, gain: Array) -> tuple[float, Array, float]:
        """The largest gain of a plane along a direction, its normal (3,) and its height."""
        value = gain[image.rows]
        some = np.flatnonzero(value)
        offset, size = image.offset[:, some], int(image.offset.max(initial=0)) + 1
        number = offset + size * np.arange(_ANGLES)[:, None]
        total = np.bincount(number.ravel(), np.tile(value[some], _ANGLES), _ANGLES * size)
        angle, most = divmod(int(np.round(total, _DIGITS).argmax()), size)
        height = float((most + image.least[angle]) * self._cell)
        return float(total.max(initial=0.0)), image.normals[angle], height

    def _directions(self, places: Array, gain: Array, near: Index, normal: Array, first: Array) -> list[Array]:
        """Directions in a plane, the `first` among them, along which probings gain most."""
        gain, across = gain.copy(), np.cross(normal, first)
        angles = 2 * np.pi / _IN_PLANE * np.arange(1, _IN_PLANE)
        others = self._allowed(np.cos(angles)[:, None] * first + np.sin(angles)[:, None] * across)
        chosen = [first]
        gain[self._first(places, near, normal, first)] = 0.0
        seen = [self._first(places, near, normal, along) for along in others]
        while len(chosen) < _PROBED and len(others):
            gains = [float(gain[rows].sum()) for rows in seen]
            best = int(np.argmax(np.round(gains, _DIGITS)))
            if gains[best] < _LEAST:
                break
            chosen.append(others[best])
            gain[seen[best]] = 0.0
        return chosen

    def _first(self, places: Array, near: Index, normal: Array, along: Array) -> Index:
        """The places near a plane that probings along a direction in it would touch first."""
        some = places[near]
        return near[self._nearest((some @ np.cross(normal, along))[:, None], some @ along)[0]]

    def _row(self, normal: Array, height: float, along: Array, places: Array | None = None) -> Probings:
        """Probings side by side in a plane across `normal`, through all of the box, or past all places (p, 3) near it."""
        # the clamp moves along its y axis in the plane of its x and y axes
        axes = np.stack([np.cross(along, normal), along, normal])
        corners = self._origin + self._cell * (OCTANTS + 1) / 2 * (np.array(self._free.shape) - 1)
        low, high = (corners @ axes.T).min(axis=0), (corners @ axes.T).max(axis=0)
        first, last = float(low[0]), float(high[0])
        if places is not None:
            near = places[np.round(np.abs(places @ normal - height) / self._cell, _DIGITS) <= 1.5] @ axes[0]
            first, last = float(near.min()) - _MARGIN * self._cell, float(near.max()) + _MARGIN * self._cell
        apart = _APART * self._diagonal
        count = int(np.ceil(np.round((last - first) / apart, _DIGITS))) + 1
        # not at the same places in planes side by side
        x = (first + last) / 2 + apart * (np.arange(count) - (count - 1) / 2 + self._random.uniform(-0.5, 0.5))
        begin = low[1] - self._length - self._away
        travel = np.full(count, min(high[1] - self._length, low[1] - self._away) - begin)
        start = np.stack([x, np.full(count, begin), np.full(count, height)], axis=1) @ axes
        rises = float(along[2])
        if np.isfinite(self._floor) and rises < -NEGLIGIBLE:
            travel = np.minimum(travel, (start[:, 2] - self._floor) / -rises - self._length)
        lowest = start[:, 2] + self._length * min(rises, 0.0)
        some = (travel > 0) & (lowest >= self._floor - NEGLIGIBLE * self._length)
        return Probings(start[some], np.broadcast_to(axes, (count, 3, 3))[some], travel[some])


def _together(rows: list[Probings], planes: int) -> Planned:
    nothing = Probings(np.empty((0, 3)), np.empty((0, 3, 3)), np.empty(0))
    if not any(len(row.travel) for row in rows):
        return Planned(nothing, 0)
    return Planned(Probings(*(np.concatenate(columns) for columns in zip(*rows, strict=True))), planes)


def _whole(values: Array) -> Index:
    """The nearest whole numbers, of values that rounding may have moved to either side of a half alike."""
    return np.round(np.round(values, _DIGITS)).astype(np.int64)
