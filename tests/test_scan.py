"""From a body to a recording and back to its contacts: exact to rounding for every friction, place and unit."""

import dataclasses
import json
import os
import re
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import trimesh
from sample_bodies import MESHES as FOLDER
from scipy.spatial.transform import Rotation
from small_scans import CUBE, EGG, RESULTS

import planar
import scan3d
from scan3d import workers
from scan3d.files.meshes import read_mesh
from scan3d.files.text import parse_rod
from scan3d.geometry.hulls import hull
from scan3d.geometry.sections import slice_frame
from scan3d.pictures import canvas
from scan3d.reconstruction.contacts import contacts

MESHES = sorted(p for p in FOLDER.iterdir() if p.suffix in {".stl", ".ply", ".obj", ".off", ".glb"})
# Contacts are reconstructed to a billionth of the rod's length; rounding could take six digits more.
EXACT = 1e-9
TIP, TANGENTIAL = planar.Phase.TIP, planar.Phase.TANGENTIAL


# --- the true contours, independent of the program: the file as trimesh reads it, every triangle cut by the plane ---


def outline(vertices, faces, normal, height):
    """Segments (k, 2, 3) in which the plane <normal, p> = height cuts the triangles."""
    above = vertices @ normal - height
    segments = []
    for a, b, c in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):  # corner a lies alone on one side
        corners = faces[:, [a, b, c]]
        side = above[corners] >= 0
        corners = corners[(side[:, 0] != side[:, 1]) & (side[:, 1] == side[:, 2])]
        ends = []
        for other in (1, 2):
            p, q = corners[:, 0], corners[:, other]
            fraction = (above[p] / (above[p] - above[q]))[:, None]
            ends.append(vertices[p] + fraction * (vertices[q] - vertices[p]))
        segments.append(np.stack(ends, axis=1))
    return np.concatenate(segments)


def segment_distances(points, segments):
    """(n,) from each point to the nearest of the segments, all against all."""
    a, ab = segments[:, 0], segments[:, 1] - segments[:, 0]
    ap = points[:, None] - a
    length = np.maximum((ab * ab).sum(axis=1), np.finfo(float).tiny)
    along = np.clip((ap * ab).sum(axis=2) / length, 0, 1)
    return np.linalg.norm(ap - along[:, :, None] * ab, axis=2).min(axis=1)


def contour_errors(cloud, recording, vertices, faces):
    """(n,) distance of each contact to the contour in which its rod's plane cuts the body, in rod lengths."""
    scale = {"mm": 1e-3, "m": 1.0}[recording.unit]
    rows = cloud.row
    # the clamp's z axis in the world
    normal = Rotation.from_quat(recording.quaternion[rows], scalar_first=True).apply([0.0, 0.0, 1.0])
    height = (recording.position_m[rows] / scale * normal).sum(axis=1)
    errors = np.full(len(cloud), np.nan)
    for number in np.unique(cloud.slice):
        here = cloud.slice == number
        assert np.ptp(height[here]) < 1e-12 * cloud.rod_length
        errors[here] = segment_distances(cloud.points[here], outline(vertices, faces, normal[here][0], height[here][0]))
    return errors / cloud.rod_length


def as_in_the_file(path):
    mesh = read_mesh(path)
    return np.asarray(mesh.vertices, dtype=float), np.asarray(mesh.faces)


def drawn_friction(recording, rows, sweeps):
    """(n,) coefficients that were drawn for rows of the recording, looked up by the forces that `sweeps` had with them."""
    unit = recording.rod.force_unit_N
    by_force = {
        np.array([x * unit, y * unit]).tobytes(): mu
        for s in sweeps
        for x, y, mu in zip(s.f0x, s.f0y, s.friction, strict=True)
    }
    return np.array([by_force[row.tobytes()] for row in recording.force_N[rows]])


def places(mesh, **plan):
    """Recording and contacts of a scan, without the surface's normals, which take longer and have separate tests."""
    recording = scan3d.simulate(mesh, scan3d.Plan(**plan))
    return recording, contacts(recording)


@pytest.fixture
def watched_sweeps(monkeypatch):
    """All sweeps that planar makes for a simulation."""
    sweeps, original = [], planar.sweep_all

    def sweep_all(*args, **kwargs):
        made = original(*args, **kwargs)
        sweeps.extend(made)
        return made

    monkeypatch.setattr(planar, "sweep_all", sweep_all)
    return sweeps


# --- contacts lie on the body ---


@pytest.mark.parametrize("path", MESHES, ids=lambda path: path.stem)
@pytest.mark.slow
def test_every_contact_lies_on_its_slice_whatever_the_friction_of_its_sample(path, watched_sweeps):
    recording, cloud = places(scan3d.load_mesh(path), slices=12, spacing="cosine", friction=(0.0, 0.4), seed=7)

    assert contour_errors(cloud, recording, *as_in_the_file(path)).max() <= EXACT
    # every row with a force gives its contact: all but each sweep's first, which only touches, and some that have left
    assert len(cloud) == np.any(recording.force_N != 0, axis=1).sum()
    assert len(cloud) > 0.95 * sum(len(sweep) - 1 for sweep in watched_sweeps)
    assert len(np.unique(cloud.slice)) == 12
    assert set(cloud.phase) == {TIP, TANGENTIAL}

    tangential = cloud.phase == TANGENTIAL
    drawn = drawn_friction(recording, cloud.row, watched_sweeps)
    assert cloud.friction[tangential] == pytest.approx(drawn[tangential], abs=1e-9)
    assert cloud.friction[tangential].min() < 0.01
    assert cloud.friction[tangential].max() > 0.39
    assert np.isnan(cloud.friction[~tangential]).all()


# --- files ---


def run(*arguments, **environment):
    command = Path(sys.executable).with_name("scan3d")
    return subprocess.run(
        [command, *map(str, arguments)], env={**os.environ, **environment}, capture_output=True, text=True, check=False
    )


# Too few contacts for the fit of a smooth body, which takes longer than all the rest.
FEW = ("--slices", "6", "--sweeps", "6", "--samples", "16")
ROUGH = ("--friction", "0.0:0.4", "--noise", "1e-4")


def scan(folder, *arguments):
    from scan3d.cli import main

    assert main(["scan", str(EGG), "--out", str(folder), *FEW, *arguments, "--quiet"]) == 0
    return folder


def without(report, *keys):
    data = json.loads(report)
    return {key: data[key] for key in data.keys() - set(keys)}


@pytest.mark.slow
def test_the_installed_command_gives_the_same_files_as_this_process_with_the_same_seed(
    tmp_path, all_samples, monkeypatch
):
    """With other hashes and one thread.  It prints results on stdout only, and draws where something can."""
    folder, pictures = tmp_path / "first", {"cloud.png", "surface.png"} if canvas.can_render() else set()
    given = ("--out", folder, *FEW, *ROUGH, "--seed", "5")
    done = run("scan", EGG, *given, PYTHONHASHSEED="3", OMP_NUM_THREADS="1")
    assert done.returncode == 0, done.stderr
    assert "Hausdorff distance" in done.stdout
    assert f"written to         {folder}" in done.stdout
    assert re.fullmatch(r"(scan3d: [\d.]+ s: .*\n)*", done.stderr) or not pictures
    assert all((folder / name).read_bytes().startswith(b"\x89PNG") for name in pictures)
    monkeypatch.setattr(canvas, "can_render", lambda *_: False)
    again = scan(tmp_path / "again", *ROUGH, "--seed", "5")
    assert RESULTS == {path.name for path in again.iterdir()} == {path.name for path in folder.iterdir()} - pictures
    for name in RESULTS:
        first, second = ((place / name).read_bytes() for place in (folder, again))
        if name == "report.json":
            first, second = (without(text, "timings_s", "files", "sha256") for text in (first, second))
        assert first == second, name


@pytest.mark.parametrize("random", [dict(friction=(0.0, 0.4)), dict(noise=1e-3)], ids=str)
def test_friction_and_noise_each_follow_the_seed(random):
    mesh = scan3d.load_mesh(CUBE)
    first, second, third = (places(mesh, slices=2, sweeps=2, samples=8, **random, seed=seed)[0] for seed in (1, 1, 2))
    assert np.array_equal(first.force_N, second.force_N)
    assert not np.allclose(first.force_N, third.force_N)


# --- invariances ---


def test_metres_and_millimetres_give_the_same_shape():
    mesh = scan3d.load_mesh(EGG)
    small = trimesh.Trimesh(mesh.vertices * 1e-3, mesh.faces, process=False)
    plan = dict(slices=8, friction=(0.0, 0.4))
    (_, in_mm), (_, in_m) = places(mesh, **plan), places(small, **plan, unit="m")
    assert len(in_m) == len(in_mm)
    assert np.array_equal(in_m.phase, in_mm.phase)
    assert np.abs(in_m.points * 1e3 - in_mm.points).max() <= 1e-12 * mesh.scale
    assert in_m.force_N == pytest.approx(in_mm.force_N, rel=1e-9)
    assert in_m.rod_length == pytest.approx(1e-3 * in_mm.rod_length, rel=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("axis", ["x", (1, 1, 0), (0.3, -0.8, 0.5)], ids=str)
def test_slicing_along_an_axis_equals_turning_the_body(axis):
    mesh = scan3d.load_mesh(FOLDER / "gem.glb")
    plan = dict(slices=6, friction=(0.0, 0.4))
    turn = slice_frame(scan3d.Plan(axis=axis).axes()[0])
    recording, cloud = places(mesh, **plan, axis=axis)
    _, turned = places(trimesh.Trimesh(mesh.vertices @ turn.T, mesh.faces, process=False), **plan)
    assert contour_errors(cloud, recording, np.asarray(mesh.vertices), np.asarray(mesh.faces)).max() <= EXACT
    assert len(cloud) == len(turned)
    # contacts at a fold of x0, where a rod is about to snap, are known to the root of rounding only
    apart = np.linalg.norm(cloud.points - turned.points @ turn, axis=1) / cloud.rod_length
    assert np.quantile(apart, 0.99) <= EXACT
    assert apart.max() <= 1e-6


# --- noise, sweeps, rods ---


def test_every_sweep_draws_different_friction(watched_sweeps):
    # along each axis the slices have the same numbers, and in each slice the sweeps
    scan3d.simulate(scan3d.load_mesh(CUBE), scan3d.Plan(slices=3, sweeps=3, samples=4, axis="xyz", friction=(0.0, 0.4)))
    drawn = np.array([sweep.friction for sweep in watched_sweeps])
    assert drawn.shape == (27, 4)
    assert len(np.unique(drawn)) == drawn.size


RODS = [dict(rod=dataclasses.replace(parse_rod(text), diameter_m=0.0)) for text in ("steel:0.003x0.5", "steel:6x1000")]
PLANS = [*RODS, *(dict(clearance=part) for part in (1e-6, 0.9, 0.999)), dict(axis="xyz", friction=(0.0, 0.4))]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("path", "plan"),
    [
        pytest.param(path, plan, marks=pytest.mark.trust if (i + k) % 2 else (), id=f"{path.stem} {next(iter(plan))}")
        for i, path in enumerate([EGG, CUBE])
        for k, plan in enumerate(PLANS)
    ],
)
def test_contacts_lie_on_the_body_whatever_the_plan(path, plan):
    """Also with rods far too short and long, and with clearances at which the tip alone touches."""
    mesh = scan3d.load_mesh(path)
    recording, cloud = places(mesh, slices=4, samples=16, **plan)
    # rounding is relative to the body's size where that is larger than the rod
    bound = EXACT * max(1.0, mesh.scale / cloud.rod_length)
    assert contour_errors(cloud, recording, *as_in_the_file(path)).max() <= bound
    # the contacts lie in the body
    assert 0 < hull(cloud.points).volume <= mesh.volume * (1 + 1e-9)
    axes = np.unique(np.round(cloud.slice_axis[np.unique(cloud.slice)], 9), axis=0)
    assert np.array_equal(axes, np.eye(3)[::-1] if "axis" in plan else np.eye(3)[2:])


@pytest.mark.parametrize("spread", [0.0, 1e-5])
def test_poses_that_are_rounded_or_shake_keep_their_slices(spread):
    """As a robot logs them: micrometres, and quaternions of six digits."""
    recording = scan3d.simulate(
        scan3d.load_mesh(EGG), scan3d.Plan(slices=8, sweeps=4, samples=16, axis=(1.0, 0.3, 2.0))
    )
    shaken = np.random.default_rng(0).normal(scale=spread * recording.rod.length_m, size=(len(recording), 1))
    logged = dataclasses.replace(
        recording,
        position_m=np.round(recording.position_m + shaken * recording.axes()[:, 2], 6 if not spread else 9),
        quaternion=np.round(recording.quaternion, 6),
    )
    exact, rounded = contacts(recording), contacts(logged)
    assert len(rounded.slice_height) == len(exact.slice_height) == 10
    assert np.array_equal(rounded.slice, exact.slice)


def test_sweeps_without_contact_are_recorded():
    mesh = scan3d.load_mesh(CUBE)  # 40 mm, about the origin
    recording = scan3d.simulate(mesh, scan3d.Plan(slices=3, sweeps=4, samples=10))
    height = recording.position_m[:, 2] * 1e3
    beyond = np.abs(height) > 20
    assert (recording.force_N[beyond] == 0).all()
    assert (recording.moment_Nm[beyond] == 0).all()
    for side in (height > 20, height < -20):
        assert side.sum() == 4 * 10
    # the first sample of a sweep only touches
    assert (np.any(recording.force_N != 0, axis=1)[~beyond].reshape(-1, 10)[:, 1:]).all()


@pytest.mark.slow
@pytest.mark.parametrize("few", [{"samples": 2}, {"samples": 20, "noise": 1e-300}])
def test_the_fewest_samples_and_the_least_noise_give_a_result(few):
    """No slice is enclosed by its known normals, and variances are 0."""
    assert scan3d.scan(CUBE, slices=4, **few).surface.is_watertight


def test_a_scan_that_does_not_fit_into_memory_is_refused_before_it_is_taken(monkeypatch):
    monkeypatch.setattr(workers, "memory_bytes", lambda: 24_000_000_000)
    scan3d.simulate(CUBE, scan3d.Plan(slices=2, samples=8))  # imports what it needs
    tracemalloc.start()
    for plan in (scan3d.Plan(slices=10**9), scan3d.Plan(samples=10**12), scan3d.Plan(sweeps=10**400)):
        with pytest.raises(scan3d.InputError, match=r"needs about .* GB, and this machine has 24 GB"):
            scan3d.simulate(CUBE, plan)
    assert tracemalloc.get_traced_memory()[1] < 10_000_000
    tracemalloc.stop()


@pytest.mark.trust
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="the largest memory is read from Linux' /proc")
def test_a_scan_takes_no_more_memory_than_was_stated_before():
    # the largest memory of a process of its own, with 300,000 samples, of which arrays take more than the program; `resource`
    # would state that of the process from which it was forked, if that is larger
    script = f"""
from pathlib import Path
from unittest.mock import patch
import scan3d
stated = []
with patch("scan3d.simulation.scan.check_memory", lambda needed, *_: stated.append(needed)):
    scan3d.scan({str(EGG)!r}, slices=16, samples=2800)
status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
print(stated[0], 1024 * int(status["VmHWM"].split()[0]))
"""
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    stated, taken = (float(word) for word in run.stdout.split())
    assert 3e8 < taken < stated
