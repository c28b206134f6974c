"""Pictures for papers: their size, resolution and letters in every format, histograms, forces, and differences of surfaces."""

import base64
import io
import re
from dataclasses import replace

import matplotlib
import numpy as np
import pytest
import trimesh
from image_checks import of_color, pixels
from PIL import Image
from small_scans import CUBE, EGG, scanned, scanned_folder, scanned_in_space

import scan3d
from scan3d.choices import CAMERAS
from scan3d.cli import main
from scan3d.pictures import figures, rendering, views
from scan3d.pictures.charts import histograms, reactions
from scan3d.pictures.parts import shown_surface
from scan3d.pictures.shading import BODY, shade_surface
from scan3d.pictures.sheet import Sheet, sheet


@pytest.fixture(scope="module")
def egg():
    return scanned(EGG)


@pytest.fixture(scope="module")
def cube():
    return scanned(CUBE)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return scanned_folder(tmp_path_factory.mktemp("papers"))


def fonts(pdf):
    """The kinds of fonts in the bytes of a .pdf whose objects are not compressed, and whether they are embedded as TrueType."""
    kinds = set(re.findall(rb"/Subtype /(Type0|Type1|Type3|TrueType|CIDFontType\d)", pdf))
    return {kind.decode() for kind in kinds}, b"/FontFile2" in pdf


# --- formats ---


@pytest.mark.parametrize("view", ["histogram", "forces"])
def test_letters_of_a_pdf_are_truetype(egg, tmp_path, view):
    views.picture(egg, tmp_path / "a.pdf", view)
    assert fonts((tmp_path / "a.pdf").read_bytes()) == ({"Type0", "CIDFontType2"}, True)
    # by its own default matplotlib writes others, which this test would find
    with matplotlib.rc_context({"pdf.fonttype": 3}):
        views.figure(egg, view).savefig(tmp_path / "b.pdf")
    assert "Type3" in fonts((tmp_path / "b.pdf").read_bytes())[0]


@pytest.mark.rendering
@pytest.mark.parametrize("dpi", [100, 600])
def test_sizes_and_the_raster_of_the_body(egg, tmp_path, dpi):
    given = sheet("85x60mm", dpi, "top")
    for ending in ("png", "pdf", "svg"):
        views.picture(egg, tmp_path / f"a.{ending}", "surface", sheet=given)
    width, height = round(85 / 25.4 * dpi), round(60 / 25.4 * dpi)
    with Image.open(tmp_path / "a.png") as image:
        assert image.size == (width, height)
        assert image.info["dpi"] == pytest.approx((dpi, dpi), abs=0.1)
    pdf, svg = (tmp_path / "a.pdf").read_bytes(), (tmp_path / "a.svg").read_text()
    box = [float(number) for number in re.search(rb"/MediaBox \[ ([^\]]*) \]", pdf)[1].split()]
    points = pytest.approx([72 * width / dpi, 72 * height / dpi], abs=0.01)
    assert box[2:] == points
    assert [float(re.search(rf'<svg[^>]* {side}="([\d.]+)pt"', svg)[1]) for side in ("width", "height")] == points
    assert fonts(pdf) == ({"Type0", "CIDFontType2"}, True)
    # the body is an image in the resolution asked for, as large in both, and not resampled: as in the .png
    # (beside that of the colour bar)
    found = re.findall(r"<image [^>]*data:image/png;base64,([^\"]*)\"", svg, flags=re.DOTALL)
    with Image.open(io.BytesIO(base64.b64decode(max(found, key=len)))) as image:
        body = np.asarray(image.convert("RGB")).astype(int)
    assert body.shape[0] in map(int, re.findall(rb"/Height (\d+)", pdf))
    assert body.shape[1] in map(int, re.findall(rb"/Width (\d+)", pdf))
    assert 0.5 * height < body.shape[0] < height
    assert 0.6 * width < body.shape[1] < width
    png = pixels(tmp_path / "a.png")
    inked = (body < 250).any(axis=2)
    rows, columns = np.flatnonzero(inked.any(axis=1)), np.flatnonzero(inked.any(axis=0))
    part = body[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    whole = (png < 250).any(axis=2)
    top = np.flatnonzero(whole[:, : body.shape[1]].any(axis=1))[0]
    left = np.flatnonzero(whole[top : top + part.shape[0] // 2, : body.shape[1]].any(axis=0))[0]
    np.testing.assert_array_equal(png[top : top + part.shape[0], left : left + part.shape[1]], part)


@pytest.mark.rendering
def test_an_svg_needs_nothing_and_is_the_same_again(egg, tmp_path):
    for name in ("a.svg", "b.svg"):
        views.picture(egg, tmp_path / name, "compare")
    text = (tmp_path / "a.svg").read_text()
    assert text == (tmp_path / "b.svg").read_text()
    assert "<text" not in text  # letters are shapes
    assert all(link.startswith(("#", "data:image/png;base64,")) for link in re.findall(r'href="([^"]*)', text))
    assert "font-family" not in text
    assert "pixelated" not in text  # smaller in a browser, pixels are averaged
    assert text.count("<image") == 3  # two bodies and the colour bar


# --- parts of a picture do not overlap ---


@pytest.mark.rendering
@pytest.mark.parametrize("size", [None, "70x55mm", "85x60mm", "200x50mm", "60x200mm"])
@pytest.mark.parametrize("view", ["cloud", "surface", "compare", "explain", "histogram", "forces"])
def test_no_part_of_a_picture_is_cut_off_or_written_over(view, size):
    scene = scanned_in_space() if size == "85x60mm" else scanned(EGG)
    scene = replace(scene, truth=scene.surface) if scene.truth is None else scene
    drawn = sheet(size)
    with figures.quiet():
        figure = views.figure(scene, view, "phase" if size == "200x50mm" else "force", drawn)
        figure.draw_without_rendering()
    renderer = figure.canvas.get_renderer()
    width, height = figure.canvas.get_width_height()
    texts = [text for text in figure.findobj(matplotlib.text.Text) if text.get_visible() and text.get_text().strip()]
    hidden = out_of_sight(figure)
    texts = [text for text in texts if id(text) not in hidden]
    boxes = [text.get_window_extent(renderer) for text in texts]
    assert len(boxes) > 3
    for text, box in zip(texts, boxes, strict=True):
        assert box.x0 > -0.5, text
        assert box.y0 > -0.5, text
        assert box.x1 < width + 0.5, text
        assert box.y1 < height + 0.5, text
    for k, (text, box) in enumerate(zip(texts, boxes, strict=True)):
        for other, rest in zip(texts[:k], boxes[:k], strict=True):
            assert not overlap(box, rest), (text, other)
    # nothing is written on an image of a body, nor another image
    images = [image.axes.get_window_extent(renderer) for axes in figure.axes for image in axes.images]
    assert len(images) == {"histogram": 0, "forces": 0, "compare": 2}.get(view, 1)
    for k, image in enumerate(images):
        assert not [text for text, box in zip(texts, boxes, strict=True) if overlap(image, box)]
        assert not any(overlap(image, rest) for rest in images[:k])
        bars = [axes.get_window_extent(renderer) for axes in figure.axes if axes.collections and not axes.images]
        assert not any(overlap(image, bar) for bar in bars)


def out_of_sight(figure):
    """The labels of ticks outside of the limits of their axis, which are not drawn."""
    found = set()
    for axis in [axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis)]:
        drawn = {id(tick) for tick in axis._update_ticks()}
        ticks = [*axis.get_major_ticks(), *axis.get_minor_ticks()]
        found |= {id(label) for tick in ticks if id(tick) not in drawn for label in (tick.label1, tick.label2)}
    return found


def overlap(one, other):
    """Whether two boxes overlap by more than the half pixel to which images are placed, or than letters' descenders."""
    across = min(one.x1, other.x1) - max(one.x0, other.x0)
    along = min(one.y1, other.y1) - max(one.y0, other.y0)
    return across > 1 and along > 1


def test_titles_are_wrapped_into_lines_of_about_one_length():
    title = "bending out of the sweep's plane in °"
    assert figures.wrapped(title, 7, Sheet()) == title
    assert figures.wrapped(title, 3, Sheet()) == "bending out of the\nsweep's plane in °"
    assert figures.wrapped("certified bound in um", 0.1, Sheet()) == "certified\nbound\nin µm"
    assert figures.wrapped("5 %", 1, Sheet()) == "5 %"


@pytest.mark.rendering
def test_a_picture_without_room_for_the_body(egg):
    with pytest.raises(
        scan3d.InputError, match="a picture of 50 x 35 mm has no room for the body beside its labels; choose a la"
    ):
        views.figure(egg, "explain", sheet=sheet("50x35mm"))


@pytest.mark.rendering
def test_the_axes_are_below_the_body_whatever_the_zoom(egg, tmp_path):
    for camera in ("300,25,4", "top,0.3"):
        given = sheet("85x60mm", 100, camera)
        figure = views.figure(egg, "surface", sheet=given)
        axes = next(axes for axes in figure.axes if axes.images)
        strip = next(axes for axes in figure.axes if any(text.get_text() == "x" for text in axes.texts))
        assert strip.get_position().y1 <= axes.get_position().y0 + 1 / figure.canvas.get_width_height()[1]
        assert strip.get_position().x0 == pytest.approx(axes.get_position().x0)
    # what is zoomed in fills the image, what is zoomed out a small part of it
    views.picture(egg, tmp_path / "near.png", "surface", sheet=sheet("85x60mm", 100, "300,25,4"))
    views.picture(egg, tmp_path / "far.png", "surface", sheet=sheet("85x60mm", 100, "300,25,0.3"))
    near, far = ((pixels(tmp_path / name)[:170, 20:250] < 250).any(axis=2).mean() for name in ("near.png", "far.png"))
    assert near > 0.9
    assert far < 0.1


@pytest.mark.rendering
def test_cameras_see_the_sides_of_a_box(tmp_path):
    """A box of 60 by 30 by 15 mm; from each side its outline has the proportions of that side."""
    box = trimesh.creation.box((60, 30, 15))
    scene = replace(scanned(CUBE), surface=box, truth=None, bound=None, contacts=None, recording=None)
    sides = {"front": 60 / 15, "back": 60 / 15, "left": 30 / 15, "right": 30 / 15, "top": 60 / 30, "bottom": 60 / 30}
    for camera, proportion in sides.items():
        views.picture(scene, tmp_path / "a.png", "surface", sheet=sheet("100x75mm", 100, camera))
        body = (np.abs(pixels(tmp_path / "a.png")[:220, 10:] - 255) > 20).any(axis=2)
        wide, high = (np.ptp(np.flatnonzero(body.any(axis=axis))) + 1 for axis in (0, 1))
        assert wide / high == pytest.approx(proportion, rel=0.04), camera
    assert set(sides) | {"iso"} == set(CAMERAS)


@pytest.mark.rendering
def test_a_long_body_is_cut_off_where_the_rods_do_not_reach(tmp_path):
    tall = trimesh.creation.cylinder(3, 120, sections=24)
    recording = scan3d.simulate(tall, scan3d.Plan(slices=4, sweeps=4, samples=12))
    scene = replace(scanned(CUBE), truth=tall, surface=tall, contacts=of(recording), recording=recording)
    views.picture(scene, tmp_path / "a.png", "explain")
    image = pixels(tmp_path / "a.png")
    # its ends are seen: faces in the colour of the body, and white paper above and below
    inked = (image[:-220] < 250).any(axis=2).any(axis=1)
    assert not inked[:20].any()
    assert of_color(image, BODY, 60).any()


def of(recording):
    from scan3d.files.shapes import cloud_table

    return cloud_table(scan3d.reconstruct(recording), None)


# --- histograms and forces ---


def test_a_histogram_counts_area(egg):
    figure = histograms(egg, Sheet())
    deviation, bound = figure.axes
    assert deviation.get_xlabel().replace("\n", " ") == "signed deviation in mm"
    assert bound.get_xlabel().replace("\n", " ") == "certified bound in mm"
    mesh, signed, local = shown_surface(egg)
    for axes, values in ((deviation, signed), (bound, local)):
        shares, edges, _ = axes.patches[0].get_data()
        assert shares.sum() == pytest.approx(100)
        # by facets, whose mean is nearly that of their vertices
        facets = values[mesh.faces].mean(axis=1)
        middles = (edges[1:] + edges[:-1]) / 2
        expected = (facets * mesh.area_faces).sum() / mesh.area
        assert (shares @ middles) / 100 == pytest.approx(expected, abs=edges[1] - edges[0])
        assert edges[0] <= values.min() + 1e-9
        assert edges[-1] >= values.max() - 1e-9
    median = float(re.match(r"median (−?[\d.]+)", deviation.get_title())[1].replace("−", "-"))
    assert signed.min() < median < signed.max()


def test_values_without_a_bound_are_counted_apart(egg):
    bound = np.where(egg.surface.vertices[:, 2] > np.median(egg.surface.vertices[:, 2]), np.inf, egg.bound)
    figure = histograms(replace(egg, truth=None, bound=bound), Sheet())
    (axes,) = figure.axes
    unknown = float(re.search(r"unknown on (\d+) %", axes.get_title().replace("\n", " "))[1])
    assert axes.patches[0].get_data()[0].sum() == pytest.approx(100 - unknown, abs=1)
    assert 20 < unknown < 80


@pytest.mark.parametrize(("factor", "label"), [(1.0, "in mm"), (1e-6, "10^{-")])
def test_small_deviations_have_a_power_in_their_unit(egg, factor, label):
    near = egg.surface.copy()
    near.vertices = near.vertices * (1 + factor * 1e-2)
    (axes,) = histograms(replace(egg, bound=None).against(near), Sheet()).axes
    assert label in axes.get_xlabel()
    assert "signed distance from the other surface" in axes.get_xlabel().replace("\n", " ")


def test_a_histogram_of_one_value(egg):
    (axes,) = histograms(replace(egg, truth=None, bound=np.zeros(len(egg.surface.vertices))), Sheet()).axes
    shares, edges, _ = axes.patches[0].get_data()
    assert (edges[0], edges[-1]) == (0, 1)
    assert shares[0] == pytest.approx(100)
    assert axes.get_title() == "median 0, 90 % from 0 to 0"


def test_forces_of_three_and_of_six_axes(egg):
    for scene, count in ((egg, 3), (scanned_in_space(), 6)):
        figure = views.figure(scene, "forces", sheet=sheet("120x90mm"))
        panels = [axes for axes in figure.axes if axes.lines]
        assert len(panels) == count
        assert all(axes.get_title(loc="left") for axes in panels)
        assert figure.get_size_inches() == pytest.approx([120 / 25.4, 90 / 25.4], abs=0.01)
    assert [axes.get_title(loc="left") for axes in reactions(egg.recording).axes[:3]] == [*figures.REACTION_LABELS]


def test_charts_need_no_renderer(folder, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(rendering, "can_render", lambda: False)
    for view in ("forces", "histogram"):
        for ending in ("png", "pdf", "svg"):
            file = tmp_path / f"{view}.{ending}"
            assert main(["show", str(folder), "--view", view, "--screenshot", str(file), "--size", "90x70mm"]) == 0
            assert file.stat().st_size > 2000
    assert main(["show", str(folder), "--screenshot", str(tmp_path / "a.svg")]) == 1
    assert rendering.NO_RENDERER in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "view", "sentence"),
    [
        (
            dict(recording=None),
            "forces",
            "cube has no recording, whose reactions the view forces shows: show a scan's folder",
        ),
        (dict(surface=None), "histogram", "cube has no surface, whose deviation and bound the view histogram shows"),
        (
            dict(truth=None, bound=None),
            "histogram",
            "neither the deviation nor the bound of cube is known, .* give --truth MESH",
        ),
    ],
)
def test_charts_that_the_scene_can_not_give(cube, change, view, sentence):
    with pytest.raises(scan3d.InputError, match=sentence):
        views.figure(replace(cube, **change), view)


# --- differences ---


def test_the_distance_from_another_surface_is_signed_and_exact(cube):
    """Of a box in a larger one, in a dented one and in one whose facets are turned inside out."""
    side = np.ptp(cube.surface.vertices, axis=0)[0]
    inner = trimesh.creation.box([side] * 3)
    for factor in (0.5, 2.0):
        other = trimesh.creation.box([factor * side] * 3)
        for shape in (other, trimesh.Trimesh(other.vertices, other.faces[:, ::-1], process=False)):
            scene = replace(cube, surface=inner, bound=None).against(shape)
            mesh, distance, _ = shown_surface(scene)
            inside = np.abs(mesh.vertices).max(axis=1) - factor * side / 2
            facing = np.sort(np.abs(mesh.vertices), axis=1)[:, 1] < 0.2 * side  # opposite the middles of faces
            np.testing.assert_allclose(distance[facing], inside[facing], atol=1e-9 * side)
            assert (distance > 0).all() if factor < 1 else (distance < 0).all()


@pytest.mark.rendering
@pytest.mark.slow
def test_the_difference_of_two_results(folder, tmp_path, capsys):
    picture = tmp_path / "difference.png"
    reconstruct = [
        "reconstruct",
        str(folder / "recording.csv"),
        "--out",
        str(tmp_path / "other"),
        "--method",
        "hull",
        "--quiet",
    ]
    assert main(reconstruct) == 0
    capsys.readouterr()
    assert main(["show", str(folder), "--screenshot", str(picture), "--against", str(tmp_path / "other")]) == 0
    assert main(["show", str(folder), "--html", str(tmp_path / "a.html"), "--against", str(tmp_path / "other")]) == 0
    assert "signed distance from the other surface in mm" in (tmp_path / "a.html").read_text()
    # in Python the same
    result, other = scan3d.open(folder), scan3d.open(tmp_path / "other")
    images = [result.plot(against=given) for given in (other, tmp_path / "other" / "surface.ply", other.surface)]
    assert len({image.tobytes() for image in images}) == 1
    np.testing.assert_array_equal(pixels(picture), np.asarray(images[0]))
    assert result.plot().tobytes() != images[0].tobytes()
    assert result.plot(against=EGG, view="histogram").size == (1400, round(1400 / 2.3))


def test_units_of_the_other_surface(folder, tmp_path):
    from scan3d.scenes import other_surface

    mesh = trimesh.creation.box((1, 1, 1))
    mesh.export(tmp_path / "box.stl")
    assert other_surface(tmp_path / "box.stl", "mm", "in").extents == pytest.approx([25.4] * 3)
    assert other_surface(mesh, "mm").extents == pytest.approx([1] * 3)
    mesh.units = "m"
    assert other_surface(mesh, "mm").extents == pytest.approx([1000] * 3)
    assert other_surface(folder, "m").extents == pytest.approx(scan3d.open(folder).surface.extents / 1000)


def test_what_has_no_surface_to_compare_with(folder, tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    (tmp_path / "notes.txt").write_text("none")
    wrong = [
        ("missing", r"there is no .*missing to compare the surface with: expected a scan's folder"),
        ("empty", r"empty holds no scan: expected cloud\.ply or surface\.ply in it"),
        (
            "notes.txt",
            r"notes\.txt has no surface to compare with: expected a scan's folder, or a surface or mesh file \(\.stl",
        ),
    ]
    for name, sentence in wrong:
        assert (
            main(["show", str(folder), "--screenshot", str(tmp_path / "a.png"), "--against", str(tmp_path / name)]) == 1
        )
        assert re.search(sentence, capsys.readouterr().err)
    assert (
        main(["show", str(folder), "--screenshot", str(tmp_path / "a.png"), "--against", str(folder / "cloud.ply")])
        == 1
    )
    assert re.search(r"cloud\.ply has no surface to compare with, but contacts only", capsys.readouterr().err)
    assert (
        main(["show", str(folder), "--screenshot", str(tmp_path / "a.png"), "--against", str(folder / "recording.csv")])
        == 1
    )
    assert re.search(r"recording\.csv has no surface to compare with", capsys.readouterr().err)
    with pytest.raises(scan3d.InputError, match="there is no surface in a int: expected a scan's folder"):
        scan3d.open(folder).plot(against=3)
    with pytest.raises(scan3d.InputError, match="the other surface has no triangles"):
        scan3d.open(folder).plot(against=trimesh.Trimesh())


# --- the command line and Python ---


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("--size", "85"), r"the size of a picture is WIDTH or WIDTHxHEIGHT with a unit .* got '85'"),
        (("--dpi", "fine"), r"the resolution of a picture is a whole number .* got 'fine'"),
        (("--camera", "above"), r"a camera is front, back, .* got 'above'"),
        (("--camera", "-60,95"), r"a camera is front, back, .* got '-60,95'"),
        (
            ("--against", "b", "--truth", "c"),
            r"--against takes another surface in the place of the true body: leave out --truth",
        ),
        (
            ("--against", "b", "--view", "explain"),
            r"--against compares surfaces: give the view surface, compare or histogram",
        ),
        (("--against", "b", "--color", "force"), r"--against compares surfaces: give the view"),
    ],
)
def test_wrong_options_are_one_sentence(folder, tmp_path, capsys, options, sentence):
    assert main(["show", str(folder), "--screenshot", str(tmp_path / "a.png"), *options]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert re.fullmatch(rf"scan3d: {sentence}.*; see 'scan3d show --help'\n", err)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("view", ["histogram", "forces"])
def test_charts_have_no_camera(folder, tmp_path, capsys, view):
    assert main(["show", str(folder), "--screenshot", str(tmp_path / "a.png"), "--view", view, "--camera", "top"]) == 1
    assert f"the view {view} shows no body, so that it has no camera: leave the camera out" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--size=85mm", "--dpi=300", "--camera=top"])
def test_options_of_a_picture_need_one(folder, tmp_path, capsys, option):
    assert main(["show", str(folder), "--html", str(tmp_path / "a.html"), option]) == 2
    assert f"{option.partition('=')[0]} is that of a picture: give --screenshot FILE as well" in capsys.readouterr().err


def test_movies_are_not_of_differences(folder, tmp_path, capsys):
    assert main(["show", str(folder), "--movie", str(tmp_path / "a.gif"), "--against", str(folder)]) == 2
    assert "--against is for a picture, a page or the window: leave out --movie" in capsys.readouterr().err


@pytest.mark.rendering
@pytest.mark.slow
def test_the_command_and_python_draw_the_same_file(folder, tmp_path):
    options = ["--size", "85x60mm", "--dpi", "150", "--camera", "-60,25", "--view", "compare"]
    assert main(["show", str(folder), "--screenshot", str(tmp_path / "a.svg"), *options]) == 0
    scan3d.open(folder).plot(size="85x60mm", dpi=150, camera="-60,25", view="compare", path=tmp_path / "b.svg")
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()


def test_files_from_python_replace_nothing_of_others(egg, tmp_path):
    file = tmp_path / "forces.svg"
    for _ in range(2):
        egg.recording.plot(path=file, size="90mm")
    file.write_text("mine")
    with pytest.raises(
        scan3d.InputError, match=r"forces\.svg can't be recognised as written by scan3d; give --overwrite"
    ):
        egg.recording.plot(path=file)
    assert file.read_text() == "mine"
    image = egg.recording.plot(path=file, size="90mm", overwrite=True)
    assert image.width == round(90 / 25.4 * 200)
    with pytest.raises(scan3d.InputError, match=r"a picture is written as \.png, \.pdf or \.svg, got 'a\.jpg'"):
        egg.recording.plot(path=tmp_path / "a.jpg")
    with pytest.raises(scan3d.InputError, match="the view forces shows no body, so that it has no camera"):
        egg.recording.plot(camera="top")
    with pytest.raises(scan3d.InputError, match="a comparison shows no body, so that it has no camera"):
        scan3d.compare(egg.surface, egg.truth).plot(camera="top")
    with pytest.raises(
        scan3d.InputError, match="surfaces are compared in the views surface, compare or histogram, got 'bound'"
    ):
        scan3d.plot(egg.surface, against=egg.truth, view="bound")
    with pytest.raises(scan3d.InputError, match=r"against must be a trimesh\.Trimesh"):
        scan3d.plot(egg.surface, against=str(EGG))


def test_a_body_found_exactly_is_not_shown_in_colours(cube):
    exact = replace(cube, surface=cube.truth)
    _, shaded = shade_surface(exact)
    assert (shaded.rgb.min(axis=1) > 240).all()
    assert shaded.norm.vmax == pytest.approx(1e-9 * exact.diagonal)
