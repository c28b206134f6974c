"""Odd files and options: the commands answer in a sentence, with the right exit code, in time and without warnings."""

import os
import random
import shutil

import pytest

from tests.robustness import corpus, fuzz, runner

# Every so many cases run in all tests: the cases are in groups of their subject, so that every group of twelve has one.
_STEP = 12
# Random inputs of `make trust`, and their seed.
_RANDOM, _SEED = int(os.environ.get("FUZZ", 300)), os.environ.get("SEED", "test")


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
    assert len(made) > 200
    assert [text for case in made[::step] if (text := wrong(case, folder))] == []


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    folder = tmp_path_factory.mktemp("source")
    fuzz.warm()
    fuzz.prepare(folder)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize(
    "numbers",
    [range(12), *(pytest.param(range(k, k + 100), marks=pytest.mark.trust) for k in range(0, _RANDOM, 100))],
    ids=str,
)
def test_random_changes_of_files_and_options(source, tmp_path, numbers):
    faults = []
    for number in numbers:
        folder = tmp_path / str(number)
        argv = fuzz.attempt(random.Random(f"{_SEED}:{number}"), source, folder)
        outcome = runner.run(argv, folder)
        if outcome.fault:
            faults.append((number, argv, outcome.fault, outcome.err, outcome.trace))
        else:
            shutil.rmtree(folder)
    assert faults == []
