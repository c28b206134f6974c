"""Former module of the bounds, kept for one version; use `scan3d.surfaces`, where a bracket is called an enclosure."""

from scan3d.surfaces import Enclosure as Bracket
from scan3d.surfaces import Gap, certificate
from scan3d.surfaces import enclosure as bracket

__all__ = ["Bracket", "Gap", "bracket", "certificate"]
