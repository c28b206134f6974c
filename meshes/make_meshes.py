"""Convex bodies to scan, and the mesh files in this folder: `python meshes/make_meshes.py [FOLDER]`.

Lengths are in millimetres, also in the files (OBJ, OFF, PLY and STL do not contain a unit; glTF readers may assume metres).
Every body contains the origin.

The meshes are exactly convex as they are read back: points are rounded to a lattice that all five formats store
without loss, and their convex hull is computed afterwards. Orientation and facets are determined in integers, so that the
result depends neither on rounding nor on the order in which the hull is built.

`make` returns a body as a mesh with a given number of subdivisions; `distance` describes the exact smooth body.
"""

import argparse
import json
import struct
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

# Single precision (STL, GLB) and 12 decimals (OBJ, OFF) represent every multiple below 2^12 mm exactly. A finer grid would
# not be stored without loss; on a coarser one the facets would differ visibly from the smooth body. Differences between
# mathematical libraries disappear in the rounding.
GRID = 2.0**-12  # mm
SUBDIVISIONS = 36  # about 10,000 triangles per curved body: dihedral angles near 2.5 degrees, files below 1 MB

ELLIPSOID = np.array([36.0, 26.0, 18.0])  # semi-axes, mm
NEEDLE = np.array([40.0, 2.0, 2.0])
DISC = np.array([40.0, 40.0, 2.0])

# Box and ball whose Minkowski sum the body is: half edges of the box, radius of the ball, mm.
SPHERE = np.array([0.0, 0.0, 0.0]), 25.0
CAPSULE = np.array([0.0, 0.0, 20.0]), 10.0
ROUNDED_BOX = np.array([20.0, 14.0, 8.0]), 6.0

EGG_LENGTH, EGG_WIDTH = 28.0, 21.0  # half length along z and nominal half width, mm
EGG_BLUNTNESS = 0.25  # convex up to 1/3; the upper end's radius of curvature is (1 + 0.25) / (1 - 0.25) of the lower's

# Face normals of a polyhedron without symmetry, over the distances of its planes from the origin (1/mm).
PEBBLE_PLANES = 1e-3 * np.array(
    [[-30, -37, -100], [13, -64, -15], [-21, 41, 65], [49, -13, -17], [18, 58, -50], [28, -14, 64], [-54, -20, 30]]
)
PEBBLE_SIZE = 0.4  # the larger, the closer the pebble is to the polyhedron

LENS_RADIUS, LENS_OFFSET = 50.0, 40.0  # of the two balls, centred at z = -40 and 40: a rim of radius 30, mm


def unit(vectors: Floats) -> Floats:
    """Return vectors (n, 3) scaled to length 1."""
    scaled: Floats = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return scaled


def directions(subdivisions: int) -> Floats:
    """Return unit vectors (n, 3), evenly spread: an octahedron with subdivided edges, projected onto a sphere.

    Their hull has 8 subdivisions² triangles, whose areas differ by a factor of at most 1.8. An icosahedron is not used because
    rims and seams of the bodies lie in the coordinate planes, which contain evenly spaced vertices of an octahedron.
    """
    i, j = np.mgrid[-subdivisions : subdivisions + 1, -subdivisions : subdivisions + 1].reshape(2, -1)
    k = subdivisions - np.abs(i) - np.abs(j)
    upper = np.column_stack([i, j, k])[k >= 0]
    lattice = np.concatenate([upper, upper * [1, 1, -1]])
    # The sine makes the spacing along the edges even, as an angle.
    return unit(np.sin(0.5 * np.pi * lattice / subdivisions))


def rings(sides: int, radius: float, heights: list[float], turn: float = 0.0) -> Floats:
    """Return the corners (n, 3) of regular polygons about the z axis, all turned by `turn` of a step, in mm."""
    angle = 2 * np.pi * (np.arange(sides) + turn) / sides
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    return np.vstack([np.column_stack([x, y, np.full(sides, height)]) for height in heights])


def ellipsoid_points(semi_axes: Floats, subdivisions: int) -> Floats:
    """Return points (n, 3) of the ellipsoid, in mm.

    Stretched points of the sphere are sparse at the ends of a needle; points with evenly spread normals are sparse on its
    flanks. The square root is a compromise between the two.
    """
    return semi_axes * unit(np.sqrt(semi_axes) * directions(subdivisions))


def rounded_points(box: tuple[Floats, float], subdivisions: int) -> Floats:
    """Return points (n, 3) of the Minkowski sum of a box and a ball: an octant of the ball at each corner, in mm."""
    half_edges, radius = box
    ball = directions(subdivisions)
    octants = [np.array([x, y, z]) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    return np.vstack([octant * half_edges + radius * ball[np.all(octant * ball >= 0, axis=1)] for octant in octants])


def egg_points(subdivisions: int) -> Floats:
    """Return points (n, 3) of the egg: an ellipsoid of revolution whose width grows with the height, in mm."""
    x, y, z = directions(subdivisions).T
    width = EGG_WIDTH * np.sqrt(1 + EGG_BLUNTNESS * z)
    return np.column_stack([width * x, width * y, EGG_LENGTH * z])


def pebble_points(subdivisions: int) -> Floats:
    """Return points (n, 3) of the pebble, where rays from the origin leave it, in mm."""
    rays = directions(subdivisions)
    radius = np.full(len(rays), 100.0)
    step = radius
    # The level is convex along a ray, so that Newton's method converges from outside without overshooting.
    while np.max(np.abs(step)) > 1e-6 * GRID:
        level, gradient = pebble_level(radius[:, None] * rays)
        step = level / np.sum(gradient * rays, axis=1)
        radius = radius - step
    return radius[:, None] * rays


def lens_points(subdivisions: int) -> Floats:
    """Return points (n, 3) of the lens, each half of the sphere mapped to a cap with proportional areas, in mm."""
    x, y, z = directions(subdivisions).T
    cap = 1 - LENS_OFFSET / LENS_RADIUS
    cosine = 1 - cap * (1 - np.abs(z))
    stretch = LENS_RADIUS * np.sqrt(cap * (1 + cosine) / (1 + np.abs(z)))
    return np.column_stack([stretch * x, stretch * y, np.sign(z) * (LENS_RADIUS * cosine - LENS_OFFSET)])


def gem_points() -> Floats:
    """Return the corners (73, 3) of a brilliant with a crown at 35 degrees and a pavilion at 41, in mm.

    Table and girdle are rotated against each other, so that all facets between them are triangles: four rounded corners
    would not be coplanar.
    """
    table = rings(24, radius=11.0, heights=[6.75], turn=0.5)
    girdle = rings(24, radius=20.0, heights=[-0.5, 0.5])
    culet = [0.0, 0.0, -17.75]
    return np.vstack([table, girdle, culet])


BODIES: dict[str, tuple[str, Callable[[int], Floats]]] = {  # file format, points for so many subdivisions
    "sphere": (".ply", partial(rounded_points, SPHERE)),
    "ellipsoid": (".ply", partial(ellipsoid_points, ELLIPSOID)),
    "egg": (".stl", egg_points),
    "pebble": (".obj", pebble_points),
    "lens": (".off", lens_points),
    "capsule": (".stl", partial(rounded_points, CAPSULE)),
    "rounded_box": (".glb", partial(rounded_points, ROUNDED_BOX)),
    "needle": (".ply", partial(ellipsoid_points, NEEDLE)),
    "disc": (".ply", partial(ellipsoid_points, DISC)),
    "cylinder": (".off", lambda n: rings(4 * n, radius=20.0, heights=[-25.0, 25.0])),
    "cube": (".stl", lambda _: rings(4, radius=20.0 * np.sqrt(2), heights=[-20.0, 20.0], turn=0.5)),
    "hexagonal_prism": (".obj", lambda _: rings(6, radius=20.0, heights=[-30.0, 30.0])),
    "gem": (".glb", lambda _: gem_points()),
}


def ellipsoid_level(semi_axes: Floats, points: Floats) -> tuple[Floats, Floats]:
    """Return level (n,), zero on the ellipsoid, positive outside, and its gradient (n, 3) at points (n, 3) in mm."""
    return np.sum((points / semi_axes) ** 2, axis=1) - 1, 2 * points / semi_axes**2


def rounded_level(box: tuple[Floats, float], points: Floats) -> tuple[Floats, Floats]:
    """Return level (n,) and gradient (n, 3) of the sum of a box and a ball at points (n, 3) outside the box, in mm."""
    half_edges, radius = box
    offset = points - np.clip(points, -half_edges, half_edges)
    reach = np.linalg.norm(offset, axis=1)
    return reach - radius, offset / reach[:, None]


def egg_level(points: Floats) -> tuple[Floats, Floats]:
    """Return level (n,) and gradient (n, 3) of the egg at points (n, 3) in mm."""
    across, along = points[:, :2] / EGG_WIDTH, points[:, 2] / EGG_LENGTH
    taper = 1 + EGG_BLUNTNESS * along
    level = np.sum(across**2, axis=1) - (1 - along**2) * taper
    slope = 2 * along * taper - EGG_BLUNTNESS * (1 - along**2)
    return level, np.column_stack([2 * across / EGG_WIDTH, slope / EGG_LENGTH])


def pebble_level(points: Floats) -> tuple[Floats, Floats]:
    """Return level (n,) and gradient (n, 3) of the pebble at points (n, 3) in mm.

    The logarithm of a sum of exponentials is smooth and convex, strictly so here because the planes span space.
    """
    terms = np.exp(points @ PEBBLE_PLANES.T)
    return np.log(np.mean(terms, axis=1)) - PEBBLE_SIZE, terms @ PEBBLE_PLANES / np.sum(terms, axis=1, keepdims=True)


def lens_level(points: Floats) -> tuple[Floats, Floats]:
    """Return level (n,) and gradient (n, 3) of the lens at points (n, 3) in mm; on the rim it is the upper cap's."""
    offset = points + np.outer(np.where(points[:, 2] < 0, -LENS_OFFSET, LENS_OFFSET), [0, 0, 1])
    reach = np.linalg.norm(offset, axis=1)
    return reach - LENS_RADIUS, offset / reach[:, None]


SMOOTH: dict[str, Callable[[Floats], tuple[Floats, Floats]]] = {
    "sphere": partial(rounded_level, SPHERE),
    "ellipsoid": partial(ellipsoid_level, ELLIPSOID),
    "egg": egg_level,
    "pebble": pebble_level,
    "lens": lens_level,
    "capsule": partial(rounded_level, CAPSULE),
    "rounded_box": partial(rounded_level, ROUNDED_BOX),
    "needle": partial(ellipsoid_level, NEEDLE),
    "disc": partial(ellipsoid_level, DISC),
}


def distance(name: str, points: Floats) -> Floats:
    """Return how far (n,) points (n, 3) near its surface lie outside a body in `SMOOTH`, to first order, in mm."""
    level, gradient = SMOOTH[name](points)
    outside: Floats = level / np.linalg.norm(gradient, axis=1)
    return outside


def normal(name: str, points: Floats) -> Floats:
    """Return the outward unit normals (n, 3) of a body in `SMOOTH` at points (n, 3) on it, in mm."""
    return unit(SMOOTH[name](points)[1])


def make(name: str, subdivisions: int = SUBDIVISIONS) -> trimesh.Trimesh:
    """Return the body as a convex mesh in mm; curved bodies have about 8 subdivisions² triangles.

    Raises ValueError for a name that is not in `BODIES`.
    """
    if name not in BODIES:
        raise ValueError(f"no body is called {name!r}: choose one of {', '.join(BODIES)}")
    _, points = BODIES[name]
    return convex_mesh(points(subdivisions))


def convex_mesh(points: Floats) -> trimesh.Trimesh:
    """Return the hull of points (n, 3) in mm, rounded to the grid, about the origin inside it."""
    lattice: Integers = np.unique(np.rint(points / GRID).astype(np.int64), axis=0)
    triangles = ConvexHull(lattice.astype(float)).simplices
    corners = lattice[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    offsets = np.sum(normals * corners[:, 0], axis=1)
    inward = offsets < 0
    triangles[inward] = triangles[inward, ::-1]

    # The diagonals with which Qhull triangulates a flat facet depend on the order of its computation, so that facets are
    # triangulated again. This is exact: for coordinates below 2^18 no number here exceeds 2^60.
    planes = np.column_stack([normals, offsets]) // (np.gcd.reduce(normals, axis=1) * np.sign(offsets))[:, None]
    _, facet, sizes = np.unique(planes, axis=0, return_inverse=True, return_counts=True)
    facets = np.split(triangles[np.argsort(facet.ravel(), kind="stable")], np.cumsum(sizes)[:-1])
    faces = np.array(sorted(triangle for facet in facets for triangle in fan(facet.tolist())))
    used, faces = np.unique(faces, return_inverse=True)
    return trimesh.Trimesh(lattice[used] * GRID, faces.reshape(-1, 3), process=False)


def fan(triangles: list[list[int]]) -> list[tuple[int, int, int]]:
    """Triangulate a convex facet, given by any triangulation of it, as a fan about its first corner."""
    edges = {edge for a, b, c in triangles for edge in ((a, b), (b, c), (c, a))}
    following = {start: end for start, end in edges if (end, start) not in edges}
    rim = [min(following)]
    while (corner := following[rim[-1]]) != rim[0]:
        rim.append(corner)
    return [(rim[0], b, c) for b, c in pairwise(rim[1:])]


def rows(prefix: str, table: Floats | Integers) -> str:
    """Return one line of text for each row of a table (n, 3), with all digits of the numbers."""
    return "".join(f"{prefix}{a} {b} {c}\n" for a, b, c in table.tolist())


def glb(mesh: trimesh.Trimesh) -> bytes:
    """Return the mesh, in millimetres, as binary glTF 2.0, which is in metres."""
    vertices, faces = mesh.vertices.astype("<f4").tobytes(), mesh.faces.astype("<u4").tobytes()
    count, (low, high) = len(mesh.vertices), mesh.bounds.tolist()
    single, unsigned = 5126, 5125  # the format's numbers for component types
    scene = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "scale": [0.001, 0.001, 0.001]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": single, "type": "VEC3", "count": count, "min": low, "max": high},
            {"bufferView": 1, "componentType": unsigned, "type": "SCALAR", "count": mesh.faces.size},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": len(vertices)},
            {"buffer": 0, "byteOffset": len(vertices), "byteLength": len(faces)},
        ],
        "buffers": [{"byteLength": len(vertices) + len(faces)}],
    }
    text = json.dumps(scene).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(vertices) + len(faces), b"BIN\0") + vertices + faces
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def write(mesh: trimesh.Trimesh, file: Path) -> None:
    """Write the mesh in the format that the file's name ends with: `.glb`, `.obj`, `.off`, `.ply` or `.stl`."""
    vertices, faces = mesh.vertices, mesh.faces
    # Three formats are written here, because those of trimesh differ between its versions.
    if file.suffix == ".glb":
        file.write_bytes(glb(mesh))
    elif file.suffix == ".obj":
        file.write_bytes((rows("v ", vertices) + rows("f ", faces + 1)).encode())
    elif file.suffix == ".off":
        counts = f"OFF\n{len(vertices)} {len(faces)} 0\n"
        file.write_bytes((counts + rows("", vertices) + rows("3 ", faces)).encode())
    else:
        mesh.export(file)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Make the convex bodies to scan.")
    parser.add_argument("folder", nargs="?", type=Path, default=Path(__file__).parent, help="where to write them")
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    for name, (suffix, _) in BODIES.items():
        file = folder / f"{name}{suffix}"
        write(make(name), file)
        print(file)
