"""What is known of the contacts in the place of a reaction that was not measured, and how it completes a recording."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

import planar
from planar.following import Frames, follow_pushes
from scan3d.arrays import Array, Index, Mask
from scan3d.errors import InputError

COLUMNS = {"f0x": "fx_N", "f0y": "fy_N", "m0z": "mz_Nm"}
"""The reactions, and their columns in the table of a recording."""
IN_PLANE = np.array([0, 1, 5])
"""These, of the six reactions."""
FORCE = "force"
"""What is completed where moments alone were measured."""


@dataclass(frozen=True)
class Known:
    """What is known of the contacts in the place of a reaction.  Raises InputError for what stands for none."""

    friction: float | None = None
    """The coefficient of friction, of contacts that are tangential or at the tip; None: all contacts are at the tip."""
    friction_sd: float = 0.0
    channel: str = ""
    """The reaction that was completed, one of `COLUMNS`, or `FORCE`; "" as long as it is open which one."""

    def __post_init__(self) -> None:
        if self.channel not in ("", *COLUMNS, FORCE):
            raise InputError(
                f"the completed channel must be one of {', '.join(COLUMNS)}, {FORCE}, got {self.channel!r}"
            )
        if self.channel == FORCE and self.friction is None:
            raise InputError("moments alone locate tangential contacts with a known friction only; state it in [known]")

    @property
    def errors(self) -> dict[str, Any]:
        """What `planar.errors` must know of the completed reaction."""
        return {"missing": self.channel, "known_sd": self._angle_sd}

    @property
    def _angle_sd(self) -> float:
        return self.friction_sd / (1 + (self.friction or 0.0) ** 2)

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

    def follow(
        self, touching: Mask, sweep: Index, place: Array, axes: Array, moment: Array, noise: float, rod: planar.Rod
    ) -> tuple[Array, Array]:
        """The forces (n, 3) by the moments (n, 3), dimensionless in clamps with places (n, 3) and axes (n, 3, 3), and the
        covariances (n, 6, 6) of force and moment: zero in rows that do not touch, forces NaN in those that are left open,
        among them those whose error is as large as the force.

        The moment about the rod is not read.  Each stretch of a sweep that touches begins with a small push against the rod.
        """
        order = np.argsort(sweep, kind="stable")
        on, same = touching[order], np.append(False, np.diff(sweep[order]) == 0)
        stretch, rows = np.cumsum(on & ~(np.append(False, on[:-1]) & same))[on], order[on]
        size = np.hypot(moment[rows, 0], moment[rows, 2])
        x, z, nought = moment[rows, 0] / size, moment[rows, 2] / size, np.zeros(len(rows))
        # the plane in which the rod bends is that across its moment
        across, about = np.stack([z, nought, -x], axis=1), np.stack([x, nought, z], axis=1)
        along = np.broadcast_to([0.0, 1.0, 0.0], across.shape)
        to_world = axes[rows]
        plane, normal = np.stack([across, along], axis=1) @ to_world, np.einsum("ni,nij->nj", -about, to_world)
        frames = Frames(stretch, place[rows], plane, normal)
        try:
            told = {"friction": self.friction or 0.0, "friction_angle_sd": self._angle_sd}
            found = follow_pushes(frames, size, rod=rod, noise=noise, **told)
        except ValueError as error:
            raise InputError(str(error)) from None
        force, covariance = np.zeros((len(sweep), 3)), np.zeros((len(sweep), 6, 6))
        fx, fy = found.force.T[:, :, None]
        force[rows] = fx * across + fy * along
        turned = np.concatenate([-np.nan_to_num(fx) * about, size[:, None] * across], axis=1)
        columns = [np.pad(across, ((0, 0), (0, 3))), np.pad(along, ((0, 0), (0, 3))), np.pad(about, ((0, 0), (3, 0)))]
        rates = np.stack([*columns, turned], axis=2)
        covariance[rows] = rates @ found.covariance @ rates.transpose(0, 2, 1)
        force[np.trace(covariance[:, :3, :3], axis1=1, axis2=2) > (force**2).sum(axis=1)] = np.nan
        return force, covariance
