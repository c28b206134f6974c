"""README and the pages in docs/: their code runs, the files and commands they name exist, and they cover the public names.

`make docs` builds the pages with Sphinx, with warnings as errors, and checks the links among them.
"""

import json
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import matplotlib
import pytest
from small_scans import SETTINGS

import planar
import scan3d
from scan3d import workers
from scan3d.choices import METHODS
from scan3d.cli import main, verbs
from scan3d.cli.commands import COMMANDS
from scan3d.files.recordings import COLUMNS
from scan3d.pictures import canvas, drawing
from tests.robustness.runner import Threads

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted(page for page in (ROOT / "docs").rglob("*.md") if "_build" not in page.parts)]
# Pages whose commands and code are run together, from top to bottom, up to this heading.
WALKED = [ROOT / "docs" / name for name in ("start.md", "recipes.md", "rig.md")]
LAST = "\n## Poses for an unknown body\n"
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


def blocks(text: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", text, flags=re.MULTILINE | re.DOTALL)


CODE = [page for page in PAGES if blocks(page.read_text("utf-8"), "python")]


def prose(text: str) -> str:
    return re.sub(r"`[^`\n]*`", "", re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL))


def targets(text: str) -> list[str]:
    """The files of the repository to which the links and pictures of a page refer, without anchors."""
    links = re.findall(r"\]\(([^)\s]+)\)", prose(text))
    links += re.findall(r"""(?:href|src)=["']([^"']+)["']""", prose(text))
    links += re.findall(r"^```\{literalinclude\} (\S+)$", text, flags=re.MULTILINE)
    return [path for path in (target.partition("#")[0] for target in links if "://" not in target) if path]


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with links to the files of the repository, into which code may write without changing the repository."""
    for path in ROOT.iterdir():
        if not path.name.startswith(".") and path.name != "out":
            (tmp_path / path.name).symlink_to(path)
    monkeypatch.chdir(tmp_path)
    matplotlib.use("Agg")
    return tmp_path


def fewer(text: str) -> str:
    """The code or command with fewer slices, samples and facets: a page's scans take a moment, and show the same."""
    text = text.replace('"slices": [4, 8, 16]', '"slices": [4]').replace('"slices": [4, 8]', '"slices": [4]')
    text = re.sub(r"\bsamples=\d\d", "samples=12", re.sub(r"icosphere\((subdivisions=)?\d", r"icosphere(\g<1>3", text))
    for much, little in (("--dpi 600", "--dpi 100"), ("--samples 64", "--samples 16"), ("--slices 8", "--slices 6"),
                         ("rate_hz = 100", "rate_hz = 30"), ("--speed 200", "--speed 600")):  # fmt: skip
        text = text.replace(much, little)
    text = re.sub(r"\bslices([ =])\d\d", r"slices\g<1>6", text)
    text = re.sub(r"\bslices=(\d+)(?!.*samples)", r"slices=\1, samples=16", text)
    return re.sub(
        r"^scan3d (scan|batch) (?!.*--samples|.*--config)",
        r"scan3d \1 --samples 16 --sweeps 6 ",
        text,
        flags=re.MULTILINE,
    )


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """The demonstration has few slices, no scan draws, and batches and pictures need no process: other tests show these."""
    monkeypatch.setattr(verbs, "DEMO_SETTINGS", SETTINGS)
    monkeypatch.setattr(workers, "Workers", Threads)
    monkeypatch.setattr(canvas, "can_render", lambda *_: False)
    monkeypatch.setattr(drawing, "draw", drawing._pictures)


@pytest.mark.slow
def test_the_code_of_all_pages_is_right_for_a_strict_type_checker(tmp_path: Path) -> None:
    """Against mypy: the blocks of a page together, as they run, those of the README one by one."""
    for page in CODE:
        found = blocks(page.read_text(encoding="utf-8"), "python")
        for number, code in enumerate(found if page.name == "README.md" else ["\n".join(found)]):
            (tmp_path / f"{page.stem}_{number}.py").write_text(code, encoding="utf-8")
    # strict by pyproject.toml; `make lint` looks into the functions of the packages, whose types are what counts here
    command = [sys.executable, "-m", "mypy", "--follow-imports=silent", "--cache-dir=.mypy_cache/pages"]
    command += map(str, tmp_path.iterdir())
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, ""), done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in CODE if page not in WALKED], ids=name_of)
def test_the_code_of_a_page_runs(page: Path, repository: Path, quick: None, capsys: pytest.CaptureFixture[str]) -> None:
    """In the order of the page, with the same variables; every block of the README by itself."""
    names: dict[str, object] = {"__name__": "__main__"}
    for number, block in enumerate(blocks(page.read_text(encoding="utf-8"), "python"), start=1):
        own = {"__name__": "__main__"} if page.name == "README.md" else names
        exec(compile(fewer(block), f"{name_of(page)}, block {number}", "exec"), own)
    # the snippets of the README print numbers
    assert page.name != "README.md" or re.search(r"\d", capsys.readouterr().out)


@pytest.mark.rendering
@pytest.mark.slow
@pytest.mark.parametrize("page", WALKED, ids=name_of)
def test_every_command_and_all_code_of_a_page_runs(
    page: Path, repository: Path, quick: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    names: dict[str, object] = {"__name__": "__main__"}
    text, bounds = page.read_text("utf-8").partition(LAST)[0], []
    for language, block in re.findall(r"^```(\w+)\n(.*?)^```$", text, flags=re.MULTILINE | re.DOTALL):
        if language == "python":
            exec(compile(fewer(block), name_of(page), "exec"), names)
        elif language == "toml":
            file = Path(block.partition("\n")[0].removeprefix("# "))
            # as a user completes the map that `--guess` has written
            guessed = file.read_text(encoding="utf-8").partition("[rod]")[0] if file.exists() else ""
            table, rod, values = fewer(block).partition("[rod]")
            file.write_text(table + guessed + rod + values, encoding="utf-8")
        elif language == "sh":
            for line in fewer(block).splitlines():
                command, _, comment = line.partition("    # ")
                words = shlex.split(command)
                assert words[0] == "scan3d"
                monkeypatch.setattr(canvas, "can_render", lambda *_, shown=words[1] == "show": shown)
                assert main(words[1:]) == (1 if comment == "refused" else 0), line
                if words[1] == "reconstruct":
                    report = Path(words[words.index("--out") + 1], "report.json").read_text(encoding="utf-8")
                    bounds.append(json.loads(report)["certificate"]["bound"])
    # with the bound that is promised, from touch alone
    assert "certified" in capsys.readouterr().out
    if page.name == "rig.md":
        # the bound shrinks with further sweeps; between what was probed nothing is bounded
        assert len(bounds) == 3
        assert bounds[1] < 0.8 * bounds[0]
        assert bounds[2] is None


def test_the_readme_is_short_and_begins_with_a_moving_picture_and_the_installation() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.split()) <= 700
    assert max(map(len, text.splitlines())) <= 120
    first = text.partition("\n## ")[0]
    assert ".gif)" in first
    assert "pip install . && scan3d demo" in first


@pytest.mark.slow
def test_the_readme_shows_what_the_demonstration_prints(
    tmp_path: Path, all_samples: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(canvas, "can_render", lambda *_: False)
    monkeypatch.chdir(tmp_path)
    assert main(["demo"]) == 0
    (shown,) = blocks((ROOT / "README.md").read_text(encoding="utf-8"), "text")
    assert set(shown.splitlines()) <= set(capsys.readouterr().out.splitlines())


@pytest.mark.trust
def test_the_readme_has_the_exactness_that_scans_print(
    tmp_path: Path, all_samples: None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(canvas, "can_render", lambda *_: False)
    rows = re.findall(r"^\| (\w+\.\w+) \| (.+?) \| (.+?) \|$", (ROOT / "README.md").read_text("utf-8"), re.MULTILINE)
    assert len(rows) == 3
    for name, distance, bound in rows:
        assert main(["scan", str(ROOT / "meshes" / name), "--out", str(tmp_path / name)]) == 0
        printed = capsys.readouterr().out
        assert f"Hausdorff distance {distance} (" in printed
        assert f"within {bound} (" in printed


def test_the_glossary_knows_the_words_that_a_report_prints() -> None:
    """The labels of the summary, and the methods of surfaces: what is asked when a word of it is not known."""
    text = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
    terms = [row.split("|")[1].strip() for row in text.split("\n") if row.startswith("| ")]
    known = {part.strip() + plural for term in terms for part in term.split(",") for plural in ("", "s", "es")}
    labels = {*re.findall(r'yield "(.+?)", ', (ROOT / "scan3d" / "report.py").read_text("utf-8")), "written to"}
    assert {"friction", "surface", "volume", "certified", "assumed", "scanned"} <= labels
    assert sorted({*labels, *METHODS} - known) == []


def test_every_extra_is_described() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    page = (ROOT / "docs" / "start.md").read_text(encoding="utf-8")
    rows = "\n".join(row.split("|")[1] for row in page.split("\n") if row.startswith("| `"))
    assert set(re.findall(r"`(\w+)`", rows)) == set(project["optional-dependencies"])


def test_links_and_pictures_are_there() -> None:
    for page in PAGES:
        missing = [name for name in targets(page.read_text(encoding="utf-8")) if not (page.parent / name).is_file()]
        assert missing == [], page


def test_scripts_and_commands_that_are_named_exist() -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for script in re.findall(r"python ((?:\w+/)+\w+\.py)", text):
            assert (ROOT / script).is_file(), script
        for target in re.findall(r"^(?:.*`)?make (\w+)", text, flags=re.MULTILINE):
            assert re.search(rf"^{target}:", makefile, flags=re.MULTILINE), target
        for command in re.findall(r"\bscan3d ([a-z]+)\b", "\n".join(blocks(text, "sh"))):
            assert command in COMMANDS, command


def test_every_public_name_is_in_the_api() -> None:
    for package in (planar, scan3d):
        page = (ROOT / "docs" / "api" / f"{package.__name__}.md").read_text(encoding="utf-8")
        described = set(re.findall(rf"^\.\. auto\w+:: {package.__name__}\.(\w+)$", page, flags=re.MULTILINE))
        assert set(package.__all__) <= described & {*dir(package)}


def test_every_example_is_in_the_gallery() -> None:
    gallery = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    for section, script in zip(
        gallery.split("\n## ")[1:], sorted(EXAMPLES, key=lambda script: gallery.index(script.name)), strict=True
    ):
        assert section.partition("\n")[0].endswith("?")
        assert f"literalinclude}} ../examples/{script.name}" in section
        # the section has a picture, unless the script prints a table
        assert (f"(pictures/{script.stem}.png)" in section) == ("savefig" in script.read_text(encoding="utf-8"))


def test_the_sidecar_in_the_pages_makes_a_recording(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "files.md").read_text(encoding="utf-8")
    (block,) = blocks(page, "toml")
    assert tomllib.loads(block)["rod"]["length_m"] == 0.05
    columns = re.findall(r"`(\w+)`", "\n".join(row.split("|")[1] for row in page.split("\n") if row.startswith("| `")))
    header = [name for name in columns if name in COLUMNS]
    assert tuple(header) == COLUMNS
    (tmp_path / "log.toml").write_text(block, encoding="utf-8")
    (tmp_path / "log.csv").write_text(",".join(header) + "\n0,0,0,0,1,0,0,0,-1e-3,1e-3,1e-6\n", encoding="utf-8")
    read = scan3d.read_recording(tmp_path / "log.csv")
    assert read.rod.bending_stiffness_Nm2 == 8.35e-5
    assert read.source["kind"] == "laboratory"


@pytest.mark.slow
def test_the_report_has_the_sections_that_the_pages_name(folder: Path) -> None:
    page = (ROOT / "docs" / "files.md").read_text(encoding="utf-8").partition("## The report")[2]
    rows = [row.split("|")[1] for row in page.split("\n") if row.startswith("| `")]
    sections = re.findall(r"`(\w+)`", " ".join(rows))
    assert sorted(sections) == sorted(json.loads((folder / "report.json").read_text(encoding="utf-8")))
