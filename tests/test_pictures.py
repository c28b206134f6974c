"""Pictures: their size, resolution, camera and letters in every format, and what is seen in each view."""

import base64
import io
import re
from dataclasses import replace

import matplotlib
import numpy as np
import pytest
import trimesh
from image_checks import fraction_of_color, pixels
from PIL import Image, ImageSequence
from small_scans import EGG, ring, scanned, scanned_in_space

import scan3d
from scan3d.choices import CAMERAS
from scan3d.pictures import canvas, figures, parts, views
from scan3d.pictures.canvas import Canvas
from scan3d.pictures.figures import Camera, Sheet, sheet
from scan3d.pictures.parts import shown_surface
from scan3d.pictures.views import histograms

# --- size, resolution and camera ---


def test_sizes():
    for size, dpi, width, height in (
        (None, None, 7.0, None),
        ("85mm", None, 85 / 25.4, None),
        (" 8.5 X 6 CM ", 600, 85 / 25.4, 60 / 25.4),
        ("3.5×2.5in", 300, 3.5, 2.5),
        ("240x180pt", 300, 240 / 72, 2.5),
        ("1200x900px", 300, 4.0, 3.0),
        ("3.x2.in", 200, 3.0, 2.0),
    ):
        given = sheet(size, dpi)
        assert given.width == pytest.approx(width), size
        assert given.height == (None if height is None else pytest.approx(height)), size
        assert given.dpi == (dpi or 200)


# Of a deviation of half the bound, in the light of the pictures.
WITHIN = "#aec6cc"


def test_cameras_have_names_or_angles():
    assert sheet().camera is None
    assert sheet(camera=" -60 , 25.5, 1.5").camera == Camera(-60, 25.5, 1.5)
    assert sheet(camera="Top,2").camera == Camera(-90, 90, 2)
    seen_from = {
        "front": (0, -1, 0), "back": (0, 1, 0), "left": (-1, 0, 0), "right": (1, 0, 0), "top": (0, 0, 1), "bottom": (0, 0, -1),
        "iso": np.array([1, -1, 1]) / np.sqrt(3),
    }  # fmt: skip
    assert set(seen_from) == set(CAMERAS)
    for name, direction in seen_from.items():
        np.testing.assert_allclose(sheet(camera=name).camera.toward, direction, atol=1e-15)


@pytest.mark.slow
@pytest.mark.rendering
def test_cameras_see_the_sides_of_a_box(cube, tmp_path):
    """A box of 60 by 30 by 15 mm; from each side its outline has the proportions of that side."""
    scene = replace(
        cube, surface=trimesh.creation.box((60, 30, 15)), truth=None, bound=None, contacts=None, recording=None
    )
    for camera, proportion in {"front": 60 / 15, "left": 30 / 15, "bottom": 60 / 30}.items():
        views.picture(scene, tmp_path / "a.png", "surface", sheet=sheet("100x75mm", 100, camera))
        body = (np.abs(pixels(tmp_path / "a.png")[:220, 10:] - 255) > 20).any(axis=2)
        wide, high = (np.ptp(np.flatnonzero(body.any(axis=axis))) + 1 for axis in (0, 1))
        assert wide / high == pytest.approx(proportion, rel=0.04), camera


@pytest.mark.rendering
def test_the_camera_sees_all_of_any_body():
    rng = np.random.default_rng(3)
    for size in ([80, 4, 4], [4, 4, 80], [1e-3, 1e-3, 1e-3], [1e4, 1, 1]):
        corners = (rng.integers(0, 2, (64, 3)) - 0.5) * size + [1000, -20, 3]
        canvas = Canvas(corners)
        across = canvas.aim(1000, 700)
        seen = (
            (corners - canvas.plotter.camera.focal_point) @ np.stack([canvas.right, canvas.up], axis=1) / across * 1000
        )
        canvas.plotter.close()
        assert np.abs(seen[:, 0]).max() <= 500
        assert np.abs(seen[:, 1]).max() <= 350
        assert max(np.ptp(seen[:, 0]) / 1000, np.ptp(seen[:, 1]) / 700) > 0.9


# --- formats ---


@pytest.mark.rendering
@pytest.mark.slow
@pytest.mark.parametrize("dpi", [100, pytest.param(600, marks=pytest.mark.trust)])
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
    # an .svg needs nothing: letters are shapes, and smaller in a browser, pixels are averaged
    assert "<text" not in svg
    assert "pixelated" not in svg
    assert all(link.startswith(("#", "data:image/png;base64,")) for link in re.findall(r'href="([^"]*)', svg))
    # the body is an image in the resolution asked for, as large in both, and not resampled: as in the .png
    # (beside that of the colour bar)
    found = re.findall(r"<image [^>]*data:image/png;base64,([^\"]*)\"", svg, flags=re.DOTALL)
    with Image.open(io.BytesIO(base64.b64decode(max(found, key=len)))) as image:
        body = np.asarray(image.convert("RGB")).astype(int)
    assert body.shape[0] in map(int, re.findall(rb"/Height (\d+)", pdf))
    assert body.shape[1] in map(int, re.findall(rb"/Width (\d+)", pdf))
    assert 0.5 * height < body.shape[0] < height
    assert 0.6 * width < body.shape[1] < width
    # letters of a .pdf are shapes of TrueType, as journals ask for
    assert b"/FontFile2" in pdf
    assert b"/Type3" not in pdf


# --- parts of a picture do not overlap ---

VIEWS = ("cloud", "surface", "compare", "explain", "histogram", "forces")
SIZES = (None, "70x55mm", "85x60mm", "200x50mm", "60x200mm")


@pytest.mark.rendering
@pytest.mark.parametrize(
    ("view", "size"),
    [
        pytest.param(view, size, marks=pytest.mark.slow if (i + k) % 5 == 0 else pytest.mark.trust)
        for i, view in enumerate(VIEWS)
        for k, size in enumerate(SIZES)
    ],
)
def test_no_part_of_a_picture_is_cut_off_or_written_over(view, size):
    scene = scanned_in_space() if size == "85x60mm" else scanned(EGG)
    scene = replace(scene, truth=scene.surface) if scene.truth is None else scene
    with figures.own_style():
        figure = views.figure(scene, view, "phase" if size == "200x50mm" else "force", sheet(size, 100))
        figure.draw_without_rendering()
    renderer = figure.canvas.get_renderer()
    width, height = figure.canvas.get_width_height()
    texts = [text for text in figure.findobj(matplotlib.text.Text) if text.get_visible() and text.get_text().strip()]
    hidden = out_of_sight(figure)
    texts = [text for text in texts if id(text) not in hidden]
    boxes = [text.get_window_extent(renderer) for text in texts]
    assert len(boxes) > 3
    for text, box in zip(texts, boxes, strict=True):
        assert min(box.x0, box.y0) > -0.5, text
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


# --- what is seen ---


def draw(scene, path, view, color="force"):
    views.picture(scene, path, view, color, sheet(None, 100))
    image = pixels(path)
    assert image.shape[1] == 700  # 7 inches
    # on white paper
    assert (image[:10] == 255).all()
    assert (image[:, :3] == 255).all()
    return image


def bar_of(image):
    """(rows, 3) the colours along the middle of the colour bar, the tallest thing at the right, inside of its frame."""
    right = image[:, 550:]
    inked = (right < 200).any(axis=2).sum(axis=0)
    sides = np.flatnonzero(inked > 0.9 * inked.max())
    bar = right[:, (sides[0] + sides[-1]) // 2]
    colored = np.flatnonzero(np.ptp(bar, axis=1) > 20)
    return bar[colored[0] : colored[-1] + 1]


def test_a_scale_says_where_values_lie_beyond_it():
    values = np.array([-3.0, 0.5, np.nan, 1.0])
    for low, high, beyond, extend in ((-3, 1, (False, False), "neither"), (-1, 2, (True, False), "min"),
                                      (-3, 0.9, (False, True), "max"), (-1, 0, (True, True), "both")):  # fmt: skip
        shaded, figure = parts.shade(values, "a in mm", low, high), figures.blank_figure(2.0)
        figures.color_bar(figure, shaded, Sheet())
        assert shaded.beyond == beyond
        assert figure.axes[0]._colorbar.extend == extend


@pytest.mark.slow
@pytest.mark.rendering
def test_the_surface_by_its_deviation(cube, tmp_path):
    image = draw(cube, tmp_path / "surface.png", "surface")
    # the hull's lid, in the picture's middle, lies farthest inside; its sides in the true ones
    middle = image[75:500, 100:450]
    assert fraction_of_color(middle, WITHIN, 12) > 0.1
    assert fraction_of_color(middle, "#b2182b", 40) == 0
    grey = np.ptp(middle, axis=2) < 12
    assert (grey & (middle.mean(axis=2) < 245)).mean() > 0.3
    # the bar goes from dark blue through white to dark red, symmetrically
    bar = bar_of(image)
    assert bar[0] == pytest.approx([103, 0, 31], abs=40)
    assert bar[-1] == pytest.approx([5, 48, 97], abs=40)
    assert bar[len(bar) // 2] == pytest.approx([247, 247, 247], abs=12)


@pytest.mark.slow
@pytest.mark.rendering
@pytest.mark.parametrize("color", ["phase", "friction"])
def test_the_cloud_by_its_colours(egg, tmp_path, color):
    image = draw(egg, tmp_path / "cloud.png", "cloud", color)
    body = image[:, :545]
    if color == "phase":
        assert fraction_of_color(body, parts.TANGENTIAL, 60) > 2e-3
        assert fraction_of_color(body, parts.TIP, 60) > 5e-5
    else:
        assert (np.ptp(body, axis=2) > 60).mean() > 2e-3
        # viridis from yellow to violet
        top, bottom = bar_of(image)[[2, -3]]
        assert top[0] > bottom[0]
        assert top[2] < bottom[2]
    # normals stick out of the body
    assert fraction_of_color(body, parts.NORMAL, 60) > 1e-3


@pytest.mark.rendering
def test_truth_and_reconstruction_side_by_side(cube):
    left, right = (axes.images[0].get_array().astype(int) for axes in views.figure(cube, "compare").axes if axes.images)
    assert fraction_of_color(left, WITHIN, 12) == 0
    assert fraction_of_color(right, WITHIN, 12) > 0.05
    # by the same camera: the outlines agree
    bodies = [(np.abs(half - 255).max(axis=2) > 12) for half in (left, right)]
    assert (bodies[0] != bodies[1]).mean() < 0.02
    assert bodies[0].mean() > 0.2


@pytest.mark.slow
@pytest.mark.rendering
@pytest.mark.parametrize("make", [lambda: scanned(EGG), scanned_in_space], ids=["planar", "spatial"])
def test_the_view_that_explains(make, tmp_path):
    image = draw(make(), tmp_path / "explain.png", "explain")
    upper, legend = image[:-75], image[-75:]
    for color in (parts.BODY, parts.ROD, parts.INK):
        assert fraction_of_color(upper, color, 60) > 1e-3
    assert fraction_of_color(upper, parts.TANGENTIAL, 60) > 4e-4
    assert (legend < 128).all(axis=2).mean() > 0.005


@pytest.mark.parametrize(
    ("missing", "view", "sentence"),
    [
        ((), "rainbow", "view must be one of cloud, surface, bound, .*, histogram, forces, got 'rainbow'"),
        (["contacts"], "cloud", "cube has no contacts to show; it has a surface: give the view surface"),
        (["truth"], "compare", "the view compare needs the true body of cube, .*: give --truth MESH"),
        (["bound"], "bound", "the bound at the surface of cube is not known: give a scan's folder"),
        (["recording"], "forces", "cube has no recording, whose reactions the view forces shows"),
        (["truth", "bound"], "histogram", "neither the deviation nor the bound of cube is known, .*"),
    ],
)
def test_views_that_the_scene_can_not_give(cube, tmp_path, monkeypatch, missing, view, sentence):
    monkeypatch.setattr(canvas, "can_render", lambda *_: True)  # it is refused before anything is drawn
    with pytest.raises(scan3d.InputError, match=sentence):
        views.picture(replace(cube, **dict.fromkeys(missing)), tmp_path / "x.png", view)
    assert not list(tmp_path.iterdir())


# --- histograms and forces ---


def test_a_histogram_counts_area(egg):
    deviation, bound = histograms(egg, Sheet()).axes
    assert deviation.get_xlabel().replace("\n", " ") == "signed deviation in µm"
    assert bound.get_xlabel().replace("\n", " ") == "certified bound in mm"
    mesh, signed, local, _ = shown_surface(egg)
    for axes, values, factor in ((deviation, signed, 1e-3), (bound, local, 1.0)):
        shares, edges, _ = axes.patches[0].get_data()
        edges = factor * edges
        assert shares.sum() == pytest.approx(100)
        # by facets, whose mean is nearly that of their vertices
        expected = (values[mesh.faces].mean(axis=1) * mesh.area_faces).sum() / mesh.area
        assert (shares @ (edges[1:] + edges[:-1]) / 2) / 100 == pytest.approx(expected, abs=edges[1] - edges[0])
        assert edges[0] <= values.min() + 1e-9
        assert edges[-1] >= values.max() - 1e-9
    median = float(re.match(r"median (−?[\d.]+)", deviation.get_title())[1].replace("−", "-"))
    assert signed.min() < median / 1000 < signed.max()


# --- movies ---

FILM = (980, 560)


def frames_of(path):
    with Image.open(path) as film:
        assert film.size == FILM
        return [np.asarray(frame.convert("RGB")).astype(int) for frame in ImageSequence.Iterator(film)]


@pytest.mark.slow
@pytest.mark.rendering
@pytest.mark.parametrize("make", [lambda: scanned(EGG), scanned_in_space, ring], ids=["planar", "spatial", "hollow"])
def test_growth(make, tmp_path):
    # the rod is seen in every frame, and not without a recording
    views.movie(make(), tmp_path / "rod.gif", frames=2)
    views.movie(replace(make(), recording=None), tmp_path / "growth.gif", frames=3)
    with_rod, shown = frames_of(tmp_path / "rod.gif"), frames_of(tmp_path / "growth.gif")
    blue = [(image[:500, :, 2].astype(int) - image[:500, :, 0] > 40).sum() for image in (*with_rod, *shown)]
    assert min(blue[:2]) > 300
    assert max(blue[2:]) == 0
    size = [(image[:500] < 250).any(axis=2).sum() for image in shown]
    assert len(shown) == 3
    assert np.all(np.diff(size) > 0)
    assert 0.1 < size[-1] / (500 * 980) < 0.6
    # every frame by the same camera: contacts that are drawn once stay
    for before, after in zip(shown, shown[1:], strict=False):
        earlier, later = ((image[:500] < 250).any(axis=2) for image in (before, after))
        assert (earlier & ~later).sum() < 0.01 * earlier.sum()


@pytest.mark.slow
def test_movies_that_can_not_be_made(egg, tmp_path, monkeypatch):
    monkeypatch.setattr(canvas, "can_render", lambda *_: False)
    for change, name, sentence in (
        ({}, "x.mp4", r"a movie is written as \.gif, got 'x\.mp4'"),
        (dict(contacts=None), "x.gif", "egg does not say which slices its contacts lie in"),
        ({}, "x.gif", "nothing here can render off screen"),
    ):
        with pytest.raises(scan3d.InputError, match=sentence):
            views.movie(replace(egg, **change), tmp_path / name)
        assert not list(tmp_path.iterdir())
