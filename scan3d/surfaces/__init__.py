"""The second half of step 2: closed surfaces from contacts, with certified bounds of their distance to the body."""

from scan3d.bounds import Certificate, Enclosure, Gap, certificate, enclosure
from scan3d.choices import METHODS
from scan3d.surfaces.choice import surface

__all__ = ["METHODS", "Certificate", "Enclosure", "Gap", "certificate", "enclosure", "surface"]
