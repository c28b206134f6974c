"""At whatever call of the file system a run ends, its folder holds the whole earlier or the whole new result."""

import contextlib
import json
import os
import shutil

import pytest
from crashes import every, run

from scan3d import InputError
from scan3d.files import journal, results
from scan3d.files.atomic import write_atomic, write_together
from scan3d.files.journal import locate
from scan3d.files.ownership import RECORDING, RESULTS, check_belongs, read_report

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="the operating system can't fork a process")
HOW = ["kill", "ctrl-c", "full disk"]
REPORT = {"schema": 1, "versions": {"scan3d": "0"}}
OLD = {name: f"old {name}".encode() * 50 for name in (*RECORDING, *RESULTS) if name != "report.json"}
# the new result has neither a recording nor one of the pictures
NEW = {name: f"new {name}".encode() * 60 for name in ("cloud.ply", "surface.ply", "view.html", "cloud.png")}
FOREIGN = {"notes.txt": b"of the user", ".hidden": b"as well"}


def write(folder, files):
    with results.opened(folder, with_recording=RECORDING[0] in files) as result:
        for name, data in files.items():
            result.put(name, data)
        result.commit(REPORT)


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file() and path.name != "report.json"}


def seen(folder):
    """The files of the result that a reader sees, after the reader has checked that they belong to the report."""
    report = read_report(folder)
    check_belongs(folder, report, (*RECORDING, *RESULTS))
    names = [name for name in (*RECORDING, *RESULTS) if locate(folder / name, "").exists()]
    assert sorted(names) == sorted(report.get("files", ()))
    return {name: locate(folder / name, "").read_bytes() for name in names if name != "report.json"}


@pytest.fixture(autouse=True)
def _without_waiting_for_the_disk(monkeypatch):
    """Nothing here depends on it, and another program that writes would slow the tests down."""
    monkeypatch.setattr(os, "fsync", lambda _: None)


@pytest.fixture
def place(tmp_path):
    """A folder with an earlier result and files of the user, made anew by each call."""

    def prepare(files=OLD):
        shutil.rmtree(tmp_path / "out", ignore_errors=True)
        if files:
            write(tmp_path / "out", files)
            for name, data in FOREIGN.items():
                (tmp_path / "out" / name).write_bytes(data)
        return tmp_path / "out"

    return prepare


@pytest.mark.parametrize("how", HOW)
def test_a_result_is_the_old_or_the_new_one(place, monkeypatch, how):
    folder = place()
    outcomes = []

    def check(kth, ended):
        # whoever can't write sees the same as who can
        with monkeypatch.context() as patched:
            patched.setattr(journal, "claim", refuse)
            read_only = seen(folder)
        found = seen(folder)
        assert found in (OLD, NEW), kth
        assert read_only == found, kth
        # and so do those who list the folder afterwards
        assert contents(folder) == {**found, **FOREIGN}
        outcomes.append(found == NEW)
        write(folder, NEW)
        assert contents(folder) == {**NEW, **FOREIGN}
        assert {path.name for path in folder.iterdir()} == {*NEW, *FOREIGN, "report.json"}

    def refuse(*_):
        raise PermissionError(13, "Permission denied")

    calls = every(lambda: write(folder, NEW), how, place, check)
    assert calls > 40
    # there is one point before which it is the old result, and after which the new one
    assert outcomes == sorted(outcomes)
    assert outcomes[0] is False
    assert outcomes[-1] is True


@pytest.mark.parametrize("how", HOW)
def test_a_first_result_is_there_or_not(place, how):
    folder = place(())

    def check(kth, ended):
        assert not folder.exists() or seen(folder) in ({}, NEW), kth
        if how != "kill" and not ended and folder.exists():  # nothing is left but a result that is complete
            assert contents(folder) == NEW, kth
        write(folder, NEW)
        assert {path.name for path in folder.iterdir()} == {*NEW, "report.json"}

    every(lambda: write(folder, NEW), how, lambda: place(()), check)


def test_who_finishes_the_work_of_a_killed_run_may_be_killed_as_well(place):
    folder = place()
    killed = []

    def prepare():
        place()
        run(lambda: write(folder, NEW), "kill", killed[-1])

    # the calls at which a kill leaves a journal
    for kth in range(1, 200):
        place()
        ended = run(lambda: write(folder, NEW), "kill", kth)
        if (folder / journal.WORK / ".scan3d-journal.json").exists():
            killed.append(kth)
        if ended:
            break
    assert len(killed) > 5
    for _ in (0, 1):
        every(
            lambda: journal.finish(folder),
            "kill",
            prepare,
            lambda kth, ended: (folder, seen(folder) == NEW or pytest.fail(f"at {kth}")),
        )
        killed.pop()  # and once more for a run that was killed one call before its end


@pytest.mark.parametrize("how", HOW)
def test_a_recording_has_the_table_and_the_rod_of_one_run(tmp_path, how):
    path = tmp_path / "log.csv"

    def files(which):
        return {"log.toml": f"{which} rod".encode() * 30, "log.csv": f"{which} table".encode() * 30}

    def prepare():
        write_together(path, files("old"))

    def check(kth, ended):
        pair = locate(path.with_suffix(".toml"), path.name).read_bytes(), locate(path).read_bytes()
        assert pair in (tuple(files("old").values()), tuple(files("new").values())), kth
        write_together(path, files("new"))
        assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == files("new")

    assert every(lambda: write_together(path, files("new")), how, prepare, check) > 15


@pytest.mark.parametrize("how", HOW)
def test_a_single_file_is_the_old_or_the_new_one(tmp_path, how):
    path = tmp_path / "a.stl"

    def check(kth, ended):
        assert path.read_bytes() in (b"old", b"new"), kth
        # what was left is removed by the next run that writes any file there
        write_atomic(tmp_path / "b.stl", b"other")
        assert {file.name for file in tmp_path.iterdir()} == {"a.stl", "b.stl"}

    assert every(lambda: write_atomic(path, b"new"), how, lambda: write_atomic(path, b"old"), check) > 8


def test_everything_is_on_the_disk_before_the_next_step_begins(place, monkeypatch):
    """A computer that loses its power keeps what was flushed, and may keep later changes without earlier ones."""
    folder, calls, replace = place(), [], os.replace

    def flushed(handle):
        calls.append(os.path.basename(os.readlink(f"/proc/self/fd/{handle}")))

    def replaced(source, to):
        calls.append(("moved", os.path.basename(to)))
        replace(source, to)

    if not os.path.isdir("/proc/self/fd"):
        pytest.skip("the operating system does not say which file is flushed")
    monkeypatch.setattr(os, "fsync", flushed)
    monkeypatch.setattr(os, "replace", replaced)
    write(folder, NEW)
    names = [*NEW, "report.json"]
    assert calls == [
        *names, journal.WORK, ".scan3d-journal.json.new", ("moved", ".scan3d-journal.json"), journal.WORK,
        *(("moved", name) for name in names), folder.name,
    ]  # fmt: skip
    calls.clear()
    write_atomic(folder / "a.stl", b"new")
    assert calls == ["a.stl", ("moved", "a.stl"), folder.name]


def test_a_file_that_is_larger_than_the_system_allows(place):
    """The kernel refuses to write, as on a full disk."""
    import resource

    folder = place()

    def limited():
        resource.setrlimit(resource.RLIMIT_FSIZE, (400, 400))
        with pytest.raises(InputError, match=r"can't write .*: File too large; choose another place with --out"):
            write(folder, {**NEW, "view.html": b"x" * 4000})

    assert run(limited, "kill", 10_000)
    assert seen(folder) == OLD
    assert contents(folder) == {**OLD, **FOREIGN}
    assert not (folder / journal.WORK).exists()


def test_a_journal_touches_its_own_folder_only(place):
    folder = place()
    outside = folder.parent / "outside.txt"
    outside.write_bytes(b"of the user")
    work = folder / journal.WORK
    for damaged in (
        {"files": ["../outside.txt"], "obsolete": {}},
        {"files": [], "obsolete": {"../outside.txt": journal.digest(outside)}},
        {"files": [".."], "obsolete": {}},
        {"files": [7], "obsolete": {}},
        ["cloud.ply"],
    ):
        work.mkdir()
        (work / ".scan3d-lock").touch()
        (work / "outside.txt").write_bytes(b"harmful")
        (work / ".scan3d-journal.json").write_text(json.dumps(damaged))
        for use in (lambda: write(folder, NEW), lambda: seen(folder)):
            with pytest.raises(InputError, match="was left by a run and is damaged; remove it"):
                use()
        assert outside.read_bytes() == b"of the user"
        assert contents(folder) == {**OLD, **FOREIGN}
        shutil.rmtree(work)


def test_a_folder_with_the_name_of_the_work_folder_is_left_alone(place):
    folder = place()
    (folder / journal.WORK).mkdir()
    (folder / journal.WORK / "thesis.tex").write_bytes(b"of the user")
    with pytest.raises(InputError, match="is not a work folder of scan3d, which needs this name; move it away"):
        write(folder, NEW)
    assert seen(folder) == OLD
    assert (folder / journal.WORK / "thesis.tex").read_bytes() == b"of the user"


def test_two_runs_at_once(place):
    folder = place()
    with results.opened(folder, with_recording=True) as result:
        result.put("cloud.ply", b"of the first")
        with pytest.raises(InputError, match=rf"another run \(process {os.getpid()} on .*, since .*--out"):
            write(folder, NEW)
        # the second run has not removed what the first one is writing, and readers see the old result
        assert (folder / journal.WORK / "cloud.ply").exists()
        assert seen(folder) == OLD
        result.commit(REPORT)
    assert seen(folder) == {"cloud.ply": b"of the first"}
    write(folder, NEW)


def test_the_results_of_an_earlier_version_are_replaced(place):
    """Their reports name no hashes."""
    folder = place()
    report = json.loads((folder / "report.json").read_text())
    del report["sha256"]
    (folder / "report.json").write_text(json.dumps(report))
    assert seen(folder) == OLD
    write(folder, NEW)
    assert contents(folder) == {**NEW, **FOREIGN}


@pytest.mark.parametrize(
    "how", [pytest.param(how, marks=pytest.mark.slow if how == "kill" else pytest.mark.trust) for how in HOW]
)
def test_the_commands_read_one_result_wherever_a_scan_was_stopped(tmp_path, monkeypatch, how):
    """The same with real results, as `show`, `export` and `reconstruct` read them."""
    import dataclasses

    import trimesh

    import scan3d
    from scan3d import workflow
    from scan3d.cli import main
    from scan3d.pictures import rendering

    # without the child process that draws
    monkeypatch.setattr(rendering, "can_render", lambda: True)
    monkeypatch.setattr(workflow, "_draw", lambda *_: None)
    monkeypatch.setattr(workflow, "Drawing", contextlib.nullcontext)
    folder, made = tmp_path / "out", {}
    for name, size in (("old", 20), ("new", 30)):
        body = trimesh.creation.box((size, 30, 40))
        recording = scan3d.simulate(body, scan3d.Plan(slices=4, samples=8, sweeps=4))
        analysis = dataclasses.replace(workflow.analyse(recording, body), seconds={})
        place = tmp_path / name
        workflow.write(analysis, place, settings={}, with_recording=True)
        made[name] = {path.name: path.read_bytes() for path in place.iterdir() if path.name != "report.json"}, analysis

    def put(name):
        if name == "old":
            shutil.rmtree(folder, ignore_errors=True)
        workflow.write(made[name][1], folder, settings={}, with_recording=True)

    def check(kth, ended):
        # each of the three commands comes first in its turn
        commands = [
            ["show", str(folder), "--html", str(tmp_path / "a.html")],
            ["export", str(folder), "--to", str(tmp_path / "a.stl")],
            ["reconstruct", str(folder / "recording.csv"), "--out", str(tmp_path / "again")],
        ]
        for turn in range(3):
            assert main([*commands[(kth + turn) % 3], "--quiet"]) == 0, kth
        found = contents(folder)
        assert found in (made["old"][0], made["new"][0]), kth
        assert (tmp_path / "again" / "cloud.ply").read_bytes() != b""
        extent = 20 if found == made["old"][0] else 30
        assert round(float(scan3d.load_mesh(tmp_path / "a.stl").extents[0])) == extent
        for name in ("a.html", "a.stl"):
            (tmp_path / name).unlink()

    assert every(lambda: put("new"), how, lambda: put("old"), check, step=3) > 40
