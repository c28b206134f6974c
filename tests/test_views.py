"""Pictures: what is seen is what was scanned."""

from dataclasses import replace

import numpy as np
import pytest
from image_checks import fraction_of_color, pixels
from small_scans import CUBE, EGG, scanned, scanned_in_space

import scan3d
from scan3d.choices import COLORS
from scan3d.pictures import rendering, shading, views
from scan3d.pictures.canvas import Canvas
from scan3d.pictures.figures import nice


@pytest.fixture(scope="module")
def egg():
    return scanned(EGG)


@pytest.fixture(scope="module")
def cube():
    return scanned(CUBE)


def draw(scene, path, view, color="force"):
    views.picture(scene, path, view, color)
    image = pixels(path)
    assert image.shape[1] == 1400  # 7 inches
    assert 600 <= image.shape[0] <= 1250
    # on white paper
    assert (image[:20] == 255).all()
    assert (image[:, :5] == 255).all()
    return image


def bar_of(image):
    """(rows, 3) the colours along the middle of the colour bar, the tallest thing at the right."""
    right = image[:, 1100:]
    inked = (right < 200).any(axis=2).sum(axis=0)
    sides = np.flatnonzero(inked > 0.9 * inked.max())
    return right[:, (sides[0] + sides[-1]) // 2]


@pytest.mark.rendering
@pytest.mark.slow
def test_the_surface_by_its_deviation(cube, tmp_path):
    image = draw(cube, tmp_path / "surface.png", "surface")
    # the hull's lid, in the picture's middle, lies farthest inside; its sides in the true ones
    middle = image[150:1000, 200:900]
    assert fraction_of_color(middle, "#053061", 25) > 0.1
    assert fraction_of_color(middle, "#b2182b", 40) == 0
    grey = np.ptp(middle, axis=2) < 12
    assert (grey & (middle.mean(axis=2) < 245)).mean() > 0.3
    # the bar goes from dark blue through white to dark red, symmetrically
    bar = bar_of(image)
    inside = np.flatnonzero(np.ptp(bar, axis=1) > 30)
    assert bar[inside[0]] == pytest.approx([103, 0, 31], abs=40)
    assert bar[inside[-1]] == pytest.approx([5, 48, 97], abs=40)
    assert bar[(inside[0] + inside[-1]) // 2] == pytest.approx([247, 247, 247], abs=12)


@pytest.mark.rendering
@pytest.mark.slow
def test_the_surface_by_its_bound(egg, tmp_path):
    # as asked for, or where there is no truth
    for scene, view in ((egg, "bound"), (replace(egg, truth=None), "surface")):
        image = draw(scene, tmp_path / "bound.png", view)
        # sequential: from pale yellow to dark blue
        bar = bar_of(image)
        inside = np.flatnonzero(np.ptp(bar, axis=1) > 20)
        assert bar[inside[0]] == pytest.approx([8, 29, 88], abs=30)
        assert bar[inside[-1]] == pytest.approx([255, 255, 217], abs=30)
        assert fraction_of_color(image[:, :1090], "#225ea8", 60) > 0.01
    plain = draw(replace(egg, truth=None, bound=None), tmp_path / "plain.png", "surface")
    assert (plain[:, 1150:] == 255).all()  # no bar
    assert 0.1 < (plain < 250).all(axis=2).mean() < 0.7


@pytest.mark.rendering
@pytest.mark.parametrize("color", sorted(set(COLORS) - {"bending"}))
@pytest.mark.slow
def test_the_cloud_by_each_colour(egg, tmp_path, color):
    image = draw(egg, tmp_path / "cloud.png", "cloud", color)
    body, right = image[:, :1090], image[:, 1100:]
    if color == "phase":
        assert fraction_of_color(body, shading.TANGENTIAL, 60) > 2e-3
        assert fraction_of_color(body, shading.TIP, 60) > 5e-5
    else:
        colorful = np.ptp(body, axis=2) > 60
        assert colorful.mean() > 2e-3
        # viridis: green, blue and violet, and no red in it
        red, green, blue = np.moveaxis(body, 2, 0)
        assert not ((red - green > 60) & (red - blue > 60)).any()
        assert (np.ptp(right, axis=2) > 60).mean() > 0.02  # the bar
    # normals stick out of the body
    assert fraction_of_color(body, shading.NORMAL, 60) > 1e-3


@pytest.mark.rendering
def test_contacts_by_the_bending_out_of_the_plane(tmp_path):
    scene = scanned_in_space()
    shaded = shading.shade_contacts(scene, "bending")
    assert shaded.title == "bending out of the sweep's plane in °"
    assert shaded.norm.vmin == -shaded.norm.vmax  # symmetric
    # a rod that bends to the clamp's z by as much as along the sweep bends 45° out of the plane
    angle = np.rad2deg(np.arcsin(np.sin(scan3d.reconstruct(scene.recording).bending_angle)))
    assert shaded.norm.vmax == pytest.approx(np.abs(angle).max(), rel=1e-6)
    assert 45 < shaded.norm.vmax <= 90
    # blue below the plane and red above it
    red, blue = shaded.rgb[:, 0].astype(int), shaded.rgb[:, 2].astype(int)
    assert (red > blue)[angle > 5].all()
    assert (blue > red)[angle < -5].all()
    bar = bar_of(draw(scene, tmp_path / "cloud.png", "cloud", "bending"))
    inside = np.flatnonzero(np.ptp(bar, axis=1) > 60)
    assert bar[inside[0], 0] > bar[inside[0], 2]
    assert bar[inside[-1], 0] < bar[inside[-1], 2]


def test_the_bending_of_planar_contacts_is_not_known(egg):
    with pytest.raises(scan3d.InputError, match="the bending of the contacts of egg is not known; known are phase"):
        shading.shade_contacts(egg, "bending")


@pytest.mark.rendering
def test_the_rod_in_space(tmp_path):
    image = draw(scanned_in_space(), tmp_path / "explain.png", "explain")
    for color in (shading.BODY, shading.ROD, shading.INK):
        assert fraction_of_color(image[:-150], color, 60) > 1e-3
    assert fraction_of_color(image[:-150], shading.TANGENTIAL, 60) > 5e-4


@pytest.mark.rendering
def test_truth_and_reconstruction_side_by_side(cube, tmp_path):
    image = draw(cube, tmp_path / "compare.png", "compare")
    places = [axes.get_position() for axes in views.figure(cube, "compare").axes if axes.images]
    height, width = image.shape[:2]
    left, right = (
        image[
            round((1 - place.y1) * height) : round((1 - place.y0) * height),
            round(place.x0 * width) : round(place.x1 * width),
        ]
        for place in places
    )
    assert fraction_of_color(left, "#053061", 25) == 0
    assert fraction_of_color(right, "#053061", 25) > 0.05
    # by the same camera: the outlines agree
    bodies = [(np.abs(half - 255).max(axis=2) > 12) for half in (left, right)]
    assert (bodies[0] != bodies[1]).mean() < 0.02
    assert bodies[0].mean() > 0.2


@pytest.mark.rendering
@pytest.mark.parametrize("scene", ["egg", "cube"])
@pytest.mark.slow
def test_the_view_that_explains(scene, tmp_path, request):
    image = draw(request.getfixturevalue(scene), tmp_path / "explain.png", "explain")
    upper = image[:-150]  # without the legend
    assert fraction_of_color(upper, shading.ROD, 50) > 3e-3
    assert fraction_of_color(upper, shading.TANGENTIAL, 60) > 5e-4
    assert fraction_of_color(upper, shading.INK, 30) > 3e-3
    assert fraction_of_color(upper, "#8d949c", 40) > 0.08  # the body
    legend = image[-150:]
    assert (legend < 128).all(axis=2).mean() > 0.005


@pytest.mark.rendering
def test_the_camera_sees_all_of_any_body():
    rng = np.random.default_rng(3)
    for size in ([80, 4, 4], [4, 4, 80], [80, 80, 4], [1e-3, 1e-3, 1e-3], [1e4, 1, 1]):
        corners = (rng.integers(0, 2, (64, 3)) - 0.5) * size + [1000, -20, 3]
        canvas = Canvas(corners)
        across = canvas.aim(1000, 700)
        camera = canvas.plotter.camera
        seen = (corners - camera.focal_point) @ np.stack([canvas.right, canvas.up], axis=1) / across * 1000
        canvas.plotter.close()
        assert np.abs(seen[:, 0]).max() <= 500
        assert np.abs(seen[:, 1]).max() <= 350
        assert max(np.ptp(seen[:, 0]) / 1000, np.ptp(seen[:, 1]) / 700) > 0.9


@pytest.mark.rendering
@pytest.mark.slow
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
    assert nice(length) == pytest.approx(step)


@pytest.mark.parametrize(
    ("change", "options", "sentence"),
    [
        (
            {},
            dict(view="rainbow"),
            "view must be one of cloud, surface, bound, compare, explain, histogram, forces, got 'rainbow'",
        ),
        ({}, dict(color="taste"), "contacts are coloured by phase, force, friction, error, bending, got 'taste'"),
        (
            dict(contacts=None),
            dict(view="cloud"),
            "cube has no contacts to show; it has a surface: give the view surface",
        ),
        (dict(surface=None), dict(view="surface"), "cube has no surface to show; it has a cloud: give the view cloud"),
        (dict(truth=None), dict(view="compare"), "the true body of cube is not known, .*: give --truth MESH"),
        (dict(bound=None), dict(view="bound"), "the bound of cube is not known; show a scan's folder"),
        (dict(recording=None), dict(view="explain"), "cube has no recording, which rods are drawn from"),
    ],
)
def test_views_that_the_scene_can_not_give(cube, tmp_path, monkeypatch, change, options, sentence):
    monkeypatch.setattr(rendering, "can_render", lambda: True)  # it is refused before anything is drawn
    with pytest.raises(scan3d.InputError, match=sentence):
        views.picture(replace(cube, **change), tmp_path / "x.png", **options)
    assert not list(tmp_path.iterdir())


def test_the_ending_of_a_picture(cube, tmp_path):
    with pytest.raises(scan3d.InputError, match=r"a picture is written as \.png, \.pdf or \.svg, got 'x\.bmp'"):
        views.picture(cube, tmp_path / "x.bmp")


@pytest.mark.rendering
@pytest.mark.parametrize("point", [(0.0, 0.0, 0.0), (-20.0, -20.0, 19.3)])
def test_points_that_differ_by_rounding_are_seen_as_one(point):
    points = np.array([point, point])
    canvas = Canvas(points)
    points[1] *= 1 + 2e-16
    rounded = Canvas(points)
    assert (canvas.size, len(canvas.corners)) == (rounded.size, len(rounded.corners)) == (1.0, 1)
    for shown in (canvas, rounded):
        shown.add_points(points, shading.TIP, 7)
        assert 0 < fraction_of_color(shown.image(64, 64)[0], shading.TIP, 60) < 0.5
        shown.plotter.close()
