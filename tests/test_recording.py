"""Recordings: written and read bit for bit, refused with a message, and reconstructed when they come from a laboratory."""

import dataclasses

import numpy as np
import pytest
from rings import recording_of
from scipy.spatial.transform import Rotation

import planar
from scan3d import Recording, Rod, read_recording, reconstruct, write_recording
from scan3d.files.recordings import COLUMNS
from tests import rigs
from tests.rig_errors import typical

HEADER = "sweep,x_m,y_m,z_m,qw,qx,qy,qz,fx_N,fy_N,mz_Nm"
ROW = "0,0.1,0.2,0.3,1,0,0,0,-0.01,0.02,0.0005"
TOML = "[rod]\nlength_m = 0.05\nbending_stiffness_Nm2 = 8.35e-5\n"


def random_recording(n=5, **changed):
    rng = np.random.default_rng(3)
    columns = dict(
        sweep=np.arange(n) // 2,
        position_m=rng.standard_normal((n, 3)),
        quaternion=Rotation.random(n, rng).as_quat(scalar_first=True),
        force_N=rng.standard_normal((n, 2)) / 3,
        moment_Nm=rng.standard_normal(n) * 1e-7,
        rod=Rod(1 / 3, 1e-4 / 3),
    )
    return Recording(**columns | changed)


def write(folder, table=f"{HEADER}\n{ROW}\n", meta=TOML):
    path = folder / "log.csv"
    path.write_bytes(table if isinstance(table, bytes) else table.encode())
    if meta is not None:
        (folder / "log.toml").write_bytes(meta if isinstance(meta, bytes) else meta.encode())
    return path


def same(a, b):
    return all(
        x.dtype == y.dtype and x.tobytes() == y.tobytes() if isinstance(x, np.ndarray) else x == y
        for x, y in ((getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(Recording))
    )


SIX = dict(
    force_z_N=np.array([0.1, -0.2, 1 / 3]), moment_x_Nm=np.array([1e-3, 2 / 3, 0.0]), moment_y_Nm=np.full(3, 1e-9)
)
NOISE = dict(noise_force_N=0.1 / 3, noise_moment_Nm=1e-9 / 3, noise_independent=False)
SOURCE = dict(unit="um", source={"rig": 'No. 3 "old"', "seed": 4, "µ": [0.1, 0.2]})
PLACE = dict(table_m=-0.0125, rig=dataclasses.replace(typical(), exact=("length_m",)))
THICK = Rod(1 / 3, 1e-4 / 3, 1e-3, bead_diameter_m=4e-3)


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
@pytest.mark.parametrize(
    "given",
    [NOISE | SOURCE | PLACE, dict(n=3, rod=THICK) | SIX, dict(rod=Rod.wire(0.05, 0.3e-3, 210e9))],
    ids=["noisy", "in space", "of a wire"],
)
def test_what_was_written_is_read_bit_for_bit(tmp_path, given, ending):
    recording, path = random_recording(**given), tmp_path / f"log{ending}"
    write_recording(recording, path)
    assert same(read_recording(path), recording)
    assert {p.name for p in tmp_path.iterdir()} == {path.name, "log.toml"}
    assert ("diameter" in (tmp_path / "log.toml").read_text()) == (recording.rod.diameter_m > 0)
    if ending == ".csv":
        further = ",fz_N,mx_Nm,my_Nm" if recording.six_axis else ""
        assert path.read_text().splitlines()[0] == HEADER + further


def test_a_recording_by_hand(tmp_path):
    recording = read_recording(write(tmp_path))
    assert recording.sweep.tolist() == [0]
    assert recording.position_m.tolist() == [[0.1, 0.2, 0.3]]
    assert recording.quaternion.tolist() == [[1, 0, 0, 0]]
    assert recording.force_N.tolist() == [[-0.01, 0.02]]
    assert recording.moment_Nm.tolist() == [0.0005]
    assert recording.rod == Rod(0.05, 8.35e-5)
    assert (recording.unit, recording.noise_force_N, recording.noise_moment_Nm) == ("mm", 0.0, 0.0)


@pytest.mark.parametrize(
    "table",
    [
        " , ".join(COLUMNS) + "\n" + ROW.replace(",", " , ") + "\n",
        f"{HEADER}\n\n{ROW}\n\n",
        f"t_s,{HEADER},temperature,fz_raw,my_raw\n0.5,{ROW},1,2,3\n",
        f"{HEADER},time,note\n{ROW},2024-05-01T10:00:00,\n",
        "mz_Nm,fy_N,fx_N,qz,qy,qx,qw,z_m,y_m,x_m,sweep\n" + ",".join(reversed(ROW.split(","))),
        HEADER + "\n" + ROW.replace("0.1", "1.0E-1").replace("0,0.1", "0.0,0.1"),
    ],
    ids=["spaces", "empty lines", "more", "more, not numbers", "order", "notation"],
)
def test_other_programs_tables(tmp_path, table):
    plain, other = tmp_path / "plain", tmp_path / "other"
    plain.mkdir()
    other.mkdir()
    assert same(read_recording(write(other, table)), read_recording(write(plain)))


def test_a_rod_by_diameter_and_modulus(tmp_path):
    recording = read_recording(
        write(tmp_path, meta="[rod]\nlength_m = 0.05\ndiameter_m = 0.3e-3\nmodulus_Pa = 210e9\n")
    )
    assert recording.rod == Rod.wire(0.05, 0.3e-3, 210e9)


# --- a laboratory's recording: made with planar alone, in a world that knows nothing of slices or meshes ---


@pytest.mark.parametrize("seed", range(3))
def test_a_laboratorys_recording_in_an_arbitrary_world(tmp_path, seed):
    """A ball is touched in two of its planes from four sides each, by a rig that stands anywhere, and turned."""
    rng, radius = np.random.default_rng(seed), 20.0
    turn, shift = Rotation.random(rng=rng), rng.uniform(-1, 1, 3)
    made = recording_of(lambda z: np.sqrt(radius**2 - z**2), [-10.0, 6.0], directions=4, samples=9, friction=0.25)
    moved = rigs.in_world(made, turn, shift)
    same_turns = np.where(made.sweep[:, None] % 2, -moved.quaternion, moved.quaternion)
    stated = dict(quaternion=same_turns, rod=made.rod.without_thickness(), unit="cm", source={})
    write_recording(dataclasses.replace(moved, **stated), tmp_path / "log.csv")
    cloud = reconstruct(read_recording(tmp_path / "log.csv"))

    assert cloud.unit == "cm"
    assert cloud.rod_length == pytest.approx(6.0)
    # the first sample of a sweep only touches, and the rest are contacts with the ball
    assert len(cloud) == len(made) - 8
    away = cloud.points - 100 * shift
    # 1e-12 of the metre that the positions are large
    assert np.linalg.norm(away, axis=1) == pytest.approx(np.full(len(cloud), 0.1 * radius), abs=1e-9)
    assert away @ turn.apply([0, 0, 1]) == pytest.approx(np.repeat([-1.0, 0.6], len(cloud) // 2), abs=1e-9)
    tangential = cloud.phase == planar.Phase.TANGENTIAL
    assert 0 < tangential.sum() < len(cloud)
    assert cloud.friction[tangential] == pytest.approx(np.full(tangential.sum(), 0.25), abs=1e-9)
    assert np.isnan(cloud.friction[~tangential]).all()
    assert len(np.unique(cloud.slice)) == 2
    assert len(np.unique(cloud.sweep)) == 8
