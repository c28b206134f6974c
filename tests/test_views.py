"""Scenes, pictures and the command `show`: what is seen is what was scanned, and without a renderer nothing crashes."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from small_scans import CUBE, EGG, scanned

import planar
import scan3d
from scan3d import commands, files, scenes, stages, views, windows
from scan3d.cli import main

COMMAND = Path(sys.executable).with_name("scan3d")
FEW = ("--slices", "4", "--sweeps", "4", "--samples", "8", "--quiet")


@pytest.fixture(scope="module")
def egg():
    return scanned(EGG)


@pytest.fixture(scope="module")
def cube():
    return scanned(CUBE)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A scan's folder, as the command makes it without pictures, beside its mesh."""
    place = tmp_path_factory.mktemp("show")
    (place / "egg.stl").write_bytes(EGG.read_bytes())
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(views, "can_render", lambda: False)
        assert main(["scan", str(place / "egg.stl"), "--out", str(place / "out"), *FEW]) == 0
    return place / "out"


# --- scenes ---


def test_slices_are_closed_lines_through_their_contacts(egg):
    number, rings = egg.column("slice"), scenes.rings(egg)
    assert [one for _, one in rings] == sorted(set(number))
    for ring, one in rings:
        points = egg.points[number == one]
        assert np.array_equal(ring[0], ring[-1])
        assert len(ring) == len(points) + 1
        assert np.ptp(ring[:, 2]) < 1e-9
        # in order: the egg's slices are circles, and a polygon in any other order is far longer
        around = np.linalg.norm(np.diff(ring, axis=0), axis=1).sum()
        assert around <= np.pi * np.ptp(ring[:, 0]) * 1.05


def test_rods_touch_where_the_contacts_are_and_keep_their_length(egg):
    one = scenes.sweep(egg, points=2000)
    mine = egg.column("sweep") == one.number
    assert one.contact == pytest.approx(egg.points[mine], abs=1e-9 * egg.diagonal)
    length = egg.recording.rod.length_m * 1e3
    along = [np.linalg.norm(np.diff(lines, axis=1), axis=2).sum(axis=1) for lines in (one.curved, one.straight)]
    assert sum(along) == pytest.approx(np.full(mine.sum(), length), rel=1e-6)
    assert np.array_equal(one.phase, egg.column("phase")[mine])
    # the rod starts along the clamp's y axis, and the base moves in -x
    start = one.curved[:, 1] - one.curved[:, 0]
    assert (start @ one.axes[1] > 0.999 * np.linalg.norm(start, axis=1)).all()
    assert (np.diff(one.base @ one.axes[0]) < 0).all()


def test_the_telling_sweep_lies_in_the_middle_and_reaches_far(cube):
    one = scenes.sweep(cube)
    assert abs(one.contact[0, 2]) < 10  # of ±20
    assert np.linalg.norm(np.ptp(one.contact, axis=0)) > 35


def test_noise_is_no_rod():
    noisy = scanned(CUBE, noise=1e-3)
    one = scenes.sweep(noisy)
    assert len(one.base) == (noisy.column("sweep") == one.number).sum()
    assert np.linalg.norm(np.ptp(one.curved.reshape(-1, 3), axis=0)) < 10 * noisy.diagonal


def test_a_sweep_that_is_not_there(egg):
    with pytest.raises(scan3d.InputError, match="sweep 4711 has no contact; choose one of the 48"):
        scenes.sweep(egg, 4711)
    with pytest.raises(scan3d.InputError, match="egg has no recording, where rods need one"):
        scenes.sweep(replace(egg, recording=None))


def test_the_deviation_is_looked_up_inside_large_facets(cube):
    mesh, off, bound = scenes.shown_surface(cube)
    assert mesh.edges_unique_length.max() <= cube.diagonal / 60 * (1 + 1e-9)
    assert mesh.volume == pytest.approx(cube.surface.volume)
    # the hull of the contacts lies inside: its lid below the cube's, its sides in the cube's
    lid = mesh.vertices[:, 2] > mesh.vertices[:, 2].max() - 1e-6
    inner = lid & (np.abs(mesh.vertices[:, :2]).max(axis=1) < 15)
    assert off[inner] == pytest.approx(mesh.vertices[inner, 2] - 20, abs=1e-6)
    assert off.max() < 1e-9
    # the bound stays what it was at old vertices, and between them lies between
    old = np.linalg.norm(mesh.vertices[:, None] - cube.surface.vertices, axis=2)
    same = np.argwhere(old < 1e-9)
    assert bound[same[:, 0]] == pytest.approx(cube.bound[same[:, 1]], abs=1e-6)
    assert cube.bound.min() - 1e-6 <= bound.min() <= bound.max() <= cube.bound.max() + 1e-6


def test_key_figures_are_the_reports(folder):
    report = json.loads((folder / "report.json").read_text())
    found = dict(scenes.figures(report))
    assert [found[name] for name in ("contacts", "slices", "sweeps")] == [
        str(report["counts"][name]) for name in ("contacts", "slices", "sweeps")
    ]
    assert found["Hausdorff distance"].startswith(f"{report['hausdorff']['two_sided']:.3g} mm (")
    assert found["size"] == "42.31 × 42.31 × 56 mm"
    # without the truth
    assert "Hausdorff distance" not in dict(scenes.figures({**report, "hausdorff": None}))
    assert scenes.figures({}) == ()


def test_the_truth_is_found_beside_the_folder_unless_it_has_changed(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    report = scenes.read_report(folder)
    assert Path(scenes.find_truth(folder, report)).samefile(folder.parent / "egg.stl")
    (tmp_path / "parts").mkdir()
    (tmp_path / "elsewhere").mkdir()
    assert scenes.find_truth(tmp_path / "elsewhere", report) is None
    (tmp_path / "parts" / "egg.stl").write_bytes(CUBE.read_bytes())
    assert scenes.find_truth(tmp_path / "elsewhere", report) is None
    (tmp_path / "parts" / "egg.stl").write_bytes(EGG.read_bytes())
    assert scenes.find_truth(tmp_path / "elsewhere", report) == "parts/egg.stl"
    assert scenes.find_truth(tmp_path / "elsewhere", {}) is None


def test_the_truth_is_found_where_it_was(tmp_path, monkeypatch, capsys):
    """However far it lies from where the results are, and from where `show` is called."""
    (tmp_path / "parts" / "old").mkdir(parents=True)
    mesh = tmp_path / "parts" / "old" / "egg.stl"
    mesh.write_bytes(EGG.read_bytes())
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    assert (
        main(["scan", "../parts/old/egg.stl", "--out", "deep/out", "--slices", "4", "--samples", "8", "--quiet"]) == 0
    )
    report = scenes.read_report(Path("deep/out"))
    assert report["mesh"]["path"] == os.path.join("..", "..", "..", "parts", "old", "egg.stl")
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "work" / "deep" / "out"
    assert Path(scenes.find_truth(folder, report)).samefile(mesh)
    mesh.unlink()
    assert scenes.find_truth(folder, report) is None


def test_what_was_felt_in_a_sentence(egg):
    lying = int(np.flatnonzero(egg.column("phase") == planar.Phase.TANGENTIAL)[0])
    said = scenes.sentence(egg, lying)
    assert said.startswith(f"contact {lying}: ({egg.points[lying][0]:.6g}, ")
    for word in ("mm, sweep 0, slice 0, tangential contact, force ", " mN, friction 0.", "normal ("):
        assert word in said
    bare = replace(egg, contacts=egg.contacts[["x", "y", "z"]])
    assert scenes.sentence(bare, 0) == "contact 0: ({:.6g}, {:.6g}, {:.6g}) mm".format(*egg.points[0])


# --- files that are shown ---


def test_a_folder_is_shown_as_it_was_scanned(folder):
    scene = commands._scene(folder, None, False, "mm")
    assert (scene.name, scene.unit) == ("egg", "mm")
    assert scene.truth.extents == pytest.approx(scan3d.load_mesh(EGG).extents)
    log = scan3d.read_recording(folder / "recording.csv")
    assert np.array_equal(scene.recording.force_N, log.force_N)
    assert np.array_equal(scene.points, scan3d.reconstruct(log).points)
    assert len(scene.bound) == len(scene.surface.vertices)
    assert dict(scene.figures)["contacts"] == str(len(scene.points))
    # a recording alone gives the same, but for the truth
    alone = commands._scene(folder / "recording.csv", None, False, "mm")
    assert np.array_equal(alone.points, scene.points)
    assert np.asarray(alone.surface.vertices) == pytest.approx(np.asarray(scene.surface.vertices))
    assert alone.bound == pytest.approx(scene.bound, rel=1e-6)
    assert alone.truth is None


def test_plys_and_meshes(folder, tmp_path):
    cloud, surface = (commands._scene(folder / f"{name}.ply", None, False, "in") for name in ("cloud", "surface"))
    assert cloud.unit == surface.unit == "mm"  # as the files say
    assert cloud.surface is None
    assert surface.contacts is None
    assert len(surface.bound) == len(surface.surface.vertices)

    points = np.random.default_rng(0).normal(size=(50, 3))
    trimesh.PointCloud(points).export(tmp_path / "foreign.ply")
    foreign = commands._scene(tmp_path / "foreign.ply", None, False, "in")
    assert foreign.unit == "in"
    assert foreign.points == pytest.approx(points, rel=1e-6)
    scan3d.load_mesh(CUBE).export(tmp_path / "mesh.ply", encoding="ascii")
    for path in (CUBE, tmp_path / "mesh.ply"):
        mesh = commands._scene(path, str(EGG), False, "mm")
        assert mesh.surface.extents == pytest.approx([40.0, 40.0, 40.0])
        assert mesh.truth is not None


def test_contacts_in_one_plane_are_still_shown(folder, tmp_path):
    log = scan3d.read_recording(folder / "recording.csv")
    mine = log.sweep == np.unique(log.sweep)[5]
    columns = ("sweep", "position_m", "quaternion", "force_N", "moment_Nm")
    scan3d.write_recording(replace(log, **{name: getattr(log, name)[mine] for name in columns}), tmp_path / "one.csv")
    scene = commands._scene(tmp_path / "one.csv", None, False, "mm")
    assert scene.surface is None
    assert len(scene.points) > 3


def nothing(place):
    return place / "nothing"


def empty_folder(place):
    (place / "empty").mkdir()
    return place / "empty"


def no_report(place):
    (place / "cloud.ply").write_bytes(b"ply\n")
    (place / "report.json").write_text("[1]")
    return place


def torn_report(place):
    (place / "report.json").write_text("{")
    return place


def surface_for_cloud(place):
    rows = np.zeros(3, dtype=[(name, "f8") for name in "xyz"])
    (place / "cloud.ply").write_bytes(files.ply(rows, np.array([[0, 1, 2]])))
    return place


def no_points(place):
    (place / "none.ply").write_bytes(files.ply(np.zeros(3, dtype=[("force", "f8")])))
    return place / "none.ply"


def points_of_nan(place):
    (place / "nan.ply").write_bytes(files.ply(np.full(3, np.nan, dtype=[(name, "f8") for name in "xyz"])))
    return place / "nan.ply"


def torn(place):
    (place / "torn.ply").write_bytes(b"ply\nformat binary_little_endian 1.0\nelement vertex 9\n")
    return place / "torn.ply"


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (nothing, "there is no .*nothing; show a scan's folder, a recording"),
        (empty_folder, "holds no scan: expected cloud.ply or surface.ply in it; make it with 'scan3d scan'"),
        (no_report, "is no report: expected a JSON object; run the scan again"),
        (torn_report, "can't read .*report.json: .*; run the scan again"),
        (surface_for_cloud, "cloud.ply holds something else than its name says; run the scan again"),
        (no_points, "none.ply has no points: expected the columns x, y and z"),
        (points_of_nan, "nan.ply has no points, or some that are not numbers; expected a cloud of contacts"),
        (torn, "can't read .*torn.ply: .*; expected a PLY of points or triangles"),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_what_can_not_be_shown(tmp_path, capsys, make, sentence):
    page = tmp_path / "page.html"
    with pytest.raises(scan3d.InputError, match=sentence):
        commands.show(str(make(tmp_path)), print, html=str(page))
    assert not page.exists()


# --- pictures ---


def pixels(path):
    with Image.open(path) as image:
        return np.asarray(image.convert("RGB")).astype(int)


def share(image, color, near=40):
    """Share of pixels of about this colour."""
    rgb = [int(color[k : k + 2], 16) for k in (1, 3, 5)]
    return (np.abs(image - rgb).max(axis=2) < near).mean()


def draw(scene, path, view, color="force"):
    views.picture(scene, path, view, color)
    image = pixels(path)
    assert image.shape[1] == 1400  # 7 inches
    assert 600 <= image.shape[0] <= 1250
    # on white paper
    assert (image[:20] == 255).all()
    assert (image[:, :5] == 255).all()
    return image


BAR = (slice(None), slice(1150, 1210))


@pytest.mark.rendering
def test_the_surface_by_its_deviation(cube, tmp_path):
    image = draw(cube, tmp_path / "surface.png", "surface")
    # the hull's lid, in the picture's middle, lies farthest inside; its sides in the true ones
    middle = image[150:1000, 200:900]
    assert share(middle, "#053061", 25) > 0.1
    assert share(middle, "#b2182b", 40) == 0
    grey = np.ptp(middle, axis=2) < 12
    assert (grey & (middle.mean(axis=2) < 245)).mean() > 0.3
    # the bar goes from dark blue through white to dark red, symmetrically
    bar = image[BAR][:, 30]
    inside = np.flatnonzero(np.ptp(bar, axis=1) > 30)
    assert bar[inside[0]] == pytest.approx([103, 0, 31], abs=40)
    assert bar[inside[-1]] == pytest.approx([5, 48, 97], abs=40)
    assert bar[(inside[0] + inside[-1]) // 2] == pytest.approx([247, 247, 247], abs=12)


@pytest.mark.rendering
def test_the_surface_by_its_bound(egg, tmp_path):
    # as asked for, or where there is no truth
    for scene, view in ((egg, "bound"), (replace(egg, truth=None), "surface")):
        image = draw(scene, tmp_path / "bound.png", view)
        # sequential: from pale yellow to dark blue
        bar = image[BAR][:, 30]
        inside = np.flatnonzero(np.ptp(bar, axis=1) > 20)
        assert bar[inside[0]] == pytest.approx([8, 29, 88], abs=30)
        assert bar[inside[-1]] == pytest.approx([255, 255, 217], abs=30)
        assert share(image[:, :1090], "#225ea8", 60) > 0.01
    plain = draw(replace(egg, truth=None, bound=None), tmp_path / "plain.png", "surface")
    assert (plain[:, 1150:] == 255).all()  # no bar
    assert 0.1 < (plain < 250).all(axis=2).mean() < 0.7


def test_bounds_between_vertices_keep_to_the_scale(cube):
    """Mixed by their values: mixed by their colours, pale and dark would give what the bar does not have."""
    bound = np.where(cube.surface.vertices[:, 0] > 0, 0.4, 0.0)
    mesh, shaded = views.shade_surface(replace(cube, bound=bound, truth=None), "bound")
    assert mesh.volume == pytest.approx(cube.surface.volume)
    assert (shaded.norm.vmin, shaded.norm.vmax) == (0.0, 0.4)
    colors = {tuple(one) for one in shaded.rgb}
    scale = stages.shade(np.linspace(0, 1, 256), "", 0, 1, map="YlGnBu").rgb
    assert colors <= {tuple(one) for one in scale}
    assert len(colors) > 30
    # linear across the lid, from side to side
    lid = mesh.vertices[:, 2] > mesh.vertices[:, 2].max() - 1e-6
    x = mesh.vertices[lid, 0]
    _, _, values = scenes.shown_surface(replace(cube, bound=bound, truth=None))
    assert values[lid].min() >= -1e-12
    assert values[lid][x < x.min() + 1e-6].max() <= values[lid][x > x.max() - 1e-6].min()


@pytest.mark.rendering
@pytest.mark.parametrize("color", scenes.COLORS)
def test_the_cloud_by_each_colour(egg, tmp_path, color):
    image = draw(egg, tmp_path / "cloud.png", "cloud", color)
    body, right = image[:, :1090], image[:, 1100:]
    if color == "phase":
        assert share(body, stages.TANGENTIAL, 60) > 2e-3
        assert share(body, stages.TIP, 60) > 5e-5
    else:
        colorful = np.ptp(body, axis=2) > 60
        assert colorful.mean() > 2e-3
        # viridis: green, blue and violet, and no red in it
        red, green, blue = np.moveaxis(body, 2, 0)
        assert not ((red - green > 60) & (red - blue > 60)).any()
        assert (np.ptp(right, axis=2) > 60).mean() > 0.02  # the bar
    # normals stick out of the body
    assert share(body, stages.NORMAL, 60) > 1e-3


@pytest.mark.rendering
def test_truth_and_reconstruction_side_by_side(cube, tmp_path):
    image = draw(cube, tmp_path / "compare.png", "compare")
    left, right = image[:, 14:574], image[:, 588:1148]
    assert share(left, "#053061", 25) == 0
    assert share(right, "#053061", 25) > 0.05
    # by the same camera: below the titles and above the scale the outlines agree
    rows = slice(120, image.shape[0] - 160)
    outlines = [(np.abs(one[rows].astype(int) - 255).max(axis=2) > 12) for one in (left, right)]
    assert (outlines[0] != outlines[1]).mean() < 0.02
    assert outlines[0].mean() > 0.2


@pytest.mark.rendering
@pytest.mark.parametrize("scene", ["egg", "cube"])
def test_the_scene_that_explains(scene, tmp_path, request):
    image = draw(request.getfixturevalue(scene), tmp_path / "explain.png", "explain")
    upper = image[:-150]  # without the legend
    assert share(upper, stages.ROD, 50) > 3e-3
    assert share(upper, stages.TANGENTIAL, 60) > 5e-4
    assert share(upper, stages.INK, 30) > 3e-3
    assert share(upper, "#8d949c", 40) > 0.08  # the body
    legend = image[-150:]
    assert (legend < 128).all(axis=2).mean() > 0.005


@pytest.mark.rendering
def test_the_camera_sees_any_body_whole():
    rng = np.random.default_rng(3)
    for size in ([80, 4, 4], [4, 4, 80], [80, 80, 4], [1e-3, 1e-3, 1e-3], [1e4, 1, 1]):
        corners = (rng.integers(0, 2, (64, 3)) - 0.5) * size + [1000, -20, 3]
        stage = stages.Stage(corners)
        across = stage.aim(1000, 800, 100)
        camera = stage.plotter.camera
        seen = (corners - camera.focal_point) @ np.stack([stage.right, stage.up], axis=1) / across * 1000
        stage.plotter.close()
        assert np.abs(seen[:, 0]).max() <= 500
        assert seen[:, 1].max() <= 400
        assert seen[:, 1].min() >= -300  # above the floor
        assert max(np.ptp(seen[:, 0]) / 1000, np.ptp(seen[:, 1]) / 700) > 0.9


@pytest.mark.rendering
def test_the_same_scene_gives_the_same_picture(egg, tmp_path):
    for name in ("a.png", "b.png", "a.pdf", "b.pdf"):
        views.picture(egg, tmp_path / name, "cloud")
    for kind in ("png", "pdf"):
        assert (tmp_path / f"a.{kind}").read_bytes() == (tmp_path / f"b.{kind}").read_bytes()
    assert (tmp_path / "a.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize(
    ("length", "step"), [(1.0, 1.0), (1.99, 1.0), (2.0, 2.0), (4.9, 2.0), (7.0, 5.0), (0.03, 0.02)]
)
def test_the_scale_is_a_round_length(length, step):
    assert stages.nice(length) == pytest.approx(step)


@pytest.mark.parametrize(
    ("change", "options", "sentence"),
    [
        ({}, dict(view="rainbow"), "view must be one of cloud, surface, bound, compare, explain, got 'rainbow'"),
        ({}, dict(color="taste"), "contacts are coloured by phase, force, friction, error, got 'taste'"),
        (dict(contacts=None), dict(view="cloud"), "cube has no contacts, where the view cloud shows them"),
        (dict(surface=None), dict(view="surface"), "cube has no surface to show; it has a cloud: give the view cloud"),
        (dict(truth=None), dict(view="compare"), "the true body of cube is not at hand, .*; give --truth MESH"),
        (dict(bound=None), dict(view="bound"), "the bound of cube is not known; show a scan's folder"),
        (dict(recording=None), dict(view="explain"), "cube has no recording, where rods need one"),
    ],
)
def test_views_that_the_scene_has_not(cube, tmp_path, monkeypatch, change, options, sentence):
    monkeypatch.setattr(views, "can_render", lambda: True)  # it is refused before anything is drawn
    with pytest.raises(scan3d.InputError, match=sentence):
        views.picture(replace(cube, **change), tmp_path / "x.png", **options)
    assert not list(tmp_path.iterdir())


def test_colours_that_a_cloud_has_not(cube, tmp_path):
    unknown = cube.contacts.copy()
    unknown["quality"] = np.nan
    with pytest.raises(
        scan3d.InputError, match="cube says nothing of its contacts' error; known are phase, force, friction"
    ):
        views.shade_contacts(replace(cube, contacts=unknown), "error")
    with pytest.raises(scan3d.InputError, match="nothing of its contacts' force; its file has points only"):
        views.shade_contacts(replace(cube, contacts=cube.contacts[["x", "y", "z"]]), "force")
    with pytest.raises(scan3d.InputError, match=r"a picture is written as \.png or \.pdf, got 'x\.bmp'"):
        views.picture(cube, tmp_path / "x.bmp")


def test_colours_say_what_they_claim(egg):
    friction = views.shade_contacts(egg, "friction")
    tip = egg.column("phase") == planar.Phase.TIP
    assert tip.any()
    assert (friction.rgb[tip] == [154, 154, 154]).all()  # unknown: grey
    low, high = np.nanargmin(egg.column("friction")), np.nanargmax(egg.column("friction"))
    assert friction.rgb[low] == pytest.approx([68, 1, 84], abs=1)  # viridis
    assert friction.rgb[high] == pytest.approx([253, 231, 37], abs=1)
    force = views.shade_contacts(egg, "force")
    assert (force.norm.vmin, force.norm.vmax) == (0.0, pytest.approx(1e3 * egg.column("force").max()))


# --- the window ---


@pytest.mark.rendering
def test_the_window(egg):
    told = []
    made = windows.window(egg, told.append, "phase", off_screen=True)
    try:
        assert list(made.layers) == ["surface", "truth", "contacts", "normals", "slices", "rods"]
        visible = {name: all(actor.GetVisibility() for actor in actors) for name, actors in made.layers.items()}
        assert visible == {name: name in ("surface", "contacts") for name in made.layers}
        assert all(made.layers.values())
        made.switch("truth", True)
        assert made.layers["truth"][0].GetVisibility()
        assert np.array_equal(made.contacts["rgb"], views.shade_contacts(egg, "phase").rgb)
        made.paint("force")
        assert np.array_equal(made.contacts["rgb"], views.shade_contacts(egg, "force").rgb)
        made.pick(egg.points[17])
        made.pick(egg.points[17] + 100.0)
        assert told == [scenes.sentence(egg, 17)]
    finally:
        made.plotter.close()


def test_without_a_display_there_is_no_window(folder, monkeypatch, capsys):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(windows.sys, "platform", "linux")
    windows.can_open.cache_clear()
    try:
        assert main(["show", str(folder)]) == 1
    finally:
        windows.can_open.cache_clear()
    assert capsys.readouterr().err == (
        "scan3d: there is no display to open a window on; write a picture with --screenshot FILE, or a page with --html FILE\n"
    )
    monkeypatch.setattr(windows, "can_open", lambda: False)
    with pytest.raises(scan3d.InputError, match="there is no display to open a window on"):
        windows.open_window(scanned(EGG), print)


# --- the command ---


@pytest.mark.rendering
def test_show_writes_what_it_is_asked_for(folder, tmp_path, capsys):
    picture, page = tmp_path / "a.png", tmp_path / "a.html"
    assert main(["show", str(folder), "--screenshot", str(picture), "--html", str(page), "--view", "compare"]) == 0
    said = capsys.readouterr()
    assert said.out == f"written to {page}\nwritten to {picture}\n"
    assert said.err == ""
    assert page.read_bytes().startswith(b"<!DOCTYPE html>")
    assert (pixels(picture) < 128).any()
    assert main(["show", str(folder / "cloud.ply"), "--screenshot", str(picture), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"shown": "cloud", "files": [str(picture)]}


def test_the_page_of_a_folder_is_that_of_its_scan(folder, tmp_path):
    commands.show(str(folder), print, html=str(tmp_path / "again.html"))
    assert (tmp_path / "again.html").read_bytes() == (folder / "view.html").read_bytes()


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("--view", "bound"), "--view says what a picture shows: give --screenshot FILE as well"),
        (("--view", "bound", "--html", "x.html"), "--view says what a picture shows: give --screenshot FILE as well"),
        (
            ("--color", "phase", "--html", "x.html"),
            "--color is for a picture or the window: give --screenshot FILE as well",
        ),
        (
            ("--color", "phase", "--movie", "x.gif"),
            "--color is for a picture or the window: give --screenshot FILE as well",
        ),
        (
            ("--color", "phase", "--view", "bound", "--screenshot", "x.png"),
            "--color is that of the contacts in the view cloud: leave it out with --view bound",
        ),
        (("--movie-of", "growth", "--html", "x.html"), "--movie-of says what a movie shows: give --movie FILE as well"),
    ],
)
def test_options_that_would_change_nothing(folder, tmp_path, monkeypatch, capsys, options, sentence):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as leaving:
        main(["show", str(folder), *options])
    assert leaving.value.code == 2
    assert capsys.readouterr() == ("", f"scan3d: {sentence}; see 'scan3d show --help'\n")
    assert not list(tmp_path.iterdir())


@pytest.mark.rendering
@pytest.mark.parametrize(("options", "same_as"), [(("--color", "phase"), "cloud"), ((), "surface")])
def test_a_colour_shows_the_contacts(folder, tmp_path, options, same_as):
    """Without a view: the contacts if their colour is named, else the surface."""
    found = tmp_path / "found.png"
    assert main(["show", str(folder), "--screenshot", str(found), "--quiet", *options]) == 0
    wanted = tmp_path / "wanted.png"
    scene = commands._scene(folder, None, False, "mm")
    views.picture(scene, wanted, same_as, "phase")
    assert found.read_bytes() == wanted.read_bytes()


@pytest.mark.parametrize("hidden", ["libraries", "display"])
def test_without_a_renderer_all_else_is_written(folder, tmp_path, hidden):
    """In a process of its own: VTK would take down this one."""
    environment = {
        name: value for name, value in os.environ.items() if not name.startswith(("DISPLAY", "WAYLAND", "VTK_"))
    }
    if hidden == "libraries":
        # empty files stand before the libraries
        for name in (
            "libEGL.so.1",
            "libEGL.so",
            "libGL.so.1",
            "libGL.so",
            "libOpenGL.so.0",
            "libGLX.so.0",
            "libOSMesa.so.8",
        ):
            (tmp_path / "lib" / name).parent.mkdir(exist_ok=True)
            (tmp_path / "lib" / name).touch()
        environment["LD_LIBRARY_PATH"] = str(tmp_path / "lib")
    else:
        environment["VTK_DEFAULT_OPENGL_WINDOW"] = "vtkXOpenGLRenderWindow"  # and no X to open it on

    def run(*arguments):
        return subprocess.run(
            [COMMAND, *map(str, arguments)], env=environment, capture_output=True, text=True, check=False
        )

    out = tmp_path / "out"
    done = run("scan", CUBE, "--out", out, *FEW)
    assert (done.returncode, done.stderr) == (0, f"scan3d: {views.NO_RENDERER}\n")
    assert {one.name for one in out.iterdir()} == {
        "recording.csv", "recording.toml", "cloud.ply", "surface.ply", "report.json", "view.html",
    }  # fmt: skip
    page = tmp_path / "page.html"
    done = run("show", folder, "--html", page, "--screenshot", tmp_path / "picture.png")
    assert (done.returncode, done.stderr) == (1, f"scan3d: {views.NO_RENDERER}\n")
    assert page.exists()
    assert not (tmp_path / "picture.png").exists()
