"""What the errors of contacts contribute to a certificate: by noise and digits, and by the calibration of the rig."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from scan3d.bounds import Allowed, Enclosure, allowed
from scan3d.cloud import Cloud
from scan3d.recording import Recording


def _allowed(cloud: Cloud, bounds: Enclosure) -> Allowed | None:
    """What the bounds allow for; None if that is nothing, or if nothing is certified."""
    return allowed(cloud, bounds.confidence) if 0 < bounds.confidence < 1 else None


def noise_off(cloud: Cloud, bounds: Enclosure) -> float:
    """The largest error of a contact by noise and digits that the bounds allow for."""
    allow = _allowed(cloud, bounds)
    if cloud.place_sd is None or allow is None or allow.kappa is None:
        return bounds.margin
    return bounds.margin + allow.kappa * float(cloud.place_sd.max())


def calibration_off(cloud: Cloud, bounds: Enclosure) -> dict[str, float]:
    """The largest error of a contact by the rig's calibration that the bounds allow for, as ``{"calibration": size}``.

    Without a calibration the dictionary is empty.
    """
    if cloud.calibration is None:
        return {}
    allow = _allowed(cloud, bounds)
    return {"calibration": 0.0 if allow is None else allow.largest}


def calibration_numbers(recording: Recording, cloud: Cloud) -> dict[str, Any]:
    """What is not known exactly of the rig that corrected a recording, and the standard deviations of contacts that follow.

    A dictionary of one entry, ``calibration``; an empty one without a calibration.
    """
    rig, found = recording.rig, cloud.calibration
    if rig is None or found is None:
        return {}
    deviations = np.sqrt(np.diag(rig.covariance))
    known = {
        "standard_deviations": dict(zip(rig.names, map(float, deviations), strict=True)),
        "taken_as_exact": list(rig.exact),
        "independent_errors": found.count,
        "contact_median": float(np.median(found.place_sd)),
        "contact_max": float(found.place_sd.max()),
    }
    return {"calibration": known}


def calibration_rows(data: Mapping[str, Any]) -> list[tuple[str, str]]:
    """The row of a report's summary on what the certificate allows for by the calibration, and what it takes as exact."""
    rig = data.get("calibration")
    if not rig:
        return []
    size, unit = data["certificate"]["parts"]["calibration"], data["certificate"]["unit"]
    exact = rig["taken_as_exact"]
    unknown = f"; not determined by it, and taken as exact: {', '.join(exact)}" if exact else ""
    return [("calibration", f"allowed for with up to {size:.3g} {unit} at a contact{unknown}")]
