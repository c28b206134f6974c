"""Odd files and options: the commands answer in a sentence, with the right exit code, in time and without warnings."""

import random
import shutil
from pathlib import Path

import pytest

from scan3d.cli.commands import COMMANDS
from tests.robustness import corpus, fuzz, runner

# Every so many cases run in all tests: the cases are in groups of their subject, so that every group of twelve has one.
_STEP = 12


@pytest.fixture(scope="module")
def cases(tmp_path_factory):
    folder = tmp_path_factory.mktemp("corpus")
    made = corpus.make(folder)
    fuzz.warm()
    return folder, made


def wrong(case, folder):
    """What is wrong with the outcome of a case, empty if nothing is."""
    outcome = runner.run(case.argv, folder)
    found = outcome.fault
    if not found and case.code >= 0 and outcome.code != case.code:
        found = f"exit code {outcome.code}, expected {case.code}"
    if not found and case.message not in outcome.err:
        found = f"expected {case.message!r}"
    if not found and outcome.warnings:
        found = outcome.warnings[0]
    return f"{case.name}: {found}: {outcome.err}{outcome.trace}" if found else ""


@pytest.mark.slow
@pytest.mark.parametrize("step", [_STEP, pytest.param(1, marks=pytest.mark.trust)])
def test_odd_files_and_options(cases, step):
    folder, made = cases
    assert len(made) > 400
    assert [text for case in made[::step] if (text := wrong(case, folder))] == []


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    """The right files that the fuzzer changes."""
    folder = tmp_path_factory.mktemp("source")
    fuzz.warm()
    fuzz.prepare(folder)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("count", [30, pytest.param(300, marks=pytest.mark.trust)])
def test_random_changes_of_files_and_options(source, tmp_path, count):
    faults = []
    for number in range(count):
        folder = tmp_path / str(number)
        argv = fuzz.attempt(random.Random(f"test:{number}"), source, folder)
        outcome = runner.run(argv, folder)
        if outcome.fault:
            faults.append((number, argv, outcome.fault, outcome.err, outcome.trace))
    assert faults == []


@pytest.mark.slow
def test_random_changes_are_made_for_every_command(source, tmp_path):
    tried = set()
    for number in range(250):
        folder = tmp_path / "attempt"
        tried.add(fuzz.attempt(random.Random(f"command:{number}"), source, folder)[0])
        shutil.rmtree(folder)
    assert tried == {*COMMANDS} - {"doctor", "completion", "demo"}  # which read no files


@pytest.mark.slow
def test_the_runner_notices_faults(tmp_path, monkeypatch):
    """The checks of the checks: what a command may do wrong is seen."""

    def outcome(action, seconds=20):
        monkeypatch.setattr(runner, "SECONDS", seconds)
        monkeypatch.setattr(runner, "MEMORY", 1 << 28)
        monkeypatch.setitem(COMMANDS, "doctor", action)
        return runner.run(["doctor"], tmp_path).fault

    def fill():
        import numpy as np

        return int(np.ones(5 << 23).sum()) * 0

    def hang():
        while True:
            pass

    def warn():
        import sys

        sys.stderr.write("RuntimeWarning: divided\n")
        return 0

    assert outcome(lambda: 0) == ""
    assert outcome(lambda: 1 // 0) == "traceback"
    assert outcome(lambda: 5) == "exit code 5"
    assert outcome(lambda: 1) == "no sentence"
    assert outcome(warn) == "warning on stderr"
    assert outcome(fill) == "memory"
    assert outcome(hang, seconds=1) == "hang"


def test_memory_is_stated_in_the_refusal(tmp_path):
    case = next(case for case in corpus._options() if case.argv[-1] == "--slices=1000000000")
    (tmp_path / "box.stl").write_bytes(Path("meshes/cube.stl").read_bytes())
    err = runner.run(case.argv, tmp_path).err
    assert "needs about" in err
    assert "and this machine has" in err
