"""What a scan states of the body holds, whatever the body, the plan, the noise and the digits."""

import dataclasses

import pytest

from tests.robustness import bounds

pytestmark = pytest.mark.slow


def wrong(seeds, **limits):
    """Failures of the draws of some seeds, but for those that are to be expected."""
    found = []
    for seed in seeds:
        draw = bounds.drawn(seed, **limits)
        found += [
            (seed, name, numbers, str(draw)) for name, numbers in bounds.failures(draw) or () if bounds.counts(name)
        ]
    return found


def test_some_scans_are_as_stated():
    assert wrong(range(5), most=(8, 24)) == []


@pytest.mark.parametrize(
    ("seeds", "limits"),
    [
        ([101, 103, 104, 1000876], {}),  # the outer body of the last one has wide facets
        (range(200, 202), {"noise": (0.0,)}),
        (range(600, 601), {"noise": (1e-3, 3e-3), "model": "spatial"}),
    ],
    ids=["any", "exact", "in space"],
)
def test_scans_are_as_stated(seeds, limits):
    """A few of those that `tests.robustness.bounds` draws in `make trust`."""
    assert wrong(seeds, **limits) == []


@pytest.mark.parametrize("part", [pytest.param(0.0, marks=pytest.mark.trust), 0.05])
def test_false_statements_are_found(part):
    """Of a recording that states less noise than it has."""
    draw = dataclasses.replace(bounds.drawn(4, noise=(1e-3,), most=(10, 24)), digits="")

    def understated(recording):
        return dataclasses.replace(
            recording, noise_force_N=part * recording.noise_force_N, noise_moment_Nm=part * recording.noise_moment_Nm
        )

    assert bounds.failures(draw) == []
    assert bounds.failures(draw, understated)
