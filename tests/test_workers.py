"""Worker processes: a death concerns one call, and no process outlives the one that started it."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import BrokenExecutor
from pathlib import Path

import pytest

from scan3d import InputError
from scan3d.workers import Workers


def is_alive(pid):
    """Whether a process runs; one that has ended but was not waited for does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def gone(pid):
    """Whether a process has ended, or ends soon."""
    end = time.monotonic() + 20
    while is_alive(pid) and time.monotonic() < end:
        time.sleep(0.05)
    return not is_alive(pid)


@pytest.mark.parametrize("jobs", [0, -1, True, 1.0, "2", None])
def test_the_number_of_workers_is_at_least_one(jobs):
    with pytest.raises(InputError, match=r"jobs must be a whole number of at least 1, got"):
        Workers(jobs)


@pytest.mark.parametrize(("stated", "used"), [({}, "1"), ({"OPENBLAS_NUM_THREADS": "3"}, "3")])
def test_commands_use_one_thread_for_linear_algebra_unless_told_otherwise(stated, used):
    """The threads of OpenBLAS are chosen when numpy is imported."""
    environment = {name: value for name, value in os.environ.items() if "NUM_THREADS" not in name}
    code = (
        "import io, os, sys; from contextlib import redirect_stdout; from scan3d.cli.commands import run\n"
        "with redirect_stdout(io.StringIO()):\n"
        "    code = run([])\n"
        "print(code, 'numpy' in sys.modules, os.environ['OPENBLAS_NUM_THREADS'])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], env={**environment, **stated}, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == ["0", "False", used]


@pytest.mark.slow
def test_a_worker_computes_with_one_thread_and_ignores_ctrl_c(monkeypatch):
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)
    with Workers(1) as workers:
        assert workers.submit(os.getenv, "OMP_NUM_THREADS").result() == "1"
        assert workers.submit(os.getenv, "OPENBLAS_NUM_THREADS").result() == "1"
        assert workers.submit(signal.getsignal, signal.SIGINT).result() == signal.SIG_IGN
        assert workers.submit(os.getpid).result() != os.getpid()
        with pytest.raises(ZeroDivisionError):
            workers.submit(divmod, 1, 0).result()


@pytest.mark.slow
def test_the_death_of_a_worker_concerns_its_call_only():
    with Workers(2) as workers:
        first = workers.submit(os.getpid).result()
        other = workers.submit(time.sleep, 1.0)
        dies = workers.submit(os._exit, 1)
        with pytest.raises(BrokenExecutor):
            dies.result()
        assert other.result() is None
        # the next calls find both workers
        assert len({workers.submit(os.getpid).result() for _ in range(8)} - {os.getpid()}) >= 1
        assert isinstance(first, int)


@pytest.mark.slow
def test_an_exception_ends_the_workers_at_once():
    start, workers = time.monotonic(), Workers(1)
    pid = workers.submit(os.getpid).result()
    running, waiting = workers.submit(time.sleep, 600), workers.submit(time.sleep, 600)
    with pytest.raises(KeyboardInterrupt), workers:
        raise KeyboardInterrupt
    assert time.monotonic() - start < 60
    assert gone(pid)
    for future in (running, waiting):
        assert future.cancelled() or isinstance(future.exception(), BrokenExecutor)


@pytest.mark.slow
def test_workers_that_are_just_starting_compute_nothing(tmp_path):
    workers = Workers(1)
    future = workers.submit((tmp_path / "computed").touch)
    workers.kill()
    workers.shutdown()
    assert isinstance(future.exception(), BrokenExecutor)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signal")
def test_workers_end_with_a_process_that_is_killed():
    code = (
        "import os, time\n"
        "from scan3d.workers import Workers\n"
        "if __name__ == '__main__':\n"
        "    workers = Workers(1)\n"
        "    print(workers.submit(os.getpid).result(), flush=True)\n"
        "    workers.submit(time.sleep, 600)\n"
        "    time.sleep(600)\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        pid = int(parent.stdout.readline())
        assert is_alive(pid)
        parent.kill()
    assert gone(pid)


@pytest.mark.slow
def test_no_module_in_the_current_folder_is_executed(tmp_path):
    """By a worker, or by what starts one; the environment of this process stays as it was."""
    names = ("multiprocessing", "pickle", "random", "numpy")
    here = tmp_path / "here"
    here.mkdir()
    for name in names:
        (here / f"{name}.py").write_text(f"open({str(tmp_path / name)!r}, 'w').close()\n")
    script = tmp_path / "script.py"
    script.write_text(
        "import os\nfrom scan3d.workers import Workers\n"
        "if __name__ == '__main__':\n"
        "    before = dict(os.environ)\n"
        "    with Workers(2) as workers:\n"
        "        print(workers.submit(pow, 2, 3).result(), dict(os.environ) == before)\n"
    )
    done = subprocess.run([sys.executable, str(script)], cwd=here, capture_output=True, text=True, timeout=60)
    assert done.stdout == "8 True\n", done.stderr
    assert not [name for name in names if (tmp_path / name).exists()]
