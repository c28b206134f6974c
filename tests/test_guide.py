"""The guide, `scan3d demo`, and what is said of words that the command line does not know."""

import json
import re
from pathlib import Path

import pytest
from small_scans import CUBE

import scan3d
from scan3d.cli import guide
from scan3d.cli.parser import parser

ROOT = Path(__file__).parents[1]


def test_the_program_alone_prints_a_short_guide(call):
    code, stdout, stderr = call()
    assert (code, stderr) == (0, "")
    assert len(stdout.splitlines()) <= 12
    assert max(map(len, stdout.splitlines())) <= 128
    commands = parser()._subparsers._group_actions[0].choices
    named = re.findall(r"^  scan3d ([a-z]+)", stdout, re.MULTILINE)
    assert "demo" in named
    assert set(named) <= set(commands)


# --- the demonstration ---


def test_the_demonstration_scans_its_body_and_says_what_to_open(call, tmp_path, monkeypatch, no_pictures):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(guide, "DEMO_SETTINGS", {"slices": 4, "sweeps": 4, "samples": 8})
    code, stdout, _ = call("demo")
    assert code == 0
    assert "written to         scan3d-demo\n" in stdout
    named = re.search(r"Open (\S+) in a browser", stdout)[1]
    assert Path(named) == Path("scan3d-demo/view.html")
    assert Path(named).is_file()
    assert scan3d.open("scan3d-demo").report["mesh"]["file"] == "demo.glb"
    code, stdout, _ = call("demo", "--out", "other", "--json")
    assert json.loads(stdout)["mesh"]["file"] == "demo.glb"
    assert "Open" not in call("demo", "--out", "other", "--quiet")[1]


def test_the_body_of_the_demonstration_is_one_of_the_meshes():
    assert guide.DEMO.read_bytes() == (ROOT / "meshes" / "gem.glb").read_bytes()


# --- misspelt words ---


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["scna", CUBE], r"invalid choice: 'scna' .*; did you mean scan\?; see 'scan3d --help'"),
        (["scan", CUBE, "--out", "o", "--frictoin", "3"], r"--frictoin 3; did you mean --friction\?; see 'scan3d scan --help'"),
        (["demo", "--ouut=x"], r"unrecognized arguments: --ouut=x; did you mean --out\?"),
        (["show", "o", "--view", "compar"], r"invalid choice: 'compar' .*; did you mean compare\?"),
        (["compare", CUBE, CUBE, "--unit", "furlong"], r"invalid choice: 'furlong' \(choose from [^;]*\); see"),
    ],
)  # fmt: skip
def test_what_was_probably_meant_is_named(call, arguments, sentence):
    code, stdout, stderr = call(*arguments)
    assert (code, stdout) == (2, "")
    assert re.search(sentence, stderr), stderr
    assert len(stderr.splitlines()) == 1


def test_a_misspelt_setting_or_name_in_python_is_named():
    with pytest.raises(scan3d.InputError, match=r"unknown setting frction; known are .*; did you mean friction\?"):
        scan3d.scan(CUBE, frction=0.2)
    with pytest.raises(AttributeError, match="module 'scan3d' has no attribute 'recontruct'") as raised:
        scan3d.recontruct  # noqa: B018
    # what Python's own "Did you mean" needs
    assert (raised.value.name, raised.value.obj) == ("recontruct", scan3d)
