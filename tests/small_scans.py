"""Small scans for the tests of pictures, pages, windows and movies."""

import functools
from unittest import mock

import numpy as np
import trimesh
from rigs import FAULTS
from sample_bodies import MESHES
from spatial_scans import recorded

import scan3d
from scan3d.cli import main
from scan3d.geometry.distance import distances
from scan3d.pictures import canvas
from scan3d.pictures.parts import of_cloud
from scan3d.pipeline import analyse
from scan3d.surfaces import certificate, enclosure, surface
from tests.rig_errors import six_axis

CUBE, EGG = MESHES / "cube.stl", MESHES / "egg.stl"
FEW = ("--slices", "4", "--sweeps", "4", "--samples", "8", "--quiet")
"""Options of a scan that takes a moment."""
SETTINGS = {"slices": 4, "sweeps": 4, "samples": 8}
"""Those of `FEW`, as keywords."""
RESULTS = {"recording.csv", "recording.toml", "cloud.ply", "surface.ply", "report.json", "view.html"}
"""The files of a scan without pictures."""


@functools.cache
def scanned(path, **plan):
    """The scene of a scan of 8 slices, with its truth."""
    mesh = scan3d.load_mesh(path)
    recording = scan3d.simulate(
        mesh, scan3d.Plan(**{**dict(slices=8, sweeps=6, samples=16, friction=(0.1, 0.4)), **plan})
    )
    cloud = scan3d.reconstruct(recording)
    hull = surface(cloud, "hull")
    return of_cloud(
        cloud,
        distances(cloud.points, mesh),
        name=path.stem,
        surface=hull,
        bound=certificate(enclosure(cloud), hull).at_vertices.astype(np.float32),
        truth=mesh,
        recording=recording,
        key_figures=(
            ("contacts", str(len(cloud))),
            ("Hausdorff distance", "0.1 mm"),
            ("friction", "0.25"),
            ("size", "40 mm"),
        ),
    )


@functools.cache
def ring():
    """The scene of a torus, swept in 3 slices and probed until half of it is known."""
    mesh = trimesh.creation.torus(10.0, 4.0, major_sections=24, minor_sections=12)
    recording = scan3d.simulate(mesh, scan3d.Plan(slices=3, samples=16, known=0.5))
    found = analyse(recording)
    return of_cloud(found.cloud, name="ring", surface=found.surface, recording=recording)


@functools.cache
def scanned_in_space(**raster):
    """The scene of sweeps in space past an ellipsoid about the origin; `raster` as in `spatial_scans.recorded`."""
    recording, _, _ = recorded(**{**dict(diameter=0.01, directions=6, heights=6, samples=32), **raster})
    cloud = scan3d.reconstruct(recording)
    hull = surface(cloud, "hull")
    bound = certificate(enclosure(cloud), hull).at_vertices.astype(np.float32)
    return of_cloud(cloud, name="ellipsoid", surface=hull, bound=bound, recording=recording)


def any_rod():
    """The scene of an egg and a rod that is tapered, curved and heavy, in a clamp that gives."""
    rod = scan3d.Rod(
        *(0.06, 2e-4, 5e-4),
        tip_diameter_m=2e-4,
        curvature_per_m=-4.0,
        weight_N=2e-3,
        clamp_compliance_rad_per_Nm=3.0,
    )
    down = scan3d.Gravity((0, 0, -1), True)
    return scanned(EGG, rod=rod, gravity=down, axis="x", slices=2, sweeps=4, samples=16)


def any_rod_in_space():
    recording = six_axis(any_rod().recording)
    return of_cloud(scan3d.reconstruct(recording, model="spatial"), name="egg", recording=recording)


def rig_logs(place):
    """`place` with planned poses, a file of faults, and an egg's exact log and one with faults, as the commands make them."""
    poses, faults = str(place / "poses.csv"), str(place / "faults.toml")
    (place / "faults.toml").write_text(FAULTS)
    plan = ["plan", "--around", "cylinder:60x60", "--slices", "4", "--samples", "40", "--quiet", "--out", poses]
    run = ["simulate", str(EGG), "--poses", poses, "--quiet"]
    exact = [*run, "--out", str(place / "log.csv"), "--placed", str(place / "placed.ply")]
    for command in (plan, exact, [*run, "--out", str(place / "raw.csv"), "--faults", faults]):
        assert main(command) == 0
    return place


def undrawn():
    """A context in which no pictures are drawn, which take longer than all the rest."""
    return mock.patch.object(canvas, "can_render", return_value=False)


def scanned_folder(place):
    """The folder of an egg's scan in `place`, as the command makes it without pictures, beside its mesh."""
    (place / "egg.stl").write_bytes(EGG.read_bytes())
    with undrawn():
        assert main(["scan", str(place / "egg.stl"), "--out", str(place / "out"), *FEW]) == 0
    return place / "out"
