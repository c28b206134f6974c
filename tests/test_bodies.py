"""Bodies: what counts as convex, against dents of known depth; slices, against cubes, half-planes and trimesh."""

import hashlib
import itertools
from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial import HalfspaceIntersection
from scipy.spatial.transform import Rotation

from scan3d.bodies import DENT_TOLERANCE, FORMATS, extent_along, load_mesh, read_mesh, slice_polygons
from scan3d.errors import InputError

KINDS = {**{kind: kind for kind in FORMATS}, "stl_ascii": "stl"}


def as_mesh(vertices, faces):
    return trimesh.Trimesh(vertices, faces, process=False)


def save(folder, mesh, name="body.ply", kind=None):
    path = Path(folder) / name
    mesh.export(path, file_type=kind or path.suffix[1:].lower())
    return path


def rotation(seed):
    return Rotation.random(rng=np.random.default_rng(seed)).as_matrix()


def box(*sides):
    """About the origin."""
    return trimesh.creation.box(sides or (1, 1, 1))


def dimpled_box(depth):
    """A cube of side 1 whose face x = 1/2 has its centre pushed in: a dent of just that depth, below 1/4."""
    cube = box()
    lid = np.flatnonzero(cube.face_normals[:, 0] > 0.5)
    corners = np.unique(cube.faces[lid])
    corners = corners[np.argsort(np.arctan2(*cube.vertices[corners, 1:].T))]
    fan = [[8, corners[i], corners[(i + 1) % 4]] for i in range(4)]
    return as_mesh(
        np.vstack([cube.vertices, [0.5 - depth, 0, 0]]), np.vstack([np.delete(cube.faces, lid, axis=0), fan])
    )


def letter_l():
    """3 high; the reentrant edge x = y = 1 lies 1/√2 below the hull's face x + y = 3."""
    outline = np.array([[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]])
    vertices = np.vstack([np.column_stack([outline, np.full(6, z)]) for z in (0, 3)])
    walls = [f for i in range(6) for j in [(i + 1) % 6] for f in ([i, j, j + 6], [i, j + 6, i + 6])]
    lid = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]])
    return as_mesh(vertices, [*walls, *(lid + 6), *lid[:, ::-1]])


def without(mesh, keep):
    return as_mesh(mesh.vertices, mesh.faces[keep])


def soup(mesh, jitter, seed=0):
    """Every triangle with corners of its own, each a little off."""
    corners = mesh.triangles.reshape(-1, 3)
    corners = corners + jitter * np.random.default_rng(seed).uniform(-1, 1, corners.shape)
    return as_mesh(corners, np.arange(len(corners)).reshape(-1, 3))


def assert_sound(body):
    """Closed, outward, convex to rounding, without a vertex to spare."""
    assert body.is_watertight
    assert body.is_winding_consistent
    assert body.euler_number == 2
    assert body.volume > 0
    assert len(np.unique(body.faces)) == len(body.vertices)
    points = (body.vertices - body.bounds.mean(axis=0)) / np.linalg.norm(body.extents)
    a, b, c = points[body.faces[:200]].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    size = np.linalg.norm(normal, axis=1)
    solid = size > 1e-9  # the normal of a sliver says nothing
    height = (points @ normal[solid].T - np.einsum("ij,ij->i", a[solid], normal[solid])) / size[solid]
    assert height.max() < 1e-9


# Files


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("upper", [False, True])
def test_formats_agree(tmp_path, kind, upper):
    # sixteenths: every format writes them exactly
    points = np.random.default_rng(1).integers(-48, 48, (60, 3)) / 16
    hull = trimesh.convex.convex_hull(points)
    name = f"body.{KINDS[kind].upper() if upper else KINDS[kind]}"
    path = save(tmp_path, hull, name, kind)
    body = load_mesh(path)
    assert_sound(body)
    assert {tuple(v) for v in body.vertices} == {tuple(v) for v in hull.vertices}
    assert body.metadata == {
        "file": name,
        "path": str(path.resolve()),
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "file_faces": len(hull.faces),
        "dent": pytest.approx(0, abs=1e-15),
        "dent_relative": pytest.approx(0, abs=1e-15),
        "hull": False,
    }
    assert len(load_mesh(str(path)).vertices) == len(body.vertices)


def test_a_scene_is_put_together_by_its_transforms(tmp_path):
    cube = box()
    upper = cube.face_normals[:, 2] > -0.5
    scene = trimesh.Scene()
    turn = np.eye(4)
    turn[:3, :3] = rotation(3) @ np.diag([1, 2, 3])
    turn[:3, 3] = 5, 6, 7
    for name, keep in (("top", upper), ("bottom", ~upper)):
        scene.add_geometry(without(cube, keep), geom_name=name, node_name=name, transform=turn)
    path = tmp_path / "scene.glb"
    path.write_bytes(scene.export(file_type="glb"))
    body = load_mesh(path)
    assert body.metadata["file_faces"] == 12
    assert body.volume == pytest.approx(6, rel=1e-6)
    np.testing.assert_allclose(body.bounds.mean(axis=0), [5, 6, 7], atol=1e-6)


def test_points_that_no_face_uses_are_no_part_of_the_body(tmp_path):
    cube = box()
    body = load_mesh(save(tmp_path, as_mesh(np.vstack([cube.vertices, [9, 9, 9]]), cube.faces), "body.off"))
    assert len(body.vertices) == 8


def test_read_mesh_keeps_the_surface_as_it_is(tmp_path):
    mesh = read_mesh(save(tmp_path, letter_l(), "l.stl"))
    assert mesh.is_watertight
    assert (len(mesh.vertices), len(mesh.faces)) == (12, 20)
    assert mesh.volume == pytest.approx(9)


def text(*rows):
    return "\n".join(rows).encode()


def broken_ascii_stl():
    words = box().export(file_type="stl_ascii").split("vertex ")
    # after three whole triangles: numpy would return those
    return "vertex ".join([*words[:10], "one " + words[10], *words[11:]]).encode()


BAD_FILES = {
    "empty.stl": (b"", "is empty"),
    "notes.txt": (b"1 2 3", "isn't a mesh file by its ending"),
    "ending": (b"1 2 3", "isn't a mesh file by its ending"),
    "number.stl": (broken_ascii_stl(), "can't be read as STL"),
    "cut.stl": (box().export(file_type="stl")[:-99], "no triangles"),
    "cut.ply": (box().export(file_type="ply")[:-99], "can't be read as PLY"),
    "cut.glb": (box().export(file_type="glb")[:-99], "can't be read as GLB"),
    "index.obj": (text("v 0 0 0", "v 1 0 0", "v 0 1 0", "v 0 0 1", "f 1 2 3", "f 1 2 9"), "can't be read as OBJ"),
    "points.obj": (text("v 0 0 0", "v 1 0 0", "v 0 1 0", "v 0 0 1"), "no triangles"),
    "points.ply": (trimesh.PointCloud(np.eye(4, 3)).export(file_type="ply"), "no triangles"),
    "triangle.off": (text("OFF", "3 1 0", "0 0 0", "1 0 0", "0 1 0", "3 0 1 2"), "only 3 distinct vertices"),
    "same.off": (text("OFF", "4 2 0", "0 0 0", "1 0 0", "0 1 0", "1 0 0", "3 0 1 2", "3 0 3 2"), "only 3 distinct"),
    **{f"words.{kind}": (b"Dear reader,\nthis solid prose has no vertex.\n", f"{kind.upper()}") for kind in FORMATS},
    **{f"picture.{kind}": (b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 9, f"{kind.upper()}") for kind in FORMATS},
}


def error(path, **options):
    """The message with which a file is refused: one sentence that names it."""
    with pytest.raises(InputError) as caught:
        load_mesh(path, **options)
    message = str(caught.value)
    assert Path(path).name in message
    assert "\n" not in message
    assert len(message) < 300
    return message


@pytest.mark.parametrize("name", BAD_FILES)
def test_files_that_are_no_mesh(tmp_path, name):
    data, why = BAD_FILES[name]
    (tmp_path / name).write_bytes(data)
    assert why in error(tmp_path / name)


def test_files_that_are_not_there(tmp_path, monkeypatch):
    assert "no mesh file" in error(tmp_path / "missing.stl")
    assert "is a folder" in error(tmp_path)
    path = save(tmp_path, box(), "locked.stl")

    def refuse(_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "read_bytes", refuse)
    assert "Permission denied" in error(path)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_vertices_that_are_no_numbers(tmp_path, kind, value):
    # trimesh's own loading drops them, and with them a corner of the body
    cube = box()
    vertices = np.array(cube.vertices)
    vertices[3, 1] = value
    with np.errstate(invalid="ignore"):
        path = save(tmp_path, as_mesh(vertices, cube.faces), f"body.{KINDS[kind]}", kind)
    assert "NaN or infinite" in error(path)


# Convexity


@pytest.mark.parametrize("turn", [np.eye(3), rotation(5)])
def test_a_flat_sheet_says_how_thick_it_is(tmp_path, turn):
    sheet = as_mesh(np.array([[0, 0, 0], [3, 0, 0], [3, 4, 0], [0, 4, 0]]) @ turn.T, [[0, 1, 2], [0, 2, 3]])
    assert "flat" in error(save(tmp_path, sheet))  # in float32: not quite flat when oblique
    assert "flat" in error(save(tmp_path, sheet), hull=True)
    thin = as_mesh(box(3, 4, 2e-6).vertices, box().faces)
    assert "2e-06 thick (4e-07 of its diagonal" in error(save(tmp_path, thin))
    assert load_mesh(save(tmp_path, box(3, 4, 1e-5))).volume == pytest.approx(12e-5)


def test_a_fine_sphere_in_single_precision(tmp_path):
    sphere = trimesh.creation.icosphere(6)
    body = load_mesh(save(tmp_path, as_mesh(sphere.vertices @ rotation(1).T + 3, sphere.faces), "sphere.stl"))
    assert_sound(body)
    assert body.metadata["dent_relative"] < 1e-6
    assert body.volume == pytest.approx(sphere.volume, rel=1e-5)


@pytest.mark.parametrize("shape", ["sphere", "box", "cylinder"])
def test_a_soup_of_triangles_with_seams(tmp_path, shape):
    mesh = {
        "sphere": trimesh.creation.icosphere(4, radius=0.5),
        "box": box().subdivide_loop(0).subdivide().subdivide().subdivide(),
        "cylinder": trimesh.creation.cylinder(0.3, 1, sections=500),
    }[shape]
    body = load_mesh(save(tmp_path, soup(mesh, 1e-7), "soup.stl"))
    assert_sound(body)
    assert body.metadata["dent_relative"] < 1e-6
    assert body.volume == pytest.approx(mesh.volume, rel=1e-5)


@pytest.mark.parametrize("radius", [1e-3, 1e-9, 1e9])
def test_units_do_not_matter(tmp_path, radius):
    sphere = trimesh.creation.icosphere(5)
    body = load_mesh(save(tmp_path, as_mesh(sphere.vertices * radius, sphere.faces), "sphere.stl"))
    assert_sound(body)
    assert len(body.vertices) == len(sphere.vertices)
    assert body.volume == pytest.approx(sphere.volume * radius**3)


def test_qhull_slivers_are_oriented(tmp_path):
    # four copies of every vertex, 1e-15 apart: facets whose normals are all rounding
    mesh = trimesh.creation.cylinder(1, 2, sections=500)
    points = np.tile(mesh.vertices, (4, 1)) + np.random.default_rng(0).normal(size=(4 * len(mesh.vertices), 3)) * 1e-15
    path = tmp_path / "cylinder.obj"
    rows = [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
    faces = np.vstack([mesh.faces + i * len(mesh.vertices) for i in range(4)]) + 1
    path.write_text("\n".join(rows + [f"f {a} {b} {c}" for a, b, c in faces.tolist()]))
    assert_sound(load_mesh(path))


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
    (one, other), (a, b) = ico.face_adjacency[0], ico.face_adjacency_edges[0]
    c, d = (np.setdiff1d(ico.faces[f], [a, b])[0] for f in (one, other))
    faces = np.vstack([np.delete(ico.faces, [one, other], axis=0), [[a, c, d], [b, c, d]]])
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
    found = dent_of(save(tmp_path_factory.getbasetemp(), moved, "moved.ply")) / 2.0**exponent
    assert found == pytest.approx(depth, rel=1e-3, abs=1e-6)  # float32 file


def open_meshes():
    cube, tube, sphere = box(), trimesh.creation.cylinder(1, 2), trimesh.creation.icosphere(4)
    up = cube.face_normals[:, 2]
    bottom_twice = np.concatenate([np.flatnonzero(up < 0.5), np.flatnonzero(up < -0.5)])
    yield "triangle", without(cube, np.arange(12) > 0), "8.3 %"
    yield "lid", without(cube, up < 0.5), "17 %"
    yield "a wall twice makes no lid", without(cube, bottom_twice), "17 %"
    yield "tube", without(tube, np.abs(tube.face_normals[:, 2]) < 0.5), "33 %"
    yield "hemisphere", without(sphere, sphere.triangles_center[:, 2] > 0), "34 %"  # a third, and its rim is jagged


@pytest.mark.parametrize(("mesh", "bare"), [pytest.param(*case, id=name) for name, *case in open_meshes()])
def test_open_meshes(tmp_path, mesh, bare):
    path = save(tmp_path, mesh, "open.stl")
    message = error(path)
    assert "open" in message
    assert bare in message
    assert "--hull" in message
    assert_sound(load_mesh(path, hull=True))


# Slices


def is_strictly_convex(polygon):
    before, after = polygon - np.roll(polygon, 1, axis=0), np.roll(polygon, -1, axis=0) - polygon
    return bool((before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0] > 0).all())


def area(polygon):
    x, y = (polygon - polygon.mean(axis=0)).T if len(polygon) else polygon.T
    return float(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


def cube_section_area(normal, height):
    """Of the unit cube about the origin: d/dh of the volume below a plane, by inclusion and exclusion over its corners."""
    n = np.abs(normal)
    corners = np.array(list(itertools.product([0, 1], repeat=3)))
    below = np.maximum(height + n.sum() / 2 - corners @ n, 0)
    return float((-1.0) ** corners.sum(axis=1) @ below**2) / (2 * n.prod())


@given(seed=st.integers(0, 2**32 - 1), height=st.floats(-1, 1))
def test_slices_of_a_cube_in_any_rotation(seed, height):
    frame = rotation(seed)
    assume(np.abs(frame[2]).min() > 0.02)  # the formula cancels
    (polygon,) = slice_polygons(box(), frame, [height])
    assert area(polygon) == pytest.approx(cube_section_area(frame[2], height), abs=1e-12)
    assert is_strictly_convex(polygon)
    points = np.column_stack([polygon, np.full(len(polygon), height)]) @ frame
    on_faces = np.sort(np.abs(np.abs(points) - 0.5), axis=1)  # an edge is where two faces meet
    assert on_faces[:, :2].max(initial=0) < 1e-14
    assert np.abs(points).max(initial=0) < 0.5 + 1e-14


@given(
    seed=st.integers(0, 2**32 - 1),
    exponent=st.integers(-40, 40),
    shift=st.tuples(*[st.floats(-3, 3)] * 3),
)
@settings(max_examples=40)
def test_slices_move_with_their_body(seed, exponent, shift):
    hull = trimesh.convex.convex_hull(np.random.default_rng(seed).normal(size=(30, 3)))
    frame, scale = rotation(seed + 1), 2.0**exponent
    moved = as_mesh(scale * (hull.vertices + shift), hull.faces)
    low, high = extent_along(hull, frame[2])
    heights = np.linspace(low, high, 9)[1:-1]
    here = slice_polygons(hull, frame, heights)
    there = slice_polygons(moved, frame, scale * (heights + frame[2] @ shift))
    for a, b in zip(here, there, strict=True):
        assert area(b) / scale**2 == pytest.approx(area(a), rel=1e-13, abs=1e-13)
        gap = np.linalg.norm((a + frame[:2] @ shift)[:, None] - b / scale, axis=2)
        assert (
            gap.min(axis=1).max() < 1e-12
        )  # where neighbouring edges are all but parallel, rounding moves their corner
        assert gap.min(axis=0).max() < 1e-12


@pytest.mark.parametrize("scale", [1, 1e-3, 1e-9])
def test_slices_of_a_sphere_against_half_planes(scale):
    # inside a plane the facets of a convex body are half-planes; this also is the 1 mm sphere in metres
    unit = trimesh.creation.icosphere(4)
    sphere = as_mesh(unit.vertices * scale, unit.faces)
    frame = rotation(8)
    heights = np.cos(np.linspace(0.1, 3, 7))
    polygons = slice_polygons(sphere, frame, scale * heights)
    normals = unit.face_normals @ frame.T
    offsets = np.einsum("fx,fx->f", unit.face_normals, unit.triangles[:, 0])
    for height, polygon in zip(heights, polygons, strict=True):
        planes = np.column_stack([normals[:, :2], normals[:, 2] * height - offsets])
        corners = HalfspaceIntersection(planes, np.zeros(2)).intersections
        gap = np.linalg.norm(corners[:, None] - polygon / scale, axis=2)
        assert gap.min(axis=1).max() < 1e-11  # nearly parallel half-planes meet this sharply
        assert gap.min(axis=0).max() < 1e-11
        assert is_strictly_convex(polygon)
        assert len(polygon) == len(slice_polygons(unit, frame, [height])[0])


def test_slices_against_trimesh():
    hull = trimesh.convex.convex_hull(np.random.default_rng(2).normal(size=(200, 3)))
    frame = rotation(9)
    for height in (-1.2, -0.3, 0.0, 0.8):
        (polygon,) = slice_polygons(hull, frame, [height])
        lines = trimesh.intersections.mesh_plane(hull, frame[2], height * frame[2]).reshape(-1, 3) @ frame.T
        gap = np.linalg.norm(lines[:, None, :2] - polygon, axis=2)
        assert gap.min(axis=1).max() < 1e-13
        assert gap.min(axis=0).max() < 1e-13


def test_slices_through_vertices_and_faces():
    cube = box(2, 2, 2).subdivide().subdivide()  # vertices at the middle, coplanar faces everywhere
    square = {(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)}
    for height in (0, 0.5, 0.3, 1, -1):  # the lid is a slice of its own
        (polygon,) = slice_polygons(cube, np.eye(3), [height])
        assert len(polygon) == 4
        assert {tuple(p) for p in polygon} == square
        assert area(polygon) == 4
    for height in (1 + 1e-13, -1.1, np.nan, np.inf):
        assert slice_polygons(cube, np.eye(3), [height])[0].shape == (0, 2)


@pytest.mark.parametrize("seed", range(5))
def test_the_lid_in_any_rotation(seed):
    turn = rotation(seed)
    cube = as_mesh(box().vertices @ turn.T + [10, 20, 30], box().faces)
    frame = turn.T  # the cube's axes in the world
    low, high = extent_along(cube, frame[2])
    for polygon in slice_polygons(cube, frame, [low, high]):
        assert len(polygon) == 4
        assert area(polygon) == pytest.approx(1, abs=1e-13)


def test_a_plane_that_only_touches():
    cube = box(2, 2, 2)
    diagonal = Rotation.align_vectors([[0, 0, 1]], [[1, 1, 1]])[0].as_matrix()
    half = Rotation.from_euler("x", 45, degrees=True).as_matrix()
    assert slice_polygons(cube, diagonal, [np.sqrt(3)])[0].shape == (0, 2)  # a vertex
    assert slice_polygons(cube, half, [np.sqrt(2)])[0].shape == (0, 2)  # an edge
    # just below the vertex there is a triangle, small as it is
    (tip,) = slice_polygons(cube, diagonal, [np.sqrt(3) - 1e-9])
    assert len(tip) == 3
    assert area(tip) == pytest.approx(1.5 * np.sqrt(3) * 1e-18, rel=1e-5)


def test_slices_of_a_plate_and_a_needle():
    frame = rotation(12)
    for sides in ((1, 1, 1e-6), (1, 1e-6, 1e-6)):
        thin = as_mesh(box(*sides).vertices @ frame, box().faces)
        (polygon,) = slice_polygons(thin, frame[[1, 2, 0]], [0.1])
        assert len(polygon) == 4
        assert area(polygon) == pytest.approx(sides[1] * sides[2], rel=1e-9)


@pytest.mark.parametrize(("place", "gap"), [(0, 2**-53), (600, 2**-43)])
def test_of_vertices_that_coincide_one_stays(place, gap):
    # a prism whose four upright edges are doubled, as near to each other as float64 allows at its place
    pairs = (0.5, 0.5 - gap), (0.5 - gap, 0.5)
    corners = np.array([[x * a, y * b, z] for x, y, z in itertools.product([-1, 1], repeat=3) for a, b in pairs])
    prism = as_mesh(corners + place, list(itertools.combinations(range(16), 3)))  # all edges there can be
    for height in (-1, 0.25, 1):
        (polygon,) = slice_polygons(prism, np.eye(3), [height + place])
        assert len(polygon) == 4
        assert area(polygon) == pytest.approx(1, abs=4 * gap)


def test_slices_come_in_the_order_of_the_heights():
    cone = trimesh.creation.cone(1, 1, sections=32)
    heights = [0.7, 0.1, 2.0, 0.4]
    areas = [area(p) for p in slice_polygons(cone, np.eye(3), heights)]
    full = 16 * np.sin(2 * np.pi / 32)
    np.testing.assert_allclose(areas, [full * 0.3**2, full * 0.9**2, 0, full * 0.6**2], atol=1e-14)
    assert slice_polygons(cone, np.eye(3), []) == []


def test_a_mirrored_frame_still_gives_counter_clockwise_polygons():
    (polygon,) = slice_polygons(box(), np.diag([-1, 1, 1]), [0.2])
    assert area(polygon) == 1


@pytest.mark.parametrize("bad", [np.eye(2), 2 * np.eye(3), np.ones((3, 3)), np.full((3, 3), np.nan)])
def test_frames_that_are_none(bad):
    with pytest.raises(ValueError, match="orthonormal"):
        slice_polygons(box(), bad, [0])


def test_heights_of_the_wrong_shape():
    with pytest.raises(ValueError, match="heights"):
        slice_polygons(box(), np.eye(3), 0.0)


def test_extent_along():
    body = as_mesh(box(2, 4, 6).vertices + np.array([1, 0, 0]), box().faces)
    assert extent_along(body, [1, 0, 0]) == (0, 2)
    assert extent_along(body, [0, -5, 0]) == (-2, 2)
    assert extent_along(body, [1, 1, 1]) == pytest.approx(np.array([-5, 7]) / np.sqrt(3))
    for bad in ([0, 0, 0], [1, 2], [np.nan, 0, 1], [np.inf, 0, 1]):
        with pytest.raises(ValueError, match="axis"):
            extent_along(body, bad)


def test_a_path_may_be_a_string():
    path = Path(__file__).parents[1] / "meshes" / "cube.stl"
    for read in (load_mesh, read_mesh):
        assert np.array_equal(read(str(path)).vertices, read(path).vertices)
