"""From a recording to results: `analyse` computes and does nothing else, `write` writes what it is given."""

import dataclasses

import numpy as np
import pytest
import trimesh
from small_scans import RESULTS

import scan3d
from scan3d import pipeline
from scan3d.files.meshes import judge_mesh
from scan3d.pictures import canvas, drawing


def simulated(noise=0.0):
    mesh = trimesh.creation.box((20, 30, 40))
    return mesh, scan3d.simulate(mesh, scan3d.Plan(slices=6, samples=12, sweeps=4, friction=(0.1, 0.3), noise=noise))


@pytest.fixture(scope="module")
def scan():
    mesh, recording = simulated()
    return mesh, recording, pipeline.analyse(recording, mesh)


def flat(value):
    """The arrays and numbers of an analysis, by name; the seconds spent are left out."""
    if dataclasses.is_dataclass(value):
        value = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        value.pop("seconds", None)
    elif isinstance(value, trimesh.Trimesh):
        value = {"vertices": np.array(value.vertices), "faces": np.array(value.faces), "metadata": dict(value.metadata)}
    elif isinstance(value, (tuple, list)):
        value = dict(enumerate(value))
    if isinstance(value, dict):
        return {f"{name}.{rest}": leaf for name, part in value.items() for rest, leaf in flat(part).items()}
    return {"": value}


def assert_same(first, second):
    first, second = flat(first), flat(second)
    assert first.keys() == second.keys()
    for name, value in first.items():
        np.testing.assert_array_equal(value, second[name], err_msg=name)


def test_analyse_gives_the_same_twice_and_leaves_its_inputs_as_they_were(scan, tmp_path, monkeypatch, capfd):
    mesh, recording, first = scan
    monkeypatch.chdir(tmp_path)
    _, untouched = simulated()
    vertices = np.array(mesh.vertices)
    again = pipeline.analyse(recording, mesh)
    assert_same(first, again)
    assert_same(recording, untouched)
    np.testing.assert_array_equal(mesh.vertices, vertices)
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr() == ("", "")


PICTURES = {"cloud.png", "surface.png"}


def test_write_removes_former_pictures_and_nothing_else(scan, tmp_path, monkeypatch):
    """A picture of an earlier run must not stand beside the results of this one."""
    _, _, analysis = scan
    analysis = dataclasses.replace(analysis, truth=None)
    with monkeypatch.context() as patched:
        patched.setattr(canvas, "can_render", lambda *_: True)
        patched.setattr(drawing.Drawing, "finish", lambda _: [b"a picture"] * 2)
        data = pipeline.write(analysis, tmp_path, settings={})
    assert set(data["files"]) == RESULTS | PICTURES
    (tmp_path / "notes.txt").write_text("earlier")
    monkeypatch.setattr(canvas, "can_render", lambda *_: False)
    pipeline.write(analysis, tmp_path, settings={})
    assert {path.name for path in tmp_path.iterdir()} == RESULTS | {"notes.txt"}


def test_a_true_body_in_another_unit_is_remarked_on(scan, tmp_path, monkeypatch):
    mesh, recording, _ = scan
    monkeypatch.setattr(canvas, "can_render", lambda *_: False)
    large, said = judge_mesh(trimesh.Trimesh(1000 * mesh.vertices, mesh.faces)), []
    pipeline.reconstruct(lambda: (recording, large), tmp_path, settings={"method": "hull"}, notify=said.append)
    assert "as large as the surface, as if the true body were in mm and the surface in m" in said[0]
