"""Means of contacts over successive rows of a sweep, and over the runs of several sweeps that lie beside each other."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, chdtri

from scan3d.arrays import Array, Index

# Successive rows of a sweep that are averaged.  More sizes need more time; fewer leave errors that larger or smaller averages
# would reduce.
AVERAGED = (2, 4, 16, 64)
# Averages of one size in a slice, about, from which that size is left out: very many contacts.  More take more time and memory;
# fewer leave out the small averages of dense slices, which follow sharp curves.
_MOST_RUNS = 1000
# Runs of one other sweep that may lie nearest to a run, whatever the errors.  Larger, averages over sweeps are less accurate;
# smaller, the errors may choose among more runs than are counted.
_CANDIDATES = 3.0


class Averages(NamedTuple):
    """Weighted means over several rows, as a list of terms: mean k has the terms with ``group == k``."""

    row: Index
    """(t,)"""
    group: Index
    """(t,) increasing"""
    weight: Array
    """(t,) of sum 1 in each group"""
    kappa: Array
    """(g,) standard deviations within which all these means stay"""

    def mean(self, values: Array) -> Array:
        """(g, ...) means of values (n, ...)."""
        return self._sums(values[self.row] * self._shaped(self.weight, values))

    def variance(self, values: Array) -> Array:
        """(g, ...) variances of the means of independent quantities with variances (n, ...)."""
        return self._sums(values[self.row] * self._shaped(self.weight**2, values))

    def _sums(self, terms: Array) -> Array:
        if not len(self.kappa):
            return terms
        sums: Array = np.add.reduceat(terms, np.searchsorted(self.group, np.arange(len(self.kappa))))
        return sums

    @staticmethod
    def _shaped(weight: Array, values: Array) -> Array:
        return weight.reshape(-1, *[1] * (values.ndim - 1))


def averages_of(points: Array, sweep: NDArray[np.int32] | None, variance: Array, kappa: float) -> Averages:
    """Means over successive rows of each sweep, and over such runs of several sweeps that lie beside each other.

    Runs are fixed by the order of the rows, so that the errors do not choose what is averaged.  Which runs of other sweeps lie
    beside one is judged by the noisy points; each has at most `_CANDIDATES` for that, which κ allows for.  The weights are
    inverse to the variances (n,).  There are no means where `sweep` is None, because the errors are not independent.
    """
    if sweep is None:
        return Averages(np.empty(0, dtype=np.intp), np.empty(0, dtype=np.intp), np.empty(0), np.empty(0))
    largest = float(variance.max(initial=0.0))
    # noise far below rounding may underflow to variances of 0
    scaled = np.maximum(variance / largest, np.finfo(float).tiny) if largest > 0 else np.ones(len(variance))
    rows, groups, weights, kappas, count = [], [], [], [], 0
    start = np.flatnonzero(np.diff(sweep, prepend=sweep[:1] - 1))
    within = np.arange(len(sweep)) - np.repeat(start, np.diff(start, append=len(sweep)))
    for size in AVERAGED:
        if len(points) > size * _MOST_RUNS and size != AVERAGED[-1]:
            continue
        run = np.cumsum(within % size == 0) - 1
        number = np.bincount(run)
        middle = np.stack([np.bincount(run, column) for column in points.T], axis=1) / number[:, None]
        half = np.sqrt(np.bincount(run, ((points - middle[run]) ** 2).sum(axis=1)) / number)
        first = np.searchsorted(run, np.arange(len(number)))
        beside = _beside(middle, 2 * half, sweep[first])
        members = [np.arange(len(number))[:, None], np.column_stack([np.arange(len(number)), beside])]
        for runs in members:
            own, other = np.nonzero(runs >= 0)
            other = runs[own, other]
            repeated = number[other]
            offset = np.arange(repeated.sum()) - np.repeat(np.cumsum(repeated) - repeated, repeated)
            row = np.repeat(first[other], repeated) + offset
            group = np.repeat(own, repeated)
            weight = 1 / scaled[row]
            rows.append(row)
            groups.append(group + count)
            weights.append(weight / np.bincount(group, weight)[group])
            choices = _CANDIDATES ** np.maximum((runs >= 0).sum(axis=1) - 1.0, 0)
            kappas.append(_widened(kappa, choices))
            count += len(number)
    return Averages(np.concatenate(rows), np.concatenate(groups), np.concatenate(weights), np.concatenate(kappas))


def _beside(middle: Array, reach: Array, sweep: NDArray[np.int32]) -> Index:
    """(r, s) the nearest run of each other sweep, -1 where it is farther than `reach` (r,) or of the same sweep."""
    beside = []
    for number in np.unique(sweep):
        runs = np.flatnonzero(sweep == number)
        distance = np.linalg.norm(middle[:, None] - middle[runs], axis=2)
        nearest = distance.argmin(axis=1)
        close = (distance[np.arange(len(middle)), nearest] <= reach) & (sweep != number)
        beside.append(np.where(close, runs[nearest], -1))
    return np.stack(beside, axis=1)


def _widened(kappa: float, choices: Array) -> Array:
    """κ for events of which there are `choices` (k,) as many."""
    widened: Array = np.sqrt(chdtri(3, chdtrc(3, kappa**2) / choices))
    return widened
