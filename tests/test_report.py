"""The report: quantities with their intervals against the true bodies."""

import re
from dataclasses import replace

import numpy as np
import pytest
import trimesh

import scan3d
from scan3d.bounds.constraints import sigmas
from scan3d.pipeline import analyse
from scan3d.report import measurands, report, summary, touched

pytestmark = pytest.mark.slow


def measured(analysis):
    found = measurands(analysis.cloud, analysis.bounds, analysis.surface, analysis.certificate)
    return {quantity["quantity"]: quantity for quantity in found}


def turned_box():
    box = trimesh.creation.box((30, 40, 25))
    box.apply_transform(trimesh.transformations.euler_matrix(0.2, -0.3, 0.4))
    return box


@pytest.fixture(scope="module")
def exact():
    return scan3d.simulate(turned_box(), scan3d.Plan(slices=12, samples=24, sweeps=8))


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
        assert low <= value <= high, name
        assert found[name]["expanded_uncertainty"] == pytest.approx(
            max(high - found[name]["value"], found[name]["value"] - low)
        )
        assert found[name]["coverage_probability"] == (0.95 if noise else 1.0)
        if np.isfinite(high) and name != "distance of the surface from the body":
            assert high - low < 0.3 * value  # the intervals say something
    assert found["volume"]["unit"] == "mm³"
    factor = found["volume"]["coverage_factor"]
    assert factor == (sigmas(len(analysis.cloud)) if noise else None)


def test_nothing_is_stated_where_the_recording_contradicts_the_model(exact):
    analysis = analyse(replace(exact, force_N=exact.force_N * [1.0, -1.0]))
    assert analysis.warnings
    for quantity in measured(analysis).values():
        assert quantity["value"] is quantity["expanded_uncertainty"] is quantity["coverage_probability"] is None
        assert quantity["interval"] == [-np.inf, np.inf]
        assert quantity["reason"] == "the recording contradicts the model"
    data = report(analysis, settings={})
    assert data["certificate"]["confidence"] is data["coverage"]["surface"] is None
    assert data["certificate"]["volume"] == [None, None]
    assert set(data["certificate"]["parts"].values()) == {None}
    assert "volume" not in dict(summary(report(analysis, settings={}))[1])


def test_intervals_of_a_body_that_is_known_to_rounding_contain_it():
    mesh = trimesh.creation.box((40, 40, 40))
    found = measured(analyse(scan3d.simulate(mesh, scan3d.Plan(slices=8)), mesh))
    for axis in "xy":
        low, high = found[f"extent along {axis}"]["interval"]
        assert low <= 40 <= high < 40 + 1e-9
        assert 0 <= found[f"extent along {axis}"]["expanded_uncertainty"] < 1e-9


def test_a_true_body_that_refutes_the_certificate_is_told(exact):
    right, wrong = (
        summary(report(analyse(exact, mesh), settings={})) for mesh in (turned_box(), trimesh.creation.box())
    )
    assert right[0].startswith("within ")
    assert "refuted" not in dict(right[1])
    assert wrong[0].startswith("refuted: the true mesh is farther away than the ")
    assert "another one, in another unit or place, or a premise" in dict(wrong[1])["refuted"]


def test_the_summary_states_the_volume_with_its_interval(exact):
    data = report(analyse(exact), settings={})
    row = dict(summary(data)[1])["volume"]
    low, high = data["measurands"][3]["interval"]
    middle, off = (float(part) for part in row.removesuffix(" mm³, certified").replace(",", "").split(" ± "))
    assert middle - off <= low < high <= middle + off


def test_what_is_stated_of_the_body_stays_stated(exact):
    """A convex body that is stated not to be convex is none for any part of the program; nor is one whose rod is wrong."""
    hollow = replace(exact, source={**exact.source, "convex": False})
    for recording in (hollow, replace(hollow, force_N=exact.force_N * [1.0, -1.0])):
        data = report(analyse(recording), settings={})
        assert data["body"]["convex"] is False
        assert data["certificate"]["bound"] == np.inf
        assert all(one["value"] is None and one["reason"] for one in data["measurands"])
        assert not any("state convex = false" in warning["message"] for warning in data["warnings"])
        words = dict(summary(data)[1])
        assert words["certified"].startswith("nothing" if data["warnings"] else "outer contours within")
    assert data["warnings"]


def test_the_spatial_model_is_refused_for_bodies_that_are_stated_not_to_be_convex(exact):
    hollow = replace(
        exact,
        source={"convex": False},
        **dict.fromkeys(("force_z_N", "moment_x_Nm", "moment_y_Nm"), np.zeros(len(exact))),
    )
    assert hollow.six_axis
    with pytest.raises(
        scan3d.InputError, match=r"spatial model bodies that are not convex are probed.*choose the planar model"
    ):
        scan3d.reconstruct(hollow, model="spatial")
    assert scan3d.reconstruct(hollow).model == "planar"


def test_places_of_patches_far_from_the_origin_are_told_apart():
    patch = {"center": [81234.5678, -3.0, 0.0], "area": 1.0, "extent": 0.25, "reason": "why"}
    words = touched({"known": 0.9, "estimated": 0.0, "unknown": [patch]}, "mm")
    assert words.endswith("in one patch 0.00025 m wide at (81.23457, -0.003, 0): why")
    assert "2.5 mm wide at (10, 0, 0)" in touched(
        {"known": 0.9, "estimated": 0.0, "unknown": [patch | {"center": [10.0, 0.0, 0.0], "extent": 2.5}]}, "mm"
    )


def test_shares_of_a_surface_add_up_and_promise_no_more_than_is_known():
    patches = [{"extent": 2.0, "center": [1.0, 0.0, 0.0]}]
    parts = np.random.default_rng(0).dirichlet([1.0, 0.1, 0.1], 200)
    for known, estimated, unknown in [*parts, (1.0, 0.0, 0.0), (0.99937, 0.00063, 0.0)]:
        coverage = {"known": known, "estimated": estimated, "unknown": patches if unknown else []}
        said = [float(part) for part in re.findall(r"([\d.]+) %", touched(coverage, "mm"))]
        assert sum(said) == pytest.approx(100)
        assert said[0] <= 100 * known + 1e-6
        assert not unknown or said[-1] >= 100 * unknown - 1e-6
