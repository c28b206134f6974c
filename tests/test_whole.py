"""Results are written whole or not at all, at whatever call of the file system a run ends."""

import errno
import os
import random
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
from sample_bodies import MESHES

import scan3d
from scan3d import InputError
from scan3d.files import whole
from scan3d.files.whole import (
    RESULTS,
    check_belongs,
    locate,
    read_report,
    replacing,
    sha256,
    write_atomic,
    write_together,
)
from scan3d.results import scene_of_folder

# Crash injection: an action runs in a forked child, which ends at its k-th call of the file system, for every k.  Calls are
# found by audit events; what has none (flushing, writing, the middle of a file's contents) is replaced.
_EVENTS = {"open", "os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.truncate", "os.listdir", "os.scandir"}
# What fails on a full disk; names can still be removed and renamed.
_NEEDS_SPACE = {"open", "os.mkdir", "write", "half", "fsync"}
_KILLED = 77


class _Faults:
    """Counts the calls, and acts at one of them."""

    def __init__(self, act, kth):
        self.act, self.kth, self.count = act, kth, 0

    def __call__(self, event, path):
        if event == "open" and isinstance(path, (str, bytes)) and os.fsdecode(path).endswith((".py", ".pyc")):
            return
        self.count += 1
        self.act(event, self.count, self.kth)


def _kill(event, count, kth):
    if count == kth:
        os._exit(_KILLED)


def _interrupt(event, count, kth):
    if count == kth:
        raise KeyboardInterrupt


def _fill_disk(event, count, kth):
    if count >= kth and event in _NEEDS_SPACE:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


ACTS = {"kill": _kill, "ctrl-c": _interrupt, "full disk": _fill_disk}


def _install(faults):
    fsync, write = os.fsync, os.write

    def watched(event, arguments):
        if event == "open" and not _opens_for_writing(arguments):
            return
        if event in _EVENTS:
            faults(event, arguments[0])

    def flushed(handle):
        faults("fsync", None)
        fsync(handle)

    def written(handle, data):
        faults("write", None)
        return write(handle, data)

    def write_bytes(path, data):
        with open(path, "wb") as file:
            file.write(data[: len(data) // 2])
            file.flush()
            faults("half", path)
            file.write(data[len(data) // 2 :])

    os.fsync, os.write = flushed, written
    Path.write_bytes = write_bytes
    Path.write_text = lambda path, text, **_: path.write_bytes(text.encode())
    sys.addaudithook(watched)


def _opens_for_writing(arguments):
    _, mode, flags = arguments
    return bool(set(mode or "") & set("wax+")) if mode else bool(flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))


def run(action, how, kth):
    """Run the action in a child process with the kth call failing: True if it came to its end before that call.

    The child ends with the exit code of the fault, and nothing of it remains but its files.
    """
    child = os.fork()
    if child == 0:
        code = 1
        try:
            faults = _Faults(ACTS[how], kth)
            _install(faults)
            try:
                action()
            except BaseException:
                code = 2
            else:
                code = 0 if faults.count < kth else 3
        finally:
            os._exit(code)
    _, status = os.waitpid(child, 0)
    code = os.waitstatus_to_exitcode(status)
    assert code in (0, 2, 3, _KILLED), f"the child process ended with {code}"
    return code == 0


def every(action, how, prepare, check, step=1):
    """For k = 1, 1 + step, …: prepare, run the action with a fault at its kth call, and check; returns the number of calls."""
    kth = 1 - step
    ended = False
    while not ended:
        kth += step
        prepare()
        ended = run(action, how, kth)
        check(kth, ended)
        assert kth < 2000
    return kth - 1


can_fork = pytest.mark.skipif(not hasattr(os, "fork"), reason="the operating system can't fork a process")
# Every third call of the file system here, every call in `make trust`.
HOW = [
    pytest.param(how, step, marks=[can_fork, *([pytest.mark.trust] if step == 1 else [])], id=f"{how} {step}")
    for how in ("kill", "ctrl-c", "full disk")
    for step in (3, 1)
]
REPORT = {"schema": 1, "versions": {"scan3d": "0"}}
OLD = {name: f"old {name}".encode() * 50 for name in RESULTS if name != "report.json"}
# the new result has neither a recording nor one of the pictures
NEW = {name: f"new {name}".encode() * 60 for name in ("cloud.ply", "surface.ply", "view.html", "cloud.png")}
FOREIGN = {"notes.txt": b"of the user", ".hidden": b"as well"}


def write(place, files):
    with replacing(place) as result:
        for name, data in files.items():
            result.put(name, data)
        result.commit(REPORT)


def names(place):
    return sorted(path.name for path in place.iterdir())


def contents(place):
    return {path.name: path.read_bytes() for path in place.iterdir() if path.is_file() and path.name != "report.json"}


def seen(place):
    report = read_report(place)
    check_belongs(place, report, RESULTS)
    return {name: locate(place / name).read_bytes() for name in report.get("files", ()) if name != "report.json"}


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


@pytest.mark.slow
@pytest.mark.parametrize(("how", "step"), HOW)
def test_a_result_is_the_old_or_the_new_one(place, monkeypatch, how, step):
    out = place()
    outcomes = []

    def refuse(*_, **__):
        raise PermissionError(13, "Permission denied")

    def check(kth, ended):
        # whoever can't write sees the same as who can
        with monkeypatch.context() as patched:
            patched.setattr(os, "replace", refuse)
            patched.setattr(Path, "unlink", refuse)
            read_only = seen(out)
        found = seen(out)
        assert found in (OLD, NEW), kth
        assert read_only == found, kth
        # and so do those who list the folder afterwards
        assert contents(out) == {**found, **FOREIGN}
        outcomes.append(found == NEW)
        write(out, NEW)
        assert contents(out) == {**NEW, **FOREIGN}
        assert names(out) == sorted([*NEW, *FOREIGN, "report.json"])

    every(lambda: write(out, NEW), how, place, check, step)
    # there is one point before which it is the old result, and after which the new one
    assert outcomes == sorted(outcomes)
    assert {*outcomes} == {False, True}


@pytest.mark.slow
@pytest.mark.parametrize(("how", "step"), HOW)
def test_a_recording_has_the_table_and_the_rod_of_one_run(tmp_path, how, step):
    path = tmp_path / "log.csv"

    def files(which):
        return {"log.toml": f"{which} rod".encode() * 30, "log.csv": f"{which} table".encode() * 30}

    def check(kth, ended):
        pair = locate(path.with_suffix(".toml")).read_bytes(), locate(path).read_bytes()
        assert pair in (tuple(files("old").values()), tuple(files("new").values())), kth
        write_together(path, files("new"))
        assert contents(tmp_path) == files("new")
        assert names(tmp_path) == ["log.csv", "log.toml"]

    every(lambda: write_together(path, files("new")), how, lambda: write_together(path, files("old")), check, step)


@pytest.mark.parametrize(("how", "step"), HOW)
def test_a_single_file_is_the_old_or_the_new_one(tmp_path, how, step):
    path = tmp_path / "a.stl"

    def check(kth, ended):
        assert path.read_bytes() in (b"old", b"new"), kth
        # what was left is removed by the next run that writes any file there
        write_atomic(tmp_path / "b.stl", b"other")
        assert names(tmp_path) == ["a.stl", "b.stl"]

    every(lambda: write_atomic(path, b"new"), how, lambda: write_atomic(path, b"old"), check, step)


def test_everything_is_on_the_disk_before_the_next_step_begins(place, monkeypatch):
    """A computer that loses its power keeps what was flushed, and may keep later changes without earlier ones."""
    out, calls, replace, rename = place(), [], os.replace, os.rename

    def shown(path):
        return "work" if os.path.basename(path).startswith(whole._WORK) else os.path.basename(path)

    def flushed(handle):
        calls.append(shown(os.readlink(f"/proc/self/fd/{handle}")))

    def moved(move):
        def watched(source, to):
            calls.append(("moved", shown(to)))
            move(source, to)

        return watched

    if not os.path.isdir("/proc/self/fd"):
        pytest.skip("the operating system does not say which file is flushed")
    monkeypatch.setattr(os, "fsync", flushed)
    monkeypatch.setattr(os, "replace", moved(replace))
    monkeypatch.setattr(os, "rename", moved(rename))
    write(out, NEW)
    written = [*NEW, "report.json"]
    complete = len(written) + 3
    assert calls[:complete] == [*written, "work", ("moved", whole._COMPLETE), out.name]
    assert sorted(calls[complete:-2]) == sorted(("moved", name) for name in NEW)
    assert calls[-2:] == [("moved", "report.json"), out.name]  # the report is the last
    calls.clear()
    write_atomic(out / "a.stl", b"new")
    assert calls == ["work", ("moved", "a.stl"), out.name]


def test_of_two_runs_at_once_the_one_that_ends_last_is_there(place):
    out = place()
    with replacing(out) as first:
        first.put("cloud.ply", b"of the first")
        write(out, NEW)
        assert seen(out) == NEW
        first.commit(REPORT)
    assert seen(out) == {"cloud.ply": b"of the first"}
    assert contents(out) == {"cloud.ply": b"of the first", **FOREIGN}


def test_what_is_left_behind_is_removed_and_the_work_of_others_is_not(tmp_path, monkeypatch):
    ended = subprocess.run(
        [sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, text=True, check=True
    )
    machine, pid = whole._machine(), int(ended.stdout)
    left = [
        f"{whole._WORK}-{machine}-{pid}-0a",
        f"{whole._WORK}-{machine}-{pid}-0b.png",
        f"{whole._WORK}-00000000-1-old",
    ]
    kept = [f"{whole._WORK}-{machine}-{os.getpid()}-0a", f"{whole._WORK}-00000000-1-new", ".scan3d-notes"]
    for name in (*left, *kept):
        (tmp_path / name).write_bytes(b"") if name.endswith(".png") else (tmp_path / name).mkdir()
    os.utime(tmp_path / left[2], (0, 0))
    write_atomic(tmp_path / "a.stl", b"new")
    assert names(tmp_path) == sorted([*kept, "a.stl"])


@can_fork
def test_a_scan_needs_no_locks(tmp_path, monkeypatch, no_pictures):
    """On Lustre and some NFS they raise errors, and so does waiting for the disk on some networks."""
    import fcntl

    def refuse(*_, **__):
        raise OSError(38, "lock unavailable")

    for name in ("flock", "lockf", "fcntl"):
        monkeypatch.setattr(fcntl, name, refuse)
    monkeypatch.setattr(os, "fsync", refuse)
    scan3d.scan(MESHES / "cube.stl", tmp_path, slices=4, sweeps=4, samples=8)
    assert names(tmp_path) == [
        "cloud.ply",
        "recording.csv",
        "recording.toml",
        "report.json",
        "surface.ply",
        "view.html",
    ]


def started(*arguments):
    # without a display this class of VTK's windows can't be opened, and there are no pictures
    hidden = {"OMP_NUM_THREADS": "1", "VTK_DEFAULT_OPENGL_WINDOW": "vtkXOpenGLRenderWindow"}
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path)), **hidden}
    command = [sys.executable, "-m", "scan3d", *map(str, arguments), "--quiet"]
    return subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def until(child, condition):
    while child.poll() is None and not condition():
        time.sleep(0.0002)


def one_result(folder):
    """The hashes of the files in a folder but the report, which the program has read without complaint."""
    report = read_report(folder)
    scene_of_folder(folder, report, "mm")
    files = {path.name: sha256(path) for path in folder.iterdir() if path.is_file()}
    assert files.keys() == set(report["files"])
    del files["report.json"]
    assert files == report["sha256"]
    return files


@pytest.mark.trust
def test_a_run_that_is_killed_leaves_the_whole_result_of_it_or_of_the_one_before(tmp_path):
    """100 kills of runs of two recordings in turn: at any time, while they write, and while they move the files."""
    draw, out, expected, kept = random.Random(0), tmp_path / "out", [], []
    moments = {None: 0.0, f"{whole._WORK}-*": 0.0, whole._COMPLETE: 0.003}
    for name in ("cube", "egg"):
        mesh, log, alone = MESHES / f"{name}.stl", tmp_path / f"{name}.csv", tmp_path / name
        few = ("--slices", "4", "--sweeps", "4", "--samples", "8")
        assert started("simulate", mesh, "--out", log, *few).wait() == 0
        begun, child = time.monotonic(), started("reconstruct", log, "--out", alone)
        until(child, lambda place=alone: any(place.glob(f"{whole._WORK}-*")))
        writing = time.monotonic()
        assert child.wait() == 0
        moments |= {None: time.monotonic() - begun, f"{whole._WORK}-*": time.monotonic() - writing}
        expected.append(one_result(alone))
    assert started("reconstruct", tmp_path / "egg.csv", "--out", out).wait() == 0
    for k in range(100):
        child = started("reconstruct", tmp_path / ("cube.csv", "egg.csv")[k % 2], "--out", out)
        sign = draw.choice(list(moments))
        if sign:
            until(child, lambda sign=sign: any(out.glob(sign)))
        end = time.monotonic() + moments[sign] * draw.random()
        until(child, lambda end=end: time.monotonic() > end)
        child.kill()
        child.wait()
        kept.append(expected.index(one_result(out)))
    assert {found == k % 2 for k, found in enumerate(kept)} == {False, True}
    assert started("reconstruct", tmp_path / "cube.csv", "--out", out).wait() == 0
    assert one_result(out) == expected[0]
    assert not list(out.glob(".scan3d-*"))


# --- single files and folders ---


def test_of_files_that_belong_together_none_is_written_if_one_cannot_be(tmp_path):
    (tmp_path / "a").write_bytes(b"old")
    (tmp_path / "b").mkdir()
    with pytest.raises(InputError, match=r"can't write .*: Is a directory"):
        write_together(tmp_path / "a", {"a": b"new", "b": b"new"})
    with pytest.raises(InputError, match=r"can't write .*missing"):
        write_together(tmp_path / "missing" / "a", {"a": b"new", "b": b"new"})
    assert (tmp_path / "a").read_bytes() == b"old"
    assert names(tmp_path) == ["a", "b"]
