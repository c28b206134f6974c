"""The data that pictures of a scan show: contacts, surface, truth and recording."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

import planar
from scan3d.arrays import Array
from scan3d.cloud import Cloud
from scan3d.files.shapes import LENGTHS, POINT, cloud_table
from scan3d.geometry.convexity import HULL_OF_MESH
from scan3d.numbers import angle, force, lengths, number, unit_for
from scan3d.recording import Recording
from scan3d.units import UNITS_M


@dataclass(frozen=True)
class Scene:
    """What is known of a body.  Lengths in `unit`."""

    name: str
    unit: str
    contacts: NDArray[Any] | None = None
    """(n,) the columns of `files.shapes.cloud_table`, or as many of them as a file has."""
    surface: Any = None
    """The reconstructed surface, a `trimesh.Trimesh`."""
    bound: Array | None = None
    """(v,) certified local bound at its vertices."""
    truth: Any = None
    """The true body, a `trimesh.Trimesh`."""
    recording: Recording | None = None
    is_other: bool = False
    """Whether another surface, which need not be convex, is in the place of the true body, to be compared with."""
    key_figures: tuple[tuple[str, str], ...] = ()
    """Pairs of a quantity's name and its value, for tables."""

    @property
    def truth_name(self) -> str:
        """What pictures call the true body: the truth, or what was taken in the place of a mesh that is not convex."""
        is_hull = self.truth is not None and "filled" in self.truth.metadata
        return HULL_OF_MESH if is_hull else "truth"

    @property
    def reference(self) -> str:
        """What pictures call the body that the surface is compared with."""
        return "other surface" if self.is_other else self.truth_name

    @property
    def deviation_title(self) -> str:
        """The title of the surface's deviation."""
        if self.is_other:
            return "signed distance from the other surface"
        return f"signed deviation{self._of_hull('from')}"

    @property
    def bound_title(self) -> str:
        """The title of the local bound."""
        return f"certified bound{self._of_hull('of')}"

    def _of_hull(self, word: str) -> str:
        return "" if self.truth_name == "truth" or self.is_other else f" {word} the {self.truth_name}"

    def in_shown_unit(self) -> Scene:
        """The scene in the unit in which its size is written (`scan3d.numbers`), such as mm for a part given in metres."""
        unit = unit_for(self.diagonal, self.unit)[0].replace("µ", "u") if len(self.corners) else self.unit
        if unit == self.unit or unit not in UNITS_M:
            return self
        factor = UNITS_M[self.unit] / UNITS_M[unit]
        contacts = self.contacts
        if contacts is not None:
            contacts = contacts.copy()
            for name in set(POINT + LENGTHS) & set(contacts.dtype.names or ()):
                contacts[name] = factor * contacts[name]
        return replace(
            self,
            unit=unit,
            contacts=contacts,
            surface=_scaled(self.surface, factor),
            bound=None if self.bound is None else factor * self.bound,
            truth=_scaled(self.truth, factor),
            recording=None if self.recording is None else replace(self.recording, unit=unit),
        )

    def against(self, other: Any) -> Scene:
        """The scene in which the surface is compared with another one, a `trimesh.Trimesh` in the same unit."""
        return replace(self, truth=other, is_other=True)

    @property
    def points(self) -> Array:
        """(n, 3) contacts."""
        return np.empty((0, 3)) if self.contacts is None else columns(self.contacts, "x", "y", "z")

    @property
    def normals(self) -> Array:
        """(n, 3) outward normals, NaN where unknown."""
        if self.contacts is None or not {"nx", "ny", "nz"} <= set(self.contacts.dtype.names or ()):
            return np.full((len(self.points), 3), np.nan)
        return columns(self.contacts, "nx", "ny", "nz")

    @property
    def corners(self) -> Array:
        """(k, 3) contacts and vertices: a picture that contains them contains all bodies."""
        bodies = [np.asarray(mesh.vertices) for mesh in (self.surface, self.truth) if mesh is not None]
        return np.concatenate([self.points, *bodies])

    @property
    def diagonal(self) -> float:
        """Diagonal of the bounding box."""
        return float(np.linalg.norm(np.ptp(self.corners, axis=0)))

    def column(self, name: str) -> Array | None:
        """(n,) a column of the contacts, None if it does not exist or holds no finite value.

        Values that colours and labels, in float32 and in other units, could not be computed for are not known.
        """
        name = {"error": "quality"}.get(name, name)
        if self.contacts is None or name not in (self.contacts.dtype.names or ()):
            return None
        values = columns(self.contacts, name)[:, 0]
        values[np.abs(values) > 1e30] = np.nan
        return values if np.isfinite(values).any() else None


def _scaled(mesh: Any, factor: float) -> Any:
    return None if mesh is None else mesh.copy().apply_scale(factor)


def columns(rows: NDArray[Any], *names: str) -> Array:
    """Columns (n, k) of a structured array."""
    return np.stack([rows[name].astype(np.float64) for name in names], axis=1)


def of_cloud(cloud: Cloud, error: Array | None = None, **more: Any) -> Scene:
    """A scene of a cloud; `error` (n,) is the contacts' distance from the truth, `more` the fields of `Scene`."""
    return Scene(**{"name": "body", **more}, unit=cloud.unit, contacts=cloud_table(cloud, error))


def out_of_plane_deg(bending_angle: Array) -> Array:
    """(n,) angles in degrees between the directions to which the rod bends and the plane of the sweep, from -90 to 90.

    In contrast to the angle of the bending plane, from -180° to 180°, it does not jump, and is 0 for rods that bend backward.
    """
    return np.rad2deg(np.arcsin(np.sin(bending_angle)))


def contact_sentence(scene: Scene, contact: int) -> str:
    """What was measured at a contact, given by its row in the scene's contacts."""
    place, unit = lengths(scene.points[contact], scene.unit, digits=6)
    parts = [f"contact {contact}: ({', '.join(place)}) {unit}"]
    for name in ("sweep", "slice"):
        values = scene.column(name)
        if values is not None:
            parts.append(f"{name} {values[contact]:.0f}")
    phase, pushed, friction = (scene.column(name) for name in ("phase", "force", "friction"))
    if phase is not None:
        parts.append(f"{planar.Phase(int(phase[contact])).name.lower()} contact")
    if pushed is not None:
        parts.append(f"force {force(pushed[contact], digits=4)}")
    if friction is not None and np.isfinite(friction[contact]):
        parts.append(f"friction {number(friction[contact])}")
    bending = scene.column("bending")
    if bending is not None:
        parts.append(f"bending {angle(out_of_plane_deg(bending)[contact])} out of the sweep's plane")
    normal = scene.normals[contact]
    if np.isfinite(normal).all():
        parts.append("normal ({})".format(", ".join(f"{x:.4f}" for x in normal)))
    return ", ".join(parts)
