"""Vertices that readers would merge: they are merged before, and surfaces stay closed in what other programs read."""

import numpy as np
import pytest
import pyvista
import trimesh
from scipy.spatial import cKDTree

import scan3d
from scan3d.files.shapes import export, ply, surface_table
from scan3d.geometry.hulls import hull
from scan3d.geometry.triangles import collapsed, kept_apart
from scan3d.surfaces import choice
from tests.shapes import box, polytope


def ring(radius, height, count, shift=0.0):
    angle = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return np.c_[radius * np.cos(angle) + shift, radius * np.sin(angle), np.full(count, height)]


def oblique_cylinder():
    return hull(np.r_[ring(10, 0, 64), ring(10, 20, 64, shift=20)])


def drop():
    return hull(
        np.concatenate([ring(8 * np.sin(t) * np.sin(t / 2), 10 * np.cos(t), 64) for t in np.linspace(0, np.pi, 40)])
    )


def oblique_cone():
    return hull(np.r_[ring(10, 0, 96), [[9, 3, 20]]])


def scanned(mesh, method, **plan):
    cloud = scan3d.reconstruct(scan3d.simulate(mesh, scan3d.Plan(**{"slices": 8, "samples": 24, **plan})))
    return scan3d.surface(cloud, method)


def written(surface, folder):
    path = folder / "surface.ply"
    path.write_bytes(ply(surface_table(surface), surface.faces, comments=("unit mm",)))
    return path


def check_readers(surface, folder, endings=(".ply", ".stl", ".obj", ".glb", ".vtp")):
    path = written(surface, folder)
    for ending in endings:
        file = path if ending == ".ply" else folder / f"exported{ending}"
        if ending != ".ply":
            export(path, file)
        scale = 1e-9 if ending == ".glb" else 1.0
        if ending != ".vtp":
            read = trimesh.load(file, force="mesh")
            assert read.is_watertight, f"trimesh {ending}"
            assert read.is_winding_consistent, f"trimesh {ending}"
            assert read.volume == pytest.approx(surface.volume * scale, rel=1e-5)
        if ending != ".glb":
            read = pyvista.read(file).clean()
            assert read.is_manifold, f"pyvista {ending}"
            assert read.n_cells == len(surface.faces)
            assert read.volume == pytest.approx(surface.volume, rel=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("body", "method", "plan"),
    [
        (oblique_cone, "bracket", {}),
        pytest.param(oblique_cone, "hull", {"axis": (1, 2, 3)}, marks=pytest.mark.trust),
        *(pytest.param(body, "bracket", {}, marks=pytest.mark.trust) for body in (drop, oblique_cylinder)),
        pytest.param(lambda: scan3d.load_mesh("meshes/lens.off"), "auto", {}, marks=pytest.mark.trust),
    ],
)
def test_surfaces_are_read_back_closed(body, method, plan, tmp_path):
    mesh = body()
    surface = scanned(mesh, method, **plan)
    assert np.isfinite(scan3d.compare(surface, mesh).volume_error)
    vertices = np.asarray(surface.vertices)
    assert cKDTree(vertices).query(vertices, k=2)[0][:, 1].min() > 1e-8
    check_readers(surface, tmp_path)


def test_points_that_coincide_are_merged_and_corners_stay():
    random = np.random.default_rng(1)
    corners = np.asarray(box(2, 3, 4).vertices)
    inwards = -np.sign(corners)[:, None] * random.uniform(1e-9, 0.9e-6, (len(corners), 500, 3))
    points = np.concatenate([(corners[:, None] + inwards).reshape(-1, 3), np.repeat(corners, 3000, axis=0)])
    points = np.concatenate([points, random.uniform(-0.9, 0.9, (300, 3))])
    points = points[random.permutation(len(points))]
    kept = kept_apart(points, 1e-6)
    assert (np.diff(kept) > 0).all()
    # one at each corner, which is the corner, and those that are near no other
    assert len(kept) == 308
    assert {tuple(corner) for corner in corners.tolist()} <= {tuple(point) for point in points[kept].tolist()}
    assert np.array_equal(kept_apart(points, 0.0), np.arange(len(points)))


@pytest.mark.parametrize("method", ["hull", "poisson"])
def test_a_surface_has_no_vertices_that_readers_merge(method):
    mesh = polytope(0, 40).subdivide()
    one, other = mesh.edges_unique[0]
    mesh.vertices[one] = mesh.vertices[other] + 1e-9
    vertices = np.asarray(choice._labelled(mesh, method, "").vertices)
    assert cKDTree(vertices).query(vertices, k=2)[0][:, 1].min() > 1e-8


@pytest.mark.parametrize("seed", range(2))
def test_a_closed_surface_stays_closed_when_edges_collapse(seed):
    mesh = polytope(seed, 40).subdivide()
    for k in range(0, len(mesh.edges_unique), 7):
        chosen = np.arange(len(mesh.vertices))
        chosen[mesh.edges_unique[k, 0]] = mesh.edges_unique[k, 1]
        left = collapsed(np.asarray(mesh.faces), chosen)
        assert len(left) <= len(mesh.faces) - 2
        assert trimesh.Trimesh(mesh.vertices, left, process=False).is_watertight
