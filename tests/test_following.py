"""Contacts by moments alone, along sweeps: against the sweeps in plane and space that made them, and against drawn noise."""

import numpy as np
import pytest
from raw_tables import POSED, si_map, write_numbers

import planar
import scan3d
from planar.channels import Frames, by_push, follow
from scan3d.errors import InputError
from scan3d.laboratory.one_sweep import OneSweep, read_sweep, reconstruct_sweep
from scan3d.pipeline import analyse
from scan3d.reconstruction.agreement import checked
from scan3d.reconstruction.contacts import contacts
from scan3d.recording import Known, completed, of_rows
from scan3d.report import report
from scan3d.spatial import inverse
from scan3d.spatial.bodies import Ellipsoid
from scan3d.spatial.sweeping import sweep

pytestmark = pytest.mark.slow


def pushed(sweep):
    """The rows of a sweep in which the moment can be felt, and their frames."""
    rows = np.flatnonzero(sweep.m0z > 1e-9)
    n = len(rows)
    place = np.column_stack([sweep.x0[rows], np.zeros(n)])
    return rows, Frames(np.zeros(n, dtype=int), place, np.broadcast_to(np.eye(2), (n, 2, 2)), np.zeros((n, 2)))


@pytest.mark.parametrize("samples", [40, 80, 400])
def test_a_push_tells_where_a_sweep_begins(samples):
    rng, far, known = np.random.default_rng(0), [], 0
    for _ in range(12):
        axes, centre = rng.uniform((0.3, 0.2), (0.55, 0.5)), (0.0, rng.uniform(0.6, 0.9))
        swept = planar.sweep(planar.Ellipse(axes, centre, rng.uniform(-1, 1)), rng.uniform(0, 0.5), samples=samples)
        rows, frames = pushed(swept)
        start, sd = by_push(frames, swept.m0z[rows])
        if swept.phase[rows[0]] == planar.Phase.TIP:
            assert np.isnan(start)
        elif np.isfinite(start):
            far.append(abs(start - swept.s1[rows[0]]) / sd)
            known += sd < 0.05
        # of a rod that is bent already nothing is told
        later = Frames(*(part[samples // 8 :] for part in frames))
        assert np.isnan(by_push(later, swept.m0z[rows[samples // 8 :]])).all()
    assert known >= 6
    assert max(far) < 2, far


def test_touches_at_a_fixed_base_are_read_row_by_row():
    # a body that comes against the rod of a clamp that stays: circles of several sizes and places
    rng, rows, circles = np.random.default_rng(3), [], []
    for _ in range(12):
        circle = planar.Circle(rng.uniform(0.2, 0.5), (0.0, rng.uniform(0.6, 0.9)))
        swept = planar.sweep(circle, rng.uniform(0, 0.4), samples=20)
        k = int(rng.choice(np.flatnonzero(np.hypot(swept.f0x, swept.f0y) > 0.1)))
        rows.append([swept.f0x[k], swept.f0y[k], swept.m0z[k]])
        circles.append(planar.Circle(circle.radius, (-swept.x0[k], circle.center[1])))
    found = reconstruct_sweep(OneSweep(np.zeros(12), *np.array(rows).T))
    assert found.touching.all()
    off = [circle.distance(place[None])[0] for circle, place in zip(circles, found.contacts.point, strict=True)]
    assert np.abs(off).max() < 1e-9


AXES, LENGTH = np.array([0.9, 0.675, 0.45]), 0.06


def test_logs_of_two_moments_in_space_are_imported(tmp_path):
    heights, n, noise = np.array([-0.2, 0.05, 0.25]), 80, 1e-4
    position = np.zeros((3, n, 3))
    position[..., 0], position[..., 1], position[..., 2] = np.linspace(1.0, 0.6, n), -0.55, heights[:, None]
    swept = sweep(Ellipsoid(AXES), position, np.tile(np.eye(3), (3, 1, 1)), 0.0, substeps=2)
    touching = np.isfinite(swept.s1)[..., None]
    force, moment = (np.where(touching, part, 0.0).reshape(-1, 3) for part in (swept.force, swept.moment))
    true = inverse.reconstruct(force, moment, tolerance=0.3).point + position.reshape(-1, 3)
    unit, place, chi = 1e-4 / LENGTH, LENGTH * position.reshape(-1, 3), []
    columns, log = [np.repeat(np.arange(3), n), place, np.tile([1.0, 0, 0, 0], (3 * n, 1))], tmp_path / "log.csv"

    def read(**known):
        rod, told = scan3d.Rod(LENGTH, 1e-4), dict(noise={"moment_Nm": noise * unit}, known=known)
        return scan3d.import_table(log, si_map(rod, [""] * 3, ["mx", "", "mz"], **told))

    for seed in range(2):
        measured = (moment + noise * np.random.default_rng(seed).standard_normal(moment.shape))[:, [0, 2]] * unit
        write_numbers(log, f"{POSED},mx,mz", *columns, measured)
        scan3d.write_recording(read(friction=0), tmp_path / "done.csv", overwrite=True)
        recording = scan3d.read_recording(tmp_path / "done.csv")
        cloud = scan3d.reconstruct(recording)
        assert len(cloud) > 0.8 * touching.sum()
        # nothing contradicts, and nothing is certified
        assert not checked(recording, cloud).contradictions
        assert report(analyse(recording), settings={})["certificate"]["missing"].startswith(
            "the forces follow from the moments"
        )
        x = recording.position_m[cloud.row] / LENGTH
        row = np.abs(x[:, None, [0, 2]] - position.reshape(-1, 3)[None, :, [0, 2]]).sum(axis=2).argmin(axis=1)
        off, spread = cloud.points / (1000 * LENGTH) - true[row], cloud.covariance / (1000 * LENGTH) ** 2
        chi.append(np.einsum("ni,nij,nj->n", off, np.linalg.inv(spread + 1e-14 * np.eye(3)), off).mean() / 3)
        assert np.median(np.linalg.norm(off, axis=1)) < 1e-3
        normal = true[row] / AXES**2
        turned = np.cross(normal, cloud.normals) / np.linalg.norm(normal, axis=1)[:, None]
        assert np.median(np.linalg.norm(turned, axis=1)) < 0.01
    assert 0.5 < np.mean(chi) < 1.5, chi
    # of the moment about z alone friction may be known; here every sweep leaves the plane
    with pytest.raises(InputError, match="tangential contacts with a known friction only"):
        read(contact="tip")


@pytest.mark.parametrize(
    ("channel", "noise", "of_axial"),
    [("force", 1e-8, 0), ("force", 1e-4, 0), ("across", 1e-4, 1e-4), ("across", 5e-4, 5e-5)],
)
def test_friction_is_known_in_space(channel, noise, of_axial):
    """Two moments, and the force along the rod beside them, of sweeps in which the contact slips sideways."""
    exact, friction = noise < 1e-6, 0.3
    n = 160 if exact else 40
    position = np.zeros((2, n, 3))
    position[..., 0], position[..., 1], position[..., 2] = np.linspace(1, 0, n), -0.6, np.array([-0.2, 0.25])[:, None]
    swept = sweep(Ellipsoid(AXES), position, np.tile(np.eye(3), (2, 1, 1)), friction, substeps=8)
    force, moment = (np.nan_to_num(part).reshape(-1, 3) for part in (swept.force, swept.moment))
    place, axes, rng = position.reshape(-1, 3), np.tile(np.eye(3), (2 * n, 1, 1)), np.random.default_rng(0)
    true = inverse.reconstruct(force, moment, tolerance=1e-6)
    moment = moment + noise * rng.standard_normal(moment.shape)
    axial = force[:, 1] + of_axial * rng.standard_normal(2 * n)
    moment[:, 1] = 0
    touching = (np.linalg.norm(moment, axis=1) > 8 * noise) & (true.phase == planar.Phase.TANGENTIAL)
    along = (axial if channel == "across" else None, of_axial)
    known = Known(friction=friction, channel=channel)
    found, moment, covariance = known.follow(
        touching, np.repeat([0, 1], n), place, axes, moment, noise, planar.Rod(), along, in_space=True
    )
    rows = np.flatnonzero(touching & np.isfinite(found[:, 0]))
    assert len(rows) > 0.9 * touching.sum()
    off = inverse.reconstruct(found[rows], moment[rows], tolerance=0.3).point - true.point[rows]
    spread = inverse.errors(found[rows], moment[rows], (0.0, 0.0), covariance=covariance[rows]).point
    chi = np.einsum("ni,nij,nj->n", off, np.linalg.inv(spread + 1e-14 * np.eye(3)), off)
    # 95 % of a normal distribution, of rows whose errors are alike
    assert exact or np.mean(chi < 7.8) > 0.8
    assert np.median(np.linalg.norm(off, axis=1)) < (1e-5 if exact else 2e-4)


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_recordings_of_the_moment_alone_are_completed(friction, tmp_path):
    contour, unit = planar.Ellipse((0.5, 0.3), (0.0, 0.75), 0.3), 1e-4 / LENGTH
    swept = planar.sweep(contour, friction, samples=120)
    kept = np.isfinite(swept.m0z)
    n = int(kept.sum())
    position = np.column_stack([LENGTH * swept.x0[kept], np.zeros((n, 2))])
    columns = np.zeros(n), position, np.tile([1.0, 0, 0, 0], (n, 1)), swept.m0z[kept] * unit
    write_numbers(tmp_path / "log.csv", "sweep,x_m,y_m,z_m,qw,qx,qy,qz,mz_Nm", *columns)
    rod = "[rod]\nlength_m = 0.06\nbending_stiffness_Nm2 = 1e-4\n"
    (tmp_path / "log.toml").write_text(f"{rod}[noise]\nmoment_Nm = {1e-6 * unit}\n[known]\nfriction = {friction}\n")
    recording = scan3d.read_recording(tmp_path / "log.csv")
    cloud = contacts(recording)
    rows = np.searchsorted(-swept.x0, -recording.position_m[cloud.row, 0] / LENGTH - 1e-9)
    assert len(cloud) > 0.8 * (swept.phase == planar.Phase.TANGENTIAL).sum()
    off = cloud.points[:, :2] / (1000 * LENGTH) - swept.point[rows]
    assert np.median(np.linalg.norm(off, axis=1)) < 2e-3
    assert (np.linalg.norm(off, axis=1) < 4 * cloud.place_sd / (1000 * LENGTH)).mean() > 0.95
    # a sweep that begins with a bent rod can't be followed
    rows = recording.moment_Nm > 0.5 * recording.moment_Nm.max()
    with pytest.raises(InputError, match="each has to begin with a small push"):
        completed(of_rows(recording, rows))


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_errors_by_the_moment_alone_are_those_of_drawn_noise(friction):
    swept = planar.sweep(planar.Ellipse((0.5, 0.3), (0.0, 0.8), 0.3), friction, samples=40)
    rows = np.flatnonzero((swept.phase == planar.Phase.TANGENTIAL) & (swept.m0z > 0.05))
    rows = rows[: np.argmin(np.append(np.diff(rows) == 1, False)) + 1]
    draws, noise, sd, rng = 150, 1e-5, 2e-5, np.random.default_rng(1)
    n, base, moment = len(rows), swept.x0[rows], swept.m0z[rows]
    frames = Frames(
        np.repeat(np.arange(draws), n),
        np.column_stack([np.tile(base, draws), np.zeros(n * draws)]),
        np.broadcast_to(np.eye(2), (n * draws, 2, 2)),
        np.zeros((n * draws, 2)),
    )
    start = float(swept.s1[rows[0]])
    told = {"friction": friction, "noise": noise, "start_sd": sd}
    drawn = np.tile(moment, draws) + noise * rng.standard_normal(n * draws)
    found = follow(frames, drawn, start + sd * rng.standard_normal(draws), **told)
    exact = follow(Frames(*(part[:n] for part in frames)), moment, np.array([start]), **told)
    # the error of the step is that of the sweep, not of the draws
    step = follow(Frames(*(part[:n] for part in frames)), moment, np.array([start]), friction=friction)
    by_noise = (exact.covariance - step.covariance)[:, :3, :3]
    stated = planar.errors(*exact.force.T, moment, noise=(0.0, 0.0), covariance=by_noise)
    place = planar.reconstruct(frames.place[:, 0], *found.force.T, drawn, tolerance=1e-3).point.reshape(draws, n, 2)
    off = place - planar.reconstruct(base, *exact.force.T, moment, tolerance=1e-3).point
    chi = np.einsum("dni,nij,dnj->dn", off, np.linalg.inv(stated.point), off) / 2
    assert 0.8 < chi.mean() < 1.2, chi.mean()


@pytest.mark.parametrize(("direction", "friction"), [(-1, 0.0), (1, 0.3)])
def test_tables_of_the_moment_alone_are_reconstructed(direction, friction, tmp_path):
    body = planar.Ellipse((0.5, 0.3), (0.0, 0.75), 0.3)
    swept = planar.sweep(body, friction, samples=80, direction=direction)
    kept = np.isfinite(swept.m0z)
    path = write_numbers(tmp_path / "sweep.csv", "x0,m0z", swept.x0[kept], swept.m0z[kept])
    path.with_suffix(".toml").write_text(f"[known]\nfriction = {friction}\n")
    found = reconstruct_sweep(read_sweep(path))
    tangential = swept.phase[kept] == planar.Phase.TANGENTIAL
    assert found.tangential.sum() > 0.8 * tangential.sum()
    assert not found.touching[~tangential].any()
    off = np.linalg.norm(found.contacts.point - swept.point[kept], axis=1)[found.touching]
    assert off.max() < 0.03
    assert np.median(off) < 2e-3
    # with noise the errors are those that are stated, the error of the step among them
    noise, chi = 1e-4, []
    for seed in range(8):
        m0z = swept.m0z[kept] + noise * np.random.default_rng(seed).standard_normal(kept.sum())
        noisy = OneSweep(swept.x0[kept], None, None, m0z, None, noise, noise, Known(friction))
        known = reconstruct_sweep(noisy)
        rows = known.touching
        off = (known.contacts.point - swept.point[kept])[rows]
        chi.append(np.einsum("ni,nij,nj->n", off, np.linalg.inv(known.errors.point[rows]), off).mean() / 2)
    assert 0.7 < np.mean(chi) < 1.3, np.mean(chi)
