"""The command: its output and exit codes, its messages for wrong input, and that it writes all results or none."""

import contextlib
import dataclasses
import importlib
import inspect
import io
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
import typing
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
import trimesh
from small_scans import CUBE, EGG, MESHES, RESULTS, SETTINGS, undrawn

import scan3d
from scan3d import choices, results, units
from scan3d.cli import main, verbs
from scan3d.cli.commands import COMMANDS, app
from scan3d.files.shapes import read_ply
from scan3d.settings import Given, Settings, settings

COMMAND = Path(sys.executable).with_name("scan3d")
# A scan that takes a fraction of a second.
FEW = ("--slices", "3", "--sweeps", "4", "--samples", "8")


def tree(folder):
    return {p.relative_to(folder): p.read_bytes() if p.is_file() else None for p in folder.rglob("*")}


def assert_sentence(stderr, sentence):
    """The message is one line that contains the sentence, after the steps of a run that has lasted a second."""
    said = re.sub(r"^scan3d: [\d.]+ s: [a-z ]+\n", "", stderr, flags=re.MULTILINE)
    assert re.fullmatch(rf"scan3d: .*{sentence}.*\n", said), stderr


@pytest.fixture(scope="module")
def scanned(tmp_path_factory):
    out, printed = tmp_path_factory.mktemp("scanned") / "out", io.StringIO()
    with undrawn(), contextlib.redirect_stdout(printed):
        assert main(["scan", str(EGG), "--out", str(out), *FEW, "--friction", "0.2", "--json"]) == 0
    return out, printed.getvalue()


# --- mistakes ---


def test_files_that_are_no_convex_bodies(call, tmp_path):
    torus = trimesh.creation.torus(3.0, 1.0)
    bowl, missing, log = tmp_path / "bowl.stl", tmp_path / "missing.stl", tmp_path / "log.csv"
    trimesh.Trimesh(torus.vertices, torus.faces[20:]).export(bowl)
    is_open, is_missing = r"bowl\.stl is open: .*--hull", r"there is no mesh file missing\.stl in .*"
    before = tree(tmp_path)
    for arguments, sentence in (
        (["scan", missing, "--out", tmp_path / "new" / "out", *FEW], is_missing),
        (["scan", bowl, "--out", tmp_path / "new" / "out", *FEW], is_open),
        (["simulate", bowl, "--out", tmp_path / "new" / "log.csv"], is_open),
        (["compare", CUBE, missing], is_missing),
        (["show", "nowhere"], "there is no nowhere; show a scan's folder"),
        (["reconstruct", log, "--out", tmp_path / "out"], r"can't read the recording .*log\.csv: No such file"),
    ):
        code, stdout, stderr = call(*arguments)
        assert (code, stdout) == (1, ""), arguments
        assert_sentence(stderr, sentence)
    assert tree(tmp_path) == before


@pytest.mark.parametrize("out", ["/proc/nowhere", "file/out/deeper", "file"])
def test_a_folder_that_can_not_be_written_into(call, tmp_path, out):
    (tmp_path / "file").write_bytes(b"other content")
    for command, place in (("scan", tmp_path / out), ("simulate", tmp_path / out / "log.csv")):
        code, stdout, stderr = call(command, CUBE, *FEW, "--out", place)
        assert (code, stdout) == (1, "")
        assert_sentence(stderr, "can't write into the folder .*; choose another one with --out")
        assert tree(tmp_path) == {Path("file"): b"other content"}


@pytest.mark.slow
def test_a_failed_run_leaves_nothing_new_and_the_results_of_the_one_before(call, scanned, tmp_path, no_pictures):
    # that the cube is not smooth is known only after the simulation
    code, stdout, stderr = call("scan", CUBE, "--out", tmp_path / "a" / "b", *FEW, "--method", "support")
    assert (code, stdout) == (1, "")
    assert_sentence(stderr, "not smooth enough for the method support")
    assert tree(tmp_path) == {}
    shutil.copytree(scanned[0], tmp_path / "old")
    before = tree(tmp_path)
    assert call("scan", CUBE, "--out", tmp_path / "old", *FEW, "--method", "support")[0] == 1
    assert tree(tmp_path) == before


@pytest.mark.parametrize(
    ("asked", "sentence"),
    [
        ("scna cube.stl", 'Unknown command "scna". Did you mean "scan".*; see \'scan3d --help\''),
        ("scan", "MESH is missing; see 'scan3d scan --help'"),
        ("simulate cube.stl", "--out is missing or has no value; see 'scan3d simulate --help'"),
        ("scan cube.stl --out out --frictoin 3", "Unknown option: --frictoin. Did you mean --friction"),
        ("reconstruct log.csv", "--out is missing: it names the folder for the results; see"),
        ("show o --view compar", 'Invalid value "compar" for --view.* Did you mean "compare"'),
        ("calibrate log.csv --out rig.toml", "the reference is one of --sphere D, --plane and --known PLACES"),
        ("batch cube.stl --out out --jobs 2 --scheduler x", "--jobs and --scheduler are two places"),
        ("simulate cube.stl --out log.csv --placed p.ply", "--placed is for a rig: give --poses FILE"),
        ("simulate cube.stl --out log.csv --method hull", "--method is of a surface, and simulate makes a recording"),
        ("simulate cube.stl --out log.csv --reach 2", "--reach is of a surface, and simulate makes a recording"),
        ("simulate cube.stl --poses p.csv --out log.csv --reach 2", "--reach is a setting of a scan, and --poses says"),
        ("plan --around 0,0,20,10 --out p.txt", "poses are written as .csv, got 'p.txt'"),
    ],
)
def test_wrong_usage(call, tmp_path, monkeypatch, asked, sentence):
    monkeypatch.chdir(tmp_path)
    code, stdout, stderr = call(*asked.split())
    assert (code, stdout) == (2, "")
    assert_sentence(stderr, sentence)
    assert tree(tmp_path) == {}


@pytest.mark.slow
def test_a_scan_goes_beside_its_mesh_and_over_nothing(call, tmp_path, no_pictures):
    mesh = Path(shutil.copy(CUBE, tmp_path / "part.stl"))
    (tmp_path / "part-scan").write_text("mine")
    for name in ("part-scan-2", "part-scan-3"):
        assert call("scan", mesh, *FEW, "--quiet")[0] == 0
        assert (tmp_path / name / "report.json").exists()
    assert (tmp_path / "part-scan").read_text() == "mine"


def test_a_disk_that_is_full(call, tmp_path, monkeypatch, no_pictures):
    def write(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", write)
    code, stdout, stderr = call("scan", CUBE, "--out", tmp_path / "a" / "b", *FEW)
    assert (code, stdout) == (1, "")
    assert_sentence(stderr, "can't write .*: No space left on device; choose another place with --out")
    monkeypatch.undo()
    assert tree(tmp_path) == {}


@pytest.mark.slow
def test_output_into_a_closed_pipe(tmp_path):
    asked = [COMMAND, "scan", CUBE, "--out", tmp_path / "out", "--print-config"]
    # the reader has ended, as in `| true`
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(asked, stdout=writing, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writing)
    assert (done.returncode, done.stderr) == (1, "")


# --- output ---


@pytest.mark.slow
def test_help_version_and_completion(call):
    code, stdout, stderr = call("--help")
    assert (code, stderr) == (0, "")
    assert all(f" {name} " in stdout for name in COMMANDS)
    assert call("--version") == call("version") == (0, version("scan3d") + "\n", "")
    assert call("help", "scan") == call("scan", "--help")
    for shell in ("bash", "zsh", "fish"):
        script = call("completion", shell)[1]
        assert all(word in script for word in (*COMMANDS, "friction")), shell
    assert "compdef _cyclopts_scan3d scan3d" in call("completion", "zsh")[1]  # for `eval`
    # the program alone prints a short guide
    code, stdout, stderr = call()
    assert (code, stderr) == (0, "")
    assert set(re.findall(r"^  scan3d ([a-z]+)", stdout, re.MULTILINE)) <= set(COMMANDS)


@pytest.mark.slow
@pytest.mark.parametrize("command", COMMANDS)
def test_the_help_of_a_command_describes_each_option_and_has_examples_that_run(call, command):
    code, stdout, stderr = call(command, "--help")
    assert (code, stderr) == (0, "")
    arguments = app()[command].assemble_argument_collection(parse_docstring=True)
    assert all(argument.parameter.help for argument in arguments.filter_by(show=True))
    for line in re.findall(r"^  (?:eval \"\$\()?(scan3d .*?)(?:\)\"| > .*)?$", COMMANDS[command].__doc__, re.MULTILINE):
        words = shlex.split(line.strip())
        assert words[1] == command
        app().parse_args(words[1:], exit_on_error=False, print_error=False)
    assert "scan3d " in COMMANDS[command].__doc__ or command == "demo"


def test_every_setting_is_an_option_and_its_help_has_the_default(call, monkeypatch):
    monkeypatch.setenv("COLUMNS", "250")
    stdout = call("scan", "--help")[1]
    for setting in dataclasses.fields(Settings):
        assert f"--{setting.name.replace('_', '-')} " in stdout
        assert f"{setting.metadata['meaning']} " in stdout
        assert setting.name == "hull" or f"[default: {setting.default}]" in stdout


@pytest.mark.slow
def test_the_demonstration_scans_its_body_and_says_what_to_open(call, tmp_path, monkeypatch, no_pictures):
    mesh = scan3d.load_mesh(results.DEMO)
    monkeypatch.syspath_prepend(MESHES)
    made = importlib.import_module("make_meshes").make("egg", 16)
    assert sorted(map(tuple, mesh.vertices)) == sorted(map(tuple, made.vertices))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(verbs, "DEMO_SETTINGS", SETTINGS)
    code, stdout, _ = call("demo")
    assert code == 0
    assert "written to         scan3d-demo\n" in stdout
    named = re.search(r"Open (\S+) in a browser", stdout)[1]
    assert Path(named) == Path("scan3d-demo/view.html")
    assert Path(named).is_file()
    assert "Open" not in call("demo", "--quiet")[1]


@pytest.mark.slow
def test_the_reports_of_scan_and_reconstruct_agree_in_their_numbers(call, scanned, tmp_path, no_pictures):
    out, printed = scanned
    first = json.loads(printed)
    code, stdout, _ = call("reconstruct", out / "recording.csv", "--out", tmp_path, "--truth", EGG, "--json")
    assert code == 0
    again = json.loads(stdout)
    # the friction that was set is known to the scan only
    assert (first["friction"].pop("set"), again["friction"].pop("set")) == ("0.2", None)
    assert set(again) == set(first)
    for key in set(first) - {"settings", "timings_s", "files", "sha256"}:
        assert again[key] == first[key], key
    for name in ("cloud.ply", "surface.ply"):
        assert again["sha256"][name] == first["sha256"][name]


def test_step_2_needs_the_recording_only(call, scanned, tmp_path, no_pictures):
    assert call("simulate", EGG, "--out", tmp_path / "log.csv", *FEW, "--friction", "0.2")[0] == 0
    for ending in (".csv", ".toml"):
        assert (tmp_path / f"log{ending}").read_bytes() == (scanned[0] / f"recording{ending}").read_bytes()
    code, stdout, _ = call("reconstruct", tmp_path / "log.csv", "--out", tmp_path / "out")
    assert code == 0
    assert "Hausdorff" not in stdout
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["mesh"] is report["hausdorff"] is report["contact_error"] is report["friction"]["set"] is None
    assert report["source"]["mesh"] == "egg.stl"
    # settings of the simulation do not apply here
    assert report["settings"] == {"method": "auto", "hull": False}
    assert set(report["files"]) == RESULTS == {p.name for p in (tmp_path / "out").iterdir()}
    there, here = (read_ply(folder / "cloud.ply")[0] for folder in (scanned[0], tmp_path / "out"))
    assert there.dtype == here.dtype
    # `quality` is the distance to the true mesh, and unknown without it
    assert all(there[name].tobytes() == here[name].tobytes() for name in there.dtype.names if name != "quality")
    assert np.isnan(here["quality"]).all()
    assert there["quality"].max() < 1e-6
    assert (scanned[0] / "surface.ply").read_bytes() == (tmp_path / "out" / "surface.ply").read_bytes()


def test_compare_prints_the_distance(call, tmp_path):
    moved = trimesh.load_mesh(CUBE)
    moved.apply_translation([0.5, 0, 0])
    moved.export(tmp_path / "moved.ply")
    code, stdout, stderr = call("compare", tmp_path / "moved.ply", CUBE)
    assert (code, stderr) == (0, "")
    assert stdout.startswith("Hausdorff distance 500 µm (")
    code, stdout, _ = call("compare", tmp_path / "moved.ply", CUBE, "--json")
    assert json.loads(stdout)["hausdorff"] == pytest.approx(0.5, rel=1e-6)
    assert "5 mm" in call("compare", tmp_path / "moved.ply", CUBE, "--unit", "cm")[1]


# --- settings ---


def test_the_command_line_precedes_the_file_and_the_file_the_defaults(call, tmp_path):
    (tmp_path / "a.toml").write_text('slices = 5\nsamples = 11\nspacing = "uniform"\n')
    code, stdout, stderr = call(
        "scan", CUBE, "--out", tmp_path / "out", "--config", tmp_path / "a.toml", "--slices", "7", "--print-config"
    )
    assert (code, stderr) == (0, "")
    assert tomllib.loads(stdout) == vars(Settings(slices=7, samples=11, spacing="uniform"))
    assert not (tmp_path / "out").exists()


ALL = Settings(
    slices=4, spacing="adaptive", axis="1,1,0", sweeps="5", samples=9, friction="0.1:0.2", rod="steel:0.5x100", clearance=0.2,
    tolerance=0.001, noise=1e-05, seed=3, unit="mm", method="hull", hull=True,
)  # fmt: skip


@pytest.mark.slow
def test_printed_settings_give_the_same_run(call, tmp_path, no_pictures):
    given = [f"--{name.replace('_', '-')}={value}" for name, value in vars(ALL).items() if name != "hull"]
    code, printed, _ = call("scan", CUBE, "--out", tmp_path / "one", *given, "--hull", "--print-config")
    assert code == 0
    assert tomllib.loads(printed) == vars(ALL)
    (tmp_path / "printed.toml").write_text(printed)
    config = ("--config", tmp_path / "printed.toml")
    assert call("scan", CUBE, "--out", tmp_path / "one", *config, "--print-config") == (0, printed, "")

    assert call("scan", CUBE, "--out", tmp_path / "one", *given, "--hull")[0] == 0
    assert call("scan", CUBE, "--out", tmp_path / "two", *config)[0] == 0
    for name in ("recording.csv", "cloud.ply", "surface.ply"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    assert json.loads((tmp_path / "two" / "report.json").read_text())["settings"] == vars(ALL)


def test_a_file_may_use_the_types_of_toml(tmp_path):
    path = tmp_path / "a.toml"
    path.write_text("friction = [0.1, 0.2]\naxis = [1, 1, 0]\nsweeps = 5\nnoise = 0\nclearance = 0.2\nhull = true\n")
    chosen = settings({}, path)
    assert (chosen.friction, chosen.axis, chosen.sweeps) == ("0.1:0.2", "1,1,0", "5")
    assert (chosen.noise, chosen.clearance, chosen.hull) == (0.0, 0.2, True)
    plan = chosen.plan()
    assert plan.friction == (0.1, 0.2)
    assert plan.sweeps == 5
    assert np.allclose(plan.axis, [1, 1, 0])
    path.write_text("friction = 0.25\n")
    assert settings({}, path).plan().friction == 0.25


def test_the_types_of_choices_are_those_of_the_lists():
    assert typing.get_args(units.Unit) == tuple(units.UNITS_M)
    lists = {name: values for name, values in vars(choices).items() if name.isupper()}
    parts = {"NOT_CONVEX": choices.METHODS, "CHARTS": choices.VIEWS, "WITH_OTHER": choices.VIEWS}
    assert all(set(lists.pop(name)) < set(whole) for name, whole in parts.items())
    types = {name: typing.get_args(kind) for name, kind in vars(choices).items() if typing.get_origin(kind)}
    assert sorted(lists.values()) == sorted(types.values())


def test_signatures_in_python_show_every_setting():
    for function in (scan3d.scan, scan3d.batch):
        shown = inspect.signature(function).parameters
        assert "settings" not in shown
        for setting in dataclasses.fields(Settings):
            assert shown[setting.name].default == setting.default
            assert setting.metadata["meaning"] in function.__doc__
    assert list(Given.__annotations__) == [setting.name for setting in dataclasses.fields(Settings)]
