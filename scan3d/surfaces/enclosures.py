"""What encloses a body: an inner and an outer body from touch alone, and the certificate of a surface between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from scan3d.arrays import Array, Index, Mask
from scan3d.geometry.vectors import highest
from scan3d.reconstruction.slices import SliceStack
from scan3d.shown import Described, Rows
from scan3d.surfaces.slabs import Gap

if TYPE_CHECKING:
    import trimesh


@dataclass(frozen=True, kw_only=True, repr=False)
class Enclosure(Described):
    """Inner and outer body, between which the surface of the true body lies; lengths in the cloud's unit."""

    inner: trimesh.Trimesh
    """The inner body, a `trimesh.Trimesh`."""
    corners: Array
    """(w, 3) corners of the outer body."""
    gap: Array
    """(w,) their distance from the inner body."""
    bound: float
    """Upper bound of the Hausdorff distance between the inner body and the true one; infinite if nothing bounds it."""
    margin: float
    """Largest error of a contact that the bounds allow for, contained in `bound`."""
    volume: tuple[float, float]
    """Lower and upper bound of the true volume."""
    confidence: float = 1.0
    """Probability with which bound and volume hold: 1 for exact contacts, and for a given margin."""

    def parts(self) -> dict[str, float]:
        """The largest gap by each cause."""
        raise NotImplementedError

    def support(self, directions: Array) -> tuple[Array, Array]:
        """Lower and upper bounds (d,) of the true body's support function in directions (d, 3), unit vectors.

        They hold with the enclosure's `confidence`, and are infinite where nothing bounds the body.
        """
        if not self.confidence:
            nothing = np.full(len(directions), np.inf)
            return -nothing, nothing
        return self._support(directions)

    def _support(self, directions: Array) -> tuple[Array, Array]:
        raise NotImplementedError

    def outer_planes(self) -> Array:
        """Planes (k, 4), n and c with <n, x> <= c, of a convex body that contains the true one with the enclosure's confidence.

        There are none where the body is unbounded.
        """
        if not (self.confidence and np.isfinite(self.bound) and np.isfinite(self.corners).all()):
            return np.empty((0, 4))
        normals = ConvexHull(self.corners).equations[:, :3]
        return np.column_stack([normals, self.support(normals)[1]])

    def summary(self) -> Rows:
        """The bound with its parts, and the volume."""
        parts = ", ".join(f"{name} {gap:.4g}" for name, gap in self.parts().items())
        low, high = self.volume
        return [
            ("inner body", f"{len(self.inner.vertices)} vertices, {len(self.inner.faces)} faces"),
            ("outer body", f"{len(self.corners)} corners"),
            ("bound", f"{self.bound:.4g} with {100 * self.confidence:g} % confidence; parts: {parts}"),
            ("margin", f"{self.margin:.4g}"),
            ("volume", f"{low:.6g} to {high:.6g}"),
        ]


@dataclass(frozen=True, kw_only=True, repr=False)
class SliceEnclosure(Enclosure):
    """The enclosure by contacts in slices: the outer body consists of slabs between the slices.

    The inner body is the convex hull of exact contacts, or of the points that noisy contacts prove.  `bound` and `volume` are
    the tighter ones of the slabs' and of those by `tangents`.
    """

    foot: Array
    """(w, 3) points of the inner body nearest to the corners; infinite where the outer body is unbounded."""
    kind: NDArray[np.int8]
    """(w,) of `Gap`."""
    straight: Mask
    """(w, 2) whether the body goes on straight, at the corner's half-spaces, below and above the slab."""
    slab: Index
    """(w,) number of the corner's slab: slab i lies below slice i of `stack`."""
    stack: SliceStack
    """The slices between which the slabs lie."""
    excess: float = 0.0
    """How far the inner body may stick out of the true one, by errors of heights by the calibration; `bound` contains it."""
    tangents: Enclosure | None = None
    """The enclosure of the same contacts by their tangents, along whatever axes their slices lie, where it is tighter."""

    def part(self, kind: Gap) -> float:
        """The largest gap of one kind, 0 if no corner is of that kind."""
        gap = self.gap[self.kind == kind]
        return min(float(gap.max()), self.bound) if len(gap) else 0.0

    def parts(self) -> dict[str, float]:
        return {kind.name.lower(): self.part(kind) for kind in Gap}

    def _support(self, directions: Array) -> tuple[Array, Array]:
        lower = highest(self.inner.vertices.view(np.ndarray), directions) - self.margin - self.excess
        upper = np.full(len(directions), np.inf)
        if np.isfinite(self.bound) and np.isfinite(self.corners).all():
            upper = highest(self.corners, directions) + self.margin
        return lower, upper if self.tangents is None else np.minimum(upper, self.tangents.support(directions)[1])


@dataclass(frozen=True, kw_only=True, repr=False)
class CellEnclosure(Enclosure):
    """The enclosure by contacts in slices along several axes: what is left of the cells between the slices' planes.

    Its contacts are exact, and all its corners finite.
    """

    def _support(self, directions: Array) -> tuple[Array, Array]:
        return highest(self.inner.vertices.view(np.ndarray), directions), highest(self.corners, directions)

    def parts(self) -> dict[str, float]:
        return {"cells": self.bound}


class Certificate(NamedTuple):
    """How far a surface can be from the true body, from touch alone, in the cloud's unit."""

    bound: float
    """Upper bound of the Hausdorff distance between the surface and the true body; infinite if nothing bounds it."""
    at_vertices: Array
    """(v,) local bound at the surface's vertices: the largest possible distance of the true surface from each of them."""

    def __repr__(self) -> str:
        known = self.at_vertices[np.isfinite(self.at_vertices)]
        local = f"{known.min():.4g} to {known.max():.4g}" if len(known) else "unknown"
        return f"Certificate(bound={self.bound:.6g}, at_vertices: {local} at {len(known)} of {len(self.at_vertices)})"
