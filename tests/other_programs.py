"""What other programs read from exported files.

`python tests/other_programs.py` prints the table of docs/files.md.  The programs run in child processes, because some of them
cannot be loaded into the same process.
"""

import re
import subprocess
import sys
import tempfile
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from scan3d.files.shapes import CLOUD_ENDINGS, SURFACE_ENDINGS, export, ply

FORMATS = [("cloud", ending) for ending in CLOUD_ENDINGS[:-1]] + [("surface", ending) for ending in SURFACE_ENDINGS]
# Turns vectors from the axes of glTF, of which y is up, to those of the world.
Y_UP = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
# Numbers with a smaller relative difference count as equal: float32 and text of six digits are allowed, and no more.
SAME = 2e-6


def example(folder):
    """Write a cloud and a surface of an ellipsoid, with normals that cannot be derived from the points."""
    random = np.random.default_rng(0)
    ball = trimesh.creation.icosphere(subdivisions=2)
    turn = trimesh.transformations.rotation_matrix(0.5, [1, 2, 3])[:3, :3]
    scalars = [("quality", "f8"), ("phase", "u1"), ("slice", "i4"), ("sweep", "i4"), ("row", "i4")]
    scalars += [("force", "f8"), ("friction", "f4"), ("normal_source", "u1"), ("cov_xy", "f4")]
    for name, columns in (("cloud", scalars), ("surface", [("bound", "f4"), ("known", "u1")])):
        spatial = [(c, "f8") for c in "xyz"] + [(f"n{c}", "f4") for c in "xyz"]
        rows = np.zeros(len(ball.vertices), [*spatial, *columns])
        for k, c in enumerate("xyz"):
            rows[c] = ball.vertices[:, k] * (30.1, 20.2, 10.3)[k] + 1 / 3
            rows[f"n{c}"] = (ball.vertices @ turn)[:, k]
        for column, kind in columns:
            rows[column] = random.random(len(rows)) if kind[0] == "f" else random.integers(1, 100, len(rows))
        (folder / f"{name}.ply").write_bytes(ply(rows, ball.faces if name == "surface" else None, ("unit mm",)))


# --- readers: the file's points (n, 3), normals (n, 3) or None, faces (m, 3) or None, and scalars by name ---


def _numpy(file, what):
    if file.suffix not in (".csv", ".mat", ".xyz", ".xyzn"):
        raise OSError("numpy reads tables of text, and scipy MATLAB's files")
    if file.suffix == ".mat":
        from scipy.io import loadmat

        read = loadmat(file)
        scalars = {name: values for name, values in read.items() if np.shape(values)[1:] == (1,)}
        faces = read["faces"].astype(int) - 1 if what == "surface" else None
        return read["points" if faces is None else "vertices"], read["normals"], faces, scalars
    if file.suffix == ".csv":
        rows = np.genfromtxt(file, delimiter=",", names=True)
        names = rows.dtype.names
        table = np.stack([rows[name] for name in names], axis=1)
        scalars = {re.sub("_(mm2?|N)$", "", name): rows[name] for name in names[6:]}
    else:
        table, scalars = np.loadtxt(file), {}
    return table[:, :3], table[:, 3:6] if table.shape[1] > 3 else None, None, scalars


def _open3d(file, what):
    import open3d

    if what == "cloud":
        read = open3d.t.io.read_point_cloud(str(file))
        columns, faces = {name: tensor.numpy() for name, tensor in read.point.items()}, None
    else:
        read = open3d.t.io.read_triangle_mesh(str(file))
        columns, faces = {name: tensor.numpy() for name, tensor in read.vertex.items()}, read.triangle.indices.numpy()
    scalars = {name: column.reshape(-1) for name, column in columns.items() if name not in ("positions", "normals")}
    return columns["positions"], columns.get("normals"), faces, scalars


def _trimesh(file, what):
    read = trimesh.load(file, process=False)
    if isinstance(read, trimesh.Scene):
        (read,) = read.geometry.values()
    if what == "cloud":
        return read.vertices, None, None, {}
    return read.vertices, read.vertex_normals, read.faces, dict(read.vertex_attributes)


def _pyvista(file, what):
    import pyvista

    read = pyvista.read(file)
    while isinstance(read, pyvista.MultiBlock):
        (read,) = read
    data = read.point_data
    normals = next((np.asarray(data[name]) for name in ("Normals", "NORMAL") if name in data), None)
    faces = read.regular_faces if what == "surface" else None
    return read.points, normals, faces, {name: np.asarray(data[name]) for name in data if data[name].ndim == 1}


def _pymeshlab(file, what):
    import pymeshlab

    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(file))
    read = meshes.current_mesh()
    scalars = {"quality": read.vertex_scalar_array()} if read.has_vertex_scalar() else {}
    faces = read.face_matrix() if what == "surface" else None
    return read.vertex_matrix(), read.vertex_normal_matrix(), faces, scalars


PROGRAMS = {"Open3D": _open3d, "trimesh": _trimesh, "pyvista": _pyvista, "pymeshlab": _pymeshlab, "numpy": _numpy}
HERE = [name for name in PROGRAMS if find_spec(name.lower())]


def read_all(program, folder):
    """Write what the program reads from every file it can read into a .npz file; runs in a child process."""
    import_module(program.lower())  # a failure here does not concern the files
    for what, ending in FORMATS:
        file = folder / f"{what}{ending}"
        try:
            points, normals, faces, scalars = PROGRAMS[program](file, what)
        except Exception as error:  # the programs raise errors of different types
            sys.stderr.write(f"{program} can't read {file.name}: {error}\n")
            continue
        given = {"points": points, "normals": normals, "faces": faces}
        given |= {f"scalar {name}": column for name, column in scalars.items()}
        kept = {name: np.asarray(column) for name, column in given.items() if column is not None}
        np.savez(file.with_name(f"{file.name}.{program}.npz"), **kept)


# --- the comparison ---


def understood(program, folder):
    """The parts of each exported file that the program reads correctly, {(what, ending): names}, in a folder of `example`."""
    for what, ending in FORMATS:
        export(folder, folder / "exported" / f"{what}{ending}", what)
    call = [sys.executable, __file__, program, str(folder / "exported")]
    done = subprocess.run(call, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    right = {(what, ending): _right(program, folder, what, ending) for what, ending in FORMATS}
    assert any(right.values()), f"{program} reads nothing (pymeshlab needs 'apt-get install libopengl0'): {done.stderr}"
    return right


def _right(program, folder, what, ending):
    from scan3d.files.shapes import read_shape

    file = folder / "exported" / f"{what}{ending}.{program}.npz"
    if not file.exists():
        return ()
    read, true = dict(np.load(file)), read_shape(folder / f"{what}.ply")
    scale = 1e-3 if ending == ".glb" else 1.0
    if ending == ".glb":  # y up
        read |= {name: read[name] @ Y_UP.T for name in ("points", "normals") if name in read}
    # programs reorder the vertices, and STL has separate corners for every triangle
    distance, index = cKDTree(true.points * scale).query(read["points"])
    size = np.abs(true.points).max() * scale
    if distance.max(initial=0) > SAME * size or set(index) != set(range(len(true.points))):
        return ()
    right = ["points"]
    if "normals" in read and np.allclose(read["normals"], true.normals[index], rtol=0, atol=SAME):
        right.append("normals")
    if "faces" in read and np.array_equal(_turned(index[read["faces"]]), _turned(true.faces)):
        right.append("faces")
    for name, column in true.columns.items():
        unit = scale if name == "bound" else 1.0
        for key in (f"scalar {name}", f"scalar _{name.upper()}"):
            if key in read and np.allclose(read[key].ravel(), column[index] * unit, rtol=SAME, atol=0):
                right.append(name)
    return tuple(right)


def _turned(faces):
    """Triangles in a canonical order, each beginning at its smallest corner; the orientation is kept."""
    first = np.argmin(faces, axis=1)[:, None]
    turned = np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)
    return turned[np.lexsort(turned.T)]


def cell(what, right):
    if not right:
        return "–"
    spatial = [name for name in right if name in ("points", "normals", "faces")]
    scalars = [name for name in right if name not in spatial]
    everything = {"cloud": 9, "surface": 2}[what]
    return ", ".join(spatial + (["all scalars"] if len(scalars) == everything else [f"`{name}`" for name in scalars]))


def table():
    with tempfile.TemporaryDirectory() as folder:
        example(Path(folder))
        columns = [understood(program, Path(folder)) for program in HERE]
    head = ["", *HERE]
    rows = [
        [f"{what} in {ending}", *(cell(what, column[what, ending]) for column in columns)] for what, ending in FORMATS
    ]
    return [f"| {' | '.join(row)} |" for row in [head, ["---"] * len(head), *rows]]


if __name__ == "__main__":
    if sys.argv[1:]:
        read_all(sys.argv[1], Path(sys.argv[2]))
    else:
        sys.stdout.write("\n".join(table()) + "\n")
