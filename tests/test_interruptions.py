"""A run ends at once and in a sentence when it is interrupted or terminated, and no file of the current folder is executed."""

import contextlib
import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from small_scans import CUBE, EGG, FEW

import scan3d
from scan3d import workers
from scan3d.cli import main

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals are different there")
# Signals may be ignored in this process, as under nohup, and a child process would inherit that; what it prints states
# that it is ready.
_CODE = """
import faulthandler, signal, sys
faulthandler.enable()  # after a crash this test shows where
signal.signal(signal.SIGINT, signal.default_int_handler)
signal.signal(signal.SIGHUP, signal.SIG_DFL)
from scan3d.cli import main
print("ready", flush=True)
sys.exit(main())
"""


def start(*arguments, code=_CODE):
    command = [sys.executable, "-c", code, *map(str, arguments)]
    child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert child.stdout.readline() == "ready\n"
    return child


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "sentence"),
    [
        (signal.SIGINT, "interrupted"),
        (signal.SIGTERM, "terminated"),
        pytest.param(signal.SIGHUP, "terminated: its terminal was closed", marks=pytest.mark.trust),
    ],
)
def test_a_run_that_is_asked_to_end_says_so_and_leaves_nothing(tmp_path, number, sentence):
    child = start("scan", EGG, "--out", tmp_path / "new" / "out", "--slices", "20000", "--quiet")
    deadline = time.monotonic() + 60
    while not (tmp_path / "new" / "out").exists():  # it is created just before the simulation begins
        assert child.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.01)
    time.sleep(0.2)
    child.send_signal(number)
    stdout, stderr = child.communicate(timeout=60)
    assert (child.returncode, stdout, stderr) == (128 + number, "", f"scan3d: {sentence}\n")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.trust
@pytest.mark.parametrize("moment", [0.05 * k for k in range(1, 25)])
def test_ctrl_c_at_any_moment(tmp_path, moment):
    """Also while VTK is imported, which an exception would crash, and while trimesh is, which would swallow it."""
    child = start("scan", CUBE, "--out", tmp_path / "out", "--slices", "300", "--quiet")
    # without a sleep, a busy machine could deliver the signal before `main` is called
    time.sleep(moment)
    child.send_signal(signal.SIGINT)
    stdout, stderr = child.communicate(timeout=60)
    assert (child.returncode, stdout, stderr) == (130, "", "scan3d: interrupted\n")
    assert list(tmp_path.iterdir()) == []


# The scan waits for its end as soon as it has simulated.
_WAIT = "pipeline.analyse = lambda *_, **__: (print('simulated', flush=True), signal.pause())"
_WAITS = _CODE.replace("print(", f"from scan3d import pipeline\n{_WAIT}\nprint(", 1)


def ended(number, out):
    """What a scan that is ended after its simulation writes to stderr."""
    child = start("scan", CUBE, "--out", out, *FEW, "--method", "hull", code=_WAITS)
    assert child.stdout.readline() == "simulated\n"
    child.send_signal(number)
    return child.communicate(timeout=60)[1]


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_what_was_simulated_is_kept_and_one_goes_on_with_it(tmp_path, capsys, no_pictures, number):
    """Against the same scan without an end: the recording is the same, byte for byte."""
    whole, out = tmp_path / "whole", tmp_path / "an out"
    assert main(["scan", str(CUBE), "--out", str(whole), *FEW, "--method", "hull"]) == 0
    on = ["reconstruct", str(out / "recording.csv"), "--out", str(out), "--truth", str(CUBE), "--method", "hull"]
    said = f"scan3d: interrupted; the recording is kept: go on with scan3d {shlex.join(on)}\n"
    assert ended(number, out) == (said if number == signal.SIGINT else "")
    assert {path.name for path in out.glob("[!.]*")} == {"recording.csv", "recording.toml", "report.json"}
    for name in ("recording.csv", "recording.toml"):
        assert (out / name).read_bytes() == (whole / name).read_bytes()
    assert main(["export", str(out), "--to", str(tmp_path / "a.stl")]) == 1
    assert main(["show", str(out), "--html", str(tmp_path / "a.html")]) == 1
    assert capsys.readouterr().err.count(shlex.join(on)) == 2
    shutil.copytree(out, tmp_path / "kept", symlinks=True)
    for go_on in ([*on, "--quiet"], ["scan", str(CUBE), "--out", str(out), *FEW]):
        shutil.rmtree(out)
        shutil.copytree(tmp_path / "kept", out, symlinks=True)
        assert main(go_on) == 0
        assert scan3d.open(out).cloud.points.shape == scan3d.open(whole).cloud.points.shape


@pytest.mark.slow
def test_an_end_replaces_neither_a_result_nor_files_of_others(tmp_path, no_pictures):
    out = tmp_path / "out"
    assert main(["scan", str(CUBE), "--out", str(out), *FEW, "--seed", "7"]) == 0
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    assert ended(signal.SIGINT, out) == "scan3d: interrupted\n"
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    # what was kept counts as the program's own only as long as it is as it was written
    shutil.rmtree(out)
    ended(signal.SIGKILL, out)
    (out / "recording.csv").write_bytes(b"mine")
    assert main(["scan", str(CUBE), "--out", str(out), *FEW]) == 1
    assert (out / "recording.csv").read_bytes() == b"mine"


def test_libraries_can_not_catch_an_interruption(tmp_path):
    """Python reports exceptions of destructors and goes on, and libraries catch exceptions of all kinds."""
    code = f"""
import os, signal, sys, time
from scan3d.workers import end_on_signals, undone_if_ended
signal.signal(signal.SIGINT, signal.default_int_handler)
end_on_signals()
print("ready", flush=True)
with undone_if_ended(lambda: open({str(tmp_path / "undone")!r}, "w").close()):
    try:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(5)
    except:
        pass
    finally:
        open({str(tmp_path / "went on")!r}, "w").close()
"""
    stderr = start(code=code).communicate(timeout=60)[1]
    assert stderr == "scan3d: interrupted\n"
    assert [path.name for path in tmp_path.iterdir()] == ["undone"]


def test_what_is_over_is_not_undone():
    with contextlib.suppress(ZeroDivisionError), workers.undone_if_ended(pytest.fail):
        raise ZeroDivisionError
    assert workers._UNDONE == []


def test_ctrl_c_in_a_program_that_calls_main_is_a_code(tmp_path, monkeypatch, capsys):
    def interrupt(*_):
        raise KeyboardInterrupt

    before = [signal.getsignal(number) for number in workers._SIGNALS]
    monkeypatch.setattr("scan3d.simulation.scan.simulate", interrupt)
    assert main(["simulate", str(CUBE), "--out", str(tmp_path / "new" / "log.csv")]) == 130
    assert capsys.readouterr() == ("", "scan3d: interrupted\n")
    assert list(tmp_path.iterdir()) == []
    assert [signal.getsignal(number) for number in workers._SIGNALS] == before


@pytest.mark.rendering
@pytest.mark.slow
def test_files_of_the_current_folder_are_not_executed_and_no_backend_is_looked_for(tmp_path):
    """Neither by the command, nor by `python -m`, nor by their child processes, which compute and draw."""
    for name in ("numpy", "scipy", "trimesh", "pyvista", "vtkmodules", "matplotlib", "pickle", "planar", "cyclopts"):
        (tmp_path / f"{name}.py").write_text(f"open('executed-{name}', 'w'); raise SystemExit('executed')")
    home = str(Path(__file__).parents[1])
    path = os.pathsep.join([home, *filter(None, [os.environ.get("PYTHONPATH")])])
    environment = {**os.environ, "PYTHONPATH": path, "MPLBACKEND": "nonsense"}
    for command in (
        [Path(sys.executable).with_name("scan3d"), "batch", CUBE, "--out", "study", *FEW],
        [sys.executable, "-m", "scan3d", "compare", CUBE, CUBE],
    ):
        done = subprocess.run(
            list(map(str, command)), cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert (done.returncode, done.stderr) == (0, "")
    assert not list(tmp_path.glob("executed*"))
    assert (tmp_path / "study" / "cube" / "cloud.png").exists()
