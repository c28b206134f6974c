"""Scans of a moment, for the tests of what is shown."""

import functools
from pathlib import Path

import numpy as np

import scan3d
from scan3d import scenes
from scan3d.bracket import bracket, certificate
from scan3d.comparison import distances
from scan3d.surfaces import surface

FOLDER = Path(__file__).parents[1] / "meshes"
CUBE, EGG = FOLDER / "cube.stl", FOLDER / "egg.stl"


@functools.cache
def scanned(path, **plan):
    """The scene of a scan of 8 slices, with its truth."""
    mesh = scan3d.load_mesh(path)
    recording = scan3d.simulate(
        mesh, scan3d.Plan(**{**dict(slices=8, sweeps=6, samples=16, friction=(0.1, 0.4)), **plan})
    )
    cloud = scan3d.reconstruct(recording)
    found = surface(cloud, "hull")
    return scenes.of_cloud(
        cloud,
        distances(cloud.points, mesh),
        name=path.stem,
        surface=found,
        bound=certificate(bracket(cloud), found)[1].astype(np.float32),
        truth=mesh,
        recording=recording,
        figures=(
            ("contacts", str(len(cloud))),
            ("Hausdorff distance", "0.1 mm"),
            ("friction", "0.25"),
            ("size", "40 mm"),
        ),
    )
