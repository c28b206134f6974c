"""Which rows of a recording were measured: what repeats, is saturated or held is left out, and nothing is concluded from it.

A sweep is cut where rows are left out: what the rod met there is not known, so that the clamp did not sweep from one part to
the next.  Only recordings that state noise, and whose rows in the air show it, tell such rows (`scan3d.unmeasured`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from scan3d.arrays import Index, Mask
from scan3d.cloud import Cloud, Unmeasured
from scan3d.reconstruction.contacts import renumbered
from scan3d.reconstruction.errors import felt
from scan3d.recording import ACROSS, CHANNELS, FORCE, IN_PLANE, REACTIONS, Recording, of_rows
from scan3d.units import force, moment
from scan3d.unmeasured import Held, gaps, held_poses, of_all, parts, sentence


def unmeasured(recording: Recording) -> Unmeasured | None:
    """The rows of a recording that were not measured; None if there are none, or if that is not known."""
    noise = recording.noise.of_reactions(recording.rod)
    if not max(recording.noise_force_N, recording.noise_moment_Nm):
        return None
    columns = dict(zip(CHANNELS, np.hstack(recording.wrench()).T, strict=True)) if recording.six_axis else {}
    three = (recording.force_N[:, 0], recording.force_N[:, 1], recording.moment_Nm)
    columns |= {CHANNELS[k]: column for k, column in zip(IN_PLANE, three, strict=True)}
    for name in _completed(recording):
        del columns[name]
    names = tuple(columns)
    values = np.stack(list(columns.values()), axis=1)
    pose = np.concatenate([recording.position_m, recording.quaternion], axis=1)
    found = gaps(values, ~felt(recording.pressing(recording.six_axis), noise), pose)
    # an import writes zeros where the rod rings in the air
    if recording.source.get("ringing"):
        found = [gap for gap in found if gap.channel >= 0 or values[gap.rows].any()]
    rows = of_all(found, len(recording))

    def shown(channel: int, value: float) -> str:
        return force(value) if names[channel].startswith("f") else moment(value)

    said = tuple(sentence(gap, len(recording), shown, names, lambda row: f"row {row + 1}") for gap in found)
    held = held_poses(recording.position_m, recording.quaternion, values, recording.rod.length_m)
    if held is not None:
        rows[held.stale] = True
        said += (_of_poses(held),)
    repeated = np.flatnonzero(of_all((gap for gap in found if gap.every), len(recording)))
    return Unmeasured(np.flatnonzero(rows), repeated, said, held is not None) if said else None


def _completed(recording: Recording) -> tuple[str, ...]:
    """The channels that were not measured, but completed."""
    if recording.completed is None:
        return ()
    if recording.completed.channel == ACROSS:
        return CHANNELS[:3:2]
    if recording.completed.channel == FORCE:
        return CHANNELS[:3] if recording.six_axis else CHANNELS[:2]
    return (CHANNELS[IN_PLANE[list(REACTIONS).index(recording.completed.channel)]],)


def _of_poses(held: Held) -> str:
    if not len(held.interpolated):
        return f"the pose is held in {len(held.stale):,} rows while the clamp moves: these rows are left out"
    return (
        f"the poses change every {held.every:.3g} rows only, in which force and moment change from row to row: where the clamp "
        f"was is not known in {len(held.interpolated) + len(held.stale):,} rows; log the poses as often as the wrench, or "
        "import the table, which interpolates them"
    )


def measured(recording: Recording, found: Unmeasured) -> tuple[Recording, Index]:
    """The recording of the rows that were measured, and their numbers (k,)."""
    known: Mask = np.ones(len(recording), dtype=bool)
    known[found.rows] = False
    rows = np.flatnonzero(known)
    known[found.repeated] = True
    return replace(of_rows(recording, rows), sweep=parts(recording.sweep, known)[rows]), rows


def as_measured(recording: Recording, cloud: Cloud) -> tuple[Recording, Cloud]:
    """A recording and its contacts without the rows that were not measured, whose numbers are those of the others."""
    if cloud.unmeasured is None:
        return recording, cloud
    part, rows = measured(recording, cloud.unmeasured)
    number = np.full(len(recording), -1)
    number[rows] = np.arange(len(rows))
    return part, replace(_numbered(cloud, number), unmeasured=None)


def as_recorded(recording: Recording, found: Unmeasured, rows: Index, cloud: Cloud) -> Cloud:
    """The contacts of the rows (k,) that were measured, with the numbers that rows and sweeps have in the recording."""
    whole = replace(_numbered(cloud, rows), unmeasured=found)
    return whole.changed(sweep=lambda one: recording.sweep[one.row].astype(np.int32))


def _numbered(cloud: Cloud, number: Index) -> Cloud:
    """The cloud with other numbers (n,) for the rows of the recording, and for those that are left out."""
    left = cloud.left_out and cloud.left_out._replace(rows=number[cloud.left_out.rows])
    return renumbered(cloud.changed(left_out=lambda _: left), number)
