"""What users read does not hang on the last digit: scans by other kernels of linear algebra, and of inputs moved by rounding,
print the same words, and find the same counts, methods and warnings.

A surface's number of facets is not among them: of bodies with plane faces it would be a count of slivers.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

import scan3d
from scan3d.report import summary
from scan3d.results import DEMO
from tests.sample_bodies import MESHES

# Kernels of OpenBLAS that every processor with 64 bits of its family runs, or that a user's may have.
KERNELS = ("Prescott", "Sandybridge", "Haswell")
SETTINGS = {"slices": 12, "samples": 24, "friction": "0.1:0.4"}
MOVED = 1e-13


def read_by_users(mesh, **settings):
    """Words, counts, method and warnings of a scan."""
    found = scan3d.scan(mesh, **(SETTINGS | settings)).report
    surface = {name: found["surface"][name] for name in ("method", "reason", "watertight")}
    codes = [warning["code"] for warning in found["warnings"]]
    return json.loads(json.dumps([summary(found), found["counts"], surface, codes]))


def moved(mesh, seed):
    """The mesh with each coordinate moved by a part of itself that is rounding."""
    vertices = np.array(mesh.vertices)
    vertices *= 1 + MOVED * np.random.default_rng(seed).uniform(-1, 1, vertices.shape)
    return trimesh.Trimesh(vertices, mesh.faces, process=False)


BODIES = sorted(path.name for path in MESHES.iterdir() if path.suffix in (".stl", ".ply", ".obj", ".off", ".glb"))
# Probed; a scan of the others takes longer.
HOLLOW = [pytest.param(f"hollow/{name}.stl", marks=pytest.mark.trust) for name in ("mug", "bracket", "torus")]


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        *HOLLOW,
        *(
            name if name in ("cube.stl", "capsule.stl") else pytest.param(name, marks=pytest.mark.trust)
            for name in BODIES
        ),
    ],
)
def test_inputs_that_are_moved_by_rounding_give_the_same(name):
    mesh = scan3d.load_mesh(MESHES / name)
    itself = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    known = read_by_users(itself)
    for seed in (1, 2):
        assert read_by_users(moved(mesh, seed)) == known


@pytest.mark.slow
@pytest.mark.parametrize(
    "paths",
    [
        [DEMO, MESHES / "hollow/torus.stl"],
        *(
            pytest.param([MESHES / name], marks=pytest.mark.trust)
            for name in [*BODIES, "hollow/mug.stl", "hollow/bracket.stl"]
        ),
    ],
    ids=lambda paths: " ".join(path.name for path in paths),
)
def test_other_kernels_of_linear_algebra_give_the_same(paths, request):
    scans = "[t.read_by_users(path) for path in sys.argv[1:]]"
    code = f"import json, sys, tests.test_last_digits as t; print(json.dumps({scans}))"
    runs = [
        subprocess.run(
            [sys.executable, "-c", code, *map(str, paths)],
            cwd=Path(__file__).parents[1],
            env={**os.environ, "OPENBLAS_CORETYPE": kernel},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for kernel in (KERNELS if request.node.get_closest_marker("trust") else KERNELS[::2])
    ]
    assert len(set(runs)) == 1
