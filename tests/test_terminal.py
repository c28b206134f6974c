"""What a terminal sees: tables and colour where they are welcome, examples under the help, completion, and how soon."""

import io
import re
import shlex
import subprocess
import sys
import time
from importlib.metadata import version
from pathlib import Path

import pytest

from scan3d import planning, settings, terminal, units
from scan3d.cli import _EXAMPLES, _VALUES, _parser, main
from scan3d.completion import SHELLS, script

CUBE = Path(__file__).parents[1] / "meshes" / "cube.stl"
COMMAND = Path(sys.executable).with_name("scan3d")
TEXT = """\
248222 contacts of 259840 samples
contact error      1.3e-13 mm at most (3.0e-15 rod lengths)
surface            support, 81920 faces, watertight
written to         out"""


class Stream(io.StringIO):
    """A terminal, or none, of an encoding."""

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
    assert terminal.table(TEXT, Stream(terminal=False), {"TERM": "xterm"}) == TEXT
    assert terminal.table(TEXT, Stream(), {"TERM": "dumb"}) == TEXT
    assert terminal.table(TEXT, None, {"TERM": "xterm"}) == TEXT


def test_a_terminal_gets_a_table_with_its_key_figures_bold(monkeypatch):
    monkeypatch.setattr(sys, "platform", "linux")
    table = terminal.table(TEXT, Stream(), {"TERM": "xterm"})
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
        ({"TERM": "xterm", "NO_COLOR": ""}, "linux", True),  # no-color.org: present and not empty
        ({"TERM": "xterm", "NO_COLOR": "1"}, "linux", False),
        ({}, "win32", False),
        ({"WT_SESSION": "1"}, "win32", True),
    ],
)
def test_no_colour_where_it_is_not_wanted(monkeypatch, environment, platform, colour):
    monkeypatch.setattr(sys, "platform", platform)
    table = terminal.table(TEXT, Stream(), environment)
    assert ("\x1b" in table) == colour
    assert "surface            │ support" in bare(table)


@pytest.mark.parametrize("encoding", ["ascii", None, "no such encoding"])
def test_a_terminal_that_knows_no_lines_gets_other_ones(encoding):
    table = bare(terminal.table(TEXT, Stream(encoding=encoding), {"TERM": "xterm"}))
    assert "surface            | support" in table
    assert table.splitlines()[1] == "-" * 61


def test_the_command_draws_a_table_on_a_terminal_only(tmp_path, monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    said = {}
    for terminal_ in (True, False):
        stream = Stream(terminal_)
        monkeypatch.setattr(sys, "stdout", stream)
        assert main(["compare", str(CUBE), str(CUBE)]) == 0
        said[terminal_] = stream.getvalue()
    assert "Hausdorff distance │ 0 mm" in bare(said[True])
    assert said[False].startswith("Hausdorff distance 0 mm")
    assert "\x1b" not in said[False]


def test_no_progress_on_a_teletype(tmp_path, monkeypatch):
    monkeypatch.setenv("TERM", "dumb")
    stream = Stream()
    monkeypatch.setattr(sys, "stderr", stream)
    few = ("--slices", "3", "--sweeps", "4", "--samples", "8")
    assert main(["simulate", str(CUBE), "--out", str(tmp_path / "log.csv"), *few]) == 0
    assert stream.getvalue() == ""


# --- help ---


def test_every_command_has_examples_that_run(capsys):
    choices = next(action for action in _parser()._actions if action.choices).choices
    assert set(_EXAMPLES) <= set(choices)
    for name, text in _EXAMPLES.items():
        with pytest.raises(SystemExit, match="0"):
            main([name, "--help"])
        said = capsys.readouterr().out
        assert said.endswith(f"examples:\n{text}\n")
        for line in text.splitlines():
            # as the shell takes it: without redirection, and what is inside of $(…)
            line = line.partition(" > ")[0].strip().removeprefix('eval "$(').removesuffix(')"')
            words = shlex.split(line)
            assert words[:2] == ["scan3d", name]
            assert _parser().parse_args(words[1:]).run


@pytest.mark.parametrize("arguments", [["--help"], ["export", "--help"], ["--version"], ["completion", "bash"]])
def test_help_comes_at_once(arguments):
    # the best of three: another process may be in the way
    took = []
    for _ in range(3):
        start = time.perf_counter()
        subprocess.run([COMMAND, *arguments], capture_output=True, check=True)
        took.append(time.perf_counter() - start)
    assert min(took) < 0.3


def test_the_package_runs_as_a_module():
    done = subprocess.run([sys.executable, "-m", "scan3d", "--version"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, version("scan3d") + "\n", "")
    done = subprocess.run([sys.executable, "-m", "scan3d", "peel"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("scan3d: argument COMMAND: invalid choice: 'peel'")


# --- completion ---


def test_the_shell_offers_what_the_settings_take():
    assert _VALUES["spacing"] == planning.SPACINGS
    assert _VALUES["standoff"] == planning.STANDOFFS
    assert _VALUES["unit"] == tuple(units.UNITS_M)
    assert _VALUES["method"] == settings.METHODS
    for axis in _VALUES["axis"]:
        settings.Settings(axis=axis).plan()


@pytest.fixture(scope="module")
def complete(tmp_path_factory):
    """What bash offers for words, the last of which is unfinished, in a folder with a file and a folder."""
    place = tmp_path_factory.mktemp("shell")
    (place / "bash").write_text(script(_parser(), "bash", _VALUES))
    (place / "work" / "my results").mkdir(parents=True)
    (place / "work" / "my part.stl").touch()

    def offered(*words):
        line = f"COMP_WORDS=({shlex.join(words)}); COMP_CWORD={len(words) - 1}; _scan3d"
        code = f"source {shlex.quote(str(place / 'bash'))}; {line}; printf '%s\\n' \"${{COMPREPLY[@]}}\""
        call = ["bash", "--norc", "-u", "-c", code]
        done = subprocess.run(call, cwd=place / "work", capture_output=True, text=True, check=True)
        assert done.stderr == ""
        return done.stdout.split("\n")[:-1]

    return offered


@pytest.mark.parametrize(
    ("words", "offers"),
    [
        (["scan3d", "sc"], ["scan"]),
        (["scan3d", "--v"], ["--version"]),
        (["scan3d", "scan", "--sp"], ["--spacing"]),
        (["scan3d", "scan", "x.stl", "--spacing", ""], ["cosine", "uniform", "adaptive"]),
        (["scan3d", "scan", "x.stl", "--spacing", "u"], ["uniform"]),
        (["scan3d", "scan", "--unit", "=", "u"], ["um"]),
        (["scan3d", "scan", "--unit", "="], list(units.UNITS_M)),
        (["scan3d", "scan", "--slices", ""], [""]),
        (["scan3d", "scan", "my"], ["my part.stl", "my results"]),
        (["scan3d", "scan", "x.stl", "--out", "my"], ["my results"]),
        (["scan3d", "export", "out", "--to", "my p"], ["my part.stl"]),
        (["scan3d", "export", "out", "--what", ""], ["surface", "cloud"]),
        (["scan3d", "completion", ""], list(SHELLS)),
        (["scan3d", "doctor", ""], [""]),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_bash_completes(complete, words, offers):
    assert sorted(complete(*words)) == sorted(offers)


def test_bash_offers_all_commands_and_all_options(complete):
    choices = next(action for action in _parser()._actions if action.choices).choices
    assert set(choices) <= set(complete("scan3d", ""))
    for name, parser in choices.items():
        assert complete("scan3d", name, "-") == [flag for a in parser._actions for flag in a.option_strings]


@pytest.mark.parametrize("shell", SHELLS)
def test_every_shell_gets_a_script_of_all_that_there_is(capsys, shell):
    assert main(["completion", shell]) == 0
    said, complained = capsys.readouterr()
    assert complained == ""
    assert said == script(_parser(), shell, _VALUES)
    choices = next(action for action in _parser()._actions if action.choices).choices
    for name, parser in choices.items():
        assert name in said
        for flag in (flag for action in parser._actions for flag in action.option_strings):
            option = f" -l {flag[2:]} " if flag.startswith("--") else f" -s {flag[1:]} "
            assert (option if shell == "fish" else flag) in said
    assert "cosine uniform adaptive" in said


def test_no_completion_for_other_shells(capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["completion", "tcsh"])
    assert "invalid choice: 'tcsh'" in capsys.readouterr().err
