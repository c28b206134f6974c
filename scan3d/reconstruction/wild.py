"""Rows of a planar recording that contradict the rest: wild values, spikes, rows that are stuck.

In a slice of a convex body no contact lies beyond the tangent at another.  A row is judged by groups of its neighbours along
the contour: the median of a contact's distances beyond the tangents of a group, and that of the distances of a group's contacts
beyond a row's tangent, are at most zero, but for the noise.  The median does not follow wild rows among the neighbours, and has
little noise of its own, so that errors of some five standard deviations show.  Corners, friction and facets of the body do not
look like such rows, because a convex body may have them.

A rod that touches lightly, or not at all, shows a wild row as a touch of one or two rows.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from scan3d.arrays import Array, Index, Mask, ratio
from scan3d.cloud import Cloud, LeftOut
from scan3d.reconstruction.agreement import FALSE_ALARM, LARGEST_SHARE, Compared, compared_in_slices
from scan3d.reconstruction.errors import RIGHT_ROWS, felt, noise_in_air
from scan3d.recording import Recording

# Contacts of a group: the median follows none of the wild ones among them while these are fewer than half.
_GROUP = 8
# Standard deviations of the remaining rows for each that is stated: what is not seen of a wild row stays within κ of these.
_FACTOR = 1.5
# Standard deviations from which on a row is off, where the rows are judged that follow each other: 1 % of the right ones are.
# Small errors of gains, rods and clamps leave such beside half of the wild rows or more, independent errors beside 12 %.
_BESIDE = 3.0
# Rows of a touch at least.
_TOUCH = 3
# Passes, each without the rows that the ones before it have left out.
_PASSES = 10


def left_out(recording: Recording, cloud: Cloud) -> LeftOut | None:
    """The rows that contradict the rest; None if there are none, or if the noise is not known.

    `cloud` are the contacts of the recording, by the rod's centre line.  Where the rows are too many, or follow each other as
    those of a systematic error do, none is left out, but their share is said.
    """
    if not recording.noise.independent or not max(recording.noise_force_N, recording.noise_moment_Nm):
        return None
    noise = recording.noise.of_reactions(recording.rod)
    pressed = felt(recording.pressing(six_axis=False), noise)
    size = noise_in_air(recording).size
    limit, strict = (-(size or 1.0) * ndtri(chance / (2 * max(len(cloud), 1))) for chance in (RIGHT_ROWS, FALSE_ALARM))
    value, short = _numbered(recording), _short(recording.sweep, pressed)
    beyond = np.full(len(recording), -np.inf)
    for compared in compared_in_slices(cloud):
        rows = cloud.row[compared.rows]
        beyond[rows] = _beyond_neighbours(compared, cloud, value[rows], short[rows], limit)
    wild = np.isin(value, value[beyond > limit])
    if not wild.any() and size is None:
        return None
    left = np.flatnonzero(wild | short)
    share = float(pressed[left].sum() / pressed.sum())
    if share <= LARGEST_SHARE and _alone(recording.sweep, value, wild, beyond > _BESIDE):
        return LeftOut(left, share, _FACTOR * (size or 1.0))
    # what no right recording has must be explained, or nothing is certified
    return LeftOut(np.empty(0, dtype=np.intp), share, 1.0) if (beyond > strict).any() else None


def _numbered(recording: Recording) -> Index:
    """(n,) numbers of the rows' reactions, which rows that repeat the one before have in common."""
    reactions = np.column_stack([recording.sweep, recording.force_N, recording.moment_Nm])
    order = np.argsort(recording.sweep, kind="stable")
    number = np.empty(len(order), dtype=np.intp)
    number[order] = np.cumsum(np.append(True, (np.diff(reactions[order], axis=0) != 0).any(axis=1)))
    return number


def _alone(sweep: Index, value: Index, wild: Mask, off: Mask) -> bool:
    """Whether beside two thirds of the wild values none is `off`, as errors are that are independent from row to row."""
    order = np.argsort(sweep, kind="stable")
    first = order[np.append(True, np.diff(value[order]) != 0)]
    off, same = off[first], np.diff(sweep[first]) == 0
    beside = np.append(off[1:] & same, False) | np.append(False, off[:-1] & same)
    return bool(3 * beside[wild[first]].sum() <= wild[first].sum())


def _short(sweep: Index, pressed: Mask) -> Mask:
    """(n,) the rows with a force whose touch has too few rows."""
    order = np.argsort(sweep, kind="stable")
    force, number = pressed[order], sweep[order]
    begins = np.flatnonzero(np.append(True, (np.diff(number) != 0) | (np.diff(force.astype(np.int8)) != 0)))
    length = np.diff(np.append(begins, len(order)))
    short = np.zeros(len(order), dtype=bool)
    short[order] = force & np.repeat(length < _TOUCH, length)
    return short


def _beyond_neighbours(compared: Compared, cloud: Cloud, value: Index, short: Mask, limit: float) -> Array:
    """(n,) how far contacts of a slice and groups of their neighbours contradict each other, in standard deviations.

    The groups are of rows that do not contradict the others by more than the limit, nor have the same `value` (n,) as such
    ones, nor, where there are such, are those of `short` touches (n,).
    """
    assert cloud.covariance is not None
    assert cloud.normal_sd is not None
    lines, some = compared.lines, compared.some
    beyond, pairs = compared.misfit.found - compared.systematic, compared.misfit.found > compared.misfit.explained
    others, own, turned = (
        part**2 for part in compared.deviations(compared.errors(1.0, cloud.covariance, cloud.normal_sd))
    )
    of_line, trusted, refuted = own + turned, np.ones(len(value), dtype=bool), np.zeros(len(value), dtype=bool)
    for _ in range(_PASSES):
        known = trusted[lines], trusted[some]
        of_lines, of_points = _groups(compared.points[lines], known[0]), _groups(compared.points[some], known[1])
        # where nothing is left to judge by, what is not trusted stays so
        found = np.where(trusted | bool(len(of_lines) or len(of_points)), -np.inf, np.inf)
        by_lines, wrong_lines = _over_groups(beyond, others, of_line, of_lines, limit)
        by_points, wrong_points = _over_groups(beyond.T, of_line.T, others.T, of_points, limit)
        found[some] = np.maximum(found[some], by_lines)
        found[lines] = np.maximum(found[lines], by_points)
        rows, columns = _contradicted(pairs & known[0][:, None] & known[1])
        refuted[lines[rows]] = refuted[some[columns]] = True
        found[lines[wrong_lines]] = found[some[wrong_points]] = np.inf
        found[lines[~known[0] & (pairs & known[1]).any(axis=1)]] = np.inf
        found[some[~known[1] & (pairs & known[0][:, None]).any(axis=0)]] = np.inf
        found[refuted] = np.inf
        wild = np.isin(value, value[found > limit])
        if not (wild & trusted).any():
            break
        trusted &= ~(wild | short)
    return found


def _contradicted(pairs: Mask) -> tuple[Index, Index]:
    """Numbers of the rows and columns with most of the pairs (k, m), without which there are none."""
    left, rows, columns = pairs.copy(), [], []
    while left.any():
        of_row, of_column = left.sum(axis=1), left.sum(axis=0)
        row, column = int(of_row.argmax()), int(of_column.argmax())
        if of_row[row] >= of_column[column]:
            rows.append(row)
            left[row] = False
        if of_column[column] >= of_row[row]:
            columns.append(column)
            left[:, column] = False
    return np.array(rows, dtype=np.intp), np.array(columns, dtype=np.intp)


# Variance of the median of many normal numbers over that of their mean.
_MEDIAN = np.pi / 2


def _over_groups(beyond: Array, common: Array, own: Array, groups: Index, limit: float) -> tuple[Array, Index]:
    """(m,) the largest median of distances (k, m) over groups (g, s) of the rows, in standard deviations, and wrong rows.

    Of the variances (k, m) one part is common to a group, and each row has one of its own.  A group that contradicts more
    columns than it has rows is wrong itself.
    """
    variance = common[groups].mean(axis=1) + _MEDIAN / groups.shape[1] * own[groups].mean(axis=1)
    found = ratio(np.median(beyond[groups], axis=1), np.sqrt(variance))
    wrong = (found > limit).sum(axis=1) > groups.shape[1]
    return np.asarray(found[~wrong].max(axis=0, initial=-np.inf)), groups[wrong].ravel()


def _groups(points: Array, chosen: Mask) -> Index:
    """(g, s) neighbours along the contour of some of the contacts; none where these are too few."""
    away, count = points - points.mean(axis=0), int(chosen.sum())
    order = np.argsort(np.arctan2(away[:, 1], away[:, 0]), kind="stable")
    order, size = order[chosen[order]], min(_GROUP, max(count, 1))
    first = np.linspace(0, count - size, max(1, count // _GROUP) if 2 * size >= _GROUP else 0)
    return np.asarray(order[first.astype(np.intp)[:, None] + np.arange(size)])
