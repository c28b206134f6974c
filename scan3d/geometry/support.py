"""A smooth body's support function, fitted to contacts.

The support function ``h(u) = max <u, p>`` of a strictly convex body has the body's points as its gradient, ``p = ∇h(u)`` for
the outward normal u (h extended to all of space as homogeneous of degree 1).  It is fitted as a sum of real solid harmonics::

    h(u) = Σ c_lm |u|^(1-l) R_lm(u),

to the contacts' distances along their normals, and with less weight to their positions along the surface.  Support functions
follow affine maps, ``h_{AK}(u) = h_K(Aᵀu)``, so the body is first mapped to one with the moments of inertia of the unit ball.
Every ellipsoid becomes the ball itself, and the series of every other smooth body converges much faster.

Under noise the fit is a smoothing spline on the sphere.  ``Δh + 2h`` is the sum of the principal radii of curvature; what is
minimised is the misfit plus λ times the integral of ``((Δ + 2)² h)²``, and λ follows from the contacts by generalised
cross-validation: harmonics of high degree are damped as far as the contacts do not determine them.

Source: R. Schneider, *Convex Bodies: The Brunn-Minkowski Theory*, 1.7; the recurrences of the Racah-normalised solid
harmonics and of their gradients are the standard ones, in Cartesian coordinates so that poles are ordinary points.
G. Wahba, *Spline interpolation and smoothing on the sphere*, SIAM J. Sci. Stat. Comput. 2 (1981) 5-16, and *Spline Models for
Observational Data*, SIAM 1990, chapter 4 (generalised cross-validation).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import cho_factor, cho_solve, eigh
from scipy.spatial import ConvexHull, QhullError

from scan3d.arrays import NEGLIGIBLE, SOME, Array, Index, across, unit
from scan3d.geometry.hulls import hull_near

# Largest number of contacts used for a fit, spread over all slices.
MAX_CONTACTS = 4000
# Points that are evaluated at once.
_BLOCK = 1000
# Regularisation of the coefficients, relative to the mean eigenvalue of the normal matrix.
_RIDGE = 1e-11


@dataclass(frozen=True)
class SupportFit:
    """A fitted support function, in the unit of the contacts."""

    degree: int
    center: Array
    """(3,) centroid, the origin of the affine map."""
    shape: Array
    """(3, 3) symmetric: a point q of the mapped body is ``center + shape q`` in the world."""
    coefficients: Array
    """((degree + 1)²,) of the harmonics, in the order of `harmonics`."""
    rms: float
    """Root mean square distance of the mapped contacts from the mapped body, whose mean radius is about 1."""

    def points(self, normals: Array) -> Array:
        """Points (n, 3) of the body with the outward normals (n, 3)."""
        return self.center + self._gradient(unit(normals @ self.shape)) @ self.shape

    def normals(self, points: Array, start: Array) -> Array:
        """Outward normals (n, 3) of the body at its points (n, 3), from rough normals `start` (n, 3)."""
        mapped = np.linalg.solve(self.shape, (points - self.center).T).T
        directions = _follow(self._gradient, mapped, unit(start @ self.shape))
        return unit(np.asarray(np.linalg.solve(self.shape, directions.T).T))

    def _gradient(self, directions: Array) -> Array:
        """Gradient (n, 3) of the series at unit vectors (n, 3); its components are sums of harmonics as well."""
        slopes, radial = self._slopes
        found = np.empty_like(directions)
        for first in range(0, len(directions), _BLOCK):
            part = directions[first : first + _BLOCK]
            value = _by_order(_levels(part.T, self.degree))
            found[first : first + _BLOCK] = (slopes @ value + (radial @ value) * part.T).T
        return found

    @cached_property
    def _slopes(self) -> tuple[Array, Array]:
        """Coefficients (3, c) of the sums ``Σ c_lm ∇R_lm``, and (c,) of ``Σ c_lm (1 - l) R_lm``."""
        count = len(self.coefficients)
        # the gradients of harmonics are sums of harmonics: those of harmonics that are unit vectors are their coefficients
        unit_vectors = _split(np.eye(count), self.degree)
        gradient = np.stack([part for key in _keys(self.degree) for part in _slopes(unit_vectors, *key)])
        degrees = np.repeat(np.arange(self.degree + 1), 2 * np.arange(self.degree + 1) + 1)
        return np.einsum("c,cxk->xk", self.coefficients, gradient), self.coefficients * (1 - degrees)


def fit_support(
    points: Array, normals: Array, degree: int, sd: Array | None = None, table: float | None = None
) -> SupportFit:
    """Fit to contacts (n, 3) with rough outward normals (n, 3), by a harmonic series up to `degree`.

    sd
        (n,) standard deviations of the contacts along their normals, by whose inverses they are weighted; the series is
        smoothed as far as they make it uncertain.  By default the weights are equal, and nothing is smoothed.
    table
        height z of the plane on which the body stands, if it is known: no contact tells where the body ends there.
    """
    # exact contacts say no more if they are many
    step = max(1, -(-len(points) // (MAX_CONTACTS if sd is None else SOME)))
    center, shape = inertia(points[::step])
    root = np.ones(0) if sd is None else np.nanmin(sd) / np.nan_to_num(sd[::step], nan=np.inf)
    mapped = np.linalg.solve(shape, (points[::step] - center).T).T
    directions = unit(normals[::step] @ shape)
    coefficients = np.zeros((degree + 1) ** 2)
    # each round improves the normals by a factor of ten or more
    for rounds_done in range(3):
        # of the contact's position along the surface, relative to its distance from it: normals of the first round are rough
        weight = (0.1, 0.02)[min(rounds_done, 1)]
        normal_matrix, right, square = np.zeros((len(coefficients),) * 2), np.zeros(len(coefficients)), 0.0
        for first in range(0, len(mapped), _BLOCK):
            part = slice(first, first + _BLOCK)
            value, gradient = harmonics(directions[part], degree)
            tangents = across(directions[part])
            rows = np.hstack([value, *(weight * (gradient * t.T).sum(axis=1) for t in tangents)])
            here = mapped[part]
            aims = [(here * directions[part]).sum(axis=1), *(weight * (here * t).sum(axis=1) for t in tangents)]
            if sd is not None:
                rows *= np.tile(root[part], 3)
                aims = [root[part] * aim for aim in aims]
            aim = np.concatenate(aims)
            normal_matrix += rows @ rows.T
            right += rows @ aim
            square += float(aim @ aim)
        if table is not None:
            # the harmonics in the mapped direction downwards, and the support function there of a body on the table, which
            # counts more than all contacts together
            down = np.array([[0.0, 0.0, -1.0]]) @ shape
            row = harmonics(unit(down), degree)[0][:, 0]
            height = float(center[2] - table) / float(np.linalg.norm(down))
            heavy = 1e3 * np.trace(normal_matrix) / float(row @ row)
            normal_matrix += heavy * np.outer(row, row)
            right += heavy * height * row
            square += heavy * height**2
        normal_matrix.flat[:: len(right) + 1] += _RIDGE * np.trace(normal_matrix) / len(right)
        if sd is None:
            coefficients = cho_solve(cho_factor(normal_matrix), right)
        else:
            coefficients = _smoothed(normal_matrix, right, square, len(mapped), degree)
        fitted = SupportFit(degree, center, shape, coefficients, 0.0)
        # noisy normals may be wrong by more than a right angle at first
        directions = _follow(fitted._gradient, mapped, directions, 3 if sd is None else 10)
    off = ((mapped - fitted._gradient(directions)) * directions).sum(axis=1)
    return SupportFit(degree, center, shape, coefficients, float(np.sqrt(np.mean(off**2))))


def _smoothed(normal_matrix: Array, right: Array, square: float, number: int, degree: int) -> Array:
    """Coefficients (c,) of the least squares of `number` contacts, smoothed by generalised cross-validation.

    `normal_matrix` (c, c) and `right` (c,) are those of the weighted least squares, `square` is their constant term.
    """
    roughness, modes = eigh(np.diag(_roughness(degree)), normal_matrix)
    roughness, along = np.maximum(roughness, 0.0), modes.T @ right
    rough = roughness[roughness > _RIDGE * roughness[-1]]
    # far beyond the values that damp the roughest and the smoothest combination of harmonics by half
    damping = np.geomspace(1 / (1e3 * rough[-1]), 1e3 / rough[0], 100)
    kept = 1 / (1 + np.outer(damping, roughness))
    misfit = square - ((2 - kept) * kept) @ along**2
    best = np.argmin(misfit / (number - kept.sum(axis=1)) ** 2)
    return modes @ (kept[best] * along)


def _roughness(degree: int) -> Array:
    """Means (c,) of ``((Δ + 2)² h)²`` over the unit sphere for each harmonic; 0 for the constant one, which is only a size."""
    degrees = np.repeat(np.arange(degree + 1), 2 * np.arange(degree + 1) + 1)
    first = np.isin(np.arange(len(degrees)), np.arange(degree + 1) ** 2)  # m = 0; those of m > 0 are half as large
    means = ((degrees - 1.0) * (degrees + 2)) ** 4 / (2 * degrees + 1) * np.where(first, 1.0, 0.5)
    return np.where(degrees > 0, means, 0.0)


def fitted_body(fit: SupportFit) -> Any:
    """The convex hull of points near a fitted body, a `trimesh.Trimesh` from which the body is as far outwards as inwards."""
    from trimesh.creation import icosphere

    # spread evenly over the ball-like body to which the fit maps its own, so that needles and discs get even facets as well
    # one subdivision more divides the distance of the facets from the body by four
    sphere = icosphere(subdivisions=6)
    normals = unit(sphere.vertices.view(np.ndarray) @ np.linalg.inv(fit.shape))
    points = fit.points(normals)
    faces = sphere.faces.view(np.ndarray)
    lift = _sagitta(points, normals, faces) / 2
    return hull_near(points + lift[:, None] * normals, faces)


def _sagitta(points: Array, normals: Array, faces: Index) -> Array:
    """Mean depth (n,) of the facets' middles at each of the points (n, 3) of a body with the outward normals (n, 3).

    On a paraboloid the middle of a triangle lies below the surface by 1/18 of the sum over its edges of the products of the
    differences of the points and of the normals.
    """
    across_edges = [values[faces] - np.roll(values[faces], 1, axis=1) for values in (points, normals)]
    depth = np.einsum("fex,fex->f", *across_edges).clip(0) / 18
    count = np.bincount(faces.ravel(), minlength=len(points))
    return np.bincount(faces.ravel(), np.repeat(depth, 3), minlength=len(points)) / count


def harmonics(u: Array, degree: int) -> tuple[Array, Array]:
    """Values (c, n) and gradients (c, 3, n) at unit vectors u (n, 3) of the functions ``|u|^(1-l) R_lm``, l <= degree."""
    along = np.ascontiguousarray(u.T)
    levels = _levels(along, degree)
    value, gradient = _by_order(levels), np.empty(((degree + 1) ** 2, 3, len(u)))
    row = 0
    for n, m in _keys(degree):
        part = slice(row, row + (2 if m else 1))
        gradient[part] = _slopes(levels, n, m)
        gradient[part] += ((1 - n) * value[part])[:, None] * along
        row = part.stop
    return value, gradient


def _levels(u: Array, degree: int) -> dict[tuple[int, int], Array]:
    """Real and imaginary parts (2, n) of the solid harmonics R_lm at unit vectors u (3, n), by l and m."""
    x, y, z = u
    xy, sectoral = x + 1j * y, np.ones(len(x), dtype=complex)
    level = {(0, 0): _parts(sectoral)}
    for m in range(1, degree + 1):
        sectoral = sectoral * xy * np.sqrt((2 * m - 1) / (2 * m))
        level[m, m] = _parts(sectoral)
    for m in range(degree):
        level[m + 1, m] = np.sqrt(2 * m + 1) * z * level[m, m]
        for n in range(m + 2, degree + 1):
            above = (2 * n - 1) * z * level[n - 1, m] - np.sqrt((n - 1) ** 2 - m * m) * level[n - 2, m]
            level[n, m] = above * (1 / np.sqrt(n * n - m * m))
    return level


def _slopes(level: dict[tuple[int, int], Array], n: int, m: int) -> Array:
    """Gradients (1 or 2, 3, k) of the real and, unless m is 0, imaginary part of R_nm, from the harmonics (2, k)."""
    zero, conjugate = np.zeros_like(level[0, 0]), np.array([[1.0], [-1.0]])
    plus = -np.sqrt((n - m) * (n - m - 1)) * level.get((n - 1, m + 1), zero)  # (∂x + i∂y) R
    minus = np.sqrt((n + m) * (n + m - 1)) * level[n - 1, m - 1] if m else conjugate * plus  # (∂x - i∂y) R
    slopes = np.stack(
        [
            0.5 * (plus + minus),
            conjugate * 0.5 * (plus - minus)[::-1],  # divided by 2i
            np.sqrt(n * n - m * m) * level.get((n - 1, m), zero),
        ],
        axis=1,
    )
    return slopes[: 2 if m else 1]


def _keys(degree: int) -> list[tuple[int, int]]:
    """l and m of the harmonics, in their order."""
    return [(n, m) for n in range(degree + 1) for m in range(n + 1)]


def _by_order(level: dict[tuple[int, int], Array]) -> Array:
    """Values (c, n) of the harmonics in their order; those of m = 0 have no imaginary part."""
    degree = max(level)[0]
    return np.concatenate([level[n, m][: 2 if m else 1] for n, m in _keys(degree)])


def _split(rows: Array, degree: int) -> dict[tuple[int, int], Array]:
    """The reverse of `_by_order`."""
    level, row = {}, 0
    for n, m in _keys(degree):
        level[n, m] = rows[row : row + 2] if m else np.stack([rows[row], np.zeros_like(rows[row])])
        row += 2 if m else 1
    return level


def _parts(values: Any) -> Array:
    """Real and imaginary parts (2, n) of complex numbers (n,), which numpy multiplies and divides in less time."""
    return np.stack([values.real, values.imag])


def _follow(gradient: Callable[[Array], Array], points: Any, directions: Array, turns: int = 3) -> Array:
    """Directions (n, 3) whose points on the fitted body lie below the given points (n, 3), improved from `directions`.

    Near the unit ball the offset of the points along the surface is the angle by which the direction must turn.
    """
    for _ in range(turns):
        offset = points - gradient(directions)
        offset -= (offset * directions).sum(axis=1, keepdims=True) * directions
        directions = unit(directions + 0.8 * offset)
    return directions


def inertia(points: Array) -> tuple[Array, Array]:
    """Centroid (3,) and shape (3, 3) of the hull of points.

    The shape is the symmetric map from the unit ball to the ellipsoid that has the hull's moments of inertia.
    """
    middle = points.mean(axis=0)
    try:
        qhull = ConvexHull(points - middle)
    except QhullError:
        extents = np.linalg.svd(points - middle, compute_uv=False)
        if len(extents) < 3 or extents[2] < NEGLIGIBLE * extents[0]:
            raise
        # moved by rounding where very many points in one plane make Qhull fail
        qhull = ConvexHull(points - middle, qhull_options="QJ")
    corners = qhull.points[qhull.simplices]
    volume = np.abs(np.linalg.det(corners)) / 6
    centroid = (volume[:, None] * corners.sum(axis=1) / 4).sum(axis=0) / volume.sum()
    tetrahedra = np.concatenate([corners, np.zeros((len(corners), 1, 3))], axis=1) - centroid
    total = tetrahedra.sum(axis=1)
    second = np.einsum("n,ni,nj->ij", volume, total, total) + np.einsum("n,nai,naj->ij", volume, tetrahedra, tetrahedra)
    values, vectors = np.linalg.eigh(second / (20 * volume.sum()))
    # a ball of radius 1 has the second moment 1/5
    return middle + centroid, vectors * np.sqrt(5 * values) @ vectors.T
