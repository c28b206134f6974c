"""What a terminal sees: bold key figures where they are supported, and the progress of a run; and what a pipe sees."""

import ast
import functools
import io
import json
import re
import sys
import time
from pathlib import Path

import pytest
from small_scans import CUBE

import scan3d
from scan3d.cli import main, terminal
from scan3d.cli.commands import run
from scan3d.cli.terminal import Progress
from scan3d.workers import heard

SIZE = ["--slices", "3", "--sweeps", "4", "--samples", "8"]
HEADING = "248222 contacts of 259840 samples"
ROWS = [("contact error", "1.3e-13 mm at most (3.0e-15 rod lengths)"), ("written to", "out")]
TEXT = f"""\
{HEADING}
contact error      1.3e-13 mm at most (3.0e-15 rod lengths)
written to         out"""


class Stream(io.StringIO):
    def __init__(self, is_terminal=True):
        super().__init__()
        self.is_terminal = is_terminal

    def isatty(self):
        return self.is_terminal


@pytest.mark.parametrize(
    ("is_terminal", "environment", "platform", "bold"),
    [
        (True, {"TERM": "xterm"}, "linux", True),
        (True, {"TERM": "xterm", "NO_COLOR": ""}, "linux", True),  # no-color.org: only if present and not empty
        (True, {"TERM": "xterm", "NO_COLOR": "1"}, "linux", False),
        (True, {"TERM": "dumb"}, "linux", False),
        (False, {"TERM": "xterm"}, "linux", False),
        (True, {}, "win32", False),
        (True, {"WT_SESSION": "1"}, "win32", True),
    ],
)
def test_key_figures_are_bold_only_where_that_is_supported_and_wanted(
    monkeypatch, is_terminal, environment, platform, bold
):
    monkeypatch.setattr(terminal.os, "environ", environment)
    monkeypatch.setattr(sys, "platform", platform)
    monkeypatch.setattr(sys, "stdout", Stream(is_terminal))
    table = terminal.table(HEADING, ROWS)
    assert re.sub("\x1b\\[[0-9]*m", "", table) == TEXT
    found = re.findall("\x1b\\[1m(.*?)\x1b\\[0m", table)
    assert found == ([HEADING, "1.3e-13 mm at most", "out"] if bold else [])


def shown(monkeypatch, *arguments, stream=None):
    stream = Stream() if stream is None else stream
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys, "stderr", stream)
    code = main([str(argument) for argument in arguments])
    return code, re.sub("\x1b\\[[0-9?]*[a-zA-Z]", "", stream.getvalue())


def test_what_is_told_of_a_scan_is_its_steps_and_counts_that_grow_to_their_totals(tmp_path, no_pictures):
    told = []
    with heard(lambda *of: told.append(of)):
        result = scan3d.scan(CUBE, tmp_path, slices=3, sweeps=4, samples=8)
    steps = [words for words, _, total in told if not total]
    assert {*steps} == {*result.report["timings_s"]}  # the recording is written before all else
    counted = [(done, total) for words, done, total in told if words == "slices"]
    assert counted == sorted(counted)
    assert counted[-1] == (3, 3)


def test_a_terminal_sees_what_is_done_and_how_far_it_is(monkeypatch, tmp_path, no_pictures):
    code, written = shown(monkeypatch, "scan", CUBE, "--out", tmp_path / "out", *SIZE)
    assert code == 0
    assert re.match(r"scan: [\d.]+ s: starting", written.lstrip())


def test_a_line_says_how_far_a_step_is_and_how_long_it_will_take(monkeypatch):
    now = 100.0
    monkeypatch.setattr(terminal.time, "monotonic", lambda: now)
    progress = Progress("scan", quiet=True)
    progress.tell("simulate")
    for now, told, line in (  # noqa: B007 - the clock reads it
        (110.0, ("slices", 0, 8), "10 s: simulating, 0 of 8 slices"),
        (130.0, ("slices", 2, 8), "30 s: simulating, 2 of 8 slices, about 1 min 0 s left of this"),
        (150.0, ("slices", 8, 8), "50 s: simulating, 8 of 8 slices"),
        # what follows is counted anew, and what was done before does not count for its pace
        (150.0, ("planes", 16, 64), "50 s: simulating, 16 of 64 planes"),
        (160.0, ("planes", 40, 64), "1 min 0 s: simulating, 40 of 64 planes, about 10 s left of this"),
        (170.0, ("surface",), "1 min 10 s: surface"),
    ):
        progress.tell(*told)
        assert progress.line() == line


def test_without_a_terminal_there_is_a_line_every_so_many_seconds_also_while_nothing_is_told(monkeypatch):
    monkeypatch.setattr(terminal, "EVERY_S", 0.05)
    monkeypatch.setattr(sys, "stderr", stream := Stream(False))
    with Progress("scan", quiet=False) as progress:
        progress.tell("surface")
        deadline = time.monotonic() + 20
        while stream.getvalue().count("s: surface") < 3 and time.monotonic() < deadline:
            time.sleep(0.01)
    assert stream.getvalue().count("s: surface") >= 3


def test_nothing_is_shown_on_a_teletype_in_a_pipe_or_with_quiet(monkeypatch, tmp_path):
    simulate = ["simulate", CUBE, "--out", tmp_path / "log.csv", *SIZE]
    assert shown(monkeypatch, *simulate, stream=Stream(False)) == (0, "")
    assert shown(monkeypatch, *simulate, "--quiet") == (0, "")
    monkeypatch.setenv("TERM", "dumb")
    monkeypatch.setattr(sys, "stderr", stream := Stream())
    assert main([str(word) for word in simulate]) == 0
    assert stream.getvalue() == ""


def test_without_a_terminal_each_step_is_one_line_with_the_time_once_a_run_has_lasted_a_second(monkeypatch):
    now = 100.0
    monkeypatch.setattr(terminal.time, "monotonic", lambda: now)
    monkeypatch.setattr(sys, "stderr", stream := Stream(False))
    with Progress("scan", quiet=False) as progress:
        for name in terminal._STEPS:
            assert bool(stream.getvalue()) == (now > 101.3)
            progress.tell(name)
            now += 0.4
    lines = stream.getvalue().splitlines()
    assert lines == [f"scan3d: {0.4 * k:.1f} s: {words}" for k, words in enumerate(terminal._STEPS.values())]


@functools.cache
def signs():
    """The characters beyond ASCII in the texts of the program, without docstrings, pictures, and what terminals obey."""
    found = {*"µμ³²±°×"}
    for path in Path(scan3d.__file__).parent.rglob("*.py"):
        if path.parent.name == "pictures":
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        notes = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
        texts = (node for node in ast.walk(tree) if isinstance(node, ast.Constant) and isinstance(node.value, str))
        text = "".join(node.value for node in texts if id(node) not in notes)
        found |= {sign for sign in set(text) if not sign.isascii() and terminal.printable(sign) == sign}
    return "".join(sorted(found))


@pytest.mark.slow
@pytest.mark.parametrize("encoding", ["ascii", "gbk", "cp932", "cp949", "cp437", "latin-1", "utf-8"])
def test_every_sign_is_legible_in_every_encoding(monkeypatch, encoding):
    """Against the encodings' own tables: a sign is printed as it is, or spelled in letters, never as a question mark."""
    printed = {name: io.TextIOWrapper(io.BytesIO(), encoding=encoding) for name in ("stdout", "stderr")}
    for name, stream in printed.items():
        monkeypatch.setattr(sys, name, stream)
    used = signs()
    monkeypatch.setattr("scan3d.cli.commands.GUIDE", f"{used}|Würfel 中 😀")
    assert run([]) == 0
    terminal.say(used)
    for stream in printed.values():
        stream.flush()
    shown, said = (stream.buffer.getvalue().decode(encoding) for stream in printed.values())
    assert said == f"scan3d: {shown[: shown.index('|')]}\n"
    assert not {"?", "\\", "\N{REPLACEMENT CHARACTER}"} & {*said}
    assert json.loads(f'"{shown}"')[-1] == "😀"  # a file's name in JSON
    if encoding == "gbk":
        assert "682 µm, 2,200 mm³".encode("gbk", terminal.SPELLED) == b"682 um, 2,200 mm3"
