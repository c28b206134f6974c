"""What a user should know of an import: sentences that are no errors."""

from __future__ import annotations

import numpy as np

from scan3d.arrays import Array, Mask
from scan3d.laboratory.columns import CHANNELS
from scan3d.laboratory.maps import Map
from scan3d.laboratory.plausibility import felt
from scan3d.recording import Recording

# Part of the force out of the plane, of a sensor with four or five channels, from which a note says so.
_OUT_OF_PLANE = 0.05


def filter_notes(map: Map, rate: float | None, every: int) -> list[str]:
    """What filter and rate do to the noise, if every so many rows of a table with a given rate in Hz are kept."""
    if rate is None:
        return []
    left = rate / every
    if map.lowpass_hz and left > 4 * map.lowpass_hz:
        return [
            f"rows that follow one another at {left:.4g} Hz have nearly the same noise after a low-pass of {map.lowpass_hz:g} "
            f"Hz; rate_hz = {2 * map.lowpass_hz:g} under [filter] keeps rows with independent noise"
        ]
    if map.lowpass_hz and left < 2 * map.lowpass_hz:
        return [
            f"at {left:.4g} Hz what is faster than {left / 2:.4g} Hz appears as slower; lowpass_hz lets up to "
            f"{map.lowpass_hz:g} Hz pass"
        ]
    return []


def contact_notes(recording: Recording, wrench: Array, known: Mask, map: Map) -> list[str]:
    """What the channels (6,) that are known, and the wrench (n, 6) of the recording's rows, say about its use."""
    notes = []
    touched = felt(recording)
    if not touched.any():
        notes.append(
            "no row has a force that stands out from the noise: either the rod touched nothing, or the sensor is silent"
        )
    further = [CHANNELS[k] for k in (2, 3, 4) if known[k]]
    if not known.all() and further:
        text = (
            f"{', '.join(further)} are left out, because a planar recording has fx, fy and mz, and all six are needed for the "
            "model in space"
        )
        if known[2] and touched.any():
            part = np.abs(wrench[touched, 2]) / np.linalg.norm(wrench[touched, :3], axis=1)
            worst = float(np.median(part))
            if worst > _OUT_OF_PLANE:
                text += f"; fz is {100 * worst:.2g} % of the force in contact, and the planar model takes it for zero"
        notes.append(text)
    if map.air == "none" and map.noise_force_N is None:
        notes.append(
            "nothing is known of the noise: state force_N and moment_Nm under [noise], or stretches in the air under [tare]"
        )
    return notes
