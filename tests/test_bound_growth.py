"""How bounds grow with what is not known: the accuracy of the contacts, and the calibration of the rig."""

import numpy as np
import pytest
import trimesh

import scan3d
from scan3d.reconstruction.contacts import contacts
from scan3d.surfaces import enclosure

# Half the lengths of the edges of an upright box, whose slices all have the same support function.
HALF = np.array([10.0, 15.0, 20.0])


@pytest.fixture(scope="module")
def recording():
    box = trimesh.creation.box(2 * HALF)
    return scan3d.simulate(box, scan3d.Plan(slices=8, sweeps=8, samples=24, spacing="uniform"))


@pytest.fixture(scope="module")
def cloud(recording):
    return contacts(recording)


@pytest.mark.parametrize("margin", [0.0, 0.01, 0.3])
def test_an_upright_box_grows_by_its_margin(cloud, margin):
    """Its walls are known at every height: they move out by the margin, and between slices by more.

    A half-space is inclined along the secant from the slice behind, whose support function may be smaller by the margin, to its
    own, where it may be larger by the margin: at a distance d from it, of slices h apart, the body may extend by margin
    (1 + 2 d / h).  Between two slices with others behind them d is at most h / 2, and at the ends h.
    """
    bounds = enclosure(cloud, margin)
    levels = np.unique(cloud.slice_height[np.unique(cloud.slice)])
    z = bounds.corners[:, 2]
    beyond = np.linalg.norm(np.maximum(np.abs(bounds.corners[:, :2]) - HALF[:2], 0), axis=1)
    inner = (z > levels[1]) & (z < levels[-2])
    assert inner.any()
    # the angle between neighbouring normals lets corners lie 5 % farther out than the planes
    assert (beyond <= 1.05 * margin * np.where(inner, 2, 3) + 1e-9).all()
    # a body that is larger by the margin would have given the same contacts
    assert (beyond[np.abs(z) < HALF[2]] >= margin - 1e-9).all()
    assert bounds.volume[1] >= np.prod(2 * (HALF + np.array([margin, margin, 0.0]))) - 1e-6
    assert bounds.volume[0] == pytest.approx(bounds.inner.volume)
    assert bounds.margin == margin
