"""The everyday bodies of the robustness trials are what their table says."""

import pytest

from tests.robustness.everyday import EVERYDAY, mesh_of


@pytest.mark.parametrize("name", EVERYDAY)
def test_body_is_closed_and_in_one_part(name):
    mesh = mesh_of(name)
    assert mesh.is_watertight
    assert mesh.volume > 0
    assert mesh.body_count == 1
    assert mesh.euler_number == EVERYDAY[name].euler
    assert 0.01 < EVERYDAY[name].wall / mesh.scale < 0.5
