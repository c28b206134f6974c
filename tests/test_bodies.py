"""Mesh files as bodies: what is read, what is refused, and what counts as convex."""

import hashlib
import itertools
import json
import re
import struct

import numpy as np
import pytest
import trimesh
from mesh_files import assert_sound, error, save
from shapes import as_mesh, box, letter_l, rotation, soup, without

import scan3d
from scan3d.__main__ import main
from scan3d.errors import InputError
from scan3d.files.meshes import FORMATS, load_mesh, read_mesh
from scan3d.files.shapes import export
from scan3d.units import UNITS_M

KINDS = {**{kind: kind for kind in FORMATS}, "stl_ascii": "stl"}


@pytest.mark.parametrize("kind", KINDS)
def test_formats_agree(tmp_path, kind):
    # sixteenths: every format writes them exactly
    points = np.random.default_rng(1).integers(-48, 48, (60, 3)) / 16
    hull = trimesh.convex.convex_hull(points)
    name = f"body.{KINDS[kind].upper()}"  # endings in capitals count as well
    path = save(tmp_path, hull, name, kind)
    body = load_mesh(path, unit="m")  # in which GLB is
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
        "convex": (hash(body.vertices), True),
        "geometry_sha256": hashlib.sha256(np.array(body.vertices, dtype=float).tobytes()).hexdigest(),
    }
    assert len(load_mesh(str(path), unit="m").vertices) == len(body.vertices)


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
    body = load_mesh(path, unit="m")
    assert body.metadata["file_faces"] == 12
    assert body.volume == pytest.approx(6, rel=1e-6)
    np.testing.assert_allclose(body.bounds.mean(axis=0), [5, 6, 7], atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("unit", ["m", "in"])
@pytest.mark.parametrize("ending", [".glb", ".obj", ".ply", ".stl"])
def test_units_that_files_state_are_read(tmp_path, ending, unit):
    mesh, path = box(30, 20, 12), tmp_path / f"box{ending}"
    mesh.units = "mm"
    scan3d.save(mesh, tmp_path / "mm.ply")
    export(tmp_path / "mm.ply", path, unit=None if ending == ".glb" else unit)
    factor = UNITS_M["mm"] / UNITS_M[unit]
    for read in (load_mesh, read_mesh):
        assert read(path, unit=unit).extents == pytest.approx(factor * mesh.extents, rel=1e-6)
    assert load_mesh(path).extents == pytest.approx(mesh.extents, rel=1e-6)
    for compared in (scan3d.compare(path, tmp_path / "mm.ply"), scan3d.compare(path, mesh)):
        assert compared.hausdorff < 1e-6 * max(1, factor) * compared.diagonal
        assert compared.relative < 1e-6
    with pytest.raises(InputError, match="unit must be one of m, cm"):
        load_mesh(path, unit="ell")


def test_a_mesh_at_many_places_of_a_scene_is_counted_before_it_is_read(tmp_path, monkeypatch):
    scene = trimesh.Scene(geometry={"ball": trimesh.creation.icosphere(3)})
    for k in range(50):
        scene.graph.update(
            f"node {k}", geometry="ball", matrix=trimesh.transformations.translation_matrix([3 * k, 0, 0])
        )
    path = tmp_path / "scene.glb"
    path.write_bytes(scene.export(file_type="glb"))
    assert path.stat().st_size < 1e5
    monkeypatch.setattr("scan3d.workers.memory_bytes", lambda: 5e6)
    assert "reading all parts of it needs about" in error(path)


def test_a_glb_of_another_program_is_in_metres(tmp_path, capsys):
    glb, stl = save(tmp_path, box(0.03, 0.02, 0.012), "box.glb"), save(tmp_path, box(30, 20, 12), "box.stl")
    assert load_mesh(glb).extents == pytest.approx([30, 20, 12])
    assert load_mesh(glb, unit="cm").extents == pytest.approx([3, 2, 1.2])
    assert scan3d.simulate(glb, scan3d.Plan(slices=2, sweeps=2, samples=2)).unit == "mm"
    assert main(["compare", str(glb), str(stl), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["relative"] < 1e-7
    save(tmp_path, box(3, 2, 1.2), "box.stl")
    assert main(["compare", str(glb), str(stl), "--unit", "cm", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["diagonal"] == pytest.approx(np.linalg.norm([3, 2, 1.2]))


FAR = np.array([412345.0, 801234.0, 50.0])


@pytest.mark.parametrize(
    "shape", [trimesh.creation.icosphere(4, radius=12), box(0.02, 0.03, 0.02)], ids=["ball", "box"]
)
@pytest.mark.parametrize("ending", [".stl", ".glb"])
def test_float32_far_from_the_origin_is_named_as_the_cause(tmp_path, shape, ending):
    moved = as_mesh(shape.vertices + FAR, shape.faces)
    assert "lost its shape in float32, whose numbers are 0.062 apart" in error(save(tmp_path, moved, f"far{ending}"))
    assert load_mesh(save(tmp_path, moved, "far.off")).extents == pytest.approx(shape.extents, rel=1e-6)
    # what is dented, or flat, in itself
    flat = as_mesh(box().vertices * [5, 5, 0], box().faces)
    assert "flat" in error(save(tmp_path, flat, f"near{ending}"))
    far = load_mesh(save(tmp_path, as_mesh(letter_l().vertices + FAR, letter_l().faces), "far.stl"))
    assert len(far.faces) == len(letter_l().faces)


def written_glb(path, points, changed=lambda tree: None, more=b""):
    faces = box().faces.astype("<u2")
    data = np.asarray(points).tobytes() + faces.tobytes() + more
    size = len(data) - faces.nbytes - len(more)
    position = {"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3"}
    tree = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "scale": [1.0, 1.0, 1.0]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "buffers": [{"byteLength": len(data)}],
        "bufferViews": [
            {"buffer": 0, "byteLength": size},
            {"buffer": 0, "byteOffset": size, "byteLength": 72},
            {"buffer": 0, "byteOffset": size + 72, "byteLength": len(more)},
        ],
        "accessors": [
            {**position, "min": [-0.015, -0.01, -0.006], "max": [0.015, 0.01, 0.006]},
            {"bufferView": 1, "componentType": 5123, "count": 36, "type": "SCALAR"},
        ],
    }
    changed(tree)
    text = json.dumps(tree).encode()
    text, data = text + b" " * (-len(text) % 4), data + bytes(-len(data) % 4)
    head = struct.pack("<4sIII4s", b"glTF", 2, 28 + len(text) + len(data), len(text), b"JSON")
    path.write_bytes(head + text + struct.pack("<I4s", len(data), b"BIN\0") + data)
    return path


CORNERS = box(0.03, 0.02, 0.012).vertices.astype("<f4")


def quantized(tree):
    tree["extensionsRequired"] = ["KHR_mesh_quantization", "KHR_materials_unlit"]
    tree["accessors"][0] = {"bufferView": 0, "componentType": 5122, "normalized": True, "count": 8, "type": "VEC3"}
    tree["bufferViews"][0]["byteStride"] = 8
    tree["nodes"][0]["scale"] = [0.015] * 3


GLB = {
    "quantized": (np.hstack([np.round(CORNERS / 0.015 * 32767), np.zeros((8, 1))]).astype("<i2"), quantized, b""),
    "interleaved": (
        np.hstack([CORNERS, CORNERS[:, :1]]),
        lambda tree: tree["bufferViews"][0].update(byteStride=16),
        b"",
    ),
    "a mirror image in a camera": (
        CORNERS,
        lambda tree: tree["nodes"][0].update(camera=0, scale=[-1.0, 1.0, 1.0], rotation=[0.0, 0.0, 1.0, 0.0]),
        b"",
    ),
}


@pytest.mark.parametrize("name", GLB)
def test_glb_is_read_as_its_specification_says(tmp_path, name):
    mesh = read_mesh(written_glb(tmp_path / "box.glb", *GLB[name]))
    assert mesh.extents == pytest.approx([30, 20, 12], rel=1e-4)
    assert mesh.volume == pytest.approx(7200, rel=1e-4)


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        (lambda tree: tree.update(extensionsRequired=["KHR_draco_mesh_compression"]), "extension KHR_draco_mesh_compr"),
        (lambda tree: tree["bufferViews"][0].update(byteStride=16, byteLength=168), "leave the box that it states"),
        (lambda tree: tree["buffers"][0].update(uri="box.bin"), "its data lie in another place, box.bin"),
        (lambda tree: tree["meshes"][0]["primitives"][0].update(mode=5), "stored as strips or fans"),
        (lambda tree: tree["accessors"][0].update(sparse={"count": 1}), "without sparse accessors"),
        (lambda tree: tree["nodes"][0].update(skin=0), "bent by a skeleton"),
    ],
)
def test_glb_that_would_be_read_wrongly_is_refused(tmp_path, changed, why):
    assert why in error(written_glb(tmp_path / "box.glb", CORNERS, changed))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("factor", "units"), [(1000, "mm and the first in m"), (25.4, "mm and the first in in"), (9.9, "mm")]
)
def test_bodies_that_differ_by_a_unit_are_remarked_on(tmp_path, capsys, factor, units):
    paths = [
        str(save(tmp_path, box(*size), name))
        for size, name in (((3, 2, 1), "a.stl"), (np.array([3, 2, 1]) * factor, "b.stl"))
    ]
    assert main(["compare", *paths, "--json"]) == 0
    assert f"times as large as the first, as if the second were in {units}" in capsys.readouterr().err
    assert main(["compare", *paths[::-1], "--json"]) == 0
    assert "the first is" in capsys.readouterr().err
    with pytest.warns(UserWarning, match="the first is .* times as large as the second, as if"):
        scan3d.compare(*paths[::-1])
    save(tmp_path, box(6, 4, 2), "b.stl")
    assert main(["compare", *paths, "--json"]) == 0
    assert capsys.readouterr().err == ""
    scan3d.compare(*paths)


@pytest.mark.parametrize(
    ("size", "unit", "meant"), [(0.04, "mm", "m"), (40, "m", "mm"), (40, "mm", None), (0.04, "m", None)]
)
def test_a_body_too_small_or_too_large_is_asked_about(tmp_path, capsys, size, unit, meant):
    path = save(tmp_path, box(size, size, size / 2), "box.stl")
    counts = ["--slices", "2", "--sweeps", "2", "--samples", "2"]
    assert main(["simulate", str(path), "--out", str(tmp_path / "log.csv"), "--unit", unit, *counts]) == 0
    question = f"scan3d: the body measures {size:g} {unit}; did you mean --unit {meant}?\n" if meant else ""
    assert capsys.readouterr().err == question


def test_it_is_asked_about_before_the_scan(tmp_path, capsys, monkeypatch):
    path = save(tmp_path, box(0.04, 0.04, 0.02), "box.stl")

    def begin(*_):
        assert "did you mean --unit m?" in capsys.readouterr().err
        raise InputError("the scan begins")

    for place in ("pipeline.simulate_judged", "simulation.scan.simulate"):
        monkeypatch.setattr(f"scan3d.{place}", begin)
    for command in ("scan", "simulate"):
        assert main([command, str(path), "--out", str(tmp_path / "out.csv")]) == 1
        assert "the scan begins" in capsys.readouterr().err


def relative_obj(mesh, reference):
    """The mesh as OBJ whose faces count back from the last of its vertices, each written as `reference`."""
    back = mesh.faces - len(mesh.vertices)
    faces = (" ".join(["f", *(reference.format(corner) for corner in face)]) for face in back)
    points = [" ".join(map(str, vertex)) for vertex in mesh.vertices]
    return "\n".join([*(f"v {p}" for p in points), *(f"vn {p}" for p in points), "vt 0 0", *faces, ""])


@pytest.mark.parametrize("reference", ["{0}", "{0}//{0}", "{0}/-1/{0}", "{0}/1"])
def test_relative_indices_of_obj_count_from_the_vertices_read_so_far(tmp_path, reference):
    halves = [as_mesh(box(3, 2, 1).vertices, box().faces[part]) for part in (slice(5), slice(5, None))]
    path = tmp_path / "halves.obj"
    path.write_text("".join(f"o half\n{relative_obj(half, reference)}" for half in halves))
    body = load_mesh(path)
    assert (body.metadata["file_faces"], body.volume) == (12, pytest.approx(6))
    corners = box(3, 2, 1).triangles  # each face directly after its vertices
    parts = ["".join("v {} {} {}\n".format(*point) for point in corner) + "f -3 \\\n -2 -1\n" for corner in corners]
    path.write_text("".join(parts))
    assert load_mesh(path).extents == pytest.approx([3, 2, 1])
    path.write_text(relative_obj(halves[0], reference) + "f -1 -2 -9\n")
    assert "the index -9, and 8 vertices can be counted" in error(path)
    path.write_text(relative_obj(halves[0], reference) + "f 0 1 2\n")
    assert "the index 0, and 8 vertices can be counted, from 1 or, back, from -1" in error(path)


@pytest.mark.parametrize(
    ("begin", "end"),
    [
        ("solid vertex_clamp", "endsolid vertex_clamp"),
        ("solid normal endsolid facet", "endsolid"),
        ("solid cube", "end solid cube"),
        ("SOLID a solid Vertex", "ENDSOLID a solid Vertex"),
        ("\ufeffsolid M\u00fcller", " EndSolid M\u00fcller\r"),
        ("solid two\nlines", "endsolid two\nlines\n\0\0\x1a"),
    ],
)
def test_names_of_solids_in_text_stl_may_be_any(tmp_path, begin, end):
    facets = "\n".join(box(3, 2, 1).export(file_type="stl_ascii").strip().split("\n")[1:-1])
    facets = facets.upper() if begin.startswith("SOLID") else facets
    path = tmp_path / "named.stl"
    path.write_text(f"{begin}\n{facets}\n{end}\n", encoding="utf-8", newline="")
    assert load_mesh(path).volume == pytest.approx(6)
    path.write_text(" ".join([*begin.split(), *facets.split(), *end.split()]), encoding="utf-8")
    assert load_mesh(path).volume == pytest.approx(6)
    path.write_text(f"{begin}\n{facets[: len(facets) // 2]}", encoding="utf-8", newline="")
    assert "cut off" in error(path)


@pytest.mark.parametrize("header", [b"solid facet vertex 1 2 3", b""])
def test_bytes_around_the_triangles_of_binary_stl(tmp_path, header):
    counted = header.ljust(80) + b"\x0c\0\0\0" + box(3, 2, 1).export(file_type="stl")[84:]
    for end in (b"", b"\r\n", bytes(200)):
        (tmp_path / "box.stl").write_bytes(counted + end)
        assert load_mesh(tmp_path / "box.stl").volume == pytest.approx(6)
    (tmp_path / "box.stl").write_bytes(counted[:80] + b"\x0b" + counted[81:])
    assert "counts 11 triangles, and 1 more may follow" in error(tmp_path / "box.stl")


@pytest.mark.parametrize("kind", ["stl_ascii", "obj", "off", "ply"])
def test_text_as_other_programs_write_it(tmp_path, kind, capsys):
    """Decimal commas, a byte order mark, line ends of old computers; in OBJ tabs and comments, in STL normals of no size."""
    options = {"encoding": "ascii"} if kind == "ply" else {}
    written = box(3, 2, 1).export(file_type=kind, **options)
    written = re.sub(r"(\d)\.(\d)", r"\1,\2", written if isinstance(written, str) else written.decode())
    if kind == "obj":
        written = re.sub(r"(?m)^(v .*)$", r"\1 # a corner", written).replace(" ", "\t")
    if kind == "stl_ascii":
        written = re.sub("normal .*", "normal -1.#IND -1.#IND -1.#IND", written)
    path = tmp_path / f"box.{KINDS[kind]}"
    for encoded in (written.encode(), b"\xef\xbb\xbf" * (kind != "ply") + written.replace("\n", "\r").encode()):
        path.write_bytes(encoded if kind != "ply" else written.encode())
        assert load_mesh(path).volume == pytest.approx(6)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("word", ["OFF", "COFF", "NOFF", "off", "OFF ", "", "# a comment\n OFF"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_off_whose_first_number_follows_the_word_without_a_space(tmp_path, word, encoding):
    """As hundreds of files of ModelNet40 begin; the volume is the textbook's."""
    written = box(3, 2, 1).export(file_type="off").split("\n", 1)
    (tmp_path / "box.off").write_bytes((word + written[1]).encode(encoding))
    assert load_mesh(tmp_path / "box.off").volume == pytest.approx(6)


LETTER = [(x, y, z) for z in (0, 7) for x, y in ((20, 0), (20, 5), (5, 5), (5, 20), (0, 20), (0, 0))]
SIDES = [[5, 4, 3, 2, 1, 0], [*range(6, 12)], *([k, (k + 1) % 6, (k + 1) % 6 + 6, k + 6] for k in range(6))]


def letter_of_polygons(kind):
    """A letter of the area 910 and the volume 1225, whose ends are polygons that are not convex."""
    points, sides = ([" ".join(map(str, row)) for row in rows] for rows in (LETTER, SIDES))
    sides = [f"{len(side.split())} {side}" for side in sides]
    if kind == "obj":  # with colours, and lines and points among the faces
        faces = (" ".join(["  f", *(f"{k - 12}//" for k in side), "\\ \n"]) for side in SIDES)
        return text(*(f"  v {point} 1 0 0" for point in points), "l 1 2", "p -1", *faces, "")
    if kind == "off":
        return text("12 8 # a file without the word", "", *points, *(f"{side} 255 0 0" for side in sides))
    vertex = ["element vertex 12", *(f"property double {name}" for name in "xyz"), "property list uchar short spare"]
    face = ["element face 8", "property uint8 flags", "property list int32 ushort vertex_index", "end_header", ""]
    head = text("ply", f"format {kind} 1.0", "comment of another program", *vertex, *face)
    if kind == "ascii":
        return head + text(*(f"{point} 1 9" for point in points), "", *(f"7 {side}" for side in sides))
    order = "<" if "little" in kind else ">"
    rows = [struct.pack(order + "3dBh", *corner, 1, 9) for corner in LETTER]
    return b"".join(
        [head, *rows, *(struct.pack(f"{order}Bi{len(side)}H", 7, len(side), *side) for side in SIDES), b"\n"]
    )


@pytest.mark.parametrize("kind", ["obj", "off", "ascii", "binary_little_endian", "binary_big_endian"])
def test_polygons_of_other_programs(tmp_path, kind):
    path = tmp_path / f"letter.{kind if kind in FORMATS else 'ply'}"
    path.write_bytes(letter_of_polygons(kind))
    body = load_mesh(path)
    assert (body.volume, body.area) == (pytest.approx(1225), pytest.approx(910))


def test_strips_of_ply(tmp_path):
    names = [f"property float {axis}" for axis in "xyz"]
    strips = ["element tristrips 2", "property list int int vertex_indices"]
    corners = ["0 0 0", "1 0 0", "0 1 0", "0 0 1", "4 0 1 2 3", "7 2 3 0 -1 0 3 1"]
    head = ["ply", "format ascii 1.0", "element vertex 4", *names, *strips, "end_header"]
    (tmp_path / "strips.ply").write_bytes(text(*head, *corners, ""))
    body = read_mesh(tmp_path / "strips.ply")
    assert (body.is_winding_consistent, abs(body.volume)) == (True, pytest.approx(1 / 6))


def text(*rows):
    return "\n".join(rows).encode()


def broken_ascii_stl():
    words = box().export(file_type="stl_ascii").split("vertex ")
    # a broken number after three complete triangles, which older versions of numpy return
    return "vertex ".join([*words[:10], "one " + words[10], *words[11:]]).encode()


BAD_FILES = {
    "notes.txt": (b"1 2 3", "isn't a mesh file by its ending"),
    "ending": (b"1 2 3", "isn't a mesh file by its ending"),
    "number.stl": (broken_ascii_stl(), "can't be read as STL"),
    "points.ply": (trimesh.PointCloud(np.eye(4, 3)).export(file_type="ply"), "no triangles"),
    "count.stl": (bytes(80) + b"\x0d\0\0\0" + bytes(600), "counts 13 triangles, and 12 fit into it"),
    "same.off": (text("OFF", "4 2 0", "0 0 0", "1 0 0", "0 1 0", "1 0 0", "3 0 1 2", "3 0 3 2"), "only 3 distinct"),
    **{f"words.{kind}": (b"Dear reader,\nthis solid prose has no vertex.\n", f"{kind.upper()}") for kind in FORMATS},
    **{f"picture.{kind}": (b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 9, f"{kind.upper()}") for kind in FORMATS},
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_files_that_are_not_meshes_are_refused(tmp_path, name):
    data, why = BAD_FILES[name]
    (tmp_path / name).write_bytes(data)
    assert why in error(tmp_path / name)


def test_vertices_of_two_coordinates_are_refused(tmp_path):
    text = trimesh.exchange.export.export_mesh(box(), None, "obj")
    path = tmp_path / "flat.obj"
    path.write_text("\n".join(line.rsplit(" ", 1)[0] if line.startswith("v ") else line for line in text.splitlines()))
    assert "three coordinates" in error(path)


@pytest.mark.parametrize(("kind", "value"), list(zip(KINDS, itertools.cycle([np.nan, np.inf]), strict=False)))
def test_vertices_that_are_not_finite_are_refused(tmp_path, kind, value):
    # trimesh.load drops such vertices, and with them a corner of the body
    cube = box()
    vertices = np.array(cube.vertices)
    vertices[3, 1] = value
    with np.errstate(invalid="ignore"):
        path = save(tmp_path, as_mesh(vertices, cube.faces), f"body.{KINDS[kind]}", kind)
    assert "NaN, infinite or beyond 1e+60" in error(path)


def test_faces_that_enclose_no_volume_are_refused(tmp_path):
    """A box of which a corner is written twice, so that its faces have others as corners."""
    corners = np.array([[x, y, z] for x in (-10, 10) for y in (-15, 15) for z in (-20, 20)])[[0, 1, 1, *range(2, 8)]]
    faces = "241 521 143 351 284 625 682 483 753 387 765 867"
    path = save(tmp_path, as_mesh(corners, [[int(k) - 1 for k in face] for face in faces.split()]))
    assert "can't be turned outwards together" in error(path)


@pytest.mark.parametrize("turn", [np.eye(3), rotation(5)])
def test_a_flat_body_is_refused_with_its_thickness(tmp_path, turn):
    sheet = as_mesh(np.array([[0, 0, 0], [3, 0, 0], [3, 4, 0], [0, 4, 0]]) @ turn.T, [[0, 1, 2], [0, 2, 3]])
    assert "flat" in error(save(tmp_path, sheet))  # in float32: not quite flat when oblique
    assert "flat" in error(save(tmp_path, sheet), hull=True)
    thin = as_mesh(box(3, 4, 2e-6).vertices, box().faces)
    assert "it is 2e-06 thick, in the unit of the mesh (4e-07 of its diagonal" in error(save(tmp_path, thin))
    assert load_mesh(save(tmp_path, box(3, 4, 1e-5))).volume == pytest.approx(12e-5)


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
def test_open_meshes_are_refused_unless_the_hull_is_wanted(tmp_path, mesh, bare):
    path = save(tmp_path, mesh, "open.stl")
    message = error(path)
    assert "open" in message
    assert bare in message
    assert "--hull" in message
    assert_sound(load_mesh(path, hull=True))
