"""Thirty-four everyday bodies that are not convex, as closed meshes of one part, with their Euler numbers and thinnest walls.

    python -m tests.robustness.everyday

prints them all, with their walls in per cent of the diagonal.  Lengths are millimetres.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import trimesh
from manifold3d import CrossSection, Manifold, Mesh, OpType

SEGMENTS = 48
"""Of circles."""


class Body(NamedTuple):
    """How a body is made, and what is true of it."""

    make: Callable[[], Manifold]
    euler: int
    """2 for each part less 2 for each handle."""
    wall: float
    """Thickness of its thinnest wall, bar or rim, in mm; rounded by its makers, not measured."""


def box(x: float, y: float, z: float, *at: float) -> Manifold:
    """A box about a place, the origin unless it is given."""
    return Manifold.cube((x, y, z), True).translate((*at, 0, 0, 0)[:3])


def rod(length: float, radius: float, *at: float, along: str = "z") -> Manifold:
    """A round rod whose middle is at a place."""
    turn = {"x": (0, 90, 0), "y": (90, 0, 0), "z": (0, 0, 0)}[along]
    return Manifold.cylinder(length, radius, radius, SEGMENTS, True).rotate(turn).translate((*at, 0, 0, 0)[:3])


def ball(radius: float, *at: float) -> Manifold:
    return Manifold.sphere(radius, SEGMENTS).translate((*at, 0, 0, 0)[:3])


def turned(*profile: tuple[float, float]) -> Manifold:
    """Turned about z from a closed profile of radius and height."""
    return CrossSection([profile]).revolve(SEGMENTS)


def cut(outline: np.ndarray, height: float) -> Manifold:
    """A plate with an outline (n, 2)."""
    return CrossSection([outline.tolist()]).extrude(height)


def around(count: int, *radii: float) -> np.ndarray:
    """(n, 2) corners at angles evenly around, at these radii in turn."""
    angle = 2 * np.pi * np.arange(count) / count
    return np.resize(radii, count)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def tube(path: np.ndarray, radius: float, *, closed: bool = False) -> Manifold:
    """A round bar along a path (n, 3) that runs nowhere along (0.1, 0.3, 1)."""
    ahead = np.roll(path, -1, axis=0) - np.roll(path, 1, axis=0) if closed else np.gradient(path, axis=0)
    side = np.cross(ahead, [0.1, 0.3, 1.0])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(ahead, side)
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    circle = around(20, radius)
    rings = path[:, None] + circle[:, :1] * side[:, None] + circle[:, 1:] * up[:, None]
    here = np.arange(len(path) * 20).reshape(-1, 20)
    there = np.roll(here, -1, axis=0) if closed else here[1:]
    here = here if closed else here[:-1]
    a, b, c, d = here, np.roll(here, -1, axis=1), np.roll(there, -1, axis=1), there
    faces = np.concatenate([np.stack([a, b, c], axis=2).reshape(-1, 3), np.stack([a, c, d], axis=2).reshape(-1, 3)])
    corners = rings.reshape(-1, 3)
    if not closed:
        corners = np.concatenate([corners, path[[0, -1]]])
        k, n = np.arange(20), len(path) * 20
        first, last = np.roll(k, -1), n - 20 + np.roll(k, -1)
        ends = [np.stack([np.full(20, n), first, k], axis=1), np.stack([np.full(20, n + 1), n - 20 + k, last], axis=1)]
        faces = np.concatenate([faces, *ends])
    mesh = trimesh.Trimesh(corners, faces, process=False)
    if mesh.volume < 0:
        mesh.invert()
    return Manifold(Mesh(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32)))


def rounded(*corners: tuple[float, float, float]) -> np.ndarray:
    """A path (n, 3) along corners, which are cut three times."""
    points = np.array(corners, dtype=float)
    for _ in range(3):
        inner = np.stack([0.75 * points[:-1] + 0.25 * points[1:], 0.25 * points[:-1] + 0.75 * points[1:]], axis=1)
        points = np.concatenate([points[:1], inner.reshape(-1, 3), points[-1:]])
    return points


def arc(radius: float, degrees: float, *at: float) -> np.ndarray:
    """(n, 3) an arc in the plane of x and z about a place, from +x upwards."""
    angle = np.radians(np.linspace(0, degrees, 1 + int(degrees / 6)))
    angle = angle[:-1] if degrees == 360 else angle
    return np.array(at or (0, 0, 0)) + radius * np.stack([np.cos(angle), 0 * angle, np.sin(angle)], axis=1)


def together(*parts: Manifold) -> Manifold:
    return Manifold.batch_boolean(list(parts), OpType.Add)


def legs(x: float, y: float, length: float, width: float) -> Manifold:
    """Four legs below z = 0."""
    return together(*(box(width, width, length, i * x, j * y, -length / 2) for i in (-1, 1) for j in (-1, 1)))


def cup(radius: float, height: float, wall: float) -> Manifold:
    """A round cup that stands on z = 0."""
    return rod(height, radius, 0, 0, height / 2) - rod(height, radius - wall, 0, 0, height / 2 + wall)


def handled(body: Manifold, bar: Manifold, inside: Manifold) -> Manifold:
    """A vessel with a bar through its wall, of which the part inside is cut away."""
    return together(body, bar - inside)


def gear() -> Manifold:
    teeth = np.clip(2.2 * np.cos(10 * np.linspace(0, 2 * np.pi, 240, endpoint=False)), -1, 1)
    return cut((17 + 2 * teeth)[:, None] * around(240, 1), 9) - rod(30, 5)


def vase() -> Manifold:
    outer = [(9, 0), (14, 10), (13, 22), (8, 32), (7, 38), (10, 46)]
    return turned((0, 0), *outer, *((r - 2, z) for r, z in outer[:0:-1]), (7, 2.5), (0, 2.5))


def teapot() -> Manifold:
    body = turned((0, 0), (10, 0), (16, 6), (17, 13), (14, 20), (9, 24), (9, 27), (3, 27), (2.5, 31), (0, 32))
    spout = tube(rounded((10, 0, 7), (20, 0, 9), (23, 0, 18), (28, 0, 24)), 2.6)
    return together(body, spout, tube(arc(9, 180, 0, 0, 0)[:, [2, 1, 0]] * [-1, 1, 1] + [-13, 0, 13], 2))


def lattice() -> Manifold:
    third = (-14, 0, 14)
    return together(
        *(rod(40, 3, x, y, 0) for x in third for y in third),
        *(box(34, 4, 4, 0, y, z) for y in third for z in (-14, 14)),
        *(box(4, 34, 4, x, 0, 0) for x in third),
    )


EVERYDAY: dict[str, Body] = {
    "mug": Body(
        lambda: handled(cup(15, 36, 2.5), tube(arc(9, 180)[:, [2, 1, 0]] + [13, 0, 18], 2.6), rod(60, 13, 0, 0, 31)),
        0,
        2.5,
    ),
    "cup with a thick handle": Body(
        lambda: handled(cup(16, 24, 3), tube(arc(7, 180)[:, [2, 1, 0]] + [15, 0, 12], 3.5), rod(60, 13.5, 0, 0, 31)),
        0,
        3.0,
    ),
    "bowl": Body(
        lambda: turned(
            (0, 0), (9, 0), (9, 2), (18, 8), (23, 16), (24, 22), (22, 22), (21, 16.5), (17, 10), (8, 4.2), (0, 4)
        ),
        2,
        2.0,
    ),
    "glass": Body(
        lambda: turned(
            (0, 0),
            (12, 0),
            (12, 2),
            (2, 4),
            (2, 22),
            (9, 28),
            (11, 36),
            (10, 48),
            (8.5, 48),
            (9, 36),
            (7, 29.5),
            (0, 25),
        ),
        2,
        1.5,
    ),
    "torus": Body(lambda: tube(arc(18, 360), 7, closed=True), 0, 14.0),
    "ring": Body(lambda: turned((12, 0), (14, 0), (14.6, 3), (14, 6), (12, 6)), 0, 2.0),
    "pipe": Body(lambda: rod(60, 9) - rod(70, 7), 0, 2.0),
    "channel": Body(lambda: box(28, 50, 20) - box(22, 60, 20, 0, 0, 3), 2, 3.0),
    "bracket with ribs": Body(
        lambda: (
            together(
                box(40, 30, 3),
                box(3, 30, 30, -18.5, 0, 13.5),
                *(
                    cut(np.array([[0, 0], [24, 0], [0, 24]]), 2.5).rotate((90, 0, 0)).translate((-18, y, 0))
                    for y in (-8, 11)
                ),
            )
            - rod(20, 3.5, 10, 8, 0)
            - rod(20, 3.5, 10, -8, 0)
        ),
        -2,
        2.5,
    ),
    "chair": Body(
        lambda: (
            together(box(22, 22, 3, 0, 0, 1), legs(9, 9, 20, 3), box(3, 22, 6, -9.5, 0, 22))
            + together(*(box(3, 3, 24, -9.5, y, 12) for y in (-9, 0, 9)))
        ),
        -2,
        3.0,
    ),
    "table": Body(lambda: together(box(44, 30, 3), legs(18, 11, 24, 3.5)), 2, 3.0),
    "stool": Body(
        lambda: together(rod(3, 14), legs(8, 8, 28, 3), *(box(16, 2.5, 2.5, 0, y, -18) for y in (-8, 8))), -2, 2.5
    ),
    "gear": Body(gear, 0, 6.0),
    "nut": Body(lambda: cut(around(6, 13), 9) - rod(30, 6), 0, 5.0),
    "bottle": Body(
        lambda: turned((0, 0), (12, 0), (13, 1), (13, 28), (5, 40), (5, 50), (6, 50.5), (6, 52.5), (0, 52.5)), 2, 10.0
    ),
    "spoon": Body(
        lambda: together(
            (ball(10).scale((1.3, 0.9, 0.5)) - ball(10, 0, 0, 2.6).scale((1.2, 0.8, 0.5))).trim_by_plane(
                (0, 0, -1), 0.5
            ),
            tube(rounded((-11, 0, -2.2), (-18, 0, 0), (-30, 0, 4), (-48, 0, 4)), 1.6),
        ),
        2,
        1.3,
    ),
    "fork": Body(
        lambda: together(
            box(12, 16, 2.5, 4, 0, 0),
            *(box(20, 2.4, 2.5, 18, y, 0) for y in (-6.8, -2.3, 2.3, 6.8)),
            box(40, 4, 2.5, -20),
        ),
        2,
        2.4,
    ),
    "hook": Body(
        lambda: tube(rounded((0, 0, 40), (1, 0, 10), (2, 0, 0), (12, 0, -6), (22, 0, 2), (21, 0, 12)), 3), 2, 6.0
    ),
    "bent rod": Body(
        lambda: tube(rounded((-25, 0, 0), (-8, 1, 0), (-7, 0, 16), (7, 0, 16), (8, -1, 0), (25, 0, 0)), 2.5), 2, 5.0
    ),
    "spring": Body(
        lambda: tube(
            np.stack([10 * np.cos(t := np.linspace(0, 6 * np.pi, 120)), 10 * np.sin(t), 1.6 * t], axis=1), 1.7
        ),
        2,
        3.4,
    ),
    "star": Body(lambda: cut(around(10, 22, 9), 8), 2, 8.0),
    "box with a lid": Body(
        lambda: together(
            box(36, 26, 18) - box(31, 21, 18, 0, 0, 2.5),
            box(36, 2.5, 26, 0, 0, 12).rotate((-15, 0, 0)).translate((0, 11.5, 7)),
        ),
        2,
        2.5,
    ),
    "vase": Body(vase, 2, 2.0),
    "plate": Body(lambda: turned((0, 0), (14, 0), (16, 1), (25, 5), (25, 7), (15.5, 3), (13.5, 2), (0, 2)), 2, 2.0),
    "key": Body(
        lambda: together(rod(3, 9) - rod(9, 5), box(32, 4, 3, 23), box(3, 6, 3, 32, -4, 0), box(3, 5, 3, 37, -3.5, 0)),
        0,
        3.0,
    ),
    "wrench": Body(
        lambda: (
            together(box(50, 8, 4, 5), rod(6, 10, 34, 0, 0), rod(6, 9, -22, 0, 0))
            - rod(20, 5, -22, 0, 0)
            - box(16, 9, 20, 40)
        ),
        0,
        4.0,
    ),
    "pulley": Body(
        lambda: (
            turned((4, 0), (18, 0), (18, 2), (12, 5), (18, 8), (18, 10), (4, 10))
            - together(*(rod(30, 2.5, *p, 5) for p in around(5, 8.5)))
        ),
        -10,
        2.0,
    ),
    "fan": Body(
        lambda: together(
            rod(9, 6), *(box(20, 8, 2, 14, 0, 0).rotate((30, 0, 0)).rotate((0, 0, 72 * k)) for k in range(5))
        ),
        2,
        2.0,
    ),
    "pyramid with a hole": Body(lambda: Manifold.cylinder(30, 24, 0.5, 4) - rod(60, 5, 0, 0, 9, along="x"), 0, 4.0),
    "lattice": Body(lattice, -18, 4.0),
    "stairs": Body(
        lambda: together(*(box(40 - 8 * k, 20, 6, -4 * k, 0, 5 * k) for k in range(5))) - box(12, 26, 9, -12, 0, 7),
        0,
        4.0,
    ),
    "teapot": Body(teapot, 0, 4.0),
    "funnel": Body(lambda: turned((2.5, 0), (4.5, 0), (4.5, 15), (19, 32), (16.5, 32), (2.5, 16)), 0, 2.0),
    "kettlebell": Body(
        lambda: together(ball(14), tube(rounded((-8, 0, 8), (-10, 0, 28), (10, 1, 28), (8, 0, 8)), 2.6)), 0, 5.2
    ),
}


def mesh_of(body: str | Manifold) -> trimesh.Trimesh:
    """A body, given by its name or as it is made, closed and outward, in mm."""
    made = (EVERYDAY[body].make() if isinstance(body, str) else body).to_mesh64()
    mesh = trimesh.Trimesh(np.array(made.vert_properties)[:, :3], np.array(made.tri_verts), process=False)
    mesh.units = "mm"
    return mesh


def main() -> None:
    for name, body in EVERYDAY.items():
        mesh = mesh_of(name)
        print(
            f"{name:24s} faces {len(mesh.faces):6d}  Euler {mesh.euler_number:4d} ({body.euler:4d})  "
            f"wall {100 * body.wall / mesh.scale:5.1f} %  parts {mesh.body_count}  watertight {mesh.is_watertight}"
        )


if __name__ == "__main__":
    main()
