"""The surface of a body of any shape from a recording: contacts and free space, and the cut through them.

Rods that move along themselves pass lines, which the cut takes as they are.  Of slices alone more is known:

In the plane of a slice free space is proven (`scan3d.bounds.free_space`).  Between two planes it is estimated: the distance
from the border is interpolated.  Of slices along several axes that one decides whose border, and whose planes, are nearest; but
free space of any axis counts where it is wider than its planes are away.  For rods that go around a body do not see its holes,
which those of other axes see.

Where no contact supports the outer contours of the slices, and between planes of which only one has the body, the surface gets
corners at the border of free space.  Elsewhere it runs through the contacts (`scan3d.surfaces.cut`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from scan3d.arrays import Array, Mask, unit_or_zero
from scan3d.bounds.free_space import Contours, Sheets, contradicted, outer_contours, passed_lines, sheets_of, spacing_of
from scan3d.cloud import TOUCHED, Cloud, NormalSource
from scan3d.errors import InputError, NoBodyError
from scan3d.geometry.crossings import first_crossings
from scan3d.geometry.distance import Search, poly_data
from scan3d.geometry.triangles import areas, dot, face_normals, kept_apart, linked
from scan3d.poses import AWAY
from scan3d.reconstruction.contacts import into_body, with_rows
from scan3d.reconstruction.touches import oriented
from scan3d.recording import Recording, of_rows
from scan3d.spatial.bodies import diameter, sphere_directions
from scan3d.surfaces.cut import ESTIMATED, KNOWN, UNKNOWN, Cut, cut_surface
from scan3d.units import length

# Directions from which a place is looked at that no rod has touched.
_LOOKED_FROM = 96
# Distance from a contact, in spacings, up to which it supports a contour.
_SUPPORTED = 1.5
# Free places are taken this part of the diagonal apart up to so many times as far from the border, and beyond so many times as
# far apart.
_STEP, _NEAR, _COARSE = 0.005, 4, 6
# Touches that the plane is taken through that estimates a normal.
_PLANE_OF = 12
# Heights of these places between two planes, in parts of their distance: next to the planes, where what they show holds.
_HEIGHTS = (0.0, 0.1, 0.9)


@dataclass(frozen=True)
class AnyShape:
    """The surface of a body of any shape, and what is known of it, in the cloud's unit."""

    surface: Any
    """A closed `trimesh.Trimesh`, outward; ``vertex_attributes["known"]``: 2 known, 1 estimated, 0 unknown."""
    contours_bound: float
    """In the planes of the slices every point of the outer contours lies within it of the true contour (C16)."""
    apart: float
    """Distance of neighbouring slices, within which of a contact the body counts as reached; the largest of all axes."""
    coverage: dict[str, Any]
    """``known``, ``estimated``: shares of the area; ``unknown``: patches ``{center, area, extent}``, largest first."""
    off: int
    """Number of contacts that are `off` the surface, as of `cut.Cut`."""


def any_shape(recording: Recording, cloud: Cloud) -> AnyShape:
    """The surface of a body of any shape from the contacts of a recording in its slices and from where its rods have been.

    Rows that were felt and are not in the cloud, as those with second contacts, count as unknown.  Raises InputError for clouds
    of the spatial model, and for contacts that do not span a body.
    """
    if cloud.probed is not None:
        return _from_anywhere(recording, cloud)
    touched = cloud.fattened or cloud
    sheets = sheets_of(recording, touched)
    kept = ~contradicted(sheets, touched)
    if not kept.any():
        raise NoBodyError("all contacts lie where other rods have passed; check the poses of the recording")
    touched, cloud = touched.select(kept), cloud.select(kept)
    contours = outer_contours(sheets, touched)
    spacing = spacing_of(touched)
    unreached = _unreached(contours, sheets, spacing)
    unreached = np.stack([unreached, np.full_like(unreached, np.nan)], axis=1)
    # a thick rod's contacts lie on the body, and what its centre line has passed is free
    found = cut_surface(
        touched.points,
        into_body(recording, touched),
        np.empty((0, 2, 3)),
        _free(sheets, _STEP * float(np.linalg.norm(np.ptp(touched.points, axis=0)))),
        between=np.concatenate([unreached, _flat(sheets, spacing)]),
        moved=cloud.points,
    )
    apart = max((sheet.apart for sheet in sheets if len(sheet.height) > 1), default=0.0)
    return _of_cut(found, float(contours.distance.max(initial=0.0)), apart)


def _of_cut(found: Cut, contours_bound: float, apart: float) -> AnyShape:
    return AnyShape(found.surface, contours_bound, apart, _coverage(found.surface), int(found.off.sum()))


def _free(sheets: list[Sheets], step: float) -> Array:
    """(n, 3) free places in the planes and next to them, a step apart at the border, and fewer beyond."""
    found = []
    for sheet in sheets:
        every = max(int(step / sheet.cell), 1)
        y, x = np.indices(sheet.free.shape[1:])[:, ::every, ::every].reshape(2, -1)
        steps = np.append(np.diff(sheet.height), 0.0)
        height = np.unique(sheet.height + np.multiply.outer(_HEIGHTS, steps))
        flat = (sheet.origin + sheet.cell * np.stack([x, y], axis=1)) @ sheet.frame[:2]
        places = (flat + height[:, None, None] * sheet.frame[2]).reshape(-1, 3)
        depth = _depth(places, sheets)
        coarse = (x % (_COARSE * every) == 0) & (y % (_COARSE * every) == 0)
        chosen = np.tile(coarse, len(height)) | (np.abs(depth) < _NEAR * step)
        found.append(places[chosen & (depth > sheet.cell / 2)])
    return np.concatenate(found)


def _unreached(contours: Contours, sheets: list[Sheets], spacing: float) -> Array:
    """(n, 3) places of the outer contours, a spacing apart, without contact and not passed by rods of other slices."""
    points = contours.points[contours.distance > _SUPPORTED * spacing]
    if len(points):
        points = points[_depth(points, sheets) <= max(sheet.cell for sheet in sheets)]
    return points[kept_apart(points, spacing)] if len(points) else points


def _flat(sheets: list[Sheets], spacing: float) -> Array:
    """(n, 2, 3) places between planes of which only one has the body there, farther than a spacing from its border in either,
    and unit vectors into the body.

    Without corners there tetrahedra from the one plane to the other would be flat roofs of no place's height.
    """
    found = [np.empty((0, 2, 3))]
    for sheet in sheets:
        every = max(int(2 * spacing / sheet.cell), 1)
        depth = np.clip(sheet.depth, -sheet.apart, sheet.apart)[:, ::every, ::every]
        here, there = depth[:-1], depth[1:]
        k, y, x = np.nonzero((here * there < 0) & (np.minimum(np.abs(here), np.abs(there)) > spacing))
        a, b = here[k, y, x], there[k, y, x]
        height = sheet.height[k] + a / (a - b) * np.diff(sheet.height)[k]
        place = sheet.origin + sheet.cell * every * np.stack([x, y], axis=1)
        place = place @ sheet.frame[:2] + height[:, None] * sheet.frame[2]
        found.append(np.stack([place, np.sign(a)[:, None] * sheet.frame[2]], axis=1))
    places = np.concatenate(found)
    return (
        places[np.abs(_depth(places[:, 0], sheets)) <= max(sheet.cell for sheet in sheets)] if len(places) else places
    )


def _depth(points: Array, sheets: list[Sheets]) -> Array:
    """Estimated distance (n,) from the border of the body, positive in free space, by the slices along all axes."""
    depth, border = (np.stack(columns) for columns in zip(*(sheet.at(points) for sheet in sheets), strict=True))
    away = np.stack([sheet.away(points) for sheet in sheets])
    nearest = np.argmin(border + away, axis=0)
    wide = np.where(depth > away, depth, -np.inf).max(axis=0)
    return np.where(np.isfinite(wide), wide, np.take_along_axis(depth, nearest[None], axis=0)[0])


def _coverage(surface: Any) -> dict[str, Any]:
    """Shares of the area by class, and the patches of unknown surface."""
    faces, vertices = surface.faces.view(np.ndarray), surface.vertices.view(np.ndarray)
    known: NDArray[np.int8] = surface.vertex_attributes["known"]
    area = areas(vertices[faces])
    # a third of each face belongs to each of its vertices
    of_vertex = np.bincount(faces.ravel(), np.repeat(area / 3, 3), minlength=len(vertices))
    total = float(of_vertex.sum())
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    both = (known[start] == UNKNOWN) & (known[end] == UNKNOWN)
    _, part = linked(start[both], end[both], len(vertices))
    rows = np.flatnonzero(known == UNKNOWN)
    patches = []
    for number in np.unique(part[rows]):
        of_patch = rows[part[rows] == number]
        weight = of_vertex[of_patch]
        if not weight.sum() > 0:
            continue
        patches.append(
            {
                "center": (weight @ vertices[of_patch] / weight.sum()).tolist(),
                "area": float(weight.sum()),
                # that of a single vertex is what a third of the faces around it has
                "extent": diameter(vertices[of_patch]) or float(np.sqrt(weight.sum())),
            }
        )
    return {
        "known": float(of_vertex[known == KNOWN].sum()) / total,
        "estimated": float(of_vertex[known == ESTIMATED].sum()) / total,
        "unknown": sorted(patches, key=lambda patch: -patch["area"]),
    }


def _from_anywhere(recording: Recording, cloud: Cloud) -> AnyShape:
    """The surface through contacts of sweeps and probings, in which no line lies that their rods have passed."""
    found = cut_surface(cloud.points, into_body(recording, cloud), passed_lines(recording, cloud))
    size = float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    found.surface.units = cloud.unit
    shape = _of_cut(found, _contours_bound(recording, cloud), TOUCHED * size)
    if patches := shape.coverage["unknown"]:
        for patch, reason in zip(patches, _reasons(found.surface, patches, cloud, size), strict=True):
            patch["reason"] = reason
    return shape


def shape_of_touches(cloud: Cloud) -> AnyShape:
    """The surface of a body of any shape through touches of another probe, whose way to the body is not known.

    Free is what the largest balls contain that touch the body from outside at a touch and have no other one inside.  All
    touches have normals, as by `with_estimated_normals`.
    """
    lines = _through_balls(cloud.points, cloud.normals)
    found = cut_surface(cloud.points, -cloud.normals, lines, lines.mean(axis=1))
    size = float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    return _of_cut(found, np.inf, TOUCHED * size)


def _through_balls(points: Array, normals: Array) -> Array:
    """(n, 2, 3) segments from touches (n, 3) through the largest empty balls before them, of at most a diagonal's radius.

    A ball shrinks to the touch that is nearest to its centre until none lies inside (Ma, Bae, Choi 2012).
    """
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    tree, radius, rows = cKDTree(points), np.full(len(points), size), np.arange(len(points))
    while len(rows):
        centre = points[rows] + radius[rows, None] * normals[rows]
        distance, near = tree.query(centre)
        step = points[near] - points[rows]
        is_inside = distance < (1 - 1e-6) * radius[rows]
        rows, step = rows[is_inside], step[is_inside]
        radius[rows] = dot(step, step) / (2 * dot(step, normals[rows]))
    return np.stack([points, points + 2 * radius[:, None] * normals], axis=1)


def with_estimated_normals(cloud: Cloud) -> Cloud:
    """The cloud with normals, where they are not known, of the planes through the touches around, all turned outwards.

    Raises InputError where they are too far apart to tell which side is outside.
    """
    unknown: Mask = np.isnan(cloud.normals[:, 0])
    if not unknown.any():
        return cloud
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkFiltersPoints import vtkPCANormalEstimation

    estimate = vtkPCANormalEstimation()
    estimate.SetInputData(poly_data(cloud.points))
    estimate.SetSampleSize(_PLANE_OF)
    estimate.SetNormalOrientationToGraphTraversal()
    estimate.Update()
    found = vtk_to_numpy(estimate.GetOutput().GetPointData().GetNormals()).astype(np.float64)
    try:
        found = oriented(cloud.points, unit_or_zero(found))
    except InputError:
        raise InputError(
            f"the {len(cloud)} touches are too far apart to tell which side of the surface is outside; give their normals"
        ) from None
    source = np.where(unknown, NormalSource.SURFACE, cloud.normal_source).astype(np.int8)
    return replace(cloud, normals=np.where(unknown[:, None], found, cloud.normals), normal_source=source)


def _contours_bound(recording: Recording, cloud: Cloud) -> float:
    """That of the outer contours in the planes in which the rod was swept; infinite if there are none."""
    number, swept = np.flatnonzero(~recording.in_probings), cloud.swept()
    if not len(swept) or not swept.in_slices:
        return np.inf
    part, swept = of_rows(recording, number), with_rows(swept, number)
    sheets = sheets_of(part, swept)
    kept = swept.select(~contradicted(sheets, swept))
    return float(outer_contours(sheets, kept).distance.max(initial=0.0)) if len(kept) else np.inf


def _reasons(surface: Any, patches: list[dict[str, Any]], cloud: Cloud, size: float) -> list[str]:
    """Why patches of the surface are unknown, as far as straight rods tell that come from outside, and from above a table."""
    places = np.array([patch["center"] for patch in patches])
    near = TOUCHED * size + np.array([patch["extent"] for patch in patches]) / 2
    vertices = surface.vertices.view(np.ndarray)
    open_to, depth = np.zeros(len(places), dtype=bool), np.full(len(places), np.inf)
    from_where = "outside" if cloud.table is None else "above the table"
    for along in sphere_directions(_LOOKED_FROM).T:
        if cloud.table is not None and along[2] > 0:
            continue
        start = places - 2 * size * along
        free = 2 * size - first_crossings(surface, start, along)[0] <= near
        below = places @ along - float((vertices @ along).min())
        open_to |= free
        depth = np.where(free, np.minimum(depth, below), depth)
    short = depth > (1 - AWAY) * cloud.rod_length
    standing = (
        np.zeros(len(places), dtype=bool) if cloud.table is None else places[:, 2] - cloud.table <= TOUCHED * size
    )
    bead = 2 * cloud.bead_radius
    fits = f" where the bead of {length(bead, cloud.unit)} fits in" if bead else ""
    return [
        "the body stands on the table there"
        if stands
        else f"no straight line from {from_where} leads there"
        if not free
        else f"deeper than the rod reaches: {length(deep, cloud.unit)} behind the hull"
        if far
        else f"a straight rod reaches it; more planes may touch it{fits}"
        for stands, free, far, deep in zip(standing, open_to, short, depth, strict=True)
    ]


def with_surface_normals(cloud: Cloud, surface: Any) -> Cloud:
    """The cloud with the normals of the surface at contacts of probings, which have none by themselves."""
    assert cloud.probed is not None
    face = Search(surface.triangles).nearest(cloud.points[cloud.probed])[1]
    normals, source = cloud.normals.copy(), cloud.normal_source.copy()
    normals[cloud.probed] = face_normals(surface)[face]
    source[cloud.probed] = NormalSource.SURFACE
    return replace(cloud, normals=normals, normal_source=source)
