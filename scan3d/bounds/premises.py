"""What the certificate of a recording assumes, what of it these data could test, and what is missing if nothing is bounded."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from scan3d.arrays import NEGLIGIBLE, Array
from scan3d.bounds.constraints import allowed
from scan3d.cloud import Cloud
from scan3d.numbers import angle, length, number, share
from scan3d.reconstruction.errors import noise_in_air
from scan3d.recording import Recording
from scan3d.rods import Rod


class Premise(NamedTuple):
    """What is assumed, whether these data could test it, and how it came out, as parts of a sentence."""

    assumed: str
    tested: bool
    outcome: str


def premises(recording: Recording, cloud: Cloud, contradicted: Collection[str]) -> tuple[Premise, ...]:
    """What the bounds of a cloud's body rest on; `contradicted` are the codes of what the recording contradicts."""
    hidden = "not tested: what neither friction nor path nor other sweeps contradict stays hidden"
    outcome = "contradicted" if {"inside-hull", "beyond-tangent"} & {*contradicted} else "not contradicted"
    outcome = outcome if contradicted else "no contact lies inside those of a convex body"
    return (
        Premise("a convex body", True, outcome)
        if cloud.convex
        else Premise("no contact is that of a rod with a second one that stayed hidden", False, hidden),
        _of_rod(recording.rod, cloud, contradicted),
        _of_noise(recording, cloud),
        *(
            []
            if recording.completed is None
            else [Premise(recording.completed.words, False, "not tested: it was stated")]
        ),
    )


def _of_noise(recording: Recording, cloud: Cloud) -> Premise:
    """That on the noise: rows in the air have no values that are too large for it."""
    noise, left = recording.noise, cloud.left_out
    if not max(noise.force_N, noise.moment_Nm, noise.pose_m):
        assumed = "reactions without noise"
    elif left is None:
        assumed = "white noise of the stated size" + (", without wild rows" if cloud.model == "spatial" else "")
    else:
        assumed = f"white noise of at most {number(left.factor)} times the stated size, but for single wild rows"
    air = noise_in_air(recording)
    if not air.rows:
        return Premise(assumed, False, "not tested: of the noise the contacts tell nothing that the body could not")
    if air.size is None:
        return Premise(
            assumed, True, f"no value of {air.rows} rows in the air is larger than the stated noise explains"
        )
    return Premise(
        assumed, True, f"of {air.rows} rows in the air some have larger values than the stated noise explains"
    )


def _of_rod(rod: Rod, cloud: Cloud, contradicted: Collection[str]) -> Premise:
    """That on the rod and the sensor: sweeps over the same place agree, and so do six reactions."""
    known = "a straight, uniform, weightless rod in a rigid clamp" if rod.is_simple else "the stated rod and clamp"
    part = float(_same_place(cloud.fattened or cloud).mean()) if len(cloud) else 0.0
    six_axes = "force and moment are those of a single force" if cloud.model == "spatial" else ""
    if contradicted:
        outcome = "contradicted"
    elif relative := 0.0 if cloud.calibration is None else cloud.calibration.relative:
        outcome = (
            f"sweeps over the same place differ by {share(relative)} of the wrench: bounds allow for that, and no more"
        )
    elif part:
        agree = f"sweeps agree at the places that several of them touched, {share(part)} of the contacts"
        outcome = f"{agree}; {six_axes}" if six_axes else agree
    else:
        outcome = six_axes or "not tested: no two sweeps touched the same place"
    return Premise(f"{known}, and a sensor that is right", bool(part or six_axes), outcome)


def _same_place(cloud: Cloud) -> Array:
    """(n,) whether each contact lies as near to one of another sweep as to the next ones of its own, in its slice."""
    size = float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    places = np.column_stack([cloud.points, 2 * size * cloud.slice])
    near = cKDTree(places).query(places, k=range(2, 4))[1]
    known = near < len(places)
    other: Array = cloud.sweep[np.where(known, near, 0)] != cloud.sweep[:, None]
    return np.asarray((other & known).any(axis=1))


def missing(cloud: Cloud) -> str:
    """Why contacts anywhere do not bound the body, as a sentence without its full stop; "" for contacts in slices.

    A convex body is bounded by planes that touch it only if their normals lie on all sides of the origin.  Where those of the
    contacts do, the errors of single contacts leave the planes too uncertain.
    """
    if cloud.model != "spatial":
        return ""
    normals = cloud.normals[np.isfinite(cloud.normals).all(axis=1)]
    if cloud.table is not None:
        normals = np.vstack([normals, [0.0, 0.0, -1.0]])
    side = _open_side(normals)
    if side is not None:
        return _on_side(side, cloud)
    if cloud.place_sd is None or cloud.tangent_sd is None or (kappa := allowed(cloud).kappa) is None:
        return "the contacts are too few or too far apart for their tangent planes to meet: sweeps between them would close it"
    place, turn = (
        kappa * float(np.median(sd)) for sd in (cloud.place_sd, cloud.tangent_sd[np.isfinite(cloud.tangent_sd)])
    )
    return (
        f"contacts face all sides, but noise may move half of them by more than {length(place, cloud.unit)}, and turn the rod "
        f"there by more than {angle(float(np.degrees(turn)))}, so that the directions of the planes that touch the "
        "body there are open: "
        "less noise would bound it"
    )


def _open_side(normals: Array) -> Array | None:
    """A direction that no normal (n, 3) has a part in; None if they lie on all sides of the origin."""
    if len(normals) < 4:
        return -normals.mean(axis=0) if len(normals) else np.array([0.0, 0.0, 1.0])
    try:
        facets = ConvexHull(normals).equations
    except QhullError:  # all in one plane
        return np.asarray(np.linalg.svd(normals - normals.mean(axis=0))[2][2])
    worst = facets[facets[:, 3].argmax()]
    return worst[:3] if worst[3] > -NEGLIGIBLE else None


def _on_side(side: Array, cloud: Cloud) -> str:
    """What would bound the body in a direction that no contact faces."""
    x, y, z = side / max(float(np.linalg.norm(side)), NEGLIGIBLE)
    if abs(z) < np.cos(np.pi / 8):  # neither down nor up
        return f"no contact bounds the body towards ({x + 0.0:.2f}, {y + 0.0:.2f}, {z + 0.0:.2f}): sweeps from that side would"
    heights = cloud.points[:, 2]
    end = float(heights.min() if z < 0 else heights.max())
    where, table = ("below", ", or the height of the table that it stands on,") if z < 0 else ("above", "")
    return f"no contact bounds the body {where} z = {length(end, cloud.unit)}: sweeps from {where}{table} would"
