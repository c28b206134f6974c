"""Bodies that are not convex: what is scanned in their place, which dents are filled, and to what distances refer.

The authority for the numbers is the shape itself: a cube whose dent has a given depth, and an L, whose hull lies 1/√2 from its
reentrant edge and has 7/6 of its volume.
"""

import json

import numpy as np
import pytest
from mesh_files import save
from shapes import as_mesh, box, dimpled_box, letter_l, without
from small_scans import FEW

import scan3d
from scan3d.cli import main
from scan3d.files.meshes import judge_mesh, load_mesh, mesh_itself
from scan3d.files.reading import dent_size
from scan3d.numbers import length
from scan3d.pictures import page, parts, rendering
from scan3d.pipeline import to_scene
from scan3d.report import _filled, key_figures

SETTINGS = dict(slices=6, sweeps=4, samples=16, method="hull")
HULL = "convex hull of the mesh"
DEPTH = 0.01
DIAGONAL = np.sqrt(3)


def cube_with_a_dent():
    """With all faces outward: those in the dent of `dimpled_box` are not."""
    mesh = dimpled_box(DEPTH)
    return as_mesh(mesh.vertices, np.vstack([mesh.faces[:-4], mesh.faces[-4:, ::-1]]))


@pytest.fixture(scope="module")
def dimpled(tmp_path_factory):
    """The path of a cube with a dent."""
    return save(tmp_path_factory.mktemp("bodies"), cube_with_a_dent(), "dimpled.off")


@pytest.fixture(scope="module")
def scanned():
    """An L, of which the convex hull is scanned."""
    return scan3d.scan(letter_l(), hull=True, **SETTINGS)


# --- dents ---


@pytest.mark.parametrize("size", [0.0101, "0.0101", f"{101 * DEPTH / DIAGONAL}%", "0.6 %"])
def test_dents_up_to_a_depth_are_filled(dimpled, size):
    body = load_mesh(dimpled, clip_dent=size)
    assert body.is_convex
    assert body.volume == pytest.approx(1)
    assert body.metadata["hull"] is True
    filled = body.metadata["filled"]
    assert filled["depth"] == pytest.approx(DEPTH, rel=1e-3)  # the precision of the search
    assert filled["at"] == pytest.approx([0.5 - DEPTH, 0, 0], abs=1e-6)
    assert filled["volume_relative"] == pytest.approx(DEPTH / 3, rel=1e-6)  # a pyramid
    assert len(mesh_itself(body).faces) == 14
    # of faces that are turned inwards the volume is not known
    turned = judge_mesh(dimpled_box(DEPTH), clip_dent=size)
    assert turned.volume == pytest.approx(1)
    assert turned.metadata["filled"]["volume_relative"] is None


@pytest.mark.parametrize("size", [0, 0.0099, "0.5%"])
def test_deeper_dents_are_refused_with_what_would_fill_them(dimpled, size):
    with pytest.raises(
        scan3d.InputError,
        match=r"isn't convex: .* 0\.01 deep, in the unit of the mesh .* --clip-dent 0\.01\d?\d? \(clip_dent\)",
    ):
        load_mesh(dimpled, clip_dent=size)


def test_the_depth_that_is_suggested_suffices(dimpled):
    with pytest.raises(scan3d.InputError) as refused:
        load_mesh(dimpled)
    suggested = str(refused.value).rpartition("--clip-dent ")[2].partition(" ")[0]
    assert load_mesh(dimpled, clip_dent=suggested).is_convex


def test_a_body_that_was_moved_has_lost_its_mesh():
    body = judge_mesh(letter_l(), hull=True)
    assert len(mesh_itself(body).vertices) == 12
    body.apply_translation([1, 0, 0])
    assert mesh_itself(body) is None


def test_open_bodies_are_not_filled(tmp_path):
    mesh = box()
    path = save(tmp_path, without(mesh, mesh.face_normals[:, 2] < 0.5))
    with pytest.raises(scan3d.InputError, match=r"is open: .* give --hull"):
        load_mesh(path, clip_dent="50%")
    filled = load_mesh(path, hull=True).metadata["filled"]
    assert filled == {"depth": 0.0, "at": None, "open": True, "volume_relative": None}
    assert _filled({"mesh": {"filled": filled, "unit": "mm"}}) == [("scanned", f"the {HULL}; the mesh is open")]


def test_of_a_convex_body_nothing_is_filled():
    for options in ({}, {"hull": True}, {"clip_dent": 1}):
        assert not {"filled", "mesh_faces"} & set(judge_mesh(box(), **options).metadata)


@pytest.mark.parametrize(
    ("given", "size"), [("0.1", (0.1, 0)), (2, (2, 0)), ("0.05%", (0, 5e-4)), (" 5 % ", (0, 0.05))]
)
def test_depths_are_absolute_or_relative(given, size):
    assert dent_size(given) == pytest.approx(size)


@pytest.mark.parametrize("given", ["-1", "deep", "nan", "inf", "5%%", "% 5", ""])
def test_other_depths_are_refused(given):
    with pytest.raises(
        scan3d.InputError, match=r"clip_dent must be a depth in the mesh's unit, such as 0\.1, or a part"
    ):
        dent_size(given)
    with pytest.raises(scan3d.InputError, match="clip_dent must be a depth"):
        scan3d.scan(box(), clip_dent=given)


# --- what is printed, reported and drawn ---


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
    figures = dict(key_figures(scanned.report))
    assert figures["scanned"] == f"the {HULL}"
    assert figures["Hausdorff distance"].endswith(f"from the {HULL}")
    assert figures["contact error"].endswith(f"from the {HULL}")
    assert figures["distance from the mesh itself"] == itself
    assert figures["certified within"].endswith(f" of the {HULL}")
    assert f" of the {HULL}, at_vertices" in repr(scanned.certificate)
    assert {one["of"] for one in scanned.report["measurands"]} == {HULL}


def test_pictures_say_what_they_show(scanned):
    scene = to_scene(scanned.analysis)
    assert scene.truth_name == HULL
    _, shaded = parts.shade_surface(scene)
    assert shaded.title == f"signed deviation from the {HULL} in µm"
    assert parts.shade_surface(scene, "bound")[1].title == f"certified bound of the {HULL} in µm"
    assert f'"name":"{HULL}"' in page.page(scene).decode()
    assert parts.shade_contacts(scene, "error").title == f"distance from the {HULL} in nm"


@pytest.mark.rendering
@pytest.mark.slow
def test_such_a_body_is_drawn_without_a_warning(scanned):
    # warnings are errors in tests; pyvista warns of metadata that it can't take over
    assert scanned.plot(view="compare").width == 1400


def test_of_a_convex_mesh_nothing_of_the_kind_is_said():
    result = scan3d.scan(box(), hull=True, **SETTINGS)
    assert result.report["mesh"]["scanned"] == result.report["hausdorff"]["to"] == "mesh"
    assert result.report["hausdorff"]["mesh_itself"] is result.report["mesh"]["filled"] is None
    assert HULL not in repr(result)
    scene = to_scene(result.analysis)
    assert scene.truth_name == "truth"
    assert parts.shade_surface(scene)[1].title == "signed deviation in µm"


@pytest.mark.slow
def test_commands_take_the_depth_and_say_what_was_filled(dimpled, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(rendering, "can_render", lambda: False)
    options = [*FEW[:-1], "--method", "hull", "--clip-dent", "1%"]
    assert main(["scan", str(dimpled), "--out", str(tmp_path / "out"), *options]) == 0
    printed = capsys.readouterr().out
    assert f"the {HULL}, which fills dents up to 10 µm deep, 0.33 % of its volume\n" in printed
    report = json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))
    assert report["settings"]["clip_dent"] == "1%"
    recording = str(tmp_path / "out" / "recording.csv")
    again = ["reconstruct", recording, "--out", str(tmp_path / "again"), "--truth", str(dimpled), "--clip-dent", "0.02"]
    assert main([*again, "--method", "hull"]) == 0
    assert "to the mesh itself" in capsys.readouterr().out
    assert scan3d.open(tmp_path / "out").certificate.of == HULL
    # the mesh that the report names is the body again
    (tmp_path / "out" / dimpled.name).write_bytes(dimpled.read_bytes())
    assert scan3d.open(tmp_path / "out")._scene().truth_name == HULL
    page = tmp_path / "page.html"
    assert main(["show", str(tmp_path / "out"), "--html", str(page)]) == 0
    assert HULL in page.read_text(encoding="utf-8")
    assert main(["scan", str(dimpled), "--out", str(tmp_path / "x"), "--clip-dents"]) == 2


@pytest.mark.trust
def test_batches_keep_both_distances(dimpled, tmp_path, monkeypatch):
    monkeypatch.setattr(rendering, "can_render", lambda: False)
    few = dict(sweeps=4, samples=8, method="hull")
    batch = scan3d.batch(dimpled, tmp_path / "study", grid={"slices": [4, 5, 6]}, clip_dent=0.02, **few)
    row = batch.rows[0]
    report = batch.open(row["run"]).report
    assert row["hausdorff_mesh"] == report["hausdorff"]["mesh_itself"]["two_sided"]
    assert row["scanned"] == HULL
    assert row["hausdorff"] == report["hausdorff"]["two_sided"]
    index = (tmp_path / "study" / "index.html").read_text(encoding="utf-8")
    assert f"or to the {HULL} where that was scanned" in index
    assert "to the mesh itself" in index
