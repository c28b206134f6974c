"""Rows that a low-pass changes by more than their noise."""

import numpy as np
import pytest

from scan3d.laboratory import filtering

RATE, LIMIT = 1000.0, 20.0


def log(noise, snap):
    """Wrenches (n, 6) that rise slowly and fall to zero in the row `snap`, and the times (n,)."""
    clock = np.arange(20_000) / RATE
    loaded = np.where(np.arange(len(clock)) < snap, np.sin(np.pi * clock / 20), 0.0)
    size = np.array([1.0, 0.3, 0.1, 20, 5, 40])
    rng = np.random.default_rng(0)
    return size * (loaded[:, None] + noise * rng.standard_normal((len(clock), 6))), clock


@pytest.mark.parametrize("noise", [0.0, 1e-3, 1e-2])
def test_rows_next_to_a_snap_are_blurred_and_no_others(noise):
    snap = 10_000
    values, clock = log(noise, snap)
    filtered = filtering.low_pass(values, clock, LIMIT, RATE, "log")
    rows = np.flatnonzero(filtering.blurred(values, filtered, clock, LIMIT, RATE, "log"))
    assert rows.min() < snap - 10
    assert rows.max() > snap + 10
    assert np.abs(rows - snap).max() < 3 * RATE / LIMIT
    # what is left is off by little more than the noise that the filter leaves
    kept = np.setdiff1d(np.arange(len(clock)), rows)
    exact, _ = log(0.0, snap)
    off = np.abs(filtered - exact)[kept] / np.array([1.0, 0.3, 0.1, 20, 5, 40])
    assert off.max() < 2 * noise + 2e-4
    assert np.abs(filtered - exact).max() > 0.4 * 40


def test_without_a_snap_no_row_is_blurred():
    values, clock = log(1e-2, 20_000)
    filtered = filtering.low_pass(values, clock, LIMIT, RATE, "log")
    assert filtering.blurred(values, filtered, clock, LIMIT, RATE, "log").sum() == 0


def test_a_limit_near_half_of_the_rate_is_none_for_what_it_takes_away():
    values, clock = log(1e-2, 10_000)
    filtered = filtering.low_pass(values, clock, 400.0, RATE, "log")
    blurred = filtering.blurred(values, filtered, clock, 400.0, RATE, "log")
    assert blurred.mean() < 1e-2
