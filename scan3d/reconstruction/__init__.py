"""The first half of step 2: from a recording, simulated or measured, to contacts with the normals of the surface."""

from scan3d.reconstruction.agreement import LARGEST_SHARE, Checked, Contradiction, cause_of_no_contact, checked
from scan3d.reconstruction.causes import Diagnosis
from scan3d.reconstruction.contacts import radius_errors
from scan3d.reconstruction.diagnosis import diagnose
from scan3d.reconstruction.errors import NoContactError
from scan3d.reconstruction.relative import reconstruct

__all__ = [
    "LARGEST_SHARE",
    "Checked",
    "Contradiction",
    "Diagnosis",
    "NoContactError",
    "cause_of_no_contact",
    "checked",
    "diagnose",
    "radius_errors",
    "reconstruct",
]
