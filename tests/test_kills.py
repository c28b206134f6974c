"""Runs that are killed from outside; `python tests/robustness/kills.py` kills a hundred."""

import importlib.util
import os
from pathlib import Path

import pytest


@pytest.mark.parametrize("count", [pytest.param(4, marks=pytest.mark.slow), pytest.param(9, marks=pytest.mark.trust)])
@pytest.mark.skipif(os.name == "nt", reason="an open file can't be moved there while it is read")
def test_a_killed_run_leaves_the_whole_earlier_or_the_whole_new_result(tmp_path, count):
    path = Path(__file__).parent / "robustness" / "kills.py"
    spec = importlib.util.spec_from_file_location("kills", path)
    kills = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(kills)
    counts = kills.kills(count, tmp_path, seed=1)
    assert counts["earlier result"] + counts["new result"] == count
