"""Random changes of files and options of the commands for a rig: plan, simulate --poses, import, calibrate, next, and the table
of one sweep."""

import contextlib
import io
import os
from pathlib import Path

import h5py
import numpy as np
import pandas
import trimesh
from scipy.io import savemat

import planar
from scan3d.cli import main
from scan3d.files.recordings import write_recording
from scan3d.pictures import canvas
from tests import rigs

KINDS = ("plan", "plan", "poses", "poses", "next", "next")
TABLES = ("import", "import", "format", "format", "format", "calibrate", "sweep")
"""What is measured: tables and recordings."""
FOLDER = "rig"
"""Name of the folder with the right files."""
_FAULTS = rigs.FAULTS.replace("rate_hz = 40", "rate_hz = 20\nspeed_mm_s = 60.0")
_AROUND = ("box:24x34x44", "cylinder:40x44", "sphere:60")
_WORDS = (*_AROUND, "box:1x1x1", "sphere:1e9", "cylinder:0x0", "box:24x34", "steel:0.3x60", "nylon:1x20", "planar", "spatial",
          "mm", "m", "in", "auto", "linear", "constant")  # fmt: skip
_PLAN = ("around", "model", "slices", "sweeps", "rod", "unit")
_LIMITS = ("samples", "clearance", "max-force", "floor", "speed")
_OPTIONS = {
    "plan": _PLAN + _LIMITS,
    "poses": ("rod", "model", "friction", "seed", "unit", "noise"),
    "import": ("rig", "after", "html"),
    "calibrate": ("sphere", "unit", "tare", "pose-noise"),
    "next": ("tolerance", "around", "sweeps", "seed", *_LIMITS),
    "sweep": ("rod", "noise-force", "noise-moment"),
}


def prepare(source):
    """Write the right files into the folder `FOLDER` of `source`."""
    place = source / FOLDER
    place.mkdir()
    (place / "faults.toml").write_text(_FAULTS)
    trimesh.creation.box((20, 30, 40)).export(place / "box.stl")
    write_recording(rigs.recorded(samples=30), place / "touches.csv")
    sweep = planar.sweep(planar.Circle(radius=0.4, center=(0.0, 0.7)), friction=0.3, samples=30)
    rows = zip(*(getattr(sweep, name).tolist() for name in ("x0", "f0x", "f0y", "m0z")), strict=True)
    lines = [",".join("0" if value != value else repr(value) for value in row) for row in rows]
    (place / "sweep.csv").write_text("\n".join(["x0,f0x,f0y,m0z", *lines, ""]))
    could, canvas.can_render = canvas.can_render, lambda *_: False
    before = Path.cwd()
    try:
        os.chdir(place)
        rod = "--rod=steel:0.3x60"
        around = f"--around={_AROUND[0]}"
        _run("plan", around, "--slices=4", "--sweeps=4", "--samples=24", rod, "--speed=60", "--out=poses.csv")
        _run("simulate", "box.stl", "--poses=poses.csv", "--faults=faults.toml", "--friction=0.3", "--out=raw.csv")
        _run("import", "raw.csv", "--map=raw_map.toml", "--out=specimen.csv")
        _run("reconstruct", "specimen.csv", "--model=planar", "--out=out")
        _run("calibrate", "touches.csv", "--sphere=30", "--out=rig.toml")
    finally:
        os.chdir(before)
        canvas.can_render = could


def _run(*argv):
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as err:
        code = main(list(argv))
    assert code == 0, (argv, err.getvalue())


def _written(path, chance):
    """The raw table in another format than text with commas, named after its ending: perhaps with two rates or times of day."""
    table = pandas.read_csv(path)
    name = path.with_suffix(chance.choice((".npz", ".npy", ".mat", ".h5", ".parquet", ".xlsx", ".lvm", ".txt", ".tsv")))
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
    return name.name


def attempt(kind, chance, folder, change, numbers, columns):
    """Change some of the files in a folder's `FOLDER`, and return the command to run in the folder.

    change
        changes the bytes of one file at random.
    numbers
        that options are given, besides words.
    columns
        changes the columns of a table at random.
    """
    if kind == "format":
        name = _written(folder / FOLDER / "raw.csv", chance)
        if chance.random() < 0.5:
            change(f"{FOLDER}/{chance.choice((name, name, 'raw_map.toml'))}")
        guess = ["--map", "first.toml", "--guess"]
        known = ["--map", f"{FOLDER}/raw_map.toml", "--out", "o.csv"]
        return ["import", f"{FOLDER}/{name}", *chance.choice((guess, known, known))]
    names = {
        "poses": ("poses.csv", "poses.csv", "poses.toml", "faults.toml", "faults.toml"),
        "import": ("raw.csv", "raw.csv", "raw_map.toml", "raw_map.toml", "rig.toml", "specimen.csv"),
        "calibrate": ("touches.csv", "touches.toml"),
        "next": ("out/report.json", "specimen.csv", "specimen.toml", "out/cloud.ply"),
        "sweep": ("sweep.csv",),
    }
    if kind in names and chance.random() < 0.8:
        name = chance.choice(names[kind])
        if name in ("specimen.csv", "touches.csv") and chance.random() < 0.7:
            path = folder / FOLDER / name
            path.write_text(columns(path.read_text(), chance))
        else:
            change(f"{FOLDER}/{name}")
    count = chance.randint(1, 3) if kind == "plan" else chance.choice((0, 0, 1, 2))
    chosen = chance.sample(_OPTIONS[kind], count)
    options = [f"--{name}={chance.choice(numbers + _WORDS)}" for name in chosen]
    rig = chance.choice(([], ["--rig", f"{FOLDER}/rig.toml"]))
    after = chance.choice(([], ["--after", f"{FOLDER}/specimen.csv"]))
    shown = chance.choice((["--out", "o.csv"], ["--out", "o.csv"], ["--dry-run", "--picture", "o.png"]))
    usual = {
        "plan": [f"--around={_AROUND[0]}", "--slices=4", "--samples=20"],
        "poses": [f"{FOLDER}/box.stl", "--poses", f"{FOLDER}/poses.csv", "--friction=0.3"],
        "import": [f"{FOLDER}/raw.csv", "--map", f"{FOLDER}/raw_map.toml", *rig, *after, *shown],
        "calibrate": [f"{FOLDER}/touches.csv", "--sphere=30"],
        "next": [f"{FOLDER}/out", f"--around={_AROUND[0]}", "--samples=16"],
        "sweep": [f"{FOLDER}/sweep.csv", "--out", "o"],
    }[kind]
    if kind == "import" and chance.random() < 0.25:
        return ["import", f"{FOLDER}/raw.csv", "--map", "first.toml", "--guess"]
    command = {"poses": "simulate", "sweep": "reconstruct"}.get(kind, kind)
    faults = ["--faults", f"{FOLDER}/faults.toml"] if kind == "poses" and chance.random() < 0.7 else []
    ending = {"plan": "csv", "calibrate": "toml"}.get(kind, "csv")
    out = [] if kind in ("import", "sweep") else ["--out", f"o.{ending}"]
    return [command, *usual, *faults, *out, *options]
