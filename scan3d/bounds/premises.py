"""What the certificate of a recording assumes, and which of it these data could test."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from scan3d.arrays import Array
from scan3d.cloud import Cloud
from scan3d.recording import Recording
from scan3d.rods import Rod


class Premise(NamedTuple):
    """What is assumed, whether these data could test it, and how it came out, as parts of a sentence."""

    assumed: str
    tested: bool
    outcome: str


def premises(recording: Recording, cloud: Cloud, contradicted: Collection[str]) -> tuple[Premise, ...]:
    """What the bounds of a cloud's body rest on; `contradicted` are the codes of what the recording contradicts."""
    noise = recording.noise
    stated = max(noise.force_N, noise.moment_Nm, noise.pose_m) > 0
    return (
        Premise("a convex body", True, _of_body(contradicted)),
        _of_rod(recording.rod, cloud, contradicted),
        Premise(
            "white noise of the stated size" if stated else "reactions without noise",
            False,
            "not tested: of the noise the contacts tell nothing that the body could not",
        ),
    )


def _of_body(contradicted: Collection[str]) -> str:
    if not contradicted:
        return "no contact lies inside those of a convex body"
    return "contradicted" if {"inside-hull", "beyond-tangent"} & set(contradicted) else "not contradicted"


def _of_rod(rod: Rod, cloud: Cloud, contradicted: Collection[str]) -> Premise:
    """That on the rod and the sensor: sweeps over the same place agree, and so do six reactions."""
    known = "a straight, uniform, weightless rod in a rigid clamp" if rod.is_simple else "the stated rod and clamp"
    share = float(_same_place(cloud.fattened or cloud).mean()) if len(cloud) else 0.0
    six_axes = "force and moment are those of a single force" if cloud.model == "spatial" else ""
    if contradicted:
        outcome = "contradicted"
    elif relative := 0.0 if cloud.calibration is None else cloud.calibration.relative:
        outcome = (
            f"sweeps over the same place differ by {100 * relative:.2g} % of the wrench, which the bounds allow for"
        )
    elif share:
        agree = f"sweeps agree at the places that several of them touched, {100 * share:.2g} % of the contacts"
        outcome = f"{agree}; {six_axes}" if six_axes else agree
    else:
        outcome = six_axes or "not tested: no two sweeps touched the same place"
    return Premise(f"{known}, and a sensor that is right", bool(share or six_axes), outcome)


def _same_place(cloud: Cloud) -> Array:
    """(n,) whether each contact lies as near to one of another sweep as to the next ones of its own, in its slice."""
    size = float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    places = np.column_stack([cloud.points, 2 * size * cloud.slice])
    near = cKDTree(places).query(places, k=range(2, 4))[1]
    known = near < len(places)
    other: Array = cloud.sweep[np.where(known, near, 0)] != cloud.sweep[:, None]
    return np.asarray((other & known).any(axis=1))
