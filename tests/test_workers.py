"""Worker processes: a death concerns one call, and no process outlives the one that started it."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import BrokenExecutor
from pathlib import Path

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from scan3d.workers import ALGEBRA, Workers, in_one_thread


def is_alive(pid):
    """Whether a process runs; one that has ended but was not waited for does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def gone(pid):
    end = time.monotonic() + 20
    while is_alive(pid) and time.monotonic() < end:
        time.sleep(0.05)
    return not is_alive(pid)


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


def test_functions_use_one_thread_for_linear_algebra_and_give_the_others_back(monkeypatch):
    for name in ALGEBRA:
        monkeypatch.delenv(name, raising=False)

    def threads():
        return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}

    @in_one_thread
    def within():
        raise ZeroDivisionError(threads())

    with threadpool_limits(2, user_api="blas"):
        for _ in range(2):  # in a nested call as well
            with pytest.raises(ZeroDivisionError, match=r"\{1\}"), in_one_thread:
                within()
            assert threads() == {2}
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    with threadpool_limits(2, user_api="blas"), pytest.raises(ZeroDivisionError, match=r"\{2\}"):
        within()


def test_workers_have_one_thread_each_and_die_alone(monkeypatch):
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)
    with Workers(2) as workers:
        assert workers.submit(os.getenv, "OMP_NUM_THREADS").result() == "1"
        assert workers.submit(os.getenv, "OPENBLAS_NUM_THREADS").result() == "1"
        assert workers.submit(signal.getsignal, signal.SIGINT).result() == signal.SIG_IGN
        with pytest.raises(ZeroDivisionError):
            workers.submit(divmod, 1, 0).result()
        other = workers.submit(time.sleep, 1.0)
        with pytest.raises(BrokenExecutor):
            workers.submit(os._exit, 1).result()
        assert other.result() is None
        # the next calls find living workers
        assert {workers.submit(os.getppid).result() for _ in range(4)} == {os.getpid()}


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


def test_shared_work_runs_no_script_twice_and_survives_the_loss_of_a_process(tmp_path):
    """A script without ``if __name__ == "__main__"``: its results are those of one process, item by item."""
    (tmp_path / "squares.py").write_text(
        "import multiprocessing, os\n"
        "def squares(items):\n"
        "    child = multiprocessing.parent_process() is not None\n"
        "    if child and 9 in items:\n"
        "        os._exit(1)\n"
        "    return [(item**2, child) for item in items]\n"
    )
    script = tmp_path / "script.py"
    script.write_text(
        "import os, sys\n"
        "print('begins', flush=True)\n"
        f"sys.path.append({str(tmp_path)!r})\n"
        "from scan3d.workers import shared\n"
        "from squares import squares\n"
        "os.sched_getaffinity = lambda _: {0, 1, 2}\n"
        "found = shared(squares, list(range(12)), 2, 'squares')\n"
        "assert found[4:6] == [(16, True), (25, True)]\n"
        "print([square for square, _ in found], shared(squares, [3], 2, 'squares'))\n"
    )
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["begins", f"{[k**2 for k in range(12)]} [(9, False)]"]
