"""Batches: meshes, grids and names; failures, repetition and continuation; the same results wherever they are computed."""

import csv
import io
import itertools
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import Executor, Future
from pathlib import Path

import pytest
from sample_bodies import MESHES
from small_scans import CUBE, EGG, FEW, SETTINGS, undrawn

import scan3d
from scan3d import batches, workers
from scan3d.batches import COLUMNS, _csv, combinations, mesh_files
from scan3d.cli import main
from scan3d.pictures import canvas
from scan3d.settings import settings
from tests.robustness.runner import Threads

pytestmark = pytest.mark.all_samples  # the results are those of other processes
THREE = (EGG, CUBE, MESHES / "gem.glb")
SUMMARIES = {"summary.csv", "batch.json"}


@pytest.fixture(autouse=True)
def without_renderer(request, monkeypatch):
    """No pictures, which take longer than everything else, in this process and in its children."""
    if "rendering" not in request.keywords:
        monkeypatch.setattr(canvas, "can_render", lambda *_: False)
        monkeypatch.setenv(canvas.WINDOW, "vtkXOpenGLRenderWindow")
        monkeypatch.delenv("DISPLAY", raising=False)


@pytest.fixture(scope="module")
def serial(tmp_path_factory):
    """Three bodies, one of them bad, scanned one after the other in this process."""
    place = tmp_path_factory.mktemp("serial")
    with undrawn():
        return place / "out", scan3d.batch([*THREE, bad_mesh(place)], place / "out", **SETTINGS)


def bad_mesh(place):
    path = place / "bad.stl"
    path.write_text("solid bad\nendsolid bad\n")
    return path


@pytest.fixture
def call(capsys, monkeypatch):
    """Run the command without further processes: (exit code, stdout, stderr)."""
    monkeypatch.setattr(workers, "Workers", Threads)

    def run(*arguments):
        return main(["batch", *map(str, arguments)]), *capsys.readouterr()

    return run


def rows_of(folder, *, times=False):
    with open(folder / "summary.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        if not times:
            del row["seconds"]
    return rows


def results_of(folder):
    """The files of all runs, without the times in their reports."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.parent != folder:
            found[str(path.relative_to(folder))] = path.read_bytes()
            if path.name == "report.json":
                report = json.loads(path.read_bytes())
                del report["timings_s"]
                found[str(path.relative_to(folder))] = report
    return found


# --- the meshes that are meant ---


def test_meshes_are_files_folders_and_patterns(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("a/one.stl", "a/two.PLY", "a/notes.txt", "b/c/three.off"):
        Path(name).parent.mkdir(parents=True, exist_ok=True)
        Path(name).touch()
    one, two, three = Path("a/one.stl"), Path("a/two.PLY"), Path("b/c/three.off")
    assert mesh_files(["a"]) == [one, two]
    assert mesh_files(["**/*.off"]) == [three]
    # each once, in the order in which it is first given; a file need not exist
    assert mesh_files([two, "a", "./a/one.stl", Path("missing.stl")]) == [two, one, Path("missing.stl")]
    Path("[1].stl").touch()
    assert mesh_files(["[1].stl"]) == [Path("[1].stl")]


def test_formulas_in_the_summary_are_text():
    texts = {"run": "=1+1", "mesh": "@x.stl", "error": "-2 is no friction", "friction": "-2", "noise": -1e-3}
    (row,) = csv.DictReader(io.StringIO(_csv([texts]).decode()))
    expected = {"run": "'=1+1", "mesh": "'@x.stl", "error": "'-2 is no friction", "friction": "-2", "noise": "-0.001"}
    assert {name: row[name] for name in texts} == expected


@pytest.mark.slow
def test_what_a_scan_has_written_is_no_mesh(serial, tmp_path):
    out, _ = serial
    shutil.copytree(out / "egg", tmp_path / "egg")
    (tmp_path / "egg" / "mine.stl").touch()
    assert mesh_files([tmp_path / "egg"]) == [tmp_path / "egg" / "mine.stl"]
    assert mesh_files([f"{tmp_path}/**/*.[ps][lt][yl]"]) == [tmp_path / "egg" / "mine.stl"]


# --- names ---


def test_names_of_runs(tmp_path):
    paths = [Path(path) for path in ("x/egg.stl", "y/Egg.ply", "..stl", "a b:c.stl", "été.stl", "n" * 120 + ".stl")]
    runs = batches._runs(paths, [({"friction": "0.0:0.4"}, settings({}))], tmp_path, False)
    names = ["egg", "Egg", "", "a-b-c", "été", "n" * 100]
    expected = [f"{name}_friction=0.0-0.4"[:100] for name in names]
    assert [run.name for run in runs] == [expected[0], f"{expected[1]}-2", *expected[2:]]


def test_many_runs_of_one_name_try_each_number_once(monkeypatch):
    tried, count = [], itertools.count

    def counted(first):
        for number in count(first):
            tried.append(number)
            yield number

    monkeypatch.setattr(batches.itertools, "count", counted)
    names = batches._distinct(["egg", "egg-3", "Egg"] + 97 * ["egg"])
    assert len({name.casefold() for name in names}) == 100
    assert names[:5] == ["egg", "egg-3", "Egg-2", "egg-4", "egg-5"]
    assert len(tried) == 99  # with that of the name egg-3


# --- grids ---


def test_a_grid_is_the_product_of_its_lists():
    assert combinations({"slices": 8, "friction": [0.0, "0.1:0.4"], "axis": ["x", [1, 1, 0]]}) == [
        {"slices": 8, "friction": friction, "axis": axis} for friction in (0.0, "0.1:0.4") for axis in ("x", [1, 1, 0])
    ]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", r"grid\.toml has no settings; expected lists of values"),
        ("slices = ['many']", r"grid\.toml: slices must be a whole number, got 'many'"),
        ("slices = [8, 0]", r"grid\.toml, slices = 0: slices must be a whole number of at least 1"),
    ],
)
def test_grids_that_can_not_be_used(call, tmp_path, text, sentence):
    path = tmp_path / "grid.toml"
    path.write_text(text)
    with pytest.raises(scan3d.InputError, match=sentence):
        scan3d.batch(EGG, tmp_path / "out", grid=path)
    code, stdout, stderr = call(EGG, "--out", tmp_path / "out", "--grid", path)
    assert (code, stdout) == (1, "")
    assert re.fullmatch(rf"scan3d: .*{sentence}.*\n", stderr)
    assert not (tmp_path / "out").exists()


# --- what a batch writes ---


@pytest.mark.slow
def test_the_summary_has_a_row_for_each_run(serial):
    out, done = serial
    assert isinstance(done, scan3d.Batch)
    assert {path.name for path in out.iterdir()} == {"egg", "cube", "gem", *SUMMARIES}
    found = rows_of(out, times=True)
    assert list(found[0]) == list(COLUMNS)
    assert [(row["run"], row["status"]) for row in found] == [
        ("egg", "done"),
        ("cube", "done"),
        ("gem", "done"),
        ("bad", "failed"),
    ]
    for row, mesh in zip(found, THREE, strict=False):
        report = json.loads((out / row["run"] / "report.json").read_text())
        assert row["mesh"] == str(mesh)
        assert float(row["hausdorff_relative"]) == report["hausdorff"]["relative"]
        assert float(row["certificate_relative"]) == report["certificate"]["relative"]
        assert int(row["contacts"]) == report["counts"]["contacts"]
        assert row["surface_method"] == report["surface"]["method"]
        assert float(row["seconds"]) == pytest.approx(sum(report["timings_s"].values()), abs=1e-3)
        assert row["error"] == ""
    assert re.match(r"bad\.stl has no triangles", found[3]["error"])
    assert found[3]["hausdorff_relative"] == ""
    assert repr(done) == f"Batch of 4 runs, 1 failed, in {out}"


def stamps(folder):
    return {path: path.stat().st_mtime_ns for path in folder.rglob("report.json")}


@pytest.fixture
def again(serial, tmp_path):
    shutil.copytree(serial[0], tmp_path / "out")
    return tmp_path / "out", [*THREE, serial[0].parent / "bad.stl"]


def test_other_meshes_settings_versions_and_results_that_are_not_whole_are_computed(again, monkeypatch):
    out, meshes = again

    def done(paths=meshes[:2], **changed):
        runs = batches._runs(paths, [({}, settings({**SETTINGS, **changed}))], out, False)
        return [run.is_done() for run in runs]

    assert done() == [True, True]
    assert done(seed=1) == [False, False]
    copy = out.parent / "egg.stl"
    copy.write_bytes(CUBE.read_bytes())
    assert done([copy, meshes[1]]) == [False, True]
    (out / "egg" / "surface.ply").write_bytes(b"ply")
    (out / "cube" / "cloud.ply").unlink()
    assert done() == [False, False]
    shutil.copytree(out / "gem", out / "gem-2")
    (out / "gem" / "report.json").write_text("{")
    assert done([meshes[2]]) == [False]
    monkeypatch.setattr(batches, "version", lambda name: "0.0.1")
    assert done() == [False, False]


# --- failures ---


class Fails(Executor):
    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        future.set_exception(RuntimeError("the worker\nis gone"))
        return future


def test_a_run_whose_worker_is_lost_is_a_failure(tmp_path):
    (row,) = scan3d.batch(EGG, tmp_path, Fails(), **SETTINGS).rows
    assert row["error"].startswith("its worker was lost (RuntimeError: the worker is gone)")


# --- the command ---


def test_the_command_prints_a_table_and_repeats_nothing_that_is_done(call, again, serial):
    out, meshes = again
    before = stamps(out)
    code, stdout, stderr = call(*meshes, "--out", out, *FEW[:-1])
    lines = stdout.splitlines()
    assert code == 1
    # the failure is tried again
    assert re.fullmatch(r"4 runs, 3 of them by an earlier call: 3 done, 1 failed, in [\d.]+ s", lines[0])
    assert stamps(out) == before
    assert rows_of(out) == rows_of(serial[0])
    for line, name in zip(lines[1:4], ("best", "median", "worst"), strict=True):
        assert re.fullmatch(rf"{name} +.+ (%|ppm) of the diagonal, certified within \S+ (%|ppm) \(\w+\)", line)
    assert lines[4].startswith("failed             bad: bad.stl has no triangles")
    assert lines[5] == f"written to         {out}"
    assert stderr == f"scan3d: 1 of 4 runs failed; summary.csv in {out} says why\n"
    code, stdout, _ = call(*meshes[:3], "--out", out, *FEW[:-1], "--json")
    data = json.loads(stdout)
    assert (code, data["computed"], data["counts"]["failed"]) == (0, 0, 0)
    assert [row["run"] for row in data["runs"]] == ["egg", "cube", "gem"]


# --- other processes ---


class Killer(threading.Thread):
    """Kills the process that computes a run, as soon as it has begun."""

    def __init__(self, folder):
        super().__init__(daemon=True)
        self.folder, self.killed, self.is_over = folder, [], False

    def run(self):
        while not self.killed and not self.is_over:
            for work in self.folder.glob(".scan3d-work-*"):
                pid = int(work.name.split("-")[3])
                if pid == os.getpid() or self.killed:
                    continue
                os.kill(pid, signal.SIGKILL)
                self.killed.append(pid)
            time.sleep(0.002)

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *_):
        self.is_over = True
        self.join()


@pytest.mark.trust
def test_processes_give_the_same_bytes_and_a_worker_that_is_killed_costs_its_run(serial, tmp_path):
    meshes = [*THREE, serial[0].parent / "bad.stl"]
    with workers.Workers(2) as executor, Killer(tmp_path / "cube") as killer:
        done = scan3d.batch(meshes, tmp_path, executor, **SETTINGS)
    assert len(killer.killed) == 1
    assert [row["status"] for row in done.rows] == ["done", "failed", "done", "failed"]
    assert re.match(r"its worker was lost \(the operating system may have", done.rows[1]["error"])
    # the same call makes what is missing
    assert scan3d.batch(meshes, tmp_path, **SETTINGS).computed == 2
    assert rows_of(tmp_path) == rows_of(serial[0])
    assert results_of(tmp_path) == results_of(serial[0])


def started(*arguments):
    # as in an installation, but with the packages of this test
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path)), "OMP_NUM_THREADS": "1"}
    return subprocess.Popen(
        [sys.executable, *map(str, arguments)],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def waited_for(condition, seconds=120):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.trust
@pytest.mark.skipif(os.name == "nt", reason="Windows has no such signals")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_a_batch_that_is_interrupted_continues(serial, tmp_path, number, capsys):
    meshes = [*THREE, serial[0].parent / "bad.stl"]
    arguments = ["batch", *map(str, meshes), "--out", str(tmp_path / "out"), *FEW]
    with started("-m", "scan3d", *arguments) as first:
        waited_for(lambda: (tmp_path / "out" / "cube").exists() or first.poll() is not None)
        assert first.poll() is None
        first.send_signal(number)
        _, stderr = first.communicate(timeout=120)
    assert first.returncode == (130 if number == signal.SIGINT else -signal.SIGKILL)
    if number == signal.SIGINT:
        assert stderr.splitlines()[-1] == "scan3d: interrupted"
        assert all(line.startswith("scan3d: ") for line in stderr.splitlines())
        assert not list((tmp_path / "out").rglob(".scan3d-*"))
    assert not (tmp_path / "out" / "summary.csv").exists()
    before = stamps(tmp_path / "out")
    assert (tmp_path / "out" / "egg" / "report.json") in before
    assert main(arguments) == 1
    assert "1 of 4 runs failed" in capsys.readouterr().err
    after = stamps(tmp_path / "out")
    assert {path: after[path] for path in before} == before
    assert rows_of(tmp_path / "out") == rows_of(serial[0])
    assert results_of(tmp_path / "out") == results_of(serial[0])


# --- Dask ---


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="Windows has no such signals")
def test_a_dask_cluster_gives_the_same_summary(serial, tmp_path, capsys):
    pytest.importorskip("distributed")
    address = tmp_path / "scheduler.json"
    local = ["--host", "127.0.0.1", "--scheduler-file", address, "--no-dashboard"]
    one_thread = [*local, "--nworkers", "1", "--nthreads", "1", "--local-directory", tmp_path]
    cluster = [started("-m", "distributed.cli.dask_scheduler", *local, "--port", "0")]
    try:
        waited_for(address.exists)
        cluster.append(started("-m", "distributed.cli.dask_worker", *one_thread))
        url = json.loads(address.read_text())["address"]
        meshes = [str(mesh) for mesh in (*THREE, serial[0].parent / "bad.stl")]
        code = main(["batch", *meshes, "--out", str(tmp_path / "out"), *FEW, "--scheduler", url])
    finally:
        for process in reversed(cluster):
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
    assert code == 1  # one of the meshes is bad
    assert rows_of(tmp_path / "out") == rows_of(serial[0])
    assert results_of(tmp_path / "out") == results_of(serial[0])
    # Dask says nothing of its own
    assert all(line.startswith("scan3d: ") for line in capsys.readouterr().err.splitlines())


def test_without_dask_the_message_says_how_to_install_it(call, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    code, stdout, stderr = call(EGG, "--out", tmp_path / "out", "--scheduler", "tcp://127.0.0.1:1")
    assert (code, stdout) == (1, "")
    assert stderr == "scan3d: a scheduler needs dask.distributed: pip install 'scan3d[cluster]'\n"
    assert not (tmp_path / "out").exists()
