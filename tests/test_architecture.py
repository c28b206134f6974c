"""The two walls of the house, and who may print: by importing in a child process, and by reading the source."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MODULES = {
    f"{p.parent.name}.{p.stem}".removesuffix(".__init__"): p
    for package in ("planar", "scan3d")
    for p in (ROOT / package).glob("*.py")
}
# What knows the truth, and what may know it: the commands, which compare with it.
TRUTH = {"scan3d.bodies", "scan3d.planning", "scan3d.simulation"}
COMMANDS = {f"scan3d.{name}" for name in ("cli", "commands", "settings", "batch", "doctor", "__main__")}
STEP_2 = {name for name in MODULES if name.startswith("scan3d.")} - TRUTH - COMMANDS


def imported(name):
    """What a module imports anywhere in it, functions included, as dotted names; not what only a type checker sees."""
    found = set()

    def visit(node):
        if isinstance(node, ast.If) and getattr(node.test, "id", None) == "TYPE_CHECKING":
            for one in node.orelse:
                visit(one)
            return
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name} imports relatively"
            # `from package import module` and `from module import name` look alike
            found.update([node.module, *(f"{node.module}.{alias.name}" for alias in node.names)])
        for child in ast.iter_child_nodes(node):
            visit(child)

    visit(ast.parse(MODULES[name].read_text(encoding="utf-8")))
    return found


def reached(name):
    """All modules of ours that a module imports, directly or through others."""
    seen, todo = set(), {name}
    while todo:
        one = todo.pop()
        seen.add(one)
        todo |= (imported(one) & set(MODULES)) - seen
    return seen


def loaded(statement):
    """Names of the top-level packages that a fresh interpreter has loaded after the statement."""
    code = f"import sys; {statement}; print(*sorted({{name.partition('.')[0] for name in sys.modules}}))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(run.stdout.split())


def test_the_reading_of_imports_finds_what_it_should():
    # on modules known to import these, so that the walls below can fail
    assert "scan3d.simulation" in imported("scan3d.commands")  # inside a function
    assert "scan3d.bodies" in reached("scan3d.cli")  # through commands
    assert "planar" in imported("scan3d.cloud")
    assert {"scan3d.recording", "scan3d.cloud", "scan3d.surfaces", "scan3d.files", "scan3d.reports"} <= STEP_2


def test_planar_needs_numpy_and_scipy_and_nothing_else():
    third_party = loaded("import planar") - set(sys.stdlib_module_names) - loaded("pass")
    assert {"planar", "numpy", "scipy"} <= third_party
    assert not third_party & {"scan3d", "trimesh", "pyvista", "vtk", "vtkmodules", "open3d", "matplotlib"}
    # what numpy and scipy bring themselves is theirs
    assert third_party - loaded("import scipy.integrate, scipy.special, scipy.optimize.elementwise") == {"planar"}


@pytest.mark.parametrize("name", sorted(name for name in MODULES if name.startswith("planar.")))
def test_no_module_of_planar_imports_more(name):
    tops = {one.partition(".")[0] for one in imported(name)} - set(sys.stdlib_module_names)
    assert tops <= {"planar", "numpy", "scipy"}


@pytest.mark.parametrize("name", sorted(STEP_2))
def test_what_reconstructs_does_not_know_the_truth(name):
    assert not reached(name) & TRUTH


def test_what_reconstructs_loads_nothing_that_knows_the_truth():
    code = f"import sys, {', '.join(STEP_2)}; print(*(n for n in sys.modules if n.startswith('scan3d')))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert set(run.stdout.split()) >= STEP_2
    assert not set(run.stdout.split()) & TRUTH


@pytest.mark.parametrize("name", sorted(MODULES))
def test_only_the_command_line_prints(name):
    tree = ast.parse(MODULES[name].read_text(encoding="utf-8"))
    calls = [node.func for node in ast.walk(tree) if isinstance(node, ast.Call)]
    prints = [call for call in calls if getattr(call, "id", None) == "print"]
    streams = [node for node in ast.walk(tree) if isinstance(node, ast.Attribute) and node.attr in ("stdout", "stderr")]
    if name == "scan3d.cli":
        assert prints  # so that the test can fail
    else:
        assert not prints
        assert not [node for node in streams if getattr(node.value, "id", None) == "sys"]


@pytest.mark.parametrize("statement", ["import scan3d", "import scan3d.cli; scan3d.cli._parser()"])
def test_help_waits_for_no_heavy_library(statement):
    heavy = {"numpy", "scipy", "trimesh", "pyvista", "vtkmodules", "open3d", "matplotlib"}
    assert not (loaded(statement) - loaded("pass")) & heavy


def test_a_scan_by_default_does_not_load_open3d():
    statement = (
        "import scan3d; mesh = scan3d.load_mesh(r'%s'); "
        "scan3d.compare(scan3d.surface(scan3d.reconstruct(scan3d.simulate(mesh, scan3d.Plan(slices=4)))), mesh)"
    )
    assert "open3d" not in loaded(statement % (ROOT / "meshes" / "cube.stl"))


def test_planar_is_imported_without_what_few_of_its_functions_need():
    """It takes a quarter of a second, most of it numpy's and scipy.special's."""
    late = ("scipy.optimize", "scipy.integrate", "scipy.spatial")
    code = f"import sys, planar; print([name for name in {late} if name in sys.modules])"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "[]"
