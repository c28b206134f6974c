"""Closed surfaces of bodies of any shape: tetrahedra between the contacts, carved by what the rods have passed.

The contacts, and where no contact supports the outer contours of the slices points of these, are the corners of Delaunay's
tetrahedra.  A tetrahedron belongs to the body unless free space fills most of it.  So the surface runs through the contacts,
with their accuracy, and elsewhere along the border of what the rods have passed.

In the plane of a slice free space is proven (`scan3d.bounds.free_space`).  Between two planes it is estimated: the distance
from the border is interpolated.  Of slices along several axes that one decides whose border, and whose planes, are nearest; but
free space of any axis counts where it is wider than its planes are away.  For rods that go around a body do not see its holes,
which those of other axes see.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import Delaunay, cKDTree

from scan3d.arrays import Array, Index, Mask
from scan3d.bounds.free_space import Contours, Sheets, contradicted, outer_contours, sheets_of, spacing_of
from scan3d.cloud import Cloud
from scan3d.errors import InputError
from scan3d.geometry.distance import Search
from scan3d.geometry.triangles import areas, kept_apart
from scan3d.recording import Recording
from scan3d.surfaces.tetrahedra import border, links, mend, parts, refined, shared

KNOWN, ESTIMATED, UNKNOWN = 2, 1, 0
"""Classes of the surface: within the spacing of a contact; between slices, where rods have reached; where no rod has."""
# Corners of tetrahedra are moved by this part of the spacing while they are found, so that no five of them lie on a sphere.
_JOGGLE, _SEED = 1e-4, 0
# Distance from a contact, in spacings, up to which it supports a contour.
_SUPPORTED = 1.5


@dataclass(frozen=True)
class Carved:
    """The surface of a body of any shape, and what is known of it, in the cloud's unit."""

    surface: Any
    """A closed `trimesh.Trimesh`, outward; ``vertex_attributes["known"]``: 2 known, 1 estimated, 0 unknown."""
    contours_bound: float
    """In the planes of the slices every point of the outer contours lies within it of the true contour (C16)."""
    apart: float
    """Distance of neighbouring slices, within which of a contact the body counts as reached; the largest of all axes."""
    coverage: dict[str, Any]
    """``known``, ``estimated``: shares of the area; ``unknown``: patches ``{center, area, extent}``, largest first."""


def carved(recording: Recording, cloud: Cloud) -> Carved:
    """The surface of a body of any shape from the contacts of a recording in its slices and from where its rods have been.

    Rows that were felt and are not in the cloud, as those with second contacts, count as unknown.  Raises InputError for clouds
    of the spatial model, and for contacts that do not span a body.
    """
    import trimesh

    touched = cloud.fattened or cloud
    sheets = sheets_of(recording, touched)
    kept = ~contradicted(sheets, touched)
    if not kept.any():
        raise InputError("all contacts lie where other rods have passed; check the poses of the recording")
    touched, cloud = touched.select(kept), cloud.select(kept)
    contours = outer_contours(sheets, touched)
    spacing = spacing_of(touched)
    unreached = _unreached(contours, sheets, spacing)
    points = np.concatenate([touched.points, unreached, _flat(sheets, spacing)])
    # contacts that are closer are one corner
    corners = kept_apart(points, 0.1 * spacing)
    faces = corners[_bounded(points[corners], corners < len(touched), sheets, spacing)]
    # the tetrahedra are those of the rod's centre line; a thick rod's contacts lie on the body
    points[: len(cloud)] = cloud.points
    vertices, faces = refined(points, faces, 2 * spacing)
    surface = trimesh.Trimesh(vertices, faces, process=False)
    surface.metadata.update(
        method="carved", reason="tetrahedra between the contacts, carved by what the rods have passed"
    )
    apart = max((sheet.apart for sheet in sheets if len(sheet.height) > 1), default=0.0)
    known = _classes(surface.vertices.view(np.ndarray), cloud.points, unreached, spacing, apart)
    surface.vertex_attributes["known"] = known
    return Carved(surface, float(contours.distance.max(initial=0.0)), apart, coverage_of(surface, known))


def _unreached(contours: Contours, sheets: list[Sheets], spacing: float) -> Array:
    """(n, 3) places of the outer contours, a spacing apart, without contact and not passed by rods of other slices."""
    points = contours.points[contours.distance > _SUPPORTED * spacing]
    if len(points):
        points = points[_depth(points, sheets) <= max(sheet.cell for sheet in sheets)]
    return points[kept_apart(points, spacing)] if len(points) else points


def _flat(sheets: list[Sheets], spacing: float) -> Array:
    """(n, 3) places between planes of which only one has the body there, farther than a spacing from its border in either.

    Without corners there tetrahedra from the one plane to the other would be flat roofs of no place's height.
    """
    found = [np.empty((0, 3))]
    for sheet in sheets:
        every = max(int(2 * spacing / sheet.cell), 1)
        depth = np.clip(sheet.depth, -sheet.apart, sheet.apart)[:, ::every, ::every]
        here, there = depth[:-1], depth[1:]
        k, y, x = np.nonzero((here * there < 0) & (np.minimum(np.abs(here), np.abs(there)) > spacing))
        a, b = here[k, y, x], there[k, y, x]
        height = sheet.height[k] + a / (a - b) * np.diff(sheet.height)[k]
        place = sheet.origin + sheet.cell * every * np.stack([x, y], axis=1)
        found.append(place @ sheet.frame[:2] + height[:, None] * sheet.frame[2])
    points = np.concatenate(found)
    return points[np.abs(_depth(points, sheets)) <= max(sheet.cell for sheet in sheets)] if len(points) else points


def _depth(points: Array, sheets: list[Sheets]) -> Array:
    """Estimated distance (n,) from the border of the body, positive in free space, by the slices along all axes."""
    depth, border = (np.stack(columns) for columns in zip(*(sheet.at(points) for sheet in sheets), strict=True))
    away = np.stack([sheet.away(points) for sheet in sheets])
    nearest = np.argmin(border + away, axis=0)
    wide = np.where(depth > away, depth, -np.inf).max(axis=0)
    return np.where(np.isfinite(wide), wide, np.take_along_axis(depth, nearest[None], axis=0)[0])


def _bounded(points: Array, touched: Mask, sheets: list[Sheets], spacing: float) -> Index:
    """Faces (f, 3), outward, of the tetrahedra between points (n, 3) that belong to the body; every edge has two of them.

    What the grid does not decide, slivers between contacts, which `touched` (n,) tells, is of the body.
    """
    thin = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[-1] if len(points) > 3 else 0.0
    if thin < _JOGGLE * spacing * np.sqrt(len(points)):
        raise InputError("the contacts lie in a plane, and span no body; scan more slices")
    joggled = points + np.random.default_rng(_SEED).uniform(-1, 1, points.shape) * _JOGGLE * spacing
    cells = Delaunay(joggled)
    corners, neighbours = cells.simplices, cells.neighbors
    # free space is evaluated in the middle of a tetrahedron, and near its corners
    weights = np.vstack([np.full((1, 4), 0.25), 0.15 + 0.4 * np.eye(4)])
    places = np.einsum("pk,tkx->tpx", weights, points[corners])
    depth = _depth(places.reshape(-1, 3), sheets).reshape(len(corners), -1).mean(axis=1)
    edges = joggled[corners[:, 1:]] - joggled[corners[:, :1]]
    volume = np.abs(np.linalg.det(edges)) / 6
    fine = max(min(sheet.cell, sheet.apart) for sheet in sheets) / 2
    body = depth < np.where(touched[corners].all(axis=1), fine, -_JOGGLE * spacing)
    # free space comes from outside, and the body has no splinters in it
    part = parts(~body, neighbours)
    from_outside = np.zeros(len(body) + 1, dtype=bool)
    from_outside[part[~body & (neighbours < 0).any(axis=1)]] = True
    body |= ~from_outside[part]
    part = parts(body, neighbours)
    sizes = np.bincount(part[body], volume[body], minlength=len(body) + 1)
    # smaller parts are splinters between rods
    body &= sizes[part] >= 1e-3 * sizes.sum()
    if not body.any():
        raise InputError("the contacts span no body that the rods have left free; take more sweeps in a slice")
    # contacts on flat parts may have slivers above them
    faces = border(body, joggled, corners, neighbours)[0]
    deep = np.setdiff1d(np.flatnonzero(touched), np.append(faces, corners[~body]))
    deep = deep[Search(points[faces]).nearest(points[deep])[0] > 2 * fine]
    _uncover(body, deep, corners, neighbours, volume * np.abs(depth))
    for rounds in range(len(body)):
        faces, owner = border(body, joggled, corners, neighbours)
        wrong = shared(faces)
        if not len(wrong):
            break
        # edges with more than two faces are mended by the smaller side first; later tetrahedra are only added
        mend(body, wrong, corners, neighbours, volume * np.abs(depth), only_add=rounds >= 8)
    return faces


def _uncover(body: Mask, deep: Index, corners: Index, neighbours: Index, cost: Array) -> None:
    """Free the tetrahedra of least cost that lead from free space to each of the points that lie deep in the body."""
    at_border = body & np.where(neighbours >= 0, ~body[neighbours], True).any(axis=1)
    length, before, _ = dijkstra(
        links(body, neighbours, cost), indices=np.flatnonzero(at_border), return_predecessors=True, min_only=True
    )
    cell, column = np.nonzero(np.isin(corners, deep))
    order = np.argsort(length[cell], kind="stable")
    path = cell[order][np.unique(corners[cell, column][order], return_index=True)[1]]
    while len(path):
        body[path] = False
        path = np.unique(before[path])
        path = path[path >= 0]


def _classes(points: Array, contacts: Array, unreached: Array, spacing: float, gap: float) -> NDArray[np.int8]:
    """(n,) class of points (n, 3) of the surface."""
    # between two slices and two contacts of each of them
    tree, most = cKDTree(contacts), np.hypot(gap, _SUPPORTED * spacing)
    distance = tree.query(points, distance_upper_bound=most)[0]
    known = np.where(distance <= spacing, KNOWN, np.where(np.isfinite(distance), ESTIMATED, UNKNOWN))
    asked, unreached = np.flatnonzero(known == ESTIMATED), unreached[tree.query(unreached)[0] > most]
    if len(unreached):
        known[asked[cKDTree(unreached).query(points[asked])[0] < distance[asked]]] = UNKNOWN
    return known.astype(np.int8)


def coverage_of(surface: Any, known: NDArray[np.int8]) -> dict[str, Any]:
    """Shares of the area by class, and the patches of unknown surface."""
    faces, vertices = surface.faces.view(np.ndarray), surface.vertices.view(np.ndarray)
    area = areas(vertices[faces])
    # a third of each face belongs to each of its vertices
    of_vertex = np.bincount(faces.ravel(), np.repeat(area / 3, 3), minlength=len(vertices))
    total = float(of_vertex.sum())
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    both = (known[start] == UNKNOWN) & (known[end] == UNKNOWN)
    links = coo_array((np.ones(int(both.sum()), dtype=bool), (start[both], end[both])), shape=(len(vertices),) * 2)
    part = connected_components(links, directed=False)[1]
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
                "extent": float(np.linalg.norm(np.ptp(vertices[of_patch], axis=0))),
            }
        )
    return {
        "known": float(of_vertex[known == KNOWN].sum()) / total,
        "estimated": float(of_vertex[known == ESTIMATED].sum()) / total,
        "unknown": sorted(patches, key=lambda patch: -patch["area"]),
    }
