"""The first half of step 2: from a recording, simulated or measured, to contacts with the normals of the surface."""

from scan3d.reconstruction.agreement import (
    LARGEST_SHARE,
    Checked,
    Contradiction,
    cause_of_no_contact,
    checked,
    reconstruct,
)
from scan3d.reconstruction.contacts import radius_errors
from scan3d.reconstruction.diagnosis import Diagnosis, diagnose
from scan3d.reconstruction.errors import NoContactError
from scan3d.reconstruction.measured import as_measured

__all__ = [
    "LARGEST_SHARE",
    "Checked",
    "Contradiction",
    "Diagnosis",
    "NoContactError",
    "as_measured",
    "cause_of_no_contact",
    "checked",
    "diagnose",
    "radius_errors",
    "reconstruct",
]
