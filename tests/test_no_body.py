"""Contacts that span no body: those of one sweep, slice or row are written as they are, and nothing else is promised."""

import json

import numpy as np
import pytest
import trimesh
from small_scans import CUBE
from spatial_scans import recorded

import scan3d
from scan3d.errors import NoBodyError
from scan3d.files.recordings import write_recording
from scan3d.recording import of_rows

SCANS = {
    "planar": (CUBE, {}, ("contact", "sweep", "slice")),
    "noisy": (CUBE, {"noise": 1e-4}, ("contact", "sweep", "slice")),
    "probing": ("torus", {"probing": "only"}, ("contact", "sweep")),
    "spatial": (None, {}, ("contact",)),  # sweeps may leave their planes
}


def whole(name):
    of, settings, _ = SCANS[name]
    if of is None:
        return recorded(diameter=0.01, directions=1, heights=3, samples=12)[0], None
    mesh = trimesh.creation.torus(9, 3, major_sections=12) if of == "torus" else scan3d.load_mesh(of)
    return scan3d.simulate(mesh, scan3d.Plan(slices=3, sweeps=4, samples=16, friction=0.3, **settings)), mesh


def thin(recording, kept):
    rows = scan3d.reconstruct(recording).row
    chosen = rows[len(rows) // 2]
    sweep, height = recording.sweep == recording.sweep[chosen], recording.position_m[:, 2]
    if kept == "contact":
        sweep[rows[rows != chosen]] = False
    return of_rows(recording, np.flatnonzero(abs(height - height[chosen]) < 1e-9 if kept == "slice" else sweep))


@pytest.mark.slow
@pytest.mark.parametrize("name", SCANS)
def test_contacts_are_written_and_what_needs_a_body_is_one_sentence(name, call, tmp_path, no_pictures):
    recording, mesh = whole(name)
    truth = [] if mesh is None else ["--truth", tmp_path / "truth.stl"]
    if mesh is not None:
        mesh.export(truth[1])
    for kept in SCANS[name][2]:
        folder = tmp_path / kept
        log, out = folder / "log.csv", folder / "out"
        folder.mkdir()
        write_recording(thin(recording, kept), log)
        cloud = scan3d.reconstruct(log)
        code, stdout, stderr = call("reconstruct", log, "--out", out, *truth)
        assert code == 0, stderr
        assert "neither surface nor certificate" in stdout
        report = json.loads((out / "report.json").read_text())
        assert report["surface"]["method"] is report["certificate"]["bound"] is report["hausdorff"] is None
        assert report["surface"]["reason"] == report["certificate"]["missing"]
        assert sorted(path.name for path in out.iterdir()) == sorted(report["files"])
        if truth and not cloud.noise:
            assert report["contact_error"]["max_rod_lengths"] < 1e-7  # the digits of an STL
        result = scan3d.open(out)
        np.testing.assert_array_equal(result.cloud.points, cloud.points)
        assert np.isinf(result.certificate.bound)
        for asked in (lambda result=result: result.surface, lambda cloud=cloud: scan3d.surface(cloud, "hull")):
            with pytest.raises(NoBodyError, match=r"no body|no sweep with two contacts"):
                asked()
        for arguments, expected in (
            (("show", out, "--html", folder / "view.html"), 0),
            (("show", log, "--html", folder / "log.html"), 0),
            (("export", out, "--to", folder / "cloud.vtp"), 0),
            (("export", out, "--to", folder / "surface.stl"), 1),
            (("next", out, "--out", folder / "poses.csv"), 1),
        ):
            code, _, stderr = call(*arguments)
            assert (code, len(stderr.splitlines())) == (expected, expected), stderr


def test_a_session_has_the_contacts_of_its_first_sweep():
    session = scan3d.Session("cylinder:60x60", slices=3, samples=16)
    session.tell(thin(whole("planar")[0], "sweep"))
    assert len(session.cloud) > 5
    assert np.isinf(session.relative_bound)
    assert "nothing bounds the body" in session.known
    for asked in (session.ask, lambda: session.surface):
        with pytest.raises(NoBodyError):
            asked()
