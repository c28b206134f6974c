"""Recordings and logs of fewer than three channels: what is known in the place of one completes them, with its uncertainty."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import trimesh
from raw_tables import POSED, si_map, write_numbers

import scan3d
from scan3d import InputError, Rod
from scan3d.cli import main
from scan3d.geometry.distance import distances
from scan3d.reconstruction.contacts import contacts
from scan3d.recording import FORCE, REACTIONS, Known, completed, reaction_columns

WIRE = Rod.wire(0.04, 0.25e-3, 210e9).without_thickness()
CONE = Rod(0.04, WIRE.bending_stiffness_Nm2, 0.25e-3, 0.125e-3).without_thickness()
FRICTION = 0.3


@cache
def scanned(rod=WIRE, friction=FRICTION, noise=0.0, seed=0, few=False):
    mesh = trimesh.creation.icosphere(2, 8.0)
    plan = scan3d.Plan(
        slices=1 if few else 3,
        sweeps=2 if few else 3,
        samples=10 if few else 16,
        spacing="uniform",
        rod=rod,
        friction=friction,
        noise=noise,
        seed=seed,
    )
    return mesh, scan3d.simulate(mesh, plan)


def without(recording, channel, folder, known):
    """The file of a recording without a channel, and with what is known in its place."""
    path = folder / "log.csv"
    scan3d.write_recording(recording, path)
    header, *lines = path.read_text().splitlines()
    column = header.split(",").index(REACTIONS[channel])
    rows = [line.split(",") for line in (header, *lines)]
    path.write_text("".join(",".join(row[:column] + row[column + 1 :]) + "\n" for row in rows))
    beside = path.with_suffix(".toml")
    beside.write_text(f"{beside.read_text()}\n[known]\n{known}\n")
    return path


@pytest.mark.slow
@pytest.mark.parametrize(("channel", "rod"), [("m0z", WIRE), ("f0y", WIRE), ("f0x", CONE)])
def test_recordings_of_two_channels_are_completed(channel, rod, tmp_path):
    mesh, whole = scanned(rod, few=rod is CONE)  # which is marched for every value tried
    read = scan3d.read_recording(without(whole, channel, tmp_path, f"friction = {FRICTION}"))
    assert read.completed == scan3d.recording.Known(FRICTION, 0.0, channel)
    cloud = contacts(read)
    assert np.abs(distances(cloud.points, mesh)).max() < 1e-8 * 40
    # rows that the channels leave open are missing, those in the air are not
    touching, air = (np.linalg.norm(whole.force_N, axis=1) > 0).sum(), len(whole) - len(contacts(whole))
    assert 0.7 * touching < len(cloud) <= touching
    assert (np.linalg.norm(read.force_N, axis=1) == 0).sum() >= air - 2
    # written, they have the completed channel, and say that it is
    scan3d.write_recording(read, tmp_path / "done.csv")
    again = scan3d.read_recording(tmp_path / "done.csv")
    assert again.completed == read.completed
    np.testing.assert_array_equal(again.force_N, read.force_N)
    np.testing.assert_array_equal(again.moment_Nm, read.moment_Nm)


@pytest.mark.parametrize("seeds", [2, pytest.param(12, marks=pytest.mark.trust)])
def test_covariances_hold_what_noise_and_friction_do(seeds, tmp_path):
    sd, chi, count = 0.003, 0.0, 0
    for seed in range(seeds):
        truth = FRICTION + sd * (-1) ** seed  # the same error in all rows of a scan
        mesh, whole = scanned(friction=float(truth), noise=3e-4, seed=seed)
        known = f"friction = {FRICTION}\nfriction_sd = {sd}"
        read = scan3d.read_recording(without(whole, "m0z", tmp_path, known))
        assert not read.noise.independent
        cloud = contacts(read)
        beyond = cloud.points @ mesh.face_normals.T - (mesh.triangles[:, 0] * mesh.face_normals).sum(axis=1)
        off, along = beyond.max(axis=1), mesh.face_normals[beyond.argmax(axis=1)]
        spread = np.einsum("ni,nij,nj->n", along, cloud.covariance, along)
        chi, count = chi + float((off**2 / spread).sum()), count + len(off)
    assert count > 60 * seeds
    assert 0.7 < chi / count < 1.3, chi / count


def test_logs_of_two_channels_are_imported(tmp_path):
    mesh, whole = scanned()
    log, exact = tmp_path / "log.csv", {"force_N": 0.0, "moment_Nm": 0.0}
    write_numbers(log, f"{POSED},fx,fy", whole.sweep, whole.position_m, whole.quaternion, whole.force_N)

    def read(moment="", **known):
        stated = {"noise": exact} | ({"known": known} if known else {})
        return scan3d.import_table(log, si_map(WIRE, ["fx", "fy"], [moment], **stated))

    assert np.abs(distances(contacts(read(friction=FRICTION)).points, mesh)).max() < 1e-8 * 40
    for wrong, words in (
        ({}, "mz was not measured; \\[known\\] of the map may state"),
        ({"friction_sd": 0.1}, "needs friction, or contact"),
        ({"friction": FRICTION, "moment": "fy"}, "of these 0 are missing"),
    ):
        with pytest.raises(InputError, match=words):
            read(**wrong)


def test_what_two_channels_do_not_tell_is_refused(tmp_path):
    _, whole = scanned(friction=0.0)
    path = without(whole, "f0x", tmp_path, "friction = 0.0")
    with pytest.raises(InputError, match="do not locate a contact without friction on a uniform rod"):
        scan3d.read_recording(path)
    _, whole = scanned()
    read = scan3d.read_recording(without(whole, "m0z", tmp_path, f"friction = {FRICTION}"))
    with pytest.raises(InputError, match="of a rod without weight"):
        replace(read, rod=replace(WIRE, weight_N=1.0), gravity=scan3d.Gravity((0, -1, 0), True))
    text = path.read_text().splitlines()
    path.write_text("".join(",".join(line.split(",")[:-1]) + "\n" for line in text))
    with pytest.raises(InputError, match="lacks fy_N, mz_Nm"):
        scan3d.read_recording(path)
    with pytest.raises(InputError, match="completed channel must be one of"):
        scan3d.recording.Known(0.3, 0.0, "fz")
    # fx of either sign agrees with the others
    with pytest.raises(InputError, match="leave no contact, or several, with that all contacts are at the tip"):
        completed(replace(whole, completed=scan3d.recording.Known(None, 0.0, "f0x")))


@pytest.mark.parametrize(
    ("channel", "six_axes"), [("m0z", False), ("f0y", False), ("f0x", False), (FORCE, False), (FORCE, True)]
)
def test_logs_in_which_nothing_was_touched_are_whole(channel, six_axes):
    rng = np.random.default_rng(0)
    noise = {"force_N": rng.normal(size=(20, 3)), "moment_Nm": 1e-2 * rng.normal(size=(20, 3))}
    log = scan3d.Recording(
        sweep=np.zeros(20, dtype=np.int64),
        position_m=np.linspace([0, 0, 0], [-0.02, 0, 0], 20),
        quaternion=np.tile([1.0, 0, 0, 0], (20, 1)),
        **reaction_columns(1e-6 * noise["force_N"], 1e-6 * noise["moment_Nm"], six_axes),
        rod=WIRE,
        noise_force_N=1e-6,
        noise_moment_Nm=1e-8,
        completed=Known(FRICTION, 0.0, channel),
    )
    found, kept = completed(log)
    assert kept.all()
    with pytest.raises(InputError, match="the recording has no contact"):
        scan3d.reconstruct(found)


@pytest.mark.slow
def test_friction_that_is_assumed_is_not_told_as_found(tmp_path, capsys):
    path = without(scanned(few=True)[1], "f0y", tmp_path, f"friction = {FRICTION}")
    assert main(["reconstruct", str(path), "--out", str(tmp_path / "out")]) == 0
    words = " ".join(capsys.readouterr().out.split())
    assert "friction 0.3, assumed: it stands in [known]" in words
    assert "estimated from touch" not in words
