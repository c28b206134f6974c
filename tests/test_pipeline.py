"""From a recording to results: `write` writes what it is given."""

import dataclasses

import pytest
import trimesh
from small_scans import RESULTS

import scan3d
from scan3d import pipeline
from scan3d.files.meshes import judge_mesh
from scan3d.pictures import canvas, drawing


@pytest.fixture(scope="module")
def scan():
    mesh = trimesh.creation.box((20, 30, 40))
    recording = scan3d.simulate(mesh, scan3d.Plan(slices=6, samples=12, sweeps=4, friction=(0.1, 0.3)))
    return mesh, recording, pipeline.analyse(recording, mesh)


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
