"""What several tests share: the option --no-skip, the marks of the tests, a scan, and a call of the command.

A test marked `rendering`, `browser` or `open3d` needs an off-screen renderer, Chromium or open3d; where that is missing the
test is skipped, with the command that installs it.  Tests marked `slow` are left out of the fast lane (``make fast``),
tests marked `trust` of ``make test`` too: they are the long versions of others, for ``make trust``.
"""

import functools
import importlib
import os
import shutil
import signal
import sys
from pathlib import Path

import hypothesis
import pytest

# Tests must not fail because the machine is busy, nor depend on random draws.
hypothesis.settings.register_profile("scan3d", deadline=None, derandomize=True)
hypothesis.settings.load_profile("scan3d")

_NEEDS = {
    "rendering": "nothing here can render off screen: apt-get install libegl1 libgl1",
    "browser": "there is no Chromium here: apt-get install chromium",
    "open3d": "open3d can't be imported here: apt-get install libgl1 libgomp1 libusb-1.0-0",
}


def pytest_addoption(parser):
    parser.addoption("--no-skip", action="store_true", help="fail if any test was skipped")


def _remove_bytecode():
    for folder in list(Path(__file__).parents[1].glob("[!.]*/**/__pycache__")):
        shutil.rmtree(folder, ignore_errors=True)


def pytest_configure(config):
    # a shell without job control ignores Ctrl-C in what it starts in the background, and so do all children of that
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    # without bytecode every process that a test starts, and each worker, compiles the packages before it begins
    if sys.dont_write_bytecode and not hasattr(config, "workerinput"):
        os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
        config.add_cleanup(_remove_bytecode)
    config.addinivalue_line("markers", "rendering: needs an off-screen renderer")
    config.addinivalue_line("markers", "browser: needs Chromium")
    config.addinivalue_line("markers", "open3d: needs open3d")
    config.addinivalue_line("markers", "slow: left out of the fast lane")
    config.addinivalue_line("markers", "all_samples: averages of comparisons are those outside of the tests")
    config.addinivalue_line("markers", "trust: many seeds or many bodies, for `make trust` only")


def chromium():
    return next(filter(None, map(shutil.which, ("chromium", "google-chrome", "chromium-browser"))), None)


@functools.cache
def _has(what):
    if what == "rendering":
        from scan3d.pictures import canvas

        return canvas.can_render()
    if what == "browser":
        return chromium() is not None
    try:
        importlib.import_module("open3d")
    except (ImportError, OSError):  # the package, or a library of the system, is missing
        return False
    return True


def pytest_runtest_setup(item):
    for what, sentence in _NEEDS.items():
        if item.get_closest_marker(what) and not _has(what):
            pytest.skip(sentence)


def _skipped(config):
    # with pytest-xdist the workers, which have no reporter, send their reports to the process that does
    reporter = config.pluginmanager.get_plugin("terminalreporter")
    return [] if reporter is None else reporter.stats.get("skipped", [])


def pytest_sessionfinish(session):
    if session.config.getoption("no_skip") and _skipped(session.config) and session.exitstatus == pytest.ExitCode.OK:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter, config):
    if config.getoption("no_skip"):
        for report in _skipped(config):
            terminalreporter.write_line(f"--no-skip: {report.nodeid} was skipped: {report.longrepr[2]}", red=True)


@pytest.fixture(scope="session")
def browser_path():
    return chromium()


@pytest.fixture(scope="module")
def egg():
    from small_scans import EGG, scanned

    return scanned(EGG)


@pytest.fixture(scope="module")
def cube():
    from small_scans import CUBE, scanned

    return scanned(CUBE)


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """The folder of a small scan of an egg, without pictures, beside its mesh."""
    from small_scans import scanned_folder

    return scanned_folder(tmp_path_factory.mktemp("egg"))


@pytest.fixture(scope="session")
def rig_folder(tmp_path_factory):
    """A folder of poses and of what a rig logs of an egg."""
    from small_scans import rig_logs

    return rig_logs(tmp_path_factory.mktemp("rig"))


@pytest.fixture(scope="module", autouse=True)
def few_samples(request):
    """Fewer points for the averages of comparisons, which take most of the time of a small scan.

    Tests that compare them with those of other processes ask for `all_samples`, or have the mark of that name.
    """
    from scan3d import comparison

    with pytest.MonkeyPatch.context() as patch:
        if not request.node.get_closest_marker("all_samples"):
            patch.setattr(comparison, "SOME", 1000)
        yield


@pytest.fixture
def all_samples(monkeypatch):
    """As many points for the averages of comparisons as outside of the tests."""
    from scan3d import arrays, comparison

    monkeypatch.setattr(comparison, "SOME", arrays.SOME)


@pytest.fixture
def call(capsys, monkeypatch):
    """Run the command in this process: (exit code, stdout, stderr); without lines on what takes long, which machines decide."""
    from scan3d.cli import main, terminal

    monkeypatch.setattr(terminal, "EVERY_S", 3600.0)

    def run(*arguments):
        try:
            code = main([str(argument) for argument in arguments])
        except SystemExit as leaving:
            code = leaving.code
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return run


@pytest.fixture
def undiagnosed(monkeypatch):
    """What contradicts the model does not depend on the search for its cause, which takes most of the time."""
    from scan3d.reconstruction import Diagnosis, agreement

    monkeypatch.setattr(agreement, "diagnose", lambda *_: Diagnosis("unknown", None, "", "unknown"))


@pytest.fixture
def no_pictures(monkeypatch):
    """Pictures take longer than all the rest, and are tested elsewhere."""
    monkeypatch.setattr("scan3d.pictures.canvas.can_render", lambda *_: False)
