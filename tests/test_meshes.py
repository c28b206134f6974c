"""The meshes to scan: exactly convex when read back, made by the script beside them, and close to their smooth bodies."""

import subprocess
import sys

import numpy as np
import pytest
from sample_bodies import MESHES as FOLDER
from sample_bodies import formulas as make_meshes

from scan3d.files.meshes import read_mesh

FILES = [FOLDER / f"{name}{suffix}" for name, (suffix, _) in make_meshes.BODIES.items()]
ROUNDING = np.sqrt(3) / 2 * make_meshes.GRID  # the farthest that a point moves to the grid, mm

# The textbook's volumes in mm³: ellipsoids, cylinders, prisms, spherical caps, Steiner's formula for the rounded box.
# The egg's taper is odd in z and cancels.
VOLUMES = {
    "sphere": 4 / 3 * np.pi * 25**3,
    "ellipsoid": 4 / 3 * np.pi * 36 * 26 * 18,
    "egg": 4 / 3 * np.pi * 21**2 * 28,
    "lens": 2 * np.pi / 3 * 10**2 * (3 * 50 - 10),
    "capsule": 4 / 3 * np.pi * 10**3 + np.pi * 10**2 * 40,
    "rounded_box": 40 * 28 * 16
    + 2 * 6 * (40 * 28 + 28 * 16 + 16 * 40)
    + np.pi * 6**2 * (40 + 28 + 16)
    + 4 / 3 * np.pi * 6**3,
    "needle": 4 / 3 * np.pi * 40 * 2 * 2,
    "disc": 4 / 3 * np.pi * 40 * 40 * 2,
    "cylinder": np.pi * 20**2 * 50,
    "cube": 40**3,
    "hexagonal_prism": 3 / 2 * np.sqrt(3) * 20**2 * 60,
}


@pytest.mark.trust
def test_the_script_makes_the_files_beside_it(tmp_path):
    run = subprocess.run([sys.executable, make_meshes.__file__, tmp_path], capture_output=True, text=True, check=True)
    assert run.stdout.split() == [str(tmp_path / file.name) for file in FILES]
    assert {file.name for file in tmp_path.iterdir()} == {file.name for file in FILES}
    for file in FILES:
        assert (tmp_path / file.name).read_bytes() == file.read_bytes(), file.name


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_the_file_reads_back_as_an_exactly_convex_body(file):
    mesh = read_mesh(file)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.body_count == 1
    assert np.all(mesh.area_faces > 0)
    assert 20 <= mesh.extents.max() <= 80

    lattice = np.rint(mesh.vertices / make_meshes.GRID)
    assert np.array_equal(lattice * make_meshes.GRID, mesh.vertices)

    # Across every edge, from both sides, the far corner of one triangle does not rise above the other's plane. Not even
    # by rounding: in steps of the grid all the numbers are integers.
    corners = lattice.astype(np.int64)
    for here, there in ((0, 1), (1, 0)):
        a, b, c = corners[mesh.faces[mesh.face_adjacency[:, here]]].swapaxes(0, 1)
        far = corners[mesh.face_adjacency_unshared[:, there]]
        assert np.max(np.sum(np.cross(b - a, c - a) * (far - a), axis=1)) <= 0

    # Inscribed but for rounding; the coarsest mesh, the needle, needs 1 %.
    assert mesh.volume > 0
    if volume := VOLUMES.get(file.stem):
        assert mesh.volume <= volume + ROUNDING * mesh.area
        assert mesh.volume == pytest.approx(volume, rel=0.01)
    if file.stem in make_meshes.SMOOTH:
        assert 5_000 <= len(mesh.faces) <= 20_000
        # To first order; 1 % covers the needle's ends, where the radius of curvature is 0.1 mm.
        assert np.max(np.abs(make_meshes.distance(file.stem, mesh.vertices))) <= 1.01 * ROUNDING
