"""The second half of step 2: closed surfaces from contacts, with certified bounds of their distance to the body."""

from scan3d.choices import METHODS
from scan3d.surfaces.allowances import Allowed, allowed, sigmas
from scan3d.surfaces.bounds import enclosure
from scan3d.surfaces.certificates import certificate, withdrawn
from scan3d.surfaces.choice import surface
from scan3d.surfaces.enclosures import Certificate, Enclosure, SliceEnclosure
from scan3d.surfaces.slabs import Gap
from scan3d.surfaces.spatial_bounds import SpatialEnclosure
from scan3d.surfaces.tuning import Tuning

__all__ = [
    "METHODS",
    "Allowed",
    "Certificate",
    "Enclosure",
    "Gap",
    "SliceEnclosure",
    "SpatialEnclosure",
    "Tuning",
    "allowed",
    "certificate",
    "enclosure",
    "sigmas",
    "surface",
    "withdrawn",
]
