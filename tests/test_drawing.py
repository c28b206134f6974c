"""The child process that draws: what it draws is the same, and its end costs the pictures only."""

import contextlib
import os
import subprocess
import sys
import time
from concurrent.futures import CancelledError

import pytest
from small_scans import CUBE, FEW, RESULTS, SETTINGS, scanned

import scan3d
from scan3d import pipeline
from scan3d.pictures import canvas, drawing
from scan3d.workers import heard

pytestmark = pytest.mark.slow

JOBS = [(".png", {"view": "cloud"})]


@pytest.fixture
def renderer(monkeypatch):
    """A renderer that has been tried, and no child that is left from another test."""
    monkeypatch.setattr(canvas, "can_render", lambda *_: True)
    drawing._end_idle()
    yield
    drawing._end_idle()


class DrawnHere(contextlib.nullcontext):
    def begin(self, *what):
        self.finish = lambda: drawing._pictures(*what)


@pytest.mark.rendering
def test_a_child_draws_while_a_scan_compares_and_as_this_process_does_afterwards(tmp_path, monkeypatch):
    """Whatever its matplotlibrc."""
    (tmp_path / "matplotlibrc").write_text("text.usetex: True\naxes.linewidth: 5\n")
    monkeypatch.setenv("MATPLOTLIBRC", str(tmp_path / "matplotlibrc"))
    drawing._end_idle()
    scan = scan3d.scan(CUBE, tmp_path / "early", **SETTINGS)
    monkeypatch.setattr(pipeline, "Drawing", lambda: DrawnHere(DrawnHere()))
    scan.save(tmp_path / "late")
    for name in ("cloud.png", "surface.png", "view.html"):
        assert (tmp_path / "early" / name).read_bytes() == (tmp_path / "late" / name).read_bytes()


@pytest.mark.parametrize(
    ("code", "sentence"),
    [
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", r"the renderer crashed \(SIGSEGV\)"),
        ("raise MemoryError('no room')", r"the process that draws has failed \(MemoryError: no room\)"),
        ("import sys; sys.exit(3)", r"the process that draws has failed \(exit code 3\)"),
        ("import time; time.sleep(60)", r"drawing took more than 0\.5 s"),  # the scene does not fit into the pipe
    ],
)
@pytest.mark.usefixtures("renderer")
def test_a_child_that_fails(monkeypatch, code, sentence):
    monkeypatch.setattr(drawing, "_CODE", code)
    if "took" in sentence:
        monkeypatch.setattr(drawing, "_TIMEOUT_S", 0.5)
    with pytest.raises(drawing.DrawingError, match=sentence):
        drawing.draw(scanned(CUBE), JOBS)


def test_the_child_is_the_trial_of_the_renderer(monkeypatch):
    """Unless the block is left before."""
    monkeypatch.setattr(canvas, "_is_known", None)
    monkeypatch.setattr(drawing, "_CODE", "import time; time.sleep(60)")
    with drawing.Drawing() as left:
        pass
    assert isinstance(left._drawn.exception(60), CancelledError)
    assert canvas._is_known is None
    monkeypatch.setattr(drawing, "_CODE", "import sys; sys.exit(3)")
    with pytest.raises(canvas.NoRendererError):
        drawing.draw(scanned(CUBE), JOBS)
    assert canvas._is_known is False


@pytest.mark.rendering
@pytest.mark.usefixtures("renderer")
def test_a_child_that_has_drawn_draws_the_next_scene_alike():
    once, again = (
        (drawing.draw(scanned(CUBE), JOBS), [child.process.pid for child in drawing._IDLE]) for _ in range(2)
    )
    assert once == again


@pytest.mark.rendering
def test_frames_of_a_movie_are_counted_while_a_child_draws_them():
    told = []
    with heard(lambda *what: told.append(what)):
        drawing.draw(scanned(CUBE), [(".gif", {"frames": 3})])
    assert told == [("frames", done, 3) for done in range(3)]


@pytest.mark.usefixtures("renderer")
def test_a_renderer_that_crashes_costs_the_pictures_only(tmp_path, monkeypatch, call):
    monkeypatch.setattr(drawing, "_CODE", "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    out, sentence = tmp_path / "out", "the renderer crashed (SIGSEGV)"
    code, _, err = call("scan", CUBE, "--out", out, *FEW)
    assert (code, err) == (0, f"scan3d: no pictures: {sentence}; all other files are written\n")
    assert {path.name for path in out.iterdir()} == RESULTS
    assert call("show", out, "--screenshot", tmp_path / "a.png") == (1, "", f"scan3d: {sentence}\n")
    assert not (tmp_path / "a.png").exists()


@pytest.mark.rendering
def test_a_child_ends_with_the_process_that_started_it():
    code = (
        "import os, time; from scan3d.pictures import drawing\n"
        "child = drawing.Drawing()\n"
        "while child._child is None: time.sleep(0.01)\n"
        "print(child._child.process.pid, flush=True); os.kill(os.getpid(), 9)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)

    end = time.monotonic() + 20
    with contextlib.suppress(ProcessLookupError):
        while True:
            os.kill(int(done.stdout), 0)
            assert time.monotonic() < end
            time.sleep(0.01)
