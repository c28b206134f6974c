"""Parts of a scene as they are drawn: its surface with values, the outlines of its slices, normals, and the rod in a sweep."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import planar
from scan3d.arrays import Array
from scan3d.errors import InputError
from scan3d.geometry.distance import signed_distances
from scan3d.pictures.scene import Scene
from scan3d.units import UNITS_M

# Contours this much narrower than the widest are as wide: among them the sweep nearest to the middle explains best.
_AS_WIDE = 0.95
# A surface's deviation varies inside its facets: longer edges, in diagonals, are split before it is looked up.
_FINEST = 1 / 60
# Normals drawn at most, and bent states of the rod in a picture.
_MOST_NORMALS = 500


def shown_surface(scene: Scene) -> tuple[Any, Array | None, Array | None]:
    """The surface with, at its vertices (v,), what is known of it: signed deviation from the truth, certified local bound.

    Long edges are split where either is known.  The deviation, positive outside, is looked up anew.  The bound, certified at
    the old vertices, runs linearly between them: on a convex surface that is no less than what a facet itself is certified
    for, as a vertex has the largest bound of the facets around it.
    """
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


def outlines(scene: Scene) -> list[tuple[Array, int]]:
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
class ShownSweep:
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


def shown_sweep(scene: Scene, number: int | None = None, points: int = 60) -> ShownSweep:
    """A sweep of the recording, the most informative one unless a number is given.

    Raises InputError if the scene has no recording, or contacts that do not say which rows of it they come from, or no such
    sweep.
    """
    recording = scene.recording
    sweep, slice_, row, phase = (scene.column(name) for name in ("sweep", "slice", "row", "phase"))
    if recording is None or sweep is None or slice_ is None or phase is None:
        raise InputError(f"{scene.name} has no recording, where rods need one: show a scan's folder, or a recording")
    if row is None or not (0 <= row.min() <= row.max() < len(recording)):
        raise InputError(
            f"the contacts of {scene.name} do not belong to its recording, where rods need the row of each contact: "
            "reconstruct the recording again"
        )
    chosen = _most_informative_sweep(scene, slice_, sweep) if number is None else number
    selected = sweep == chosen
    if not selected.any():
        raise InputError(
            f"sweep {chosen} has no contact; choose one of the {len(np.unique(sweep))} that have, such as {int(sweep[0])}"
        )
    rod, rows, kind = recording.rod, row[selected].astype(np.int64), phase[selected]
    force, moment = recording.force_N[rows] / rod.force_unit_N, recording.moment_Nm[rows] / rod.moment_unit_Nm
    lines = planar.elastic_lines(np.zeros(len(rows)), force[:, 0], force[:, 1], moment, points)
    axes = recording.axes()[rows]
    kept = np.isfinite(lines.curved).all(axis=(1, 2)) & np.isfinite(lines.straight).all(axis=(1, 2))
    scale = 1 / UNITS_M[scene.unit]
    base = recording.position_m[rows]

    def world(line: Array) -> Array:
        return (base[:, None] + rod.length_m * np.einsum("npi,nij->npj", line, axes[:, :2]))[kept] * scale

    return ShownSweep(
        number=int(chosen),
        slice=int(slice_[selected][0]),
        base=base[kept] * scale,
        axes=axes[0],
        curved=world(lines.curved),
        straight=world(lines.straight),
        reactions=np.column_stack([force, moment])[kept],
        phase=kind[kept].astype(np.int8),
    )


def _most_informative_sweep(scene: Scene, slices: Array, sweeps: Array) -> int:
    """The sweep whose contacts reach farthest, in the middle one of the widest slices."""
    numbers = np.unique(slices)
    box = [np.ptp(scene.points[slices == one], axis=0) for one in numbers]
    width = np.linalg.norm(box, axis=1)
    middle = np.array([scene.points[slices == one].mean(axis=0) for one in numbers])
    away = np.linalg.norm(middle - scene.points.mean(axis=0), axis=1)
    away[width < _AS_WIDE * width.max()] = np.inf
    found = np.unique(sweeps[slices == numbers[np.argmin(away)]])
    reach = np.array([np.linalg.norm(np.ptp(scene.points[sweeps == one], axis=0)) for one in found])
    return int(found[np.argmax(np.round(reach / (reach.max() or 1.0), 6))])


def normal_lines(scene: Scene, most: int = _MOST_NORMALS) -> Array:
    """(k, 2, 3) short lines along the normals of contacts, evenly chosen."""
    known = np.flatnonzero(np.isfinite(scene.normals).all(axis=1))
    some = known[:: max(1, len(known) // most)]
    points = scene.points[some]
    return np.stack([points, points + 0.035 * scene.diagonal * scene.normals[some]], axis=1)
