"""The child process that draws, kept for several scenes."""

import os
import signal
import threading
import time
from pathlib import Path

import pytest
from small_scans import scanned

import scan3d
from scan3d.pictures import drawing, early_drawing, rendering

MESHES = Path(__file__).parents[1] / "meshes"
JOBS = [(".png", {"view": "cloud"})]

pytestmark = pytest.mark.rendering


@pytest.fixture(scope="module")
def scenes():
    return [scanned(MESHES / name) for name in ("cube.stl", "gem.glb")]


@pytest.fixture(autouse=True)
def _nothing_kept():
    yield
    drawing.stop_shared()


def drawn(scene):
    """The pictures, and the number of the process that drew them."""
    with drawing.shared() as child:
        return child.draw(scene, JOBS), child._child.pid


@pytest.mark.slow
def test_a_process_that_is_kept_draws_the_same_pictures(scenes):
    fresh = [drawing.draw(scene, JOBS) for scene in scenes]
    kept = [drawn(scene) for scene in (*scenes, *scenes)]
    assert [pictures for pictures, _ in kept] == [*fresh, *fresh]
    assert len({number for _, number in kept}) == 1
    with drawing.Drawing(warm=True) as child:
        assert [child.draw(scene, JOBS) for scene in scenes] == fresh


@pytest.mark.slow
def test_a_process_that_was_killed_is_replaced(scenes):
    _, first = drawn(scenes[0])
    os.kill(first, signal.SIGKILL)
    drawing._shared._child.wait()
    _, second = drawn(scenes[0])
    assert second != first


@pytest.mark.slow
def test_a_process_that_crashes_is_replaced(scenes):
    with drawing.shared() as child:
        os.kill(child._child.pid, signal.SIGSTOP)  # so that it has not answered when it is killed
        os.kill(child._child.pid, signal.SIGKILL)
        with pytest.raises(drawing.DrawingError, match=r"the renderer crashed \(SIGKILL\)"):
            child.draw(scenes[0], JOBS)
    assert drawn(scenes[0])[0]


@pytest.mark.slow
def test_a_process_without_work_ends(scenes, monkeypatch):
    monkeypatch.setattr(drawing, "_CODE", "from scan3d.pictures import drawing; drawing._IDLE_S = 0.1; drawing.serve()")
    with drawing.Drawing() as child:
        child.draw(scenes[0], JOBS)
        end = time.monotonic() + 20
        while child.is_running and time.monotonic() < end:
            time.sleep(0.05)
        assert not child.is_running


@pytest.mark.parametrize(
    "hung", ["import time; time.sleep(60)", "import sys; sys.stdin.buffer.read(1); import time; time.sleep(60)"]
)
def test_a_process_that_hangs_is_ended(scenes, monkeypatch, hung):
    # the scene does not fit into the pipe: without an end, one that reads nothing would be waited for
    monkeypatch.setattr(drawing, "_CODE", hung)
    monkeypatch.setattr(drawing, "_TIMEOUT_S", 0.5)
    with drawing.Drawing() as child:
        with pytest.raises(drawing.DrawingError, match=r"^drawing took more than 0\.5 s$"):
            child.draw(scenes[0], JOBS)
        assert not child.is_running


@pytest.mark.slow
def test_two_at_once_do_not_share_a_process(scenes):
    with drawing.shared() as first, drawing.shared() as second:
        assert first._child.pid != second._child.pid
    assert drawing._shared.is_running
    assert not (first.is_running and second.is_running)


@pytest.mark.slow
def test_a_batch_in_this_process_draws_with_one_and_keeps_none(tmp_path, monkeypatch):
    started = []
    enter = drawing.Drawing.__enter__

    def counted(self):
        started.append(self)
        return enter(self)

    monkeypatch.setattr(drawing.Drawing, "__enter__", counted)
    meshes = [MESHES / "cube.stl", MESHES / "gem.glb"]
    scan3d.batch(meshes, tmp_path, slices=6, samples=40)
    assert len(started) == 1
    assert not started[0].is_running
    assert len(list(tmp_path.glob("*/surface.png"))) == 2


def test_a_scene_that_lacks_what_is_to_be_shown_does_not_end_the_process(scenes):
    with drawing.shared() as child:
        with pytest.raises(scan3d.InputError, match=r"."):
            child.draw(scenes[0], [(".png", {"view": "nonsense"})])
        assert child.draw(scenes[0], JOBS)


def test_a_process_that_is_started_early_is_there_when_it_is_needed(monkeypatch):
    monkeypatch.setattr(rendering, "can_render", lambda: True)
    early = early_drawing.EarlyDrawing()
    with early as child:
        assert child.is_running
    assert not child.is_running
    early.stop()  # once more does nothing


def test_a_process_that_is_not_needed_is_ended_while_it_starts(monkeypatch):
    may_go_on = threading.Event()

    def can_render():
        may_go_on.wait(10)
        return True

    monkeypatch.setattr(rendering, "can_render", can_render)
    monkeypatch.setattr(early_drawing, "Drawing", None)  # it must not be started
    early = early_drawing.EarlyDrawing()
    early.stop()
    may_go_on.set()
    early._starting.join(10)
    assert not early._starting.is_alive()
    assert early._drawing is None


@pytest.mark.slow
def test_what_is_to_be_drawn_can_be_given_before_the_process_is_needed(scenes):
    early = early_drawing.EarlyDrawing()
    early.begin(scenes[0], JOBS)
    with early as child:
        assert child.has_begun
        assert child.finish() == drawing.draw(scenes[0], JOBS)
        assert not child.has_begun
        assert child.draw(scenes[1], JOBS) == drawing.draw(scenes[1], JOBS)


def test_where_nothing_can_be_rendered_nothing_is_begun(scenes, monkeypatch):
    monkeypatch.setattr(rendering, "can_render", lambda: False)
    early = early_drawing.EarlyDrawing()
    early.begin(scenes[0], JOBS)
    with early as child:
        assert not child.has_begun


def test_a_process_that_reads_nothing_can_be_stopped_while_it_is_asked(scenes, monkeypatch):
    # the scene does not fit into the pipe
    monkeypatch.setattr(rendering, "can_render", lambda: True)
    monkeypatch.setattr(drawing, "_CODE", "import time; time.sleep(60)")
    early = early_drawing.EarlyDrawing()
    early._starting.join()
    early.begin(scenes[0], JOBS)
    deadline = time.monotonic() + 10
    while not early._drawing.has_begun and time.monotonic() < deadline:
        time.sleep(0.01)
    early.stop()
    early._starting.join(10)
    assert not early._starting.is_alive()


@pytest.mark.slow
def test_a_scan_draws_while_it_compares_and_its_pictures_are_those_drawn_afterwards(tmp_path, monkeypatch):
    late = []
    begin = drawing.Drawing.begin

    def counted(self, scene, jobs):
        late.append(jobs)
        begin(self, scene, jobs)

    monkeypatch.setattr(drawing.Drawing, "begin", counted)
    scan = scan3d.scan(MESHES / "gem.glb", tmp_path / "early", slices=6, samples=40, noise=1e-3)
    assert late == []
    scan.save(tmp_path / "late")
    assert len(late) == 1
    for name in ("cloud.png", "surface.png", "view.html"):
        assert (tmp_path / "early" / name).read_bytes() == (tmp_path / "late" / name).read_bytes()
