"""Completion scripts: bash is run, and the scripts of all shells name every command and option."""

import shlex
import subprocess

import pytest

from scan3d import choices, units
from scan3d.choices import SHELLS
from scan3d.cli import main
from scan3d.cli.completion import script
from scan3d.cli.parser import VALUES, parser
from scan3d.settings import Settings


def test_the_shell_offers_the_values_of_the_settings():
    assert VALUES["spacing"] == choices.SPACINGS
    assert VALUES["unit"] == tuple(units.UNITS_M)
    assert VALUES["method"] == choices.METHODS
    for axis in VALUES["axis"]:
        Settings(axis=axis).plan()


@pytest.fixture(scope="module")
def complete(tmp_path_factory):
    """A function that returns the completions of bash for the last word, in a folder that contains a file and a folder."""
    place = tmp_path_factory.mktemp("shell")
    (place / "bash").write_text(script(parser(), "bash", VALUES))
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
    commands = next(action for action in parser()._actions if action.choices).choices
    assert set(commands) <= set(complete("scan3d", ""))
    for name, command in commands.items():
        assert complete("scan3d", name, "-") == [flag for a in command._actions for flag in a.option_strings]


@pytest.mark.parametrize("shell", SHELLS)
def test_every_shell_gets_a_script_of_all_commands_and_options(capsys, shell):
    assert main(["completion", shell]) == 0
    stdout, stderr = capsys.readouterr()
    assert stderr == ""
    assert stdout == script(parser(), shell, VALUES)
    commands = next(action for action in parser()._actions if action.choices).choices
    for name, command in commands.items():
        assert name in stdout
        for flag in (flag for action in command._actions for flag in action.option_strings):
            option = f" -l {flag[2:]} " if flag.startswith("--") else f" -s {flag[1:]} "
            assert (option if shell == "fish" else flag) in stdout
    assert "adaptive cosine uniform" in stdout


def test_no_completion_for_other_shells(capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["completion", "tcsh"])
    assert "invalid choice: 'tcsh'" in capsys.readouterr().err
