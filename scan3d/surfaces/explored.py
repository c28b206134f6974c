"""The surface of a body of any shape from a recording of sweeps and probings: the minimum cut, and how well it is known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from scan3d.bounds.free_space import contradicted, outer_contours, passed_lines, sheets_of
from scan3d.cloud import Cloud, NormalSource
from scan3d.geometry.crossings import first_crossings
from scan3d.geometry.distance import Search
from scan3d.geometry.triangles import face_normals
from scan3d.poses import AWAY
from scan3d.reconstruction.contacts import into_body, with_rows
from scan3d.recording import Recording, of_rows
from scan3d.spatial.bodies import sphere_directions
from scan3d.surfaces.carved import Carved, coverage_of
from scan3d.surfaces.cut import TOUCHED, cut_surface
from scan3d.units import length

# Directions from which a place is looked at.
_LOOKED_FROM = 96


def explored(recording: Recording, cloud: Cloud) -> Carved:
    """The surface through all contacts of a recording, that nothing which its rods have passed lies in.

    Raises InputError for contacts that span no body.
    """
    found = cut_surface(cloud.points, into_body(recording, cloud), passed_lines(recording, cloud))
    size = float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    found.surface.units = cloud.unit
    coverage = coverage_of(found.surface, found.surface.vertex_attributes["known"])
    patches = coverage["unknown"]
    if patches:
        for patch, reason in zip(patches, _reasons(found.surface, patches, cloud, size), strict=True):
            patch["reason"] = reason
    return Carved(found.surface, _contours_bound(recording, cloud), TOUCHED * size, coverage)


def _contours_bound(recording: Recording, cloud: Cloud) -> float:
    """That of the outer contours in the planes in which the rod was swept; infinite if there are none."""
    number, swept = np.flatnonzero(~recording.in_probings), cloud.swept()
    if not len(swept):
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
    return [
        "the body stands on the table there"
        if stands
        else f"no straight line from {from_where} leads there"
        if not free
        else f"deeper than the rod reaches: {length(deep, cloud.unit)} behind the hull"
        if far
        else "a straight rod reaches it; more planes would touch it"
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
