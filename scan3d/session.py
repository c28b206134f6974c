"""A session at a rig: ask for poses, tell what was measured, and ask again, until the bound is small enough.

A session does not know the body.  A rig, real or computed, goes through the poses that `Session.ask` gives, and its recording
is given to `Session.tell`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from scan3d.bounds import Certificate, Gap
from scan3d.bounds.free_space import passed_lines
from scan3d.choices import Model
from scan3d.cloud import Cloud
from scan3d.errors import InputError
from scan3d.geometry.hulls import distance_from_hull, hull
from scan3d.pipeline import analyse
from scan3d.planning import rig
from scan3d.planning.heights import next_heights
from scan3d.planning.plan import further_directions, open_places
from scan3d.poses import TABLE, PoseList
from scan3d.reconstruction import Contradiction, reconstruct
from scan3d.reconstruction.agreement import BELOW_TABLE, below_table
from scan3d.reconstruction.contacts import into_body
from scan3d.reconstruction.slices import stacks
from scan3d.recording import Recording, joined
from scan3d.report import Analysis, contradicted, touched
from scan3d.rods import Rod
from scan3d.shown import Described, Rows
from scan3d.units import UNITS_M, length, share
from scan3d.workers import in_one_thread, tell

if TYPE_CHECKING:
    import trimesh


class Session(Described):
    """Poses out, recordings in: the body that stands on z = 0 in the bounding body `around`.

    around
        the bounding body, an `Envelope` or its text, such as ``"cylinder:80x90"``.
    rod, model, settings
        as in `RigPlan`; by default 8 slices in the first batch.
    tolerance
        bound, relative to the diagonal of the contacts' bounding box, at which `ask` gives no more poses.
    seed
        of the directions of sweeps that are aimed in space.

    Raises InputError as `RigPlan`.
    """

    def __init__(
        self,
        around: rig.Envelope | str,
        rod: Rod | None = None,
        model: Model = "planar",
        *,
        tolerance: float = 0.0,
        seed: int = 0,
        **settings: Any,
    ) -> None:
        body = rig.parse_envelope(around) if isinstance(around, str) else around
        self.plan = rig.RigPlan(body, model, rod=rod, **{"slices": 8, **settings})
        self.plan.resolved_clearance()
        if not tolerance >= 0:
            raise InputError(f"tolerance must be a number >= 0, got {tolerance}")
        self.tolerance = tolerance
        self._seed = seed
        self._recordings: list[Recording] = []
        self._last: Analysis | None = None

    @in_one_thread
    def ask(self, sweeps: int = 24) -> PoseList | None:
        """The poses of the next sweeps: first those of the plan, then about `sweeps` where most room is left for the body.

        None if the tolerance is met, or if no further sweep would add information.  Further sweeps are in the planes of the
        recording's own slices, and of horizontal ones at first.  Raises InputError if the contacts so far span no body, or lie
        outside the bounding body, and if clamp or rod would come below the floor on every sweep.
        """
        if not self._recordings:
            return self.planned()
        if self.relative_bound <= self.tolerance:
            return None
        tell("planning")
        self._check_around()
        if not self.cloud.convex:
            return self._probings(max(1, sweeps // rig.SIDES))
        self._known.checked_surface()  # raises NoBodyError
        chosen = self._further_slices(sweeps) if self.plan.model == "planar" else self._aimed(sweeps)
        return self._numbered(chosen)

    def _numbered(self, chosen: list[rig.Sweep]) -> PoseList | None:
        """The poses of sweeps that follow those so far."""
        return rig.pose_list(chosen, self.plan, int(self.recording.sweep.max()) + 1) if chosen else None

    def _probings(self, planes: int) -> PoseList | None:
        """Probings in so many planes, where most is unknown of a body that is not convex; None if nothing is left to gain."""
        recording, cloud, space = self.recording, self.cloud, self.plan.space()
        unknown = rig.unknown(space, cloud.points, [self._seed, len(self._recordings)])
        unknown.add(cloud.points, into_body(recording, cloud), passed_lines(recording, cloud))
        along = np.flatnonzero(recording.in_probings)
        begins = along[np.unique(recording.sweep[along], return_index=True)[1]]
        unknown.aimed(recording.position_m[begins] / UNITS_M[recording.unit], recording.axes()[begins])
        return self._numbered(rig.probings(unknown.next_round(planes).moves, space))

    def planned(self) -> PoseList:
        """The poses of the first batch."""
        return rig.plan_poses(self.plan)

    def tell(self, recording: Recording) -> None:
        """Add what was measured; its sweeps are numbered after those so far.

        Raises InputError for a recording with another rod, unit or table, or without the axes that the model needs.
        """
        if not isinstance(recording, Recording):
            raise InputError(
                f"tell a scan3d.Recording, got {type(recording).__name__}; scan3d.read_recording reads a file"
            )
        if self.plan.model == "spatial":
            recording.wrench()
        if recording.unit != self.plan.unit:
            raise InputError(f"the session is in {self.plan.unit}, and the recording in {recording.unit}")
        if recording.table_m not in (None, TABLE):
            raise InputError(
                f"the session's body stands on z = 0, and the recording's on z = {length(recording.table_m, 'm', digits=4)}; "
                "state poses in a frame in which the table is at 0"
            )
        recording = replace(recording, table_m=TABLE)
        joined([*self._recordings[-1:], recording])  # raises InputError if it cannot be done
        self._recordings.append(recording)
        self._last = None

    @property
    def recording(self) -> Recording:
        """All recordings so far as one.  Raises InputError if there are none."""
        if not self._recordings:
            raise InputError("there is no recording yet: sweep the poses of ask(), and tell() their recording")
        return joined(self._recordings)

    @property
    def cloud(self) -> Cloud:
        """The contacts, with the table at z = 0."""
        return self._known.cloud

    @property
    def surface(self) -> trimesh.Trimesh:
        """The surface, a `trimesh.Trimesh`.  Raises NoBodyError if the contacts so far span no body."""
        return self._known.checked_surface()

    @property
    def certificate(self) -> Certificate:
        """The certificate of the surface; of nothing where the recording contradicts the model (`warnings`)."""
        return self._known.certificate

    @property
    def warnings(self) -> tuple[Contradiction, ...]:
        """Contradictions between the recordings and the model."""
        return self._known.warnings

    @property
    def relative_bound(self) -> float:
        """The certified bound, relative to the diagonal of the contacts' bounding box."""
        return self.certificate.relative(self.cloud.points)

    @property
    def known(self) -> str:
        """What is certified so far, in words."""
        found, unit = self._known, self.plan.unit
        if why := contradicted(found.cloud.model) if found.warnings else self.recording.untested:
            return f"nothing is certified: {why}"
        if found.any_shape is not None and found.cloud.probed is not None:
            return touched(found.any_shape.coverage, unit)
        if found.any_shape is not None:
            contours = f"the outer contours are known within {length(found.any_shape.contours_bound, unit, up=True)}"
            return f"{contours} in the planes of the slices; between them nothing is, because the body is not convex"
        if not self.certificate.bound < np.inf:
            return "nothing bounds the body yet"
        part = share(self.relative_bound, up=True)
        return f"the body is known within {length(self.certificate.bound, unit, up=True)} ({part} of the diagonal)"

    def summary(self) -> Rows:
        """The plan, and what is known so far."""
        plan, known = self.plan, self._recordings
        rows = [
            ("around", f"{plan.around} in {plan.unit}"),
            ("model", plan.model),
            ("tolerance", f"{self.tolerance:g}"),
        ]
        if not known:
            return [*rows, ("recordings", "none yet: sweep the poses of ask(), and tell() their recording")]
        return [*rows, ("recordings", f"{len(known)} with {len(self.cloud)} contacts"), ("certified", self.known)]

    @property
    def _known(self) -> Analysis:
        """What follows from all recordings so far.

        Raises InputError for contacts below the table: poses are planned for a body that stands on it.
        """
        if self._last is None:
            found = analyse(self.recording, model=self.plan.model)
            for warning in found.warnings:
                if warning.code == BELOW_TABLE:
                    raise InputError(warning.message)
            self._last = found
        return self._last

    def _check_around(self) -> None:
        """Raises InputError for contacts that do not lie in the bounding body, from which poses keep away."""
        space, points = self.plan.space(), self.cloud.points
        points = points[np.isfinite(points).all(axis=1)]
        beyond = float(distance_from_hull(space.points)(points).max())
        if beyond > space.margin:
            raise InputError(
                f"contacts lie up to {length(beyond, self.plan.unit)} outside of the bounding body {self.plan.around}, which "
                "stands on z = 0 about the z axis: state a larger one to keep away from, or move the frame of the poses"
            )

    def _further_slices(self, sweeps: int) -> list[rig.Sweep]:
        """Sweeps of new slices, and of slices that their contacts leave open."""
        plan, space, cloud = self.plan, self.plan.space(), self.cloud
        by_axis = stacks(cloud.fattened or cloud)
        frames, count = [stack.frame for stack in by_axis], max(1, sweeps // rig.SIDES // len(by_axis))
        chosen = self._open_directions(sweeps)
        for k, frame in enumerate(frames):
            # as finely as slabs will be divided in the end
            heights = next_heights(cloud.fattened or cloud, frame[2], 3 * count, count=count)
            along = space.points @ frame[2]
            chosen += [
                (k, float(angle), float(z))
                for z in heights
                if along.min() <= z <= along.max()
                for angle in 2 * np.pi * np.arange(rig.SIDES) / rig.SIDES
            ]
        found = [rig.slice_sweep(plan, space, angle, z, frame=frames[k]) for k, angle, z in sorted(chosen)]
        return rig.above_floor(found, space)

    def _open_directions(self, sweeps: int) -> list[tuple[int, float, float]]:
        """At most `sweeps` directions and heights, each with the number of its stack of slices, that close what the contacts
        of slices leave open, if that is much."""
        bounds, cloud = self._known.bounds, self.cloud
        if bounds.slabs is None:
            return []
        wide = (bounds.slabs.kind == Gap.CONTACTS) & (bounds.gap > 0.5 * bounds.gap.max())
        stack = bounds.slabs.stack
        if not wide.any():
            return []
        axes = [other.frame[2] for other in stacks(cloud.fattened or cloud)]
        number = int(np.argmax(np.array(axes) @ stack.frame[2]))
        directions: list[tuple[int, float, float]] = []
        for level in np.unique(np.abs((bounds.corners[wide] @ stack.frame[2])[:, None] - stack.heights).argmin(axis=1)):
            part = stack.slices[level]
            points = part.points[part.tangential]
            width = float(np.ptp(part.points, axis=0).max())
            directions += [
                (number, float(angle % (2 * np.pi)), float(part.height))
                for angle in further_directions(points, part.normals, width)
            ]
        return directions[:sweeps]

    def _aimed(self, sweeps: int) -> list[rig.Sweep]:
        space = self.plan.space()
        random = np.random.default_rng([self._seed, 7, len(self._recordings)])
        # more than are wanted: some cannot be reached from above the table
        target, normal = open_places(self.cloud.points / space.length, self.cloud.normals, 8 * sweeps)
        lines = rig.lines_to(target * space.length, normal, space, random)[:sweeps]
        return [line.sweep(self.plan.samples) for line in lines]


def around_contacts(recording: Recording, model: str) -> rig.Envelope:
    """A cylinder about the z axis that contains the contacts of a recording with a margin.

    Raises NoBodyError for contacts that span no body, and InputError for those below z = 0, where the table is.
    """
    cloud = reconstruct(replace(recording, table_m=TABLE), model=model)
    points = cloud.points[np.isfinite(cloud.points).all(axis=1)]
    hull(points)  # raises NoBodyError: one slice does not tell how large the body is
    if below := below_table(cloud):
        raise InputError(f"poses are planned for a body that stands on z = 0 about the z axis: {below[0].message}")
    radius, high = float(np.hypot(*points[:, :2].T).max()), float(points[:, 2].max())
    return rig.Envelope("cylinder", tuple(float(f"{1.1 * size:.4g}") for size in (2 * radius, high)))
