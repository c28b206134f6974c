"""The report: quantities with their intervals against the true bodies."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

import scan3d
from scan3d.bounds.constraints import sigmas
from scan3d.pipeline import analyse
from scan3d.report import measurands, report, summary


def measured(analysis):
    found = measurands(analysis.cloud, analysis.bounds, analysis.surface, analysis.certificate)
    return {quantity["quantity"]: quantity for quantity in found}


def turned_box():
    box = trimesh.creation.box((30, 40, 25))
    box.apply_transform(trimesh.transformations.euler_matrix(0.2, -0.3, 0.4))
    return box


@pytest.fixture(scope="module")
def exact():
    """The recording of the box in a few slices, without noise."""
    return scan3d.simulate(turned_box(), scan3d.Plan(slices=12, samples=24, sweeps=8))


@pytest.mark.slow
@pytest.mark.parametrize(("model", "noise"), [("planar", 0.0), ("planar", 1e-4), ("spatial", 1e-4)])
def test_the_intervals_contain_the_true_extents_and_volume(model, noise):
    mesh = turned_box()
    size = dict(slices=6, sweeps=4, samples=16) if model == "spatial" else dict(slices=12, samples=24)
    plan = scan3d.Plan(friction=0.2, model=model, noise=noise, **size)
    analysis = analyse(scan3d.simulate(mesh, plan), mesh)
    assert not analysis.warnings
    found = measured(analysis)
    true = {f"extent along {axis}": extent for axis, extent in zip("xyz", mesh.extents, strict=True)}
    true |= {"volume": mesh.volume, "distance of the surface from the body": analysis.comparison.hausdorff}
    assert list(found) == list(true)
    for name, value in true.items():
        low, high = found[name]["interval"]
        assert low - 1e-9 <= value <= high + 1e-9, name
        assert found[name]["expanded_uncertainty"] == pytest.approx(
            max(high - found[name]["value"], found[name]["value"] - low)
        )
        assert found[name]["coverage_probability"] == (0.95 if noise else 1.0)
        if np.isfinite(high) and name != "distance of the surface from the body":
            assert high - low < 0.3 * value  # the intervals say something
    assert found["volume"]["unit"] == "mm³"
    factor = found["volume"]["coverage_factor"]
    assert factor == (sigmas(len(analysis.cloud)) if noise else None)


@pytest.mark.slow
def test_nothing_is_stated_where_the_recording_contradicts_the_model(exact):
    analysis = analyse(replace(exact, force_N=exact.force_N * [1.0, -1.0]))
    assert analysis.warnings
    for quantity in measured(analysis).values():
        assert quantity["coverage_probability"] == 0.0
        assert quantity["interval"][1] == np.inf
    assert "volume" not in dict(summary(report(analysis, settings={}))[1])


@pytest.mark.slow
def test_the_summary_states_the_volume_with_its_interval(exact):
    data = report(analyse(exact), settings={})
    row = dict(summary(data)[1])["volume"]
    low, high = data["measurands"][3]["interval"]
    middle, off = (float(part) for part in row.removesuffix(" mm³, certified").replace(",", "").split(" ± "))
    assert middle - off <= low < high <= middle + off
