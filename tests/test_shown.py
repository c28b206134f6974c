"""What `print` shows of results: a few lines, with the numbers that the results hold."""

import numpy as np
import pytest
from small_scans import CUBE

import scan3d
from scan3d.bounds import Certificate
from scan3d.shown import described


@pytest.fixture(scope="module")
def result():
    return scan3d.scan(CUBE, slices=4, sweeps=4, samples=8, method="hull")


def everything(result):
    session = scan3d.Session("cylinder:80x90")
    return {
        "recording": result.recording,
        "cloud": result.cloud,
        "surface": result.surface,
        "certificate": result.certificate,
        "comparison": result.comparison,
        "bounds": result.analysis.bounds,
        "analysis": result.analysis,
        "scan": result,
        "plan": scan3d.Plan(),
        "rod": result.recording.rod,
        "session": session,
        "poses": session.ask(),
    }


def test_everything_prints_in_ten_lines_of_120_characters(result):
    for name, thing in everything(result).items():
        lines = repr(thing).splitlines()
        assert 1 <= len(lines) <= 10, name
        assert name == "plan" or max(map(len, lines)) <= 120, name


def rows(thing):
    title, *lines = repr(thing).splitlines()
    return title, {line[2:23].strip(): line[24:] for line in lines}


def test_the_rows_hold_the_numbers_of_the_results(result):
    title, cloud = rows(result.cloud)
    assert title == "Cloud"
    assert cloud["contacts"].startswith(f"{len(result.cloud)}: ")
    _, recording = rows(result.recording)
    assert recording["samples"].startswith(f"{len(result.recording)}, ")
    assert recording["noise"] == "none"
    title, comparison = rows(result.comparison)
    assert "units of the meshes" in title
    assert comparison["Hausdorff distance"].startswith(f"{result.comparison.hausdorff:.4g} (")
    _, bounds = rows(result.analysis.bounds)
    assert bounds["bound"].startswith(f"{result.analysis.bounds.bound:.4g} with 100 % confidence; parts: slices ")
    assert f"bound={result.certificate.bound:.6g}, " in repr(result.certificate)
    title, scan = rows(result)
    assert title.startswith("Scan of cube.stl: ")
    assert scan.keys() == dict(result.summary()).keys()
    assert all(value.startswith(scan[name].removesuffix("...")) for name, value in result.summary())


def test_unknown_bounds_print():
    unknown = Certificate(np.inf, np.array([np.inf, np.inf]))
    assert repr(unknown) == "Certificate(bound=inf, at_vertices: unknown at 0 of 2)"


def test_long_lines_end_with_dots():
    assert described("Title", [("name", "x" * 200)]).splitlines()[1].endswith("x...")
    assert len(described("Title", [("name", "x" * 200)]).splitlines()[1]) == 120
