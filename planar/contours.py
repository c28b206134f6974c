"""Contours of the objects along which the rod is swept.

A contour lies above the base line ``y = 0``.  The rod, clamped on that line and moved in -x, touches its lower side and
passes it from right to left: the slope angle ``α̃`` falls from ``π/2`` (right) through 0 (lowest point) to ``-π/2`` (left).
``t = (cos α̃, sin α̃)`` is the tangent and ``n = (sin α̃, -cos α̃)`` the outward normal.

A strictly convex contour is parametrised by its slope, a convex polygon by its edges and vertices (`planar.paths`).  Contours
that are not convex, and several in one plane, are loops (`planar.loops`), which the rod may touch at several places at once.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import ArrayLike

from planar.arrays import ROUNDING, Array
from planar.loops import Loop, Outlines, crosses_itself, ellipse_loop, polygon_loop, spline_loop
from planar.paths import Path, polygon_paths, smooth_path

# Step in slope over which a curve's radius of curvature is differenced: truncation, which grows with the square of the step,
# and rounding, which grows with its inverse, are alike.
_DIFFERENCE = float(np.cbrt(np.finfo(float).eps))
# Slopes at which a curve is checked for convexity, and from which the search for the nearest point of a contour starts.
_SLOPES = 721
# Steps of the iterations for a foot point: bisection halves the error in each, until it is rounding.
_FOOT_POINT_STEPS = 60
# Pairs of points and edges whose distances are computed at once, which limits the memory.
_PAIRS_AT_ONCE = 2_000_000


class Contour(ABC):
    """A contour in the plane, in rod lengths."""

    @property
    def is_convex(self) -> bool:
        """Whether the rod touches it at one place at a time, which then follows a path."""
        return True

    @abstractmethod
    def path(self) -> Path:
        """The part of a convex contour that the rod can reach, from its first touch onwards."""

    def loops(self) -> list[Loop]:
        """The whole contour as closed loops, body on the left."""
        raise ValueError(
            f"{type(self).__name__} has a lower side only; closed are Circle, Ellipse, Polygon and Curve.from_points"
        )

    @abstractmethod
    def distance(self, points: ArrayLike) -> Array:
        """Distance (n,) of points (n, 2) to the contour, in rod lengths, never negative."""


class SmoothContour(Contour):
    """A strictly convex contour given by the place and the curvature of its points as functions of the slope angle."""

    @abstractmethod
    def points(self, slope: ArrayLike) -> Array:
        """Contour points (n, 2) with the slope angles (n,) in radians."""

    @abstractmethod
    def radius_of_curvature(self, slope: ArrayLike) -> Array:
        """Radius of curvature (n,) at the slope angles (n,), in rod lengths."""

    def path(self) -> Path:
        return smooth_path(self)

    def distance(self, points: ArrayLike) -> Array:
        """Distance (n,) of points (n, 2) to the contour's lower side, slopes from -π/2 to π/2."""
        points = np.asarray(points, dtype=float)
        slope = np.linspace(-np.pi / 2, np.pi / 2, _SLOPES)
        nearest = slope[scipy.spatial.cKDTree(self.points(slope)).query(points)[1]]
        spacing = np.pi / (_SLOPES - 1)
        low, high = nearest - spacing, nearest + spacing
        for _ in range(_FOOT_POINT_STEPS):  # the foot point, where the offset is normal to the contour, by bisection
            middle = (low + high) / 2
            offset = points - self.points(middle)
            ahead = offset[:, 0] * np.cos(middle) + offset[:, 1] * np.sin(middle) > 0
            low, high = np.where(ahead, middle, low), np.where(ahead, high, middle)
        foot = self.points(np.clip(low, -np.pi / 2, np.pi / 2))
        return np.asarray(np.linalg.norm(points - foot, axis=1))


@dataclass(frozen=True)
class Curve(SmoothContour):
    """Any strictly convex contour, from callables of the slope angle (n,) in [-π/2, π/2], radians.

    `place` gives its points (n, 2), `curvature_radius` its radius of curvature (n,), which must be positive; without it the
    radius is differenced from the points.  `from_support` makes one from the support function.
    """

    place: Callable[[Array], Array]
    curvature_radius: Callable[[Array], Array] | None = None

    def __post_init__(self) -> None:
        slope = np.linspace(-np.pi / 2, np.pi / 2, _SLOPES)
        points, radius = np.asarray(self.points(slope)), self.radius_of_curvature(slope)
        if points.shape != (len(slope), 2) or not np.isfinite(points).all():
            raise ValueError(
                f"a curve must give finite points (n, 2) for slopes (n,), got the shape {points.shape}; of x and y over any "
                "parameter make one by Curve.from_points(x(t), y(t))"
            )
        if not (radius > 0).all():
            worst = int(np.argmin(radius))
            raise ValueError(
                f"the curve must be strictly convex: at the slope {np.degrees(slope[worst]):.4g}° its radius of curvature "
                f"is {radius[worst]:.3g}"
            )
        chords = np.diff(points, axis=0)
        lag = np.arctan2(chords[:, 1], chords[:, 0]) - (slope[:-1] + slope[1:]) / 2
        if np.abs(lag).max() > np.pi / (_SLOPES - 1):
            raise ValueError(
                "the curve's points must be given by their slope angle: their chords have other directions"
            )

    @classmethod
    def from_support(
        cls,
        support: Callable[[Array], Array],
        derivative: Callable[[Array], Array],
        second_derivative: Callable[[Array], Array] | None = None,
    ) -> Curve:
        """From the support function ``h(α̃) = max <n, p>`` in the direction of the normal ``n = (sin α̃, -cos α̃)``."""

        def place(slope: Array) -> Array:
            c, s, h, d = np.cos(slope), np.sin(slope), support(slope), derivative(slope)
            return np.stack([h * s + d * c, -h * c + d * s], axis=-1)

        if second_derivative is None:
            return cls(place)
        return cls(place, lambda slope: support(slope) + second_derivative(slope))

    @staticmethod
    def from_points(x: ArrayLike, y: ArrayLike) -> ClosedCurve:
        """The smooth closed curve, convex or not, through points x, y (n,) in either order: a periodic cubic spline.

        The points are those of one turn; the last is joined to the first.  Raises ValueError for curves that cross themselves.
        """
        points = [np.asarray(column, dtype=float) for column in (x, y)]
        if points[0].ndim != 1 or points[0].shape != points[1].shape:
            raise ValueError(f"a curve needs x and y of one shape (n,), got {points[0].shape} and {points[1].shape}")
        return ClosedCurve(np.stack(points, axis=1))

    def points(self, slope: ArrayLike) -> Array:
        return np.asarray(self.place(np.asarray(slope, dtype=float)))

    def radius_of_curvature(self, slope: ArrayLike) -> Array:
        slope = np.asarray(slope, dtype=float)
        if self.curvature_radius is not None:
            return np.asarray(self.curvature_radius(slope))
        # one-sided at the ends of the range of slopes
        low, high = np.maximum(slope - _DIFFERENCE, -np.pi / 2), np.minimum(slope + _DIFFERENCE, np.pi / 2)
        chord = self.points(high) - self.points(low)
        middle = (low + high) / 2
        return np.asarray((chord[..., 0] * np.cos(middle) + chord[..., 1] * np.sin(middle)) / (high - low))


@dataclass(frozen=True)
class Mirrored(SmoothContour):
    """The mirror image of a smooth contour, x → -x: a sweep in +x along the one is a sweep in -x along the other."""

    image: SmoothContour

    def loops(self) -> list[Loop]:
        across = np.array([-1.0, 1.0])
        return [loop._replace(ellipse=loop.ellipse * [across, across, -across]) for loop in self.image.loops()]

    def points(self, slope: ArrayLike) -> Array:
        return np.asarray(self.image.points(-np.asarray(slope, dtype=float)) * np.array([-1.0, 1.0]))

    def radius_of_curvature(self, slope: ArrayLike) -> Array:
        return self.image.radius_of_curvature(-np.asarray(slope, dtype=float))

    def distance(self, points: ArrayLike) -> Array:
        return self.image.distance(np.asarray(points, dtype=float) * np.array([-1.0, 1.0]))


@dataclass(frozen=True)
class Ellipse(SmoothContour):
    """Ellipse with `semi_axes` (a, b), the first turned by `angle` from the x axis, in rod lengths and radians."""

    semi_axes: tuple[float, float]
    center: tuple[float, float]
    angle: float = 0.0

    def __post_init__(self) -> None:
        a, b = self.semi_axes
        if not (np.isfinite([a, b, *self.center, self.angle]).all() and a > 0 and b > 0):
            raise ValueError(
                f"an ellipse needs finite numbers and positive semi-axes, got semi_axes={self.semi_axes}, "
                f"center={self.center}, angle={self.angle}"
            )

    def _normal_in_axes(self, slope: ArrayLike) -> tuple[Array, Array, Array]:
        slope = np.asarray(slope, dtype=float)
        # n = (sin α̃, -cos α̃) turned into the ellipse's axes
        u, v = np.sin(slope - self.angle), -np.cos(slope - self.angle)
        a, b = self.semi_axes
        return u, v, np.hypot(a * u, b * v)

    def loops(self) -> list[Loop]:
        return [ellipse_loop(self.semi_axes, self.center, self.angle)]

    def points(self, slope: ArrayLike) -> Array:
        u, v, support = self._normal_in_axes(slope)
        a, b = self.semi_axes
        p, q = a * a * u / support, b * b * v / support
        c, s = np.cos(self.angle), np.sin(self.angle)
        return np.stack([self.center[0] + c * p - s * q, self.center[1] + s * p + c * q], axis=-1)

    def radius_of_curvature(self, slope: ArrayLike) -> Array:
        a, b = self.semi_axes
        return np.asarray((a * b) ** 2 / self._normal_in_axes(slope)[2] ** 3)

    def distance(self, points: ArrayLike) -> Array:
        offset = np.asarray(points, dtype=float) - self.center
        c, s = np.cos(self.angle), np.sin(self.angle)
        x, y = np.abs(offset @ np.array([c, s])), np.abs(offset @ np.array([-s, c]))
        a, b = self.semi_axes
        # Foot point (a cos θ, b sin θ): alternating between the foot and the centre of curvature there converges fast.
        u, v = np.full_like(x, np.sqrt(0.5)), np.full_like(x, np.sqrt(0.5))
        for _ in range(_FOOT_POINT_STEPS):
            ex, ey = (a * a - b * b) * u**3 / a, (b * b - a * a) * v**3 / b
            scale = np.hypot(a * u - ex, b * v - ey) / np.maximum(np.hypot(x - ex, y - ey), np.finfo(float).tiny)
            u = np.clip(((x - ex) * scale + ex) / a, 0.0, 1.0)
            v = np.clip(((y - ey) * scale + ey) / b, 0.0, 1.0)
            norm = np.hypot(u, v)
            u, v = u / norm, v / norm
        return np.asarray(np.hypot(x - a * u, y - b * v))


@dataclass(frozen=True)
class Circle(SmoothContour):
    """Circle with `radius` and `center`, in rod lengths: the contour (4) of the paper."""

    radius: float
    center: tuple[float, float]

    def __post_init__(self) -> None:
        if not (np.isfinite([self.radius, *self.center]).all() and self.radius > 0):
            raise ValueError(f"a circle needs a positive radius and a finite center, got {self}")

    def loops(self) -> list[Loop]:
        return [ellipse_loop((self.radius, self.radius), self.center, 0.0)]

    def points(self, slope: ArrayLike) -> Array:
        slope = np.asarray(slope, dtype=float)
        return np.asarray(self.center) + self.radius * np.stack([np.sin(slope), -np.cos(slope)], axis=-1)

    def radius_of_curvature(self, slope: ArrayLike) -> Array:
        return np.full(np.shape(slope), float(self.radius))

    def distance(self, points: ArrayLike) -> Array:
        offset = np.asarray(points, dtype=float) - self.center
        return np.abs(np.hypot(offset[..., 0], offset[..., 1]) - self.radius)


@dataclass(frozen=True)
class Polygon(Contour):
    """Polygon with `vertices` (n, 2) in rod lengths, in either order: any simple loop.

    Duplicate and collinear vertices are dropped; afterwards `vertices` runs counter-clockwise.  Raises ValueError if the
    polygon crosses or touches itself, or has no area.
    """

    vertices: Array = field(repr=False)

    def __post_init__(self) -> None:
        vertices = _tidy(_checked_points(self.vertices, "a polygon", "vertices"))
        vertices.setflags(write=False)
        object.__setattr__(self, "vertices", vertices)

    @cached_property
    def _convex(self) -> bool:
        return not (_turns(self.vertices) < 0).any()

    @property
    def is_convex(self) -> bool:
        return self._convex

    def path(self) -> Path:
        _check_convex(self)
        return polygon_paths([self.vertices])

    def loops(self) -> list[Loop]:
        return [polygon_loop(self.vertices)]

    def distance(self, points: ArrayLike) -> Array:
        points = np.asarray(points, dtype=float)
        edges = np.roll(self.vertices, -1, axis=0) - self.vertices
        squared = (edges**2).sum(axis=1)
        nearest = np.empty(len(points))
        rows = max(1, _PAIRS_AT_ONCE // len(edges))
        for start in range(0, len(points), rows):
            offset = points[start : start + rows, None] - self.vertices
            along = np.clip((offset * edges).sum(axis=-1) / squared, 0.0, 1.0)
            gap = np.linalg.norm(offset - along[..., None] * edges, axis=-1)
            nearest[start : start + rows] = gap.min(axis=1)
        return nearest


class _Looped(Contour):
    """Contours that are swept as loops: those that need not be convex."""

    @cached_property
    def _outline(self) -> Outlines:
        return Outlines([self.loops()])

    @property
    def is_convex(self) -> bool:
        return False

    def path(self) -> Path:
        raise ValueError("a contour that is swept as loops has no path by its slope")

    def distance(self, points: ArrayLike) -> Array:
        points = np.asarray(points, dtype=float)
        return np.abs(self._outline.nearest(np.zeros(len(points), dtype=np.intp), points).gap)


@dataclass(frozen=True)
class ClosedCurve(_Looped):
    """The smooth closed curve through `points` (n, 2) in rod lengths, convex or not; made by `Curve.from_points`."""

    points: Array = field(repr=False)

    def __post_init__(self) -> None:
        points = _checked_points(self.points, "a curve", "points")
        if len(points) > 1 and (points[0] == points[-1]).all():
            points = points[:-1]
        _, area = _extent(points)
        points = np.ascontiguousarray(points if area > 0 else points[::-1])
        if not np.hypot(*(points - np.roll(points, 1, axis=0)).T).all():
            raise ValueError("a curve needs points that differ from their neighbours")
        points.setflags(write=False)
        object.__setattr__(self, "points", points)
        between = np.linspace(0, 1, 4 * len(points), endpoint=False)
        _check_crossing(self._outline.at(np.zeros(len(between), dtype=np.intp), between).point, "curve")

    def loops(self) -> list[Loop]:
        return [spline_loop(self.points)]


@dataclass(frozen=True)
class Contours(_Looped):
    """Several closed contours in one plane, swept together: bodies beside each other.

    Contours inside others are holes, or bodies in holes: no rod reaches them from outside, and they are left out.  Raises
    ValueError for contours that overlap.
    """

    parts: Sequence[Contour]

    def __post_init__(self) -> None:
        parts = tuple(self.parts)
        if not parts:
            raise ValueError("several contours need at least one")
        for part in parts:
            check_contour(part)
        outlines = [Outlines([part.loops()]) for part in parts]
        outer = []
        for i in range(len(parts)):
            hidden = False
            for k in range(len(parts)):
                apart = (outlines[i].low > outlines[k].high) | (outlines[k].low > outlines[i].high)
                if k != i and not apart.any():
                    points = outlines[i].samples
                    inside = outlines[k].nearest(np.zeros(len(points), dtype=np.intp), points, 0.0).gap < 0
                    if inside.any() != inside.all():
                        raise ValueError("contours in one plane must not overlap; give the outline of their union")
                    hidden |= bool(inside.all())
            if not hidden:
                outer.append(parts[i])
        object.__setattr__(self, "parts", tuple(outer))

    def loops(self) -> list[Loop]:
        return [loop for part in self.parts for loop in part.loops()]


def mirrored(contour: Contour) -> Contour:
    """The mirror image of a contour, x → -x."""
    across = np.array([-1.0, 1.0])
    if isinstance(contour, Polygon):
        return Polygon(contour.vertices * across)
    if isinstance(contour, ClosedCurve):
        return ClosedCurve(contour.points * across)
    if isinstance(contour, Contours):
        return Contours([mirrored(part) for part in contour.parts])
    check_contour(contour)
    assert isinstance(contour, SmoothContour)
    return Mirrored(contour)


def check_contour(contour: object) -> None:
    """Raise TypeError for anything that is not a contour, such as an array of vertices."""
    if not isinstance(contour, Contour):
        raise TypeError(f"a contour must be a planar.Circle, Ellipse, Curve or Polygon, got {type(contour).__name__}")


def _checked_points(given: ArrayLike, what: str, name: str) -> Array:
    points = np.asarray(given, dtype=float)
    if points.ndim != 2 or points.shape[1:] != (2,) or len(points) < 3:
        raise ValueError(f"{what} needs {name} of shape (n >= 3, 2), got {points.shape}")
    if not np.isfinite(points).all():
        raise ValueError(
            f"{what} needs finite {name}, got {int((~np.isfinite(points)).any(axis=1).sum())} that are not"
        )
    return points


def _check_convex(contour: Polygon) -> None:
    turn = _turns(contour.vertices)
    if (turn < 0).any():
        worst, at = int(np.argmin(turn)), contour.vertices
        raise ValueError(
            f"this needs a convex polygon: at ({at[worst, 0]:.6g}, {at[worst, 1]:.6g}) it turns inwards by "
            f"{np.degrees(-turn[worst]):.3g}°; pass its convex hull (scipy.spatial.ConvexHull) if that is what you mean"
        )


def _check_crossing(vertices: Array, what: str) -> None:
    pair = crosses_itself(vertices)
    if pair is not None:
        x, y = vertices[pair[0]]
        raise ValueError(f"the {what} must not cross or touch itself: it does next to ({x:.6g}, {y:.6g})")


def _extent(vertices: Array) -> tuple[float, float]:
    """Size and signed area of a closed polygon, which must have one."""
    size = float(np.ptp(vertices, axis=0).max())
    following = np.roll(vertices, -1, axis=0)
    centre = vertices.mean(axis=0)
    area = (
        np.sum(
            (vertices - centre)[:, 0] * (following - centre)[:, 1]
            - (vertices - centre)[:, 1] * (following - centre)[:, 0]
        )
        / 2
    )
    if abs(area) <= ROUNDING * size**2:
        raise ValueError("a polygon needs an area: its vertices lie on one line, or the polygon crosses itself")
    return size, float(area)


def _turns(vertices: Array) -> Array:
    """Angles (n,) by which a closed polygon turns at its vertices."""
    before, after = vertices - np.roll(vertices, 1, axis=0), np.roll(vertices, -1, axis=0) - vertices
    return np.asarray(np.arctan2(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0], (before * after).sum(axis=1)))


def _tidy(vertices: Array) -> Array:
    """Counter-clockwise vertices without duplicates and without corners that turn by less than rounding."""
    size = np.ptp(vertices, axis=0).max()
    steps = np.roll(vertices, -1, axis=0) - vertices
    kept = vertices[np.hypot(*steps.T) > ROUNDING * size]
    if len(kept) < 3:
        raise ValueError(f"a polygon needs at least three distinct vertices, got {len(kept)}")
    if _extent(kept)[1] < 0:
        kept = kept[::-1]
    while True:
        before, after = kept - np.roll(kept, 1, axis=0), np.roll(kept, -1, axis=0) - kept
        cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
        chord = np.maximum(np.hypot(*(before + after).T), np.finfo(float).tiny)
        straight = (np.abs(cross) <= ROUNDING * size * chord) & ((before * after).sum(axis=1) > 0)
        # never two neighbours at once: the chord must stay within rounding of the edges that it replaces
        even = np.arange(len(kept)) % 2 == 0
        even[-1] &= len(kept) % 2 == 0
        straight &= even | ~(np.roll(straight, 1) | np.roll(straight, -1))
        if not straight.any() or len(kept) <= 3:
            break
        kept = kept[~straight]
    turn = np.arctan2(cross, (before * after).sum(axis=1))
    if round(turn.sum() / (2 * np.pi)) != 1:
        raise ValueError(
            f"the polygon must not cross itself: it turns {turn.sum() / (2 * np.pi):.0f} times instead of once"
        )
    if (turn < 0).any():
        _check_crossing(kept, "polygon")
    return np.ascontiguousarray(kept)
