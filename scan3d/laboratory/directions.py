"""Whether the clamp moves as its orientation says: sweeps are along -x of its frame.

Where most are not, other ways to read the orientation are tried, and the one with which they are is named.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from scan3d.arrays import Array, Mask
from scan3d.errors import InputError
from scan3d.laboratory import segments
from scan3d.laboratory.columns import read_log
from scan3d.laboratory.maps import Map
from scan3d.laboratory.tables import RawTable

# Angle in radians to the x axis within which a sweep is along it.
_ALONG = 0.3
# Fraction of the sweeps along -x, below which the orientation counts as wrong, and with another reading, above which that
# counts as right.
_FEW, _MOST = 0.5, 0.9
# Fraction of the rows in contact that strokes found by motion hold at least; the others belong to retracts and strokes back.
# Where they hold less than the second one, other readings of the orientation are tried all the same.
_TOUCHING, _DOUBTFUL = 0.2, 0.7
# Rows of a table by which other readings are tried in doubt, about.  More take longer; fewer miss short sweeps.
_TRIED = 50_000
_AXES = ("+x", "-x", "+y", "-y", "+z", "-z")


def check_directions(
    table: RawTable, map: Map, sweep: NDArray[np.int64], position: Array, quaternion: Array, touched: Mask
) -> list[str]:
    """Raise InputError if there is no sweep, or if most are not along -x of the clamp's frame, or do not hold the contacts.

    touched
        (n,) rows in contact.

    Returns notes on sweeps that hold only some of the contacts, where with another reading of the orientation they hold most.
    """
    angle = segments.travel_angles(sweep, position, quaternion)
    known = angle[np.isfinite(angle)]
    if map.directions == "both":
        known = np.minimum(known, np.pi - known)
    held = float((sweep >= 0)[touched].mean()) if touched.any() else 1.0
    holds = held >= _TOUCHING
    if len(known) and (known < _ALONG).mean() >= _FEW and holds:
        if held >= _DOUBTFUL:
            return []
        # some of the rows are enough, if none of the table was left out
        step = max(1, len(table) // _TRIED) if len(table) == len(touched) else 1
        some = replace(table, columns=tuple(column[::step] for column in table.columns))
        right = [name for name, candidate in _other_readings(map) if _fits(some, candidate, touched[::step], _MOST)]
        return [
            f"only {100 * held:.0f} % of the rows in contact lie in sweeps along -x of the clamp's frame, and nearly all do if "
            f"{name}: check [columns] orientation of {map.name}"
            for name in right[:1]
        ]
    if len(angle) and not len(known):
        raise InputError(
            f"{table.name}: the clamp does not move in any of the {len(angle)} sweeps; check [columns] position and sweep of "
            f"{map.name}"
        )
    listed = "" if not len(known) else f"in {(known >= _ALONG).sum()} of {len(known)} sweeps "
    listed = listed if holds else "in contact "
    axis = _usual_axis(np.where(touched, 0, -1) if not holds else sweep, position, quaternion)
    what = f"the clamp moves {listed}mostly along {axis} of its own frame, and not along -x as in a sweep"
    advice = _advice(table, map, axis, touched)
    raise InputError(f"{table.name}: {what}; {advice}")


def _usual_axis(sweep: NDArray[np.int64], position: Array, quaternion: Array) -> str:
    """The axis of the clamp's frame along which it moves farthest, in the sweeps if there are any."""
    step = np.diff(position, axis=0)
    rows = (sweep[1:] >= 0) & (sweep[1:] == sweep[:-1])
    rows = rows if step[rows].any() else np.ones(len(step), dtype=bool)
    if not rows.any():
        return "no axis"
    local = Rotation.from_quat(quaternion[:-1][rows], scalar_first=True).apply(step[rows], inverse=True)
    lengths = np.stack([np.maximum(local, 0).sum(axis=0), np.maximum(-local, 0).sum(axis=0)], axis=1).ravel()
    return _AXES[int(np.argmax(lengths))]


def _advice(table: RawTable, map: Map, axis: str, touched: Mask) -> str:
    right = [name for name, candidate in _other_readings(map) if _fits(table, candidate, touched)]
    if right:
        return f"they would be along -x if {right[0]}: check [columns] orientation of {map.name}"
    if axis == "+x":
        return (
            "turn the clamp's frame about the rod by euler_deg = [0, 180, 0] under [clamp] of the map, or take strokes in both "
            'directions by directions = "both" under [sweeps]'
        )
    return (
        f"check [columns] orientation and position of {map.name}, or state the clamp's frame, with y along the rod and x "
        "against the sweep, in the logged one under [clamp]"
    )


def _other_readings(map: Map) -> Iterator[tuple[str, Map]]:
    """Other ways to read the orientation, with the words for them."""
    orientation = map.columns.orientation

    def changed(**fields: Any) -> Map:
        return replace(map, columns=replace(map.columns, orientation=replace(orientation, **fields)))

    if orientation.kind == "quaternion":
        other = "xyzw" if orientation.order == "wxyz" else "wxyz"
        last = "last" if other == "xyzw" else "first"
        yield f'qw is the {last} of the four columns, order = "{other}"', changed(order=other)
        return
    for unit, factor in (("deg", np.pi / 180), ("rad", 1.0)):
        if map.factors["angle"] != factor:
            yield (
                f'the angles are in {unit}, angle = "{unit}" under [units]',
                replace(map, factors={**map.factors, "angle": factor}),
            )
    if orientation.kind == "euler":
        convention = orientation.convention
        for other in (convention.swapcase(), convention[::-1], convention[::-1].swapcase()):
            if other != convention:
                yield f'the convention is "{other}"', changed(convention=other)


def _fits(table: RawTable, map: Map, touched: Mask, least: float = _FEW) -> bool:
    """Whether nearly all of the clamp's sweeps are along -x with another map.

    Sweeps that are found by motion hold at least the fraction `least` of the rows in contact then.
    """
    try:
        log = read_log(table, map)
    except InputError:
        return False
    position, quaternion = map.clamp.carried(log.position_m, log.quaternion)
    if log.sweep is not None:
        sweep = log.sweep if log.sweeping is None else segments.numbered(log.sweep, log.sweeping)
    elif log.sweeping is not None:
        sweep = segments.runs_of(log.sweeping)
    else:
        found = segments.strokes(position, quaternion, map.rod.length_m)
        forwards = (found.sweep >= 0) & ~np.append(found.backwards, True)[found.sweep]
        return bool(forwards[touched].mean() >= least) if touched.any() else bool(forwards.any())
    angle = segments.travel_angles(sweep, position, quaternion)
    known = angle[np.isfinite(angle)]
    return bool(len(known)) and bool((known < _ALONG).mean() >= _MOST)
