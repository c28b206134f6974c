"""Bodies that are not convex, from their sections to the report.

The authority for sections and contacts is the mesh itself, by its distance, and known areas of unions.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from matplotlib.path import Path as MatplotlibPath
from sample_bodies import MESHES
from shapes import box, letter_l, moved
from small_scans import undrawn

import scan3d
from scan3d import pipeline
from scan3d.bounds.free_space import rods_of
from scan3d.files.meshes import judge_mesh, load_mesh
from scan3d.geometry import sections
from scan3d.geometry.distance import nearest
from scan3d.geometry.hulls import is_convex, runs_both_ways
from scan3d.geometry.sections import slice_frame, slice_outlines
from scan3d.pictures.parts import shown_sweep
from scan3d.recording import of_rows
from tests.robustness.everyday import cut, mesh_of

FLAT = np.eye(3)


def area(polygon):
    following = np.roll(polygon, -1, axis=0)
    return ((polygon[:, 0] * following[:, 1] - polygon[:, 1] * following[:, 0]).sum()) / 2


@pytest.mark.parametrize(
    ("places", "areas"),
    [
        ([(0, 0, 0), (0.5, 0.5, 0)], [1.75]),  # shells that overlap
        ([(0, 0, 0), (1, 0, 0)], [2]),  # that share a face
        ([(0, 0, 0), (1, 1, 0)], [1, 1]),  # that share an edge
        ([(0, 0, 0), (3, 0, 0)], [1, 1]),
        ([(x, y, 0) for x in range(3) for y in range(3) if (x, y) != (1, 1)], [9]),  # around a hole
        ([(0, 0, 0), (0, 0, 0.25)], [1]),  # of which faces coincide
    ],
)
@pytest.mark.parametrize("height", [0.3, 0.4999])
def test_sections_of_shells_are_those_of_their_union(places, areas, height):
    mesh = trimesh.util.concatenate([moved(box(), place) for place in places])
    (outlines,) = slice_outlines(mesh, FLAT, np.array([height]))
    assert sorted(map(area, outlines)) == pytest.approx(areas, rel=1e-12)


@pytest.mark.parametrize("seed", range(30))
def test_outlines_go_around_all_that_lines_enclose(seed):
    # on a grid, where edges coincide and lines cross themselves without an area
    draw = np.random.default_rng(seed)
    lines = [np.round(2 * draw.normal(size=(draw.integers(3, 9), 2))) for _ in range(draw.integers(1, 4))]
    points = draw.uniform(-6, 6, size=(1000, 2))
    by_lines, by_outlines = (
        np.any([MatplotlibPath(line).contains_points(points) for line in closed], axis=0)
        for closed in (lines, sections._outer_outlines(lines, 10.0))
    )
    assert by_lines.any()
    assert not (by_lines & ~by_outlines).any()


def test_outlines_end_where_edges_go_the_same_way():
    # a box of which one vertex lies on an edge, and two are missing
    x, y = [-10, 10, -10, -10, -10, 10, -10], [-15, -15, 15, 15, -15, -15, 15]
    vertices = np.column_stack([x, y, [-20, -20, -20, -10, 20, 20, 20]])
    faces = np.array(list("034042230354246456253152261165"), dtype=int).reshape(-1, 3)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    found = slice_outlines(mesh, FLAT, np.linspace(-19, 19, 16))
    assert all(area(line) > 0 for lines in found for line in lines)


@pytest.mark.parametrize("axis", [(0, 0, 1), (1, 0, 0), (0.3, -0.5, 0.8)])
def test_outlines_lie_on_the_surface(axis):
    mesh, frame = (
        trimesh.creation.torus(2.0, 0.7, major_sections=40, minor_sections=20),
        slice_frame(np.array(axis, float)),
    )
    heights = np.linspace(-2.6, 2.6, 9)
    count = 0
    for height, outlines in zip(heights, slice_outlines(mesh, frame, heights), strict=True):
        for outline in outlines:
            places = np.concatenate([outline, (outline + np.roll(outline, -1, axis=0)) / 2])
            world = np.column_stack([places, np.full(len(places), height)]) @ frame
            assert np.abs(nearest(world, mesh)[0]).max() < 1e-13
            assert area(outline) > 0
            count += 1
    assert count >= 3


def test_a_plane_of_faces_is_cut_just_below():
    assert slice_outlines(letter_l(), FLAT, np.array([letter_l().bounds[0, 2]])) == [[]]
    (top,) = slice_outlines(letter_l(), FLAT, np.array([letter_l().bounds[1, 2]]))
    assert len(top) == 1


def test_faces_are_turned_alike():
    mesh = trimesh.creation.torus(2.0, 0.7, major_sections=12, minor_sections=8)
    faces = mesh.faces.copy()
    faces[::3] = faces[::3, ::-1]
    assert not runs_both_ways(faces)
    body = judge_mesh(trimesh.Trimesh(mesh.vertices, faces, process=False))
    assert runs_both_ways(np.asarray(body.faces))
    assert body.volume == pytest.approx(mesh.volume)
    assert not is_convex(body)


@pytest.fixture(scope="module")
def scanned(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scans") / "out"
    with undrawn():
        return scan3d.scan(letter_l(), folder, slices=3, samples=24, friction="0.0:0.4", probing="off"), folder


@pytest.mark.slow
def test_contacts_lie_on_a_body_that_is_not_convex(scanned):
    result, _ = scanned
    wrong = result.analysis.contact_error > 1e-9 * result.cloud.rod_length
    assert wrong.mean() <= 0.005
    counts = result.report["counts"]
    assert counts["hidden_second_contacts"] <= wrong.sum()
    assert counts["unresolved"] == 0
    assert not result.cloud.convex


@pytest.mark.slow
def test_noisy_contacts_lie_as_far_from_a_body_that_is_not_convex_as_their_errors_say():
    """Of lone contacts, whose errors may be infinite, none is a warning of the arithmetic."""
    recording = scan3d.simulate(
        letter_l(), scan3d.Plan(slices=2, samples=64, noise=1e-3, friction=(0.0, 0.4), probing="off")
    )
    cloud = scan3d.reconstruct(recording)
    off = np.abs(nearest(cloud.points, letter_l())[0]) / cloud.place_sd
    assert len(cloud) > 500
    assert (off > 5).mean() < 0.005
    # a rod across a hole touches both of its edges in one row
    bracket = load_mesh(MESHES / "hollow" / "bracket.stl")
    cloud = scan3d.reconstruct(
        scan3d.simulate(bracket, scan3d.Plan(slices=3, samples=24, noise=1e-3, friction=0.3, probing="off"))
    )
    assert np.abs(nearest(cloud.points, bracket)[0]).max() < 0.02 * cloud.rod_length


@pytest.mark.slow
def test_second_contacts_are_found_by_friction():
    """All contacts lie on the body then, and the rods that touched a second place prove no free space."""
    mesh = letter_l()
    recording = scan3d.simulate(mesh, scan3d.Plan(slices=2, friction=0.3, probing="off"))
    cloud = scan3d.reconstruct(recording)
    assert np.abs(nearest(cloud.points, mesh)[0]).max() < 1e-9 * cloud.rod_length
    assert (np.diff(cloud.row) > 0).all()
    second = np.setdiff1d(np.flatnonzero(np.linalg.norm(recording.force_N, axis=1) > 0), cloud.row)
    assert len(second) == cloud.second >= 3
    # no step from one of these rods counts, and none of them is drawn as one with a single contact
    assert not rods_of(recording, cloud).on[second].any()
    sweep = int(recording.sweep[second[0]])
    drawn = shown_sweep(pipeline.to_scene(pipeline.analyse(recording)), sweep)
    assert len(drawn.base) == (cloud.sweep == sweep).sum()


@pytest.mark.slow
def test_rods_across_shallow_dents_are_found_by_contacts_that_they_have_passed():
    """With friction drawn anew for each sample nothing else tells of contacts that are off by a ten-thousandth of the rod."""
    angle = 2 * np.pi * np.arange(32) / 32
    outline = 20 * np.stack([np.cos(angle), np.sin(angle)], axis=1) * np.where(np.arange(32) % 2, 0.978, 1.0)[:, None]
    mesh = mesh_of(cut(outline, 10))
    assert mesh.is_volume
    recording = scan3d.simulate(mesh, scan3d.Plan(slices=1, sweeps=6, friction=(0.0, 0.4), probing="off"))
    cloud = scan3d.reconstruct(recording)
    assert cloud.second > 0
    assert (np.abs(nearest(cloud.points, mesh)[0]) > 1e-9 * cloud.rod_length).mean() <= 0.005


@pytest.mark.slow
def test_a_contact_without_another_nearby_is_none_where_friction_tells_nothing():
    """The first row in which a rod touched two legs of a table gave a contact, a quarter of the rod's length off."""
    mesh = trimesh.util.concatenate([moved(box(4, 4, 8), (x, y, 0)) for x in (-16, 16) for y in (-11, 11)])
    rod = scan3d.Rod.of_length(0.0505)
    plan = scan3d.Plan(slices=1, sweeps=6, samples=64, friction=(0.0, 0.4), rod=rod, probing="off")
    recording = scan3d.simulate(mesh, plan)
    cloud = scan3d.reconstruct(recording)
    assert len(cloud) > 300
    assert np.abs(nearest(cloud.points, mesh)[0]).max() < 1e-9 * cloud.rod_length
    # nor does one next to contacts of other sweeps tell whether it is that of a second place, where its own has no other
    rows = np.flatnonzero(recording.sweep == recording.sweep[cloud.row[0]])
    lone = scan3d.reconstruct(of_rows(recording, np.setdiff1d(np.arange(len(recording)), rows[rows != cloud.row[0]])))
    assert len(lone) > 250
    assert not (np.linalg.norm(lone.points - cloud.points[0], axis=1) < 1e-9).any()
    # noise hides the second contact in the rows beside
    cloud = scan3d.reconstruct(scan3d.simulate(mesh, replace(plan, sweeps=None, noise=1e-3, seed=1)))
    assert (np.abs(nearest(cloud.points, mesh)[0]) > 5 * cloud.place_sd).mean() <= 0.005


@pytest.mark.slow
def test_the_report_of_a_body_that_is_not_convex(scanned):
    result, folder = scanned
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert report["body"] == {"convex": False, "parts": 1}
    assert report["certificate"]["bound"] is None
    assert report["certificate"]["contours"]["bound"] > 0
    assert "second" in report["certificate"]["premise"]
    shares = report["coverage"]
    unknown = sum(patch["area"] for patch in shares["unknown"]) / result.surface.area
    assert shares["known"] + shares["estimated"] + unknown == pytest.approx(1, abs=1e-6)
    assert set(np.unique(scan3d.open(folder).surface.vertex_attributes["known"])) <= {0, 1, 2}
    rows = dict(result.summary())
    assert "of the surface known" in repr(result)
    assert "of the diagonal" in rows["where touched"]
    assert rows["Hausdorff distance"].endswith("of the diagonal), the largest found")
    assert "not convex" in rows["certified"]


@pytest.mark.slow
def test_what_is_for_convex_bodies_is_refused_for_others(scanned):
    result, _ = scanned
    with pytest.raises(scan3d.InputError, match="method bracket is for convex bodies"):
        scan3d.surface(result.cloud, "bracket")
    with pytest.raises(scan3d.InputError, match="make the surface through contacts and free space by"):
        scan3d.surface(result.cloud)
    for plan in (
        scan3d.Plan(model="spatial", probing="off"),
        scan3d.Plan(tolerance=1e-3),
        scan3d.Plan(rod=scan3d.Rod(2.0, 1e-4, tip_diameter_m=1e-4, diameter_m=2e-4), probing="off"),
    ):
        with pytest.raises(scan3d.InputError, match="not convex"):
            scan3d.simulate(letter_l(), plan)


@pytest.mark.slow
def test_the_meshes_that_come_along_are_closed_and_not_convex():
    for path in sorted((MESHES / "hollow").iterdir()):
        assert not is_convex(load_mesh(path))
        assert not load_mesh(path, hull=True).metadata["filled"]["open"]
