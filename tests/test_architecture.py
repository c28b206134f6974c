"""What an import loads, in child processes, and what planar needs; who imports whom is checked by import-linter."""

import functools
import subprocess
import sys
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).parents[1]
HEAVY = {"numpy", "scipy", "trimesh", "pyvista", "vtkmodules", "open3d", "matplotlib"}
STANDARD = sys.stdlib_module_names


@functools.cache
def loaded(statement):
    code = f"import sys; {statement}; print(*sys.modules)"
    return set(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split())


@pytest.mark.slow
def test_planar_needs_numpy_and_scipy_and_nothing_else():
    # an interpreter of this environment may load packages itself; numpy and scipy bring some
    lent = loaded("import scipy.integrate, scipy.special, scipy.optimize.elementwise")
    third_party = {name.partition(".")[0] for name in loaded("import planar") - lent} - STANDARD
    assert third_party == {"planar"}
    graph = grimp.build_graph(
        "planar", include_external_packages=True, exclude_type_checking_imports=True, cache_dir=None
    )
    targets = {(name, target) for name in graph.modules for target in graph.find_modules_directly_imported_by(name)}
    foreign = {pair for pair in targets if pair[1].partition(".")[0] not in {"planar", "numpy", "scipy", *STANDARD}}
    # where a picture or a data frame is asked for
    assert foreign == {("planar.plots", "matplotlib"), ("planar.plots", "pandas")}


@pytest.mark.parametrize(
    ("statement", "not_loaded"),
    [
        # its import takes a quarter of a second, most of it for numpy and scipy.special
        ("import planar", {"scipy.optimize", "scipy.integrate", "scipy.spatial"}),
        ("import scan3d", HEAVY),
        ("from scan3d.cli.commands import app; app()['scan']", HEAVY),
    ],
)
def test_an_import_and_help_wait_for_no_heavy_library(statement, not_loaded):
    assert not loaded(statement) & not_loaded


@pytest.mark.slow
def test_a_scan_by_default_does_not_load_open3d():
    mesh = ROOT / "meshes" / "cube.stl"
    assert "open3d" not in loaded(f"import scan3d; scan3d.scan({str(mesh)!r}, slices=4, sweeps=4, samples=8)")
