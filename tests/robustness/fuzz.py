"""Random changes of files and options over all commands: no traceback, no hang, no memory beyond 2 GB, no warning."""

import contextlib
import io
import re
import shutil
import tempfile
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import h5py
import numpy as np
import pandas
import trimesh
from scipy.io import savemat

import planar
from scan3d.choices import METHODS
from scan3d.cli import main
from scan3d.files.recordings import write_recording
from scan3d.geometry.hulls import hull
from scan3d.pictures import canvas
from tests import rigs
from tests.robustness import corpus

NUMBERS = ("0", "-1", "1", "2", "3", "1e-300", "1e300", "-1e300", "nan", "inf", "-inf", "1e-9", "0.5", "1e9", "4294967296",
           "-2147483649", corpus.HUGE, "", "x", "\x1b[31m", "\u202e", "0x10", "1_0", "true", "null", "[]", "{}")  # fmt: skip
WORDS = ("auto", "hull", "bracket", "support", "regression", "poisson", "adaptive", "uniform", "fixed", "xyz", "y", "1,1,0",
         "planar", "spatial", "0:0.4", "mm", "m", "um", "in", "steel:0.3x50", "nylon:1x20", "steel:0.01x2000", "steel:0.3x60",
         "box:24x34x44", "cylinder:40x44", "sphere:60", "box:1x1x1", "sphere:1e9", "cylinder:0x0", "box:24x34", "linear",
         "constant")  # fmt: skip
MESHES = ("box.stl", "box.ply", "box.obj", "box.off", "box.glb", "text.stl", "ball.ply", "torus.stl")
CHOICES = {
    "mesh": MESHES,
    "other": MESHES,
    "hull": ("", "--hull"),
    "log": ("log", "log", "specimen"),
    "truth": ("", "--truth=box.stl"),
    "model": ("", "--model=planar", "--model=planar", "--model=spatial"),
    "method": ("", *(f"--method={method}" for method in METHODS)),
    "unit": ("mm", "m", "um", "in"),
    "planes": ("", "--spacing=adaptive", "--axis=1,2,3", "--axis=xyz", "--noise=1e-3"),
    "solid": ("other.off", "box.stl"),
    "rig": ("", "--rig=rig.toml"),
    "after": ("", "--after=specimen.csv"),
    "faults": ("", "--faults=faults.toml", "--faults=faults.toml"),
    "imported": ("--out=o.csv", "--out=o.csv", "--dry-run --picture=o.png"),
    "format": ("npz", "npy", "mat", "h5", "parquet", "xlsx", "lvm", "txt", "tsv"),
    "map": ("--map=raw_map.toml --out=o.csv", "--map=raw_map.toml --out=o.csv", "--map=first.toml --guess"),
    "results": ("scan", "scan", "scan/cloud.ply", "scan/surface.ply"),
    "ending": ("stl", "ply", "obj", "glb", "vtp", "mat", "pcd", "xyz", "xyzn", "csv"),
}
"""What stands for a name in braces."""
AROUND = "--around=box:24x34x44"


class Command(NamedTuple):
    """What is called, with names in braces, and what of it is changed."""

    line: str
    files: str = ""
    """Of which one is changed, four times of five."""
    options: str = ""
    """Of which up to three are given a number or a word."""
    weight: int = 1


SIZES = "slices samples sweeps friction clearance tolerance noise seed rod axis spacing unit method model"
LIMITS = "samples clearance max-force floor speed"
RAW = "raw.csv raw.csv raw_map.toml raw_map.toml rig.toml specimen.csv"
RIG = "poses.csv poses.csv poses.toml faults.toml faults.toml"
SCAN = "scan/report.json scan/report.json scan/cloud.ply scan/surface.ply scan/recording.csv scan/recording.toml"
# Half of the inputs are recordings and tables of measurements.
COMMANDS = (
    Command(
        "reconstruct {log}.csv --out=o {truth} {model} {method}", "{log}.csv {log}.csv {log}.csv {log}.toml", weight=6
    ),
    Command("show {log}.csv --html=o.html", "{log}.csv {log}.csv {log}.csv {log}.toml"),
    Command("import raw.csv --map=raw_map.toml {rig} {after} {imported}", RAW, "rig after html", weight=2),
    Command("import raw.csv --map=first.toml --guess", RAW),
    Command("import raw.{format} {map}", "raw.{format} raw.{format} raw_map.toml", weight=3),
    Command(
        "calibrate touches.csv --sphere=30 --out=o.toml", "touches.csv touches.toml", "sphere unit tare pose-noise"
    ),
    Command("reconstruct sweep.csv --out=o", "sweep.csv", "rod noise-force noise-moment"),
    Command("scan {mesh} --out=o.csv --slices=4 --samples=20 {hull}", "{mesh}"),
    Command("simulate {mesh} --out=o.csv --slices=4 --samples=20 {hull}", "{mesh}"),
    Command("scan {mesh} --out=o.csv --slices=4 --samples=20 {hull}", options=SIZES),
    Command("simulate {mesh} --out=o.csv --slices=4 --samples=20 {hull}", options=SIZES),
    Command("compare {mesh} {other}", "{mesh} {other}"),
    Command("simulate box.stl --out=o.csv --config=config.toml", "config.toml"),
    # a file of settings is also a grid with one value of each
    Command("batch box.stl --out=o --grid=config.toml", "config.toml"),
    Command("show {results} --html=o.html", SCAN, weight=2),
    Command("export {results} --to=o.{ending}", "scan/cloud.ply scan/surface.ply"),
    Command("scan body.off --out=o --slices=4 --samples=20 --unit={unit} {method} {planes}"),
    Command("compare body.off {solid}"),
    Command(
        f"plan {AROUND} --slices=4 --samples=20 --out=o.csv",
        options=f"around model slices sweeps rod unit {LIMITS}",
        weight=2,
    ),
    Command(
        "simulate box.stl --poses=poses.csv --friction=0.3 --out=o.csv {faults}",
        RIG,
        "rod model friction seed unit noise",
        2,
    ),
    Command(
        f"next out {AROUND} --samples=16 --out=o.csv",
        "out/report.json specimen.csv specimen.toml out/cloud.ply",
        f"tolerance around sweeps seed {LIMITS}",
        2,
    ),
)


def mutated(data, chance):
    """The bytes with one to three changes: bytes, numbers, pieces removed, repeated or exchanged."""
    for _ in range(chance.choice((1, 1, 1, 2, 3))):
        how = chance.choice(
            ("flip", "flip", "cut", "number", "number", "number", "remove", "repeat", "line", "insert", "word")
        )
        if not data:
            return chance.randbytes(chance.randint(0, 40))
        at = chance.randrange(len(data))
        if how == "flip":
            data = data[:at] + bytes([data[at] ^ 1 << chance.randrange(8)]) + data[at + 1 :]
        elif how == "cut":
            data = data[:at]
        elif how == "insert":
            data = data[:at] + chance.randbytes(chance.randint(1, 8)) + data[at:]
        elif how in ("remove", "repeat"):
            end = at + chance.randint(1, 200)
            data = data[:at] + data[at:end] * (2 if how == "repeat" else 0) + data[end:]
        elif how == "line":
            lines = data.split(b"\n")
            k = chance.randrange(len(lines))
            lines[k : k + 1] = chance.choice(([], [lines[k]] * 2, [chance.choice(lines)]))
            data = b"\n".join(lines)
        elif how == "word":
            data = _replace(
                data, rb"[A-Za-z_]{3,}", chance, lambda: chance.choice((b"length", b"x", b"face", b"vertex", b"\xff"))
            )
        else:
            data = _replace(data, rb"-?[0-9][0-9.e+-]*", chance, lambda: chance.choice(NUMBERS).encode())
    return data


def _replace(data, pattern, chance, word):
    """The data with one match of the pattern replaced; matches in the first bytes, where headers are, are taken more often."""
    found = list(re.finditer(pattern, data[: 2000 if chance.random() < 0.5 else 200_000]))
    if not found:
        return data
    match = chance.choice(found)
    return data[: match.start()] + word() + data[match.end() :]


def body(chance):
    """An OFF of a random convex body: of any size, far from the origin, thin, with many or few corners, or in one plane."""
    draw = np.random.default_rng(chance.getrandbits(32))
    points = draw.standard_normal((chance.choice((4, 5, 8, 30, 200)), 3))
    if chance.random() < 0.3:
        points = np.sign(points) * (1 + 1e-9 * points * (chance.random() < 0.5))
    if chance.random() < 0.3:
        points /= np.linalg.norm(points, axis=1, keepdims=True)
    points *= 10.0 ** draw.uniform(-1, 0, 3) if chance.random() < 0.7 else 10.0 ** draw.uniform(-9, 0, 3)
    points += draw.standard_normal(3) * 10.0 ** chance.choice((-9, 0, 0, 1, 3, 6, 9))
    try:
        shape = hull(points)
        faces, used = np.asarray(shape.faces), np.asarray(shape.vertices)
    except ValueError:
        faces, used = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]), points
    used = used * 10.0 ** chance.choice((0, 0, 1, 1, 2, -3, 3, -6, 6, -12, 12, -30, 30, -150, 150, -300, 290))
    lines = [f"{x!r} {y!r} {z!r}" for x, y, z in used.tolist()] + [f"3 {a} {b} {c}" for a, b, c in faces.tolist()]
    return "\n".join([f"OFF\n{len(used)} {len(faces)} 0", *lines, ""])


def columns(text, chance):
    """A recording with some columns scaled, shifted, exchanged or made constant, or some rows left out or in another order."""
    draw = np.random.default_rng(chance.getrandbits(32))
    head, *lines = text.splitlines()
    table = np.array([line.split(",") for line in lines], dtype=float)
    for _ in range(chance.randint(1, 2)):
        first, second = draw.integers(0, table.shape[1], 2)
        rows = slice(None) if chance.random() < 0.6 else slice(*sorted(draw.integers(0, len(table), 2).tolist()))
        how = chance.choice(
            ("scale", "shift", "swap", "constant", "shuffle", "choose", "repeat", "noise", "sign", "sweeps")
        )
        values = table[rows, first]
        if how == "scale":
            table[rows, first] = values * 10.0 ** draw.uniform(-20, 20)
        elif how == "shift":
            table[rows, first] = values + draw.standard_normal() * 10.0 ** draw.uniform(-9, 3)
        elif how == "noise":
            table[rows, first] = values + draw.standard_normal(len(values)) * 10.0 ** draw.uniform(-12, 0)
        elif how == "swap":
            table[rows, [first, second]] = table[rows, [second, first]]
        elif how == "constant":
            table[rows, first] = draw.choice([0.0, 1.0, values[0] if len(values) else 0.0])
        elif how == "sign":
            table[rows, first] = -values
        elif how == "sweeps":
            table[rows, 0] = draw.integers(-3, 3, len(values))
        elif how == "shuffle":
            table = draw.permutation(table)
        else:
            kept = draw.integers(0, len(table), chance.choice((1, 2, 3, 30, len(table))))
            table = table[np.sort(kept)] if how == "choose" else np.concatenate([table, table[kept]])
    rows = (",".join(map(repr, row)) for row in table.tolist())
    return "\n".join([head, *rows]) + "\n"


def thinned(text, chance):
    """A recording of which little is left: some sweeps, few rows of each, one contact in a slice or in all, or a single row."""
    head, *lines = text.splitlines()
    names = head.split(",")
    rows = [dict(zip(names, line.split(","), strict=True)) for line in lines]
    moments = [abs(float(row["mz_Nm"])) for row in rows]
    touching = [moment > 0.01 * max(moments) for moment in moments]
    heights = [round(float(row["z_m"]), 3) for row in rows]
    kept = [True] * len(rows)
    for _ in range(chance.randint(1, 2)):
        how = chance.choice(("only", "sweep", "rows", "row", "contact", "contact", "ends"))
        groups = chance.choice(([row["sweep"] for row in rows], heights))
        known = sorted({*groups})
        some = {*chance.sample(known, chance.choice((1, 1, 2, len(known))))}
        single, left = chance.randrange(len(rows)), dict.fromkeys(known, 0)
        for k, group in enumerate(groups):
            left[group] += touching[k] if how == "contact" else 1
            kept[k] &= {
                "only": group in some,
                "sweep": group == min(some),
                "rows": group not in some or chance.random() < 0.1,
                "row": k == single,
                "contact": group not in some or not touching[k] or left[group] == 1,
                "ends": group not in some or left[group] <= 2,
            }[how]
    return "\n".join([head, *(line for line, keep in zip(lines, kept, strict=True) if keep), ""])


def write_table(name, chance):
    """Write the raw table in the format of the file's ending: perhaps with two rates or times of day."""
    table = pandas.read_csv(name.with_suffix(".csv"))
    if chance.random() < 0.2:
        table["t_s"] = [f"23:{59 if t < 1 else 0:02}:{t % 60:09.6f}" for t in table["t_s"]]
    arrays = {one: table[one].to_numpy() for one in table if table[one].dtype != object}
    if chance.random() < 0.2:
        arrays = {one: values[:: chance.choice((1, 2))] for one, values in arrays.items()}
    if name.suffix == ".npz":
        np.savez_compressed(name, **arrays)
    elif name.suffix == ".npy":
        np.save(name, chance.choice((table.to_numpy(), table.to_records(index=False), next(iter(arrays.values())))))
    elif name.suffix == ".mat":
        savemat(name, chance.choice((arrays, {"log": arrays})), do_compression=chance.random() < 0.5)
    elif name.suffix == ".h5":
        with h5py.File(name, "w") as file:
            for one, values in arrays.items():
                file[f"log/{one}"] = values
    elif name.suffix == ".parquet":
        table.to_parquet(name)
    elif name.suffix == ".xlsx":
        table.head(60).to_excel(name, index=False)
    else:
        text = table.to_csv(sep="\t" if name.suffix != ".txt" else ";", index=False, decimal=chance.choice((".", ",")))
        if name.suffix == ".lvm":
            head = "LabVIEW Measurement\t\nSeparator\tTab\nDecimal_Separator\t.\n***End_of_Header***\t\n\n***End_of_Header***\n"
            text = head + text.replace("\n", "\tComment\n", 1)
        name.write_bytes(text.encode(chance.choice(("utf-8", "utf-16", "latin-1"))))


def attempt(chance, source, folder):
    """Copy the files of the source into a folder, change some, and return the command to run there."""
    shutil.copytree(source, folder, dirs_exist_ok=True)
    for name in ("body.off", "other.off"):
        (folder / name).write_text(body(chance))
    command = chance.choices(COMMANDS, [command.weight for command in COMMANDS])[0]
    names = {name: chance.choice(known) for name, known in CHOICES.items()}
    if "{format}" in command.line:
        write_table(folder / f"raw.{names['format']}", chance)
    files, options = command.files.format(**names).split(), command.options.split()
    if files and chance.random() < 0.8:
        name = chance.choice(files)
        path = folder / name
        if name in ("log.csv", "specimen.csv", "touches.csv") and chance.random() < 0.8:
            path.write_text(chance.choice((columns, thinned))(path.read_text(), chance))
        else:
            path.write_bytes(mutated(path.read_bytes(), chance))
    chosen = chance.sample(options, chance.randint(not files, 3) if options else 0)
    return command.line.format(**names).split() + [f"--{name}={chance.choice(NUMBERS + WORDS)}" for name in chosen]


def prepare(folder):
    """Write the right files that are changed."""
    with tempfile.TemporaryDirectory() as whole:
        corpus.make(whole)
        for name in (*MESHES[:5], "log.csv", "log.toml"):
            shutil.copy(Path(whole) / name, folder)
        shutil.copytree(Path(whole) / "scan", folder / "scan")
    box = trimesh.creation.box((20, 30, 40))
    (folder / "text.stl").write_text(box.export(file_type="stl_ascii"))
    trimesh.creation.icosphere(subdivisions=1, radius=9).export(folder / "ball.ply")
    trimesh.creation.torus(9, 3, major_sections=12, minor_sections=8).export(folder / "torus.stl")
    chosen = "slices = 4\nsamples = 20\nclearance = 0.3\nnoise = 0.0\nseed = 0\nhull = false\n"
    named = 'spacing = "cosine"\naxis = "z"\nfriction = "0.3"\nrod = "auto"\n'
    (folder / "config.toml").write_text(chosen + named)
    (folder / "faults.toml").write_text(rigs.FAULTS.replace("rate_hz = 40", "rate_hz = 20\nspeed_mm_s = 60.0"))
    write_recording(rigs.recorded(samples=30), folder / "touches.csv")
    sweep = planar.sweep(planar.Circle(radius=0.4, center=(0.0, 0.7)), friction=0.3, samples=30)
    rows = zip(*(getattr(sweep, name).tolist() for name in ("x0", "f0x", "f0y", "m0z")), strict=True)
    lines = [",".join("0" if value != value else repr(value) for value in row) for row in rows]
    (folder / "sweep.csv").write_text("\n".join(["x0,f0x,f0y,m0z", *lines, ""]))
    with contextlib.chdir(folder), mock.patch.object(canvas, "can_render", return_value=False):
        _run(f"plan {AROUND} --slices=4 --sweeps=4 --samples=24 --rod=steel:0.3x60 --speed=60 --out=poses.csv")
        _run("simulate box.stl --poses=poses.csv --faults=faults.toml --friction=0.3 --out=raw.csv")
        _run("import raw.csv --map=raw_map.toml --out=specimen.csv")
        _run("reconstruct specimen.csv --model=planar --out=out")
        _run("calibrate touches.csv --sphere=30 --out=rig.toml")


def _run(line):
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as err:
        code = main(line.split())
    assert code == 0, (line, err.getvalue())


def warm():
    """Import what the commands import, so that every child begins with it."""
    import matplotlib.colors
    import pyvista

    import scan3d.cli.commands
    import scan3d.files.shapes
    import scan3d.pictures.page
    import scan3d.simulation.scan

    return matplotlib, pyvista, scan3d
