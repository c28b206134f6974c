"""Random changes of files and options over all commands: no traceback, no hang, no memory beyond 2 GB, no warning."""

import re
import shutil
import tempfile
from pathlib import Path

import numpy as np

from scan3d.geometry.hulls import hull
from tests.robustness import corpus, rig_inputs

NUMBERS = ("0", "-1", "1", "2", "3", "1e-300", "1e300", "-1e300", "nan", "inf", "-inf", "1e-9", "0.5", "1e9", "4294967296",
           "-2147483649", corpus.HUGE, "", "x", "\x1b[31m", "\u202e", "0x10", "1_0", "true", "null", "[]", "{}")  # fmt: skip
MESHES = ("box.stl", "box.ply", "box.obj", "box.off", "box.glb", "text.stl", "ball.ply", "torus.stl")
OPTIONS = ("slices", "samples", "sweeps", "friction", "clearance", "tolerance", "noise", "seed", "rod", "axis", "spacing",
           "unit", "method", "model")  # fmt: skip
WORDS = ("auto", "hull", "bracket", "support", "regression", "poisson", "adaptive", "uniform", "fixed", "xyz", "y", "1,1,0",
         "spatial", "0:0.4", "m", "um", "in", "steel:0.3x50", "nylon:1x20", "steel:0.01x2000")  # fmt: skip
# Half of the inputs are recordings and tables of measurements.
RECORDINGS = ("table", "rod", "columns", "columns", "thin", "thin", "thin", *rig_inputs.TABLES)
KINDS = ("mesh", "compare", "options", "options", "config", "show", "show", "export", "body", "body", *rig_inputs.KINDS)
METHODS = ("auto", "hull", "bracket", "support", "regression", "poisson", "ball-pivoting")
UNITS = ("mm", "m", "um", "in")
SMALL = ("--slices=4", "--samples=20")


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


def attempt(chance, source, folder):
    """Copy the files of the source into a folder, change some, and return the command to run there."""
    shutil.copytree(source, folder, dirs_exist_ok=True)

    def change(*names):
        for name in names:
            path = folder / name
            path.write_bytes(mutated(path.read_bytes(), chance))

    kind = chance.choice(chance.choice((RECORDINGS, KINDS)))
    if kind in (*rig_inputs.KINDS, *rig_inputs.TABLES):
        return rig_inputs.attempt(kind, chance, folder, change, NUMBERS, columns)
    mesh = chance.choice(MESHES)
    hull = chance.choice(([], ["--hull"]))
    if kind in ("mesh", "compare", "options"):
        if kind != "options":
            change(mesh)
        if kind == "compare":
            pair = [mesh, chance.choice(MESHES)]
            chance.shuffle(pair)
            return ["compare", *pair]
        options = {f"--{chance.choice(OPTIONS)}={chance.choice(NUMBERS + WORDS)}" for _ in range(chance.randint(1, 3))}
        given = [*SMALL, *(sorted(options) if kind == "options" else [])]
        return [chance.choice(("scan", "simulate", "simulate")), mesh, "--out", "o.csv", *given, *hull]
    if kind == "body":
        (folder / "body.off").write_text(body(chance))
        (folder / "other.off").write_text(body(chance))
        scan = [
            "scan",
            "body.off",
            "--out",
            "o",
            *SMALL,
            f"--method={chance.choice(METHODS)}",
            f"--unit={chance.choice(UNITS)}",
        ]
        scan += chance.choice(([], ["--spacing=adaptive"], ["--axis=1,2,3"], ["--axis=xyz"], ["--noise=1e-3"]))
        return chance.choice((scan, scan, ["compare", "body.off", "other.off"], ["compare", "body.off", "box.stl"]))
    if kind == "thin":
        name = chance.choice(("log", f"{rig_inputs.FOLDER}/specimen"))
        path = folder / f"{name}.csv"
        path.write_text(thinned(path.read_text(), chance))
        models = ([], ["--model=planar"], ["--model=planar"], ["--model=spatial"])
        options = [*chance.choice(models), *chance.choice(([], [f"--method={chance.choice(METHODS)}"]))]
        return ["reconstruct", f"{name}.csv", "--out", "o", *options, *chance.choice(([], ["--truth", "box.stl"]))]
    if kind in ("table", "rod", "columns"):
        if kind == "columns":
            (folder / "log.csv").write_text(columns((folder / "log.csv").read_text(), chance))
        else:
            change("log.csv" if kind == "table" else "log.toml")
        truth = chance.choice(([], [], ["--truth", "box.stl"]))
        reconstruct = ["reconstruct", "log.csv", "--out", "o", *truth]
        return chance.choice((reconstruct, reconstruct, ["show", "log.csv", "--html", "o.html"]))
    if kind == "config":
        change("config.toml")
        simulate = ["simulate", "box.stl", "--out", "o.csv", "--config", "config.toml"]
        # a file of settings is also a grid with one value of each
        return chance.choice((simulate, ["batch", "box.stl", "--out", "o", "--grid", "config.toml"]))
    if kind == "show":
        files = ("report.json", "report.json", "cloud.ply", "surface.ply", "recording.csv", "recording.toml")
        change(f"scan/{chance.choice(files)}")
        return ["show", chance.choice(("scan", "scan", "scan/cloud.ply", "scan/surface.ply")), "--html", "o.html"]
    change(chance.choice(("scan/cloud.ply", "scan/surface.ply")))
    ending = chance.choice(("stl", "ply", "obj", "glb", "vtp", "mat", "pcd", "xyz", "xyzn", "csv"))
    return ["export", chance.choice(("scan", "scan/cloud.ply", "scan/surface.ply")), "--to", f"o.{ending}"]


def prepare(folder):
    """Write the right files that are changed."""
    import trimesh

    with tempfile.TemporaryDirectory() as whole:
        corpus.make(whole)
        for name in (*MESHES[:5], "log.csv", "log.toml"):
            shutil.copy(Path(whole) / name, folder)
        shutil.copytree(Path(whole) / "scan", folder / "scan")
    box = trimesh.creation.box((20, 30, 40))
    (folder / "text.stl").write_text(box.export(file_type="stl_ascii"))
    trimesh.creation.icosphere(subdivisions=1, radius=9).export(folder / "ball.ply")
    trimesh.creation.torus(9, 3, major_sections=12, minor_sections=8).export(folder / "torus.stl")
    rig_inputs.prepare(folder)
    chosen = "slices = 4\nsamples = 20\nclearance = 0.3\nnoise = 0.0\nseed = 0\nhull = false\n"
    named = 'spacing = "cosine"\naxis = "z"\nfriction = "0.3"\nrod = "auto"\n'
    (folder / "config.toml").write_text(chosen + named)


def warm():
    """Import what the commands import, so that every child begins with it."""
    import matplotlib.colors
    import pyvista

    import scan3d.cli.commands
    import scan3d.files.shapes
    import scan3d.pictures.page
    import scan3d.simulation.scan

    return matplotlib, pyvista, scan3d
