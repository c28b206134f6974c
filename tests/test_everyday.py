"""The everyday bodies of the robustness trials are what their table says, and one of them is scanned."""

import numpy as np
import pytest

import scan3d
from scan3d.pipeline import analyse
from scan3d.settings import settings
from tests.robustness.everyday import EVERYDAY, mesh_of
from tests.robustness.probing import signed


@pytest.mark.parametrize("name", EVERYDAY)
def test_body_is_closed_and_in_one_part(name):
    mesh = mesh_of(name)
    assert mesh.is_watertight
    assert mesh.volume > 0
    assert mesh.body_count == 1
    assert mesh.euler_number == EVERYDAY[name].euler
    assert 0.01 < EVERYDAY[name].wall / mesh.scale < 0.5


@pytest.mark.slow
def test_no_needle_stands_between_the_parts_of_a_body():
    mesh = mesh_of("wrench")
    surface = analyse(scan3d.simulate(mesh, settings({"friction": "0:0.4"}).plan())).surface
    assert surface.euler_number == EVERYDAY["wrench"].euler
    # where nothing was touched as well; it was 5.8 %
    assert np.abs(signed(mesh, surface.vertices)).max() <= 0.03 * np.linalg.norm(mesh.extents)
