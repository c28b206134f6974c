"""Colours mean what their scales say."""

from dataclasses import replace

import numpy as np
import pytest
from small_scans import CUBE, EGG, scanned

import planar
import scan3d
from scan3d.pictures import shading
from scan3d.pictures.parts import shown_surface


@pytest.fixture(scope="module")
def egg():
    return scanned(EGG)


@pytest.fixture(scope="module")
def cube():
    return scanned(CUBE)


def test_colours_of_bounds_between_vertices_are_on_the_scale(cube):
    """Values are interpolated, not colours: a mixture of pale and dark need not be a colour of the scale."""
    bound = np.where(cube.surface.vertices[:, 0] > 0, 0.4, 0.0)
    mesh, shaded = shading.shade_surface(replace(cube, bound=bound, truth=None), "bound")
    assert mesh.volume == pytest.approx(cube.surface.volume)
    assert (shaded.norm.vmin, shaded.norm.vmax) == (0.0, 0.4)
    colors = {tuple(color) for color in shaded.rgb}
    scale = shading.shade(np.linspace(0, 1, 256), "", 0, 1, map="YlGnBu").rgb
    assert colors <= {tuple(color) for color in scale}
    assert len(colors) > 30
    # linear across the lid, from side to side
    lid = mesh.vertices[:, 2] > mesh.vertices[:, 2].max() - 1e-6
    x = mesh.vertices[lid, 0]
    _, _, values = shown_surface(replace(cube, bound=bound, truth=None))
    assert values[lid].min() >= -1e-12
    assert values[lid][x < x.min() + 1e-6].max() <= values[lid][x > x.max() - 1e-6].min()


def test_colours_that_a_cloud_does_not_know(cube):
    unknown = cube.contacts.copy()
    unknown["quality"] = np.nan
    with pytest.raises(
        scan3d.InputError, match="the error of the contacts of cube is not known; known are phase, force, friction"
    ):
        shading.shade_contacts(replace(cube, contacts=unknown), "error")
    with pytest.raises(
        scan3d.InputError, match="the force of the contacts of cube is not known; its file has points only"
    ):
        shading.shade_contacts(replace(cube, contacts=cube.contacts[["x", "y", "z"]]), "force")


def test_colours_are_those_of_their_scales(egg):
    friction = shading.shade_contacts(egg, "friction")
    tip = egg.column("phase") == planar.Phase.TIP
    assert tip.any()
    assert (friction.rgb[tip] == [154, 154, 154]).all()  # unknown: grey
    low, high = np.nanargmin(egg.column("friction")), np.nanargmax(egg.column("friction"))
    assert friction.rgb[low] == pytest.approx([68, 1, 84], abs=1)  # viridis
    assert friction.rgb[high] == pytest.approx([253, 231, 37], abs=1)
    force = shading.shade_contacts(egg, "force")
    assert (force.norm.vmin, force.norm.vmax) == (0.0, pytest.approx(1e3 * egg.column("force").max()))


# Linear red, green and blue as they are seen without one kind of cones (G. M. Machado, M. M. Oliveira, L. A. F. Fernandes, A
# Physiologically-based Model for Simulation of Color Vision Deficiency, IEEE TVCG 15, 2009, severity 1).
SEEN = {
    "all": np.eye(3),
    "no red": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "no green": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "no blue": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}


def lab(color, seen):
    """(3,) the colour "#rrggbb" in CIELAB, as it is seen."""
    srgb = np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    linear = (np.array(seen) @ linear).clip(0, 1)
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ linear
    x, y, z = np.cbrt(xyz / [0.9505, 1.0, 1.089])
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


def least_difference(colors):
    """The smallest distance in CIELAB of two of some colours for any kind of sight."""
    seen = [[lab(color, matrix) for color in colors] for matrix in SEEN.values()]
    return min(np.linalg.norm(a - b) for found in seen for k, a in enumerate(found) for b in found[:k])


def test_what_must_be_told_apart_is_so_by_the_colour_blind():
    # red and green of one lightness, which this test is to find
    assert least_difference(("#b2182b", "#3a6f1f")) < 20
    groups = [
        (shading.TANGENTIAL, shading.TIP, shading.UNKNOWN, shading.NORMAL),
        (shading.ROD, shading.TANGENTIAL, shading.BODY, shading.INK),
        shading.REACTION_COLORS,
        shading.ON_DEVIATION,
        (shading.ROD, shading.BOUND),
    ]
    for colors in groups:
        assert least_difference(colors) > 15, colors
