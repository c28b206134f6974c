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

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any

import numpy as np
from scipy.linalg import cho_factor, cho_solve, eigh

from scan3d.arrays import SOME, Array, Index, across, unit
from scan3d.geometry.hulls import hull, hull_near

# Largest number of contacts used for a fit, spread over all slices.
MAX_CONTACTS = 4000
# Points that are evaluated at once.
_BLOCK = 4000
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
            value = _values(part.T, self.degree)
            found[first : first + _BLOCK] = (slopes @ value + (radial @ value) * part.T).T
        return found

    @cached_property
    def _slopes(self) -> tuple[Array, Array]:
        """Coefficients (3, c) of the sums ``Σ c_lm ∇R_lm``, and (c,) of ``Σ c_lm (1 - l) R_lm``."""
        # the gradients of harmonics are sums of harmonics: those of harmonics that are unit vectors are their coefficients
        gradient = _gradients(np.eye(len(self.coefficients)), self.degree)
        return np.einsum("c,cxk->xk", self.coefficients, gradient), self.coefficients * (1 - _degrees(self.degree))


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
        fitted = SupportFit(degree, center, shape, coefficients)
        # noisy normals may be wrong by more than a right angle at first
        directions = _follow(fitted._gradient, mapped, directions, 3 if sd is None else 10)
    return fitted


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
    degrees = _degrees(degree)
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
    value = _values(along, degree)
    gradient, radial = _gradients(value, degree), (1 - _degrees(degree))[:, None] * value
    for k in range(3):
        gradient[:, k] += radial * along[k]
    return value, gradient


def _values(u: Array, degree: int) -> Array:
    """The solid harmonics (c, n) at unit vectors u (3, n): by l and m real and, unless m is 0, imaginary part of R_lm."""
    x, y, z = u
    value = np.empty(((degree + 1) ** 2, len(x)))
    xy, sectoral = x + 1j * y, np.ones(len(x), dtype=complex)
    value[0] = 1.0
    for m in range(1, degree + 1):
        sectoral = sectoral * (xy * math.sqrt((2 * m - 1) / (2 * m)))
        value[_rows(m, m)] = sectoral.real, sectoral.imag
    for m in range(degree):
        np.multiply(math.sqrt(2 * m + 1) * z, value[_rows(m, m)], out=value[_rows(m + 1, m)])
        for n in range(m + 2, degree + 1):
            size = math.sqrt(n * n - m * m)
            above = np.multiply((2 * n - 1) / size * z, value[_rows(n - 1, m)], out=value[_rows(n, m)])
            above -= math.sqrt((n - 1) ** 2 - m * m) / size * value[_rows(n - 2, m)]
    return value


def _gradients(value: Array, degree: int) -> Array:
    """Gradients (c, 3, n) of the solid harmonics, from their values (c, n)."""
    gradient = np.zeros((len(value), 3, value.shape[1]))
    for n in range(1, degree + 1):
        for m in range(n + 1):
            slopes = gradient[_rows(n, m)]
            if m < n:
                slopes[:, 2] = math.sqrt(n * n - m * m) * value[_rows(n - 1, m)]
            if m < n - 1:  # half of (∂x + i∂y) R, of which (∂x - i∂y) R is the conjugate where m is 0
                real, imaginary = -math.sqrt((n - m) * (n - m - 1)) / (2 if m else 1) * value[_rows(n - 1, m + 1)]
                slopes[0, 0], slopes[0, 1] = real, imaginary
                if m:
                    slopes[1, 0], slopes[1, 1] = imaginary, -real
            if m:  # half of (∂x - i∂y) R
                real, *imaginary_part = math.sqrt((n + m) * (n + m - 1)) / 2 * value[_rows(n - 1, m - 1)]
                slopes[0, 0] += real
                slopes[1, 1] += real
                for imaginary in imaginary_part:  # none where m - 1 is 0
                    slopes[1, 0] += imaginary
                    slopes[0, 1] -= imaginary
    return gradient


@cache
def _rows(n: int, m: int) -> slice:
    """The rows of real and, unless m is 0, imaginary part of R_nm."""
    return slice(n * n + max(2 * m - 1, 0), n * n + 2 * m + 1)


def _degrees(degree: int) -> Index:
    """l (c,) of the harmonics, in their order."""
    return np.repeat(np.arange(degree + 1), 2 * np.arange(degree + 1) + 1)


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
    corners = hull(points - middle).triangles.view(np.ndarray)
    volume = np.abs(np.linalg.det(corners)) / 6
    centroid = (volume[:, None] * corners.sum(axis=1) / 4).sum(axis=0) / volume.sum()
    tetrahedra = np.concatenate([corners, np.zeros((len(corners), 1, 3))], axis=1) - centroid
    total = tetrahedra.sum(axis=1)
    second = np.einsum("n,ni,nj->ij", volume, total, total) + np.einsum("n,nai,naj->ij", volume, tetrahedra, tetrahedra)
    values, vectors = np.linalg.eigh(second / (20 * volume.sum()))
    # a ball of radius 1 has the second moment 1/5
    return middle + centroid, vectors * np.sqrt(5 * values) @ vectors.T
