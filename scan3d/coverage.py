"""How much of a body its contacts cover."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from scan3d.arrays import Array
from scan3d.bounds import Certificate, Enclosure, certificate
from scan3d.cloud import Cloud
from scan3d.spatial.bodies import sphere_directions

# Directions, spread evenly over the sphere, by which the coverage of normals is measured.  More take longer; fewer give a
# coarser fraction.
_DIRECTIONS = 5000
# A direction is covered if a contact's normal lies within this many degrees of it.  Larger, gaps between the normals are
# overlooked; smaller, a dense scan seems to leave gaps between its samples.
_COVERED_DEG = 5.0
# The surface counts as covered where its certified bound is no more than this fraction of the diagonal, for contacts in slices
# and for contacts anywhere, whose bounds are wider.  Larger, the coverage says less about accuracy; smaller, it is low for
# scans whose accuracy is sufficient.
_COVERED_BOUND, _COVERED_ANYWHERE = 1e-3, 5e-3
# A surface with fewer facets than this is subdivided to measure its coverage, to edges of this fraction of its diagonal.  More
# and smaller facets take longer; fewer and larger ones have vertices only at the edges of a polyhedron.
_COARSE, _SUBDIVIDED = 2000, 50


def _local_bounds(bounds: Enclosure, surface: Any, certified: Certificate) -> tuple[Any, Array]:
    """The surface and the local bounds at its vertices; with more vertices where contacts lie anywhere and facets are large."""
    if bounds.slabs is None and bounds.confidence and len(surface.faces) < _COARSE:
        fine = surface.subdivide_to_size(float(np.linalg.norm(surface.extents)) / _SUBDIVIDED, max_iter=100)
        return fine, certificate(bounds, fine).at_vertices
    return surface, certified.at_vertices


def coverage(cloud: Cloud, bounds: Enclosure, surface: Any, certified: Certificate) -> dict[str, Any]:
    """How much of the body the contacts cover.

    `surface` is the fraction of the surface's area where the certified bound is at most 0.1 % of the diagonal, or 0.5 % for
    contacts of the spatial model, as `surface_within` says.  `normals` is the fraction of the sphere of directions that lies
    within 5° of a contact's normal.
    """
    surface, bound = _local_bounds(bounds, surface, certified)
    diagonal = float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    area = np.asarray(surface.area_faces)
    within = (_COVERED_ANYWHERE if cloud.model == "spatial" else _COVERED_BOUND) * diagonal
    closed = bound[surface.faces].max(axis=1) <= within
    covered = {"surface": float(area[closed].sum() / area.sum()), "surface_within": within}
    known = cloud.normals[np.isfinite(cloud.normals[:, 0])]
    if not len(known):
        return {**covered, "normals": 0.0}
    sphere = sphere_directions(_DIRECTIONS).T
    return {
        **covered,
        "normals": float(np.mean(cKDTree(known).query(sphere)[0] < 2 * np.sin(np.radians(_COVERED_DEG / 2)))),
    }
