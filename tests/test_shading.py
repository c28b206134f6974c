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
