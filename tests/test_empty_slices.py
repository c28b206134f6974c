"""A slice counts as empty only where the swept rods prove that the body does not reach it."""

import dataclasses

import numpy as np
import pytest
import trimesh

import scan3d
from scan3d.pipeline import analyse
from scan3d.reconstruction.contacts import contacts
from scan3d.reconstruction.slices import _area, _clipped, _covered, slices_of, unproven
from scan3d.recording import joined, of_rows
from scan3d.report import report, summary
from scan3d.surfaces import enclosure

SPHERE = trimesh.creation.icosphere(4, 10.0)


def out_of_reach(recording, rows, lengths):
    """The recording with the clamps of some rows moved back along the rod, and nothing felt there."""
    back = rows[:, None] * recording.axes()[:, 1] * recording.rod.length_m * lengths
    return dataclasses.replace(
        recording,
        position_m=recording.position_m - back,
        force_N=np.where(rows[:, None], 0.0, recording.force_N),
        moment_Nm=np.where(rows, 0.0, recording.moment_Nm),
    )


@pytest.fixture(scope="module")
def scanned():
    return scan3d.simulate(SPHERE, scan3d.Plan(slices=16, spacing="cosine"))


@pytest.mark.slow
def test_slices_out_of_reach_end_no_body(scanned):
    """These slices once certified 3.6e-2 of the diagonal where the truth was 9.0e-2."""
    upper = scanned.position_m[:, 2] > 0.0075
    found = contacts(out_of_reach(scanned, upper, 1.2))
    assert found.unresolved[[slice_ for slice_ in range(18) if found.slice_height[slice_] > 7.5]].all()
    bounds = enclosure(found)
    assert bounds.bound == np.inf
    assert scan3d.compare(bounds.inner, SPHERE).hausdorff > 0.05 * 20
    analysis = analyse(out_of_reach(scanned, upper, 1.2))
    data = report(analysis, settings={})
    assert data["counts"]["unproven_slices"] == found.unresolved.sum() == 5
    (certified,) = [text for name, text in summary(data)[1] if name == "certified"]
    assert "5 slices without contact prove no end" in certified
    # the same slices within reach prove that nothing is there
    assert enclosure(contacts(scanned)).bound < 0.3


def test_an_empty_slice_that_is_swept_on_one_side_proves_nothing(scanned):
    """Half of the sweeps of the slice above the sphere, those from one side, are left out, and the others are too far away."""
    above = scanned.position_m[:, 2] > 0.01
    assert 0 < above.sum() < len(above) / 10
    assert contacts(scanned).unresolved is None
    assert contacts(out_of_reach(scanned, above, 0.1)).unresolved is None
    assert contacts(out_of_reach(scanned, above, 0.9)).unresolved.sum() == 1


def test_rows_that_were_lost_prove_nothing(scanned):
    """Of the sweeps above the sphere the middle half of the rows is lost, where a touch would be."""
    above = np.unique(scanned.sweep[scanned.position_m[:, 2] > 0.01])
    rank = np.arange(len(scanned)) - np.searchsorted(scanned.sweep, scanned.sweep)
    share = rank / np.bincount(scanned.sweep)[scanned.sweep]
    lost = np.isin(scanned.sweep, above) & (share > 0.25) & (share < 0.75)
    assert contacts(of_rows(scanned, np.flatnonzero(~lost))).unresolved.sum() == 1
    # what is only thinned is as it was
    assert contacts(of_rows(scanned, np.flatnonzero(~lost | (rank % 2 == 0)))).unresolved is None


def test_a_noisy_sensor_proves_less(scanned):
    """A rod that is bent by less than it can feel may be inside the body."""
    cloud, number = contacts(scanned), slices_of(scanned, scanned.axes()[:, 2])[0]
    assert not unproven(cloud, scanned, number, 0.0).any()
    assert not unproven(cloud, scanned, number, 0.01).any()
    ends = np.isin(cloud.slice_height, [cloud.slice_height.min(), cloud.slice_height.max()])
    assert (unproven(cloud, scanned, number, 0.4) == ends).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spacing", "slices", "turns"),
    [
        ("cosine", 3, [0.8]),
        ("adaptive", 5, [0.0]),
        *(
            pytest.param(spacing, slices, [0.0, np.pi, 0.8], marks=pytest.mark.trust)
            for spacing in ("cosine", "uniform", "adaptive")
            for slices in (3, 5, 12)
        ),
    ],
)
def test_simulated_scans_prove_their_ends(spacing, slices, turns):
    for body in (
        SPHERE,
        trimesh.creation.cone(10, 25, sections=60),
        trimesh.creation.box((30, 20, 4)),
        trimesh.creation.icosphere(3).apply_scale([2, 2, 40]),
    ):
        for turn in turns:
            turned = body.copy()
            turned.apply_transform(trimesh.transformations.rotation_matrix(turn, [1, 0.3, 0]))
            cloud = contacts(scan3d.simulate(turned, scan3d.Plan(slices=slices, spacing=spacing, samples=24)))
            assert cloud.unresolved is None


@pytest.mark.parametrize("seed", range(2))
def test_clipping_and_covering_against_a_grid(seed):
    random = np.random.default_rng(seed)
    angle = np.sort(random.uniform(0, 2 * np.pi, 9))
    polygon = np.stack([np.cos(angle), np.sin(angle)], axis=1) * random.uniform(1, 3, 2)
    grid = np.stack(np.meshgrid(*[np.linspace(-3, 3, 301)] * 2), axis=-1).reshape(-1, 2)
    edge = np.roll(polygon, -1, axis=0) - polygon
    normals = np.stack([edge[:, 1], -edge[:, 0]], axis=1)
    inside = (grid @ normals.T <= (polygon * normals).sum(axis=1)).all(axis=1)
    assert _area(polygon) == pytest.approx(inside.mean() * 36, rel=0.03)
    areas = []
    covered = np.zeros(len(grid), dtype=bool)
    for turn in random.uniform(0, np.pi, 5):
        along = np.array([np.cos(turn), np.sin(turn)])
        across = np.array([-along[1], along[0]])
        values = np.array([random.uniform(0, 3), random.uniform(0, 3), random.uniform(0, 2), random.uniform(0, 2)])
        four = np.stack([along, -along, across, -across])
        areas.append((four, values))
        covered |= (grid @ four.T <= values).all(axis=1)
        part = polygon
        for normal, value in zip(four, values, strict=True):
            part = _clipped(part, normal, value)
        assert _area(part) == pytest.approx((inside & (grid @ four.T <= values).all(axis=1)).mean() * 36, abs=0.3)
        uncovered = (inside & ~covered).mean() * 36
        if uncovered > 0.05 or uncovered == 0:
            assert _covered(polygon, areas) == (uncovered == 0)


def test_a_slice_that_curved_rods_pass_beside_proves_nothing():
    """Rods bent away from a spindle lie beside it in a slice that straight ones would sweep: 3.25 mm were certified of 31."""
    spindle = trimesh.creation.icosphere(4)
    spindle.apply_scale([3, 3, 40])
    rod = scan3d.Rod(0.06, 1e-3, curvature_per_m=-5.0)
    scanned = scan3d.simulate(spindle, scan3d.Plan(rod=rod, slices=16, spacing="uniform", friction=0.2, sweeps=6))
    below = of_rows(scanned, scanned.position_m[:, 2] < 0.009)
    nothing = of_rows(below, np.arange(200))
    x = np.linspace(3.6e-3, -3.6e-3, 200)
    empty = dataclasses.replace(
        nothing,
        sweep=np.full(200, 9999),
        position_m=np.column_stack([x, np.full(200, -0.054), np.full(200, 0.012)]),
        quaternion=np.tile([1.0, 0.0, 0.0, 0.0], (200, 1)),
        force_N=np.zeros((200, 2)),
        moment_Nm=np.zeros(200),
    )
    for curved in (True, False):
        made = joined([below, empty])
        made = made if curved else dataclasses.replace(made, rod=scan3d.Rod(0.06, 1e-3))
        assert (contacts(made).unresolved is not None) == curved
