"""Contacts in the world, the result of the first half of step 2."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import planar
from scan3d.arrays import Array, Index, Mask
from scan3d.geometry.support import SupportFit
from scan3d.rigs import RigErrors
from scan3d.shown import Exported, Rows, Shown
from scan3d.units import force, length, lengths, number

TOUCHED = 0.02
"""Distance from a contact, in diagonals of the contacts' box, within which a place of a body that is not convex is touched."""


class NormalSource(IntEnum):
    """Where a contact's normal comes from."""

    UNKNOWN = 0
    SLICES = 1
    """Direction in the slice's plane from (14), inclination to the plane from the slices above and below."""
    FIT = 2
    """The smooth body fitted to all contacts."""
    FRICTION = 3
    """As SLICES, at a tip contact, by the friction that the tangential contacts agree on."""
    SLIP = 4
    """The direction in which the rod's material point slips along the surface, against which friction acts (spatial model)."""
    PATH = 5
    """Perpendicular to the rod and to the path of the contact over the surface (spatial model)."""
    FORCE = 6
    """The direction of the contact force, where there is no friction (spatial model)."""
    HULL = 7
    """Perpendicular to the rod, with all contacts on one side: the middle of the angles that this leaves (spatial model)."""
    FACET = 8
    """The facet of a polyhedron that several slices show, or those that meet at the contact."""
    SURFACE = 9
    """The surface through all contacts, at the contact of a probing, which by itself has no normal."""
    MEASURED = 10
    """It was measured with the touch of another probe."""


class Tilt(NamedTuple):
    """How the planes in which the rod bends differ from those of the slices."""

    slope: float
    """Largest tangent of the angle between a row's plane and its slice."""
    spread: float
    """Largest difference between the height of a row's plane over the centre and that of its slice."""
    centre: Array
    """(3,) a place amid the contacts."""

    def scaled(self, factor: float) -> Tilt:
        """The same tilt in another unit of length."""
        return Tilt(self.slope, factor * self.spread, factor * self.centre)


class LeftOut(NamedTuple):
    """Rows of a recording that contradict the rest (`scan3d.reconstruction.agreement`)."""

    rows: Index
    """(w,) their numbers, from 0."""
    share: float
    """Part of the rows with a force that they are."""
    factor: float
    """Standard deviations of the others' noise for each that the recording states."""

    @property
    def too_many(self) -> bool:
        """Whether rows contradict the rest that can't be left out."""
        return self.share > 0 and not len(self.rows)


class Unmeasured(NamedTuple):
    """Rows of a recording that hold no measurement (`scan3d.reconstruction.measured`)."""

    rows: Index
    """(w,) their numbers, from 0."""
    repeated: Index
    """Those in which a sensor that is slower than its log shows the row before: a sweep goes on across them."""
    words: tuple[str, ...]
    """What was not measured in them, in sentences."""
    poses: bool
    """Whether poses are held, so that those of the other rows are not certain either."""


@dataclass(frozen=True, repr=False)
class Cloud(Shown, Exported):
    """Contacts (n,) in the world, in the recording's unit, and the slices (s,) they lie in."""

    points: Array
    """(n, 3)"""
    normals: Array
    """(n, 3) outward unit normals of the surface; NaN where unknown."""
    normal_source: NDArray[np.int8]
    """(n,) of `NormalSource`."""
    in_plane_normals: Array
    """(n, 3) outward unit normals of the slice's contour in its plane: in tangential contact by (14), in tip contact by
    the friction that the tangential contacts agree on, NaN if they do not agree."""
    phase: NDArray[np.int8]
    """(n,) of `planar.Phase`: TIP or TANGENTIAL."""
    slice: NDArray[np.int32]
    """(n,) number of the slice."""
    sweep: NDArray[np.int32]
    """(n,) number of the sweep."""
    row: NDArray[np.int32]
    """(n,) row of the recording, from 0, that the contact was reconstructed from."""
    force_N: Array
    """(n,) contact force."""
    friction: Array
    """(n,) coefficient of friction (14), NaN in tip contact."""
    slice_axis: Array
    """(s, 3) unit normal of every slice, including the empty ones, which have no contact."""
    slice_height: Array
    """(s,) its height along that normal, in the recording's unit."""
    unit: str
    """Unit of all lengths here, that of the recording."""
    rod_length: float
    """In the recording's unit; of touches of another probe the diagonal of their box, as a scale."""
    noise: float
    """Median standard deviation of a contact's place, in its least certain direction, in the recording's unit; 0 for exact
    data."""
    covariance: Array | None = None
    """(n, 3, 3) covariance of each contact's place, in the recording's unit squared; None for exact data."""
    place_sd: Array | None = None
    """(n,) standard deviation of each contact's place in its least certain direction; None for exact data."""
    normal_sd: Array | None = None
    """(n,) standard deviation of the angle of the in-plane normal in tangential contact, in radians, infinite in tip contact;
    None for exact data."""
    unresolved: NDArray[np.bool_] | None = None
    """(s,) whether a slice without contact may not be empty: forces stand out from the noise, or the rods did not sweep all
    places that the body may reach there.  None: there is no such slice."""
    probed: NDArray[np.bool_] | None = None
    """(n,) whether the contact is that of a probing, whose rod moves along itself (`reconstruction.probings`): it has no slice,
    which is -1.  None: there is none."""
    bead_radius: float = 0.0
    """Of the ball on the tip of the rod that probed, in the recording's unit; 0 for none."""
    bead_centres: Array | None = None
    """(n, 3) its centres at the contacts, which are `bead_radius` away from `points`; None without a bead."""
    bead_sd: Array | None = None
    """(n,) standard deviation of each centre in its least certain direction; None without a bead, or for exact data."""
    light: int = 0
    """Number of contacts left out because the rod touched too lightly for the noise."""
    convex: bool = True
    """Whether the body counts as convex: unless its recording states that it is not, and its contacts accord with that."""
    of_sweeps: Cloud | None = None
    """Of sweeps and probings: the contacts of the sweeps by themselves, which may accord with a convex body."""
    second: int = 0
    """Number of rows with a force of which no contact is known, because the rod touched at a second place as well."""
    left_out: LeftOut | None = None
    """Rows of the recording that contradict the rest, and were left out; None if there are none."""
    unmeasured: Unmeasured | None = None
    """Rows of the recording that were not measured, and were left out; None if there are none."""
    pose_error: float = 0.0
    """Largest error of a contact's place by the digits of the poses, in the recording's unit."""
    normal_error: float = 0.0
    """Largest error of a measured normal's direction by its digits, in radians."""
    tilt: Tilt | None = None
    """How the planes in which contacts lie differ from their slices; None if they agree up to `pose_error`."""
    table: float | None = None
    """Height z of the table, below which nothing of the body lies, in the recording's unit; None if no table is known."""

    model: str = "planar"
    """Model of contact that gave the contacts, one of `choices.MODELS`, or ``touches`` of another probe.  Only clouds of the
    planar model have slices: in others `slice` is -1, `in_plane_normals` are NaN, `slice_axis` and `slice_height` are empty."""
    rod_radius: float = 0.0
    """Radius of the rod in the recording's unit, by which `points` lie inside `centre_points`, or inside the points of the
    `fattened` cloud; 0 where it is not known.  Of a tapered rod the largest."""
    tapered: bool = False
    """Whether the rod's radius changes along it, so that its centre line touches no body fattened by one radius."""
    fattened: Cloud | None = None
    """Of a thick rod in a plane: the contacts of its centre line with the body fattened by the rod's radius, in which all that
    follows from slices is found; None for a rod without thickness."""
    lever: float = 0.0
    """How far a contact of the centre line may lie outside of the fattened body, in the recording's unit, because friction acts
    on the rod's surface and not on its centre line."""
    centre_points: Array | None = None
    """(n, 3) points of the rod's centre line at the contacts (spatial model): they lie on the surface of the body fattened by
    the rod's radius, and `points` are ``centre_points - rod_radius * normals``."""
    centre_covariance: Array | None = None
    """(n, 3, 3) covariance of each centre point, in the recording's unit squared; None for exact data."""
    tangents: Array | None = None
    """(n, 3) unit tangents of the rod at the contacts, towards its tip (spatial model).  In tangential contact the whole line
    through the centre point along the tangent is free of the interior of the fattened body."""
    tangent_sd: Array | None = None
    """(n,) root of the mean square error of each tangent's direction, in radians; None for exact data."""
    bending_angle: Array | None = None
    """(n,) angle between the plane in which the rod bends and the plane of its sweep, in radians (spatial model)."""
    slip_to_path: Array | None = None
    """(n,) angle in radians between the normals from slip and path, where both are known to a degree, else NaN (spatial model).
    Without isotropic Coulomb friction it is not small."""
    calibration: RigErrors | None = None
    """Standard deviations by the uncertainty of the rig's calibration, which are not part of the others; None without it."""
    independent: bool = True
    """Whether the errors of successive contacts are independent, as those of noise are; those of rounding alone are not."""

    kept: dict[str, Any] = field(default_factory=dict, repr=False, compare=False)
    """What was computed from the contacts and may be asked for again, by its name and with the arrays that it depends on."""

    def accurate(self) -> Cloud:
        """The cloud without the contacts whose place is much less certain than most, as under light touches."""
        if self.place_sd is None:
            return self
        # less uncertain ones do not draw surfaces to places outside the body
        limit = max(4 * self.noise, 2e-5 * self.rod_length)
        return self if (self.place_sd <= limit).all() else self.select(self.place_sd <= limit)

    @property
    def in_slices(self) -> bool:
        """Whether the contacts lie in slices, and not anywhere."""
        return self.model == "planar"

    @property
    def noisy(self) -> bool:
        """Whether the contacts have errors that surfaces should not follow."""
        return self.covariance is not None and self.noise > 1e-7 * self.rod_length

    def least_variance(self) -> Array:
        """(n,) variances that are added to the covariances in every direction where contacts are weighted; for noisy data."""
        assert self.place_sd is not None
        # errors of the second order, and no contact counts as if it were much more accurate than most
        second = self.place_sd**2 / (0.3 * self.rod_length)
        return (0.15 * self.noise) ** 2 + self.pose_error**2 + second**2

    def sd_along(self, directions: Array) -> Array | None:
        """(n,) standard deviations of the places along unit vectors (n, 3), NaN where those are; None unless `noisy`."""
        if not self.noisy:
            return None
        assert self.covariance is not None
        variance = np.einsum("ni,nij,nj->n", directions, self.covariance, directions)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0) + self.least_variance()))

    fit: SupportFit | None = None
    """The support function fitted to the contacts, if the body proved smooth."""

    def __len__(self) -> int:
        return len(self.points)

    @classmethod
    def of_places(cls, points: Array, **known: Any) -> Cloud:
        """Exact contacts (n, 3) at the tip, in no slices and without normals, but for the columns that are given."""
        numbers, unknown = np.arange(len(points), dtype=np.int32), np.full(len(points), np.nan)
        columns: dict[str, Any] = {
            "normals": np.full((len(points), 3), np.nan),
            "normal_source": np.full(len(points), NormalSource.UNKNOWN, dtype=np.int8),
            "in_plane_normals": np.full((len(points), 3), np.nan),
            "phase": np.full(len(points), planar.Phase.TIP, dtype=np.int8),
            "slice": np.full(len(points), -1, dtype=np.int32),
            **{"sweep": numbers, "row": numbers, "force_N": unknown, "friction": unknown},
            **{"slice_axis": np.empty((0, 3)), "slice_height": np.empty(0), "noise": 0.0},
        }
        return cls(points, **(columns | known))

    def swept(self) -> Cloud:
        """The contacts that are not those of probings."""
        return self if self.probed is None else replace(self.select(~self.probed), probed=None)

    def select(self, rows: Mask | Index) -> Cloud:
        """A cloud of some of the contacts, selected by (n,) booleans or by indices; slices, fit and settings stay the same."""
        columns = {name: getattr(self, name) for name in PER_CONTACT}
        selected = {name: column[rows] for name, column in columns.items() if column is not None}
        calibration = None if self.calibration is None else self.calibration.select(rows)
        fattened = None if self.fattened is None else self.fattened.select(rows)
        return replace(self, **selected, calibration=calibration, fattened=fattened, kept=dict(self.kept))

    def changed(self, **columns: Callable[[Cloud], Any]) -> Cloud:
        """The cloud with other columns, which are made of it; those of the `fattened` one are made of that."""
        parts = {name: getattr(self, name) for name in ("fattened", "of_sweeps")}
        parts = {name: part and part.changed(**columns) for name, part in parts.items()}
        return replace(self, **{name: made(self) for name, made in columns.items()}, **parts)

    def summary(self) -> Rows:
        """Counts, size and what was measured."""
        tips = int((self.phase == planar.Phase.TIP).sum())
        friction = self.friction[np.isfinite(self.friction)]
        size, unit = lengths(np.ptp(self.points, axis=0) if len(self) else np.zeros(3), self.unit)
        swept = np.ones(len(self), dtype=bool) if self.probed is None else ~self.probed
        slices = ("slices", f"{len(np.unique(self.slice[swept]))} with contacts of {len(self.slice_height)}")
        probings = "" if swept.all() else f" and {(~swept).sum()} probings"
        in_space = ("model", "spatial: the rod may leave the plane of its sweep")
        rows: Rows = [("touches", f"{len(self)} of another probe")]
        if self.model != "touches":
            rows = [
                ("contacts", f"{len(self)}: {len(self) - tips} tangential, {tips} at the tip"),
                slices if self.in_slices else in_space,
                ("sweeps", f"{len(np.unique(self.sweep[swept]))}{probings}"),
            ]
        rows += [
            ("size", f"{' × '.join(size)} {unit}"),
            ("normals", f"{np.isfinite(self.normals).all(axis=1).sum()} known"),
        ]
        if np.isfinite(self.force_N).any():
            rows.append(("force", f"{force(self.force_N.min())} to {force(self.force_N.max())}"))
        if len(friction):
            spread = f"{number(friction.min())} to {number(friction.max())}"
            rows.append(("friction", f"{number(float(np.median(friction)))} (median; {spread})"))
        if self.noise:
            rows.append(("position noise", f"{length(self.noise, self.unit, digits=2)} (standard deviation)"))
        return rows


PER_CONTACT = (
    "points", "normals", "normal_source", "in_plane_normals", "phase", "slice", "sweep", "row", "force_N", "friction",
    "probed", "covariance", "place_sd", "normal_sd", "centre_points", "centre_covariance", "tangents",
    "tangent_sd", "bending_angle", "slip_to_path", "bead_centres", "bead_sd",
)  # fmt: skip
