"""Elastic lines: the shape of a rod whose support reactions are given, for drawing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from planar import plots
from planar.arrays import Array
from planar.elastica import bend, partial_shape
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
    base, fx, fy, moment = (column[:, None] for column in reactions)
    side = np.where(moment < 0, -1.0, 1.0)
    fraction = np.linspace(0.0, 1.0, points)

    with np.errstate(divide="ignore", invalid="ignore"):
        f = np.hypot(fx, fy)
        root_f = np.sqrt(f)
        alpha = np.arctan2(-side * fx, fy)
        q = side * moment / (2 * root_f)
        shape = bend(alpha, q)
        s1 = np.minimum(shape.length / root_f, 1.0)
        x, y = partial_shape(alpha, q, shape.length - fraction * s1 * root_f)
        x, y = (shape.x - x) / root_f, (shape.y - y) / root_f
        k, complement = np.hypot(np.sin(alpha / 2), q), np.cos(alpha / 2) ** 2 - q * q
        end = alpha - 2 * np.arctan2(k, np.sqrt(complement)) + np.pi / 2  # φ1 (12)
    free = f == 0
    x, y = np.where(free, 0.0, x), np.where(free, fraction, y)
    s1, end = np.where(free, 1.0, s1), np.where(free, np.pi / 2, end)
    curved = np.stack([base + side * x, y], axis=-1)
    tip = curved[:, -1] + (1 - s1) * np.concatenate([side * np.cos(end), np.sin(end)], axis=1)
    return ElasticLines(curved, np.stack([curved[:, -1], tip], axis=1))
