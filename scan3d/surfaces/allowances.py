"""Errors that bounds of a stated confidence allow for: those of the reactions' noise, and those of the rig's calibration."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from scan3d.arrays import Array
from scan3d.cloud import Cloud
from scan3d.surfaces.averages import AVERAGED

CONFIDENCE = 0.95
"""Probability with which the bounds hold under noise."""
# Part of the probability of failure that the calibration has where there is noise as well.  Larger, bounds allow for more
# noise; smaller, for larger errors of the calibration.  Its factor hardly depends on it.
_SHARE = 0.2


def sigmas(count: int, confidence: float = CONFIDENCE) -> float:
    """The number of standard deviations κ within which all linear functions of the errors of `count` contacts stay.

    Averages are counted as well, two for every run of rows, once for the inner and once for the outer polygon.
    """
    events = max(count, 1) * (1 + 4 * sum(1 / size for size in AVERAGED))
    return float(np.sqrt(chdtri(3, (1 - confidence) / events)))


class Allowed(NamedTuple):
    """What bounds of a stated confidence allow for: the probability that they fail is shared by noise and calibration."""

    kappa: float | None
    """Standard deviations of each contact by the noise, as `sigmas`; None for exact reactions."""
    factor: float
    """Standard deviations of all contacts by the calibration (`scan3d.rigs.RigErrors.factor`); 0 without one."""
    confidence: float
    """That of the bounds: 1 where there is neither noise nor calibration."""
    place: Array | float
    """(n,) the largest errors of the places by the calibration; 0 without one."""
    turn: Array | float
    """(n,) those of the tangents, in radians."""
    across: Array | float
    """(n,) those of the places across the rod, in the planes of the slices."""
    tilt: Array | float
    """(n,) those of the tangents' angles there, in radians."""
    height: float
    """The largest error of the height of a contact or a line."""

    @property
    def largest(self) -> float:
        """The largest error of a contact's place by the calibration."""
        return float(np.max(self.place, initial=0.0))


def allowed(cloud: Cloud, confidence: float = CONFIDENCE) -> Allowed:
    """What bounds of a cloud's body have to allow for in order to hold with a confidence."""
    noisy, rig = cloud.covariance is not None or cloud.place_sd is not None, cloud.calibration
    if rig is None or not rig.count:
        kappa = sigmas(len(cloud), confidence) if noisy else None
        return Allowed(kappa, 0.0, confidence if noisy else 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    alpha = 1 - confidence
    factor = rig.factor(_SHARE * alpha if noisy else alpha)
    kappa = sigmas(len(cloud), 1 - (1 - _SHARE) * alpha) if noisy else None
    columns = rig.place_sd, rig.turn_sd, rig.across_sd, rig.tilt_sd
    place, turn, across, tilt = (factor * column for column in columns)
    height = factor * float(rig.height_sd.max(initial=0.0))
    return Allowed(kappa, factor, confidence, place, turn, across, tilt, height)
