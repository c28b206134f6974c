"""The data that pictures of a scan show: contacts, surface, truth and recording; and the parts of them that are drawn.

Parts are the surface, outlines of slices, paths of contacts, normals and rods, with their colours.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import planar
from planar.plots import TANGENTIAL_COLOR, TIP_COLOR
from scan3d.arrays import Array
from scan3d.choices import COLORS
from scan3d.cloud import Cloud
from scan3d.errors import InputError
from scan3d.files.shapes import cloud_table, scale_lengths
from scan3d.geometry.distance import signed_distances
from scan3d.geometry.hulls import HULL_OF_MESH, is_convex
from scan3d.geometry.sections import section_lines
from scan3d.recording import Recording
from scan3d.spatial import inverse, march
from scan3d.units import UNITS_M, angle, force, lengths, number, unit_for


@dataclass(frozen=True)
class Scene:
    """What is known of a body.  Lengths in `unit`."""

    name: str
    unit: str
    contacts: NDArray[Any] | None = None
    """(n,) the columns of `files.shapes.cloud_table`, or as many of them as a file has."""
    surface: Any = None
    """The reconstructed surface, a `trimesh.Trimesh`."""
    bound: Array | None = None
    """(v,) certified local bound at its vertices."""
    truth: Any = None
    """The true body, a `trimesh.Trimesh`."""
    recording: Recording | None = None
    is_other: bool = False
    """Whether another surface, which need not be convex, is in the place of the true body, to be compared with."""
    key_figures: tuple[tuple[str, str], ...] = ()
    """Pairs of a quantity's name and its value, for tables."""
    shown: tuple[Any, Array | None, Array | None, Array | None] | None = None
    """`shown_surface` in this unit, where it has been computed for another scene of the same bodies."""

    @property
    def truth_name(self) -> str:
        """What pictures call the true body: the truth, or what was taken in the place of a mesh that is not convex."""
        is_hull = self.truth is not None and "filled" in self.truth.metadata
        return HULL_OF_MESH if is_hull else "truth"

    @property
    def reference(self) -> str:
        """What pictures call the body that the surface is compared with."""
        return "other surface" if self.is_other else self.truth_name

    @property
    def deviation_title(self) -> str:
        """The title of the surface's deviation."""
        if self.is_other:
            return "signed distance from the other surface"
        return f"signed deviation{self._of_hull('from')}"

    @property
    def bound_title(self) -> str:
        """The title of the local bound."""
        return f"certified bound{self._of_hull('of')}"

    def _of_hull(self, word: str) -> str:
        return "" if self.truth_name == "truth" or self.is_other else f" {word} the {self.truth_name}"

    def in_shown_unit(self) -> Scene:
        """The scene in the unit in which its size is written (`scan3d.units`), such as mm for a part given in metres."""
        unit = unit_for(self.diagonal, self.unit)[0].replace("µ", "u") if len(self.corners) else self.unit
        if unit == self.unit or unit not in UNITS_M:
            return self
        factor = UNITS_M[self.unit] / UNITS_M[unit]
        contacts = self.contacts
        if contacts is not None:
            scale_lengths(contacts := contacts.copy(), factor)
        return replace(
            self,
            unit=unit,
            contacts=contacts,
            surface=_scaled(self.surface, factor),
            bound=None if self.bound is None else factor * self.bound,
            truth=_scaled(self.truth, factor),
            recording=None if self.recording is None else replace(self.recording, unit=unit),
            shown=None,
        )

    def against(self, other: Any) -> Scene:
        """The scene in which the surface is compared with another one, a `trimesh.Trimesh` in the same unit."""
        return replace(self, truth=other, is_other=True, shown=None)

    @property
    def points(self) -> Array:
        """(n, 3) contacts."""
        return np.empty((0, 3)) if self.contacts is None else columns(self.contacts, "x", "y", "z")

    @property
    def normals(self) -> Array:
        """(n, 3) outward normals, NaN where unknown."""
        if self.contacts is None or not {"nx", "ny", "nz"} <= set(self.contacts.dtype.names or ()):
            return np.full((len(self.points), 3), np.nan)
        return columns(self.contacts, "nx", "ny", "nz")

    @property
    def corners(self) -> Array:
        """(k, 3) contacts and vertices: a picture that contains them contains all bodies."""
        bodies = [np.asarray(mesh.vertices) for mesh in (self.surface, self.truth) if mesh is not None]
        return np.concatenate([self.points, *bodies])

    @property
    def diagonal(self) -> float:
        """Diagonal of the bounding box."""
        return float(np.linalg.norm(np.ptp(self.corners, axis=0)))

    def column(self, name: str) -> Array | None:
        """(n,) a column of the contacts, None if it does not exist or holds no finite value.

        Values that colours and labels, in float32 and in other units, could not be computed for are not known.
        """
        name = {"error": "quality"}.get(name, name)
        if self.contacts is None or name not in (self.contacts.dtype.names or ()):
            return None
        values = columns(self.contacts, name)[:, 0]
        values[np.abs(values) > 1e30] = np.nan
        return values if np.isfinite(values).any() else None


def _scaled(mesh: Any, factor: float) -> Any:
    return None if mesh is None else mesh.copy().apply_scale(factor)


def columns(rows: NDArray[Any], *names: str) -> Array:
    """Columns (n, k) of a structured array."""
    return np.stack([rows[name].astype(np.float64) for name in names], axis=1)


def of_cloud(cloud: Cloud, error: Array | None = None, **more: Any) -> Scene:
    """A scene of a cloud; `error` (n,) is the contacts' distance from the truth, `more` the fields of `Scene`."""
    return Scene(**{"name": "body", **more}, unit=cloud.unit, contacts=cloud_table(cloud, error))


def out_of_plane_deg(bending_angle: Array) -> Array:
    """(n,) angles in degrees between the directions to which the rod bends and the plane of the sweep, from -90 to 90.

    In contrast to the angle of the bending plane, from -180° to 180°, it does not jump, and is 0 for rods that bend backward.
    """
    return np.rad2deg(np.arcsin(np.sin(bending_angle)))


def contact_sentence(scene: Scene, contact: int) -> str:
    """What was measured at a contact, given by its row in the scene's contacts."""
    place, unit = lengths(scene.points[contact], scene.unit, digits=6)
    parts = [f"contact {contact}: ({', '.join(place)}) {unit}"]
    for name in ("sweep", "slice"):
        values = scene.column(name)
        if values is not None:
            parts.append(f"{name} {values[contact]:.0f}")
    phase, pushed, friction = (scene.column(name) for name in ("phase", "force", "friction"))
    if phase is not None:
        parts.append(f"{planar.Phase(int(phase[contact])).name.lower()} contact")
    if pushed is not None:
        parts.append(f"force {force(pushed[contact], digits=4)}")
    if friction is not None and np.isfinite(friction[contact]):
        parts.append(f"friction {number(friction[contact])}")
    bending = scene.column("bending")
    if bending is not None:
        parts.append(f"bending {angle(out_of_plane_deg(bending)[contact])} out of the sweep's plane")
    normal = scene.normals[contact]
    if np.isfinite(normal).all():
        parts.append("normal ({})".format(", ".join(f"{x:.4f}" for x in normal)))
    return ", ".join(parts)


# A pale body, on which contacts and rods of saturated colours stand out.  Red and orange differ in lightness, so that readers
# with deficient colour vision can distinguish them.
BODY, INK, ROD, TIP, TANGENTIAL = "#c3ccd6", "#222222", "#1b6ca8", TIP_COLOR, TANGENTIAL_COLOR
# Tangential and tip contacts on a surface that is coloured from blue over white to red, from which black and yellow stand out.
ON_DEVIATION = "#161616", "#ffd60a"
# Reactions of the rod, the contacts of the sweep that is shown, and the curves of components along x, y and z.
FORCE, SELECTED, REACTION_COLORS = "#8e24aa", "#00c853", (ROD, TIP, TANGENTIAL)
UNKNOWN, NORMAL, SLICE, EDGE, BACKDROP, BOUND = "#9a9a9a", "#6b6b6b", "#5b6672", "#4a4f55", "#eef0f3", "#3f9e8f"
ESTIMATED = "#e6d8b8"


class Shade(NamedTuple):
    """Values and their colours by a scale."""

    values: Array
    """(n,) in the unit of the title"""
    rgb: NDArray[np.uint8]
    """(n, 3)"""
    title: str
    map: str
    norm: Any
    """A matplotlib norm; None for kinds."""
    kinds: tuple[tuple[str, str], ...] = ()
    """Names and colours of the kinds that the values number."""

    @property
    def beyond(self) -> tuple[bool, bool]:
        """Whether values lie below the scale, and above it, by more than rounding: they have the colours of its ends."""
        low, high = self.norm.vmin, self.norm.vmax
        known, rounding = self.values[np.isfinite(self.values)], 1e-9 * (high - low)
        return bool((known < low - rounding).any()), bool((known > high + rounding).any())


def largest_known(values: Array) -> float:
    """The largest finite value; 0 if there is none."""
    known = values[np.isfinite(values)]
    return float(known.max()) if len(known) else 0.0


def shade(values: Array, title: str, low: float, high: float, *, map: str = "viridis", log: bool = False) -> Shade:
    """Colours of values (n,) on a scale from `low` to `high`; values that are not finite are grey."""
    import matplotlib
    from matplotlib.colors import LogNorm, Normalize, to_rgb

    norm = LogNorm(low, high, clip=True) if log else Normalize(low, high, clip=True)
    known = np.isfinite(values)
    rgb = np.tile(np.array(to_rgb(UNKNOWN)), (len(values), 1))
    rgb[known] = matplotlib.colormaps[map](norm(values[known]))[:, :3]
    return Shade(values, (255 * rgb + 0.5).astype(np.uint8), title, map, norm)


def shade_kinds(values: Array, title: str, *kinds: tuple[str, str]) -> Shade:
    """Colours of values (n,) that number kinds, whose names and colours are given."""
    from matplotlib.colors import to_rgb

    values, colors = values.astype(int), 255 * np.array([to_rgb(color) for _, color in kinds]) + 0.5
    return Shade(values, colors.astype(np.uint8)[values], title, "", None, kinds)


def shade_contacts(scene: Scene, color: str, pair: tuple[str, str] = (TANGENTIAL, TIP)) -> Shade:
    """Colours of the contacts, `pair` those of tangential and of tip contacts.

    Raises InputError unless `color` is one of `COLORS` and the scene has its values.
    """
    if color not in COLORS:
        raise InputError(f"contacts are coloured by {', '.join(COLORS)}, got {color!r}")
    values = scene.column(color)
    if values is None:
        known = [name for name in COLORS if scene.column(name) is not None]
        if not known and color == "force":  # by default, of the points of another program
            return shade_kinds(np.zeros(len(scene.points)), "", ("", pair[0]))
        others = f"known are {', '.join(known)}" if known else "its file has points only"
        raise InputError(f"the {color} of the contacts of {scene.name} is not known; {others}")
    if color == "phase":
        return shade_kinds(values == planar.Phase.TIP, "kind of contact", ("tangential", pair[0]), ("tip", pair[1]))
    if color == "force":
        return shade(values * 1e3, "contact force in mN", 0.0, largest_known(values) * 1e3 or 1.0)
    if color == "friction":
        low, high = -largest_known(-values), largest_known(values)
        if high - low <= 1e-6:  # one value, but for rounding: in the middle of a scale
            low, high = max(low - 0.05, 0.0), high + 0.05
        return shade(values, "coefficient of friction", low, high)
    if color == "bending":
        angle = out_of_plane_deg(values)
        largest = max(largest_known(np.abs(angle)), 1.0)  # smaller angles are rounding
        # diverging, with a middle that is grey enough to be seen on a white page
        return shade(angle, "bending out of the sweep's plane in °", -largest, largest, map="coolwarm")
    values, unit = shown_lengths(values, scene.unit)
    high = max(largest_known(values), 1.0 if unit == "nm" else 0.0)
    return shade(values, f"distance from the {scene.truth_name} in {unit}", high * 1e-4, high, log=True)


def shown_lengths(values: Array, unit: str) -> tuple[Array, str]:
    """Lengths (n,) in the unit in which the largest of them is written, nm if that is below a nanometre, and that unit."""
    symbol, size = unit_for(max(largest_known(np.abs(values)), 1.001e-9 / UNITS_M[unit]), unit)
    return values * (UNITS_M[unit] / float(size)), symbol


def surface_shades(scene: Scene) -> tuple[Any, list[Shade]]:
    """The surface, and the colours of its vertices by how well they are known, the deviation from the truth and the bound: by
    those that are said.

    Deviation and bound are in one unit.  Where both are known, a deviation within the largest bound is pale, and colours are
    those of a fault only beyond.

    A body with few vertices, such as a cube, may show one bound everywhere: bounds are known at vertices only, and that of a
    vertex is the largest of the facets around it.
    """
    mesh, deviation, bound, known = shown_surface(scene)
    shades = []
    if known is not None and not scene.is_other:  # patches that no rod has reached are seen at once
        kinds = ("known", BODY), ("estimated", ESTIMATED), ("unknown", TANGENTIAL)
        shades.append(shade_kinds(2 - known, "known or not", *kinds))
    bounds = bound if scene.bound is not None and bound is not None else np.empty(0)
    off = np.empty(0) if deviation is None else deviation
    values, unit = shown_lengths(np.concatenate([off, bounds]), scene.unit)
    off, bounds = np.split(values, [len(off)])
    widest = largest_known(bounds)
    if len(off):
        # a body that was found exactly, to a nanometre, is not shown in the colours of a large deviation
        largest = 2 * widest or max(float(np.abs(off).max()), 1.0 if unit == "nm" else 0.0)
        shades.append(shade(off, f"{scene.deviation_title} in {unit}", -largest, largest, map="RdBu_r"))
    if np.isfinite(bounds).any():
        shades.append(shade(bounds, f"{scene.bound_title} in {unit}", 0.0, widest or 1.0, map="YlGnBu"))
    return mesh, shades


def shade_surface(scene: Scene, view: str = "surface") -> tuple[Any, Shade | None]:
    """The surface and the colours of its vertices by the first that is known of `surface_shades`; None without any.

    Raises InputError without a surface, and for the view "bound" without bounds.
    """
    if scene.surface is None:
        raise InputError(f"{scene.name} has no surface to show; it has a cloud: give the view cloud")
    mesh, shades = surface_shades(scene)
    if view != "bound":
        return mesh, shades[0] if shades else None
    if scene.bound is None or not np.isfinite(scene.bound).any():
        why = (
            "it is not convex, and the view surface shows what of it is known"
            if is_hollow(scene)
            else "give a scan's folder, its surface.ply or a recording that certifies one"
        )
        raise InputError(f"the bound at the surface of {scene.name} is not known: {why}")
    return mesh, shades[-1]


# Toward the camera: three sides of a box are seen, and none of them hides another's contacts.
DIRECTION = (1.0, -1.3, 0.8)
# From a sweep toward the camera, along the clamp's axes: rods hide little of the body and do not hide each other.
SWEEP_DIRECTION = (0.45, -0.6, 0.7)


def shown_surface(scene: Scene) -> tuple[Any, Array | None, Array | None, Array | None]:
    """The surface, and at its vertices (v,) the signed deviation from the truth, the certified local bound, and how well they
    are known (2, 1 or 0); None if that is not known.

    Where either is known, edges longer than a sixtieth of the diagonal are split.  The deviation, positive outside, is computed
    at the new vertices.  The bound, certified at the old vertices, is interpolated linearly: on a convex surface the result is
    no less than the certified bound of a facet, as a vertex has the largest bound of the facets around it.
    """
    import trimesh

    if scene.shown is not None:
        return scene.shown
    known = scene.surface.vertex_attributes.get("known")
    known = None if known is None else np.asarray(known, dtype=int)
    if scene.truth is None and scene.bound is None:
        return scene.surface, None, None, known
    count = len(scene.surface.vertices)
    bounds = np.zeros(count) if scene.bound is None else scene.bound
    at_least = np.zeros((count, 2)) if known is None else known[:, None] >= [1, 2]
    # lengths are those of the places alone, and every column is halved
    columns = np.column_stack([scene.surface.vertices, bounds, at_least])
    columns, faces = trimesh.remesh.subdivide_to_size(columns, scene.surface.faces, scene.diagonal / 60, max_iter=20)
    mesh = trimesh.Trimesh(columns[:, :3], faces, process=False)
    bound = None if scene.bound is None else columns[:, 3]
    if known is not None:  # as well as the least known of the old vertices that a new one is a mean of
        known = (columns[:, 4:] == 1).sum(axis=1)
    if scene.truth is None:
        return mesh, None, bound, known
    distances = signed_distances if not scene.is_other and is_convex(scene.truth) else _distances_from_other
    return mesh, distances(np.asarray(mesh.vertices), scene.truth), bound, known


def _distances_from_other(points: Array, other: Any) -> Array:
    """Distances (p,) of points (p, 3) from a mesh that need not be convex, negative inside, or behind where it is open.

    The sign is that of the normals at the nearest facet, edge or vertex (J. A. Bærentzen, H. Aanæs, Signed Distance Computation
    Using the Angle Weighted Pseudonormal, IEEE TVCG 11, 2005).
    """
    import pyvista

    inward = other.is_watertight and other.volume < 0
    cloud = pyvista.PolyData(points).compute_implicit_distance(pyvista.wrap(other), inplace=True)
    values = np.asarray(cloud["implicit_distance"], dtype=float)
    return -values if inward else values


def area_of_vertices(mesh: Any) -> Array:
    """(v,) the area around each vertex: a third of its facets."""
    faces = np.asarray(mesh.faces)
    return np.bincount(faces.ravel(), np.repeat(mesh.area_faces / 3, 3), len(mesh.vertices)).astype(np.float64)


def is_hollow(scene: Scene) -> bool:
    """Whether the scene has the surface of a body that is not convex."""
    return scene.surface is not None and "known" in scene.surface.vertex_attributes


def outlines(scene: Scene) -> list[tuple[Array, int]]:
    """The slices as closed lines (k, 3) through their contacts, in order around the slice, with the slices' numbers.

    Of a body that is not convex, where contacts have no such order, the lines in which the slices' planes cut the surface.
    """
    slices = scene.column("slice")
    if slices is None:
        return []
    lines, contacts = [], scene.points
    for of, rows in zip(*_rows_of_each(slices), strict=True):
        points = contacts[rows]
        if len(points) < 2 or of < 0:  # probings lie in no slice
            continue
        middle = (points.min(axis=0) + points.max(axis=0)) / 2
        # the plane of the slice: the two main directions of its contacts
        plane = np.linalg.svd(points - middle, full_matrices=False)[2][:2]
        if is_hollow(scene):
            frame = np.vstack([plane, np.cross(*plane)])
            height = frame[2] @ middle
            for line in section_lines(scene.surface, frame, np.array([height]))[0]:
                line = np.column_stack([line, np.full(len(line), height)]) @ frame
                lines.append((np.concatenate([line, line[:1]]), int(of)))
            continue
        u, v = plane @ (points - middle).T
        # ordered by the angle about the middle, in coordinates scaled so that a thin contour becomes as wide as it is long
        contour = points[np.argsort(np.arctan2(v / (np.ptp(v) or 1.0), u / (np.ptp(u) or 1.0)), kind="stable")]
        lines.append((np.concatenate([contour, contour[:1]]), int(of)))
    return lines


def _rows_of_each(numbers: Array) -> tuple[Array, list[NDArray[np.intp]]]:
    """The distinct ones of numbers (n,), rising, and the rows of each, rising as well."""
    order = np.argsort(numbers, kind="stable")
    distinct, first = np.unique(numbers[order], return_index=True)
    return distinct, np.split(order, first[1:])


def contact_paths(scene: Scene) -> list[tuple[Array, int]]:
    """The paths of the contacts over the body as lines (k, 3), with the numbers of their sweeps.

    The path of a sweep is broken where samples without contact lie between its contacts, and where the contact jumps, as in a
    snap, by more than 15 % of the diagonal.
    """
    sweeps, rows = scene.column("sweep"), scene.column("row")
    if sweeps is None or rows is None:
        return []
    order = np.lexsort((rows, sweeps))
    points, sweeps, rows = scene.points[order], sweeps[order], rows[order]
    ends = (np.diff(sweeps) != 0) | (np.diff(rows) != 1)
    ends |= np.linalg.norm(np.diff(points, axis=0), axis=1) > 0.15 * scene.diagonal
    pieces = np.split(np.arange(len(points)), np.flatnonzero(ends) + 1)
    return [(points[piece], int(sweeps[piece[0]])) for piece in pieces if len(piece) > 1]


def sections(scene: Scene) -> tuple[str, list[tuple[Array, int]]]:
    """The lines on the body that belong to slices or sweeps, with their numbers, and what they are called."""
    if scene.column("slice") is None:
        return "contact paths", contact_paths(scene)
    return "slices", outlines(scene)


@dataclass(frozen=True)
class ShownSweep:
    """One sweep as it is drawn, with k samples in contact.  Lengths in the scene's unit."""

    number: int
    slice: int | None
    """None where contacts lie in no slices, as those of the spatial model."""
    base: Array
    """(k, 3) position of the clamp"""
    turns: Array
    """(k, 3, 3) the clamp's x, y and z axes, as rows"""
    curved: Array
    """(k, p, 3) the rod from the clamp to the contact"""
    rest: Array
    """(k, q, 3) the rest of the rod, from the contact to the tip"""

    @property
    def axes(self) -> Array:
        """(3, 3) the clamp's axes at the first contact, which it keeps in most sweeps."""
        return self.turns[0]

    @property
    def contact(self) -> Array:
        """(k, 3) points of contact, on the rod's centre line"""
        return self.curved[:, -1]

    @property
    def rods(self) -> Array:
        """(k, p + q - 1, 3) the rod from the clamp to the tip"""
        return np.concatenate([self.curved, self.rest[:, 1:]], axis=1)


def has_rods(scene: Scene) -> bool:
    """Whether the scene has a recording and contacts that state their rows, which folders of earlier versions do not."""
    return scene.recording is not None and scene.column("row") is not None


def shown_sweep(scene: Scene, number: int | None = None, points: int = 60) -> ShownSweep:
    """A sweep of the recording, the most informative one unless a number is given; `points` are those of a curved part.

    Raises InputError if the scene has no recording, or contacts that do not come from the recording.
    """
    recording = scene.recording
    sweeps, slices = scene.column("sweep"), scene.column("slice")
    if recording is None or sweeps is None:
        raise InputError(
            f"{scene.name} has no recording, which rods are drawn from: show a scan's folder, or a recording"
        )
    chosen = most_informative_sweep(scene) if number is None else number
    selected = sweeps == chosen
    rows = recording_rows(scene, recording)[selected]
    curved, rest = bent_rods(recording, rows, is_spatial(scene), points)
    kept = np.isfinite(curved).all(axis=(1, 2)) & np.isfinite(rest).all(axis=(1, 2))
    scale = 1 / UNITS_M[scene.unit]
    return ShownSweep(
        number=int(chosen),
        slice=None if slices is None else int(slices[selected][0]),
        base=recording.position_m[rows][kept] * scale,
        turns=recording.axes()[rows][kept],
        curved=curved[kept] * scale,
        rest=rest[kept] * scale,
    )


def bent_rods(recording: Recording, rows: NDArray[np.int64], spatial: bool, points: int = 60) -> tuple[Array, Array]:
    """Rods (k, p, 3) from the clamp to the contact in some rows, and their rests (k, q, 3) up to the tip, in metres.

    `spatial` rods bend as all six reactions say, others in the clamp's plane of x and y.  Raises InputError without the six.
    """
    axes, base, down = recording.axes()[rows], recording.position_m[rows], recording.down()
    force, moment = _reactions(recording, rows, spatial)
    lines = march.shapes(recording.rod.in_space(), force.T, moment.T, None if down is None else down[rows].T, points)
    bent, rest = (base[:, None] + recording.rod.length_m * np.einsum("ipn,nij->npj", line, axes) for line in lines)
    return bent, rest


def at_clamp(
    recording: Recording, rows: NDArray[np.int64], spatial: bool, touching: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Contact forces and moments at the clamp (k, 3) that bend the rods of some rows, in EI/L² and EI/L in the clamp's frame.

    Of the rows those numbered `touching` have a contact.
    """
    down, rod = recording.down(), recording.rod.in_space()
    force, moment = np.zeros((2, len(rows), 3))
    if down is not None:
        moment = -march.free_reactions(rod, down[rows].T)[1].T
    held = _reactions(recording, rows[touching], spatial)
    force[touching], moment[touching] = (-part for part in held)
    if down is not None:
        force[touching] -= rod.profile.weight * down[rows[touching]]
    return force, moment


def _reactions(recording: Recording, rows: NDArray[np.int64], spatial: bool) -> tuple[Array, Array]:
    """Support reactions (k, 3) of rods as they are drawn, in EI/L² and EI/L in the clamp's frame.

    A rod that is straight at rest, uniform and weightless bends in a plane: of six reactions those in it are kept, as
    `spatial.inverse.reconstruct` finds it.
    """
    force, moment = (columns[rows] for columns in recording.reactions(spatial))
    if not (spatial and recording.rod.is_simple):
        return force, moment
    bending = inverse.reconstruct(force, moment, noise=recording.noise.of_reactions(recording.rod)).bending
    about = np.cross(bending, [0.0, 1.0, 0.0])
    across, turning = (np.einsum("ni,ni->n", *pair)[:, None] for pair in ((force, bending), (moment, about)))
    return across * bending + force * [0.0, 1.0, 0.0], turning * about


def sweep_direction(sweep: ShownSweep) -> Array:
    """(3,) from a sweep toward the camera; rods that bend below the sweep's plane are seen from below."""
    x, y, z = sweep.axes
    side = -1.0 if sweep.slice is None and ((sweep.contact - sweep.base) @ z).mean() < 0 else 1.0
    return side * SWEEP_DIRECTION[2] * z + SWEEP_DIRECTION[1] * y + SWEEP_DIRECTION[0] * x


def is_spatial(scene: Scene) -> bool:
    """Whether the contacts come from the spatial model, in which the rod bends in a plane of its own in every sample."""
    return scene.column("slice") is None


def recording_rows(scene: Scene, recording: Recording) -> NDArray[np.int64]:
    """(n,) rows of the recording that the contacts come from."""
    rows, sweeps, forces = (scene.column(name) for name in ("row", "sweep", "force"))
    if rows is not None and sweeps is not None and 0 <= rows.min() <= rows.max() < len(recording):
        indices = rows.astype(np.int64)
        # in the plane of a sweep, or of all channels, as those of probings are
        same, unit = np.zeros(len(rows), dtype=bool), recording.rod.force_unit_N
        for six_axis in {False, recording.six_axis}:
            of_recording = unit * np.linalg.norm(recording.pressing(six_axis)[indices], axis=1)
            same = same | (forces is None or np.isclose(forces, of_recording, rtol=1e-6, atol=planar.TOLERANCE * unit))
        if np.array_equal(recording.sweep[indices], sweeps) and np.all(same):
            return indices
    raise InputError(
        f"the contacts of {scene.name} do not belong to its recording, which rods are drawn from: reconstruct it again"
    )


def most_informative_sweep(scene: Scene) -> int:
    """The sweep whose contacts extend farthest; of those that extend nearly as far, that nearest to the middle of the body.

    Of a body that is not convex, of which a view from behind hides most, one on the side that its pictures show.
    """
    sweeps, points = scene.column("sweep"), scene.points
    assert sweeps is not None
    numbers, rows = _rows_of_each(sweeps)
    extent = np.array([np.linalg.norm(np.ptp(points[of_sweep], axis=0)) for of_sweep in rows])
    middle = [points[of_sweep].mean(axis=0) for of_sweep in rows] - points.mean(axis=0)
    distance = np.linalg.norm(middle, axis=1)
    if is_hollow(scene):
        nearness = middle @ np.array(DIRECTION)
        extent[nearness < 0.7 * nearness.max()] = 0.0
    distance[extent < 0.95 * extent.max()] = np.inf
    # rounded, because in a symmetric body rounding would choose among equals
    return int(numbers[np.argmin(np.round(distance / (scene.diagonal or 1.0), 6))])


def normal_lines(scene: Scene) -> Array:
    """(k, 2, 3) short lines along the normals of contacts; of more than 500, which would hide them, some evenly chosen."""
    known = np.flatnonzero(np.isfinite(scene.normals).all(axis=1))
    chosen = known[:: max(1, len(known) // 500)]
    points = scene.points[chosen]
    return np.stack([points, points + 0.035 * scene.diagonal * scene.normals[chosen]], axis=1)
