"""The public steps take paths where they take meshes and recordings, and give what they give for what was read."""

import typing

import numpy as np
import pytest
from small_scans import CUBE

import scan3d
from scan3d import choices, units

PLAN = scan3d.Plan(slices=4, sweeps=4, samples=8)


@pytest.fixture(scope="module")
def mesh():
    return scan3d.load_mesh(CUBE)


@pytest.fixture(scope="module")
def recording(mesh):
    return scan3d.simulate(mesh, PLAN)


def test_meshes_may_be_paths(mesh, recording):
    for path in (CUBE, str(CUBE)):
        simulated = scan3d.simulate(path, PLAN)
        assert np.array_equal(simulated.force_N, recording.force_N)
        assert scan3d.compare(path, mesh).hausdorff == 0
        assert scan3d.compare(mesh, path).hausdorff == 0


def test_recordings_may_be_paths(recording, tmp_path):
    scan3d.write_recording(recording, tmp_path / "log.csv")
    points = scan3d.reconstruct(recording).points
    for path in (tmp_path / "log.csv", str(tmp_path / "log.csv")):
        assert np.array_equal(scan3d.reconstruct(path).points, points)


def test_surfaces_state_their_unit():
    cloud = scan3d.reconstruct(scan3d.simulate(CUBE, scan3d.Plan(slices=4, sweeps=4, samples=8, unit="in")))
    assert scan3d.surface(cloud, "hull").units == "in"


def test_the_types_of_choices_are_those_of_the_lists():
    assert typing.get_args(units.Unit) == tuple(units.UNITS_M)
    lists = {name: values for name, values in vars(choices).items() if name.isupper()}
    parts = {"NOT_CONVEX": choices.METHODS, "CHARTS": choices.VIEWS, "WITH_OTHER": choices.VIEWS}
    assert all(set(lists.pop(name)) < set(whole) for name, whole in parts.items())
    types = {name: typing.get_args(kind) for name, kind in vars(choices).items() if typing.get_origin(kind)}
    assert sorted(lists.values()) == sorted(types.values())
