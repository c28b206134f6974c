"""What a terminal sees: tables and colour where they are supported, examples under the help, and how soon."""

import io
import os
import re
import shlex
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

from scan3d.cli import main, terminal
from scan3d.cli.parser import _EXAMPLES, parser

CUBE = Path(__file__).parents[1] / "meshes" / "cube.stl"
COMMAND = Path(sys.executable).with_name("scan3d")
HEADING = "248222 contacts of 259840 samples"
ROWS = [
    ("contact error", "1.3e-13 mm at most (3.0e-15 rod lengths)"),
    ("surface", "support, 81920 faces, watertight"),
    ("written to", "out"),
]
TEXT = """\
248222 contacts of 259840 samples
contact error      1.3e-13 mm at most (3.0e-15 rod lengths)
surface            support, 81920 faces, watertight
written to         out"""


class Stream(io.StringIO):
    """A stream with an encoding, which is a terminal or not."""

    def __init__(self, terminal=True, encoding="utf-8"):
        super().__init__()
        self.terminal, self.name = terminal, encoding

    def isatty(self):
        return self.terminal

    @property
    def encoding(self):
        return self.name


def bare(text):
    return re.sub("\x1b\\[[0-9]*m", "", text)


def test_a_pipe_and_a_teletype_get_plain_text():
    assert terminal.table(HEADING, ROWS, Stream(terminal=False), {"TERM": "xterm"}) == TEXT
    assert terminal.table(HEADING, ROWS, Stream(), {"TERM": "dumb"}) == TEXT
    assert terminal.table(HEADING, ROWS, None, {"TERM": "xterm"}) == TEXT


def test_a_terminal_gets_a_table_with_its_key_figures_bold(monkeypatch):
    monkeypatch.setattr(sys, "platform", "linux")
    table = terminal.table(HEADING, ROWS, Stream(), {"TERM": "xterm"})
    assert bare(table).splitlines() == [
        "248222 contacts of 259840 samples",
        "─" * 61,
        "contact error      │ 1.3e-13 mm at most (3.0e-15 rod lengths)",
        "surface            │ support, 81920 faces, watertight",
        "written to         │ out",
    ]
    bold = re.findall("\x1b\\[1m(.*?)\x1b\\[0m", table)
    assert bold == ["248222 contacts of 259840 samples", "1.3e-13 mm at most", "support", "out"]
    assert table.endswith("\x1b[0m")


@pytest.mark.parametrize(
    ("environment", "platform", "colour"),
    [
        ({"TERM": "xterm"}, "linux", True),
        ({"TERM": "xterm", "NO_COLOR": ""}, "linux", True),  # no-color.org: only if present and not empty
        ({"TERM": "xterm", "NO_COLOR": "1"}, "linux", False),
        ({}, "win32", False),
        ({"WT_SESSION": "1"}, "win32", True),
    ],
)
def test_colour_only_where_it_is_supported_and_wanted(monkeypatch, environment, platform, colour):
    monkeypatch.setattr(sys, "platform", platform)
    table = terminal.table(HEADING, ROWS, Stream(), environment)
    assert ("\x1b" in table) == colour
    assert "surface            │ support" in bare(table)


@pytest.mark.parametrize("encoding", ["ascii", None, "no such encoding"])
def test_a_terminal_without_line_characters_gets_ascii(encoding):
    table = bare(terminal.table(HEADING, ROWS, Stream(encoding=encoding), {"TERM": "xterm"}))
    assert "surface            | support" in table
    assert table.splitlines()[1] == "-" * 61


def test_the_command_draws_a_table_on_a_terminal_only(tmp_path, monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    output = {}
    for terminal_ in (True, False):
        stream = Stream(terminal_)
        monkeypatch.setattr(sys, "stdout", stream)
        assert main(["compare", str(CUBE), str(CUBE)]) == 0
        output[terminal_] = stream.getvalue()
    assert "Hausdorff distance │ 0 mm" in bare(output[True])
    assert output[False].startswith("Hausdorff distance 0 mm")
    assert "\x1b" not in output[False]


def test_no_progress_on_a_teletype(tmp_path, monkeypatch):
    monkeypatch.setenv("TERM", "dumb")
    stream = Stream()
    monkeypatch.setattr(sys, "stderr", stream)
    few = ("--slices", "3", "--sweeps", "4", "--samples", "8")
    assert main(["simulate", str(CUBE), "--out", str(tmp_path / "log.csv"), *few]) == 0
    assert stream.getvalue() == ""


# --- help ---


def test_every_command_has_examples_that_run(capsys):
    choices = next(action for action in parser()._actions if action.choices).choices
    assert set(_EXAMPLES) <= set(choices)
    for name, text in _EXAMPLES.items():
        with pytest.raises(SystemExit, match="0"):
            main([name, "--help"])
        stdout = capsys.readouterr().out
        assert stdout.endswith(f"examples:\n{text}\n")
        for line in text.splitlines():
            # without what the shell removes: the redirection, and $(…) around the command
            line = line.partition(" > ")[0].strip().removeprefix('eval "$(').removesuffix(')"')
            words = shlex.split(line)
            assert words[:2] == ["scan3d", name]
            assert parser().parse_args(words[1:]).command == name


@pytest.mark.parametrize("arguments", [["--help"], ["export", "--help"], ["--version"], ["completion", "bash"]])
def test_help_is_quick(arguments):
    def seconds(command):
        """Of the processor, because tests run side by side and wait for each other; the best of three."""
        taken = []
        for _ in range(3):
            before = os.times()
            subprocess.run(command, capture_output=True, check=True)
            after = os.times()
            taken.append(sum(after[2:4]) - sum(before[2:4]))  # of child processes, in user and in system mode
        return min(taken)

    # a command that computes imports these and as much again
    assert 0 < seconds([COMMAND, *arguments]) < seconds([sys.executable, "-c", "import numpy, scipy.spatial"])


def test_the_package_runs_as_a_module():
    done = subprocess.run([sys.executable, "-m", "scan3d", "--version"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, version("scan3d") + "\n", "")
    done = subprocess.run([sys.executable, "-m", "scan3d", "peel"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("scan3d: argument COMMAND: invalid choice: 'peel'")
