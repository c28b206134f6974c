"""How far a mesh is from convex: by its edges, its hull's planes and its deepest dent, against known depths and brute force."""

import numpy as np
import pytest
import trimesh
from mesh_files import assert_sound, save
from sample_bodies import MESHES
from scipy.spatial import ConvexHull
from shapes import as_mesh, ball, box, dented, dimpled_box, inscribed_radius, letter_l, moved, pinhole, rotation

import scan3d
from scan3d.files.meshes import judge_mesh, load_mesh, mesh_itself, read_mesh
from scan3d.geometry.hulls import (
    CONVEX_DEPTH,
    DENT_TOLERANCE,
    against_hull,
    distance_to_hull,
    is_convex,
    outward_faces,
    planes_by_edges,
    prepare_facets,
)
from scan3d.units import length

BODIES = [MESHES / name for name in ("cube.stl", "cylinder.off", "gem.glb")]


def facets_of(mesh):
    """The facets of a mesh, at unit size about the middle of its bounding box."""
    low, high = mesh.bounds
    return prepare_facets(mesh, (low + high) / 2, float(np.linalg.norm(high - low)))


def by_edges(mesh):
    facets = facets_of(mesh)
    return planes_by_edges(facets.faces, facets.corners, facets.normals)


def dent_of(mesh):
    """The largest depth of a vertex below the hull, at unit size, by all planes of Qhull."""
    vertices = facets_of(mesh).vertices
    equations = ConvexHull(vertices).equations
    return -float((vertices @ equations[:, :3].T + equations[:, 3]).max(axis=1).min())


@pytest.mark.parametrize("path", BODIES, ids=[path.name for path in BODIES])
def test_the_meshes_that_come_along_are_as_convex_as_by_qhull(path, monkeypatch):
    facets = facets_of(read_mesh(path))
    planes, bound = planes_by_edges(facets.faces, facets.corners, facets.normals)
    # edges between coplanar faces may be reflex by rounding, each of some thousands by 1e-13
    assert bound < 1e-8
    above = facets.vertices @ planes[:, :3].T - planes[:, 3]
    assert above.max() <= 0  # the planes support the hull
    assert above.max(axis=0).min() > -1e-8
    verdict = against_hull(facets)[1] <= CONVEX_DEPTH
    monkeypatch.setattr("scan3d.geometry.hulls.planes_by_edges", lambda *_: (np.empty((0, 4)), np.inf))
    assert verdict
    assert verdict == (against_hull(facets)[1] <= CONVEX_DEPTH)


@pytest.mark.parametrize("inside_out", [False, True])
def test_a_strictly_convex_body_is_its_hull_to_rounding_and_qhull_is_not_asked(inside_out, monkeypatch):
    monkeypatch.setattr("scan3d.geometry.hulls.ConvexHull", None)
    body = moved(ball(3, 500), (5.0, 6.0, 7.0), rotation=rotation(2))
    body = trimesh.Trimesh(body.vertices, body.faces[:, ::-1] if inside_out else body.faces, process=False)
    facets = facets_of(body)
    planes, bound = against_hull(facets)
    assert bound <= 1e-15
    height = np.einsum("mx,mkx->mk", planes[:, :3], facets.corners) - planes[:, 3:]
    assert np.abs(height).max() < 1e-12
    assert (facets.vertices @ planes[:, :3].T <= planes[:, 3]).all()
    assert distance_to_hull(body) <= 1e-14


def test_random_small_dents_are_bounded_from_above():
    rng = np.random.default_rng(4)
    sphere, proven = trimesh.creation.icosphere(2), 0
    for size in 10.0 ** rng.uniform(-8, -1, 60):
        mesh = as_mesh(sphere.vertices * (1 + size * rng.standard_normal((len(sphere.vertices), 1))), sphere.faces)
        planes, bound = by_edges(mesh)
        assert bound >= dent_of(mesh)
        if len(planes):
            proven += 1
            assert (facets_of(mesh).vertices @ planes[:, :3].T <= planes[:, 3]).all()
    assert proven > 20


def rows(faces):
    """Triangles as a set, whichever corner comes first."""
    return {tuple(np.roll(face, -face.argmin()).tolist()) for face in np.asarray(faces)}


@pytest.mark.parametrize("inside_out", [False, True])
def test_the_faces_of_a_strictly_convex_body_are_the_facets_of_its_hull_turned_outwards(inside_out):
    body = ball(7, 300)
    points, faces = body.vertices.view(np.ndarray), body.faces.view(np.ndarray)
    outward = outward_faces(points, faces[:, ::-1] if inside_out else faces)
    hull = ConvexHull(points)
    assert rows(np.sort(outward, axis=1)) == rows(np.sort(hull.simplices, axis=1))
    assert trimesh.Trimesh(points, outward, process=False).volume == pytest.approx(hull.volume, rel=1e-12)


@pytest.mark.parametrize("depth", [1e-10, 1e-6, 1e-2])
def test_a_shallow_dent_is_bounded_from_above_and_not_by_much(depth):
    body = dented(depth)
    bound = distance_to_hull(body)
    # the dent's own depth; the argument allows for three times that of a face's middle, which lies at a third, and R / r
    assert depth * (1 - 1e-3) <= bound <= 2 * np.sqrt(3) * depth * (1 + 1e-3)


@pytest.mark.parametrize("side", [1e-3, 1e-5])
def test_a_pinhole_counts_by_its_size(side):
    mesh, hole = pinhole(side)
    # the middle of the hole lies on the hull's surface, and the mesh is at its edge
    assert inscribed_radius(hole) <= distance_to_hull(mesh) < 20 * side


def dent_of_file(path):
    return load_mesh(path, hull=True).metadata["dent"]


@pytest.mark.parametrize("depth", [2e-6, 1e-3])
def test_a_dimple_of_known_depth(tmp_path, depth):
    # 1e-3: the precision promised; 1e-7: rounding of the file to float32
    path = save(tmp_path, dimpled_box(depth), "dimple.ply")
    assert dent_of_file(path) == pytest.approx(depth, rel=1e-3, abs=1e-7)
    if depth < DENT_TOLERANCE * np.sqrt(3):
        body = load_mesh(path)
        assert_sound(body)
        assert body.metadata["dent_relative"] == pytest.approx(depth / np.sqrt(3), rel=1e-3, abs=1e-7)
    else:
        assert not is_convex(load_mesh(path))
        place = load_mesh(path, hull=True).metadata["filled"]["at"]
        np.testing.assert_allclose(place, [0.5 - depth, 0, 0], atol=1e-3)


def test_a_dent_inside_a_triangle_against_brute_force(tmp_path):
    # a cavity whose deepest place is neither at a vertex nor on an edge: a small tetrahedron in a large random body
    rng = np.random.default_rng(4)
    hull = trimesh.convex.convex_hull(rng.normal(size=(40, 3)))
    inner = trimesh.creation.icosahedron().apply_scale(0.8)
    inner.invert()  # a part within the body would be no dent
    mesh = trimesh.util.concatenate([hull, inner])
    weights = rng.dirichlet(np.ones(3), 4000)
    points = np.einsum("pc,tcx->tpx", weights, inner.triangles).reshape(-1, 3)
    normals = hull.face_normals
    depth = (np.einsum("fx,fx->f", normals, hull.triangles[:, 0]) - points @ normals.T).min(axis=1).max()
    assert dent_of_file(save(tmp_path, mesh)) == pytest.approx(depth, rel=5e-3)  # as finely as brute force samples


@pytest.mark.parametrize(
    ("mesh", "depth"),
    [
        (letter_l(), 1 / np.sqrt(2)),
        (trimesh.creation.torus(1, 0.3, major_sections=64, minor_sections=32), 0.3),
        (
            trimesh.util.concatenate([box(), as_mesh(box().vertices + np.array([2, 0, 0]), box().faces)]),
            0.5,
        ),  # two bodies
        (trimesh.util.concatenate([box(), as_mesh(box().vertices / 2, box().faces[:, ::-1])]), 0.25),  # a cavity
    ],
    ids=["L", "torus", "two cubes", "hollow cube"],
)
def test_bodies_that_are_not_convex(tmp_path, mesh, depth):
    turned = as_mesh(mesh.vertices @ rotation(0).T, mesh.faces)
    path = save(tmp_path, turned)
    assert dent_of_file(path) == pytest.approx(depth, rel=1.5e-3)
    itself = load_mesh(path)
    assert not is_convex(itself)
    assert itself.volume == pytest.approx(turned.volume, rel=1e-6)
    assert len(itself.faces) == len(turned.faces)
    body = load_mesh(path, hull=True)
    assert_sound(body)
    assert body.metadata["hull"] is True
    assert body.metadata["dent_relative"] == pytest.approx(depth / np.linalg.norm(turned.extents), rel=1.5e-3)
    assert body.volume == pytest.approx(turned.convex_hull.volume, rel=1e-6)


SETTINGS = dict(slices=6, sweeps=4, samples=16, method="hull")
HULL = "convex hull of the mesh"
DEPTH = 0.01


def cube_with_a_dent():
    """With all faces outward: those in the dent of `dimpled_box` are not."""
    mesh = dimpled_box(DEPTH)
    return as_mesh(mesh.vertices, np.vstack([mesh.faces[:-4], mesh.faces[-4:, ::-1]]))


@pytest.fixture(scope="module")
def dimpled(tmp_path_factory):
    return save(tmp_path_factory.mktemp("bodies"), cube_with_a_dent(), "dimpled.off")


@pytest.fixture(scope="module")
def scanned():
    return scan3d.scan(letter_l(), hull=True, **SETTINGS)


def test_of_a_hull_over_faces_that_are_turned_inwards_the_filled_volume_is_not_known(dimpled):
    assert len(mesh_itself(load_mesh(dimpled, hull=True)).faces) == 14
    turned = judge_mesh(dimpled_box(DEPTH), hull=True)
    assert turned.volume == pytest.approx(1)
    assert turned.metadata["filled"]["volume_relative"] is None


def test_without_the_hull_dents_stay_and_faces_are_turned_outwards(dimpled):
    for body in (load_mesh(dimpled), judge_mesh(dimpled_box(DEPTH)), judge_mesh(load_mesh(dimpled))):
        assert body.volume == pytest.approx(1 - DEPTH / 3)
        assert not is_convex(body)
        assert "filled" not in body.metadata
    assert is_convex(judge_mesh(load_mesh(dimpled), hull=True))


def test_the_report_has_the_distance_to_the_mesh_itself(scanned):
    report = scanned.report
    assert report["mesh"]["scanned"] == report["hausdorff"]["to"] == HULL
    itself = scan3d.compare(scanned.surface, letter_l())
    assert report["hausdorff"]["mesh_itself"] == {
        "two_sided": itself.hausdorff,
        "surface_to_mesh": itself.surface_to_mesh,
        "mesh_to_surface": itself.mesh_to_surface,
        "relative": itself.relative,
    }
    # the reentrant edge lies 1/√2 deep; the slices leave out less than that of the hull
    assert itself.hausdorff > np.sqrt(0.5) - report["hausdorff"]["two_sided"]
    assert report["mesh"]["filled"]["depth"] == pytest.approx(np.sqrt(0.5), rel=1e-3)
    assert report["mesh"]["filled"]["volume_relative"] == pytest.approx(1 - 9 / 10.5)


def test_what_is_printed_says_what_it_refers_to(scanned):
    rows = dict(scanned.summary())
    assert rows["scanned"] == f"the {HULL}, which fills dents up to 707 µm deep, 14 % of its volume"
    assert rows["Hausdorff distance"].endswith(f"to the {HULL}")
    assert rows["contact error"].endswith(f"from the {HULL}")
    itself = length(scanned.report["hausdorff"]["mesh_itself"]["two_sided"], "mm")
    assert rows["to the mesh itself"].startswith(f"{itself} (")
    assert rows["volume"].endswith(f"certified of the {HULL}")
    assert f") of the {HULL}, from touch alone" in rows["certified"]
    assert f" of the {HULL}, at_vertices" in repr(scanned.certificate)
    assert {one["of"] for one in scanned.report["measurands"]} == {HULL}
