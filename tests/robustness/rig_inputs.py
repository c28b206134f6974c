"""Random changes of files and options of the commands for a rig: plan, simulate --poses, import, calibrate, next, and the table
of one sweep."""

import contextlib
import io
import os
from pathlib import Path

import trimesh

import planar
from scan3d.cli import main
from scan3d.files.recordings import write_recording
from scan3d.pictures import canvas
from tests import rigs

KINDS = ("plan", "plan", "poses", "poses", "import", "import", "import", "calibrate", "next", "next", "sweep")
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
    could, canvas.can_render = canvas.can_render, lambda: False
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


def attempt(kind, chance, folder, change, numbers, columns):
    """Change some of the files in a folder's `FOLDER`, and return the command to run in the folder.

    change
        changes the bytes of one file at random.
    numbers
        that options are given, besides words.
    columns
        changes the columns of a table at random.
    """
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
