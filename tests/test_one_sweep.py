"""One sweep in one plane through its files: contour, friction and error bars, and what is wrong with a table."""

import csv
import json

import numpy as np
import pytest
from PIL import Image

import planar
from scan3d.cli import main
from scan3d.files.text import parse_rod
from scan3d.laboratory.one_sweep import COLUMNS, SI_COLUMNS, OneSweep, read_sweep, reconstruct_sweep
from scan3d.pictures.views import sweep_figure

ELLIPSE = planar.Ellipse((0.5, 0.3), (0.0, 0.85), 0.3)
FRICTION = 0.25
ROD = "steel:0.3x50"
SIDECAR = "[rod]\nlength_m = 0.05\ndiameter_m = 0.0003\nmodulus_Pa = 210e9\n"


@pytest.fixture(scope="module", params=[-1, 1], ids=["in -x", "in +x"])
def sweep(request):
    return planar.sweep(ELLIPSE, FRICTION, samples=120, direction=request.param)


@pytest.fixture(scope="module")
def left():
    return planar.sweep(ELLIPSE, FRICTION, samples=120)


def columns(sweep, si=False):
    rod = parse_rod(ROD)
    units = [rod.length_m, rod.force_unit_N, rod.force_unit_N, rod.moment_unit_Nm] if si else [1, 1, 1, 1]
    return np.column_stack(sweep.reactions) * units


def write(path, table, header=COLUMNS):
    rows = "\n".join(",".join(map(repr, row)) for row in table.tolist())
    path.write_text(f"{','.join(header)}\n{rows}\n", encoding="utf-8")
    return path


def read_contacts(path):
    """The columns of a table of contacts; NaN where a cell is empty."""
    with open(path, encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    words = {"phase", "status"}
    return {
        name: np.array([row[name] if name in words else float(row[name] or "nan") for row in rows]) for name in rows[0]
    }


def test_an_ellipse_comes_back_through_the_file(tmp_path, sweep, capsys):
    si = bool(sweep.x0[-1] > sweep.x0[0])  # dimensionless in -x, SI units in +x
    table = write(tmp_path / "sweep.csv", columns(sweep, si), SI_COLUMNS if si else COLUMNS)
    assert main(["reconstruct", str(table), *(["--rod", ROD] if si else [])]) == 0
    out = capsys.readouterr().out
    assert f"base moving in {'-' if sweep.x0[-1] < sweep.x0[0] else '+'}x" in out
    assert "error of the place not known: give the noise by --noise-force and --noise-moment" in out
    length, unit = (parse_rod(ROD).length_m, "_m") if si else (1.0, "")
    found = read_contacts(tmp_path / "contacts.csv")
    touching = np.hypot(sweep.f0x, sweep.f0y) > 0  # the rod is straight at touch-down
    assert touching.sum() > 100
    assert list(found["status"]) == ["ok" if touches else "no_force" for touches in touching]
    assert list(found["phase"][touching]) == [planar.Phase(code).name.lower() for code in sweep.phase[touching]]
    place = np.column_stack([found[f"x{unit}"], found[f"y{unit}"]]) / length
    if si:  # the rod's centre line touches the ellipse grown by the rod's radius
        normal = np.nan_to_num(np.column_stack([found["normal_x"], found["normal_y"]]))
        place += parse_rod(ROD).diameter_m / 2 / length * normal
    assert np.abs(place - sweep.point)[touching].max() < 1e-9
    assert ELLIPSE.distance(place[touching]).max() < 1e-9
    assert np.abs(found[f"s1{unit}"] / length - sweep.s1)[touching].max() < 1e-9
    tangential = touching & (sweep.phase == planar.Phase.TANGENTIAL)
    assert np.abs(found["friction"][tangential] - FRICTION).max() < 1e-9
    assert np.abs(found["slope"] - sweep.slope)[tangential].max() < 1e-9
    normal = np.column_stack([np.sin(sweep.slope), -np.cos(sweep.slope)])
    assert np.abs(np.column_stack([found["normal_x"], found["normal_y"]]) - normal)[tangential].max() < 1e-9
    assert np.isnan(found["friction"][~tangential]).all()
    assert not any(name.startswith("sd_") for name in found)
    # the folder has the picture as well
    with Image.open(tmp_path / "sweep.png") as image:
        assert image.size[0] == 1400


@pytest.mark.slow
@pytest.mark.parametrize("known", [{}, {"f0y": "friction = 0.25"}, {"m0z": "friction = 0.25"}])
def test_touches_from_both_sides_are_those_of_each_side(tmp_path, left, known, capsys):
    """A clamp that stays is touched by a pin here and there; the sign of the moment, or of the force, tells the side."""
    touches = columns(left)[20:100:10] * [0, 1, 1, 1]
    mirrored = touches * [1, -1, 1, -1]
    mixed = np.stack([touches, mirrored], axis=1).reshape(-1, 4)
    found = {}
    for name, table in (("one", touches), ("other", mirrored), ("both", mixed)):
        kept = [k for k, column in enumerate(COLUMNS) if column not in known]
        path = write(tmp_path / f"{name}.csv", table[:, kept], [COLUMNS[k] for k in kept])
        for words in known.values():
            path.with_suffix(".toml").write_text(f"[known]\n{words}\n", encoding="utf-8")
        assert main(["reconstruct", str(path), "--out", str(tmp_path / name)]) == 0
        assert "base at rest" in capsys.readouterr().out
        found[name] = read_contacts(tmp_path / name / "contacts.csv")
    assert (found["one"]["status"] == "ok").all()
    for name in ("x", "y", "s1", "friction", "normal_x"):
        assert found["both"][name][::2] == pytest.approx(found["one"][name], abs=1e-12, nan_ok=True)
        assert found["both"][name][1::2] == pytest.approx(found["other"][name], abs=1e-12, nan_ok=True)
    assert found["other"]["x"] == pytest.approx(-found["one"]["x"], abs=1e-12)


def test_error_bars_cover_the_truth(sweep):
    # two standard deviations cover 95.4 % of normal errors; rows near the tip may change their kind of contact
    noise, rng = 3e-4, np.random.default_rng(0)
    hits = {name: [] for name in ("x", "y", "s1", "friction", "slope")}
    strong = np.hypot(sweep.f0x, sweep.f0y) > 100 * noise  # errors of the first order
    for _ in range(20):
        error = rng.normal(scale=noise, size=(3, len(sweep)))
        noisy = OneSweep(sweep.x0, sweep.f0x + error[0], sweep.f0y + error[1], sweep.m0z + error[2], None, noise, noise)
        found = reconstruct_sweep(noisy)
        contacts = found.contacts
        rows = strong & found.touching
        assert rows.sum() > 0.99 * strong.sum()
        safely = rows & found.tangential & (sweep.s1 < 0.99)
        for name, value, truth, sd, some in (
            ("x", contacts.point[:, 0], sweep.point[:, 0], found.point_sd[:, 0], rows),
            ("y", contacts.point[:, 1], sweep.point[:, 1], found.point_sd[:, 1], rows),
            ("s1", contacts.s1, sweep.s1, found.errors.s1, rows),
            ("friction", contacts.friction, sweep.friction, found.friction_sd, safely),
            ("slope", contacts.slope, sweep.slope, found.errors.slope, safely),
        ):
            hits[name].append(np.abs(value - truth)[some] <= 2 * sd[some])
    for name, covered in hits.items():
        assert 0.945 < np.concatenate(covered).mean() < 0.963, name


def test_noise_is_that_of_the_sidecar_or_the_options(tmp_path, left, capsys):
    table = write(tmp_path / "sweep.csv", columns(left, si=True), SI_COLUMNS)
    (tmp_path / "sweep.toml").write_text(f"{SIDECAR}[noise]\nforce_N = 1e-5\nmoment_Nm = 5e-7\n")
    found = reconstruct_sweep(read_sweep(table))
    rod = parse_rod(ROD)
    assert found.noise == pytest.approx((1e-5 / rod.force_unit_N, 5e-7 / rod.moment_unit_Nm))
    options = ["--noise-force", "2e-5", "--noise-moment", "1e-6", "--json"]
    medians = []
    for further in ([], options):
        assert main(["reconstruct", str(table), "--json", *further]) == 0
        data = json.loads(capsys.readouterr().out)
        assert data["unit"] == "mm"
        medians.append(data["place_sd_median"])
    assert medians[1] == pytest.approx(2 * medians[0], rel=0.02)
    length = rod.length_m
    written = read_contacts(tmp_path / "contacts.csv")
    twice = reconstruct_sweep(read_sweep(table, None, 2e-5, 1e-6))
    assert np.nanmax(np.abs(written["sd_x_m"] / length - twice.point_sd[:, 0])) < 1e-15
    tangential = twice.tangential
    # the first order of tan ζ
    step = np.tan(twice.contacts.friction_angle + 1e-6 * twice.errors.friction_angle) - twice.contacts.friction
    assert written["sd_friction"][tangential] == pytest.approx(1e6 * step[tangential], rel=1e-3)


def test_a_row_of_noise_is_no_contact_whatever_the_sign_of_its_moment(left):
    touches = np.vstack([[left.x0[0] + 0.1, 1e-4, 1e-4, -1e-4], columns(left)])
    found = reconstruct_sweep(OneSweep(*touches.T, noise_force=1e-4, noise_moment=1e-4))
    assert found.contacts.status[0] == planar.Status.NO_FORCE


def test_contacts_of_another_table_are_not_replaced(tmp_path, left, call):
    tables = [write(tmp_path / f"{name}.csv", columns(left)[::step]) for name, step in (("one", 1), ("other", 2))]
    assert call("reconstruct", tables[0])[0] == 0
    assert call("reconstruct", tables[0])[0] == 0
    before = (tmp_path / "contacts.csv").read_bytes()
    code, _, error = call("reconstruct", tables[1])
    assert code == 1
    assert "contacts.csv holds other contacts than those of this table" in error
    assert (tmp_path / "contacts.csv").read_bytes() == before
    assert call("reconstruct", tables[1], "--overwrite")[0] == 0


@pytest.mark.parametrize("column", range(4))
def test_a_row_without_a_value_has_no_contact_and_changes_no_other(tmp_path, left, column):
    table = np.round(columns(left), 4)
    whole = reconstruct_sweep(read_sweep(write(tmp_path / "whole.csv", table)))
    table[50, column] = np.nan
    found = reconstruct_sweep(read_sweep(write(tmp_path / "sweep.csv", table)))
    others = np.arange(len(table)) != 50
    assert found.contacts.status[50] == planar.Status.NO_FORCE
    assert np.isnan(found.errors.largest[50])
    assert found.noise[0] == pytest.approx(whole.noise[0])
    assert (found.contacts.status == whole.contacts.status)[others].all()
    sweep_figure(found)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x0,f0x,m0z\n0,0,0\n", "the header of one sweep lacks f0y; expected x0,f0x,f0y,m0z or x0_m,"),
        ("x0_m,f0x,f0y,m0z\n1,0,0,0\n", "dimensionless columns (f0x, f0y, m0z) with columns in SI units (x0_m)"),
        ("x0,f0x,f0y,m0z\n1,-1,1,1\n0,-1,1,1\n1,-1,1,1\n", "must decrease or increase"),
        ("x0,f0x,f0y,m0z\n1,-1,1,-1\n0,-1,1,-1\n", "the clamping moment is that of a rod bent against the sweep"),
        ("x0_m,f0x_N,f0y_N,m0z_Nm\n1,0,0,0\n0,0,0,0\n", "need the rod: give --rod MATERIAL:DIAMETERxLENGTH"),
    ],
)
def test_a_wrong_table_is_refused_in_one_sentence_and_nothing_is_written(tmp_path, call, text, words):
    (tmp_path / "sweep.csv").write_text(text, encoding="utf-8")
    code, out, err = call("reconstruct", tmp_path / "sweep.csv")
    assert (code, out, err.count("\n")) == (1, "", 1)
    assert words in err
    assert [path.name for path in tmp_path.iterdir()] == ["sweep.csv"]


def test_a_tapered_rod_is_read_as_one(tmp_path):
    rod = planar.Rod(tip_diameter=0.4)
    whisker = planar.sweep(ELLIPSE, FRICTION, samples=20, rod=rod)
    table = write(tmp_path / "sweep.csv", columns(whisker, si=True), SI_COLUMNS)
    (tmp_path / "sweep.toml").write_text(SIDECAR.replace("0.0003", "3e-4\ntip_diameter_m = 1.2e-4"))
    found = reconstruct_sweep(read_sweep(table))
    felt = found.touching & (np.hypot(whisker.f0x, whisker.f0y) > 0.01)
    place = found.contacts.point.copy()
    radius = 1.5e-4 / 0.05 * (1 - 0.6 * found.contacts.s1)
    place[found.tangential] += (radius[:, None] * found.contacts.normal)[found.tangential]
    assert felt.sum() > 12
    assert np.abs(place - whisker.point)[felt].max() < 1e-8


@pytest.mark.slow
@pytest.mark.parametrize("missing", ["f0y", "m0z"])
def test_a_reaction_that_was_not_measured_is_completed_by_what_is_known(tmp_path, left, missing, capsys):
    whole = columns(left)
    kept = [k for k, name in enumerate(COLUMNS) if name != missing]
    table = write(tmp_path / "sweep.csv", whole[:, kept], [COLUMNS[k] for k in kept])
    noise = "[noise]\nforce = 1e-6\nmoment = 1e-6\n"
    (tmp_path / "sweep.toml").write_text(f"{noise}[known]\nfriction = {FRICTION}\nfriction_sd = 1e-3\n")
    found = reconstruct_sweep(read_sweep(table))
    felt = np.hypot(left.f0x, left.f0y) > 0.01
    determined = felt & ~found.undetermined
    assert determined.sum() > 0.7 * felt.sum()
    assert np.abs(found.contacts.point - left.point)[determined].max() < 1e-9
    # friction that is off by one standard deviation moves contacts by about one of theirs
    (tmp_path / "sweep.toml").write_text(f"{noise}[known]\nfriction = {FRICTION + 1e-3}\nfriction_sd = 1e-3\n")
    off = reconstruct_sweep(read_sweep(table))
    both = determined & ~off.undetermined & found.tangential & off.tangential & (found.errors.largest > 1e-5)
    moved = np.linalg.norm(off.contacts.point - left.point, axis=1)[both]
    assert both.sum() > 20
    assert np.median(moved / off.errors.largest[both]) == pytest.approx(1, abs=0.15)
    assert main(["reconstruct", str(table)]) == 0
    assert ("undetermined" in capsys.readouterr().out) == bool(off.undetermined.any())
    # contacts of the tip alone
    tips = left.phase == planar.Phase.TIP
    write(table, whole[tips][:, kept], [COLUMNS[k] for k in kept])
    (tmp_path / "sweep.toml").write_text("[known]\ncontact = 'tip'\n")
    found = reconstruct_sweep(read_sweep(table))
    assert np.abs(found.contacts.point - left.point[tips])[found.touching].max() < 1e-8
    assert found.touching.sum() > 10
