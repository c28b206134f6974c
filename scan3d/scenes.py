"""What there is to see of a scan: contacts, slices, surface, truth and rods, from memory or from files."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import planar
from scan3d.cloud import Array, Cloud, table
from scan3d.errors import InputError
from scan3d.files import read_ply
from scan3d.recording import Recording, read_recording
from scan3d.units import UNITS_M

COLORS = ("phase", "force", "friction", "error")
"""What contacts can be coloured by."""
# Contours this much narrower than the widest are as wide: among them the sweep nearest to the middle explains best.
_AS_WIDE = 0.95
# A surface's deviation varies inside its facets: longer edges, in diagonals, are split before it is looked up.
_FINEST = 1 / 60
# A contact's force and its row's agree to rounding.
_SAME_FORCE = 1e-9
_UNIT_COMMENT = "unit "


@dataclass(frozen=True)
class Scene:
    """What is known of a body.  Lengths in `unit`."""

    name: str
    unit: str
    contacts: NDArray[Any] | None = None
    """(n,) the columns of `cloud.table`, or as many of them as a file has."""
    surface: Any = None
    """The reconstructed surface, a `trimesh.Trimesh`."""
    bound: Array | None = None
    """(v,) certified local bound at its vertices."""
    truth: Any = None
    """The true body, a `trimesh.Trimesh`."""
    recording: Recording | None = None
    figures: tuple[tuple[str, str], ...] = field(default=())
    """Key figures: what, and how much."""

    @property
    def points(self) -> Array:
        """(n, 3) contacts."""
        return np.empty((0, 3)) if self.contacts is None else columns(self.contacts, "x", "y", "z")

    @property
    def normals(self) -> Array:
        """(n, 3) outward normals, NaN where unknown."""
        if self.contacts is None or "nx" not in (self.contacts.dtype.names or ()):
            return np.full((len(self.points), 3), np.nan)
        return columns(self.contacts, "nx", "ny", "nz")

    @property
    def corners(self) -> Array:
        """(k, 3) points that fill a picture of all bodies."""
        bodies = [np.asarray(mesh.vertices) for mesh in (self.surface, self.truth) if mesh is not None]
        return np.concatenate([self.points, *bodies])

    @property
    def diagonal(self) -> float:
        """Of the bounding box."""
        return float(np.linalg.norm(np.ptp(self.corners, axis=0)))

    def column(self, name: str) -> Array | None:
        """(n,) a column of the contacts, None if there is none or nothing in it."""
        name = {"error": "quality"}.get(name, name)
        if self.contacts is None or name not in (self.contacts.dtype.names or ()):
            return None
        values = columns(self.contacts, name)[:, 0]
        return values if np.isfinite(values).any() else None


def columns(rows: NDArray[Any], *names: str) -> Array:
    """Columns (n, k) of a structured array."""
    return np.stack([rows[name].astype(np.float64) for name in names], axis=1)


def of_cloud(cloud: Cloud, error: Array | None = None, **more: Any) -> Scene:
    """A scene of a cloud; `error` (n,) is the contacts' distance from the truth, `more` the fields of `Scene`."""
    return Scene(**{"name": "body", **more}, unit=cloud.unit, contacts=table(cloud, error))


def of_folder(folder: Path, report: Mapping[str, Any], unit: str) -> Scene:
    """The scene in a scan's folder, without the truth.  Raises InputError if it holds neither cloud nor surface."""
    cloud, surface, log = (folder / name for name in ("cloud.ply", "surface.ply", "recording.csv"))
    if not (cloud.exists() or surface.exists()):
        raise InputError(f"{folder} holds no scan: expected cloud.ply or surface.ply in it; make it with 'scan3d scan'")
    parts: dict[str, Any] = {"figures": figures(report)}
    for path in (surface, cloud):
        if path.exists():
            found = read_ply_scene(path, unit)
            if found is None or (found.contacts is None) != (path == surface):
                raise InputError(f"{path} holds something else than its name says; run the scan again")
            kept = {name: getattr(found, name) for name in ("unit", "contacts", "surface", "bound")}
            parts |= {name: value for name, value in kept.items() if value is not None}
    if log.exists():
        parts["recording"] = read_recording(log)
    named, source = report.get("mesh") or {}, report.get("source") or {}
    origin = named.get("file") or source.get("mesh") or folder.resolve().name
    return Scene(**{"name": Path(str(origin)).stem, **parts})


def find_truth(folder: Path, report: Mapping[str, Any]) -> str | None:
    """The mesh file that a report names, if it is where it was, beside the folder, here, or in a folder here, unchanged."""
    named = report.get("mesh") or {}
    name, digest = Path(str(named.get("file"))).name, named.get("sha256")
    places = (folder, folder.resolve().parent, Path(), *sorted(one for one in Path().iterdir() if one.is_dir()))
    was = [folder / str(named["path"])] if named.get("path") else []
    for path in (*was, *(place / name for place in places)):
        if path.is_file() and hashlib.sha256(path.read_bytes()).hexdigest() == digest:
            return str(path)
    return None


def read_ply_scene(path: Path, unit: str) -> Scene | None:
    """The scene in a PLY: a cloud, or a surface as `scan` writes it with its bound; None for other PLYs with faces.

    Raises InputError for points that are none.
    """
    try:
        rows, faces, comments = read_ply(path)
    except InputError:
        return _read_foreign(path, unit)
    _check(path, rows)
    unit = said_unit(comments, unit)
    if faces is None:
        return Scene(path.stem, unit, contacts=rows)
    import trimesh

    bound = rows["bound"] if "bound" in (rows.dtype.names or ()) else None
    known = bound is not None and np.isfinite(bound).any()
    mesh = trimesh.Trimesh(columns(rows, "x", "y", "z"), faces, process=False)
    return Scene(path.stem, unit, surface=mesh, bound=bound if known else None)


def _read_foreign(path: Path, unit: str) -> Scene | None:
    """The points of another program's PLY."""
    import trimesh

    try:
        found = trimesh.load(path)
    except (OSError, ValueError, KeyError, IndexError, AttributeError, NotImplementedError) as error:
        raise InputError(f"can't read {path}: {error}; expected a PLY of points or triangles") from None
    if not isinstance(found, trimesh.PointCloud):
        return None
    rows = np.empty(len(found.vertices), dtype=[(name, "f8") for name in "xyz"])
    for name, values in zip("xyz", np.asarray(found.vertices).T, strict=True):
        rows[name] = values
    _check(path, rows)
    return Scene(path.stem, unit, contacts=rows)


def _check(path: Path, rows: NDArray[Any]) -> None:
    if not {"x", "y", "z"} <= set(rows.dtype.names or ()):
        raise InputError(f"{path.name} has no points: expected the columns x, y and z")
    if not len(rows) or not np.isfinite(columns(rows, "x", "y", "z")).all():
        raise InputError(f"{path.name} has no points, or some that are not numbers; expected a cloud of contacts")


def said_unit(comments: tuple[str, ...], unit: str) -> str:
    """The unit that a PLY's comments say, or the one given."""
    said = [line.removeprefix(_UNIT_COMMENT) for line in comments if line.startswith(_UNIT_COMMENT)]
    return said[0] if said and said[0] in UNITS_M else unit


def read_report(folder: Path) -> Mapping[str, Any]:
    """A scan's report.json; empty if there is none.  Raises InputError if it can't be read."""
    path = folder / "report.json"
    if not path.exists():
        return {}
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"can't read {path}: {error}; run the scan again") from None
    if not isinstance(data, Mapping):
        raise InputError(f"{path} is no report: expected a JSON object; run the scan again")
    return data


def shown_surface(scene: Scene) -> tuple[Any, Array | None, Array | None]:
    """The surface with, at its vertices (v,), what is known of it: signed deviation from the truth, certified local bound.

    Long edges are split where either is known.  The deviation, positive outside, is looked up anew.  The bound, certified at
    the old vertices, runs linearly between them: on a convex surface that is no less than what a facet itself is certified
    for, as a vertex has the largest bound of the facets around it.
    """
    from scan3d.comparison import signed_distances

    if scene.truth is None and scene.bound is None:
        return scene.surface, None, None
    mesh, weights, corners = _fine(scene.surface, scene.diagonal * _FINEST)
    bound = None if scene.bound is None else (weights * scene.bound[corners]).sum(axis=1)
    off = None if scene.truth is None else signed_distances(np.asarray(mesh.vertices), scene.truth)
    return mesh, off, bound


def _fine(mesh: Any, longest: float) -> tuple[Any, Array, NDArray[np.integer]]:
    """The mesh, its long edges split: every vertex is a mean, with weights (v, 3), of old vertices (v, 3)."""
    import trimesh

    if mesh.edges_unique_length.max() <= longest:
        own = np.arange(len(mesh.vertices))
        return mesh, np.tile([1.0, 0.0, 0.0], (len(own), 1)), np.stack([own] * 3, axis=1)
    vertices, faces, of = trimesh.remesh.subdivide_to_size(
        mesh.vertices, mesh.faces, longest, max_iter=20, return_index=True
    )
    old = np.empty(len(vertices), dtype=np.int64)
    old[faces] = of[:, None]  # one of the old faces it lies in
    with np.errstate(divide="ignore", invalid="ignore"):
        weights = trimesh.triangles.points_to_barycentric(mesh.triangles[old], vertices)
    slivers = ~np.isfinite(weights).all(axis=1)  # they have no such coordinates: the nearest corner's then
    away = np.linalg.norm(mesh.triangles[old[slivers]] - vertices[slivers, None], axis=2)
    weights[slivers] = np.eye(3)[away.argmin(axis=1)]
    return trimesh.Trimesh(vertices, faces, process=False), weights, np.asarray(mesh.faces)[old]


def rings(scene: Scene) -> list[tuple[Array, int]]:
    """The slices as closed lines (k, 3) through their contacts, in order around them, and their numbers."""
    number = scene.column("slice")
    if number is None:
        return []
    found = []
    for one in np.unique(number):
        points = scene.points[number == one]
        middle = (points.min(axis=0) + points.max(axis=0)) / 2
        # the plane of the slice: its contacts' two main directions
        across = np.linalg.svd(points - middle, full_matrices=False)[2][:2]
        u, v = across @ (points - middle).T
        # scaled to a round contour, where the angle about the middle tells neighbours of a needle's apart
        ring = points[np.argsort(np.arctan2(v / (np.ptp(v) or 1.0), u / (np.ptp(u) or 1.0)), kind="stable")]
        found.append((np.concatenate([ring, ring[:1]]), int(one)))
    return found


@dataclass(frozen=True)
class Sweep:
    """One sweep as it is seen.  Lengths in the scene's unit; k samples with contact."""

    number: int
    slice: int
    base: Array
    """(k, 3) clamp"""
    axes: Array
    """(3, 3) its x, y and z axes, as rows"""
    curved: Array
    """(k, p, 3) rod from the clamp to the contact"""
    straight: Array
    """(k, 2, 3) its straight rest"""
    reactions: Array
    """(k, 3) f0x, f0y in EI/L² and m0z in EI/L (8)"""
    phase: NDArray[np.int8]
    """(k,) of `planar.Phase`"""

    @property
    def contact(self) -> Array:
        """(k, 3)"""
        return self.curved[:, -1]


def sweep(scene: Scene, number: int | None = None, points: int = 60) -> Sweep:
    """A sweep of the recording, or the one that shows most.  Raises InputError if there is no recording or no such sweep."""
    recording = scene.recording
    log, slices, felt, phase = (scene.column(name) for name in ("sweep", "slice", "force", "phase"))
    if recording is None or log is None or slices is None or felt is None or phase is None:
        raise InputError(f"{scene.name} has no recording, where rods need one: show a scan's folder, or a recording")
    chosen = _telling(scene, slices, log) if number is None else number
    mine = log == chosen
    if not mine.any():
        raise InputError(f"sweep {chosen} has no contact; choose one of the {len(np.unique(log))} that have, such as "
                         f"{int(log[0])}")  # fmt: skip
    rod, rows = recording.rod, np.flatnonzero(recording.sweep == chosen)
    size = np.hypot(*recording.force_N[rows].T)
    # the rows behind the contacts, by their forces: others feel nothing but noise
    nearest = np.abs(size[:, None] - felt[mine]).argmin(axis=1)
    behind = np.abs(size - felt[mine][nearest]) <= _SAME_FORCE * size
    rows, kind = rows[behind & (size > 0)], phase[mine][nearest[behind & (size > 0)]]
    force, moment = recording.force_N[rows] / rod.force_unit_N, recording.moment_Nm[rows] / rod.moment_unit_Nm
    lines = planar.elastic_lines(np.zeros(len(rows)), force[:, 0], force[:, 1], moment, points)
    axes = recording.axes()[rows]
    kept = np.isfinite(lines.curved).all(axis=(1, 2)) & np.isfinite(lines.straight).all(axis=(1, 2))
    scale = 1 / UNITS_M[scene.unit]
    base = recording.position_m[rows]

    def world(line: Array) -> Array:
        return (base[:, None] + rod.length_m * np.einsum("npi,nij->npj", line, axes[:, :2]))[kept] * scale

    return Sweep(
        int(chosen),
        int(slices[mine][0]),
        base[kept] * scale,
        axes[0],
        world(lines.curved),
        world(lines.straight),
        np.column_stack([force, moment])[kept],
        kind[kept].astype(np.int8),
    )


def _telling(scene: Scene, slices: Array, log: Array) -> int:
    """The sweep whose contacts reach farthest, in the middle one of the widest slices."""
    numbers = np.unique(slices)
    box = [np.ptp(scene.points[slices == one], axis=0) for one in numbers]
    width = np.linalg.norm(box, axis=1)
    middle = np.array([scene.points[slices == one].mean(axis=0) for one in numbers])
    away = np.linalg.norm(middle - scene.points.mean(axis=0), axis=1)
    away[width < _AS_WIDE * width.max()] = np.inf
    found = np.unique(log[slices == numbers[np.argmin(away)]])
    reach = np.array([np.linalg.norm(np.ptp(scene.points[log == one], axis=0)) for one in found])
    return int(found[np.argmax(np.round(reach / (reach.max() or 1.0), 6))])


def figures(report: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    """The key figures of a report, those that it has; distances also in % of the diagonal."""

    def of(section: str, name: str) -> Any:
        part = report.get(section)
        return part.get(name) if isinstance(part, Mapping) else None

    found: list[tuple[str, str]] = []
    extents, unit = of("mesh", "extents"), of("certificate", "unit") or of("mesh", "unit") or ""
    if extents is not None:
        found.append(("size", " × ".join(f"{one:.4g}" for one in extents) + f" {unit}"))
    found += [
        (name, str(of("counts", name))) for name in ("contacts", "slices", "sweeps") if of("counts", name) is not None
    ]
    if of("contact_error", "max") is not None:
        found.append(("contact error", f"{of('contact_error', 'max'):.2g} {unit} at most"))
    if of("friction", "estimated_median") is not None:
        found.append(("friction", f"{of('friction', 'estimated_median'):.4g} (median)"))
    if of("surface", "method") is not None:
        found.append(("surface", f"{of('surface', 'method')}, {of('surface', 'faces')} faces"))
    for what, section, name in (
        ("Hausdorff distance", "hausdorff", "two_sided"),
        ("certified within", "certificate", "bound"),
    ):
        value, relative = of(section, name), of(section, "relative")
        if value is not None and np.isfinite(value):
            found.append((what, f"{value:.3g} {unit} ({100 * relative:.2g} %)"))
    return tuple(found)


def sentence(scene: Scene, contact: int) -> str:
    """What was felt at a contact."""
    parts = [
        "contact {}: ({})".format(contact, ", ".join(f"{x:.6g}" for x in scene.points[contact])) + f" {scene.unit}"
    ]
    for name in ("sweep", "slice"):
        values = scene.column(name)
        if values is not None:
            parts.append(f"{name} {values[contact]:.0f}")
    phase, force, friction = (scene.column(name) for name in ("phase", "force", "friction"))
    if phase is not None:
        parts.append(f"{planar.Phase(int(phase[contact])).name.lower()} contact")
    if force is not None:
        parts.append(f"force {1e3 * force[contact]:.4g} mN")
    if friction is not None and np.isfinite(friction[contact]):
        parts.append(f"friction {friction[contact]:.4g}")
    normal = scene.normals[contact]
    if np.isfinite(normal).all():
        parts.append("normal ({})".format(", ".join(f"{x:.4f}" for x in normal)))
    return ", ".join(parts)
