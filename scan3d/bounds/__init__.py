"""Inner and outer body of a body from touch alone, and certified bounds of the distance of surfaces from it."""

from scan3d.bounds.certificates import Certificate, Premise, certificate, missing, premises
from scan3d.bounds.constraints import Allowed, allowed, sigmas
from scan3d.bounds.enclosures import Enclosure, bounding_nothing, enclosure, unbounded
from scan3d.bounds.slabs import Gap

__all__ = [
    "Allowed",
    "Certificate",
    "Enclosure",
    "Gap",
    "Premise",
    "allowed",
    "bounding_nothing",
    "certificate",
    "enclosure",
    "missing",
    "premises",
    "sigmas",
    "unbounded",
]
