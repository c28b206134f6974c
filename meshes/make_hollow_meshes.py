"""Bodies that are not convex, and the mesh files in the folder `hollow`: `python meshes/make_hollow_meshes.py [FOLDER]`.

Lengths are in millimetres.  The mug and the bracket are each of two closed shells that overlap, as CAD programs often export
them: what is scanned is their union.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

Floats = NDArray[np.float64]
AROUND = 64  # facets around an axis

PEANUT_FOCUS, PEANUT_SIZE = 16.0, 17.0  # Cassini's oval |p - e| |p + e| = b², turned about its long axis
TORUS = 20.0, 7.0  # radius of the ring, and of its tube
MUG_RADIUS, MUG_HEIGHT, MUG_WALL = 20.0, 42.0, 4.0
HANDLE_RADIUS, HANDLE_TUBE = 13.0, 3.5
PLATE, PLATE_THICKNESS, HOLE = (40.0, 30.0), 6.0, 8.0  # of the bracket: two plates with a hole in each
L_SIZE, L_ARM, L_WIDTH = 40.0, 12.0, 16.0


def closed(rings: Floats, *, around: bool) -> trimesh.Trimesh:
    """The surface of a tube through rings (n, k, 3) of points, closed at its ends by fans, or joined to itself."""
    n, k = rings.shape[:2]
    number = np.arange(n * k).reshape(n, k)
    count = n if around else n - 1
    a, b = number[:count], np.roll(number, -1, axis=0)[:count]
    faces = [
        np.stack([a, b, np.roll(b, -1, axis=1)], axis=2),
        np.stack([a, np.roll(b, -1, axis=1), np.roll(a, -1, axis=1)], axis=2),
    ]
    points, triangles = rings.reshape(-1, 3), [part.reshape(-1, 3) for part in faces]
    if not around:
        points = np.concatenate([points, rings[[0, -1]].mean(axis=1)])
        for ring, middle in ((number[0], n * k), (number[-1][::-1], n * k + 1)):
            triangles.append(np.stack([ring, np.roll(ring, -1), np.full(k, middle)], axis=1))
    mesh = trimesh.Trimesh(points, np.concatenate(triangles), process=False)
    if mesh.volume < 0:
        mesh.invert()
    return mesh


def turned(profile: Floats, *, around: bool = False) -> trimesh.Trimesh:
    """The body of a profile (n, 2) of radius and height, turned about the z axis."""
    angle = 2 * np.pi * np.arange(AROUND) / AROUND
    rings = [np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(AROUND, z)]) for r, z in profile]
    return closed(np.array(rings), around=around)


def peanut() -> trimesh.Trimesh:
    angle = np.linspace(0, np.pi, 64)[1:-1]
    c, e, b = np.cos(2 * angle), PEANUT_FOCUS, PEANUT_SIZE
    radius = e * np.sqrt(c + np.sqrt((b / e) ** 4 - np.sin(2 * angle) ** 2))
    return turned(np.stack([radius * np.sin(angle), radius * np.cos(angle)], axis=1))


def torus() -> trimesh.Trimesh:
    angle, (ring, tube) = 2 * np.pi * np.arange(32) / 32, TORUS
    return turned(np.stack([ring + tube * np.cos(angle), tube * np.sin(angle)], axis=1), around=True)


def mug() -> trimesh.Trimesh:
    r, h, wall = MUG_RADIUS, MUG_HEIGHT, MUG_WALL
    cup = turned(
        np.array([[r - 1, 0], [r, 1], [r, h - 1], [r - 1, h], [r - wall + 1, h], [r - wall, h - 1], [r - wall, wall]])
    )
    # the handle ends in the middle of the wall
    end = np.arccos((r - wall / 2 - r) / HANDLE_RADIUS)
    along, about = np.linspace(-end, end, 40)[:, None], 2 * np.pi * np.arange(24) / 24
    reach = HANDLE_RADIUS + HANDLE_TUBE * np.cos(about)
    tube = np.stack(
        [r + reach * np.cos(along), HANDLE_TUBE * np.sin(about) + 0 * along, h / 2 + reach * np.sin(along)], axis=2
    )
    return trimesh.util.concatenate([cup, closed(tube, around=False)])


def plate() -> trimesh.Trimesh:
    """A plate in x and y with a round hole."""
    angle = 2 * np.pi * (np.arange(AROUND) + 0.5) / AROUND
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    square = circle / np.abs(circle).max(axis=1, keepdims=True)
    outer = square * np.array(PLATE) / 2
    low, high = np.zeros((AROUND, 1)), np.full((AROUND, 1), PLATE_THICKNESS)
    loops = [
        np.hstack([outline, z])
        for outline, z in ((outer, low), (outer, high), (HOLE * circle, high), (HOLE * circle, low))
    ]
    return closed(np.array(loops), around=True)


def bracket() -> trimesh.Trimesh:
    lying, upright = plate(), plate()
    upright.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2, [0, 1, 0]))
    upright.apply_translation([-PLATE[0] / 2 + PLATE_THICKNESS, 0, PLATE[0] / 2])
    return trimesh.util.concatenate([lying, upright])


def letter_l() -> trimesh.Trimesh:
    s, a = L_SIZE, L_ARM
    outline = np.array([[0, 0], [s, 0], [s, a], [a, a], [a, s], [0, s]])
    bottom, top = (np.column_stack([outline, np.full(6, z)]) for z in (0.0, L_WIDTH))
    cap = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])
    i, k = np.arange(6), (np.arange(6) + 1) % 6
    side = np.concatenate([np.stack([i, k, 6 + k], axis=1), np.stack([i, 6 + k, 6 + i], axis=1)])
    return trimesh.Trimesh(np.vstack([bottom, top]), np.vstack([cap[:, ::-1], cap + 6, side]), process=False)


BODIES: dict[str, Callable[[], trimesh.Trimesh]] = {
    "peanut.stl": peanut,
    "torus.stl": torus,
    "mug.stl": mug,
    "bracket.stl": bracket,
    "l.stl": letter_l,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path, default=Path(__file__).parent / "hollow", metavar="FOLDER")
    folder = parser.parse_args().folder
    folder.mkdir(exist_ok=True)
    for name, make in BODIES.items():
        (folder / name).write_bytes(trimesh.exchange.stl.export_stl(make()))


if __name__ == "__main__":
    main()
