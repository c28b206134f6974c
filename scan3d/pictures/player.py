"""What the page's player needs: poses and reactions of the samples, sweep by sweep.

The shapes of the rod are not stored.  The page integrates the elastic line from the reactions of the sample that it shows, so
that a sample takes some 30 bytes, and not the hundreds of its shape.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scan3d.arrays import Array
from scan3d.pictures.encoding import floats, integers
from scan3d.pictures.parts import is_spatial, most_informative_sweep, recording_rows
from scan3d.pictures.scene import Scene
from scan3d.pictures.shading import FORCE, INK, REACTION_COLORS, ROD, SELECTED
from scan3d.recording import Recording
from scan3d.units import UNITS_M

# Samples without contact that are shown before the first and after the last contact of a sweep, as a fraction of those from
# the first to the last.  More make the page of a log that is mostly air larger; fewer do not show the rod come and leave.
_AIR = 0.25


class Samples(NamedTuple):
    """The samples of the player, those of a sweep one after the other."""

    rows: NDArray[np.int64]
    """(n,) rows of the recording"""
    starts: NDArray[np.int64]
    """(s,) where each sweep starts"""
    numbers: NDArray[np.int64]
    """(s,) numbers of the sweeps, ascending"""
    of_contact: NDArray[np.int64]
    """(c,) the sample that each contact comes from"""


def player(scene: Scene, center: Array) -> dict[str, Any]:
    """The data of the player, for a scene that has rods (`parts.has_rods`).

    Positions are relative to `center` in the scene's unit, forces are in mN and moments in mN mm, all in float32 and base64.
    Raises InputError if the contacts do not come from the scene's recording.
    """
    recording, sweeps = scene.recording, scene.column("sweep")
    assert recording is not None
    rows = recording_rows(scene, recording)
    assert sweeps is not None
    samples = samples_of(recording, rows)
    spatial = is_spatial(scene)
    reactions, labels = _reactions(recording, samples.rows, spatial)
    scale = 1 / UNITS_M[scene.unit]
    turned, turns = _turns(recording.quaternion[samples.rows])
    shown = most_informative_sweep(scene, scene.column("slice"), sweeps)
    data: dict[str, Any] = {
        "numbers": samples.numbers.tolist(),
        "starts": samples.starts.tolist(),
        "shown": int(np.flatnonzero(samples.numbers == shown)[0]),
        "position": floats(recording.position_m[samples.rows] * scale - center),
        "turned": integers(turned),
        "turns": floats(turns),
        "reactions": floats(reactions),
        "labels": labels,
        "contact": integers(samples.of_contact),
        "length": recording.rod.length_m * scale,
        "forceUnit": 1e3 * recording.rod.force_unit_N,
        "momentUnit": 1e6 * recording.rod.moment_unit_Nm,
        "colors": {"rod": ROD, "force": FORCE, "selected": SELECTED, "ink": INK, "curves": REACTION_COLORS},
    }
    if spatial:
        bending = np.zeros(len(samples.rows))
        angles = scene.column("bending")
        assert angles is not None
        bending[samples.of_contact] = np.nan_to_num(angles)
        data["bending"] = floats(bending)
    return data


def samples_of(recording: Recording, rows: NDArray[np.int64]) -> Samples:
    """The samples of all sweeps with contacts, `rows` (c,) being those of the contacts in the recording.

    A sweep is shown from shortly before its first to shortly after its last contact.
    """
    order = np.argsort(recording.sweep, kind="stable")
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    numbers, group = np.unique(recording.sweep[rows], return_inverse=True)
    first = np.full(len(numbers), len(order))
    last = np.full(len(numbers), -1)
    np.minimum.at(first, group, place[rows])
    np.maximum.at(last, group, place[rows])
    air = np.ceil(_AIR * (last - first + 1)).astype(np.int64)
    ordered = recording.sweep[order]
    begin = np.maximum(first - air, np.searchsorted(ordered, numbers, "left"))
    end = np.minimum(last + air + 1, np.searchsorted(ordered, numbers, "right"))
    lengths = end - begin
    starts = np.concatenate([[0], np.cumsum(lengths)[:-1]])
    kept = np.repeat(begin - starts, lengths) + np.arange(lengths.sum())
    return Samples(order[kept], starts, numbers, (starts - begin)[group] + place[rows])


def _reactions(recording: Recording, rows: NDArray[np.int64], spatial: bool) -> tuple[Array, list[dict[str, Any]]]:
    """Reactions (n, 3) in the plane or (n, 6) in space, and the charts in which the page draws them."""
    if spatial:
        force, moment = recording.wrench()
        reactions = np.column_stack([1e3 * force[rows], 1e6 * moment[rows]])
        return reactions, [
            {"title": "force in mN", "names": ["f0x", "f0y", "f0z"]},
            {"title": "moment in mN mm", "names": ["m0x", "m0y", "m0z"]},
        ]
    reactions = np.column_stack([1e3 * recording.force_N[rows], 1e6 * recording.moment_Nm[rows]])
    names = (("f0x", "mN"), ("f0y", "mN"), ("m0z", "mN mm"))
    return reactions, [{"title": f"{name} in {unit}", "names": [name]} for name, unit in names]


def _turns(quaternions: Array) -> tuple[NDArray[np.int64], Array]:
    """The samples (k,) from which on the clamp has another orientation, and these orientations (k, 4), w first."""
    changed = np.concatenate([[True], (np.diff(quaternions, axis=0) != 0).any(axis=1)])
    at = np.flatnonzero(changed)
    return at, quaternions[at]
