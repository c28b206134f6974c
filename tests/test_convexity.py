"""The deepest dent of a body, against dents of known depth and brute force."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from mesh_files import assert_sound, error, save
from shapes import as_mesh, box, dimpled_box, letter_l, rotation

from scan3d.files.meshes import load_mesh
from scan3d.geometry.convexity import DENT_TOLERANCE


def dent_of(path):
    return load_mesh(path, hull=True).metadata["dent"]


@pytest.mark.parametrize("depth", [2e-6, 1e-5, 1e-3, 0.2])
def test_a_dimple_of_known_depth(tmp_path, depth):
    # 1e-3: the precision promised; 1e-7: rounding of the file to float32
    path = save(tmp_path, dimpled_box(depth), "dimple.ply")
    assert dent_of(path) == pytest.approx(depth, rel=1e-3, abs=1e-7)
    if depth < DENT_TOLERANCE * np.sqrt(3):
        body = load_mesh(path)
        assert_sound(body)
        assert body.metadata["dent_relative"] == pytest.approx(depth / np.sqrt(3), rel=1e-3, abs=1e-7)
    else:
        message = error(path)
        assert f"{depth:.3g} deep" in message
        assert "--hull" in message
        place = [float(x) for x in message.partition("at (")[2].partition(")")[0].split(",")]
        np.testing.assert_allclose(place, [0.5 - depth, 0, 0], atol=1e-3)


def test_a_flipped_diagonal(tmp_path):
    # every vertex lies on the hull; with dihedral angle δ, sin δ = 2/3, the middle of the flipped edge is a √3/2 sin(δ)/2 deep
    ico = trimesh.creation.icosahedron()
    (first, second), (a, b) = ico.face_adjacency[0], ico.face_adjacency_edges[0]
    c, d = (np.setdiff1d(ico.faces[f], [a, b])[0] for f in (first, second))
    faces = np.vstack([np.delete(ico.faces, [first, second], axis=0), [[a, c, d], [b, c, d]]])
    path = save(tmp_path, as_mesh(ico.vertices, faces))
    edge = np.linalg.norm(ico.vertices[a] - ico.vertices[b])
    assert dent_of(path) == pytest.approx(edge * np.sqrt(3) / 6, rel=1e-3)
    middle = ico.vertices[[c, d]].mean(axis=0)
    place = [float(x) for x in error(path).partition("at (")[2].partition(")")[0].split(",")]
    np.testing.assert_allclose(place, middle, atol=0.02)


def test_a_dent_inside_a_triangle_against_brute_force(tmp_path):
    # a cavity whose deepest place is neither at a vertex nor on an edge: a small tetrahedron in a large random body
    rng = np.random.default_rng(4)
    hull = trimesh.convex.convex_hull(rng.normal(size=(40, 3)))
    inner = trimesh.creation.icosahedron().apply_scale(0.8)
    mesh = trimesh.util.concatenate([hull, inner])
    weights = rng.dirichlet(np.ones(3), 4000)
    points = np.einsum("pc,tcx->tpx", weights, inner.triangles).reshape(-1, 3)
    normals = hull.face_normals
    depth = (np.einsum("fx,fx->f", normals, hull.triangles[:, 0]) - points @ normals.T).min(axis=1).max()
    assert dent_of(save(tmp_path, mesh)) == pytest.approx(depth, rel=5e-3)  # as finely as brute force samples


@pytest.mark.parametrize(
    ("mesh", "depth"),
    [
        (letter_l(), 1 / np.sqrt(2)),
        (trimesh.creation.torus(1, 0.3, major_sections=64, minor_sections=32), 0.3),
        (
            trimesh.util.concatenate([box(), as_mesh(box().vertices + np.array([2, 0, 0]), box().faces)]),
            0.5,
        ),  # two bodies
        (trimesh.util.concatenate([box(), as_mesh(box().vertices / 2, box().faces)]), 0.25),  # a cavity
    ],
    ids=["L", "torus", "two cubes", "hollow cube"],
)
@pytest.mark.parametrize("seed", [None, 0])
def test_bodies_that_are_not_convex(tmp_path, mesh, depth, seed):
    turned = mesh if seed is None else as_mesh(mesh.vertices @ rotation(seed).T, mesh.faces)
    path = save(tmp_path, turned)
    assert dent_of(path) == pytest.approx(depth, rel=1.5e-3)
    assert "isn't convex" in error(path)
    body = load_mesh(path, hull=True)
    assert_sound(body)
    assert body.metadata["hull"] is True
    assert body.metadata["dent_relative"] == pytest.approx(depth / np.linalg.norm(turned.extents), rel=1.5e-3)
    assert body.volume == pytest.approx(turned.convex_hull.volume, rel=1e-6)


@given(
    seed=st.integers(0, 2**32 - 1),
    depth=st.floats(1e-3, 0.2),
    exponent=st.integers(-20, 20),
    shift=st.tuples(*[st.floats(-2, 2)] * 3),
)
@settings(max_examples=25)
def test_a_dent_moves_with_its_body(tmp_path_factory, seed, depth, exponent, shift):
    mesh = dimpled_box(depth)
    moved = as_mesh(2.0**exponent * (mesh.vertices @ rotation(seed).T + shift), mesh.faces)
    dent = dent_of(save(tmp_path_factory.getbasetemp(), moved, "moved.ply")) / 2.0**exponent
    assert dent == pytest.approx(depth, rel=1e-3, abs=1e-6)  # float32 file


def test_qhull_slivers_are_oriented(tmp_path):
    # four copies of every vertex, 1e-15 apart: facets whose normals are all rounding
    mesh = trimesh.creation.cylinder(1, 2, sections=500)
    points = np.tile(mesh.vertices, (4, 1)) + np.random.default_rng(0).normal(size=(4 * len(mesh.vertices), 3)) * 1e-15
    path = tmp_path / "cylinder.obj"
    rows = [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
    faces = np.vstack([mesh.faces + i * len(mesh.vertices) for i in range(4)]) + 1
    path.write_text("\n".join(rows + [f"f {a} {b} {c}" for a, b, c in faces.tolist()]))
    assert_sound(load_mesh(path))
