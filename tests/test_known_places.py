"""Raw signals at known places: the matrix of a sensor, with deviations, through files and back to contacts."""

import re

import numpy as np
import pytest
import trimesh

import scan3d
from scan3d.calibration.known import Places, Signals, of_signals, wrenches
from scan3d.cli import main
from scan3d.files.text import rod_section, to_toml
from scan3d.rigs import Frame
from scan3d.rods import Rod
from scan3d.spatial import inverse
from scan3d.spatial.march import SpatialRod
from tests.raw_tables import track

ROD = Rod(0.06, 1.9e-4, 0.0003)
UNITS = np.repeat([ROD.force_unit_N, ROD.moment_unit_Nm], 3)
SENSOR = Frame.of(np.zeros(3), np.zeros(3))


def touches(random, count, space):
    along, aside = random.uniform(0.4, 0.9, count), random.uniform(0.08, 0.2, count)
    angle = random.uniform(0, 2 * np.pi, count) if space else np.pi * random.integers(0, 2, count)
    return ROD.length_m * np.stack([aside * np.cos(angle), along, space * aside * np.sin(angle)], axis=1)


def at(point, deviation=0.0):
    nothing = np.full(len(point), np.nan)
    return Places(
        nothing, point, np.full((len(point), 3), np.nan), np.full(len(point), deviation), np.zeros(len(point))
    )


@pytest.mark.parametrize("rod", [SpatialRod(), SpatialRod(curvature=(0.1, -0.05, 0.0))])
def test_the_wrench_of_a_place_is_that_of_a_rod_that_touches_there_without_friction(rod):
    point = touches(np.random.default_rng(1), 12, True) / ROD.length_m
    wrench, _ = wrenches(rod, at(point))
    found = inverse.reconstruct(wrench[:, :3], wrench[:, 3:], rod=rod, tolerance=1e-6)
    assert np.abs(found.point - point).max() < 1e-9
    assert np.abs((found.force * found.tangent).sum(axis=1)).max() < 1e-8


def test_a_weight_at_an_arc_length_and_the_place_where_it_hangs_tell_the_same():
    point = touches(np.random.default_rng(2), 8, True) / ROD.length_m
    wrench, _ = wrenches(SpatialRod(), at(point))
    s1 = inverse.reconstruct(wrench[:, :3], wrench[:, 3:], tolerance=1e-6).s1
    hung = at(np.full((8, 3), np.nan))._replace(arc=s1, force=-wrench[:, :3])
    assert np.abs(wrenches(SpatialRod(), hung)[0] - wrench).max() < 1e-8


@pytest.mark.trust
@pytest.mark.parametrize(("curvature", "count"), [(0.0, 3), (0.1, 3), (0.0, 5)])
def test_deviations_hold(curvature, count):
    """Of 40 touches, with places that scatter by a third of a per mille of the rod and counts by 0.2 % of their range."""
    right = []
    for seed in range(25):
        random = np.random.default_rng(seed)
        stated = touches(random, 40, False)
        real = stated + 2e-5 * random.standard_normal(stated.shape) * [1, 1, 0]
        rod = SpatialRod(curvature=(curvature, 0.0, 0.0))
        wrench = np.vstack([wrenches(rod, at(real).of_rod(ROD))[0] * UNITS, np.zeros((4, 6))])[:, [0, 1, 5]]
        slope = 2000 * random.normal(size=(count, 3)) / np.abs(wrench).max(axis=0)
        offset = 500 * random.normal(size=count)
        rows = (offset + wrench @ slope.T)[:, None] + 5 * random.standard_normal((44, 20, count))
        mean = rows.mean(axis=1)
        spread = (rows - mean[:, None]).reshape(-1, count)
        signals = Signals(mean, np.full(44, 20), spread, np.zeros(count), tuple("abcde"[:count]))
        free = at(np.full((4, 3), np.nan))
        places = Places(*(np.concatenate(pair) for pair in zip(at(stated, 2e-5), free, strict=True)))
        found = of_signals(ROD, SENSOR, (), places, signals)
        truth = np.concatenate([[curvature / ROD.length_m] * (curvature > 0), offset, np.linalg.pinv(slope).ravel()])
        right.append(np.abs(found.values - truth) < 2 * found.standard_deviations)
    assert 0.9 <= np.mean(right) <= 0.98


def written(folder, space, random, bend=0.0):
    """The files of a calibration in a folder, and what makes counts of wrenches (n, 6)."""
    used = [0, 1, 2, 3, 5] if space else [0, 1, 5]
    point = touches(random, 40, space)
    wrench = np.vstack(
        [wrenches(SpatialRod(curvature=(bend, 0, 0)), at(point).of_rod(ROD))[0] * UNITS, np.zeros((4, 6))]
    )
    slope = 2000 * random.normal(size=(6, 6)) / np.abs(wrench).max(axis=0).clip(1e-9)
    slope = (slope * np.isin(np.arange(6), used))[: 6 if space else 3]
    offset = 500 * random.normal(size=len(slope))

    def counts(wrench):
        values = offset + wrench @ slope.T
        return values + 2 * random.standard_normal(values.shape)

    rows = [
        f"{k},{','.join(map(repr, row))}" for k in range(44) for row in counts(np.repeat(wrench[[k]], 20, 0)).tolist()
    ]
    channels = [f"c{k}" for k in range(len(slope))]
    (folder / "log.csv").write_text("\n".join([f"touch,{','.join(channels)}", *rows]) + "\n")
    places = [f"{k},{','.join(map(repr, row[: 2 + space]))}" for k, row in enumerate((1000 * point).tolist())]
    air = [f"{k},,{',' * space}" for k in range(40, 44)]
    (folder / "places.csv").write_text("\n".join([f"touch,x_mm,y_mm{',z_mm' * space}", *places, *air]) + "\n")
    (folder / "log.toml").write_bytes(to_toml({"rod": rod_section(ROD)}).encode())
    return counts, channels


@pytest.mark.slow
@pytest.mark.parametrize("space", [False, True])
def test_from_counts_to_contacts(tmp_path, capsys, space):
    """A log in counts is calibrated, imported and reconstructed, and contacts are where the deviations say."""
    random = np.random.default_rng(6)
    counts, channels = written(tmp_path, space, random)
    arguments = [
        str(tmp_path / "log.csv"),
        "--known",
        str(tmp_path / "places.csv"),
        "--out",
        str(tmp_path / "rig.toml"),
    ]
    assert main(["calibrate", *arguments]) == 0
    assert "matrix_fx_c0" in capsys.readouterr().out
    body = trimesh.creation.icosphere(5, radius=15)
    plan = scan3d.Plan(slices=6, sweeps=4, friction=0.3, rod=ROD, model="spatial" if space else "planar", seed=1)
    recording = scan3d.simulate(body, plan)
    log = track(recording)
    data = {
        "columns": {
            "time": "t",
            "position": ["x", "y", "z"],
            "orientation": {"quaternion": ["qw", "qx", "qy", "qz"]},
            "signals": channels,
        },
        "units": {"length": "m"},
        "rod": rod_section(ROD),
    }
    values = counts(log.wrench if space else log.wrench * np.isin(np.arange(6), [0, 1, 5]))
    table = np.column_stack([log.time, log.position, log.quaternion, values])
    names = ["t", "x", "y", "z", "qw", "qx", "qy", "qz", *channels]
    np.savetxt(tmp_path / "raw.csv", table, delimiter=",", header=",".join(names), comments="", fmt="%.12g")
    found = scan3d.import_table(tmp_path / "raw.csv", data, tmp_path / "rig.toml")
    assert found.six_axis == space
    cloud = scan3d.reconstruct(found)
    away = cloud.points - body.centroid
    outward = away / np.linalg.norm(away, axis=1)[:, None]
    covariance = cloud.covariance + cloud.calibration.covariance
    sd = np.sqrt(np.einsum("ni,nij,nj->n", outward, covariance, outward))
    error = np.linalg.norm(away, axis=1) - 15
    # a sphere of triangles, of a few micrometres, and one draw of the calibration's errors
    assert np.mean(np.abs(error) < 2 * sd) > 0.85
    assert np.median(np.abs(error)) < 0.1
    assert len(cloud.calibration.covariance) == len(cloud)


@pytest.mark.parametrize("told", ["s", "y"])
def test_a_pin_touches_a_cone_at_its_radius_there(tmp_path, told):
    """The radius at the clamp was taken everywhere."""
    rod, nothing = Rod(0.06, 1.9e-4, 0.003, tip_diameter_m=0.001), np.full(12, np.nan)
    aside, along = np.abs(touches(np.random.default_rng(3), 12, False)[:, :2]).T
    arc, height = (along, nothing) if told == "s" else (nothing, along)
    point, distance = np.column_stack([aside, height, 0 * aside]), rod.radius_m(along / rod.length_m) + 0.001
    touched = Places(arc, point, np.full((12, 3), np.nan), np.zeros(12), distance).of_rod(rod)
    shown = np.vstack([(wrenches(rod.in_space(), touched)[0] * UNITS)[:, [0, 1, 5]], np.zeros((3, 3))])
    rows = [f"{k},{','.join(map(repr, row))}" for k, row in enumerate(shown.tolist())]
    (tmp_path / "log.csv").write_text("\n".join(["touch,a,b,c", *rows]) + "\n")
    places = [f"{k},{x!r},{y!r},2" for k, (x, y) in enumerate((1000 * np.stack([aside, along], axis=1)).tolist())]
    places += [f"{k},,," for k in (12, 13, 14)]
    (tmp_path / "places.csv").write_text("\n".join([f"touch,x_mm,{told}_mm,pin_diameter_mm", *places]) + "\n")
    (tmp_path / "log.toml").write_bytes(to_toml({"rod": rod_section(rod)}).encode())
    found = scan3d.calibrate_signals(tmp_path / "log.csv", tmp_path / "places.csv")
    assert found.matrix == pytest.approx(np.eye(3), abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("touch,x_mm,y_mm\n0,5,30\n", "1 touches do not determine fx, fy, mz with deviations"),
        ("touch,x,y_mm\n0,5,30\n", "column 'x' needs its unit at its end, such as x_mm"),
        ("touch,x_mm,why_mm\n0,5,30\n", "has the column 'why_mm'; known are"),
        ("touch,x_mm\n0,5\n", "line 2 does not tell how the rod is bent"),
        ("touch,x_mm,y_mm\n0,5,-30\n", "not in front of the clamp"),
        ("touch,x_mm,y_mm\n99,5,30\n", "has no row with the same touch in the log"),
        ("touch,x_mm,y_mm\n0,5,30\n0,6,30\n", "line 3 has the touch 0 again; leave one of the two out"),
        ("x_mm,y_mm\n5,30\n", "does not tell which of the 880 rows"),
        ("touch,x_mm,y_mm\n0,5,100\n", "no rod of 0.06 m touches at place 1 of 1"),
    ],
)
def test_what_is_wrong_in_the_places_is_said(tmp_path, line, why):
    written(tmp_path, False, np.random.default_rng(1))
    (tmp_path / "places.csv").write_text(line)
    with pytest.raises(scan3d.InputError, match=re.escape(why)) as error:
        scan3d.calibrate_signals(tmp_path / "log.csv", tmp_path / "places.csv")
    assert "[sensor]" not in str(error.value)  # of the map, in which nothing is wrong
