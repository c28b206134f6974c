"""Threads beside the main one change no result, and an error is raised where the result of its call is asked for."""

import os
import threading

import numpy as np
import pytest

import scan3d
from scan3d.threads import begun, each, number

EGG = os.path.join(os.path.dirname(__file__), "..", "meshes", "egg.stl")


@pytest.fixture(params=["1", "3"])
def threads(request, monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", request.param)
    return int(request.param)


def test_number_is_that_of_libraries_or_of_cores(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "5")
    assert number() == 5
    monkeypatch.setenv("OMP_NUM_THREADS", "0")
    assert number() == 1
    for stated in ("", "4,2"):
        monkeypatch.setenv("OMP_NUM_THREADS", stated)
        assert number() == os.cpu_count()


def test_calls_are_in_another_thread_unless_there_is_one_only(threads):
    waiting = begun(threading.get_ident)
    inside = [waiting(), *each(lambda _: threading.get_ident(), range(3))]
    assert [ident == threading.get_ident() for ident in inside] == [threads == 1] * 4


def test_a_call_begins_before_its_result_is_asked_for(monkeypatch):
    monkeypatch.setenv("OMP_NUM_THREADS", "2")
    called = threading.Event()
    waiting = begun(called.set)
    assert called.wait(10)
    assert waiting() is None


def test_results_are_in_the_order_of_the_parts(threads):
    first = threading.Event()

    def wait_for_the_second(part):
        first.wait(10) if part == 0 and threads > 1 else first.set()
        return part**2

    assert list(each(wait_for_the_second, range(5))) == [0, 1, 4, 9, 16]


def test_exceptions_are_raised_where_the_result_is_asked_for(threads):
    waiting = begun(int, "one")
    with pytest.raises(ValueError, match="one"):
        waiting()
    results = each(int, ["1", "two"])
    assert next(results) == 1
    with pytest.raises(ValueError, match="two"):
        next(results)


def test_settings_of_numpy_for_errors_hold_in_the_thread(threads):
    with np.errstate(divide="raise"):
        waiting = begun(np.divide, 1.0, np.zeros(1))
        with pytest.raises(FloatingPointError):
            waiting()
        with pytest.raises(FloatingPointError):
            list(each(lambda divisor: np.divide(1.0, divisor), [np.ones(1), np.zeros(1)]))


@pytest.mark.parametrize(
    "settings",
    [{"slices": 12}, {"slices": 12, "noise": 1e-4}, {"slices": 6, "axis": "xyz"}],
    ids=["exact", "noise", "axes"],
)
def test_a_scan_is_the_same_with_any_number_of_threads(settings, monkeypatch):
    scans = []
    for stated in ("1", "3"):
        monkeypatch.setenv("OMP_NUM_THREADS", stated)
        scans.append(scan3d.scan(EGG, **settings))
    one, three = scans
    for name in ("points", "normals", "slice_height"):
        assert np.array_equal(getattr(one.cloud, name), getattr(three.cloud, name), equal_nan=True)
    assert np.array_equal(one.surface.vertices, three.surface.vertices)
    assert np.array_equal(one.surface.faces, three.surface.faces)
    assert one.certificate.bound == three.certificate.bound
    assert np.array_equal(one.certificate.at_vertices, three.certificate.at_vertices)
    assert one.comparison.hausdorff == three.comparison.hausdorff
