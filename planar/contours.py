"""Contours of the objects along which the rod is swept.

A contour lies above the base line ``y = 0``.  The rod, clamped on that line and moved in -x, touches its lower side and
passes it from right to left: the slope angle ``α̃`` falls from ``π/2`` (right) through 0 (lowest point) to ``-π/2`` (left).
``t = (cos α̃, sin α̃)`` is the tangent and ``n = (sin α̃, -cos α̃)`` the outward normal.

A strictly convex contour is parametrised by its slope, a convex polygon by its edges and vertices.  Contours that are not
convex, and several in one plane, are loops (`planar.loops`), which the rod may touch at several places at once.

The path of a contour is its lower side in pieces, in the order in which the rod passes them.  On a strictly convex contour the
slope turns and the point moves along every piece.  A convex polygon is the limit: along an edge the slope is fixed and the
point moves, at a vertex the point is fixed and the slope turns through the vertex's cone of normals.  Each piece has a
parameter in [0, 1], so that polygons need no smoothing.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
import scipy
from numpy.typing import ArrayLike

from planar.arrays import ROUNDING, Array, Index
from planar.loops import Loop, Outlines, crosses_itself, ellipse_loop, polygon_loop, spline_loop

# Upper bounds of a piece's length, in rod lengths, and of its turn: on larger pieces the base position may have two extrema, of
# which the second would be missed.
_LONGEST_PIECE = 0.05
_WIDEST_PIECE = np.radians(4.0)


class SmoothCurve(Protocol):
    """A strictly convex curve given by its slope angle."""

    def points(self, slope: ArrayLike) -> Array:
        """Points (n, 2) with the slope angles (n,) in radians."""

    def radius_of_curvature(self, slope: ArrayLike) -> Array:
        """Radius of curvature (n,) at the slope angles (n,), in rod lengths."""


@dataclass(frozen=True)
class Path:
    """Contours as the rod passes them: rows of pieces, those of contour i from `offsets[i]` to `offsets[i + 1]`.

    On a polygon's piece slope and point are linear in the parameter t in [0, 1]; a smooth contour evaluates them itself.
    """

    slope: Array
    """(p,) slope angle at the start of each piece, falling along the path."""
    turn: Array
    """(p,) change of slope over the piece, at most 0."""
    point: Array
    """(p, 2) contour point at the start."""
    move: Array
    """(p, 2) change of the point over the piece."""
    offsets: Index
    """(contours + 1,) first piece of each contour."""
    smooth: SmoothCurve | None = None

    def at(self, piece: Index, t: Array) -> tuple[Array, Array, Array]:
        """Slope, x and y of the contour at parameter t (n,) of the pieces (n,)."""
        slope = self.slope[piece] + t * self.turn[piece]
        if self.smooth is not None:
            points = self.smooth.points(slope)
            return slope, points[:, 0], np.where(slope == self.slope[0], self.point[0, 1], points[:, 1])
        point, move = self.point[piece], self.move[piece]
        return slope, point[:, 0] + t * move[:, 0], point[:, 1] + t * move[:, 1]

    def arc_rate(self, piece: Index, slope: Array) -> Array:
        """Signed arc length along the tangent per unit of t: at most 0, because the path runs against the tangent."""
        if self.smooth is not None:
            return self.smooth.radius_of_curvature(slope) * self.turn[piece]
        return np.asarray(-np.hypot(self.move[piece, 0], self.move[piece, 1]))


def smooth_path(curve: SmoothCurve) -> Path:
    """The path along the lower side of a smooth curve, as far as the tip of the upright rod reaches.

    Raises ValueError if the curve lies outside the rod's reach.
    """
    check_height(curve.points(np.zeros(1))[0, 1])

    def above_tip(slope: float) -> float:
        return float(curve.points(np.array([slope]))[0, 1] - 1.0)

    first, last = np.pi / 2, -np.pi / 2
    if above_tip(first) > 0:
        first = scipy.optimize.brentq(above_tip, 0.0, first, xtol=1e-16, rtol=1e-15)
    if above_tip(last) > 0:
        last = scipy.optimize.brentq(above_tip, last, 0.0, xtol=1e-16, rtol=1e-15)
    slope = np.linspace(first, last, 2 + int((first - last) / _WIDEST_PIECE))
    while True:
        chord = np.linalg.norm(np.diff(curve.points(slope), axis=0), axis=1)
        long = chord > _LONGEST_PIECE
        # contours of more than some thousand rod lengths have so many pieces
        if not long.any() or len(slope) > 100_000:
            break
        middle = (slope[:-1] + slope[1:]) / 2
        slope = np.sort(np.concatenate([slope, middle[long]]))[::-1]
    points = curve.points(slope)
    if above_tip(np.pi / 2) > 0:
        # Next to touch-down x0 varies with the square root of the height, which would amplify the rounding of y = 1.
        points[0, 1] = 1.0
    offsets = np.array([0, len(slope) - 1])
    return Path(slope[:-1], np.diff(slope), points[:-1], np.diff(points, axis=0), offsets, curve)


def polygon_paths(polygons: Sequence[Array]) -> Path:
    """One path over many polygons, which are swept together.

    Each polygon is given by its vertices (n, 2): convex, counter-clockwise, without collinear triples.  Raises ValueError if
    one of them lies outside the rod's reach.
    """
    pieces = []
    for vertices in polygons:
        check_height(vertices[:, 1].min())
        # those on the lower side, within reach and short enough
        pieces.append(_Pieces(*subdivided(*_within_reach(_lower_side(vertices)))[0]))
    offsets = np.cumsum([0] + [len(polygon.slope) for polygon in pieces])
    joined = _Pieces(*(np.concatenate(columns) for columns in zip(*pieces, strict=True)))
    return Path(joined.slope, joined.turn, joined.point, joined.move, offsets)


class _Pieces(NamedTuple):
    """Pieces (p,) of one polygon: the columns of a `Path`."""

    slope: Array
    turn: Array
    point: Array
    move: Array


def _lower_side(vertices: Array) -> _Pieces:
    """Vertex, edge, vertex, ..., vertex: the slope turns at the vertices, the point moves along the edges."""
    edges = np.roll(vertices, -1, axis=0) - vertices
    # Edges of the lower side run to the right.  Vertical edges stay out: the rod stands parallel to them without force.
    lower = np.flatnonzero(edges[:, 0] > 0)
    interruption = np.flatnonzero(np.diff(lower) != 1)
    if len(interruption):
        lower = np.roll(lower, -(interruption[0] + 1))
    corners = vertices[np.append(lower, (lower[-1] + 1) % len(vertices))][::-1]
    angles = np.arctan2(edges[lower, 1], edges[lower, 0])[::-1]

    count = 2 * len(angles) + 1
    slope, turn = np.empty(count), np.zeros(count)
    point, move = np.repeat(corners, 2, axis=0)[:-1], np.zeros((count, 2))
    bounds = np.concatenate([[np.pi / 2], angles, [-np.pi / 2]])
    slope[0::2], slope[1::2] = bounds[:-1], angles
    turn[0::2] = np.diff(bounds)
    move[1::2] = np.diff(corners, axis=0)
    return _Pieces(slope, turn, point, move)


def _within_reach(pieces: _Pieces) -> _Pieces:
    """The pieces below the tip of the upright rod, y <= 1: one interval of the path, because y is convex along it."""
    slope, turn, point, move = pieces
    ends = point + move
    inside = np.minimum(point[:, 1], ends[:, 1]) <= 1.0
    inside &= (turn != 0) | (np.abs(move).sum(axis=1) > 0)
    slope, turn, point, move, ends = slope[inside], turn[inside], point[inside], move[inside], ends[inside]
    if point[0, 1] > 1.0:
        cut = (point[0, 1] - 1.0) / (point[0, 1] - ends[0, 1])
        point[0] = point[0, 0] + cut * move[0, 0], 1.0
        move[0] = ends[0] - point[0]
    if ends[-1, 1] > 1.0:
        move[-1] *= (1.0 - point[-1, 1]) / (ends[-1, 1] - point[-1, 1])
    return _Pieces(slope, turn, point, move)


def subdivided(slope: Array, turn: Array, point: Array, move: Array) -> tuple[tuple[Array, Array, Array, Array], Index]:
    """The pieces divided evenly until none is longer or wider than the bounds, and the piece that each part is of."""
    parts = np.maximum(np.hypot(*move.T) / _LONGEST_PIECE, np.abs(turn) / _WIDEST_PIECE)
    parts = np.maximum(np.ceil(parts), 1).astype(np.intp)
    row = np.repeat(np.arange(len(parts)), parts)
    step = (np.arange(len(row)) - np.repeat(np.cumsum(parts) - parts, parts))[:, None]
    turn, move = turn[row] / parts[row], move[row] / parts[row, None]
    return (slope[row] + step[:, 0] * turn, turn, point[row] + step * move, move), row


def check_height(lowest: float) -> None:
    """Raise ValueError for an object whose lowest point is not between the base line and the tip of the rod."""
    if lowest <= 0:
        raise ValueError(f"the object must lie above the base line y = 0, its lowest point is at y = {lowest:.6g}")
    if lowest > 1 - ROUNDING:  # nearer to the tip, the contact force is lost in rounding
        raise ValueError(
            f"the object is out of the rod's reach: its lowest point is at y = {lowest:.6g} rod lengths, the tip at 1"
        )


class Contour(ABC):
    """A contour in the plane, in rod lengths."""

    @property
    def is_convex(self) -> bool:
        """Whether the rod touches it at one place at a time, which then follows a path."""
        return True

    @abstractmethod
    def path(self) -> Path:
        """The part of a convex contour that the rod can reach, from its first touch onwards."""

    @abstractmethod
    def loops(self) -> list[Loop]:
        """The whole contour as closed loops, body on the left."""

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
        for _ in range(60):  # until the error is rounding
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
        rows = max(1, 2_000_000 // len(edges))  # more pairs at once would take too much memory
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
class Curve(_Looped):
    """The smooth closed curve through `points` (n, 2) in rod lengths, convex or not: a periodic cubic spline.

    The points are those of one turn, in either order; the last is joined to the first.  Raises ValueError for curves that cross
    themselves.
    """

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

    @classmethod
    def from_points(cls, x: ArrayLike, y: ArrayLike) -> Curve:
        """From the coordinates (n,) of the points."""
        points = [np.asarray(column, dtype=float) for column in (x, y)]
        if points[0].ndim != 1 or points[0].shape != points[1].shape:
            raise ValueError(f"a curve needs x and y of one shape (n,), got {points[0].shape} and {points[1].shape}")
        return cls(np.stack(points, axis=1))

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
    if isinstance(contour, Curve):
        return Curve(contour.points * across)
    if isinstance(contour, Contours):
        return Contours([mirrored(part) for part in contour.parts])
    if isinstance(contour, Circle):
        return Circle(contour.radius, (-contour.center[0], contour.center[1]))
    if isinstance(contour, Ellipse):
        return Ellipse(contour.semi_axes, (-contour.center[0], contour.center[1]), -contour.angle)
    raise TypeError(f"the mirror image of a {type(contour).__name__} is not known")


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
