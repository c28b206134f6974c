"""Functions given what they do not expect: a sentence that says what was expected, and no result."""

import os
import signal
import subprocess
import sys
import tracemalloc
from pathlib import Path

import pytest

import scan3d
from scan3d import InputError, workers
from scan3d.cli import main
from tests.shapes import box

EGG = str(Path(__file__).parents[1] / "meshes" / "egg.stl")


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
