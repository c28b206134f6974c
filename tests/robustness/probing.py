"""Everyday bodies that are not convex, scanned by default, against what straight rods from outside can reach of them.

    python -m tests.robustness.probing [--turns 3] [--noise 1e-4] [--only mug bowl]

Each is turned at random, with friction from 0 to 0.4.  A place of the truth counts as touched with a contact within 2 % of the
diagonal, and as in reach if one of 200 straight lines leads there.  Printed are, in per cent: what is in reach, what of it is
touched, the distances between what is in reach and the surface, both ways and unknown surface included, at most and in the
mean, free lines that are deeper than 0.5 % of the diagonal inside, the largest distance of what is not called unknown, what
is known, and under noise which of the probed contacts are within two standard deviations, as stated, of the body.  The exit
code is 1 if a scan fails, if less than 95 % of what is in reach is touched or, in the median body, of the probed contacts are
within their errors, or if something that is not called unknown is farther off than 3 %.
"""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import numpy as np
import pyvista
import trimesh
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import scan3d
from scan3d.bounds.free_space import passed_lines
from scan3d.geometry.crossings import first_crossings
from scan3d.geometry.distance import locator
from scan3d.geometry.hulls import turns
from scan3d.geometry.triangles import longest_first
from scan3d.spatial.bodies import sphere_directions
from tests.robustness import options
from tests.robustness.everyday import EVERYDAY, mesh_of


class Found(NamedTuple):
    """Shares and distances, the latter in diagonals."""

    reach: float
    touched: float
    largest: float
    mean: float
    inside: float
    not_unknown: float
    euler: int
    known: float
    within: float
    seconds: float


def in_reach(mesh: Any, places: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(p,) whether straight lines lead from outside to places of a mesh."""
    size = float(np.linalg.norm(mesh.extents))
    found = np.zeros(len(places), dtype=bool)
    for along in sphere_directions(200).T:
        rows = np.flatnonzero(~found & (normals @ along < 0))
        met, _ = first_crossings(mesh, places[rows] - 2 * size * along, along)
        found[rows[met >= 2 * size * (1 - 1e-9)]] = True
    return found


def signed(mesh: Any, places: np.ndarray) -> np.ndarray:
    return np.array(pyvista.PolyData(places).compute_implicit_distance(pyvista.wrap(mesh))["implicit_distance"])


def within_errors(mesh: Any, cloud: scan3d.Cloud) -> float:
    """The share of the probed contacts that are within two of their standard deviations of a mesh; NaN for exact data."""
    if cloud.place_sd is None:
        return np.nan
    assert cloud.probed is not None
    probed = cloud.select(cloud.probed)
    corners = np.asarray(mesh.triangles)
    corners = np.take_along_axis(corners, longest_first(corners)[:, :, None], axis=1)
    off = probed.points - locator(corners)(probed.points)[1]
    # what is off by d in the direction u is within two deviations if d² <= 4 u·Cu
    square = (off**2).sum(axis=1)
    return float((square**2 <= 4 * np.einsum("ni,nij,nj->n", off, probed.covariance, off)).mean())


def trial(mesh: Any, seed: int, noise: float) -> Found:
    """One scan."""
    size, start = float(np.linalg.norm(mesh.extents)), time.process_time()
    result = scan3d.scan(mesh, friction=(0.0, 0.4), noise=noise, seed=seed)
    seconds = time.process_time() - start
    cloud, surface = result.cloud, result.surface
    places, face = trimesh.sample.sample_surface(mesh, 3000, seed=seed)
    reachable = in_reach(mesh, places, mesh.face_normals[face])
    near = cKDTree(cloud.points).query(places)[0] <= 0.02 * size
    there = np.abs(signed(surface, places))[reachable] / size
    known = surface.vertex_attributes["known"]
    on_surface = trimesh.sample.sample_surface(surface, 3000, seed=seed)
    class_of = known[surface.faces[on_surface[1]]].min(axis=1)
    back = np.abs(signed(mesh, on_surface[0])) / size
    random, lines = np.random.default_rng(seed), passed_lines(result.recording, cloud)
    lines = lines[random.integers(len(lines), size=3000)]
    part = random.uniform(0, 1, (len(lines), 1))
    free = lines[:, 0] + part * (lines[:, 1] - lines[:, 0])
    # the sign of the distance is wrong far from some edges, and winding numbers are not
    deep = free[signed(surface, free) < -0.005 * size]
    inside = [turns(surface.triangles.view(np.ndarray) - place) > 0.5 for place in deep]
    return Found(
        float(reachable.mean()),
        float(near[reachable].mean()),
        float(max(there.max(), back.max())),
        float((there.mean() + back.mean()) / 2),
        sum(inside) / len(free),
        float(back[class_of > 0].max(initial=0.0)),
        int(surface.euler_number),
        result.report["coverage"]["known"],
        within_errors(mesh, cloud),
        seconds,
    )


def main() -> int:
    given = options(__doc__, turns=3, first=0, noise=0.0, only=list(EVERYDAY))
    found, right, failed = [], [], False
    print(
        "body            seed  reach touched largest   mean  inside  not unknown  known within Euler    s", flush=True
    )
    for name in given.only:
        for seed in range(given.first, given.first + given.turns):
            mesh = mesh_of(name)
            turn = np.eye(4)
            if seed:
                turn[:3, :3] = Rotation.random(rng=np.random.default_rng([seed, len(name)])).as_matrix()
            mesh.apply_transform(turn)
            try:
                one = trial(mesh, seed, given.noise)
            except Exception as error:  # each is a failure, and the others are still wanted
                print(f"{name:15} {seed:4}  {type(error).__name__}: {error}", flush=True)
                failed = True
                continue
            found.append(one)
            right.append(one.euler == EVERYDAY[name].euler)
            numbers = [100 * value for value in (*one[:6], one.known, one.within)]
            print(
                f"{name:15} {seed:4} {numbers[0]:6.1f} {numbers[1]:7.2f} {numbers[2]:7.2f} {numbers[3]:6.3f} {numbers[4]:7.3f} "
                f"{numbers[5]:12.2f} {numbers[6]:6.1f} {numbers[7]:6.2f} "
                f"{one.euler:3} {'' if right[-1] else 'x':2} {one.seconds:4.0f}",
                flush=True,
            )
    table = np.array(found)
    print("median         ", *(f"{value:.5g}" for value in np.median(table, axis=0)))
    print("worst touched, largest:", table[:, 1].min(), table[:, 2].max(), "Euler numbers right:", np.mean(right))
    imprecise = given.noise > 0 and np.median(table[:, 8]) < 0.95
    return int(failed or imprecise or table[:, 1].min() < 0.95 or table[:, 5].max() > 0.03)


if __name__ == "__main__":
    raise SystemExit(main())
