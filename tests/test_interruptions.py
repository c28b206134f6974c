"""A run ends at once and in a sentence when it is interrupted, terminated, or when its renderer crashes."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from small_scans import CUBE, FEW

from scan3d.cli import interruptions, main
from scan3d.cli.interruptions import Interruptions, Terminated

pytestmark = pytest.mark.skipif(os.name == "nt", reason="signals are different there")
# The seconds after its beginning at which a run is interrupted: while it imports, computes and writes.
MOMENTS = [0.08, 0.16, 0.24, 0.32, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.2]
# Signals may be ignored in this process, as under nohup, and a child process would inherit that; what it prints states
# that it is ready.
_CODE = """
import faulthandler, signal, sys
faulthandler.enable()  # after a crash this test shows where
signal.signal(signal.SIGINT, signal.default_int_handler)
if hasattr(signal, "SIGHUP"):
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
from scan3d.cli import main
print("ready", flush=True)
sys.exit(main())
"""


def start(*arguments, **options):
    command = [sys.executable, "-c", _CODE, *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)


@pytest.mark.parametrize(
    "moment",
    [
        pytest.param(moment, marks=pytest.mark.trust if number % 2 else pytest.mark.slow)
        for number, moment in enumerate(MOMENTS)
    ],
)
def test_ctrl_c_at_any_moment(tmp_path, moment):
    """An exception while VTK is imported would end in a crash, and trimesh would swallow it."""
    child = start("scan", CUBE, "--out", tmp_path / "out", "--slices", "300", "--quiet")
    assert child.stdout.readline() == "ready\n"
    # without the shortest sleep, a busy machine could deliver the signal before `main` is called
    time.sleep(moment - MOMENTS[0] + 0.05)
    child.send_signal(signal.SIGINT)
    stdout, stderr = child.communicate(timeout=60)
    assert (child.returncode, stdout, stderr) == (130, "", "scan3d: interrupted\n")
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_before_the_signals_are_handled(monkeypatch, capfd):
    def interrupt(number):
        raise KeyboardInterrupt

    monkeypatch.setattr(signal, "getsignal", interrupt)
    assert main(["scan", str(CUBE)]) == 130
    assert capfd.readouterr() == ("", "scan3d: interrupted\n")


@pytest.mark.parametrize(
    ("number", "sentence"),
    [(signal.SIGTERM, "terminated"), (getattr(signal, "SIGHUP", None), "terminated: its terminal was closed")],
)
def test_a_run_that_is_asked_to_end_cleans_up(tmp_path, number, sentence):
    child = start("scan", CUBE, "--out", tmp_path / "out", "--slices", "4000", "--quiet")
    deadline = time.monotonic() + 60
    while not (tmp_path / "out").exists():
        assert child.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.01)
    time.sleep(0.2)
    child.send_signal(number)
    stdout, stderr = child.communicate(timeout=60)
    assert (child.returncode, stdout, stderr) == (128 + number, "ready\n", f"scan3d: {sentence}\n")
    assert list(tmp_path.iterdir()) == []


def test_the_signals_are_as_before_afterwards(capsys):
    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]
    with Interruptions(ends_process=False) as context:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(5)
    assert context.code == 143
    assert capsys.readouterr().err == "scan3d: terminated\n"
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)] == before


def test_an_import_is_not_interrupted(tmp_path, monkeypatch, capsys):
    """It goes on, and the run is interrupted directly after it."""
    (tmp_path / "slowly_imported.py").write_text(
        "import os, signal, time\nos.kill(os.getpid(), signal.SIGTERM)\ntime.sleep(0.2)\ncomplete = True\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    with Interruptions(ends_process=False) as context:
        import slowly_imported

        time.sleep(5)
        pytest.fail("it was not interrupted")
    assert slowly_imported.complete
    assert context.code == 143
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
    capsys.readouterr()


def test_an_interruption_that_is_caught_is_repeated(monkeypatch, capsys):
    """Python reports exceptions of destructors and of callbacks, and goes on; libraries catch exceptions of all kinds."""
    monkeypatch.setattr(interruptions, "_TRIALS", 0)
    monkeypatch.setattr(interruptions, "_CAUGHT_S", 0.1)

    class Destroyed:
        def __del__(self):
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(0.05)

    for caught in (True, False):
        with Interruptions(ends_process=False) as context:
            try:
                if caught:
                    os.kill(os.getpid(), signal.SIGTERM)
                    time.sleep(5)
                else:
                    Destroyed()
            except:  # noqa: E722
                assert caught
            time.sleep(5)
            pytest.fail("it was not interrupted")
        assert context.code == 143
        assert capsys.readouterr().err == "scan3d: terminated\n"


def test_a_run_that_is_completed_though_it_was_interrupted_ends_at_once():
    """A library that caught the interruption may crash when Python ends it."""
    code = """
import atexit, os, signal
from scan3d.cli.interruptions import Interruptions
atexit.register(os.abort)
with Interruptions(ends_process=True) as context:
    try:
        os.kill(os.getpid(), signal.SIGTERM)
        while True:
            pass
    except BaseException:
        pass
    print("complete")
    context.code = 3
"""
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (3, "complete\n", "")


def test_the_code_of_a_library_is_not_interrupted(monkeypatch, capsys):
    """Unless it takes long."""
    monkeypatch.setattr(interruptions, "_TRIALS", 30)
    begin = time.monotonic()
    with Interruptions(ends_process=False) as context:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(5)
    assert context.code == 143
    assert 0.2 < time.monotonic() - begin < 4
    capsys.readouterr()


def test_errors_of_other_kinds_pass():
    with pytest.raises(ZeroDivisionError), Interruptions(ends_process=False):
        raise ZeroDivisionError
    with pytest.raises(SystemExit), Interruptions(ends_process=False):
        sys.exit(2)
    # a library that was interrupted may raise an error of its own instead
    with Interruptions(ends_process=False) as context:
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(5)
        except Terminated:
            raise ImportError("cannot import name") from None
    assert context.code == 143


@pytest.mark.parametrize(
    "runs",
    [
        pytest.param([("scan3d", "scan"), ("-m", "doctor")], marks=pytest.mark.slow, id="each once"),
        pytest.param([("scan3d", "doctor"), ("-m", "scan")], marks=pytest.mark.trust, id="the other way round"),
    ],
)
def test_files_of_the_current_folder_are_not_executed(tmp_path, runs):
    """Neither by the command, nor by `python -m`, nor by their child processes."""
    for name in ("numpy", "scipy", "trimesh", "pyvista", "vtkmodules", "matplotlib", "pickle", "planar"):
        (tmp_path / f"{name}.py").write_text(f"open('executed-{name}', 'w'); raise SystemExit('executed')")
    home = str(Path(__file__).parents[1])
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([home, *filter(None, [os.environ.get("PYTHONPATH")])])}
    programs = {"scan3d": [Path(sys.executable).with_name("scan3d")], "-m": [sys.executable, "-m", "scan3d"]}
    commands = {"scan": ["scan", CUBE, "--out", "out", *FEW], "doctor": ["doctor", "--quiet"]}
    for program, command in runs:
        done = subprocess.run(
            [*programs[program], *map(str, commands[command])],
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
    assert not list(tmp_path.glob("executed*"))


@pytest.mark.rendering
@pytest.mark.slow
def test_a_backend_that_does_not_exist_does_no_harm(tmp_path):
    environment = {**os.environ, "MPLBACKEND": "nonsense"}
    code = "import sys; from scan3d.cli import main; sys.exit(main())"

    def run(*arguments):
        command = [sys.executable, "-c", code, *map(str, arguments)]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")

    run("scan", CUBE, "--out", tmp_path / "out", *FEW)
    assert (tmp_path / "out" / "cloud.png").exists()
    run(
        "show",
        tmp_path / "out",
        "--screenshot",
        tmp_path / "a.png",
        "--movie",
        tmp_path / "a.gif",
        "--html",
        tmp_path / "a.html",
    )


def test_an_interruption_that_a_library_has_caught_is_raised_at_the_next_check():
    interruptions.check()  # outside of a run nothing is raised
    with interruptions.Interruptions(ends_process=False) as run:
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        interruptions.check()
        pytest.fail("no interruption was raised")
    assert run.code == 130
    interruptions.check()
