"""Elastic lines: the shape of a rod whose support reactions are given, for drawing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from planar import plots
from planar.arrays import BLOCK, Array
from planar.elastica import bend
from planar.pieces import piece
from planar.reactions import checked_reactions

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class ElasticLines(NamedTuple):
    """Shapes of n rods in rod lengths; NaN where a rod with such reactions does not exist."""

    curved: Array
    """(n, points, 2) from the clamp to the contact, evenly in arc length."""
    straight: Array
    """(n, 2, 2) ends of the straight part beyond the contact; they coincide in tip contact."""

    def plot(self, *, axes: Axes | None = None, **style: Any) -> Any:
        """The rods, those in tip contact in blue, the others in red up to the contact and in black beyond it.

        `axes` are matplotlib's, by default new ones; `style` is that of `matplotlib.axes.Axes.plot`.  Returns the axes.
        """
        return plots.plot_lines(self.curved, self.straight, axes, style)


def elastic_lines(x0: ArrayLike, f0x: ArrayLike, f0y: ArrayLike, m0z: ArrayLike, points: int = 100) -> ElasticLines:
    """Elastic lines of rods with the given base positions and support reactions (n,).

    A rod without force is straight.  Reactions of sweeps in +x have ``m0z < 0``.  Raises ValueError for arrays of
    different lengths or fewer than 2 points.
    """
    reactions = checked_reactions(x0, f0x, f0y, m0z)
    if points < 2:
        raise ValueError(f"an elastic line needs at least 2 points, got {points}")
    parts = [slice(first, first + BLOCK) for first in range(0, max(len(reactions[0]), 1), BLOCK)]
    drawn = (_drawn(points, *(column[part, None] for column in reactions)) for part in parts)
    return ElasticLines(*(np.concatenate(columns) for columns in zip(*drawn, strict=True)))


def _drawn(points: int, base: Array, fx: Array, fy: Array, moment: Array) -> tuple[Array, Array]:
    side = np.where(moment < 0, -1.0, 1.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        f = np.hypot(fx, fy)
        root_f = np.sqrt(f)
        alpha = np.arctan2(-side * fx, fy)
        q = side * moment / (2 * root_f)
        s1 = np.where(f > 0, np.minimum(bend(alpha, q).length / root_f, 1.0), 1.0)
    shape = piece(-fx, -fy, np.full_like(f, np.pi / 2), -moment, np.linspace(0.0, 1.0, points) * s1)
    curved = np.stack([base + shape.x, shape.y], axis=-1)
    end = shape.phi[:, -1:]
    tip = curved[:, -1] + (1 - s1) * np.concatenate([np.cos(end), np.sin(end)], axis=1)
    return curved, np.stack([curved[:, -1], tip], axis=1)
