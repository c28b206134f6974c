"""What the certificate assumes: the rod is tested by sweeps over the same place, so is convexity, and the report says so."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import trimesh

import planar
import scan3d
from scan3d.pipeline import analyse
from scan3d.reconstruction import checked
from scan3d.reconstruction.agreement import LARGEST
from scan3d.reconstruction.contacts import contacts
from scan3d.recording import of_rows
from scan3d.report import report, summary
from tests.robustness import faults
from tests.robustness.bounds import false_statements
from tests.robustness.shot_rods import noisy
from tests.wrong_recordings import scaled

pytestmark = pytest.mark.slow

BODY = trimesh.creation.icosphere(subdivisions=3).apply_transform(np.diag([14, 8, 10, 1.0]))
ROD = replace(scan3d.Rod.of_length(0.028), diameter_m=0.0)


@cache
def simulated(rod):
    return scan3d.simulate(BODY, scan3d.Plan(slices=6, samples=40, friction=0.3, spacing="cosine", rod=rod))


def recorded(noise=0.0, rod=ROD, gains=(1.0, 1.0, 1.0), seed=0):
    """A recording by a rod that may be another one than the straight, uniform one that it states, with gains of the sensor."""
    recording = scaled(*gains)(replace(simulated(rod), rod=ROD))
    return noisy(recording, noise, np.random.default_rng(seed))


def relative_error(recording):
    rig = scan3d.reconstruct(recording).calibration
    return 0.0 if rig is None else rig.relative


def tapered(part):
    table = [(s * ROD.length_m, (1 - part * s) ** 4 * ROD.bending_stiffness_Nm2) for s in np.linspace(0, 1, 11)]
    return replace(ROD, bending_stiffness_Nm2=table)


CURVED = replace(ROD, curvature_per_m=0.005 / ROD.length_m)
WRONG = {
    "curved": {"rod": CURVED},
    "curved away": {"rod": replace(ROD, curvature_per_m=-0.005 / ROD.length_m)},
    "tapered": {"rod": tapered(0.01)},
    "clamp": {"rod": replace(ROD, clamp_compliance_rad_per_Nm=np.radians(0.05) / ROD.moment_unit_Nm)},
    "gain of fx": {"gains": (1.01, 1.0, 1.0)},
    "gain of fy": {"gains": (1.0, 1.003, 1.0)},
    "gain of mz": {"gains": (1.0, 1.0, 0.997)},
}


# Of these the relative error is found as well as the bounds that allow for it.
BOUNDED = [("curved", 1e-3), ("tapered", 0.0)]


@pytest.mark.parametrize("noise", [0.0, 1e-4, 1e-3])
def test_a_right_recording_has_no_relative_error(noise):
    assert relative_error(recorded(noise)) == 0.0


@pytest.mark.parametrize(
    ("wrong", "noise"),
    [
        pytest.param(wrong, noise, marks=() if (k + bool(noise)) % 2 else pytest.mark.trust)
        for k, wrong in enumerate(WRONG)
        for noise in (0.0, 1e-3)
        if (wrong, noise) not in BOUNDED
    ],
)
def test_sweeps_over_the_same_place_show_the_relative_error(wrong, noise):
    assert 1e-5 < relative_error(recorded(noise, **WRONG[wrong])) <= LARGEST


def test_a_force_so_large_that_no_error_of_the_wrench_changes_a_contact_is_a_contradiction(undiagnosed):
    box = trimesh.creation.box((20, 30, 40))
    recording = scaled(1e12, 1, 1)(scan3d.simulate(box, scan3d.Plan(slices=4, samples=20)))
    assert checked(recording, scan3d.reconstruct(recording)).contradictions


def test_an_error_that_is_too_large_is_a_contradiction(undiagnosed):
    recording = recorded(1e-4, rod=tapered(0.1))
    cloud = scan3d.reconstruct(recording)
    assert cloud.calibration is None
    assert checked(recording, cloud).contradictions


@pytest.mark.parametrize(
    ("wrong", "noise"),
    [
        *BOUNDED,
        *(pytest.param(*case, marks=pytest.mark.trust) for case in (("gain of mz", 1e-4), ("clamp", 1e-3))),
    ],
)
def test_bounds_allow_for_the_relative_error(wrong, noise):
    """Without it, curvature of 0.5 % of 1/L makes the extents false, and the others take the certificate away."""
    analysis = analyse(recorded(noise, **WRONG[wrong]), BODY, "hull")
    assert not analysis.warnings
    assert 1e-5 < analysis.cloud.calibration.relative <= LARGEST
    assert np.isfinite(analysis.certificate.bound)
    assert false_statements(BODY, analysis) == []
    assert analysis.recording.rig is None  # it is no part of the files
    data = report(analysis, settings={})
    rows = dict(summary(data)[1])
    assert "of the wrench: bounds allow for that, and no more" in rows["tested"]
    named = analysis.diagnosis
    assert named is None or "the bounds hold if no more of the wrench is wrong" in named.message
    assert data["certificate"]["relative_error"] == analysis.cloud.calibration.relative


@pytest.mark.parametrize("fault", ["none", "weight of steel 0.3x50"])
def test_nothing_is_false_for_a_rod_that_was_integrated_on_its_own(fault):
    """A short version of `tests.robustness.faults`: a polytope, which few places show to be touched by another rod."""
    found = faults.outcome(1, 6, 1e-3, fault)
    assert found.false == []
    assert found.cause != "FALSE"
    assert (found.relative > 0) == (fault != "none")
    assert np.isfinite(found.bound)


@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize(("phase", "code"), [("TIP", "inside-hull"), ("TANGENTIAL", "beyond-tangent")])
def test_a_contact_in_a_dent_contradicts_convexity(phase, code, noise, undiagnosed):
    recording = recorded(noise)
    cloud = contacts(recording)
    touched = np.flatnonzero(cloud.phase == planar.Phase[phase])
    row = touched[len(touched) // 2]
    rows = touched[len(touched) // 2 : len(touched) // 2 + 3] if noise else [row]
    position = recording.position_m.copy()
    # with noise one row alone would be left out as a wild one
    position[cloud.row[rows]] -= 0.03 * ROD.length_m * cloud.in_plane_normals[row]
    dented = replace(recording, position_m=position)
    cloud = scan3d.reconstruct(dented)
    assert cloud.calibration is None
    found = checked(dented, cloud).contradictions
    # that the body is not convex is a finding of its own where the other sweeps agree with it
    assert not cloud.convex or code in [each.code for each in found]


def test_the_report_says_what_is_assumed_and_what_was_tested():
    analysis = analyse(recorded(1e-4), BODY, "hull")
    data = report(analysis, settings={})["certificate"]
    body, rod, noise = data["premises"]
    assert data["premise"] == "; ".join(each["assumed"] for each in (body, rod, noise))
    assert (body["tested"], rod["tested"], noise["tested"]) == (True, True, True)
    assert "sweeps agree at the places that several of them touched" in rod["outcome"]
    one_sweep = recorded(1e-4)
    first = np.array([np.flatnonzero(one_sweep.sweep == k)[0] for k in np.unique(one_sweep.sweep)])
    heights = np.round(one_sweep.position_m[first, 2], 9)
    chosen = np.unique(heights, return_index=True)[1]
    kept = np.isin(one_sweep.sweep, one_sweep.sweep[first[chosen]])
    rod = report(analyse(of_rows(one_sweep, kept), None, "hull"), settings={})["certificate"]["premises"][1]
    assert not rod["tested"]
    assert rod["outcome"] == "not tested: no two sweeps touched the same place"
