"""The import rule of the wings, and who may print: by reading the source, by import-linter, and in child processes."""

import ast
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MODULES = {
    ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path
    for package in ("planar", "scan3d")
    for path in (ROOT / package).rglob("*.py")
}
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
CONTRACTS = PROJECT["tool"]["importlinter"]["contracts"]
LAYERS = [{name.strip() for name in line.split("|")} for line in CONTRACTS[0]["layers"]]
# What knows the true body or reads it, and the commands, which compare with it.
TRUTH = {"scan3d.simulation", "scan3d.files.meshes"}
ABOVE_TRUTH = {"scan3d.cli"}
STEP_2 = {
    "scan3d.reconstruction",
    "scan3d.laboratory",
    "scan3d.surfaces",
    "scan3d.planning",
    "scan3d.cloud",
    "scan3d.recording",
}


def wing(name):
    """The sub-package or module directly below scan3d that a module belongs to."""
    return name.split(".")[1]


def imported(name):
    """What a module imports anywhere in it, functions included, as dotted names; not what only a type checker sees."""
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
    return names


def reached(name):
    """All modules of ours that a module imports, directly or through others."""
    seen, pending = set(), {name}
    while pending:
        module = pending.pop()
        seen.add(module)
        pending |= (imported(module) & set(MODULES)) - seen
    return seen


def loaded(statement):
    """Names of the top-level packages that a fresh interpreter has loaded after the statement."""
    code = f"import sys; {statement}; print(*sorted({{name.partition('.')[0] for name in sys.modules}}))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(run.stdout.split())


def upward_imports(line_of):
    """Imports between wings of scan3d that do not go down; `line_of` gives the line of a wing."""
    wrong = []
    for name in MODULES:
        if not name.startswith("scan3d.") or wing(name) == "__main__":
            continue
        for target in imported(name) & set(MODULES):
            if target.startswith("scan3d.") and wing(target) != wing(name) and line_of(target) <= line_of(name):
                wrong.append((name, target))
    return wrong


def line_of(name):
    return next(k for k, line in enumerate(LAYERS) if wing(name) in line)


def test_the_reading_of_imports_sees_sub_packages_and_functions():
    # on modules known to import these, so that the rules below can fail
    assert "scan3d.simulation.scan" in imported("scan3d.cli.verbs")  # inside a function
    assert "scan3d.files.meshes" in reached("scan3d.cli")
    assert "planar" in imported("scan3d.reconstruction.contacts")
    assert len([name for name in MODULES if name.startswith("scan3d.geometry.")]) >= 5


def test_every_module_of_scan3d_stands_in_one_line_of_the_rule():
    assert CONTRACTS[0]["exhaustive"]
    wings = {wing(name) for name in MODULES if name.startswith("scan3d.")} - {"__main__"}
    assert wings == set().union(*LAYERS)
    assert sum(map(len, LAYERS)) == len(wings)


def test_wings_import_only_from_lines_below_their_own():
    assert upward_imports(line_of) == []
    # the same rule with the lines reversed is broken everywhere
    assert len(upward_imports(lambda name: -line_of(name))) > 100


def copied(tmp_path):
    """A copy of the packages and of the import rule, to break them in."""
    for package in ("planar", "scan3d"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


def lint(folder):
    code = (
        "import sys; sys.path.insert(0, ''); from importlinter.cli import lint_imports; "
        "sys.exit(lint_imports(no_cache=True))"
    )
    return subprocess.run([sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(
    ("file", "text", "sentence"),
    [
        ("scan3d/stray.py", '"""A module in no wing."""\n', "stray"),
        ("scan3d/stray/__init__.py", '"""A wing in no line."""\n', "stray"),
        ("scan3d/geometry/up.py", "import scan3d.cloud\n", "scan3d.geometry.up"),
        ("scan3d/surfaces/up.py", "def late():\n    import scan3d.files.meshes\n", "scan3d.surfaces.up"),
        ("scan3d/pictures/across.py", "import scan3d.surfaces.choice\n", "scan3d.pictures.across"),
        ("planar/up.py", "import scan3d.units\n", "planar.up"),
        (None, "", ""),
    ],
)
def test_import_linter_enforces_the_rule(tmp_path, file, text, sentence):
    folder = copied(tmp_path)
    if file is not None:
        (folder / file).parent.mkdir(exist_ok=True)
        (folder / file).write_text(text, encoding="utf-8")
    run = lint(folder)
    assert run.returncode == (0 if file is None else 1), run.stdout + run.stderr
    assert sentence in run.stdout


def test_no_imports_in_a_circle():
    order, done = [], set()

    def visit(name, path):
        assert name not in path, f"{' -> '.join([*path, name])} is a circle"
        if name in done:
            return
        done.add(name)
        for target in sorted(imported(name) & set(MODULES) - {name}):
            # a package hands on names of the modules in it
            if MODULES[target].name != "__init__.py":
                visit(target, [*path, name])
        order.append(name)

    for name in sorted(MODULES):
        visit(name, [])
    assert len(order) == len(MODULES)


def test_results_show_themselves_by_one_late_import():
    late = {name for name, path in MODULES.items() if "import_module" in path.read_text(encoding="utf-8")}
    # the public names of the package, the pictures of results, and an optional library
    assert late == {"scan3d", "scan3d.shown", "scan3d.pictures.movie"}


def test_planar_needs_numpy_and_scipy_and_nothing_else():
    third_party = loaded("import planar") - set(sys.stdlib_module_names) - loaded("pass")
    assert {"planar", "numpy", "scipy"} <= third_party
    assert not third_party & {"scan3d", "trimesh", "pyvista", "vtk", "vtkmodules", "open3d", "matplotlib"}
    # numpy and scipy may bring packages themselves
    assert third_party - loaded("import scipy.integrate, scipy.special, scipy.optimize.elementwise") == {"planar"}


@pytest.mark.parametrize("name", sorted(name for name in MODULES if name.startswith("planar.")))
def test_no_module_of_planar_imports_more(name):
    packages = {target.partition(".")[0] for target in imported(name)} - set(sys.stdlib_module_names)
    assert packages <= {"planar", "numpy", "scipy"}


@pytest.mark.parametrize("name", sorted(name for name in MODULES if any(name.startswith(top) for top in STEP_2)))
def test_what_reconstructs_does_not_know_the_truth(name):
    assert not {module for module in reached(name) if any(module.startswith(top) for top in TRUTH)}


def test_what_reconstructs_loads_nothing_that_knows_the_truth():
    names = sorted(name for name in MODULES if any(name.startswith(top) for top in STEP_2))
    code = f"import sys, {', '.join(names)}; print(*(n for n in sys.modules if n.startswith('scan3d')))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert set(run.stdout.split()) >= set(names)
    assert not {name for name in run.stdout.split() if any(name.startswith(top) for top in TRUTH | ABOVE_TRUTH)}


@pytest.mark.parametrize("name", sorted(MODULES))
def test_only_the_command_line_prints(name):
    tree = ast.parse(MODULES[name].read_text(encoding="utf-8"))
    calls = [node.func for node in ast.walk(tree) if isinstance(node, ast.Call)]
    prints = [call for call in calls if getattr(call, "id", None) == "print"]
    streams = [node for node in ast.walk(tree) if isinstance(node, ast.Attribute) and node.attr in ("stdout", "stderr")]
    if name == "scan3d.cli.verbs":
        assert prints  # so that the test can fail
    elif not name.startswith("scan3d.cli."):
        assert not prints
        assert not [node for node in streams if getattr(node.value, "id", None) == "sys"]


@pytest.mark.parametrize("name", sorted(MODULES))
def test_modules_and_functions_stay_short(name):
    text = MODULES[name].read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 350
    functions = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.FunctionDef)]
    long = {node.name for node in functions if node.end_lineno - node.lineno + 1 > 60}
    assert long == ({"parser"} if name == "scan3d.cli.parser" else set())


@pytest.mark.parametrize(
    "statement", ["import scan3d", "from scan3d.cli.parser import parser; parser()", "import scan3d.cli"]
)
def test_help_waits_for_no_heavy_library(statement):
    heavy = {"numpy", "scipy", "trimesh", "pyvista", "vtkmodules", "open3d", "matplotlib"}
    assert not (loaded(statement) - loaded("pass")) & heavy


@pytest.mark.slow
def test_a_scan_by_default_does_not_load_open3d():
    statement = (
        "import scan3d; mesh = scan3d.load_mesh(r'%s'); "
        "scan3d.compare(scan3d.surface(scan3d.reconstruct(scan3d.simulate(mesh, scan3d.Plan(slices=4)))), mesh)"
    )
    assert "open3d" not in loaded(statement % (ROOT / "meshes" / "cube.stl"))


def test_planar_is_imported_without_what_few_of_its_functions_need():
    """Its import takes a quarter of a second, most of it for numpy and scipy.special."""
    late = ("scipy.optimize", "scipy.integrate", "scipy.spatial")
    code = f"import sys, planar; print([name for name in {late} if name in sys.modules])"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "[]"
