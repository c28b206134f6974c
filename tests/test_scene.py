"""A scene, read from files, in parts, colours and words: what is seen is what was scanned."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from shapes import unit
from small_scans import CUBE, EGG, any_rod, any_rod_in_space, ring, scanned, scanned_in_space
from spatial_scans import SEMI_AXES

import planar
import scan3d
from scan3d import results
from scan3d.cli import main, show
from scan3d.geometry.distance import distances
from scan3d.pictures import parts
from scan3d.pictures.parts import (
    contact_paths,
    contact_sentence,
    of_cloud,
    out_of_plane_deg,
    outlines,
    shade_surface,
    shown_surface,
    shown_sweep,
    sweep_direction,
)
from scan3d.recording import of_rows
from scan3d.report import key_figures


@pytest.fixture(scope="module")
def ellipsoid():
    return scanned_in_space()


# --- files ---


def test_a_folder_is_shown_as_it_was_scanned(folder):
    scene = show.read_scene(folder, None, False, "mm")
    assert (scene.name, scene.unit) == ("egg", "mm")
    assert scene.truth.extents == pytest.approx(scan3d.load_mesh(EGG).extents)
    log = scan3d.read_recording(folder / "recording.csv")
    assert np.array_equal(scene.recording.force_N, log.force_N)
    assert np.array_equal(scene.points, scan3d.reconstruct(log).points)
    assert len(scene.bound) == len(scene.surface.vertices)
    assert dict(scene.key_figures)["contacts"].startswith(f"{len(scene.points)} of ")
    # a recording alone gives the same, but for the truth
    alone = show.read_scene(folder / "recording.csv", None, False, "mm")
    assert np.array_equal(alone.points, scene.points)
    assert np.asarray(alone.surface.vertices) == pytest.approx(np.asarray(scene.surface.vertices))
    assert alone.bound == pytest.approx(scene.bound, rel=1e-6)
    assert alone.truth is None


@pytest.mark.slow
def test_a_stored_scan_in_space_has_all_that_its_pictures_need(ellipsoid, tmp_path, no_pictures):
    scan3d.write_recording(ellipsoid.recording, tmp_path / "recording.csv")
    assert main(["reconstruct", str(tmp_path / "recording.csv"), "--out", str(tmp_path), "--quiet"]) == 0
    report = results.read_report(tmp_path)
    read = results.scene_of_folder(tmp_path, report, "mm")
    assert report["model"] == "spatial"
    cloud = scan3d.reconstruct(read.recording)
    assert read.column("slice") is None
    assert dict(read.key_figures)["contacts"].endswith("sweeps in space")
    assert read.column("bending") == pytest.approx(cloud.bending_angle, abs=1e-6)
    tangents = np.stack([read.column(f"t{axis}") for axis in "xyz"], axis=1)
    assert tangents == pytest.approx(cloud.tangents, abs=1e-6)
    sweep = shown_sweep(read)
    assert sweep.contact == pytest.approx(cloud.centre_points[cloud.sweep == sweep.number], abs=1e-9 * read.diagonal)


def test_the_truth_is_found_beside_the_folder_unless_it_has_changed(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    report = results.read_report(folder)
    assert Path(results.find_truth(folder, report)).samefile(folder.parent / "egg.stl")
    (tmp_path / "parts").mkdir()
    (tmp_path / "elsewhere").mkdir()
    for body, found in ((None, None), (CUBE, None), (EGG, "parts/egg.stl")):
        if body:
            (tmp_path / "parts" / "egg.stl").write_bytes(body.read_bytes())
        assert results.find_truth(tmp_path / "elsewhere", report) == (found and Path(found))
    assert results.find_truth(tmp_path / "elsewhere", {}) is None


def strings(value):
    if isinstance(value, dict):
        value = [*value, *value.values()]
    return [text for item in value for text in strings(item)] if isinstance(value, list) else [str(value)]


def test_a_report_names_no_place_outside_its_folder(folder):
    report = results.read_report(folder)
    assert report["mesh"]["file"] == report["source"]["mesh"] == "egg.stl"
    words = strings(dict(report))
    assert len(words) > 100
    assert not [word for word in words if ".." in word or "/" in word.replace("Hausdorff/", "") or "\\" in word]


def test_plys_and_meshes(folder, tmp_path):
    cloud, surface = (show.read_scene(folder / f"{name}.ply", None, False, "in") for name in ("cloud", "surface"))
    assert cloud.unit == surface.unit == "mm"  # as the files say
    assert (cloud.surface, surface.contacts) == (None, None)
    assert len(surface.bound) == len(surface.surface.vertices)
    points, path = np.random.default_rng(0).normal(size=(50, 3)), tmp_path / "foreign.ply"
    rows = np.column_stack([points, np.eye(3)[[2] * 50]])
    text = "\n".join(" ".join(map(str, row)) for row in rows.tolist()).encode()
    for kind, names, body in (
        ("ascii", ("x", "y", "z", "nx", "ny", "nz"), text),
        ("binary_big_endian", ("x", "y", "z"), points.astype(">f4").tobytes()),
    ):
        properties = "".join(f"property float {name}\n" for name in names)
        faces = "element face 0\nproperty list uchar int vertex_indices\nend_header\n"
        path.write_bytes(f"ply\nformat {kind} 1.0\nelement vertex 50\n{properties}{faces}".encode() + body)
        foreign = show.read_scene(path, None, False, "in")
        assert (foreign.unit, foreign.contacts.dtype.names) == ("in", names)
        assert len(parts.shade_contacts(foreign, "force").rgb) == 50  # although nothing is known of the points
        assert foreign.points == pytest.approx(points, rel=1e-6)
    scan3d.load_mesh(CUBE).export(tmp_path / "mesh.ply", encoding="ascii")
    for path in (CUBE, tmp_path / "mesh.ply"):
        mesh = show.read_scene(path, str(EGG), False, "mm")
        assert mesh.surface.extents == pytest.approx([40.0, 40.0, 40.0])
        assert mesh.truth is not None


# --- slices, paths and rods ---


def test_slices_are_closed_lines_through_their_contacts(egg):
    slice_of_contact, drawn = egg.column("slice"), outlines(egg)
    assert [number for _, number in drawn] == sorted(set(slice_of_contact))
    for outline, number in drawn:
        points = egg.points[slice_of_contact == number]
        assert np.array_equal(outline[0], outline[-1])
        assert len(outline) == len(points) + 1
        assert np.ptp(outline[:, 2]) < 1e-9
        # in order: the egg's slices are circles, and a polygon in any other order is far longer
        length = np.linalg.norm(np.diff(outline, axis=0), axis=1).sum()
        assert length <= np.pi * np.ptp(outline[:, 0]) * 1.05


@pytest.mark.slow
def test_a_hollow_body_is_cut_by_its_slices_and_seen_from_the_side_of_its_pictures():
    """Contacts ordered around a slice went to and fro between walls, and those of all probings were one line."""
    scene = ring()
    slices = scene.column("slice")
    assert (slices < 0).any()
    of_slice = dict.fromkeys(slices[slices >= 0], 0)
    for line, number in outlines(scene):
        of_slice[number] += 1
        assert np.array_equal(line[0], line[-1])
        assert np.abs(distances(line, scene.surface)).max() < 1e-9 * scene.diagonal
        assert np.ptp(line[:, 2]) < 1e-9
    assert max(of_slice.values()) == 2  # a ring has an inner and an outer wall
    sweep = shown_sweep(scene)
    assert (sweep.contact.mean(axis=0) - scene.points.mean(axis=0)) @ parts.DIRECTION > 0


def test_paths_of_contacts_are_broken_where_the_rod_leaves_the_body(ellipsoid):
    row, sweep = ellipsoid.column("row"), ellipsoid.column("sweep")
    paths = contact_paths(ellipsoid)
    assert {number for _, number in paths} <= set(sweep)
    for line, number in paths:
        mine = np.flatnonzero(sweep == number)
        index = [mine[np.argmin(np.linalg.norm(ellipsoid.points[mine] - point, axis=1))] for point in line]
        assert (np.diff(row[index]) == 1).all()
    assert max(np.linalg.norm(np.diff(line, axis=0), axis=1).max() for line, _ in paths) < 0.2 * ellipsoid.diagonal


def check_lengths(sweep, scene):
    along = [np.linalg.norm(np.diff(lines, axis=1), axis=2).sum(axis=1) for lines in (sweep.curved, sweep.rest)]
    assert sum(along) == pytest.approx(np.full(len(sweep.base), 1e3 * scene.recording.rod.length_m), rel=1e-6)
    start = sweep.curved[:, 1] - sweep.curved[:, 0]
    assert (start @ sweep.axes[1] > 0.999 * np.linalg.norm(start, axis=1)).all()


@pytest.mark.slow
def test_rods_touch_where_the_contacts_are_in_whatever_order_these_are(egg):
    number = shown_sweep(egg).number
    for scene in (egg, replace(egg, contacts=egg.contacts[np.random.default_rng(5).permutation(len(egg.contacts))])):
        sweep = shown_sweep(scene, number, points=2000)
        assert sweep.contact == pytest.approx(scene.points[scene.column("sweep") == number], abs=1e-9 * egg.diagonal)
        check_lengths(sweep, egg)
    assert (np.diff(shown_sweep(egg).base @ shown_sweep(egg).axes[0]) < 0).all()


@pytest.mark.slow
def test_rods_in_space_touch_where_the_contacts_are(ellipsoid):
    cloud, sides = scan3d.reconstruct(ellipsoid.recording), set()
    for number in np.unique(cloud.sweep)[::3]:
        sweep, rows = shown_sweep(ellipsoid, number, points=2000), cloud.sweep == number
        assert sweep.slice is None
        assert sweep.contact == pytest.approx(cloud.centre_points[rows], abs=1e-9 * ellipsoid.diagonal)
        check_lengths(sweep, ellipsoid)
        # past a tangential contact the rod goes straight on along its tangent, and stays outside of the body
        tangential = cloud.phase[rows] == planar.Phase.TANGENTIAL
        rest = unit(np.diff(sweep.rest, axis=1)[tangential, 0])
        assert rest == pytest.approx(cloud.tangents[rows][tangential], abs=1e-6)
        semi_axes = np.array(SEMI_AXES) * 50  # mm
        assert (np.linalg.norm(sweep.rods.reshape(-1, 3) / semi_axes, axis=1) > 1.0).all()
        # rods that bend downward are seen from below
        up = np.sign(((sweep.contact - sweep.base) @ sweep.axes[2]).mean())
        assert np.sign(sweep_direction(sweep) @ sweep.axes[2]) == up
        sides.add(up)
    assert sides == {-1.0, 1.0}


@pytest.mark.slow
@pytest.mark.parametrize("scanned", [any_rod, any_rod_in_space])
def test_any_rod_touches_where_the_contacts_are(scanned):
    scene = scanned()
    assert (
        np.abs(any_rod().contacts["quality"]).max() < 1e-7
    )  # at touch-down there is no force, and no contact by rounding
    sweep = shown_sweep(scene, points=500)
    rows = scene.column("sweep") == sweep.number
    assert np.abs(sweep.contact - scene.points[rows]).max() < 1e-6 * scene.diagonal
    check_lengths(sweep, scene)


def test_clamps_may_turn_during_a_sweep(ellipsoid):
    recording, number = ellipsoid.recording, shown_sweep(ellipsoid).number
    # turned about the world's z axis, as far as the sample's number says; contacts turn about the clamps
    turns = Rotation.from_rotvec(np.outer(1e-3 * np.arange(len(recording)), [0, 0, 1]))
    quaternion = (turns * Rotation.from_quat(recording.quaternion, scalar_first=True)).as_quat(scalar_first=True)
    turned = replace(recording, quaternion=quaternion)
    cloud = scan3d.reconstruct(turned)
    sweep = shown_sweep(of_cloud(cloud, recording=turned), number)
    rows = cloud.sweep == number
    assert sweep.turns == pytest.approx(turned.axes()[cloud.row[rows]])
    assert not np.allclose(sweep.turns[0], sweep.turns[-1])
    assert sweep.contact == pytest.approx(cloud.centre_points[rows], abs=1e-9 * ellipsoid.diagonal)


def test_contacts_that_do_not_come_from_the_recording(egg):
    message = "the contacts of egg do not belong to its recording, which rods are drawn from: reconstruct it again"
    log, columns = egg.recording, [name for name in egg.contacts.dtype.names if name != "row"]
    for changed in (
        dict(contacts=egg.contacts[columns]),
        dict(recording=of_rows(log, np.arange(len(log) // 2))),
        dict(recording=scanned(EGG, sweeps=7).recording),
    ):
        with pytest.raises(scan3d.InputError, match=message):
            shown_sweep(replace(egg, **changed))


# --- the surface ---


def test_the_deviation_is_looked_up_inside_large_facets(cube):
    mesh, deviation, bound, _ = shown_surface(cube)
    assert mesh.edges_unique_length.max() <= cube.diagonal / 60 * (1 + 1e-9)
    assert mesh.volume == pytest.approx(cube.surface.volume)
    # the hull of the contacts lies inside: its lid below the cube's, its sides in the cube's
    lid = mesh.vertices[:, 2] > mesh.vertices[:, 2].max() - 1e-6
    inner = lid & (np.abs(mesh.vertices[:, :2]).max(axis=1) < 15)
    assert deviation[inner] == pytest.approx(mesh.vertices[inner, 2] - 20, abs=1e-6)
    assert deviation.max() < 1e-9
    # at old vertices the bound is unchanged, and elsewhere it lies between those of old vertices
    old = np.linalg.norm(mesh.vertices[:, None] - cube.surface.vertices, axis=2)
    same = np.argwhere(old < 1e-9)
    assert bound[same[:, 0]] == pytest.approx(cube.bound[same[:, 1]], abs=1e-6)
    assert cube.bound.min() - 1e-6 <= bound.min() <= bound.max() <= cube.bound.max() + 1e-6


def test_the_deviation_is_positive_outside_also_where_a_body_is_not_convex():
    thicker, body = trimesh.creation.torus(10, 4.2, 96, 48), trimesh.creation.torus(10, 4, 96, 48)
    deviation = shown_surface(parts.Scene("ring", "mm", surface=thicker, truth=body))[1]
    np.testing.assert_allclose(deviation, 0.2, atol=0.02)


def test_no_bound_is_shown_that_is_larger_than_that_of_a_corner(cube):
    """Slivers, of which barycentric coordinates are rounding, show values of their corners, as every other facet does."""
    rng = np.random.default_rng(3)
    for flatness in (1e-3, 1e-9, 1e-13, 1e-17, 0.0):
        corners = np.cumsum(rng.uniform(size=(40, 2)), axis=0)
        vertices = np.column_stack([corners[:, 0], flatness * rng.normal(size=40) + corners[:, 0], corners[:, 1] * 0])
        faces = np.column_stack([np.arange(38), np.arange(1, 39), np.arange(2, 40)])
        slivers = trimesh.Trimesh(vertices, faces, process=False)
        bound = rng.uniform(1, 2, 40)
        shown = shown_surface(replace(cube, surface=slivers, bound=bound, truth=None))[2]
        assert len(shown) > 40
        assert bound.min() - 1e-9 <= shown.min() <= shown.max() <= bound.max() + 1e-9


def test_a_body_that_is_not_convex_has_no_bound_at_its_surface_to_show(cube):
    surface = cube.surface.copy()
    surface.vertex_attributes["known"] = np.full(len(surface.vertices), 2)
    with pytest.raises(scan3d.InputError, match="not convex, and the view surface shows what of it is known"):
        shade_surface(replace(cube, surface=surface, bound=None), "bound")
    # beside another surface the distance from that is shown
    other = replace(cube, surface=surface, bound=None).against(trimesh.creation.box([30.0] * 3))
    assert shade_surface(other)[1].title.startswith("signed distance from the other surface")


def test_the_distance_from_another_surface_is_signed_and_exact(cube):
    """Of a box in a larger one, in a dented one and in one whose facets are turned inside out."""
    side = np.ptp(cube.surface.vertices, axis=0)[0]
    inner = trimesh.creation.box([side] * 3)
    for factor in (0.5, 2.0):
        other = trimesh.creation.box([factor * side] * 3)
        for shape in (other, trimesh.Trimesh(other.vertices, other.faces[:, ::-1], process=False)):
            mesh, distance, *_ = shown_surface(replace(cube, surface=inner, bound=None).against(shape))
            inside = np.abs(mesh.vertices).max(axis=1) - factor * side / 2
            facing = np.sort(np.abs(mesh.vertices), axis=1)[:, 1] < 0.2 * side  # opposite the middles of faces
            np.testing.assert_allclose(distance[facing], inside[facing], atol=1e-9 * side)
            assert (distance > 0).all() if factor < 1 else (distance < 0).all()


# --- colours ---


def test_colours_of_bounds_between_vertices_are_on_the_scale(cube):
    """Values are interpolated, not colours: a mixture of pale and dark need not be a colour of the scale."""
    bound = np.where(cube.surface.vertices[:, 0] > 0, 0.4, 0.0)
    mesh, shaded = parts.shade_surface(replace(cube, bound=bound, truth=None), "bound")
    assert mesh.volume == pytest.approx(cube.surface.volume)
    assert (shaded.norm.vmin, shaded.norm.vmax) == (0.0, pytest.approx(400.0))  # µm
    colors = {tuple(color) for color in shaded.rgb}
    scale = parts.shade(np.linspace(0, 1, 256), "", 0, 1, map="YlGnBu").rgb
    assert colors <= {tuple(color) for color in scale}
    assert len(colors) > 30


def test_colours_are_those_of_their_scales(egg):
    friction = parts.shade_contacts(egg, "friction")
    tip = egg.column("phase") == planar.Phase.TIP
    assert tip.any()
    assert (friction.rgb[tip] == [154, 154, 154]).all()  # unknown: grey
    low, high = np.nanargmin(egg.column("friction")), np.nanargmax(egg.column("friction"))
    assert friction.rgb[low] == pytest.approx([68, 1, 84], abs=1)  # viridis
    assert friction.rgb[high] == pytest.approx([253, 231, 37], abs=1)
    force = parts.shade_contacts(egg, "force")
    assert (force.norm.vmin, force.norm.vmax) == (0.0, pytest.approx(1e3 * egg.column("force").max()))


def test_the_bending_out_of_the_plane_is_red_above_it_and_blue_below_it(ellipsoid):
    shaded = parts.shade_contacts(ellipsoid, "bending")
    angle = np.rad2deg(np.arcsin(np.sin(scan3d.reconstruct(ellipsoid.recording).bending_angle)))
    assert shaded.norm.vmax == pytest.approx(np.abs(angle).max(), rel=1e-6)
    red, blue = shaded.rgb[:, 0].astype(int), shaded.rgb[:, 2].astype(int)
    assert (red > blue)[angle > 5].all()
    assert (blue > red)[angle < -5].all()
    # it is small for rods that bend backward
    angles = np.deg2rad([0.0, 30.0, 90.0, 150.0, 180.0, -170.0, -90.0, -10.0])
    assert out_of_plane_deg(angles) == pytest.approx([0, 30, 90, 30, 0, -10, -90, -10], abs=1e-9)


# --- words ---


def test_key_figures_are_those_of_the_report(folder):
    report = json.loads((folder / "report.json").read_text())
    shown = dict(key_figures(report))
    assert shown["scan"].startswith("within ")
    counts = report["counts"]
    counts["slices"] += counts["empty_slices"]
    for name, words in {"contacts": "of", "slices": "slices", "sweeps": "sweeps"}.items():
        assert f"{counts[name]} {words}" in shown["contacts"]
    assert shown["Hausdorff distance"].startswith(f"{report['hausdorff']['two_sided']:.3g} mm (")
    assert shown["size"] == "42.31 × 42.31 × 56 mm"
    # without the truth
    assert "Hausdorff distance" not in dict(key_figures({**report, "hausdorff": None}))


def test_the_sentence_of_a_contact(egg, ellipsoid):
    contact = int(np.flatnonzero(egg.column("phase") == planar.Phase.TANGENTIAL)[0])
    sentence = contact_sentence(egg, contact)
    assert sentence.startswith(f"contact {contact}: ({egg.points[contact][0]:.4f}, ")
    for part in ("mm, sweep 0, slice 0, tangential contact, force ", " mN, friction 0.", "normal ("):
        assert part in sentence
    points_only = replace(egg, contacts=egg.contacts[["x", "y", "z"]])
    assert contact_sentence(points_only, 0) == "contact 0: ({:.4f}, {:.4f}, {:.3f}) mm".format(*egg.points[0])
    angle = scan3d.reconstruct(ellipsoid.recording).bending_angle
    contact = int(np.argmax(np.abs(np.sin(angle))))
    sentence = contact_sentence(ellipsoid, contact)
    assert f", bending {np.rad2deg(np.arcsin(np.sin(angle[contact]))):.1f}° out of the sweep's plane" in sentence
    assert "slice" not in sentence
