"""The certificate of a surface: how far it can be from the body that an enclosure bounds (`scan3d.bounds.enclosures`), and what
that assumes.

The distance to a convex surface is a convex function, and so it is largest over the outer body at one of its corners.  By the
triangle inequality a corner is no farther from the surface than from the inner body, and from there to the surface.

Local bounds.  A point x of the body lies no farther from its surface than ``h(u) - <u, x>`` for every direction u, where h is
at most the support function of the outer body.  Within a slab the same holds with the slab's own corners, and with directions u
in the slices' planes: the way from x along u leaves the body inside the slab.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial import ConvexHull, QhullError, cKDTree

from scan3d.arrays import AT_ONCE, NEGLIGIBLE, ROUNDING, Array, Index, highest
from scan3d.bounds.constraints import allowed
from scan3d.bounds.enclosures import Enclosure, SlabCorners
from scan3d.cloud import Cloud
from scan3d.comparison import compare
from scan3d.geometry.distance import nearest
from scan3d.geometry.hulls import distance_to_hull, hull_about_mean, support_of
from scan3d.geometry.triangles import spanned
from scan3d.reconstruction.errors import noise_in_air
from scan3d.recording import Recording
from scan3d.rods import Rod
from scan3d.units import angle, length, number, share


class Certificate(NamedTuple):
    """How far a surface can be from the true body, from touch alone, in the cloud's unit."""

    bound: float
    """Upper bound of the Hausdorff distance between the surface and the true body; infinite if nothing bounds it."""
    at_vertices: Array
    """(v,) local bound at the surface's vertices: the largest possible distance of the true surface from each of them."""
    of: str = "body"
    """What was touched; the convex hull of a mesh that is not convex, where that was scanned in its place."""

    def relative(self, points: Array) -> float:
        """The bound in diagonals of the bounding box of contacts (n, 3)."""
        return self.bound / float(np.linalg.norm(np.ptp(points, axis=0))) if self.bound < np.inf else np.inf

    def __repr__(self) -> str:
        known = self.at_vertices[np.isfinite(self.at_vertices)]
        local = f"{known.min():.4g} to {known.max():.4g}" if len(known) else "unknown"
        of = "" if self.of == "body" else f" of the {self.of}"
        return (
            f"Certificate(bound={self.bound:.6g}{of}, at_vertices: {local} at {len(known)} of {len(self.at_vertices)})"
        )


def certificate(bounds: Enclosure, surface: Any, *, convex: bool = False) -> Certificate:
    """The certificate of a surface, a `trimesh.Trimesh` in the cloud's unit, by an enclosure of the body.

    Whether the surface is convex is judged by its shape, unless it is known to be, as a hull made by Qhull is.  A convex
    surface is certified by the distances of the outer body's corners from it, and of its vertices from the inner body.  A
    surface that is open or not convex is compared with the inner body, and the bound of the inner body is added to the
    distance.
    """
    vertices = np.asarray(surface.vertices).reshape(-1, 3)
    if not bounds.confidence:
        return Certificate(np.inf, np.full(len(vertices), np.inf))
    diagonal = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    deviation = ROUNDING * diagonal if convex else distance_to_hull(surface)
    if deviation > NEGLIGIBLE * diagonal:
        local = np.abs(nearest(vertices, bounds.inner)[0])
        return Certificate(compare(surface, bounds.inner).upper + bounds.bound, local + bounds.bound)
    bound, local = _of_convex(bounds, surface)
    return Certificate(bound + deviation, local + deviation)


def _of_convex(bounds: Enclosure, surface: Any) -> tuple[float, Array]:
    """The bound of a convex surface, and the local bound (v,) at its vertices."""
    vertices = surface.vertices.view(np.ndarray)
    outwards = np.maximum(bounds.sticking_out(vertices), 0.0)
    bound = np.inf
    extreme, support = _extreme(bounds.corners)
    if bounds.closed and np.isfinite(bounds.gap).all():
        farthest = float(nearest(extreme, surface)[0].max())
        bound = max(float(outwards.max()), farthest + bounds.reach)
    local = np.minimum(np.maximum(outwards, _depths(bounds, surface, support)), bound)
    if bounds.tighter is not None:
        other, other_local = _of_convex(bounds.tighter, surface)
        bound, local = min(bound, other), np.minimum(local, other_local)
    return bound, local


def _depths(bounds: Enclosure, surface: Any, support: Callable[[Array], Array]) -> Array:
    """Upper bounds (v,) of the distances of a convex surface's vertices in the body from the body's surface.

    support
        the support function of the outer body's corners.

    Of the directions of the faces' normals at a vertex that with the largest bound counts, so that the bound is wide where the
    body may reach far beyond one of the faces.  Where a slab is unbounded, they are the vertices' normals, projected into the
    slices' planes, and the bound of the slab's vertices is infinite.
    """
    vertices: Array = surface.vertices.view(np.ndarray)
    faces: Index = surface.faces
    corner = vertices[faces]
    normals = spanned(corner)
    if bounds.slabs is not None and not bounds.closed:
        of_vertices = np.zeros_like(vertices)
        np.add.at(of_vertices, faces.ravel(), np.repeat(normals, 3, axis=0))
        depths = _within_slabs(bounds.corners, bounds.slabs, vertices, of_vertices)
    elif len(bounds.corners):
        size = np.linalg.norm(normals, axis=1)
        known = np.flatnonzero(size > 0)
        outward = normals[known] / size[known, None]
        depth = support(outward) - (outward * corner[known, 0]).sum(axis=1)
        depths = np.full(len(vertices), -np.inf)
        np.maximum.at(depths, faces[known].ravel(), np.repeat(np.maximum(depth, 0.0), 3))
        depths[np.isneginf(depths)] = np.inf
    else:
        depths = np.full(len(vertices), np.inf)
    if bounds.directions is not None and bounds.directions.open.any():
        places, is_open = bounds.directions
        blocks = np.array_split(normals, 1 + len(normals) * len(places) // AT_ONCE)
        farthest = np.concatenate([(block @ places.T).argmax(axis=1) for block in blocks])
        depths[faces[is_open[farthest]]] = np.inf
    return np.maximum(depths + bounds.reach, 0.0)


def _extreme(points: Array) -> tuple[Array, Callable[[Array], Array]]:
    """Those of the points (n, 3) that are vertices of their hull, and its support function.

    All where Qhull finds none, and where some are infinite.
    """
    found = hull_about_mean(points) if np.isfinite(points).all() else None
    if found is None:
        return points, partial(highest, points)
    middle, support = points.mean(axis=0), support_of(found)
    return points[found.vertices], lambda directions: support(directions) + directions @ middle


def _within_slabs(corners: Array, slabs: SlabCorners, vertices: Array, normals: Array) -> Array:
    """The bounds (v,) by each vertex' own slab and the direction of its normal (v, 3) in the slices' planes."""
    frame, levels = slabs.stack.frame, np.array([-np.inf, *slabs.stack.heights, np.inf])
    heights = vertices @ frame[2]
    rounding = ROUNDING * float(np.abs(heights).max())
    level = normals - (normals @ frame[2])[:, None] * frame[2]
    size = np.linalg.norm(level, axis=1)
    level = np.where(size[:, None] > 0, level / np.where(size > 0, size, 1.0)[:, None], frame[0])
    found, is_open = np.full(len(vertices), np.inf), np.zeros(len(vertices), dtype=bool)
    for k in np.unique(slabs.number):
        of_slab = corners[slabs.number == k]
        rows = (heights >= levels[k] - rounding) & (heights <= levels[k + 1] + rounding)
        if np.isfinite(of_slab).all():
            depth = highest(of_slab, level[rows]) - (level[rows] * vertices[rows]).sum(axis=1)
            found[rows] = np.minimum(found[rows], np.maximum(depth, 0.0))
        else:
            is_open |= rows
    return np.where(is_open, np.inf, found)


class Premise(NamedTuple):
    """What is assumed, whether these data could test it, and how it came out, as parts of a sentence."""

    assumed: str
    tested: bool
    outcome: str


def premises(recording: Recording | None, cloud: Cloud, contradicted: Collection[str]) -> tuple[Premise, ...]:
    """What the bounds of a cloud's body rest on; `contradicted` are the codes of what the recording contradicts."""
    if recording is None:
        return _of_touches(cloud, contradicted)
    hidden = "not tested: what neither friction nor path nor other sweeps contradict stays hidden"
    outcome = "contradicted" if {"inside-hull", "beyond-tangent"} & {*contradicted} else "not contradicted"
    outcome = outcome if contradicted else "no contact lies inside those of a convex body"
    return (
        Premise("a convex body", True, outcome)
        if cloud.convex
        else Premise("no contact is that of a rod with a second one that stayed hidden", False, hidden),
        _of_rod(recording.rod, cloud, contradicted),
        _of_noise(recording, cloud),
        *(
            []
            if recording.completed is None
            else [Premise(recording.completed.words, False, "not tested: it was stated")]
        ),
    )


def _of_touches(cloud: Cloud, contradicted: Collection[str]) -> tuple[Premise, ...]:
    """Those of touches of another probe."""
    if not cloud.convex:
        return (Premise("the surface runs through all touches", False, "not tested"),)
    places, normals = (
        f"noise of the {name} of the stated size" if sd is not None and sd.any() else f"{name} without error"
        for name, sd in (("places", cloud.place_sd), ("normals", cloud.normal_sd))
    )
    outcome = (
        "some touches lie beyond planes of others" if contradicted else "no touch lies beyond the plane of another one"
    )
    found = (
        Premise("a convex body", True, "no touch lies inside the hull of the others"),
        Premise(places, False, "not tested"),
        Premise(normals, True, outcome),
    )
    return found if np.isfinite(cloud.normals).any() else found[:2]


def _of_noise(recording: Recording, cloud: Cloud) -> Premise:
    """That on the noise: rows in the air have no values that are too large for it."""
    noise, left = recording.noise, cloud.left_out
    if not max(noise.force_N, noise.moment_Nm, noise.pose_m):
        assumed = "reactions without noise"
    else:
        kind = "white noise" if cloud.independent else "noise, alike in successive rows or not,"
        if left is None:
            assumed = f"{kind} of the stated size" + (", without wild rows" if cloud.model == "spatial" else "")
        else:
            assumed = f"{kind} of at most {number(left.factor)} times the stated size, but for single wild rows"
    air = noise_in_air(recording)
    if not air.rows:
        return Premise(assumed, False, "not tested: of the noise the contacts tell nothing that the body could not")
    if air.size is None:
        return Premise(
            assumed, True, f"no value of {air.rows} rows in the air is larger than the stated noise explains"
        )
    reached = f"a value of {air.rows} rows in the air is one that noise of the stated size reaches"
    return Premise(assumed, True, f"{reached} in {share(air.chance, up=True)} of such recordings at most")


def _of_rod(rod: Rod, cloud: Cloud, contradicted: Collection[str]) -> Premise:
    """That on the rod and the sensor: sweeps over the same place agree, and so do six reactions."""
    known = "a straight, uniform, weightless rod in a rigid clamp" if rod.is_simple else "the stated rod and clamp"
    part = float(_same_place(cloud.fattened or cloud).mean()) if len(cloud) else 0.0
    six_axes = "force and moment are those of a single force" if cloud.model == "spatial" else ""
    if contradicted:
        outcome = "contradicted"
    elif relative := 0.0 if cloud.calibration is None else cloud.calibration.relative:
        outcome = (
            f"sweeps over the same place differ by {share(relative)} of the wrench: bounds allow for that, and no more"
        )
    elif part:
        agree = f"sweeps agree at the places that several of them touched, {share(part)} of the contacts"
        outcome = f"{agree}; {six_axes}" if six_axes else agree
    else:
        outcome = six_axes or "not tested: no two sweeps touched the same place"
    return Premise(f"{known}, and a sensor that is right", bool(part or six_axes), outcome)


def _same_place(cloud: Cloud) -> Array:
    """(n,) whether each contact lies as near to one of another sweep as to the next ones of its own, in its slice."""
    size = float(np.linalg.norm(np.ptp(cloud.points, axis=0)))
    places = np.column_stack([cloud.points, 2 * size * cloud.slice])
    # rods that turn about a corner touch one place, of which rounding must make no neighbours
    order = np.lexsort((cloud.row, cloud.sweep))
    step = np.linalg.norm(np.diff(places[order], axis=0), axis=1)
    new = np.append(True, (step > NEGLIGIBLE * size) | (np.diff(cloud.sweep[order]) != 0))
    first, one = order[new], np.empty(len(order), dtype=np.intp)
    one[order] = np.cumsum(new) - 1
    distance, near = cKDTree(places[first]).query(places[first], k=range(2, 7))
    known = near < len(first)
    own = known & (cloud.sweep[first][np.where(known, near, 0)] == cloud.sweep[first][:, None])
    next_ones = np.where(own & (np.cumsum(own, axis=1) == 2), distance, np.inf).min(axis=1)
    as_near = distance <= next_ones[:, None] + NEGLIGIBLE * size
    return np.asarray((known & ~own & as_near).any(axis=1)[one])


def missing(cloud: Cloud) -> str:
    """Why contacts anywhere do not bound the body, as a sentence without its full stop; "" for contacts in slices.

    A convex body is bounded by planes that touch it only if their normals lie on all sides of the origin.  Where those of the
    contacts do, the errors of single contacts leave the planes too uncertain.
    """
    if cloud.in_slices:
        return ""
    normals = cloud.normals[np.isfinite(cloud.normals).all(axis=1)]
    if cloud.model == "touches" and not len(normals):
        return "places alone do not bound a body from outside: normals of the touches would"
    if cloud.table is not None:
        normals = np.vstack([normals, [0.0, 0.0, -1.0]])
    side = _open_side(normals)
    if side is not None:
        return _on_side(side, cloud)
    if cloud.model == "touches":
        return "the planes of the touches are too uncertain, or too few, to meet around the body"
    if cloud.place_sd is None or cloud.tangent_sd is None or (kappa := allowed(cloud).kappa) is None:
        return "the contacts are too few or too far apart for their tangent planes to meet: sweeps between them would close it"
    place, turn = (
        kappa * float(np.median(sd)) for sd in (cloud.place_sd, cloud.tangent_sd[np.isfinite(cloud.tangent_sd)])
    )
    return (
        f"contacts face all sides, but noise may move half of them by more than {length(place, cloud.unit)}, and turn "
        f"the rod there by more than {angle(float(np.degrees(turn)))}, so that the directions of the planes that touch "
        "the body there are open: less noise would bound it"
    )


def _open_side(normals: Array) -> Array | None:
    """A direction that no normal (n, 3) has a part in; None if they lie on all sides of the origin."""
    if len(normals) < 4:
        return -normals.mean(axis=0) if len(normals) else np.array([0.0, 0.0, 1.0])
    try:
        facets = ConvexHull(normals).equations
    except QhullError:  # all in one plane
        return np.asarray(np.linalg.svd(normals - normals.mean(axis=0))[2][2])
    worst = facets[facets[:, 3].argmax()]
    return worst[:3] if worst[3] > -NEGLIGIBLE else None


def _on_side(side: Array, cloud: Cloud) -> str:
    """What would bound the body in a direction that no contact faces."""
    moves = "touches" if cloud.model == "touches" else "sweeps"
    x, y, z = side / max(float(np.linalg.norm(side)), NEGLIGIBLE)
    if abs(z) < np.cos(np.pi / 8):  # neither down nor up
        return f"no contact bounds the body towards ({x + 0.0:.2f}, {y + 0.0:.2f}, {z + 0.0:.2f}): {moves} from that side would"
    heights = cloud.points[:, 2]
    end = float(heights.min() if z < 0 else heights.max())
    where, table = ("below", ", or the height of the table that it stands on,") if z < 0 else ("above", "")
    return f"no contact bounds the body {where} z = {length(end, cloud.unit)}: {moves} from {where}{table} would"
