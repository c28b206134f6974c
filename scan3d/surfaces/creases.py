"""Edges of bodies, between the contacts on either side of them.

The faces of tetrahedra between contacts zigzag across an edge of the body, and along a bent surface.  Edges between them are
exchanged for the other diagonals where the surface is bent less by these (Dyn, Hormann, Kim and Levin, 2001).

A surface whose vertices are contacts cuts off what lies between the last contacts before an edge and the first ones behind it.
Contacts have planes: that of a vertex is fitted to its neighbours or, near an edge, is that of a neighbour whose own neighbours
are all on the vertex's side of it, which is the one that fits best (as in the filter of Kuwahara, 1976).  Where the planes at
both ends of an edge of the surface differ much, the edge gets a vertex on the line in which they meet (Attene, Falcidieno,
Rossignac and Spagnuolo, 2003).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array, eye_array

from scan3d.arrays import NEGLIGIBLE, Array, Index, Mask, unit_or_zero
from scan3d.geometry.triangles import dot, linked, opposite_edges, spanned
from scan3d.surfaces.tetrahedra import Edges, divided

# Cosines of the angles between planes that meet in an edge: at smaller ones a smooth body may be bent, and at larger ones the
# line in which they meet is far away.
_BENT, _FOLDED = np.cos(np.radians([40.0, 120.0]))
# Planes of an edge of the body are nearer to their vertices than this part of what those of a smooth one would be.
_OFF = 0.5
# The share of edges across a crease whose planes are that near, at least, and their number: on smooth bodies few are so.
_SURE, _LEAST = 0.6, 8
# Radians by which a surface is bent less that count as nothing, and the area of a face in those of its neighbours that is too
# small to be made.
_UNBENT, _SLIVER = 1e-6, 0.05
# Cosine of the angle between neighbouring faces of which one is turned over, and areas that are none, in squares of the
# distance of contacts.
_TURNED, _FLAT = np.cos(np.radians(170.0)), 1e-3


def creased(vertices: Array, faces: Index) -> tuple[Array, Index]:
    """Vertices (n, 3) and faces (f, 3) of a closed surface through contacts, with further vertices on the edges of the body."""
    edges = Edges.of(faces)
    normals, off, own = _planes(vertices, faces, edges)
    a, b = vertices[edges.start], vertices[edges.end]
    one, other = normals[edges.start], normals[edges.end]
    bend = dot(one, other)
    middle = (a + b) / 2
    # from the middle along both normals to the line in which the planes meet
    rise, fall = dot(one, a - middle), dot(other, b - middle)
    sine = np.maximum(1 - bend**2, NEGLIGIBLE)
    place = middle + ((rise - bend * fall) / sine)[:, None] * one + ((fall - bend * rise) / sine)[:, None] * other
    bent = (bend < _BENT) & (bend > _FOLDED)
    sure = bent & (np.maximum(off[edges.start], off[edges.end]) <= _OFF * np.minimum(own[edges.start], own[edges.end]))
    # edges with a face between them cross the same crease
    start, end = (edges.number[:, k].ravel() for k in ([0, 1, 2], [1, 2, 0]))
    both = bent[start] & bent[end]
    _, part = linked(start[both], end[both], len(bent))
    count, sures = np.bincount(part, bent), np.bincount(part, sure)
    split = bent & (sures >= np.maximum(_SURE * count, _LEAST))[part]
    least = _FLAT * float(np.median(np.linalg.norm(b - a, axis=1))) ** 2
    while True:
        # faces that would be turned over, or have no area, stay as they are
        new = np.concatenate([vertices, place[split]])
        parts = divided(faces, edges, split, len(vertices))
        old, made = parts < len(vertices), parts >= len(vertices)
        across = spanned(new[parts])
        out = unit_or_zero(across)
        beside = opposite_edges(parts)
        assert beside is not None, "every edge belongs to two faces"
        turned = (old & (dot(out[:, None], normals[np.where(old, parts, 0)]) < NEGLIGIBLE)).any(axis=1)
        turned |= (dot(out[:, None], out[beside // 3]) < _TURNED).any(axis=1) | (np.linalg.norm(across, axis=1) < least)
        turned &= made.any(axis=1)
        if not turned.any():
            return new, parts
        split[np.flatnonzero(split)[parts[turned][made[turned]] - len(vertices)]] = False


def least_bent(vertices: Array, faces: Index) -> Index:
    """Faces (f, 3) of a closed surface, with diagonals exchanged until no other lessens the sum over all edges of their lengths
    times the angles between their faces."""
    faces, active = faces.astype(np.int64), np.ones(len(faces), dtype=bool)
    while active.any():
        found = _better(vertices, faces, active)
        a, b, c, d = found.corners
        # together those that have no face in common with a better one; equal ones in the order of their vertices
        rank = np.empty(len(a), dtype=np.int64)
        rank[np.lexsort((b, a, np.round(found.gain / found.gain.max(initial=1e-300), 9)))] = np.arange(len(a))
        best = np.full(len(faces), -1)
        np.maximum.at(best, found.faces.ravel(), np.tile(rank, len(found.faces)))
        alone = np.flatnonzero((best[found.faces] == rank).all(axis=0))
        new = np.unique(np.minimum(c, d)[alone] * len(vertices) + np.maximum(c, d)[alone], return_index=True)[1]
        chosen = alone[new]  # no edge twice
        active[:] = False
        active[np.delete(found.faces, chosen, axis=1)[:2]] = True
        active[found.faces[:, chosen]] = True
        a, b, c, d, left, right = (column[chosen] for column in (a, b, c, d, *found.faces[:2]))
        faces[left], faces[right] = np.stack([c, a, d], axis=1), np.stack([d, b, c], axis=1)
    return faces


class _Diagonals(NamedTuple):
    """Edges (n,) of which the other diagonal of the faces beside them is better."""

    corners: Index
    """(4, n) the edge's beginning and end, and the third corners of the faces on its left and right."""
    faces: Index
    """(6, n) on its left and right, and beyond their other edges."""
    gain: Array
    """(n,) by which lengths times angles become less."""


def _better(vertices: Array, faces: Index, active: Mask) -> _Diagonals:
    """The edges beside active faces (f,) that are to be exchanged."""
    beside = opposite_edges(faces)
    assert beside is not None, "every edge belongs to two faces"
    across = beside.ravel()
    edge = np.flatnonzero(np.arange(len(across)) < across)
    edge = edge[active[edge // 3] | active[across[edge] // 3]]
    (left, j), (right, k) = np.divmod(edge, 3), np.divmod(across[edge], 3)
    a, b, c, d = corners = np.stack([faces[left, j], faces[right, k], faces[left, j - 1], faces[right, k - 1]])
    beyond = np.stack([beside[left, j - 2], beside[left, j - 1], beside[right, k - 2], beside[right, k - 1]]) // 3
    size = spanned(vertices[faces])
    normals = unit_or_zero(size)
    made = [spanned(vertices[np.stack(three, axis=1)]) for three in ((d, b, c), (c, a, d))]
    first, second = (unit_or_zero(each) for each in made)

    def bent(start: Index, end: Index, one: Array, other: Array) -> Array:
        angle = np.arctan2(np.linalg.norm(np.cross(one, other), axis=1), dot(one, other))
        return np.asarray(np.linalg.norm(vertices[end] - vertices[start], axis=1) * angle)

    gain = bent(a, b, normals[left], normals[right]) - bent(c, d, first, second)
    sides = (b, c, left, first), (c, a, left, second), (a, d, right, second), (d, b, right, first)
    for (start, end, face, after), other in zip(sides, normals[beyond], strict=True):
        gain += bent(start, end, normals[face], other) - bent(start, end, after, other)
    better = gain > _UNBENT * np.linalg.norm(vertices[b] - vertices[a], axis=1)
    least = _SLIVER * np.minimum(*(np.linalg.norm(size[face], axis=1) for face in (left, right)))
    for each in made:
        better &= (dot(each, size[left] + size[right]) > 0) & (np.linalg.norm(each, axis=1) > least)
    rows = np.flatnonzero(better)
    # a diagonal that is an edge already would belong to four faces
    edges = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1), axis=-1) @ [len(vertices), 1]
    rows = rows[~np.isin(np.minimum(c, d)[rows] * len(vertices) + np.maximum(c, d)[rows], edges)]
    return _Diagonals(corners[:, rows], np.stack([left, right, *beyond])[:, rows], gain[rows])


def _planes(vertices: Array, faces: Index, edges: Edges) -> tuple[Array, Array, Array]:
    """Normals (n, 3), outward, of planes at vertices (n, 3), how far (n,) they are from these and from the neighbours that they
    are fitted to, and how far (n,) planes would be that are fitted to a vertex's own neighbours."""
    n = len(vertices)
    ones = np.ones(len(edges.start), dtype=np.float64)
    beside = coo_array((ones, (edges.start, edges.end)), shape=(n, n)).tocsr()
    beside = beside + beside.T + eye_array(n, format="csr")
    count = beside.sum(axis=1)[:, None]
    middle = beside @ vertices / count
    # moments about each vertex, which lose no digits
    row = np.repeat(np.arange(n), np.diff(beside.indptr))
    offset = vertices[beside.indices] - middle[row]
    moments = np.zeros((n, 3, 3))
    for i in range(3):
        for j in range(i, 3):
            moments[:, i, j] = moments[:, j, i] = np.bincount(row, offset[:, i] * offset[:, j], n)
    spread, axes = np.linalg.eigh(moments / count[..., None])
    outward = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(outward, faces[:, k], spanned(vertices[faces]))
    normals = axes[:, :, 0] * np.sign(dot(axes[:, :, 0], outward))[:, None]
    rough = np.sqrt(np.maximum(spread[:, 0], 0.0))
    # of the planes around each vertex the one that is nearest to it and to its own neighbours
    around = (beside @ beside).tocsr()
    row, column = np.repeat(np.arange(n), np.diff(around.indptr)), around.indices
    off = rough[column] + np.abs(dot(normals[column], vertices[row] - middle[column]))
    off = np.where(dot(normals[column], unit_or_zero(outward)[row]) > 0, off, np.inf)
    order = np.lexsort((column, np.round(off / off[np.isfinite(off)].max(initial=1e-300), 9), row))
    best = order[around.indptr[:-1]]
    return normals[column[best]], off[best], rough
