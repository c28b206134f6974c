"""The settings of a scan, and where its sweeps go.

In a slice that is directions, samples and base lines.  In space a rod that comes from one side bends aside and slides over the
body (S24): it sees the part of the surface whose normals lie some 13° to 70° from its own direction.  Twelve directions, those
of the vertices of an icosahedron, see every normal from two or more sides.  From each of them the straight lines of a round
rod run in two directions across each other, and every other line runs backwards, because a sweep sees most of the side that
it comes to.

Of a body that is not convex, sweeps aim at what no contact supports: the widest stretches of the outer contours of its slices.
Between its contacts an outer contour is the border of what the rods have passed.  How far it is from the nearest contact says
how wide a bay may be that no rod has entered (C16).  A rod is sent against such a stretch from either side of its normal, from
so far away that its end, which probes like a finger, passes halfway between the stretch and what may lie behind it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, cKDTree
from scipy.spatial.transform import Rotation

from scan3d.arrays import Array, ratio
from scan3d.bounds.free_space import contradicted, outer_contours, sheets_of
from scan3d.choices import MODELS, PROBINGS, SPACINGS, Model, Probing, Spacing
from scan3d.cloud import Cloud
from scan3d.errors import InputError
from scan3d.recording import FORCE_SIGMAS, Recording
from scan3d.rods import Gravity, Rod
from scan3d.units import FACTORS, UNITS_M, Unit, is_finite, spelled

LARGEST_FRICTION = 100.0
"""Largest coefficient of friction.  No materials come near it, and beyond it steep forces lose their digits."""
SMALLEST_CLEARANCE = 1e-6
"""Smallest distance of the base line from a slice, in rod lengths.  Smaller, rounding would put the base line into the body."""
LARGEST_STOP_FORCE = 0.5
"""Largest force at the end of a probing, in EI/L²: a fifth of Euler's load of a rod whose end may slide, π²/4."""
LARGEST_NOISE = 1.0
"""Largest standard deviation of force and moment, in EI/L² and EI/L.  Contact forces are of that size, so that beyond it
nothing would be measured."""


@dataclass(frozen=True)
class Plan:
    """Settings of a simulated scan.

    model
        model of contact: ``planar``, the rod stays in its slice, or ``spatial``, a round rod bends where the contact pushes it.
    slices
        number of slices along each axis, besides one beyond either end of the body.  With adaptive spacing it is the largest:
        there are fewer where further slices would not lower the bound, and other empty slices count.  In the spatial model
        there are no slices, and 0.4 times as many sweeps from each of twelve directions.
    spacing
        heights of the slices: ``cosine`` (dense at the ends), ``uniform``, or ``adaptive`` (where the contacts so far leave
        most room for the body).
    tolerance
        adaptive spacing stops when the certified bound, relative to the diagonal of the contacts' bounding box, is this small;
        slices whose contours need more contacts for it are swept again with up to 16 times the samples.
    axis
        normal of the slices: ``"x"``, ``"y"``, ``"z"``, several such as ``"xyz"``, or a vector of three numbers.  ``"free"``,
        with adaptive spacing: of a body whose first slices, along z, show a polyhedron, further ones are in any plane, chosen
        for its facets and vertices; where all are known there are no more.  Other bodies are sliced along z.
    sweeps
        sweeps per slice, evenly spaced around it, or in the spatial model per direction; None: as many as the body needs.
    samples
        samples per sweep, from touch-down to the sweep's end.
    friction
        coefficient of friction, or the range ``(low, high)`` from which every sample draws its own; dimensionless.
    clearance
        distance of the base line from the slice, in rod lengths.
    rod
        a `scan3d.Rod`, in SI units; None: a steel wire as long as the widest slice's diameter, or in the spatial model as the
        body.
    bead
        diameter of a ball on the rod's tip, in the unit of the mesh; 0: none, or that of `rod`.
    gravity
        a `scan3d.Gravity`, of a rod that has a weight: it must lie in the planes of the slices.
    probing
        ``auto``: of a body that is not convex, after sweeps in an eighth of the slices, the rod is sent along itself, wherever
        most is unknown, in at most three times as many planes; in the spatial model without sweeps.  ``off``:
        there are sweeps only; ``only``: there are none.
    known
        share of the surface that has a contact nearby, as far as contacts tell, at which probing ends; 0: where nothing is left
        to gain.
    stop_force
        force at which a probing ends, in EI/L², or with a unit, such as ``"2 mN"``; ``"auto"``: a hundredth of EI/L², which
        bends the rod by at most a three hundredth of its length, or twice what stands out of the noise.
    noise
        standard deviation of force and moment, in EI/L² and EI/L.
    seed
        seed of the random friction, noise and directions.
    unit
        unit of the mesh's coordinates: ``m``, ``cm``, ``mm``, ``um`` or ``in``.

    Raises InputError for values out of their range.
    """

    model: Model = "planar"
    slices: int = 64
    spacing: Spacing = "adaptive"
    tolerance: float = 0.0
    axis: str | Sequence[float] = "z"
    sweeps: int | None = None
    samples: int = 64
    friction: float | tuple[float, float] = 0.3
    clearance: float = 0.3
    rod: Rod | None = None
    bead: float = 0.0
    gravity: Gravity | None = None
    probing: Probing = "auto"
    known: float = 0.0
    stop_force: float | str = "auto"
    noise: float = 0.0
    seed: int = 0
    unit: Unit = "mm"

    def __post_init__(self) -> None:
        for name, minimum in (("slices", 1), ("samples", 2), ("seed", 0)):
            check_whole(name, getattr(self, name), minimum)
        if self.sweeps is not None:
            check_whole("sweeps", self.sweeps, 1)
        choices = (("model", MODELS), ("spacing", SPACINGS), ("probing", PROBINGS), ("unit", UNITS_M))
        for name, known in choices:
            check_choice(name, getattr(self, name), known)
        if not (is_finite(self.known) and 0 <= self.known <= 1):
            raise InputError(f"known must be a share from 0 to 1, got {self.known}")
        for name in ("known", "stop_force") if self.probing == "off" else ():
            if getattr(self, name) != getattr(type(self), name):
                raise InputError(f"{name} says when a probing ends, and probing is off; leave one of the two out")
        low, high = self.friction_range
        if not 0 <= low <= high <= LARGEST_FRICTION:
            raise InputError(
                f"friction must be a number >= 0 or a rising range LOW:HIGH of such, at most {LARGEST_FRICTION:g}, "
                f"got {self.friction}"
            )
        if not (is_finite(self.tolerance) and self.tolerance >= 0):
            raise InputError(f"tolerance must be a number >= 0, got {self.tolerance}")
        if not (is_finite(self.clearance) and SMALLEST_CLEARANCE <= self.clearance < 1):
            raise InputError(
                f"clearance must lie between {SMALLEST_CLEARANCE:g} and 1 rod lengths, got {self.clearance}"
            )
        if not (is_finite(self.noise) and 0 <= self.noise <= LARGEST_NOISE):
            raise InputError(f"noise must be a number >= 0 and at most {LARGEST_NOISE:g}, got {self.noise}")
        if self.rod is not None and not isinstance(self.rod, Rod):
            raise InputError(f"rod must be a scan3d.Rod or None, got {self.rod!r}")
        if not isinstance(self.gravity, Gravity | None) or (self.gravity is None and self.rod and self.rod.weight_N):
            raise InputError(
                f"gravity must be a scan3d.Gravity, needed with a rod that has a weight, got {self.gravity!r}"
            )
        if not (is_finite(self.bead) and self.bead >= 0):
            raise InputError(f"bead must be a diameter >= 0, got {self.bead}")
        if self.has_bead and (self.model != "spatial" or self.probing == "off"):
            raise InputError(
                "a bead touches beside the rod's end, and nothing is known of sweeps with one: choose the spatial model, "
                "with probing auto or only"
            )
        self.stop_force_of(None)
        self.axes()
        for name in ("spacing", "axis", "tolerance") if self.model == "spatial" else ():
            value, default = getattr(self, name), getattr(type(self), name)
            if not np.array_equal(value, default):
                raise InputError(
                    f"{name} is a setting of slices, and the spatial model has none; leave out {name} {value!r}"
                )

    @property
    def has_bead(self) -> bool:
        """Whether the rod has a bead on its tip, so that the body is probed only."""
        return bool(self.bead or (self.rod is not None and self.rod.bead_diameter_m))

    @property
    def is_free(self) -> bool:
        """Whether slices may lie in any plane."""
        return isinstance(self.axis, str) and self.axis == "free"

    @property
    def friction_range(self) -> tuple[float, float]:
        """Lowest and highest coefficient of friction."""
        ends: list[Any] = [self.friction] * 2 if np.ndim(self.friction) == 0 else list(self.friction)  # type: ignore[arg-type]
        if len(ends) != 2:
            raise InputError(f"a range of friction has two ends, got {self.friction}")
        if not all(map(is_finite, ends)):
            raise InputError(f"friction must be a number >= 0, or a range of two such numbers, got {self.friction!r}")
        return float(ends[0]), float(ends[1])

    def stop_force_of(self, rod: Rod | None) -> float:
        """The force at which a probing ends, in EI/L² of a rod; in newtons, and by the noise, it is judged with the rod.

        Raises InputError for what is no such force.
        """
        stands_out = FORCE_SIGMAS * self.noise
        given, one = self.stop_force, 1.0 if rod is None else rod.force_unit_N
        text = repr(max(0.01, 2 * stands_out)) if given == "auto" else str(given).strip()
        match = re.fullmatch(r"(\d*\.?\d+(?:[eE][+-]?\d+)?)\s*(\D.*)?", text)
        value, unit = (float(match[1]), match[2]) if match else (0.0, None)
        factor = FACTORS["force"].get(spelled(unit, "force") or "") if unit else one
        if factor is None or not 0 < value < math.inf:
            raise InputError(
                "stop_force must be auto, a force in EI/L² of the rod such as 0.01, or one with a unit such as 2mN; got "
                f"{given!r}"
            )
        found = value * factor / one
        if (rod is not None or (unit is None and given != "auto")) and not stands_out < found <= LARGEST_STOP_FORCE:
            raise InputError(
                f"stop_force must stand out of the noise, above {stands_out:.3g} EI/L², and be at most "
                f"{LARGEST_STOP_FORCE:g} EI/L², far below what buckles the rod; got {given}"
            )
        return found

    def down(self, axes: Array) -> Array | None:
        """(m, 3) gravity in the frames of clamps with axes (m, 3, 3), as rows; None unless the rod has a weight."""
        heavy = self.rod is not None and self.rod.weight_N and self.gravity is not None
        return np.asarray(axes @ np.array(self.gravity.direction)) if heavy and self.gravity is not None else None

    def axes(self) -> Array:
        """Unit normals (k, 3) of the slices."""
        letters = "z" if self.is_free else self.axis if isinstance(self.axis, str) else ""
        try:
            vectors = (
                np.eye(3)[["xyz".index(letter) for letter in letters]] if letters else np.array([self.axis], float)
            )
        except (TypeError, ValueError, OverflowError):
            vectors = np.empty(0)
        valid = vectors.ndim == 2 and vectors.shape[1] == 3 and np.isfinite(vectors).all() and vectors.any(axis=1).all()
        if not valid or len(set(letters)) < len(letters):
            raise InputError(
                f"axis must be x, y, z, several of them such as xyz, free, or a vector of three numbers that is not zero, "
                f"got {self.axis!r}"
            )
        vectors /= np.abs(vectors).max(axis=1, keepdims=True)  # so that squares are numbers of a computer
        return np.array([vector / np.linalg.norm(vector) for vector in vectors])


def check_choice(name: str, value: object, known: Iterable[str]) -> None:
    """Raises InputError for a setting whose value is none of the known ones."""
    if not isinstance(value, str) or value not in known:
        raise InputError(f"{name} must be one of {', '.join(known)}, got {value!r}")


def check_whole(name: str, value: object, minimum: int) -> None:
    """Raises InputError for a setting whose value is no whole number, or too small."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < minimum:
        raise InputError(f"{name} must be a whole number of at least {minimum}, got {value!r}")


FIRST_SWEEPS = 6
"""Approach directions with which a slice is begun; one sweep sees some 100° of its normals, less of straight sides."""
MAX_SWEEPS = 16
"""Upper bound of the number of approach directions of a slice."""
OPEN_FRACTION = 5e-4
"""A slice is covered where contacts and their tangents leave less than this fraction of its width open between them."""
AIMED_SLOPE = math.radians(40)
"""The slope at which a sweep aimed at a normal meets it: the middle of the slopes that it sees tangentially."""
# Where along the rod, in its lengths, a place in space is touched that a sweep is aimed at.
_TOUCHED = 0.6


def cosine_fractions(count: int) -> Array:
    """Chebyshev's nodes (count,) between 0 and 1: dense at the ends, where bodies are small."""
    return (1 - np.cos(np.pi * (np.arange(count) + 0.5) / count)) / 2


def base_fractions(samples: int) -> Array:
    """Where the samples (n,) of a sweep are taken, as fractions of the travel from touch-down to the sweep's end.

    They are denser at the start, where the contour turns fastest under the rod, so that the normals are met about evenly.
    """
    u = np.linspace(0.0, 1.0, samples)
    # denser at the sweep's start than evenly spaced by this fraction, and sparser at its end
    return u - 0.45 / np.pi * np.sin(np.pi * u)


def first_directions(plan: Plan) -> Array:
    """The approach directions with which a slice is begun: angles (k,) of the undeformed rod in it, in radians."""
    count = plan.sweeps or FIRST_SWEEPS
    return 2 * np.pi * np.arange(count) / count


def base_clearances(plan: Plan, directions: int) -> list[list[float]]:
    """Distances of the base lines from the slice in rod lengths, for each direction, of a body that need not be convex.

    A base far away probes with the end of the rod, as with a finger, and reaches into what the bent rod passes from a near one;
    with a given number of sweeps the two take turns.
    """
    # of a slice that is not convex the last fifth of the rod probes the far side
    both = [plan.clearance, max(plan.clearance, 0.8)]
    return [both if plan.sweeps is None else [both[k % 2]] for k in range(directions)]


def further_directions(points: Array, normals: Array, width: float, limit: float | None = None) -> Array:
    """Approach directions (k,), in radians, towards those parts of a slice's contour that tangential contacts leave open.

    points, normals (n, 2)
        contacts and their outward unit normals.  Two neighbouring contacts leave open the triangle between their chord and
        their tangents.
    width
        of the contour, in the unit of the points.
    limit
        height of an open triangle, in the same unit, above which a sweep is aimed at it; by default a part of the width.

    Returns no directions where there are no tangential contacts.
    """
    if not len(points):
        return np.empty(0)
    # contacts on one edge have the same normal, up to rounding; their order is that along the edge
    angle = np.round(np.arctan2(normals[:, 1], normals[:, 0]), 9)
    order = np.lexsort((points[:, 1] * np.cos(angle) - points[:, 0] * np.sin(angle), angle))
    points, angle = points[order], angle[order]
    chord = np.roll(points, -1, axis=0) - points
    gap = np.diff(angle, append=angle[0] + 2 * np.pi)
    ahead = angle + gap
    before = np.maximum(-chord[:, 0] * np.cos(angle) - chord[:, 1] * np.sin(angle), 0.0)
    after = np.maximum(chord[:, 0] * np.cos(ahead) + chord[:, 1] * np.sin(ahead), 0.0)
    height = np.nan_to_num(ratio(before * after, np.hypot(*chord.T) * np.sin(gap)))
    open_height = np.where(gap >= np.pi, width, height)
    limit = OPEN_FRACTION * width if limit is None else limit
    middle = (angle + gap / 2)[open_height > limit]
    # n = (sin α̃, -cos α̃) in the clamp's frame, whose y axis, the undeformed rod, has the direction sought; it is rounded, so
    # that the poses are short numbers
    return np.unique(np.round(middle + np.pi - AIMED_SLOPE, 3))


class BaseLine(NamedTuple):
    """The line on which the clamp moves in a sweep, in the frame of the slices and in the outline's unit."""

    axes: Array
    """(2, 2) the clamp's x and y axes, as rows: along the sweep, and along the undeformed rod."""
    origin: Array
    """(2,) a point of the line."""


def base_line(outline: Array, angle: float, clearance: float) -> BaseLine:
    """The base line at a given distance from an outline.

    outline (n, 2)
        points of a slice's contour, of the projection of the whole body, or of a box around it.
    angle
        direction of the undeformed rod in the slice, in radians.
    clearance
        distance of the line from the outline, in the outline's unit.
    """
    y = np.array([np.cos(angle), np.sin(angle)])
    x = np.array([y[1], -y[0]])
    # the origin lies below the middle of the outline's box, which keeps the coordinates small
    middle = (outline.min(axis=0) + outline.max(axis=0)) / 2
    depth = ((outline - middle) @ y).min() - clearance
    return BaseLine(np.stack([x, y]), middle + depth * y)


def positions(line: BaseLine, x0: Array, height: float, frame: Array) -> Array:
    """Positions (n, 3) of the clamp in the world, at the base positions x0 (n,) in the slice at a height.

    The rows of `frame` (3, 3) are the axes of the slices' frame in the world.
    """
    in_slice = line.origin + x0[:, None] * line.axes[0]
    return np.column_stack([in_slice, np.full(len(x0), height)]) @ frame


def clamp_axes(line: BaseLine, frame: Array) -> Array:
    """(3, 3) the clamp's x, y and z axes in the world, as rows."""
    return np.vstack([line.axes @ frame[:2], frame[2]])


class Lines(NamedTuple):
    """Straight paths (k) of a clamp, before it is known where on them the rod touches."""

    origin: Array
    """(k, 3) a point of each path."""
    axes: Array
    """(k, 3, 3) axes of the clamp as rows: x, against which it moves, y along the rod, and z."""


def icosahedron() -> Array:
    """(12, 3) unit vectors to the vertices of an icosahedron that is turned askew.

    A rod that lies flat on a face, or sweeps in a body's plane of symmetry, sees little.
    """
    golden = (1 + np.sqrt(5)) / 2
    ends = np.array([(0, a, b * golden) for a in (-1, 1) for b in (-1, 1)])
    vertices = np.concatenate([np.roll(ends, k, axis=1) for k in range(3)])
    # turned by angles that belong to no symmetry
    return Rotation.from_euler("xyz", (0.2, 0.37, 0.61)).apply(vertices / np.linalg.norm(vertices[0]))


def rasters(points: Array, count: int, clearance: float) -> Lines:
    """`count` lines from each of twelve directions.

    points
        (n, 3) that span the body, such as its vertices.
    clearance
        distance of the clamp from the body along the rod.
    """
    parts = [_raster(points, -direction, count, clearance) for direction in icosahedron()]
    return Lines(*map(np.concatenate, zip(*parts, strict=True)))


def _raster(points: Array, along: Array, count: int, clearance: float) -> Lines:
    """Lines across the direction `along` of the rod, as many each way as the body is wide there."""
    first, second = across(along)
    widths = [float(np.ptp(points @ axis)) for axis in (first, second)]
    numbers = [max(1, round(count * width / sum(widths))) for width in widths]
    origin, axes = [], []
    for spread, moved, number in ((first, second, numbers[0]), (second, first, numbers[1])):
        place = points @ spread
        offsets = place.min() + np.ptp(place) * cosine_fractions(number)
        middle = points.mean(axis=0)
        base = middle + ((points @ along).min() - clearance - middle @ along) * along
        origin.append(base + (offsets - base @ spread)[:, None] * spread)
        sign = np.where(np.arange(number) % 2, -1.0, 1.0)
        x = sign[:, None] * moved
        y = np.broadcast_to(along, x.shape)
        axes.append(np.stack([x, y, np.cross(x, y)], axis=1))
    return Lines(np.concatenate(origin), np.concatenate(axes))


def aimed(contacts: Array, normals: Array, count: int, generator: np.random.Generator) -> Lines:
    """At most `count` lines aimed at the places where contacts leave most room for the body outside of their hull.

    The rod comes down on such a place along its normal, lying across it: it touches there first, wherever it slides afterwards.

    contacts, normals
        (n, 3) in rod lengths, and outward unit vectors (n, 3), NaN where they are unknown.
    """
    target, normal = open_places(contacts, normals, count)
    angle = generator.uniform(0, 2 * np.pi, len(target))[:, None]
    first, second = (np.array(axes) for axes in zip(*map(across, normal), strict=True))
    y = np.cos(angle) * first + np.sin(angle) * second
    return Lines(target - _TOUCHED * y, np.stack([normal, y, np.cross(normal, y)], axis=1))


def open_places(contacts: Array, normals: Array, count: int) -> tuple[Array, Array]:
    """Points and normals (k, 3), k <= count, of facets of the contacts' hull that leave most room, apart from each other.

    The room is the height above the middle of a facet at which the tangent planes at its three corners end it.
    """
    qhull = ConvexHull(contacts)
    faces, outward = qhull.simplices, qhull.equations[:, :3]
    corners = contacts[faces]
    target, size = corners.mean(axis=1), np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    height = ((corners - target[:, None]) * normals[faces]).sum(axis=2)
    slope = (outward[:, None] * normals[faces]).sum(axis=2)
    room = np.where(slope > 0, ratio(height, slope), np.inf).min(axis=1)
    room = np.clip(room, 0.0, size)
    turn = np.where(slope > 0, slope, 0.0).min(axis=1)  # cosine of the largest angle to a corner's normal
    tree, taken = cKDTree(target), np.zeros(len(target), dtype=bool)
    chosen: list[int] = []
    for facet in np.argsort(-room, kind="stable"):
        if len(chosen) == count:
            break
        if not taken[facet]:
            chosen.append(int(facet))
            near = np.array(tree.query_ball_point(target[facet], size[facet]))
            taken[near[outward[near] @ outward[facet] >= turn[facet]]] = True
    return target[chosen], outward[chosen]


def across(direction: Array) -> tuple[Array, Array]:
    """Two unit vectors across a direction (3,) and across each other."""
    first = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    first /= np.linalg.norm(first)
    return first, np.cross(direction, first)


class Aim(NamedTuple):
    """A sweep at a stretch of a slice's outer contour; lengths in the cloud's unit."""

    width: float
    """Distance of the stretch from the nearest contact."""
    axis: Array
    """(3,) of the slice."""
    height: float
    """Of the slice along its axis."""
    angle: float
    """Direction of the undeformed rod in the frame of the slice, in radians."""
    tip: float
    """How far along that direction, from the origin, the end of the undeformed rod goes."""


def aims(recording: Recording, cloud: Cloud) -> list[Aim]:
    """Sweeps at the widest stretches of each slice that are wider than the slices are apart, the widest first.

    cloud
        contacts of the recording.  Raises InputError as `bounds.free_space.sheets_of`.
    """
    touched = cloud.fattened or cloud
    sheets = sheets_of(recording, touched)
    touched = touched.select(~contradicted(sheets, touched))
    found = []
    for sheet in sheets:
        contours = outer_contours([sheet], touched)
        places = contours.points @ sheet.frame.T
        flat, height = places[:, :2], places[:, 2]
        x, y = np.round((flat - sheet.origin) / sheet.cell).astype(int).T
        number = np.abs(height[:, None] - sheet.height).argmin(axis=1)
        depth = sheet.depth
        outward = np.stack(
            [depth[number, y, x + 1] - depth[number, y, x - 1], depth[number, y + 1, x] - depth[number, y - 1, x]],
            axis=1,
        )
        for k, level in enumerate(sheet.height):
            rows = np.flatnonzero((number == k) & (contours.distance > sheet.apart))
            for _ in range(3):
                if not len(rows):
                    break
                widest = rows[contours.distance[rows].argmax()]
                width = float(contours.distance[widest])
                of_stretch = np.linalg.norm(flat[rows] - flat[widest], axis=1) <= width
                normal = outward[rows[of_stretch]].sum(axis=0)
                # a rod that comes along the stretch's normal meets the bay's mouth first
                for aside in (-math.radians(30), math.radians(30)):
                    angle = math.atan2(-normal[1], -normal[0]) + aside
                    along = float(flat[widest] @ (math.cos(angle), math.sin(angle)))
                    found.append(Aim(width, sheet.frame[2], float(level), angle, along + width / 2))
                rows = rows[~of_stretch]
    return sorted(found, key=lambda aim: -aim.width)


def aimed_line(aim: Aim, outline: Array, length: float, nearest: float) -> BaseLine:
    """The base line of a sweep with a rod of a length past an outline (n, 2), from which the line keeps `nearest` at least."""
    along = outline @ (math.cos(aim.angle), math.sin(aim.angle))
    return base_line(outline, aim.angle, max(nearest, float(along.min()) - aim.tip + length))
