"""The guide, `scan3d demo`, `scan3d explain`, and what is said of words that the command line does not know."""

import json
import re
from pathlib import Path

import pytest
from small_scans import CUBE, FEW

import scan3d
from scan3d.cli import guide
from scan3d.cli.parser import parser
from scan3d.summaries import summary

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


# --- the words of a report ---


@pytest.mark.parametrize(
    ("words", "first"),
    [
        ("Hausdorff distance", "Hausdorff distance (unit length)"),
        ("hausdorff", "Hausdorff distance (unit length)"),
        ("contact_error", "contact error (unit length)"),
        ("friction angle", "friction angle (symbol ζ = arctan μ, unit rad)"),
        ("height slope", "height slope (symbol ∂h/∂z)"),
        ("coverage", "coverage"),
    ],
)
def test_terms_are_explained(call, words, first):
    code, stdout, stderr = call("explain", *words.split())
    assert (code, stderr) == (0, "")
    assert stdout.splitlines()[0] == first
    assert stdout.splitlines()[1].startswith("  ")
    assert not re.search(r"[$\\{}`]", stdout)


def test_a_misspelt_term_is_guessed(call):
    assert call("explain", "covrage") == (
        1,
        "",
        f"scan3d: the glossary has no 'covrage'; did you mean coverage?; 'scan3d explain' lists its {len(guide.glossary())} "
        "terms\n",
    )
    assert "did you mean" not in call("explain", "xyzzy")[2]


def test_without_a_term_all_are_listed(call):
    stdout = call("explain")[1]
    assert all(term.name in stdout for term in guide.glossary())


def test_every_row_of_the_glossary_is_a_term():
    text = (ROOT / "scan3d" / "cli" / "glossary.md").read_text(encoding="utf-8")
    rows = [line for line in text.splitlines() if line.startswith("| ") and not line.startswith("| term ")]
    terms = guide.glossary()
    assert len(terms) == len(rows) > 100
    assert len({term.name for term in terms}) == len(terms)
    assert not any(re.search(r"[$\\{}`]", part) for term in terms for part in term)
    assert "glossary.md" in (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")


def test_every_section_of_a_report_and_every_row_of_its_summary_is_explained(call, tmp_path, no_pictures):
    assert call("scan", CUBE, "--out", tmp_path / "out", "--noise", "1e-4", *FEW)[0] == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text(encoding="utf-8"))
    words = [*report, *(name for name, _ in summary(report).rows)]
    assert len(words) > 20
    for word in words:
        assert guide.explain(word.removesuffix("_s").replace("sha256", "files")), word


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
