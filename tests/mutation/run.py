"""Mutation testing: change the source a little, and see whether a test notices.

    python tests/mutation/run.py                              # all mutants of all targets: hours
    python tests/mutation/run.py --sample 300 --seed 1        # 300 of them, spread evenly over the modules
    python tests/mutation/run.py --modules planar/elastica.py scan3d/surfaces/bounds.py
    python tests/mutation/run.py --again                      # the survivors of the last run only

`targets.toml` beside this file says which modules are mutated and which tests may notice.  A first run of these tests
records which lines each of them runs and how long it takes.  Each mutant then meets the tests that run its line, the
fastest first, up to the first failure.  Written to `out/mutants`: `survivors.diff` and `results.json`.  A survivor that
`survivors.md`, beside this file, explains counts as explained in the summary.

The mutant is loaded in a child process that is forked after numpy, scipy and the test libraries are imported, so that a
mutant starts without importing them.  There are two limits: a test that starts a separate Python process sees the unchanged
source there, and a test that finds a result in a `functools.cache` of another test is not known to run the lines behind it.

Existing programs are not used: mutmut 3.8 mutates functions only, hence none of the modules' constants (tolerances, numbers of
standard deviations), leaves out functions with most decorators, takes no sample, and runs all tests again before the first
mutant.  cosmic-ray 8.7 starts the whole test command anew for each mutant, which takes 3 s before the first test, runs all
tests for each, and takes no sample either.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import glob
import hashlib
import importlib.util
import json
import os
import pickle
import random
import re
import resource
import signal
import sys
import time
import tomllib
import traceback
from collections.abc import Callable, Iterator
from importlib.machinery import ModuleSpec, SourceFileLoader
from pathlib import Path
from types import CodeType, FrameType
from typing import Any, NamedTuple

ROOT = Path(__file__).parents[2]
HERE = Path(__file__).parent
OUT = ROOT / "out" / "mutants"

sys.path.insert(0, str(HERE))
from mutants import Mutant, mutants  # noqa: E402

# Imported once, before the forks.
_PRELOADED = (
    "hypothesis",
    "mpmath",
    "numpy.testing",
    "pytest",
    "scipy.integrate",
    "scipy.interpolate",
    "scipy.optimize.elementwise",
    "scipy.sparse.csgraph",
    "scipy.spatial.transform",
    "scipy.special",
    "trimesh",
    "vtkmodules.util.numpy_support",
    "vtkmodules.vtkCommonDataModel",
)
_PYTEST = ("-x", "-q", "--tb=no", "-p", "no:cacheprovider", "-W", "ignore::pytest.PytestAssertRewriteWarning")
# A mutant has timed out after this many seconds, and this many times the time that its tests take without it.
_PATIENCE_S, _PATIENCE = 15.0, 3.0
_MOST_MEMORY = 12 << 30
_OK, _NO_TESTS = 0, 5

Lines = frozenset[tuple[str, int]]
Say = Callable[[str], None]


class Test(NamedTuple):
    """A test as it ran on the unchanged source."""

    name: str
    seconds: float
    lines: Lines
    """Module, relative to the project, and line."""


class Result(NamedTuple):
    group: str
    mutant: Mutant
    outcome: str
    """``killed``, ``timed out``, ``survived`` or ``not reached`` (no test runs the line)."""
    tests: int
    seconds: float


# --- what each test runs ---


class _Recorder:
    """A pytest plugin that records the lines of some files that each test runs, those of its fixtures included."""

    def __init__(self, files: set[str]) -> None:
        self.files = files
        self.tests: dict[str, tuple[float, set[tuple[str, int]], list[str]]] = {}
        self.fixtures: dict[str, set[tuple[str, int]]] = {}
        self._hits: set[tuple[str, int]] = set()
        self._all: dict[CodeType, set[int]] = {}

    def _trace(self, frame: FrameType, event: str, argument: Any) -> Any:
        code = frame.f_code
        if code.co_filename not in self.files:
            return None
        if code not in self._all:
            self._all[code] = {line for _, _, line in code.co_lines() if line}
        return None if all((code.co_filename, line) in self._hits for line in self._all[code]) else self._line

    def _line(self, frame: FrameType, event: str, argument: Any) -> Any:
        if event == "line":
            self._hits.add((frame.f_code.co_filename, frame.f_lineno))
        return self._line

    @contextlib.contextmanager
    def _recording(self, hits: set[tuple[str, int]]) -> Iterator[None]:
        before, self._hits = self._hits, hits
        try:
            yield
        finally:
            self._hits = before

    def hooks(self) -> Any:
        import pytest

        recorder = self

        class Hooks:
            @pytest.hookimpl(wrapper=True)
            def pytest_runtest_protocol(self, item: Any) -> Any:
                hits: set[tuple[str, int]] = set()
                start = time.perf_counter()
                with recorder._recording(hits):
                    sys.settrace(recorder._trace)
                    try:
                        done = yield
                    finally:
                        sys.settrace(None)
                fixtures = [d.baseid + name for name, ds in item._fixtureinfo.name2fixturedefs.items() for d in ds]
                recorder.tests[item.nodeid] = time.perf_counter() - start, hits, fixtures
                return done

            @pytest.hookimpl(wrapper=True)
            def pytest_fixture_setup(self, fixturedef: Any) -> Any:
                hits = recorder.fixtures.setdefault(fixturedef.baseid + fixturedef.argname, set())
                with recorder._recording(hits):
                    return (yield)

        return Hooks()

    def result(self) -> list[Test]:
        found = []
        for name, (seconds, hits, fixtures) in self.tests.items():
            lines = hits.union(*(self.fixtures.get(fixture, set()) for fixture in fixtures))
            found.append(Test(name, seconds, frozenset((os.path.relpath(f, ROOT), n) for f, n in lines)))
        return found


def _recorded(test_file: str, modules: list[Path]) -> list[Test]:
    """The tests of one file, from the last time if neither source nor tests have changed since."""
    sources = [*sorted(ROOT.glob("planar/**/*.py")), *sorted(ROOT.glob("scan3d/**/*.py")), ROOT / "tests/conftest.py"]
    content = b"".join(path.read_bytes() for path in [*sources, ROOT / test_file])
    key = hashlib.sha256(content + repr(modules).encode()).hexdigest()[:20]
    stored = OUT / "recorded" / f"{Path(test_file).stem}-{key}.pickle"
    if not stored.exists():
        stored.parent.mkdir(parents=True, exist_ok=True)

        def record() -> int:
            import pytest

            recorder = _Recorder({str(ROOT / module) for module in modules})
            code = pytest.main([*_PYTEST[1:], test_file], plugins=[recorder, recorder.hooks()])
            if code == _OK:
                stored.write_bytes(pickle.dumps(recorder.result()))
            return int(code)

        code = _in_child(record, 3600.0)
        if code != _OK:
            sys.exit(f"{test_file} must pass on the unchanged source, but pytest returned {code}: see {OUT}/last.log")
    return pickle.loads(stored.read_bytes())  # type: ignore[no-any-return]


# --- one mutant ---


class _Finder:
    """Loads one module from another text than its file's."""

    def __init__(self, mutant: Mutant) -> None:
        parts = mutant.path.with_suffix("").parts
        self._name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        self._path = str(ROOT / mutant.path)
        code = compile(mutant.text, self._path, "exec", dont_inherit=True)

        class Loader(SourceFileLoader):
            def get_code(self, fullname: str) -> CodeType:
                return code

        self._loader = Loader(self._name, self._path)

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        if name != self._name:
            return None
        return importlib.util.spec_from_file_location(name, self._path, loader=self._loader)


class _Order:
    """A pytest plugin that runs some tests only, in the given order, and lets hypothesis stop at the first failure."""

    def __init__(self, names: list[str]) -> None:
        self._names = names

    def pytest_configure(self) -> None:
        from hypothesis import Phase, settings

        settings.register_profile("mutation", settings.default, phases=[Phase.explicit, Phase.generate], database=None)
        settings.load_profile("mutation")

    def pytest_collection_modifyitems(self, items: list[Any]) -> None:
        found = {item.nodeid: item for item in items}
        items[:] = [found[name] for name in self._names if name in found]


def _in_child(work: Callable[[], int], timeout: float) -> int | None:
    """What the work returns in a forked process; None if it takes longer.  Ends all that it has started."""
    sys.stdout.flush()
    child = os.fork()
    if child == 0:
        code = 99
        try:
            os.setsid()
            log = os.open(OUT / "last.log", os.O_RDWR | os.O_CREAT | os.O_TRUNC)
            for stream in (0, 1, 2):
                os.dup2(log, stream)
            resource.setrlimit(resource.RLIMIT_DATA, (_MOST_MEMORY, _MOST_MEMORY))
            code = work()
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code)
    end, status = time.monotonic() + timeout, None
    try:
        while time.monotonic() < end:
            done, waited = os.waitpid(child, os.WNOHANG)
            if done:
                status = waited
                break
            time.sleep(0.01)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)
        if status is None:
            os.waitpid(child, 0)
    return None if status is None else os.waitstatus_to_exitcode(status)


def _meets(mutant: Mutant, tests: list[Test]) -> list[Test]:
    """The tests that may notice a mutant, the fastest first."""
    module = str(mutant.path)
    first, last = mutant.lines
    lines = {(module, line) for line in range(first, last + 1)}
    mentioned: frozenset[str] = frozenset()
    if not mutant.function or not any(lines & test.lines for test in tests):
        # run while the module is loaded: the tests that use the names, or else the module
        source = mutant.source.decode().splitlines()
        uses = {(module, i) for i, line in enumerate(source, 1) if any(name in line for name in mutant.names)}
        if mutant.names and any(uses & test.lines for test in tests):
            lines = uses
        elif not mutant.function or mutant.function.rpartition(".")[2][:1].isupper():
            lines = {(module, line) for line in range(1, len(source) + 1)}
            mentioned = frozenset({*mutant.names, mutant.function.partition(".")[0]} - {""})
    chosen = [test for test in tests if lines & test.lines or _mentions(test.name.partition("::")[0], mentioned)]
    return sorted(chosen, key=lambda test: test.seconds)


@functools.cache
def _words(test_file: str) -> frozenset[str]:
    return frozenset(re.findall(r"\w+", (ROOT / test_file).read_text(encoding="utf-8")))


def _mentions(test_file: str, names: frozenset[str]) -> bool:
    return not names.isdisjoint(_words(test_file))


def try_mutant(group: str, mutant: Mutant, tests: list[Test], most_seconds: float) -> Result:
    """Run the tests that may notice a mutant, as many as take `most_seconds` without it."""
    start = time.monotonic()
    chosen: list[str] = []
    expected = 0.0
    for test in _meets(mutant, tests):
        if chosen and expected + test.seconds > most_seconds:
            break
        chosen.append(test.name)
        expected += test.seconds
    if not chosen:
        return Result(group, mutant, "not reached", 0, 0.0)

    def run() -> int:
        import pytest

        sys.meta_path.insert(0, _Finder(mutant))
        files = sorted({name.partition("::")[0] for name in chosen})
        return int(pytest.main([*_PYTEST, *files], plugins=[_Order(chosen)]))

    code = _in_child(run, _PATIENCE_S + _PATIENCE * expected)
    outcome = "timed out" if code is None else "survived" if code == _OK else "killed"
    return Result(group, mutant, outcome, len(chosen), time.monotonic() - start)


# --- all ---


def _paths(patterns: list[str]) -> list[Path]:
    """Python files, relative to the project, that patterns and folders mean."""
    found: dict[Path, None] = {}
    for pattern in patterns:
        matches = sorted(glob.glob(pattern, root_dir=ROOT))
        if not matches:
            sys.exit(f"targets.toml names {pattern}, which does not exist")
        for match in matches:
            inside = sorted((ROOT / match).rglob("*.py")) if (ROOT / match).is_dir() else [ROOT / match]
            found |= {path.relative_to(ROOT): None for path in inside}
    return list(found)


def _sampled(found: list[Mutant], fraction: float, chance: random.Random) -> list[Mutant]:
    """A fraction of the mutants of a module, in the order of the source."""
    if fraction >= 1:
        return found
    chosen = chance.sample(range(len(found)), min(len(found), max(1, round(fraction * len(found)))))
    return [found[i] for i in sorted(chosen)]


def _summary(results: list[Result], explained: Callable[[Mutant], bool]) -> str:
    columns = ("killed", "timed out", "survived", "not reached", "explained")
    rows = []
    modules = list(dict.fromkeys(str(result.mutant.path) for result in results))
    for module in [*modules, "all"]:
        of_module = [r for r in results if module in ("all", str(r.mutant.path))]
        count = [sum(r.outcome == outcome for r in of_module) for outcome in columns[:4]]
        alive = [r for r in of_module if r.outcome in columns[2:4]]
        count.append(sum(explained(r.mutant) for r in alive))
        rate = 100 * (count[0] + count[1]) / len(of_module)
        rows.append(f"{module:34}{len(of_module):8}" + "".join(f"{n:12}" for n in count) + f"{rate:10.1f} %")
    head = f"{'module':34}{'mutants':>8}" + "".join(f"{name:>12}" for name in columns) + f"{'killed':>12}"
    return "\n".join([head, *rows])


def run(modules: list[str], sample: int | None, seed: int, again: bool, most_seconds: float, say: Say) -> list[Result]:
    """Results of a run, in the order of the targets; a `sample` of about so many, or all mutants."""
    groups = tomllib.loads((HERE / "targets.toml").read_text(encoding="utf-8"))
    found: list[tuple[str, list[Mutant]]] = []
    for group, target in groups.items():
        for path in _paths(target["modules"]):
            if not modules or any(path == Path(m) or Path(m) in path.parents for m in modules):
                found.append((group, mutants(ROOT, path)))
    if not found:
        sys.exit(f"none of the modules in targets.toml is {', '.join(modules)}")
    if again:
        last = json.loads((OUT / "results.json").read_text())
        alive = {(r["module"], r["change"]) for r in last if r["outcome"] in ("survived", "not reached")}
        found = [(group, [m for m in ms if (str(m.path), m.label) in alive]) for group, ms in found]
    elif sample is not None:
        fraction = sample / max(1, sum(len(ms) for _, ms in found))
        found = [(group, _sampled(ms, fraction, random.Random(f"{seed} {ms[0].path}"))) for group, ms in found if ms]
    # once for all targets, which have tests in common
    targets = [path for target in groups.values() for path in _paths(target["modules"])]
    results: list[Result] = []
    for group in dict.fromkeys(group for group, ms in found if ms):
        say(f"{group}: recording what the tests run")
        tests = [test for path in _paths(groups[group]["tests"]) for test in _recorded(str(path), targets)]
        todo = [mutant for other, ms in found if other == group for mutant in ms]
        for number, mutant in enumerate(todo, 1):
            results.append(try_mutant(group, mutant, tests, most_seconds))
            result = results[-1]
            say(
                f"{group} {number}/{len(todo)} {result.seconds:6.1f} s  {result.outcome:11} {mutant.path}: {mutant.label}"
            )
    return results


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--modules", nargs="+", default=[], metavar="PATH", help="only these files or folders")
    parser.add_argument("--sample", type=int, metavar="N", help="about N mutants, spread evenly; without it all")
    parser.add_argument("--seed", type=int, default=0, help="of the sample")
    parser.add_argument("--again", action="store_true", help="only what survived the last run")
    parser.add_argument("--seconds", type=float, default=60.0, help="of tests per mutant at most (60)")
    parser.add_argument("--least", type=float, metavar="PERCENT", help="fail if fewer mutants are killed")
    given = parser.parse_args()

    os.chdir(ROOT)
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(variable, "1")  # threads do not survive a fork
    sys.path.insert(0, str(ROOT))
    for name in _PRELOADED:
        importlib.import_module(name)
    OUT.mkdir(parents=True, exist_ok=True)

    def say(line: str) -> None:
        print(line, file=sys.stderr, flush=True)

    results = run(given.modules, given.sample, given.seed, given.again, given.seconds, say)
    text = HERE / "survivors.md"
    known = text.read_text(encoding="utf-8") if text.exists() else ""

    def explained(mutant: Mutant) -> bool:
        return f"{mutant.label}: " in known

    alive = [r for r in results if r.outcome in ("survived", "not reached")]
    name = "again" if given.again else "survivors"
    parts = [
        f"# {r.outcome}{', explained' if explained(r.mutant) else ''}: {r.mutant.label}\n{r.mutant.diff}" for r in alive
    ]
    (OUT / f"{name}.diff").write_text("\n".join(parts), encoding="utf-8")
    if not given.again:
        rows = [
            {
                "module": str(r.mutant.path),
                "change": r.mutant.label,
                "outcome": r.outcome,
                "seconds": round(r.seconds, 2),
            }
            for r in results
        ]
        (OUT / "results.json").write_text(json.dumps(rows, indent=1, ensure_ascii=False), encoding="utf-8")
    print(_summary(results, explained) if results else "nothing to do")
    killed = 100 * (1 - len(alive) / max(1, len(results)))
    return int(given.least is not None and killed < given.least)


if __name__ == "__main__":
    sys.exit(main())
