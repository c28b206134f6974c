"""Contacts by moments alone, along sweeps: in space against root finding on an ellipsoid, and against drawn noise."""

import numpy as np
import pytest

import planar
from planar.following import Frames, follow
from scan3d.channels import Known
from scan3d.errors import InputError
from scan3d.laboratory.one_sweep import OneSweep, read_sweep, reconstruct_sweep
from scan3d.spatial.following import by_two_moments
from tests.spatial_sweeps import AXES, CENTRE, _state, sweep

CIRCLE = planar.Circle(radius=0.9, center=(0.0, 1.3))


def frictionless(samples):
    """Clamps (n, 3), moments (n, 2) about x and z, arc lengths and places of tangential contacts with an ellipsoid."""
    base = np.linspace(0.05, -0.55, samples)
    states = sweep(0.15, base)
    place = np.column_stack([base, np.zeros(samples), np.full(samples, 0.15)])
    rods = [_state(state) for state in states]
    tangential = states[:, 3] < 1 - 1e-9
    first = int(np.argmax(tangential))
    last = first + int(np.argmin(np.append(tangential[first:], False)))
    size = 2 * states[:, 2] * np.array([rod[3] for rod in rods])
    omega = states[:, 0]
    moment = size[:, None] * np.column_stack([-np.sin(omega), np.cos(omega)])
    point = place + np.array([rod[0] for rod in rods])
    rows = slice(first, last)
    return place[rows], moment[rows], states[rows, 3], point[rows]


def test_two_moments_are_enough_along_a_frictionless_sweep_in_space():
    off = []
    for samples in (30, 60):
        place, moment, s1, point = frictionless(samples)
        assert len(place) > 0.5 * samples
        found = by_two_moments(place, np.eye(3), *moment.T, start=float(s1[0]))
        off.append(np.linalg.norm(found.point - point, axis=1).max())
        # the ellipsoid's normal is the direction of the force
        normal = (found.point - CENTRE) / AXES**2
        turned = np.cross(normal, found.force) / np.linalg.norm(normal, axis=1)[:, None]
        assert np.linalg.norm(turned, axis=1).max() < 0.05 * np.linalg.norm(found.force, axis=1).max()
    # of the second order in the step
    assert off[0] < 5e-3
    assert off[1] < 0.35 * off[0]


def test_errors_by_two_moments_are_those_of_drawn_noise():
    place, moment, s1, _ = frictionless(30)
    draws, noise, sd, rng = 300, 1e-5, 1e-5, np.random.default_rng(0)
    n, start = len(place), float(s1[0])
    true = by_two_moments(place, np.eye(3), *moment.T, start=start, noise=noise, start_sd=sd)
    drawn = np.tile(moment, (draws, 1)) + noise * rng.standard_normal((n * draws, 2))
    starts = start + sd * rng.standard_normal(draws)
    found = by_two_moments(
        np.tile(place, (draws, 1)), np.eye(3), *drawn.T, start=starts, sweep=np.repeat(np.arange(draws), n)
    )
    off = found.point.reshape(draws, n, 3) - true.point
    chi = np.einsum("dni,nij,dnj->dn", off, np.linalg.inv(true.covariance), off) / 3
    assert 0.85 < chi.mean() < 1.15, chi.mean()


def test_what_two_moments_do_not_tell_is_refused():
    place, moment, s1, _ = frictionless(30)
    with pytest.raises(ValueError, match="straight rods without weight only"):
        by_two_moments(place, np.eye(3), *moment.T, start=0.5, rod=planar.Rod(curvature=0.1))
    with pytest.raises(ValueError, match="start must be an arc length"):
        by_two_moments(place, np.eye(3), *moment.T, start=[0.5, 0.6])


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
    stated = planar.errors(*exact.force.T, moment, noise=(0.0, 0.0), covariance=exact.covariance[:, :3, :3])
    place = planar.reconstruct(frames.place[:, 0], *found.force.T, drawn, tolerance=1e-3).point.reshape(draws, n, 2)
    off = place - planar.reconstruct(base, *exact.force.T, moment, tolerance=1e-3).point
    chi = np.einsum("dni,nij,dnj->dn", off, np.linalg.inv(stated.point), off) / 2
    assert 0.8 < chi.mean() < 1.2, chi.mean()


@pytest.mark.parametrize(("direction", "friction"), [(-1, 0.0), (1, 0.3)])
def test_tables_of_the_moment_alone_are_reconstructed(direction, friction, tmp_path):
    body = planar.Ellipse((0.5, 0.3), (0.0, 0.75), 0.3)
    swept = planar.sweep(body, friction, samples=80, direction=direction)
    kept = np.isfinite(swept.m0z)
    lines = [f"{x:.17g},{m:.17g}" for x, m in zip(swept.x0[kept], swept.m0z[kept], strict=True)]
    path = tmp_path / "sweep.csv"
    path.write_text("x0,m0z\n" + "\n".join(lines) + "\n")
    with pytest.raises(InputError, match="lacks f0x, f0y"):
        read_sweep(path)
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
