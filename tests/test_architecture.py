"""Who imports whom: by import-linter, by reading the source, and in child processes."""

import ast
import functools
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MODULES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for package in ("planar", "scan3d")
    for path in (ROOT / package).rglob("*.py")
}
HEAVY = {"numpy", "scipy", "trimesh", "pyvista", "vtkmodules", "open3d", "matplotlib"}
STANDARD = sys.stdlib_module_names


@functools.cache
def imported(name):
    """Modules of ours, and other names, that a module imports anywhere in it, functions included; not what only types need."""
    names = set()

    def visit(node):
        if isinstance(node, ast.If) and getattr(node.test, "id", None) == "TYPE_CHECKING":
            for child in node.orelse:
                visit(child)
            return
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name} imports relatively"
            # `from package import module` and `from module import name` look alike
            names.update([node.module, *(f"{node.module}.{alias.name}" for alias in node.names)])
        for child in ast.iter_child_nodes(node):
            visit(child)

    visit(ast.parse(MODULES[name].read_text(encoding="utf-8")))
    return frozenset(names)


@functools.cache
def loaded(statement):
    """Names of the modules that a fresh interpreter has loaded after the statement."""
    code = f"import sys; {statement}; print(*sys.modules)"
    return set(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split())


@pytest.mark.slow
def test_no_imports_in_a_circle():
    done = set()

    def visit(name, path):
        assert name not in path, f"{' -> '.join([*path, name])} is a circle"
        if name not in done:
            done.add(name)
            for target in sorted(imported(name) & set(MODULES) - {name}):
                # a package hands on names of the modules in it
                if MODULES[target].name != "__init__.py":
                    visit(target, [*path, name])

    for name in sorted(MODULES):
        visit(name, [])
    assert done == set(MODULES)


@pytest.mark.slow
def test_planar_needs_numpy_and_scipy_and_nothing_else():
    # an interpreter of this environment may load packages itself; numpy and scipy bring some
    lent = loaded("import scipy.integrate, scipy.special, scipy.optimize.elementwise")
    third_party = {name.partition(".")[0] for name in loaded("import planar") - lent} - STANDARD
    assert third_party == {"planar"}
    targets = {
        (name, target.partition(".")[0]) for name in MODULES if name.startswith("planar") for target in imported(name)
    }
    foreign = {(name, target) for name, target in targets if target not in {"planar", "numpy", "scipy", *STANDARD}}
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
