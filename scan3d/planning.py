"""What is scanned, and how: heights of the slices, approach directions, clearance, friction, rod."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scan3d.errors import InputError
from scan3d.rods import Rod
from scan3d.units import UNITS_M

Array = NDArray[np.float64]
Index = NDArray[np.int64]

SPACINGS = ("cosine", "uniform", "adaptive")
STANDOFFS = ("follow", "fixed")
_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
# Adaptive spacing starts with so many slices inside the body, and one beyond either end by this share of its height.
FIRST_SLICES = 8
OVERSHOOT = 0.02
# Smallest distance of the slices beyond the ends, as a share of the height.
MARGIN = 1e-4
# Gap in a cap over that in another slab of the same weight: how a body closes past its end slice is least known.
_CAP_WEIGHT = 1.5
# Slices closer to each other than this share of the height tell nothing new.
CLOSEST = 1e-7
# How much denser than evenly a sweep's samples are at its start, and sparser at its end.
CROWDING = 0.45
# Approach directions of a slice to start with; one sweep sees some 100° of its normals, of flat sides less.
FIRST_SWEEPS = 6
# Most approach directions of a slice.
MOST_SWEEPS = 16
# A slice is covered where contacts and their tangents leave less than this share of its width open between them.
OPEN_SHARE = 5e-4
# The slope at which a sweep aimed at a normal meets it: in the middle of what it sees tangentially.
AIMED_SLOPE = math.radians(40)


@dataclass(frozen=True)
class Plan:
    """Settings of a simulated scan.  Raises InputError for values out of their range."""

    slices: int = 64
    """Slices along each axis; with adaptive spacing the empty ones count."""
    spacing: str = "cosine"
    """Heights of the slices: 'cosine' (dense at the ends), 'uniform', or 'adaptive' (where the contacts so far leave most
    room for the body)."""
    tolerance: float = 0.0
    """Adaptive spacing stops when the certified bound, relative to the contacts' bounding-box diagonal, is this small."""
    axis: str | Sequence[float] = "z"
    """Normal of the slices: 'x', 'y', 'z', several such as 'xyz', or a vector."""
    sweeps: int | None = None
    """Sweeps per slice, evenly around it; None: as many as its contour needs."""
    samples: int = 64
    """Samples per sweep, from touch-down to the sweep's end."""
    friction: float | tuple[float, float] = 0.3
    """Coefficient of friction, or the range from which every sample draws its own."""
    clearance: float = 0.3
    """Distance of the base line from the slice, in rod lengths."""
    standoff: str = "follow"
    """The base line follows every slice ('follow'), or keeps the distance it has from the widest body ('fixed')."""
    rod: Rod | None = None
    """None: a steel wire twice as long as the widest slice's radius."""
    noise: float = 0.0
    """Standard deviation of force and moment, in EI/L² and EI/L."""
    seed: int = 0
    unit: str = "mm"
    """Unit of the mesh's coordinates."""

    def __post_init__(self) -> None:
        for name, least in (("slices", 1), ("samples", 2), ("seed", 0)):
            _check_whole(name, getattr(self, name), least)
        if self.sweeps is not None:
            _check_whole("sweeps", self.sweeps, 1)
        if self.spacing not in SPACINGS:
            raise InputError(f"spacing must be one of {', '.join(SPACINGS)}, got {self.spacing!r}")
        if self.standoff not in STANDOFFS:
            raise InputError(f"standoff must be one of {', '.join(STANDOFFS)}, got {self.standoff!r}")
        if not (math.isfinite(self.tolerance) and self.tolerance >= 0):
            raise InputError(f"tolerance must be a number >= 0, got {self.tolerance}")
        if self.unit not in UNITS_M:
            raise InputError(f"unit must be one of {', '.join(UNITS_M)}, got {self.unit!r}")
        low, high = self.friction_range
        if not (math.isfinite(low) and math.isfinite(high) and 0 <= low <= high):
            raise InputError(f"friction must be a number >= 0 or a rising range LOW:HIGH of such, got {self.friction}")
        if not (math.isfinite(self.noise) and self.noise >= 0):
            raise InputError(f"noise must be a number >= 0, got {self.noise}")
        if not 0 < self.clearance < 1:
            raise InputError(f"clearance must lie between 0 and 1 rod lengths, got {self.clearance}")
        self.axes()

    @property
    def friction_range(self) -> tuple[float, float]:
        if isinstance(self.friction, (int, float)):
            return float(self.friction), float(self.friction)
        if len(self.friction) != 2:
            raise InputError(f"a range of friction has two ends, got {self.friction}")
        return float(self.friction[0]), float(self.friction[1])

    def axes(self) -> Array:
        """Unit normals (k, 3) of the slices."""
        given = [_AXES.get(letter, ()) for letter in self.axis] if isinstance(self.axis, str) else [self.axis]
        vectors = [np.asarray(vector, dtype=float) for vector in given]
        good = all(v.shape == (3,) and np.isfinite(v).all() and np.linalg.norm(v) > 0 for v in vectors)
        if not vectors or not good or (len(set(self.axis)) < len(self.axis) and isinstance(self.axis, str)):
            raise InputError(
                f"axis must be x, y, z, several of them such as xyz, or a vector of three numbers that is not zero, "
                f"got {self.axis!r}"
            )
        return np.array([vector / np.linalg.norm(vector) for vector in vectors])


def _check_whole(name: str, value: object, least: int) -> None:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise InputError(f"{name} must be a whole number of at least {least}, got {value!r}")


def heights(low: float, high: float, plan: Plan) -> Array:
    """Heights (slices,) between the ends of the body; cosine spacing puts them at Chebyshev's nodes."""
    share = (np.arange(plan.slices) + 0.5) / plan.slices
    if plan.spacing == "cosine":
        share = (1 - np.cos(np.pi * share)) / 2
    return low + (high - low) * share


def first_heights(low: float, high: float, plan: Plan) -> Array:
    """Heights that are scanned before any contact is known: one on either side beyond the body is among them."""
    if plan.spacing == "adaptive":
        few = replace(plan, slices=max(2, min(FIRST_SLICES, plan.slices - 2)), spacing="cosine")
        inside = heights(low, high, few)
        beyond = OVERSHOOT * (high - low)
    else:
        inside = heights(low, high, plan)
        beyond = max(float(inside[0]) - low, MARGIN * (high - low))
    return np.concatenate([inside, [low - beyond, high + beyond]])


def next_heights(known: Array, slab: Index, corners: Array, gaps: Array, kinks: Array, count: int, left: int) -> Array:
    """About `count` further heights, no more than `left`, where the bracket is widest.

    known (s,): heights scanned, rising, with the nearest empty ones at both ends.  Of the outer body's corners: slab (w,),
    number of the lower known height; corners (w,), their own heights; gaps (w,), their distances from the inner body;
    kinks (w,), whether the body goes on straight on both sides.

    A slab gets the height of its worst corner, which for a polyhedron is a vertex's own.  Where the body bends all along,
    its gap falls with the square of the slab's parts: a slab that will need three of them, with what is left, gets two
    heights at once.  A corner on an empty slice says only that the body ends before it, one on an end slice only that the
    body may end right behind it: there the height between is halved.
    """
    size = known[-1] - known[0]
    order = np.lexsort((-gaps, slab))
    worst = order[np.unique(slab[order], return_index=True)[1]]
    worst = worst[gaps[worst] > 0]
    slab, corner, kink = slab[worst], corners[worst], kinks[worst]
    low, high = known[slab], known[slab + 1]
    first, last = slab == 0, slab == len(known) - 2
    weight = np.sqrt(np.where(first | last, _CAP_WEIGHT, 1.0) * gaps[worst])

    end, beyond = np.where(first, high, low), np.where(first, low, high)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (corner - end) / (beyond - end)
    in_cap = end + np.where(share > 1 - 1e-9, 0.5, np.where(kink, 0.98, 0.35) * share) * (beyond - end)
    on_slice = np.minimum(corner - low, high - corner) <= CLOSEST * size
    single = np.where(first | last, in_cap, np.where(on_slice, (low + high) / 2, corner))
    useful = np.minimum(single - low, high - single) > CLOSEST * size
    thirds = ~(first | last | kink) & (_parts(weight, left) == 3)

    chosen: list[float] = []
    for i in np.argsort(-weight, kind="stable"):
        if len(chosen) >= count:
            break
        if useful[i]:
            new = [low[i] + (high[i] - low[i]) * k / 3 for k in (1, 2)] if thirds[i] else [single[i]]
            chosen += new[: left - len(chosen)]
    return np.array(chosen)


def _parts(weight: Array, left: int) -> Index:
    """Parts (n,) into which slabs come if `left` cuts make the largest ``weight / parts`` as small as they can."""
    parts = np.ones(len(weight), dtype=np.int64)
    for _ in range(left if len(weight) else 0):
        parts[np.argmax(weight / parts)] += 1
    return parts


def base_shares(samples: int) -> Array:
    """Where on the way from touch-down to the sweep's end the samples (n,) are taken.

    Denser at the start, where the contour turns fastest under the rod: so the normals are met about evenly.
    """
    u = np.linspace(0.0, 1.0, samples)
    return u - CROWDING / np.pi * np.sin(np.pi * u)


def first_directions(plan: Plan) -> Array:
    """Approach directions: angles (k,) of the undeformed rod in the slice, in radians."""
    count = plan.sweeps or FIRST_SWEEPS
    return 2 * np.pi * np.arange(count) / count


def further_directions(points: Array, normals: Array, width: float) -> Array:
    """Approach directions (k,) towards what tangential contacts leave open of a slice's contour.

    points (n, 2) with outward normals (n, 2); two neighbours leave open the triangle between their chord and their
    tangents.  None where there is no tangential contact to go by.
    """
    if not len(points):
        return np.empty(0)
    # contacts on one edge have one normal, up to rounding; there their order is that along the edge
    angle = np.round(np.arctan2(normals[:, 1], normals[:, 0]), 9)
    order = np.lexsort((points[:, 1] * np.cos(angle) - points[:, 0] * np.sin(angle), angle))
    points, angle = points[order], angle[order]
    chord = np.roll(points, -1, axis=0) - points
    gap = np.diff(angle, append=angle[0] + 2 * np.pi)
    ahead = angle + gap
    before = np.maximum(-chord[:, 0] * np.cos(angle) - chord[:, 1] * np.sin(angle), 0.0)
    after = np.maximum(chord[:, 0] * np.cos(ahead) + chord[:, 1] * np.sin(ahead), 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        height = np.nan_to_num(before * after / (np.hypot(*chord.T) * np.sin(gap)))
    open_height = np.where(gap >= np.pi, width, height)
    middle = (angle + gap / 2)[open_height > OPEN_SHARE * width]
    # n = (sin α̃, -cos α̃) in the clamp's frame, whose y axis, the rod, stands at the direction sought
    return np.unique(np.round(middle + np.pi - AIMED_SLOPE, 3))
