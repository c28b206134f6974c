"""A session at a rig: ask for poses, tell what was measured, and ask again, until the bound is small enough.

A session does not know the body.  A rig, real or computed, goes through the poses that `Session.ask` gives, and its recording
is given to `Session.tell`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from scan3d.bounds import Certificate, Gap
from scan3d.choices import Model
from scan3d.cloud import Cloud
from scan3d.errors import InputError
from scan3d.pipeline import analyse
from scan3d.planning import rig
from scan3d.planning.heights import next_heights
from scan3d.planning.plan import Plan, aimed_line, aims, further_directions, open_places
from scan3d.poses import TABLE, PoseList
from scan3d.reconstruction import Contradiction, reconstruct
from scan3d.reconstruction.agreement import BELOW_TABLE
from scan3d.reconstruction.slices import LEVEL
from scan3d.recording import Recording, joined
from scan3d.report import Analysis
from scan3d.rods import Rod
from scan3d.shown import Described, Rows
from scan3d.units import length, share

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

    def ask(self, sweeps: int = 24) -> PoseList | None:
        """The poses of the next sweeps: first those of the plan, then about `sweeps` where most room is left for the body.

        None if the tolerance is met, or if no further sweep would add information.  Raises InputError if the contacts so far
        span no body.
        """
        if not self._recordings:
            return self.planned()
        if self.relative_bound <= self.tolerance:
            return None
        chosen = self._further_slices(sweeps) if self.plan.model == "planar" else self._aimed(sweeps)
        if not chosen:
            return None
        return rig.pose_list(chosen, self.plan, int(self.recording.sweep.max()) + 1)

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
        """The surface, a `trimesh.Trimesh`."""
        return self._known.surface

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
        return self.certificate.bound / float(np.linalg.norm(np.ptp(self.cloud.points, axis=0)))

    @property
    def known(self) -> str:
        """What is certified so far, in words."""
        found, unit = self._known, self.plan.unit
        if found.carved is not None:
            contours = f"the outer contours are known within {length(found.carved.contours_bound, unit, up=True)}"
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
        bound = "nothing" if self.warnings else self.known
        return [*rows, ("recordings", f"{len(known)} with {len(self.cloud)} contacts"), ("certified", bound)]

    @property
    def _known(self) -> Analysis:
        """What follows from all recordings so far.

        Raises InputError for contacts below the table: poses are planned for a body that stands on it.
        """
        if self._last is None:
            recording = self.recording
            normals = recording.axes()[:, 2]
            # all slices are horizontal, up to the tilt of a clamp that is a little off
            level = (normals[:, 2] > 0).all() and np.linalg.norm(normals[:, :2], axis=1).max() < LEVEL
            model = "planar" if self.plan.model == "planar" and level else None
            found = analyse(recording, model=model)
            for warning in found.warnings:
                if warning.code == BELOW_TABLE:
                    raise InputError(warning.message)
            self._last = found
        return self._last

    def _further_slices(self, sweeps: int) -> list[rig.Sweep]:
        """Sweeps of new slices, and of slices that their contacts leave open.

        Of a body that is not convex: at the widest stretches without contact, and then of slices in the middle of others.
        """
        space, cloud, count = self.plan.space(), self.cloud, max(1, sweeps // rig.SIDES)
        at_stretches: list[rig.Sweep] = []
        if cloud.convex:
            # as finely as slabs will be divided in the end
            heights = next_heights(cloud.fattened or cloud, Plan(), left=3 * count, count=count)
        else:
            outline = self.plan.around.outline()
            for aim in aims(self.recording, cloud)[:sweeps]:
                line = aimed_line(aim, outline, space.length, space.clearance)
                at_stretches.append(rig.slice_sweep(self.plan, space, aim.angle, aim.height, line))
            known = np.unique(cloud.slice_height)
            between = np.argsort(-np.diff(known), kind="stable")[: (sweeps - len(at_stretches)) // rig.SIDES]
            heights = (known[between] + known[between + 1]) / 2
        top = self.plan.around.height
        chosen = [
            (float(angle), float(z))
            for z in heights
            if space.floor <= z <= top
            for angle in 2 * np.pi * np.arange(rig.SIDES) / rig.SIDES
        ]
        chosen += self._open_directions(sweeps)
        return at_stretches + [rig.slice_sweep(self.plan, space, angle, z) for angle, z in sorted(chosen)]

    def _open_directions(self, sweeps: int) -> list[tuple[float, float]]:
        """At most `sweeps` directions and heights that close what the contacts of slices leave open, if that is much."""
        bounds = self._known.bounds
        if bounds.slabs is None:
            return []
        wide = (bounds.slabs.kind == Gap.CONTACTS) & (bounds.gap > 0.5 * bounds.gap.max())
        levels = bounds.slabs.stack.heights
        if not wide.any():
            return []
        numbers = np.unique(np.abs(bounds.corners[wide, 2:] - levels).argmin(axis=1))
        directions: list[tuple[float, float]] = []
        for number in numbers:
            part = bounds.slabs.stack.slices[number]
            points = part.points[part.tangential]
            width = float(np.ptp(part.points, axis=0).max())
            # from the slices' frame, whose axes are those of the world for horizontal slices
            directions += [
                (float(angle % (2 * np.pi)), float(part.height))
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

    Raises InputError for contacts below z = 0, where the table is.
    """
    cloud = reconstruct(recording, model=model)
    low, high = float(cloud.points[:, 2].min()), float(cloud.points[:, 2].max())
    if low < -1e-6 * cloud.rod_length:
        raise InputError(
            f"contacts lie down to z = {length(low, cloud.unit, digits=4)}, and poses are planned for a body that stands on z "
            "= 0 about the z axis; move the frame of the poses"
        )
    radius = float(np.hypot(*cloud.points[:, :2].T).max())
    return rig.Envelope("cylinder", tuple(float(f"{1.1 * size:.4g}") for size in (2 * radius, high)))
