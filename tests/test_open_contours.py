"""Scans with a tolerance: slices whose contours need more contacts than their sweeps have samples for."""

from pathlib import Path

import numpy as np
import trimesh

import scan3d
from scan3d.planning.heights import open_contours
from scan3d.simulation import scan as simulated
from scan3d.simulation.scan import AxisScan
from scan3d.surfaces import Gap, enclosure

MESHES = Path(__file__).parents[1] / "meshes"
FEW_SAMPLES = {"slices": 60, "samples": 10, "friction": (0.0, 0.4)}


def scanned(name, **settings):
    body = scan3d.load_mesh(MESHES / name)
    return scan3d.simulate(body, scan3d.Plan(**FEW_SAMPLES, **settings))


def samples_of_sweeps(recording):
    return np.bincount(recording.sweep)


def relative_gaps(recording):
    """The largest gaps of all slices' contours, and of all, over the diagonal of the contacts."""
    cloud = scan3d.reconstruct(recording)
    bounds, diagonal = enclosure(cloud), np.linalg.norm(np.ptp(cloud.points, axis=0))
    return bounds.part(Gap.CONTACTS) / diagonal, bounds.bound / diagonal


def test_contours_are_swept_again_until_they_are_known_within_the_tolerance():
    recording = scanned("gem.glb", tolerance=4e-3)
    assert set(samples_of_sweeps(recording)) > {10}
    assert relative_gaps(recording)[1] < 4e-3
    without = scanned("gem.glb")
    assert set(samples_of_sweeps(without)) == {10}
    assert relative_gaps(without)[0] > 4e-3


def test_the_slices_with_wide_gaps_are_named():
    cloud = scan3d.reconstruct(scanned("gem.glb"))
    diagonal = np.linalg.norm(np.ptp(cloud.points, axis=0))
    every, largest = open_contours(cloud, 0.0)
    some, again = open_contours(cloud, 0.5 * largest / diagonal)
    none, _ = open_contours(cloud, 1.01 * largest / diagonal)
    assert largest == again
    assert len(none) == 0 < len(some) < len(every)
    assert set(some) <= set(every) <= set(cloud.slice_height)


def test_gaps_that_more_samples_do_not_close_are_left(monkeypatch):
    asked = []

    def noisy(cloud, tolerance):
        heights, _ = open_contours(cloud, tolerance)
        asked.append(len(heights))
        return heights, 1.0

    monkeypatch.setattr(simulated, "open_contours", noisy)
    recording = scanned("gem.glb", tolerance=4e-3)
    # the samples are doubled once, and then directions are sought as long as there are any
    assert max(samples_of_sweeps(recording)) == 20
    assert len(asked) < 12


# Corners of a wing's section.
WING = [
    [-89, -557], [-12, -306], [131, 313], [131, 319], [132, 320], [132, 321], [131, 331], [129, 350], [125, 359], [106, 339],
    [94, 320], [59, 235], [-61, -98], [-138, -321], [-209, -541], [-203, -603], [-198, -613], [-186, -623], [-172, -627],
    [-154, -623], [-117, -597], [-93, -566],
]  # fmt: skip


def test_contours_of_which_the_rods_tip_alone_touched_a_part_are_swept_from_further_directions(monkeypatch):
    """No normal is measured there, so that more samples do not help."""
    corners = np.array(WING, dtype=float)
    ends = [np.column_stack([corners, np.full(len(corners), z)]) for z in (0.0, 600.0)]
    body = trimesh.convex.convex_hull(np.concatenate(ends))
    plan = scan3d.Plan(slices=6, samples=16, tolerance=1e-4, friction=(0.0, 0.4))
    recording = scan3d.simulate(body, plan)
    assert relative_gaps(recording)[0] < 1e-4
    monkeypatch.setattr(AxisScan, "sweep_further", lambda *_: False)
    without = scan3d.simulate(body, plan)
    assert relative_gaps(without)[0] > 2e-4
    assert recording.sweep.max() > without.sweep.max()


def test_contours_are_known_before_close_slices_are_chosen():
    """The gaps between contacts would make the secants between close slices steep, so that hundreds of slices were needed."""
    body = scan3d.load_mesh(MESHES / "capsule.stl")
    plan = scan3d.Plan(slices=200, samples=16, tolerance=1e-3)
    recording = scan3d.simulate(body, plan)
    assert relative_gaps(recording)[1] < 1e-3
    assert len(np.unique(scan3d.reconstruct(recording).slice_height.round(6))) < 80
    assert max(samples_of_sweeps(recording)) <= 16 * 16
