"""Odd meshes, recordings, settings, reports and clouds, each with what a command should answer to it."""

import io
import json
import os
import pickle
import struct
import warnings
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

import scan3d
from scan3d import pipeline
from scan3d.files.recordings import write_recording
from scan3d.pictures import canvas

HUGE = "1" * 400
"""A number of 400 digits, which no float can hold."""


@dataclass(frozen=True)
class Case:
    """A command and what it should do."""

    name: str
    argv: tuple[str, ...]
    code: int
    message: str = ""
    """Part of what is printed to stderr."""


def make(folder):
    """Write the files of the corpus into a folder and return its cases; the commands run in that folder."""
    folder = Path(folder)
    box = trimesh.creation.box((20, 30, 40))
    for ending in ("stl", "ply", "obj", "off", "glb"):
        box.export(folder / f"box.{ending}")
    recording = scan3d.simulate(scan3d.load_mesh(folder / "box.stl"), scan3d.Plan(slices=4, samples=20))
    write_recording(recording, folder / "log.csv")
    (folder / "scan").mkdir()
    could, canvas.can_render = canvas.can_render, lambda *_: False
    try:
        analysis = pipeline.analyse(recording, scan3d.load_mesh(folder / "box.stl"))
        pipeline.write(analysis, folder / "scan", settings={"friction": "0.3"})
    finally:
        canvas.can_render = could
    return [*_meshes(folder, box), *_recordings(folder), *_tables(folder), *_options(), *_configs(folder)]


# --- meshes ---


def _meshes(folder, box):
    stl, glb = (folder / "box.stl").read_bytes(), (folder / "box.glb").read_bytes()
    text = (folder / "box.off").read_text()
    header = b"ply\nformat binary_little_endian 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n"
    lists = b"property list uchar int vertex_indices\nend_header\n"
    files = {
        "cut.stl": (stl[:-120], "cut off, damaged"),
        "count.stl": (stl[:80] + struct.pack("<I", 4_000_000_000) + stl[84:], "cut off, damaged"),
        "cut_text.stl": (box.export(file_type="stl_ascii").encode()[:-300], "cut off, damaged or another kind of file"),
        "cut.off": ("\n".join(text.split("\n")[:-4]).encode(), "declares 12 faces and holds"),
        "cut.ply": ((folder / "box.ply").read_bytes()[:-60], "cut off, damaged"),
        "cut.glb": (glb[:-40], "cut off, damaged"),
        "faces.ply": (header + b"element face " + b"1" + b"0" * 30 + b"\n" + lists + b"\0" * 200, "cut off, damaged"),
        "digits.ply": (header + b"element face " + b"9" * 5000 + b"\n" + lists + b"\0" * 200, "PLY"),
        "accessor.glb": (_glb_with_count(glb, 100_000_000), "cut off, damaged"),
        "nan.off": (text.replace("-10.00000000", "nan", 1).encode(), "OFF"),
        "huge.off": (text.replace("-10.00000000", HUGE, 1).encode(), "NaN, infinite or beyond"),
        "index.off": (text.replace("3 ", "3 99 ", 1).encode(), "OFF"),
        "null.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2\n", "OBJ"),
        "escape\x1b[31m.stl": (b"solid x", "escape\\x1b[31m.stl"),
        "line\nbreak.stl": (b"solid x", "break.stl"),
        "turn\u202egnp.stl": (b"solid x", "turn\\u202egnp.stl"),
        "empty.glb": (b"", "is empty"),
    }
    cases = []
    for name, (data, message) in files.items():
        (folder / name).write_bytes(data)
        for hull in ([], ["--hull"]):
            cases.append(Case(f"simulate {name}", ("simulate", name, "--out", "o.csv", *hull), 1, message))
        cases.append(Case(f"compare {name}", ("compare", name, "box.stl"), 1, message))
    os.mkfifo(folder / "pipe.stl")
    os.symlink("/dev/zero", folder / "zero.stl")
    os.symlink("/dev/zero", folder / "zero.csv")
    (folder / "folder.stl").mkdir()
    far = {"pipe.stl": "device or a pipe", "zero.stl": "device or a pipe", "folder.stl": "is a folder"}
    cases += [Case(f"compare {name}", ("compare", name, "box.stl"), 1, message) for name, message in far.items()]
    cases.append(Case("scan a device", ("scan", "/dev/zero", "--out", "o"), 1, "isn't a mesh file"))
    for power in (18, -18):
        big = box.copy()
        big.apply_scale(10.0**power)
        (folder / f"scaled{power}.off").write_text(big.export(file_type="off", digits=20))
        cases.append(Case(f"compare 1e{power}", ("compare", "box.stl", f"scaled{power}.off"), 0))
        cases.append(Case(f"compare 1e{power} back", ("compare", f"scaled{power}.off", "box.stl"), 0))
    for power in (-300, -150, 150, 300):
        lines = text.split("\n")
        corners = [" ".join(f"{word}e{power}" for word in line.split()) for line in lines[2:10]]
        (folder / f"scaled{power}.off").write_text("\n".join([*lines[:2], *corners, *lines[10:]]))
        why = "beyond 1e+60" if power > 0 else "no numbers of a computer"
        cases.append(Case(f"compare 1e{power}", ("compare", "box.stl", f"scaled{power}.off"), 1, why))
        cases.append(Case(f"scan 1e{power}", ("scan", f"scaled{power}.off", "--out", "o"), 1))
    return cases


def _glb_with_count(data, count):
    """The GLB with another count in its first accessor, which has no data any more."""
    size = struct.unpack_from("<I", data, 12)[0]
    tree = json.loads(data[20 : 20 + size])
    tree["accessors"][0] = {**tree["accessors"][0], "count": count}
    tree["accessors"][0].pop("bufferView")
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + size :]
    return struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A) + text + rest


# --- recordings ---


def _recordings(folder):
    table, rod = (folder / "log.csv").read_text(), (folder / "log.toml").read_text()
    lines = table.splitlines()
    column = lines[0].split(",")

    def changed(row, name, value):
        cells = lines[row].split(",")
        cells[column.index(name)] = value
        return "\n".join([*lines[:row], ",".join(cells), *lines[row + 1 :]])

    tables = {
        "huge": (changed(7, "fy_N", HUGE), "line 8 has inf in column 'fy_N'"),
        "large": (changed(7, "fy_N", "1e200"), "force_N holds 1e+200"),
        "far sweep": (changed(7, "sweep", "1e18"), "line 8 has 1e+18 in column 'sweep', where a whole number"),
        "quaternion": (changed(7, "qw", "3"), "must be unit quaternions"),
        "zero quaternion": (changed(7, "qw", "1e300"), "must be unit quaternions"),
        "two rows in one": ("\n".join([*lines[:7], lines[7] + "," + lines[8], *lines[9:]]), "line 8 has 22 values"),
        "binary": ("\0\1\2\3" * 50, "is no text"),
        "twice": (table.replace("sweep,x_m", "sweep,sweep,x_m", 1), "its header has sweep more than once"),
        "no contact": (
            "\n".join([lines[0], *[",".join([*row.split(",")[:8], "0", "0", "0"]) for row in lines[1:]]]),
            "no",
        ),
    }
    rods = {
        "misspelt": (rod.replace("length_m", "lenght_m"), "did you mean length_m?"),
        "section": (rod.replace("[noise]", "[nosie]"), "did you mean noise?"),
        "schema": (rod.replace("schema = 1", "schema = 7"), "schema 7 is not known"),
        "digits": (_replaced(rod, "length_m", HUGE), "must be a finite number"),
        "many digits": (_replaced(rod, "length_m", "1" * 5000), "is not a TOML file"),
        "infinite": (_replaced(rod, "length_m", "inf"), "must be a finite number"),
        "tiny": (_replaced(rod, "length_m", "1e-300"), "reactions that are no numbers"),
        "list": (_replaced(rod, "unit", "[1]"), "unit must be one of"),
        "nested": ("a = " + "[" * 5000 + "]" * 5000, "is not a TOML file"),
        "escape": (_replaced(rod, "unit", '"\\u001b[31mred"'), "\\x1b[31mred"),
    }
    cases = []
    for name, (text, message) in tables.items():
        place = f"table {name}.csv"
        (folder / place).write_text(text)
        (folder / f"table {name}.toml").write_text(rod)
        cases.append(Case(place, ("reconstruct", place, "--out", "o"), 1, message))
    for name, (text, message) in rods.items():
        place = f"rod {name}.csv"
        (folder / place).write_text(table)
        (folder / f"rod {name}.toml").write_text(text)
        cases.append(Case(place, ("reconstruct", place, "--out", "o"), 1, message))
        cases.append(Case(f"show {place}", ("show", place, "--html", "o.html"), 1, message))
    stiff = _replaced(rod, "bending_stiffness_Nm2", str(2**32))  # no error of the wrench changes a contact
    for name, (text, toml) in {
        "mac": (table.replace("\n", "\r"), rod),
        "dos": (table.replace("\n", "\r\n"), rod),
        "bom": ("\ufeff" + table, rod),
        "24 axes": (table.replace("z_m,qw,qx", "qx,qw,z_m", 1), rod),  # with a slice along each
        "stiff": (table, stiff),
    }.items():
        (folder / f"{name}.csv").write_text(text, newline="")
        (folder / f"{name}.toml").write_text(toml)
        cases.append(Case(name, ("reconstruct", f"{name}.csv", "--out", f"out {name}"), 0))
    cases.append(Case("device", ("reconstruct", "zero.csv", "--out", "o"), 1, "device or a pipe"))
    return cases


def _replaced(toml, name, value):
    return "\n".join(f"{name} = {value}" if line.startswith(f"{name} =") else line for line in toml.splitlines())


# --- tables of a rig ---


def _tables(folder):
    """Tables that are refused in a sentence, and before they are loaded."""
    rod = "[rod]\nlength_m = 0.05\nbending_stiffness_Nm2 = 1e-4\n"
    named = 'time = "t"\nposition = ["x", "y", "z"]\norientation = {quaternion = ["w", "a", "b", "c"]}\n'
    columns = f'[columns]\n{named}force = ["f", "g", "h"]\nmoment = ["k", "l", "m"]\n'
    text = f'# für die Waage\n{columns}[units]\nlength = "mm"\nforce = "N"\nmoment = "N m"\n{rod}'
    (folder / "map.toml").write_text(text, encoding="utf-16")
    (folder / "latin.toml").write_text(text, encoding="latin-1")
    names = "txyzwabcfghklm"
    rows = {name: np.zeros(10 if name in "fghklm" else 20) for name in names}
    np.savez(folder / "rates.npz", **rows)
    np.savez(folder / "pickled.npz", **{name: np.array([None]) for name in names})
    (folder / "pickle.npy").write_bytes(pickle.dumps([1.0]))
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (10**12,)})
    with zipfile.ZipFile(folder / "huge.npz", "w") as file:
        file.writestr("t.npy", head.getvalue() + bytes(100))
    with warnings.catch_warnings(), zipfile.ZipFile(folder / "twice.npz", "w") as file:
        warnings.simplefilter("ignore")
        for _ in range(2):
            file.writestr("t.npy", head.getvalue())
    header = ",".join(names)
    clocks = [f"{k}:00," + ",".join("0" * 13) for k in range(20)]
    (folder / "clock.csv").write_text("\n".join([header, *clocks, ""]))
    (folder / "quote.csv").write_text("\n".join([header, '"' + "0," * 100_000, ""]))
    (folder / "cut.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(100))
    (folder / "cut.lvm").write_text("LabVIEW Measurement\nSeparator\tTab\n***End_of_Header***\n")
    messages = {
        "rates.npz": "bring two rates to the same times",
        "pickled.npz": "holds Python objects, which are not read",
        "pickle.npy": "holds Python objects, which are not read",
        "huge.npz": "reading huge.npz needs about",
        "twice.npz": "has t more than once",
        "clock.csv": "leave time out of map.toml",
        "quote.csv": "",
        "cut.mcap": "mcap recover cut.mcap",
        "cut.lvm": "",
    }
    cases = []
    for name, message in messages.items():
        cases.append(Case(f"import {name}", ("import", name, "--map", "map.toml", "--out", "o.csv"), 1, message))
        cases.append(Case(f"guess {name}", ("import", name, "--map", f"guess {name}.toml", "--guess"), -1))
    latin = ("import", "rates.npz", "--map", "latin.toml", "--out", "o.csv")
    return [*cases, Case("a map in Latin-1", latin, 1, "line 1 is no UTF-8: save it as UTF-8")]


# --- options ---


def _options():
    small = ("--slices", "4", "--samples", "20")
    simulate = ("simulate", "box.stl", "--out", "o.csv", *small)
    wrong = {
        "slices": ("0", "-1", "abc", "1.5", "nan", HUGE, "1" * 5000, "1000000000"),
        "samples": ("0", "1", "-1", "x", HUGE, "1000000000000"),
        "sweeps": ("0", "-1", "two", "1e3", HUGE, "10000000000"),
        "friction": ("-1", "nan", "inf", "1e300", "0:1:2", "1:0", "0:nan", ":", HUGE),
        "clearance": ("0", "-1", "1", "nan", "inf", "1e-300", "1e300", HUGE),
        "tolerance": ("-1", "nan", "inf", HUGE),
        "noise": ("-1", "nan", "inf", "1e300", HUGE),
        "seed": ("-1", "1.5", "x"),
        "rod": ("steel", "steel:1x0", "steel:1e-300x50", "steel:1e300x50", "steel:0.3x1e300", f"steel:{HUGE}x1", "a:b"),
        "axis": ("w", "1,2", "0,0,0", "nan,0,1", "1e999,0,0", "xx", ",,", ""),
        "spacing": ("even", ""),
        "unit": ("furlong", "\x1b[31m"),
        "method": ("magic",),
    }
    cases = [
        Case(f"--{name}={value[:20]!r}", (*simulate, f"--{name}={value}"), _wrong(name, value))
        for name, values in wrong.items()
        for value in values
    ]
    extreme = (
        "--samples=2; --samples=3; --clearance=0.9; --clearance=0.999999; --clearance=1e-6; --friction=100; --friction=0:100; "
        "--noise=1; --noise=1e-300; --tolerance=1e300; --sweeps=1; --slices=1; --slices=2; --axis=1e300,0,0; "
        f"--axis=1e-320,0,0; --axis=1e308,1e308,1e308; --rod=steel:0.3x40; --seed={HUGE}; --spacing=adaptive --samples=2; "
        "--clearance=0.9; --axis=xyz --slices=2; --rod=steel:0.3x1e10; --rod=steel:1e20x1e20; --spacing=adaptive --slices=1; "
        "--sweeps=1 --samples=2"
    ).split("; ")
    # they may fail, in a sentence
    cases += [
        Case(words, ("scan", "box.stl", "--out", f"out {words}", *small, *words.split()), -1) for words in extreme
    ]
    cases.append(
        Case("reconstruct --method", ("reconstruct", "log.csv", "--out", "o", "--method", "magic"), 2, "Invalid value")
    )
    no_name = ("import", "log.csv", "--map", "log.toml", "--rig", "log.toml", "--after=", "--out", "i.csv")
    cases.append(Case("a recording without a name", no_name, -1))
    cases.append(Case("an escape", ("scan", "a\x1b[2Jb.stl", "--out", "o"), 1, "a\\x1b[2Jb.stl"))
    cases.append(Case("an option with an escape", ("scan", "box.stl", "--out", "o", "--a\x1b[2Jb"), 2, "--a\\x1b[2Jb"))
    cases.append(Case("a null character", ("scan", "a\0b.stl", "--out", "o"), 1, "a\\x00b.stl"))
    return cases


def _wrong(name, value):
    """The exit code: what does not fit into memory is no wrong usage."""
    return 1 if name in ("slices", "samples", "sweeps") and value.isdecimal() and 9 < len(value) < 4000 else 2


def _configs(folder):
    texts = {
        "misspelt": ("slises = 3", 1, "did you mean slices?"),
        "value": ("slices = -3", 1, "slices must be a whole number"),
        "digits": (f"clearance = {HUGE}", 1, "clearance must lie"),
        "many digits": ("slices = " + "1" * 5000, 1, "is not a TOML file"),
        "date": ("noise = 2020-01-01", 1, "noise must be a number"),
        "table": ("[rod]\nlength = 1", 1, "rod: unknown names: length"),
        "nested": ("axis = " + "[" * 3000 + "]" * 3000, 1, "is not a TOML file"),
    }
    cases = []
    for name, (text, code, message) in texts.items():
        (folder / f"config {name}.toml").write_text(text)
        argv = ("simulate", "box.stl", "--out", "o.csv", "--config", f"config {name}.toml")
        cases.append(Case(f"config {name}", argv, code, message))
    # the file is right, the command line is wrong
    (folder / "right.toml").write_text("slices = 4\nsamples = 20\n")
    argv = ("simulate", "box.stl", "--out", "o.csv", "--config", "right.toml")
    cases.append(Case("config right", (*argv, "--slices=-3"), 2, "slices must be"))
    cases.append(Case("config is a device", (*argv[:-1], "/dev/zero"), 1, "device or a pipe"))
    return cases
