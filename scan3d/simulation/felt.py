"""What a rod feels along given paths of its clamp, and the plane contours that its centre line touches.

The surface of a convex polyhedron fattened by a ball of radius a consists of its faces moved outwards by a, of parts of
cylinders about its edges, and of parts of spheres about its vertices.  A plane cuts the cylinders in arcs of ellipses and the
spheres in arcs of circles.  With the angle φ of the normal n(φ) about an edge, the arc is

    e + τ(φ) d + a n(φ),        τ(φ) = (z - <e, k> - a <n(φ), k>) / <d, k>,        0 <= τ <= length of the edge,

with the edge's end e and direction d, and the plane's height z along k; it ends where τ does, and there begins an arc about a
vertex.  The contours returned are polygons with all their vertices on such arcs, and on the lines between them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

import planar
from scan3d.arrays import NEGLIGIBLE, ROUNDING, Array, Index, Mask, ranges
from scan3d.errors import InputError
from scan3d.geometry.distance import segments_meet
from scan3d.geometry.hulls import is_convex
from scan3d.geometry.sections import convex_polygon, extent_along, slice_outlines, slice_polygons
from scan3d.planning.plan import Plan
from scan3d.recording import Recording, reaction_columns
from scan3d.rods import Rod
from scan3d.spatial.bodies import RoundedPolyhedron
from scan3d.spatial.equilibrium import wrench
from scan3d.spatial.sweeping import End, sweep
from scan3d.units import UNITS_M

if TYPE_CHECKING:
    import trimesh


class Track(NamedTuple):
    """Places (n) of a clamp in one sweep, in the mesh's unit."""

    number: int
    position: Array
    """(n, 3)"""
    axes: Array
    """(n, 3, 3) as rows."""
    friction: Array
    """(n,)"""


class Reactions(NamedTuple):
    """Reactions along one sweep in the clamp's frame, in units of the rod; zero without contact."""

    force: Array
    """(n, 3)"""
    moment: Array
    """(n, 3)"""
    touches: Mask
    """(n,)"""
    known: Mask
    """(n,) rows in which an equilibrium was found: what is felt in others is not known."""


def felt(mesh: Any, tracks: list[Track], rod: Rod, metres: float, model: str) -> list[Reactions]:
    """The reactions of a rod that sweeps a `trimesh.Trimesh`, convex in space, whose unit is so many metres.

    The centre line of a thick rod touches the mesh fattened by the rod's radius, and the contact force acts on it there.

    Raises InputError for sweeps that begin in the body or in which the clamp turns, and in the planar model for clamps that do
    not move along -x of their frames.
    """
    length = rod.length_m / metres
    for track in tracks:
        _check_path(track, length, model)
    if model == "spatial":
        check_simple(rod)
        return _felt_in_space(mesh, tracks, length, rod.diameter_m / metres / 2)
    return _felt_in_planes(mesh, tracks, length, rod)


def check_simple(rod: Rod) -> None:
    """Raise InputError for rods of which no scan in space is simulated."""
    if not rod.is_simple:
        raise InputError(
            "scans in space are simulated with straight, uniform, weightless rods in rigid clamps; simulate this rod "
            "with the planar model"
        )


def drawn_friction(bounds: tuple[float, float], samples: int, key: Sequence[int]) -> Array:
    """(n,) coefficients of friction between two bounds, from the stream of random numbers that has a key.

    Each sweep has its own stream, so that its draws don't depend on the order of work.
    """
    low, high = bounds
    return np.random.default_rng(key).uniform(low, high, samples) if high > low else np.full(samples, low)


def rounded_body(mesh: Any, length: float, radius: float) -> tuple[RoundedPolyhedron, Array]:
    """The body that the centre line of a round rod touches, in lengths of the rod about the middle (3,) that is returned.

    So rounding does not depend on where the body lies.  A rod without thickness counts as one of a billionth of its length,
    whose contacts with vertices have regular equations.  Raises InputError for a body that the spatial model can't have.
    """
    vertices = np.asarray(mesh.vertices, dtype=float)
    middle = (vertices.max(axis=0) + vertices.min(axis=0)) / 2
    try:
        return RoundedPolyhedron((vertices - middle) / length, mesh.faces, max(radius / length, 1e-9)), middle
    except ValueError as error:
        raise InputError(f"this body can't be swept in space: {error}") from None


def recorded(
    plan: Plan,
    rod: Rod,
    axes: Array,
    number: Index,
    position: Array,
    wrench: Array,
    source: dict[str, Any],
    *part: int,
) -> Recording:
    """The recording of sweeps (m), as a rig would log it, with the noise of a plan, drawn anew for each numbered `part` of it.

    axes (m, 3, 3)
        of the clamps, as rows.
    number, position (n, 3), wrench (n, 3) or (n, 6)
        at each sample: number of the sweep, the clamp's place in the plan's unit, and reactions in units of the rod, two of the
        force and one of the moment or all, NaN without contact.
    """
    # scipy wants the clamp's axes as columns
    quaternion = Rotation.from_matrix(np.swapaxes(axes, 1, 2)).as_quat(scalar_first=True)
    wrench = np.nan_to_num(wrench)
    if plan.noise > 0:
        random = np.random.default_rng([plan.seed, 1, *part])
        wrench += plan.noise * np.hstack([*random.standard_normal((wrench.shape[1] // 3, len(wrench), 3))])
    forces = 3 if wrench.shape[1] == 6 else 2
    force, moment = wrench[:, :forces] * rod.force_unit_N, wrench[:, forces:] * rod.moment_unit_Nm
    return Recording(
        sweep=np.asarray(number, dtype=np.int64),
        position_m=position * UNITS_M[plan.unit],
        quaternion=quaternion[number],
        **reaction_columns(force, moment, forces == 3),
        rod=rod,
        noise_force_N=plan.noise * rod.force_unit_N,
        noise_moment_Nm=plan.noise * rod.moment_unit_Nm,
        unit=plan.unit,
        gravity=plan.gravity,
        source={"kind": "simulation", "seed": plan.seed, **source},
    )


def _felt_in_planes(mesh: Any, tracks: list[Track], length: float, thick: Rod) -> list[Reactions]:
    outlines = _outlines(mesh, tracks, length, length * thick.diameter_m / 2 / thick.length_m)
    lowest = [min((loop[:, 1].min() for loop in loops), default=np.inf) for loops in outlines]
    rod = thick.in_plane()
    reactions = []
    for first in range(0, len(tracks), 16):
        part = range(first, min(first + 16, len(tracks)))
        within = [k for k in part if lowest[k] <= 1]
        for k in within:
            if lowest[k] <= 0:
                raise InputError(_begins_in_body(tracks[k].number))
        travel = [(tracks[k].position - tracks[k].position[0]) @ tracks[k].axes[0, 0] / length for k in within]
        base = list(map(np.minimum.accumulate, travel))  # falling also where rounding would lift it
        contours = [contour_of(outlines[k]) for k in within]
        frictions = [tracks[k].friction for k in within]
        swept = planar.sweep_all(contours, frictions, base=base, rod=rod) if within else []
        results = dict(zip(within, swept, strict=True))
        for k in part:
            reactions.append(_in_plane(tracks[k], results.get(k)))
    return reactions


def _in_plane(track: Track, result: planar.Sweep | None) -> Reactions:
    n = len(track.position)
    force, moment = np.zeros((n, 3)), np.zeros((n, 3))
    if result is None:
        return Reactions(force, moment, np.zeros(n, dtype=bool), np.ones(n, dtype=bool))
    touches = result.phase != planar.Phase.NONE
    known = np.asarray(result.status != planar.SweepStatus.UNRESOLVED)
    if touches[0] or not known[0]:
        raise InputError(_begins_in_body(track.number))
    force[:, 0], force[:, 1] = np.nan_to_num(result.f0x), np.nan_to_num(result.f0y)
    moment[:, 2] = np.nan_to_num(result.m0z)
    return Reactions(force, moment, touches, known)


def _begins_in_body(number: int) -> str:
    return (
        f"the rod touches the body before sweep {number} begins: the body is larger than what the poses were planned "
        "for, or stands elsewhere; plan with a larger --around"
    )


def _check_path(track: Track, length: float, model: str) -> None:
    rounding = 1e-6  # of directions, and of places in rod lengths
    if np.abs(track.axes - track.axes[0]).max() > rounding:
        raise InputError(f"in a sweep the clamp does not turn, unlike in sweep {track.number}; cut it into several")
    travel = (track.position - track.position[0]) / length
    aside = np.abs(travel @ track.axes[0, 1:].T).max()
    backwards = np.diff(travel @ track.axes[0, 0]).max(initial=0.0)
    if model == "planar" and max(aside, backwards) > rounding:
        raise InputError(
            "in the planar model the clamp moves against the x axis of its frame, unlike in sweep "
            f"{track.number}; give --model spatial"
        )


def contour_of(loops: Sequence[Array]) -> planar.Contour:
    """The contour of loops (m, 2)."""
    parts = [planar.Polygon(loop) for loop in loops]
    return parts[0] if len(parts) == 1 else planar.Contours(parts)


def _outlines(mesh: Any, tracks: list[Track], length: float, radius: float) -> list[list[Array]]:
    """The loops (m, 2) of each sweep's slice in the frame of its clamp at the first place, in rod lengths."""
    outlines: list[list[Array]] = [[]] * len(tracks)
    frames = np.array([track.axes[0] for track in tracks])
    rows = np.round(frames, 12).reshape(len(tracks), -1)
    _, first, group = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    for k, row in enumerate(first):
        members = np.flatnonzero(group.reshape(-1) == k)
        start = np.array([tracks[i].position[0] @ frames[row].T for i in members])
        loops = sections(mesh, frames[row], start[:, 2], radius, length)
        for i, part, place in zip(members, loops, start, strict=True):
            outlines[i] = [(loop - place[:2]) / length for loop in part]
    return outlines


def _felt_in_space(mesh: Any, tracks: list[Track], length: float, radius: float) -> list[Reactions]:
    body, middle = rounded_body(mesh, length, radius)
    positions = [(track.position - middle) / length for track in tracks]
    places = [_places(position, position[:0, 0]) for position in positions]
    found: dict[int, _Swept] = {}
    again = list(range(len(tracks)))
    while again:  # once more with the rows where the contact changes much
        order = sorted(again, key=lambda k: len(places[k]))
        for first in range(0, len(order), 128):
            rows = order[first : first + 128]
            parts = _swept(body, [tracks[k] for k in rows], [positions[k] for k in rows], [places[k] for k in rows])
            found |= dict(zip(rows, parts, strict=True))
        again = [k for k in order if len(found[k][1])]
        for k in again:
            places[k] = _places(positions[k], np.append(places[k], found[k][1]))
    return [found[k][0] for k in range(len(tracks))]


_Swept = tuple[Reactions, Array]
"""Reactions, and rows between places from one to the next of which the contact changes much."""


def _places(position: Array, more: Array) -> Array:
    """Where on its path a sweep is solved: (k,) in rows, `more` among them.

    At every row, unless the rows are closer to each other than needed.
    """
    n = len(position)
    every = np.arange(n, dtype=float)
    path = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(position, axis=0), axis=1))])
    # rods that are interpolated between places so near have contacts that are off by some 1e-5 rod lengths
    count = math.ceil(path[-1] / 0.0025) + 1
    at = np.union1d(np.interp(np.linspace(0, path[-1], count), path, every), more)
    return at if len(at) < n else every


def _swept(body: RoundedPolyhedron, tracks: list[Track], rows: list[Array], places: list[Array]) -> list[_Swept]:
    """Sweeps of similar lengths at once: shorter ones go on beyond their ends, which is cut off."""
    n = max(len(at) for at in places)
    position, friction = np.empty((len(tracks), n, 3)), np.empty((len(tracks), n))
    for k, (track, row, at) in enumerate(zip(tracks, rows, places, strict=True)):
        where = np.stack([np.interp(at, np.arange(len(row)), column) for column in row.T], axis=1)
        count, step = len(at), where[-1] - where[-2]
        position[k, :count] = where
        position[k, count:] = where[-1] + np.arange(1, n - count + 1)[:, None] * step
        nearest = np.minimum(np.round(at).astype(np.intp), len(track.friction) - 1)
        friction[k, :count], friction[k, count:] = track.friction[nearest], track.friction[-1]
    try:
        result = sweep(body, position, np.array([track.axes[0] for track in tracks]), friction)
    except ValueError as error:
        raise InputError(f"these poses can't be swept in space: {error}; plan with a larger --around") from None
    found = []
    for k, (track, at) in enumerate(zip(tracks, places, strict=True)):
        count = len(at)
        s1, force, moment = result.s1[k, :count], result.force[k, :count], result.moment[k, :count]
        touches, turned = np.isfinite(s1), at[:0]
        if count < len(track.position):
            # across a snap the reactions jump
            joined = touches[:-1] & touches[1:] & ~result.snapped[k, 1:count]
            turn, path = (
                np.linalg.norm(np.diff(column, axis=0), axis=1)
                for column in (force / np.linalg.norm(force, axis=1, keepdims=True), result.point[k, :count])
            )
            # in radians and rod lengths: larger changes are those of snaps and edges, and friction may be drawn anew
            turns = touches[:-1] & touches[1:] & ~(joined & (turn <= 0.02) & (path <= 0.01))
            row = np.arange(len(track.position), dtype=float)
            turned = row[turns[np.clip(np.searchsorted(at, row) - 1, 0, count - 2)] & ~np.isin(row, at)]
            force, moment, touches = _between(at, (s1, force, moment), touches, joined, len(track.position))
        known = np.ones(len(touches), dtype=bool)
        if result.end[k] == End.LOST:
            known[int(np.flatnonzero(touches).max(initial=-1)) + 1 :] = False
        found.append((Reactions(np.nan_to_num(force), np.nan_to_num(moment), touches, known), turned))
    return found


def _between(
    at: Array, known: tuple[Array, Array, Array], touches: Mask, joined: Mask, rows: int
) -> tuple[Array, Array, Mask]:
    """Forces and moments (n, 3) at the rows, zero without contact, and where the rod touches (n,).

    They come from contacts `known` at places `at` (m,): arc lengths, forces and moments.  In between the rod is bent as by a
    single force at an arc length, with the direction of the force, q² and sin β interpolated where two places are `joined`: so
    a tip contact stays one, and the force in the cone.  From the place before a touch-down to the first place that touches, and
    likewise at a lift-off, nothing touches; on both sides of a snap the rod is that of the nearest place.
    """
    row = np.arange(rows, dtype=float)
    before = np.minimum(np.searchsorted(at, row, side="right") - 1, len(at) - 2)
    part = (row - at[before]) / (at[before + 1] - at[before])
    part = np.where(joined[before], part, np.round(part))
    part[-1] = 1.0
    exact = np.isin(row, at)
    touching = np.where(exact & (part == 0), touches[before], touches[before] & touches[before + 1])
    touching[-1] = touches[-1]
    force, moment = np.zeros((rows, 3)), np.zeros((rows, 3))
    some = np.flatnonzero(touching)
    before, part = before[some], part[some]
    after = np.where(part > 0, before + 1, before)
    s1, (omega, alpha, squared) = known[0], _state(*known[1:])
    turn = (omega[after] - omega[before] + np.pi) % (2 * np.pi) - np.pi
    # the sine of half the angle of the force, squared, and q² are of one sign, and sin β is twice their sum less 1
    half, squared, s1, leaning = (
        column[before] + part * (column[after] - column[before])
        for column in (np.sin(alpha / 2) ** 2, squared, s1, alpha)
    )
    alpha = np.copysign(2 * np.arcsin(np.sqrt(half)), leaning)
    state = np.stack([omega[before] + part * turn, alpha, squared, s1])
    found = wrench(state, planar.elastica.bend(alpha, np.sqrt(squared)).length)
    force[some], moment[some] = found[0].T, found[1].T
    return force, moment, touching


def _state(force: Array, moment: Array) -> tuple[Array, Array, Array]:
    """The angles ω and α and q², each (n,), of rods with reactions (n, 3) (S5 to S7)."""
    size = np.linalg.norm(moment, axis=1)
    omega = np.arctan2(-moment[:, 0], moment[:, 2])
    lateral = force[:, 0] * np.cos(omega) + force[:, 2] * np.sin(omega)
    return omega, np.arctan2(-lateral, force[:, 1]), size**2 / (4 * np.linalg.norm(force, axis=1))


def steps_touch(mesh: Any, position: Array, axes: Array, length: float, radius: float) -> Mask:
    """(n - 1,) in which steps between poses (n) a straight rod touches the body."""
    turns = Rotation.from_matrix(np.swapaxes(axes, 1, 2))
    vector = (turns[:-1].inv() * turns[1:]).as_rotvec()
    size = np.maximum(np.linalg.norm(np.diff(position, axis=0), axis=1), length * np.linalg.norm(vector, axis=1))
    count: Index = np.ceil(size / (0.02 * length)).astype(np.intp) + 1
    step, rank = ranges(count)
    part = rank / np.maximum(count - 1, 1)[step]
    place = position[step] + part[:, None] * (position[step + 1] - position[step])
    along = (turns[step] * Rotation.from_rotvec(part[:, None] * vector[step])).as_matrix()[:, :, 1]
    touches = segments_meet(mesh, place, along, length, radius)
    return np.asarray(np.bincount(step, touches, minlength=len(count)) > 0)


def grown_extent(mesh: trimesh.Trimesh, axis: Array, radius: float) -> tuple[float, float]:
    """Lowest and highest coordinate along an axis (3,) of a mesh fattened by a radius."""
    low, high = extent_along(mesh, axis)
    return low - radius, high + radius


def sections(
    mesh: trimesh.Trimesh, frame: Array, heights: Array, radius: float = 0.0, length: float = 1.0
) -> list[list[Array]]:
    """The contours of plane sections that can be reached from outside, as `slice_outlines`, for a rod of a radius and a length.

    A convex mesh may be fattened by the radius: then the contours' vertices are exact to rounding, and their sides within
    2.5e-10 rod lengths of the surface, an eighth of the error that exact contacts may have.
    """
    if not is_convex(mesh):
        return slice_outlines(mesh, frame, heights)
    polygons = _grown_polygons(mesh, frame, heights, radius, length) if radius else slice_polygons(mesh, frame, heights)
    return [[polygon] if len(polygon) else [] for polygon in polygons]


def _grown_polygons(mesh: trimesh.Trimesh, frame: Array, heights: Array, radius: float, length: float) -> list[Array]:
    center = mesh.bounds.mean(axis=0)
    origin = frame @ center
    body = RoundedPolyhedron((mesh.vertices.view(np.ndarray) - center) @ frame.T, mesh.faces)
    step = float(np.sqrt(8 * 2.5e-10 * length / radius))  # by the sagitta of an arc
    rounding = ROUNDING * float(np.abs(body.vertices).max())
    return [convex_polygon(_outline(body, z, radius, step), rounding) + origin[:2] for z in heights - origin[2]]


def _outline(body: RoundedPolyhedron, height: float, radius: float, step: float) -> Array:
    """Points (n, 2) of the section of a fattened polyhedron, no farther apart on its arcs than turns by `step`."""
    ends = body.vertices[2, np.stack([body.tail, body.head])]
    near = (ends.min(axis=0) <= height + radius) & (ends.max(axis=0) >= height - radius) & (body.angle > 0)
    edge = np.flatnonzero(near)
    angle, rise, across = body.angle[edge], body.left_normal[2, edge], body.turned[2, edge]
    largest, top = np.hypot(rise, across), np.arctan2(across, rise)
    # where the arc about an edge ends at one of its vertices: (2 ends, 2 solutions, e)
    vertex = np.stack([body.tail[edge], body.head[edge]])
    level = (height - body.vertices[2, vertex]) / radius
    with np.errstate(divide="ignore", invalid="ignore"):
        half = np.arccos(level / largest)
    turn = np.mod(np.stack([top - half, top + half], axis=1), 2 * np.pi)
    ended = turn <= angle  # not where it is NaN
    at_end, _, row = np.nonzero(ended)
    joints = vertex[at_end, row], body.on_edge(edge[row], turn[ended])[1]
    parts = [body.vertices[:, joints[0]] + radius * joints[1]]
    # the arcs between these places
    ends_of_arcs = np.where(ended, turn, 0.0).reshape(4, -1)
    places = np.sort(np.concatenate([np.zeros((1, len(edge))), ends_of_arcs, angle[None]]), axis=0)
    first, last = places[:-1], places[1:]
    slope = body.direction[2, edge] * body.length[edge]
    middle = (height - ends[0, edge] - radius * _rise(rise, across, (first + last) / 2)) / np.where(slope, slope, 1.0)
    size = float(np.abs(body.vertices).max())
    arc = (last > first) & (middle >= 0) & (middle <= 1) & (np.abs(slope) > NEGLIGIBLE * size)
    number, row = np.nonzero(arc)
    part, turn = _spread(row, first[number, row], last[number, row], step)
    along = (height - ends[0, edge[part]] - radius * _rise(rise[part], across[part], turn)) / slope[part]
    chosen = edge[part]
    span = body.length[chosen] * body.direction[:, chosen]
    on_edge = body.vertices[:, body.tail[chosen]] + np.clip(along, 0, 1) * span
    parts.append(on_edge + radius * body.on_edge(chosen, turn)[1])
    parts.append(_about_vertices(body, height, radius, step, *joints))
    return np.concatenate(parts, axis=1)[:2].T


def _rise(rise: Array, across: Array, turn: Array) -> Array:
    return rise * np.cos(turn) + across * np.sin(turn)


def _spread(row: Index, first: Array, last: Array, step: float) -> tuple[Index, Array]:
    """Values from first to last (n,), no farther apart than a step, and the row of each."""
    count = np.ceil((last - first) / step).astype(np.intp) + 1
    number, rank = ranges(count)
    part = rank / np.maximum(count - 1, 1)[number]
    return row[number], first[number] + part * (last - first)[number]


def _about_vertices(
    body: RoundedPolyhedron, height: float, radius: float, step: float, vertex: Index, normals: Array
) -> Array:
    """Points (3, n) of the arcs about vertices, which begin and end at normals (3, k) about vertices (k,)."""
    level = (height - body.vertices[2]) / radius
    alone = np.setdiff1d(np.flatnonzero(np.abs(level) <= 1), vertex)  # whole circles, or nothing
    turn = np.concatenate([np.arctan2(normals[1], normals[0]), np.zeros(len(alone))])
    vertex = np.concatenate([vertex, alone])
    if not len(vertex):
        return np.empty((3, 0))
    order = np.lexsort((turn, vertex))
    vertex, turn = vertex[order], turn[order]
    begins = np.flatnonzero(np.diff(vertex, prepend=-1))
    following = np.append(turn[1:], 0.0)
    following[np.append(begins[1:], len(turn)) - 1] = turn[begins] + 2 * np.pi

    def normal(vertex: Index, turn: Array) -> Array:
        flat = np.sqrt(np.maximum(1 - level[vertex] ** 2, 0.0))
        return np.stack([flat * np.cos(turn), flat * np.sin(turn), level[vertex]])

    middle = normal(vertex, (turn + following) / 2)
    inside = ((body.away[:, :, vertex] * middle[:, None]).sum(axis=0) <= NEGLIGIBLE).all(axis=0)
    vertex, turn = _spread(vertex[inside], turn[inside], following[inside], step)
    return body.vertices[:, vertex] + radius * normal(vertex, turn)
