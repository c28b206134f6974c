"""Functions given what they do not expect: a sentence that says what was expected, and no result."""

import dataclasses
import os
import signal
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
import trimesh

import scan3d
from scan3d import InputError, workers
from scan3d.cli import main
from tests.shapes import box, dimpled_box, without

EGG = str(Path(__file__).parents[1] / "meshes" / "egg.stl")
PLAN = scan3d.Plan(slices=4, samples=20)


@pytest.fixture(scope="module")
def recording():
    return scan3d.simulate(box(20, 30, 40), PLAN)


@pytest.mark.parametrize(
    ("mesh", "sentence"),
    [
        (trimesh.Scene(box()), r"got Scene; a scene becomes a mesh by its method to_mesh\(\)"),
        (without(box(20, 30, 40), range(10)), "the body isn't a closed surface .*give mesh.convex_hull"),
        (dimpled_box(0.01), "the body isn't a closed surface whose faces are turned alike"),
        (trimesh.Trimesh(np.eye(3), [[0, 1, 5]], process=False), "a face with a vertex that does not exist"),
        (trimesh.Trimesh(), "at least one triangle"),
        (trimesh.Trimesh(np.full((3, 3), np.nan), [[0, 1, 2]], process=False), "finite coordinates"),
    ],
    ids=range(6),
)
def test_what_is_no_body_is_not_scanned(mesh, sentence):
    with pytest.raises(InputError, match=sentence):
        scan3d.simulate(mesh, PLAN)


@pytest.mark.parametrize(
    ("field", "value", "sentence"),
    [
        ("force_N", lambda a: np.ma.masked_less(a, 0), "force_N is a masked array"),
        ("moment_Nm", lambda a: a.astype(complex), "moment_Nm must be an array of real numbers, got complex128"),
        ("position_m", lambda a: None, "position_m must be an array of real numbers, got object None"),
        ("sweep", lambda a: a + 0.5, "sweep must be an array of whole numbers, got float64"),
        ("sweep", lambda a: [[1], [2, 3]], "rows differ in length"),
        ("force_N", lambda a: a[:, :1], r"force_N must have the shape"),
        ("rod", lambda a: None, "rod must be a scan3d.Rod, got NoneType"),
        ("noise_moment_Nm", lambda a: 1j, "must be numbers >= 0"),
        ("moment_Nm", lambda a: a + 1e70, r"moment_Nm holds 1e\+70; check its unit, which is that of SI"),
        # its square is no number of a computer: a calibration ended in an OverflowError
        ("noise_moment_Nm", lambda a: 1e300, r"a standard deviation of the noise is 1e\+300; check its unit"),
    ],
)
def test_columns_that_are_no_real_numbers(recording, field, value, sentence):
    with pytest.raises(InputError, match=sentence):
        dataclasses.replace(recording, **{field: value(getattr(recording, field))})


@pytest.mark.parametrize(
    "setting",
    [
        dict(friction=None), dict(friction="0.3"), dict(friction=1j), dict(friction=(0.1, None)), dict(friction=1e9),
        dict(noise=None), dict(noise="1"), dict(noise=10**400), dict(clearance="x"), dict(clearance=1e-9), dict(tolerance=[]),
        dict(axis=None), dict(axis=[["x"]]), dict(axis=(1, 2, "z")), dict(axis=(10**400, 0, 0)), dict(rod="steel:0.3x50"),
        dict(spacing=None), dict(spacing=[]), dict(unit=None), dict(unit=[]), dict(sweeps=1.5),
        dict(slices=None), dict(seed="7"),
    ],
    ids=str,
)  # fmt: skip
def test_settings_of_other_types(setting):
    with pytest.raises(InputError, match=next(iter(setting))):
        scan3d.Plan(**setting)


def test_a_scan_that_does_not_fit_into_memory_is_refused_before_it_is_taken(monkeypatch):
    monkeypatch.setattr(workers, "memory_bytes", lambda: 24_000_000_000)
    scan3d.simulate(box(), scan3d.Plan(slices=2, samples=8))  # imports what it needs
    tracemalloc.start()
    for plan in (scan3d.Plan(slices=10**9), scan3d.Plan(samples=10**12), scan3d.Plan(sweeps=10**400)):
        with pytest.raises(InputError, match=r"needs about .* GB, and this machine has 24 GB"):
            scan3d.simulate(box(), plan)
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
    scan3d.scan({EGG!r}, slices=16, samples=2800)
status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
print(stated[0], 1024 * int(status["VmHWM"].split()[0]))
"""
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    stated, taken = (float(word) for word in run.stdout.split())
    assert 3e8 < taken < stated


@pytest.mark.parametrize(
    "words",
    [
        "import raw.csv --guess",
        "import raw.bag --guess",
        "import raw.bag --map {map} --out r.csv",
        "import raw.mat --guess",
        "reconstruct raw.csv --out r",
    ],
)
def test_pipes_are_refused(tmp_path, words, capsys):
    (tmp_path / "map.toml").write_text("[rod]\nlength_m = 0.1\nbending_stiffness_Nm2 = 1e-4\n[ros]\npose = '/a'\n")
    for name in ("raw.csv", "raw.bag", "raw.mat"):
        os.mkfifo(tmp_path / name)
    command, raw, *rest = words.format(map=tmp_path / "map.toml").split()
    signal.alarm(20)  # ends the tests, instead of waiting without end
    try:
        assert main([command, str(tmp_path / raw), *rest]) == 1
    finally:
        signal.alarm(0)
    assert f"{raw} is a device or a pipe, where a file is expected" in capsys.readouterr().err
    assert main(["import", str(tmp_path / "none.bag"), "--guess"]) == 1
    assert "can't read the bag" in capsys.readouterr().err
