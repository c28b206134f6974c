"""The shells of a closed mesh, and the body that they enclose where they overlap, touch or lie in each other.

An assembly that is exported as one file has a shell for each of its parts, with walls inside the body, where no rod comes.  The
body is the union of the shells that are turned outwards; one that is turned inwards is a cavity of the smallest that holds it,
or, where none does, a part that is turned wrongly.  The union is that of Manifold (E. Lalish), whose result is a closed surface
whatever the rounding (J. Smith, Towards Robust Boolean Operations, 2009), and whose vertices are those of the shells, and those
where they cross.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from scan3d.arrays import NEGLIGIBLE, Array, Index, Mask, unit_or_zero
from scan3d.geometry.hulls import runs_both_ways, turns, was_judged
from scan3d.geometry.triangles import areas, distinct_rows, dot, linked, without_unused

# Directions about an edge are one within this part of a turn, as those of faces in a plane that are cut differently.
_TURN = 1e-9


def shells(points: Array, faces: Index) -> Index:
    """The number (m,) of the shell of each face (m, 3) of a closed mesh with points (n, 3), whose faces are turned alike.

    Faces are neighbours that have an edge alone.  Of several at an edge those are that have the body between them, unless they
    belong to shells that are closed there already.
    """
    start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    low, high, back = np.minimum(start, end), np.maximum(start, end), start > end
    order = np.lexsort((back, high, low))
    first = np.flatnonzero((np.diff(low[order], prepend=-1) != 0) | (np.diff(high[order], prepend=-1) != 0))
    count = np.diff(first, append=len(order))
    a, b = (order[first[count == 2] + k] // 3 for k in (0, 1))
    count_of_parts, label = linked(a, b, len(faces))
    parent = list(range(count_of_parts))

    def part(edge: int) -> int:
        number = int(label[edge // 3])
        while parent[number] != number:
            parent[number] = number = parent[parent[number]]
        return number

    for begin, number in zip(first[count > 2].tolist(), count[count > 2].tolist(), strict=True):
        edges = order[begin : begin + number]
        open_: dict[int, int] = {}
        for edge in edges.tolist():
            open_[part(edge)] = open_.get(part(edge), 0) + (1 if back[edge] else -1)
        left = np.array([edge for edge in edges.tolist() if open_[part(edge)]], dtype=np.int64)
        for one, other in _around(points, faces, left, back) if len(left) else ():
            parent[part(one)] = part(other)
    numbers = np.array([part(3 * int(face)) for face in np.unique(label, return_index=True)[1]], dtype=np.int64)
    return np.asarray(np.unique(numbers, return_inverse=True)[1][label])


def _around(points: Array, faces: Index, edges: Index, back: Mask) -> list[tuple[int, int]]:
    """The pairs of directed edges (2k,) at one place, between whose faces the body lies."""
    face, corner = np.divmod(edges, 3)
    ends = points[faces[face[0], [corner[0], (corner[0] + 1) % 3]]]
    along = unit_or_zero((ends[1:] - ends[:1]) * (-1 if back[edges[0]] else 1))[0]
    aside = points[faces[face, (corner + 2) % 3]] - ends[0]
    aside -= (aside @ along)[:, None] * along
    x = unit_or_zero(aside[:1])[0]
    turn = np.arctan2(aside @ np.cross(along, x), aside @ x) / (2 * np.pi) % 1
    order = np.argsort(turn)
    place = np.empty(len(edges), dtype=np.int64)
    place[order] = np.cumsum(np.diff(turn[order], prepend=turn[order[0]]) > _TURN)
    if turn.min() + 1 - turn.max() <= _TURN:
        place[place == place.max()] = 0
    # seen along the edge, the body begins behind a face that runs back, and ends at one that runs forth
    order = np.lexsort((edges, back[edges], place))
    begun: list[tuple[int, list[int]]] = []
    pairs: dict[int, int] = {}
    for again in (False, True):
        for edge, where in zip(edges[order].tolist(), place[order].tolist(), strict=True):
            if back[edge] and not again:
                if not begun or begun[-1][0] != where:
                    begun.append((where, []))
                begun[-1][1].append(edge)
            elif not back[edge] and begun and edge not in pairs:
                pairs[edge] = begun[-1][1].pop(0)  # of copies of a shell the first belongs to the first
                if not begun[-1][1]:
                    begun.pop()
    return list(pairs.items())


def cavities(points: Array, faces: Index) -> Mask:
    """Which faces (m,) of a closed mesh, whose faces are turned outwards, bound closed cavities; none of an open one."""
    if not runs_both_ways(faces):
        return np.zeros(len(faces), dtype=bool)
    label = shells(points, faces)
    volumes = np.bincount(label, _volumes(points[faces]))
    return np.asarray((volumes < -NEGLIGIBLE * volumes.max(initial=0.0))[label])


def whole_body(mesh: Any) -> Any:
    """A `trimesh.Trimesh` without walls inside it: the union of its shells, or the mesh as it is."""
    if "geometry_sha256" in mesh.metadata and was_judged(mesh):  # as it was read
        return mesh
    first, number = distinct_rows(mesh.vertices.view(np.ndarray))
    union = united(mesh.vertices.view(np.ndarray)[first], number[mesh.faces.view(np.ndarray)])
    return mesh if union is None else type(mesh)(*union, process=False)


def united(points: Array, faces: Index) -> tuple[Array, Index] | None:
    """Points and faces of the union of the shells of a closed mesh; None where that is the mesh as it is, or has no union."""
    if not runs_both_ways(faces):
        return None
    label = shells(points, faces)
    count = int(label.max(initial=0)) + 1
    if count == 1:
        return None
    # by a power of two, which rounds nothing
    scale = 2.0 ** -np.ceil(np.log2(np.ptp(points, axis=0).max()))
    corners = scale * points[faces]
    volumes = np.bincount(label, _volumes(corners), count)
    boxes = _boxes(corners, label, count)
    solid = np.abs(volumes) > NEGLIGIBLE * np.prod(boxes[:, 1] - boxes[:, 0], axis=1)  # sheets enclose nothing
    owner = np.where(solid, np.arange(count), -1)
    turned = np.zeros(count, dtype=bool)
    outwards = [k for k in np.argsort(volumes) if solid[k] and volumes[k] > 0]
    for cavity in np.flatnonzero(solid & (volumes < 0)):
        place = corners[np.argmax(label == cavity)].mean(axis=0)
        low, high = boxes[cavity]
        around = (k for k in outwards if (boxes[k, 0] <= low).all() and (high <= boxes[k, 1]).all())
        holder = next((k for k in around if turns(corners[label == k] - place) > 0.5), None)
        turned[cavity], owner[cavity] = holder is None, cavity if holder is None else holder
    numbers, outward = np.unique(owner[owner >= 0]), np.where(turned[label][:, None], faces[:, ::-1], faces)
    if not _any_meet(boxes[numbers]):
        return (points, outward) if turned.any() else None
    return _union(scale, points, outward, owner[label], numbers)


def _union(scale: float, points: Array, faces: Index, owner: Index, numbers: Index) -> tuple[Array, Index] | None:
    """`united` of parts by their numbers (k,), to which the faces (m, 3) belong by `owner` (m,)."""
    from manifold3d import Error, Manifold, Mesh64, OpType

    parts = []
    for number in numbers:
        used, own = without_unused(faces[owner == number])
        parts.append(Manifold(Mesh64(scale * points[used], own.astype(np.uint64))))
    union = Manifold.batch_boolean(parts, OpType.Add)
    if union.status() != Error.NoError or any(part.status() != Error.NoError for part in parts):
        return None
    before = sum(part.volume() for part in parts), float(areas(scale * points[faces[owner >= 0]]).sum())
    if np.abs(np.array([union.volume(), union.surface_area()]) / before - 1).max() < NEGLIGIBLE:
        return None
    mesh = union.to_mesh64()
    return np.array(mesh.vert_properties, dtype=np.float64)[:, :3] / scale, np.array(mesh.tri_verts, dtype=np.int64)


def _volumes(corners: Array) -> Array:
    """Volumes (m,) between triangles (m, 3, 3) and a point in their middle."""
    a, b, c = (corners - corners.reshape(-1, 3).mean(axis=0)).transpose(1, 0, 2)
    return dot(a, np.cross(b, c)) / 6


def _boxes(corners: Array, label: Index, count: int) -> Array:
    """The boxes (k, 2, 3) of so many shells."""
    boxes = np.empty((count, 2, 3))
    boxes[:, 0], boxes[:, 1] = np.inf, -np.inf
    np.minimum.at(boxes[:, 0], label, corners.min(axis=1))
    np.maximum.at(boxes[:, 1], label, corners.max(axis=1))
    return boxes


def _any_meet(boxes: Array) -> bool:
    """Whether two of the boxes (k, 2, 3) have a point in common."""
    boxes = boxes[np.argsort(boxes[:, 0, 0])]
    last = np.searchsorted(boxes[:, 0, 0], boxes[:, 1, 0], side="right")
    return any(
        ((boxes[k, 0] <= boxes[k + 1 : end, 1]) & (boxes[k + 1 : end, 0] <= boxes[k, 1])).all(axis=1).any()
        for k, end in enumerate(last)
    )
