"""What is known of the contacts in the place of a reaction that was not measured, and how it completes a recording."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

import planar
from scan3d.arrays import Array, Index
from scan3d.errors import InputError

COLUMNS = {"f0x": "fx_N", "f0y": "fy_N", "m0z": "mz_Nm"}
"""The reactions, and their columns in the table of a recording."""


@dataclass(frozen=True)
class Known:
    """What is known of the contacts in the place of a reaction.  Raises InputError for what stands for none."""

    friction: float | None = None
    """The coefficient of friction, of contacts that are tangential or at the tip; None: all contacts are at the tip."""
    friction_sd: float = 0.0
    channel: str = ""
    """The reaction that was completed, one of `COLUMNS`; "" as long as it is open which one."""

    def __post_init__(self) -> None:
        if self.channel not in ("", *COLUMNS):
            raise InputError(f"the completed channel must be one of {', '.join(COLUMNS)}, got {self.channel!r}")

    @property
    def errors(self) -> dict[str, Any]:
        """What `planar.errors` must know of the completed reaction."""
        return {"missing": self.channel, "known_sd": self.friction_sd / (1 + (self.friction or 0.0) ** 2)}

    @property
    def words(self) -> str:
        """What is assumed, for messages."""
        if self.friction is None:
            return f"that all contacts are at the tip, which stands for {self.channel}"
        return f"a coefficient of friction of {self.friction:g} ± {self.friction_sd:g}, which stands for {self.channel}"

    def complete(self, reactions: dict[str, Array], rows: Index, direction: int, rod: planar.Rod) -> Array:
        """The reaction (n,) of the completed channel: zero but in some rows, NaN where the others leave several contacts open.

        Raises InputError for channels that do not tell.
        """
        columns = (None if name == self.channel else reactions[name][rows] for name in COLUMNS)
        f0x, f0y, m0z = columns
        told: dict[str, Any] = {"tip": True} if self.friction is None else {"friction": self.friction}
        try:
            done = planar.complete(np.zeros(len(rows)), f0x, f0y, m0z, **told, direction=direction, rod=rod)
        except ValueError as error:
            raise InputError(str(error)) from None
        found = np.zeros(len(reactions[self.channel]))
        found[rows] = getattr(done.reactions, self.channel)
        return found
