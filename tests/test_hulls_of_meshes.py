"""Hulls of bodies that are not convex: what is filled, and to what distances refer.

The authority for the numbers is the shape itself: a cube whose dent has a given depth, and an L, whose hull lies 1/√2 from its
reentrant edge and has 7/6 of its volume.
"""

import numpy as np
import pytest
from mesh_files import save
from shapes import as_mesh, dimpled_box, letter_l

import scan3d
from scan3d.files.meshes import judge_mesh, load_mesh, mesh_itself
from scan3d.geometry.hulls import is_convex
from scan3d.units import length

SETTINGS = dict(slices=6, sweeps=4, samples=16, method="hull")
HULL = "convex hull of the mesh"
DEPTH = 0.01


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


def test_the_hull_fills_dents(dimpled):
    body = load_mesh(dimpled, hull=True)
    assert body.is_convex
    assert body.volume == pytest.approx(1)
    assert body.metadata["hull"] is True
    filled = body.metadata["filled"]
    assert filled["depth"] == pytest.approx(DEPTH, rel=1e-3)  # the precision of the search
    assert filled["at"] == pytest.approx([0.5 - DEPTH, 0, 0], abs=1e-6)
    assert filled["volume_relative"] == pytest.approx(DEPTH / 3, rel=1e-6)  # a pyramid
    assert len(mesh_itself(body).faces) == 14
    # of faces that are turned inwards the volume is not known
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
