"""Whether a six-axis recording agrees with the spatial model: one contact force on a thin round rod past a convex body.

Two residuals of the six reactions vanish for a single force at the rod's centre line: the moment about the rod's axis, up to
friction across a rod of finite radius, and the moment along the force.  Contacts of a convex body lie on their hull, and the
rod's tangents at tangential contacts pass outside it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, QhullError
from scipy.special import chdtri

import planar
from scan3d.arrays import Array, Index
from scan3d.cloud import Cloud
from scan3d.reconstruction.contradiction import Contradiction
from scan3d.reconstruction.rig_effects import torsion_sd
from scan3d.reconstruction.spatial import Readings, readings
from scan3d.recording import Recording

# Largest fraction of the rows with a force that may lack a contact or have residuals.  Larger, faulty recordings pass; smaller,
# single disturbed rows of a measurement count as a contradiction.
_DISTURBED = 0.02
# Standard deviations of a residual that noise explains in single rows, of which very few exceed it.
_SIGMAS = 5.0
# Rounding: of the residuals, relative to force times moment, and of contacts, in rod lengths.
_ROUNDING_RESIDUAL, _ROUNDING = 1e-7, 1e-7
# Probability that noise makes a correct recording exceed the allowed distances.  Larger, false alarms; smaller, faults pass.
_FALSE_ALARM = 1e-5
# Contacts and tangents that are compared with the hull at most, and contacts of the hull.  More take longer; fewer may miss
# the worst one.
_COMPARED, _HULL = 1000, 4000


class _Found(NamedTuple):
    """What the tests measure, before thresholds are applied."""

    without_contact: float
    """Fraction of the rows with a force that have no contact."""
    skewed: float
    """Fraction of the contacts whose moment has a component along the force."""
    skew_deg: float
    """Angle by which force and moment deviate from the perpendicular, in 95 % of the contacts at most."""
    twisted: float
    """Fraction of the contacts with a moment about the rod's axis."""
    twist: float
    """That moment over the clamping moment, in 95 % of the contacts at most."""
    inside: float
    """Largest depth of a contact or a tangent in the hull, in the cloud's unit, over what is allowed is `excess`."""
    allowed: float
    """Depth that noise and rounding allow there."""

    def excesses(self) -> dict[str, float]:
        """The results of the tests over their thresholds, by code."""
        return {
            "force-without-contact": self.without_contact / _DISTURBED,
            "moment-along-force": self.skewed / _DISTURBED,
            "moment-about-rod": self.twisted / _DISTURBED,
            "inside-hull": self.inside / self.allowed,
        }


def spatial_contradictions(recording: Recording, cloud: Cloud) -> list[Contradiction]:
    """The contradictions between a six-axis recording, its contacts and the spatial model."""
    found = _tests(recording, readings(recording), cloud)
    codes = [code for code, excess in found.excesses().items() if excess > 1]
    if not codes:
        return []
    values = {
        "force-without-contact": (
            found.without_contact,
            f"{100 * found.without_contact:.2g} % of the rows with a force have no contact: no bent rod has their reactions",
        ),
        "moment-along-force": (
            found.skew_deg,
            f"force and moment are up to {found.skew_deg:.2g}° off the perpendicular, in {100 * found.skewed:.2g} % of the "
            "contacts by more than noise and rounding allow: a second contact, or a misaligned or untared sensor",
        ),
        "moment-about-rod": (
            found.twist,
            f"the moment about the rod's axis is up to {found.twist:.2g} of the clamping moment, in {100 * found.twisted:.2g} "
            "% of the contacts more than noise, rounding and friction across the rod allow: a bent rod, or a misaligned sensor",
        ),
        "inside-hull": (
            found.inside,
            f"contacts, or the rod's tangents at contacts, lie up to {found.inside:.3g} {cloud.unit} inside the hull of the "
            f"contacts, where noise and rounding allow {found.allowed:.2g} {cloud.unit}: the contacts are not those of a "
            "convex body",
        ),
    }
    return [Contradiction(code, values[code][1], values[code][0]) for code in codes]


def _tests(recording: Recording, known: Readings, cloud: Cloud) -> _Found:
    felt = int(known.felt.sum())
    without = 1 - int((known.touching | known.light).sum()) / felt if felt else 0.0
    found, rows = known.found, cloud.row
    f = np.linalg.norm(found.force[rows], axis=1)
    m = 2 * found.q[rows] * np.sqrt(f)
    torsion, skew = np.abs(found.torsion[rows]), np.abs(found.skew[rows])
    sigma_f, sigma_m = known.noise
    # friction across the rod acts at the rod's radius
    radius = cloud.rod_radius / cloud.rod_length
    twisted = torsion > _SIGMAS * sigma_m + _ROUNDING_RESIDUAL * (m + f) + radius * f + _by_calibration(
        recording, cloud
    )
    skewed = skew > _SIGMAS * np.hypot(f * sigma_m, m * sigma_f) + _ROUNDING_RESIDUAL * f * (m + f)
    angle = np.degrees(np.arcsin(np.minimum(skew / (f * np.hypot(m, torsion)), 1.0)))
    return _Found(
        without,
        float(skewed.mean()),
        float(np.percentile(angle, 95)),
        float(twisted.mean()),
        float(np.percentile(torsion / m, 95)),
        *_inside_hull(cloud, known),
    )


def _by_calibration(recording: Recording, cloud: Cloud) -> Array | float:
    """(n,) moments about the rod that the uncertainty of the rig's calibration makes."""
    rig = cloud.calibration
    return 0.0 if rig is None else rig.factor(_FALSE_ALARM) * torsion_sd(recording, cloud.row)


def _inside_hull(cloud: Cloud, known: Readings) -> tuple[float, float]:
    """The depth of a contact or a tangent in the hull of the contacts, and the allowed depth, where their ratio is largest."""
    rounding = _ROUNDING * cloud.rod_length + 2 * cloud.pose_error
    points, tangents = cloud.centre_points, cloud.tangents
    assert points is not None
    assert tangents is not None
    of_hull = _some(np.arange(len(points)), _HULL)
    middle = points.mean(axis=0)
    try:
        hull = ConvexHull(points[of_hull] - middle)
    except (QhullError, ValueError):
        return 0.0, rounding
    outward, offset = hull.equations[:, :3], hull.equations[:, 3]
    kappa = float(np.sqrt(chdtri(3, _FALSE_ALARM / len(points))))
    place, turn = np.zeros(len(points)), np.zeros(len(points))
    if known.error is not None and cloud.place_sd is not None:
        place, turn = kappa * cloud.place_sd, kappa * known.error.tangent[cloud.row]
    if (rig := cloud.calibration) is not None:
        factor = rig.factor(_FALSE_ALARM)
        place, turn = place + factor * rig.place_sd, turn + factor * rig.turn_sd
    of_facet = place[of_hull][hull.simplices].max(axis=1)

    def worst(rows: Index, at: Array, arm: Array) -> tuple[float, float]:
        """Depth and allowed depth of places (k, 3) that depend on contacts by an arm (k,) along their tangents."""
        below = -(at - middle) @ outward.T - offset
        facet = below.argmin(axis=1)
        depth = below[np.arange(len(rows)), facet]
        allowed = rounding + place[rows] + of_facet[facet] + turn[rows] * arm
        # and errors of the second order
        allowed += (place[rows] + of_facet[facet]) ** 2 / cloud.rod_length
        i = int(np.argmax(depth / allowed)) if len(rows) else -1
        return (float(depth[i]), float(allowed[i])) if i >= 0 else (0.0, rounding)

    some = _some(np.arange(len(points)), _COMPARED)
    lines = _some(np.flatnonzero(cloud.phase == planar.Phase.TANGENTIAL), _COMPARED)
    # the middle of the part of each tangent that lies in the hull, or of its distance to it
    slope, height = tangents[lines] @ outward.T, -(points[lines] - middle) @ outward.T - offset
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = height / slope
    first = np.where(slope < 0, crossing, -np.inf).max(axis=1)
    last = np.where(slope > 0, crossing, np.inf).min(axis=1)
    arm = (first + last) / 2
    arm = np.where(np.isfinite(arm), arm, 0.0)
    pairs = [
        worst(some, points[some], np.zeros(len(some))),
        worst(lines, points[lines] + arm[:, None] * tangents[lines], np.abs(arm)),
    ]
    return max(pairs, key=lambda pair: pair[0] / pair[1])


def _some(rows: Index, count: int) -> Index:
    """At most `count` of the rows, evenly spread."""
    return rows if len(rows) <= count else rows[np.linspace(0, len(rows) - 1, count).astype(np.intp)]
