"""What a run shows while it lasts: on a terminal (here a pseudo-terminal), in a pipe, with --quiet, and the time left."""

import io
import json
import os
import re
import subprocess
import sys
from argparse import Namespace
from pathlib import Path

import pytest
from small_scans import CUBE

from scan3d.cli import progress
from scan3d.cli.progress import Progress, duration
from scan3d.workflow import _Clock

SIZE = ["--slices", "3", "--sweeps", "4", "--samples", "8"]
# The command, which tells in a file what was imported when it first wrote to stderr.
CODE = """
import sys
write, (file, *arguments) = sys.stderr.write, sys.argv[1:]
def first(text):
    sys.stderr.write = write
    with open(file, "w") as out:
        print(*sys.modules, file=out)
    return write(text)
sys.stderr.write = first
from scan3d.cli import main
sys.exit(main(arguments))
"""
HEAVY = {"numpy", "scipy", "trimesh", "pyvista", "vtkmodules", "matplotlib"}


class Clock:
    """A clock that is set by hand."""

    def __init__(self, monkeypatch):
        self.now = 100.0
        monkeypatch.setattr(progress.time, "monotonic", lambda: self.now)


class Terminal(io.StringIO):
    def isatty(self):
        return True


def on_terminal(*arguments, code=None):
    """What a command writes to a terminal, and its exit code."""
    pty = pytest.importorskip("pty")
    ours, theirs = pty.openpty()
    start = [sys.executable, "-c", code] if code else [sys.executable, "-m", "scan3d"]
    environment = {**os.environ, "TERM": "xterm", "NO_COLOR": "1"}
    child = subprocess.Popen(
        [*start, *map(str, arguments)], stdin=theirs, stdout=theirs, stderr=theirs, env=environment
    )
    os.close(theirs)
    written = b""
    while True:
        try:
            data = os.read(ours, 65536)
        except OSError:  # on Linux, when the other end is closed
            break
        if not data:
            break
        written += data
    os.close(ours)
    return written.decode(), child.wait()


def frames(written):
    """The lines that were shown one after the other in one place, without their blanks."""
    return [frame.strip() for frame in re.split(r"\r(?!\n)", written.partition("\n")[0]) if frame.strip()]


@pytest.mark.slow
@pytest.mark.rendering  # without a renderer a sentence stands between the lines
def test_a_scan_on_a_terminal_shows_every_step(tmp_path):
    written, code = on_terminal("scan", CUBE, "--out", tmp_path / "out", *SIZE)
    assert code == 0
    *shown, heading = frames(written)
    assert shown[0] == "scan: starting"
    words = list(dict.fromkeys(re.sub(r"( \d+/\d+ slices)?(, .*)?$", "", frame) for frame in shown))
    assert words == [
        "scan: starting",
        "scan: reading",
        "scan: simulating",
        "scan: contacts and normals",
        "scan: agreement with the model",
        "scan: bounds",
        "scan: surface",
        "scan: certificate",
        "scan: comparison with the mesh",
        "scan: pictures and page",
        "scan: writing",
    ]
    assert "scan: simulating 3/3 slices" in [frame.partition(",")[0] for frame in shown]
    # the line is erased, and the result begins where it was
    assert re.search(r"\r +\r\d+ contacts of \d+ samples", written)
    assert re.match(r"\d+ contacts", heading)


@pytest.mark.parametrize("command", ["scan", "compare"])
def test_the_first_line_is_there_before_numerical_libraries(tmp_path, command):
    # the import of these takes seconds on a slow disk
    arguments = {
        "scan": ["scan", "nothing.stl", "--out", tmp_path / "out"],
        "compare": ["compare", CUBE, "nothing.stl"],
    }
    written, exit_code = on_terminal(tmp_path / "modules.txt", *arguments[command], code=CODE)
    assert exit_code == 1
    assert frames(written)[0] == f"{command}: starting"
    assert not set((tmp_path / "modules.txt").read_text().split()) & HEAVY
    # an error erases the line as well
    assert re.search(r"\r +\rscan3d: [^\r]*nothing\.stl[^\r]*\r\n$", written)


def test_the_test_above_sees_what_is_imported(tmp_path):
    on_terminal(tmp_path / "modules.txt", "compare", CUBE, "nothing.stl", code=f"import numpy\n{CODE}")
    assert "numpy" in (tmp_path / "modules.txt").read_text().split()


def test_quiet_is_quiet_on_a_terminal(tmp_path):
    written, code = on_terminal("simulate", CUBE, "--out", tmp_path / "log.csv", *SIZE, "--quiet")
    assert (written, code) == ("", 0)


def test_short_runs_leave_no_lines_in_a_pipe(tmp_path):
    command = [sys.executable, "-m", "scan3d", "simulate", CUBE, "--out", tmp_path / "log.csv", *SIZE]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stderr == ""


def test_long_runs_leave_few_lines_in_a_pipe(monkeypatch):
    clock, stream = Clock(monkeypatch), io.StringIO()
    monkeypatch.setattr(sys, "stderr", stream)
    monkeypatch.setattr(progress, "_AGAIN_S", 1e9)  # drawn by hand
    with Progress(Namespace(command="scan", quiet=False)) as shown:
        shown.expect("planar")
        count = shown.counter("slices")
        shown.step("load")
        clock.now += 1
        shown.step("simulate")
        for second in range(3600):
            clock.now += 1
            count(second + 1, 3600)
    lines = stream.getvalue().splitlines()
    assert len(lines) == 9  # after 10, 20, 40, ... 2560 seconds
    assert "\r" not in stream.getvalue()
    assert re.fullmatch(r"scan3d: simulating 9/3600 slices, 10 s so far", lines[0])
    assert re.fullmatch(r"scan3d: simulating \d+/3600 slices, \d+ %, \d+ h \d+ min left", lines[-1])


def test_every_step_has_words_and_a_share():
    assert set(progress._SHARES) == {"planar", "spatial"}
    for shares in progress._SHARES.values():
        assert set(shares) == set(progress._WORDS)
    told = []
    with _Clock(step=told.append)("bounds"):
        assert told == ["bounds"]


def test_the_steps_are_those_of_the_report(call, tmp_path, no_pictures):
    stdout = call("scan", CUBE, "--out", tmp_path, *SIZE, "--json")[1]
    assert set(json.loads(stdout)["timings_s"]) == set(progress._WORDS)


def shown_left(monkeypatch, factor=1.0):
    """The time left that is shown in the middle of each step of a run that keeps to the shares, and the true one."""
    clock = Clock(monkeypatch)
    shares = progress._SHARES["planar"]
    seconds = {name: 100 * share / sum(shares.values()) for name, share in shares.items()}
    left, begun = progress._TimeLeft(shares), clock.now
    for name, long in seconds.items():
        left.begin(name)
        clock.now += factor * long / 2
        yield str(left), 100 * factor - (clock.now - begun)
        clock.now += factor * long / 2


@pytest.mark.parametrize("factor", [1.0, 30.0])
def test_the_time_left_is_right_where_the_steps_have_their_shares(monkeypatch, factor):
    estimates = [(text, true) for text, true in shown_left(monkeypatch, factor) if text.endswith("left")]
    assert len(estimates) > 5
    for text, true in estimates:
        # to the second, whichever way a half is rounded
        assert text.rpartition("%, ")[2] in {f"{duration(max(true + half, 1))} left" for half in (-0.5, 0.0, 0.5)}


def test_a_step_that_takes_longer_has_no_estimate(monkeypatch):
    clock, left = Clock(monkeypatch), progress._TimeLeft({"load": 1, "surface": 1, "write": 2})
    left.begin("load")
    assert str(left) == ""
    clock.now += 3
    left.begin("surface")
    clock.now += 1
    assert str(left) == ", 33 %, 8 s left"
    clock.now += 9
    assert str(left) == ", 13 s so far"
    left.begin("write")
    assert str(left) == ", 50 %, 13 s left"
    # a run that comes back to a step is no less done than before
    clock.now += 6.5
    assert str(left) == ", 75 %, 6 s left"
    left.begin("surface")
    left.begin("write")
    assert str(left) == ", 75 %, 6 s left"


def test_parts_of_an_unknown_number_have_no_estimate(monkeypatch):
    clock = Clock(monkeypatch)
    monkeypatch.setattr(progress, "_AGAIN_S", 1e9)
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with Progress(Namespace(command="scan", quiet=False)) as shown:
        shown.expect("planar")
        shown.step("load")
        shown.step("simulate")
        clock.now += 30
        shown.counter("slices", estimated=False)(500, 1024)
    assert frames(terminal.getvalue())[-1] == "scan: simulating 500/1024 slices, 30 s so far"


def test_a_message_replaces_the_line_and_a_closed_stream_does_no_harm(monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with Progress(Namespace(command="scan", quiet=False)) as shown:
        shown.say("no pictures")
        assert re.search(r"\r +\rscan3d: no pictures\n$", terminal.getvalue())
        monkeypatch.setattr(sys, "stderr", io.StringIO())
        terminal.close()
        shown.tell("on")


def test_the_line_fits_a_narrow_terminal(monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(progress, "_columns", lambda _: 12)
    with Progress(Namespace(command="scan", quiet=False)) as shown:
        shown.tell("comparison with the mesh")
    assert max(map(len, frames(terminal.getvalue()))) == 11


@pytest.mark.slow
def test_a_batch_on_a_terminal_counts_its_runs(tmp_path):
    written, code = on_terminal("batch", CUBE, CUBE.with_name("gem.glb"), "--out", tmp_path / "study", *SIZE)
    assert code == 0
    *shown, result = frames(written)
    assert [shown[0], shown[-1]] == ["batch: starting", "batch: 2/2 runs, 0 s left"]
    assert re.match("2 runs: 2 done, 0 failed", result)


@pytest.mark.parametrize(
    ("seconds", "text"), [(12.3, "12 s"), (59.7, "1 min 0 s"), (200, "3 min 20 s"), (7500, "2 h 5 min")]
)
def test_durations(seconds, text):
    assert duration(seconds) == text


def test_make_test_says_how_long_it_takes():
    makefile = (Path(__file__).parents[1] / "Makefile").read_text(encoding="utf-8")
    assert re.search(r"^test:.*\n\t@echo .*minutes", makefile, flags=re.MULTILINE)
