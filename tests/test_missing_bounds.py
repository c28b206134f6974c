"""What is said to be missing where nothing bounds a body that was touched in space."""

from dataclasses import replace

import numpy as np
import pytest
from spatial_bodies import Ellipsoid, spatial_cloud

from scan3d.bounds import enclosure, missing

BALL = Ellipsoid([0.5, 0.4, 0.3])


@pytest.mark.parametrize(
    ("seen", "words"),
    [
        (lambda _, n: n[:, 2] > 0.05, "below z = "),
        (lambda _, n: n[:, 2] < -0.05, "above z = "),
        (lambda _, n: n[:, 0] > 0.05, "towards (-1.00, "),
    ],
)
def test_the_open_side_is_named(seen, words):
    cloud = spatial_cloud(BALL, 600, 1, seen=seen)
    assert np.isinf(enclosure(cloud).bound)
    assert words in missing(cloud)
    assert ("table" in missing(cloud)) == ("below" in words)


def test_noise_is_named_where_contacts_face_all_sides():
    cloud = spatial_cloud(BALL, 600, 1)
    sd = np.full(len(cloud), 0.05)
    noisy = replace(cloud, place_sd=sd, tangent_sd=sd, covariance=sd[:, None, None] ** 2 * np.eye(3))
    assert np.isinf(enclosure(noisy).bound)
    assert "less noise would bound it" in missing(noisy)
