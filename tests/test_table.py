"""The table on which a body stands: stated in a recording, it bounds the body from below in slices and in space."""

import dataclasses
import json

import numpy as np
import pytest
from sample_bodies import convex_hausdorff
from shapes import ball
from spatial_bodies import Ellipsoid, largest_difference, random_polyhedron, spatial_cloud

import scan3d
from scan3d.bounds.enclosures import slice_enclosure
from scan3d.cli import main
from scan3d.reconstruction import checked
from scan3d.session import Session
from scan3d.simulation.rig import simulate_rig, standing
from scan3d.surfaces import certificate, enclosure, surface
from tests.robustness.bounds import false_bounds

pytestmark = pytest.mark.slow

ROD = scan3d.Rod(0.06, 1.9e-4, 0.0003)


def body(seed):
    return standing(ball(seed, 16, np.array([20.0, 16.0, 22.0])))


def swept(mesh, slices=7, samples=40):
    return simulate_rig(mesh, Session("cylinder:46x48", ROD, slices=slices, samples=samples).ask()).recording()


@pytest.fixture(scope="module")
def recording():
    return swept(body(3))


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.trust) for seed in (1, 2))])
def test_the_table_bounds_horizontal_slices_as_an_empty_one_does(seed):
    mesh = body(seed)
    recording = swept(mesh)
    open_below = scan3d.reconstruct(dataclasses.replace(recording, table_m=None))
    # without the table the slices do not bound the body from below, but the tangents do, loosely
    assert slice_enclosure(open_below).bound == np.inf
    cloud = scan3d.reconstruct(recording)
    bounds = enclosure(cloud)
    assert false_bounds(mesh, bounds) == []
    assert bounds.bound < min(16, enclosure(open_below).bound)
    # of the body fattened by the rod, which is as much lower
    assert bounds.corners[:, 2].min() == pytest.approx(bounds.reach, abs=1e-9)
    made = surface(cloud, bounds=bounds)
    assert convex_hausdorff(made, mesh) <= certificate(bounds, made).bound
    # a slice as low as the rod's centre line can be on the table, in which nothing is touched
    with_empty = dataclasses.replace(
        open_below.fattened,
        slice_axis=np.vstack([open_below.slice_axis, [0.0, 0.0, 1.0]]),
        slice_height=np.append(open_below.slice_height, -cloud.rod_radius),
    )
    assert enclosure(dataclasses.replace(open_below, fattened=with_empty)).bound == bounds.bound


@pytest.mark.parametrize("axis", [(0.0, 0.0, -1.0), "x", (1.0, 0.0, 1.0)])
def test_the_table_cuts_slices_along_any_axis(axis):
    mesh = body(2)
    recording = scan3d.simulate(mesh, scan3d.Plan(slices=6, samples=20, axis=axis))
    cloud = scan3d.reconstruct(recording)
    before, bounds = enclosure(cloud), enclosure(dataclasses.replace(cloud, table=0.0))
    assert before.corners[:, 2].min() < -1e-3
    assert bounds.corners[:, 2].min() > -1e-9
    assert bounds.volume[1] < before.volume[1]
    assert bounds.bound <= before.bound
    assert false_bounds(mesh, bounds) == []


@pytest.mark.parametrize(("seed", "radius"), [(0, 0.02), (1, 0.0), pytest.param(2, 0.02, marks=pytest.mark.trust)])
def test_the_table_closes_contacts_in_space(seed, radius):
    shape = Ellipsoid(np.array([1.0, 0.8, 0.6])) if seed == 0 else random_polyhedron(seed)
    lowest = -float(shape.support(np.array([[0.0, 0.0, -1.0]]))[0])
    cloud = spatial_cloud(shape, 1500, seed, radius, seen=lambda _, normals: normals[:, 2] > -0.6)
    before = enclosure(cloud).bound
    bounds = enclosure(dataclasses.replace(cloud, table=lowest))
    assert largest_difference(bounds.inner, shape) <= bounds.bound < min(before, 1.0)
    made = surface(dataclasses.replace(cloud, table=lowest), "bracket", bounds=bounds)
    certified, local, _ = certificate(bounds, made)
    assert largest_difference(made, shape) <= certified
    assert np.isfinite(local).all()


def test_contacts_below_the_table_contradict_it(recording):
    cloud = scan3d.reconstruct(recording)
    assert checked(recording, cloud).contradictions == []
    lowest = float(cloud.fattened.points[:, 2].min()) + cloud.rod_radius
    # on the table, up to rounding
    on_it = dataclasses.replace(recording, table_m=lowest / 1000)
    assert checked(on_it, scan3d.reconstruct(on_it)).contradictions == []
    assert enclosure(scan3d.reconstruct(on_it)).bound >= convex_hausdorff(enclosure(cloud).inner, body(3)) - 2 * lowest
    above = dataclasses.replace(recording, table_m=0.02)
    found = checked(above, scan3d.reconstruct(above))
    assert [warning.code for warning in found.contradictions] == ["below-table"]
    assert f"contacts lie down to z = {lowest:.4g} mm, where the table is at 20" in found.contradictions[0].message
    assert found.contradictions[0].value == pytest.approx(20 - lowest)
    assert found.diagnosis.fault == "table"


def reconstructed(log, out, capsys, *options):
    """The certificate of a report, and what the command prints."""
    assert main(["reconstruct", str(log), "--method", "hull", "--out", str(out), *options]) == 0
    return json.loads((out / "report.json").read_text())["certificate"], capsys.readouterr().out


def test_the_commands_know_the_table(rig_folder, tmp_path, capsys, no_pictures):
    known, text = reconstructed(rig_folder / "log.csv", tmp_path / "out", capsys)
    assert known["table"] == 0.0
    assert 0 < known["bound"] < 30
    assert "and the table at z = 0 mm" in text
    # the same table, stated by the option
    (tmp_path / "log.csv").write_text((rig_folder / "log.csv").read_text())
    (tmp_path / "log.toml").write_text((rig_folder / "log.toml").read_text().replace("table_height_m = 0.0\n", ""))
    unknown, text = reconstructed(tmp_path / "log.csv", tmp_path / "out", capsys)
    assert unknown["table"] is None
    assert unknown["bound"] is None
    assert "if it stands on a table, state the height by --table" in text
    stated, _ = reconstructed(tmp_path / "log.csv", tmp_path / "out", capsys, "--table", "0")
    assert stated["bound"] == known["bound"]
    lower, _ = reconstructed(tmp_path / "log.csv", tmp_path / "out", capsys, "--table", "-5")
    assert lower["table"] == -5.0
    assert lower["volume"][1] > known["volume"][1]
