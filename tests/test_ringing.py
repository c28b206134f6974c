"""Rows in which a rod rings in the air are no contacts, at any frequency, damping and sampling rate; contacts remain."""

import numpy as np
import pytest
from raw_tables import Rig, map_of, table, track, write
from shapes import unit
from small_scans import EGG

import scan3d
from scan3d.laboratory.importing import convert, load
from scan3d.laboratory.maps import read_map
from scan3d.laboratory.signals import ringing

# Moment over force of a cantilever that swings in its first mode, in its lengths: ∫ φ s ds / ∫ φ ds, φ the mode's deflection.
LEVER = 0.7265


@pytest.fixture(scope="module")
def spatial():
    return scan3d.simulate(scan3d.load_mesh(EGG), scan3d.Plan(slices=5, model="spatial", sweeps=4, samples=60))


def ring(wrench, angle, damping, size, length, rows, turn=0.0):
    """(rows, 6) what a rod shows that is let go while `wrench` (6,) bends it; `turn` is the part of a swing across that."""
    moment = unit(wrench[3:] * [1, 0, 1])
    across, rod = np.cross(moment, [0, 1, 0]), np.array([0, 1, 0])
    row = np.arange(1, rows + 1)[:, None]
    swing = np.exp(-damping * angle * row) * (np.cos(angle * row) * moment + turn * np.sin(angle * row) * across)
    return size * np.hstack([np.cross(swing, rod), LEVER * length * swing])


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("turn", [0.0, 0.8])
@pytest.mark.parametrize("angle", [0.06, 0.31, 1.1, 2.0, 2.9])
def test_swings_are_found_and_contacts_remain(spatial, angle, turn, noise):
    random, length = np.random.default_rng(int(100 * angle)), spatial.rod.length_m
    wrench = np.hstack(spatial.wrench())
    for sweep, size in ((0, 0.3), (7, 0.03), (13, 0.01)):
        rows = wrench[spatial.sweep == sweep]
        touched = np.flatnonzero(np.linalg.norm(rows[:, :3], axis=1))
        pressed = rows[touched[0] : touched[-1] + 1]
        largest = np.linalg.norm(pressed[:, :3], axis=1).max()
        swing = ring(pressed[-1], angle, 0.01, size * largest, length, int(200 / min(angle, 1)), turn)
        log = np.vstack([np.zeros((50, 6)), pressed, swing, np.zeros((50, 6))])
        sd = noise * largest * np.repeat([1, length], 3)
        found = ringing(log + sd * random.standard_normal(log.shape), sd, np.zeros(len(log), dtype=int))
        seen = np.linalg.norm(log[:, :3], axis=1) > max(8 * sd[0], 1e-3 * largest)
        kind = np.repeat([0, 1, 2, 0], [50, len(pressed), len(swing), 50])
        assert found[seen & (kind == 2)].sum() >= (0.6 if noise else 0.95) * (seen & (kind == 2)).sum()
        # those that are lost belong to the last tenth of a period before the snap
        assert found[kind == 1].sum() <= 2 + 0.6 / angle


@pytest.mark.parametrize("noise", [0.0, 1e-4, 1e-2])
def test_nothing_is_lost_of_logs_that_do_not_ring(spatial, noise):
    planar = scan3d.simulate(scan3d.load_mesh(EGG), scan3d.Plan(slices=6, sweeps=4, samples=40))
    for recording in (spatial, planar):
        force, moment = recording.force_N, recording.moment_Nm[:, None] * [0, 1]
        wrench = np.hstack(recording.wrench()) if recording.six_axis else np.hstack([force, moment])
        half = wrench.shape[1] // 2
        sd = noise * np.repeat([np.abs(wrench[:, :half]).max(), np.abs(wrench[:, half:]).max()], half)
        log = wrench + sd * np.random.default_rng(1).standard_normal(wrench.shape)
        assert not ringing(log, sd, recording.sweep)[np.linalg.norm(force, axis=1) > 8 * sd[0]].any()


@pytest.mark.slow
@pytest.mark.parametrize("rig", [Rig(), Rig(noise=0.002)], ids=["exact", "noise"])
def test_an_import_takes_ringing_for_air_and_counts_it(tmp_path, spatial, rig):
    """Every sweep ends in a swing of 12 Hz that outlasts the log's calm air."""
    log = track(spatial, air=150)
    silent = np.linalg.norm(log.wrench[:, :3], axis=1) == 0
    ends = np.flatnonzero(
        ~silent[:-1] & silent[1:] & silent[np.minimum(np.arange(len(silent) - 1) + 30, len(silent) - 1)]
    )
    rung = log.wrench.copy()
    angle = 2 * np.pi * 12 * float(np.median(np.diff(log.time)))
    for end in ends:
        stop = end + 1 + int(np.argmax(np.append(~silent[end + 1 :], True)))
        rung[end + 1 : stop] = ring(log.wrench[end], angle, 0.003, 0.05, spatial.rod.length_m, stop - end - 1)
    swung = np.linalg.norm(rung - log.wrench, axis=1) > 0
    chosen = read_map(map_of(spatial.rod, rig))
    before, after = (tmp_path / name for name in ("before.csv", "after.csv"))
    write(before, table(log, rig))
    write(after, table(log._replace(wrench=rung), rig))
    still, rings = (convert(load(path, chosen), chosen) for path in (before, after))
    assert still.summary.ringing == 0
    assert rings.summary.ringing > 0.8 * swung.sum()
    assert rings.summary.noise_force_N <= 1.2 * still.summary.noise_force_N
    assert rings.summary.sweeps == still.summary.sweeps
    # all rows stay, and no more of them are felt
    assert rings.summary.samples == still.summary.samples
    felt, right = (
        (np.linalg.norm(found.recording.force_N, axis=1) > 8 * still.summary.noise_force_N).sum()
        for found in (rings, still)
    )
    assert 0.95 * right < felt <= 1.02 * right
