"""What was measured of the body, as in a certificate of measurement: value, coverage interval, coverage probability.

Source: JCGM 100:2008, *Guide to the expression of uncertainty in measurement* (GUM), and JCGM 101:2008 for intervals that are
not symmetric about the value.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from scan3d.bounds import Certificate, Enclosure, allowed
from scan3d.cloud import Cloud

_AXES = "xyz"


def measurands(cloud: Cloud, bounds: Enclosure, surface: Any, certified: Certificate) -> list[dict[str, Any]]:
    """The quantities that are measured of a body by its contacts, enclosure, surface and certificate, each with these entries.

    quantity, unit
        what was measured; the extents are those along the axes of the world.
    value
        that of the surface.
    interval
        lower and upper bound, between which the true value lies with the coverage probability; infinite where nothing
        bounds it.
    expanded_uncertainty
        the largest distance of the value from the ends of the interval.
    coverage_probability
        1 for exact contacts; 0 where the recording contradicts the model, so that nothing is stated.
    coverage_factor
        the number of standard deviations of each contact that the interval allows for, which is larger than 2 because it
        holds for all contacts at once; None for exact contacts.  Where the reactions are exact, and the rig's calibration is
        not, the number of standard deviations of the calibration.

    All intervals hold together, under the premises of the certificate.
    """
    unit, probability = cloud.unit, bounds.confidence
    allow = allowed(cloud, probability) if 0 < probability < 1 else None
    factor = None if allow is None else allow.kappa or allow.factor

    def measured(quantity: str, value: float, low: float, high: float, power: str = "") -> dict[str, Any]:
        return {
            "quantity": quantity,
            "value": value,
            "unit": unit + power,
            "interval": [low, high],
            "expanded_uncertainty": max(high - value, value - low),
            "coverage_probability": probability,
            "coverage_factor": factor,
        }

    directions = np.concatenate([np.eye(3), -np.eye(3)])
    lower, upper = bounds.support(directions)
    size = np.ptp(np.asarray(surface.vertices), axis=0)
    least, largest = np.maximum(lower[:3] + lower[3:], 0.0), upper[:3] + upper[3:]
    extents = [
        measured(f"extent along {axis}", float(size[k]), float(least[k]), float(largest[k]))
        for k, axis in enumerate(_AXES)
    ]
    low, high = bounds.volume
    return [
        *extents,
        measured("volume", float(surface.volume), float(low), float(high), "³"),
        measured("distance of the surface from the body", 0.0, 0.0, float(certified.bound)),
    ]
