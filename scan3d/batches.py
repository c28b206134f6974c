"""Many scans: meshes and settings, computed in this process, in others, or by a cluster, with one summary."""

from __future__ import annotations

import csv
import dataclasses
import glob
import io
import itertools
import logging
import os
import re
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from functools import reduce
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple, Unpack

from scan3d import pipeline
from scan3d.errors import InputError
from scan3d.files.meshes import FORMATS
from scan3d.files.text import read_section
from scan3d.files.whole import BATCH, SCHEMA, earlier_files, read_report, replacing, sha256, unchanged
from scan3d.settings import Given, Settings, shows_settings, varied_settings
from scan3d.workers import Workers, undone_if_ended

Row = dict[str, Any]
"""A row of the summary, by column; what is not known is None."""
DONE, FAILED = "done", "failed"
# The figures of a report that the summary has, by column, and where the report has them.
_FIGURES = {
    "scanned": ("mesh", "scanned"),
    "hausdorff": ("hausdorff", "two_sided"),
    "hausdorff_relative": ("hausdorff", "relative"),
    "hausdorff_mesh": ("hausdorff", "mesh_itself", "two_sided"),
    "certificate": ("certificate", "bound"),
    "certificate_relative": ("certificate", "relative"),
    "contacts": ("counts", "contacts"),
    "contact_error": ("contact_error", "max"),
    "friction_estimated": ("friction", "estimated_median"),
    "surface_method": ("surface", "method"),
    "volume_error": ("comparison", "volume_error"),
    "normals_median_deg": ("comparison", "normal_median_deg"),
    "coverage": ("coverage", "surface"),
    "surface_known": ("coverage", "known"),
    "surface_estimated": ("coverage", "estimated"),
}
_OF_SETTINGS = (field.name for field in dataclasses.fields(Settings))
COLUMNS = ("run", "mesh", "mesh_sha256", *_OF_SETTINGS, "status", "error", *_FIGURES, "warnings", "seconds")
"""The columns of the summary."""
# Seconds for which a scheduler is looked for.
_PATIENCE_S = 30
# Scans of one process take turns: a scheduler may give it several threads, for which libraries that read meshes are not made.
_ONE_AT_A_TIME = threading.Lock()


@dataclass(frozen=True, repr=False)
class Batch:
    """The summary of a batch."""

    folder: Path
    """With ``summary.csv``, ``batch.json``, and a folder for each run."""
    rows: tuple[Row, ...]
    """The rows of the summary, by column, in the order of the runs."""
    computed: int
    """Number of runs that this call has made; the others were done before."""

    @property
    def ranks(self) -> Ranks:
        """The rows of the best, the median and the worst run by the Hausdorff distance relative to the diagonal."""
        known = [row for row in self.rows if row["status"] == DONE and row["hausdorff_relative"] is not None]
        known.sort(key=lambda row: float(row["hausdorff_relative"]))
        return Ranks(known[0], known[len(known) // 2], known[-1]) if known else Ranks(None, None, None)

    @property
    def failures(self) -> list[Row]:
        """The rows of the runs that have failed."""
        return [row for row in self.rows if row["status"] == FAILED]

    def figures(self) -> dict[str, Any]:
        """The counts of runs, the names of the best, the median and the worst one, and the rows, as batch.json has them."""
        total, failed = len(self.rows), len(self.failures)
        ranks = {name: row and row["run"] for name, row in self.ranks._asdict().items()}
        return {"counts": {"runs": total, "done": total - failed, "failed": failed}, **ranks, "runs": list(self.rows)}

    def __repr__(self) -> str:
        return f"Batch of {len(self.rows)} runs, {len(self.failures)} failed, in {self.folder}"


class Ranks(NamedTuple):
    """Rows of the best, the median and the worst of the runs that are done; None if none is.

    Of an even number of runs the worse one of the two in the middle counts as the median.
    """

    best: Row | None
    median: Row | None
    worst: Row | None


class BatchProgress(NamedTuple):
    """How far a batch is."""

    done: int
    """Runs that are finished, those of earlier calls and failures included."""
    total: int
    failed: int


@shows_settings
def batch(
    paths: str | os.PathLike[str] | Iterable[str | os.PathLike[str]],
    out: str | os.PathLike[str],
    executor: Executor | None = None,
    *,
    grid: str | os.PathLike[str] | Mapping[str, Any] | None = None,
    config: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
    progress: Callable[[BatchProgress], None] = lambda _: None,
    notify: Callable[[str], None] = lambda _: None,
    **settings: Unpack[Given],
) -> Batch:
    """Scan many meshes, each with one setting or with every combination of a grid, and summarise the results in a folder.

    paths
        mesh files, folders for the mesh files in them, and patterns such as ``parts/**/*.stl``.
    out
        folder for the summary, and for a folder of results for each run, as ``scan3d scan`` writes them.
    executor
        any `concurrent.futures.Executor`, such as `scan3d.workers.Workers` for processes that compute with one thread each, or
        the executor of a Dask client; None: the runs are made in this process, one after the other.
    grid
        lists of values by setting, or the path of a TOML file with them, as `combinations` describes.
    config
        path of a TOML file of settings, over which those that are given take precedence.
    overwrite
        whether files in the folder that the program did not write may be replaced.
    progress
        called with a `BatchProgress` as runs are finished.
    notify
        called with a sentence on what is missing in results, such as pictures, once for each sentence.

    A run that fails, or whose worker dies, is a row of the summary, and the others are made.  What an earlier call has finished
    with the same mesh, settings and version of the program is not repeated.  The results do not depend on the executor, apart
    from times.

    Raises InputError for meshes, settings and grids that can't be used, if a setting is given twice, and if the folder can't be
    written into or holds files that must not be replaced.
    """
    file = Path(grid) if isinstance(grid, (str, os.PathLike)) else None
    if isinstance(grid, (str, os.PathLike)):
        grid = read_section(grid, "grid", name=str(grid)).data
    varied = [{}] if grid is None else combinations(grid, str(file or "the grid"))
    chosen = varied_settings(settings, varied, config, source="scan3d.batch", grid_source=str(file or "the grid"))
    given = [paths] if isinstance(paths, (str, os.PathLike)) else paths
    folder = Path(out)
    runs = _runs(mesh_files(given), list(zip(varied, chosen, strict=True)), folder, overwrite)
    inputs = {"grid": file, "file of settings": config}
    with replacing(folder, inputs=inputs, overwrite=overwrite, kind=BATCH) as result:
        missing = [run for run in runs if not run.is_done()]
        failures: dict[str, Outcome] = {}
        notices: set[str] = set()
        before = len(runs) - len(missing)
        progress(BatchProgress(before, len(runs), 0))
        for done, (run, outcome) in enumerate(_outcomes(missing, executor), start=before + 1):
            if outcome.error:
                failures[run.name] = outcome
            for notice in outcome.notices:
                if notice not in notices:
                    notify(notice)
                notices.add(notice)
            progress(BatchProgress(done, len(runs), len(failures)))
        made = Batch(folder, tuple(_row(run, failures.get(run.name)) for run in runs), len(missing))
        result.put("summary.csv", _csv(made.rows))
        result.commit({"schema": SCHEMA, "versions": {"scan3d": version("scan3d")}, **made.figures()})
    return made


# --- runs ---


@dataclass(frozen=True)
class Run:
    """A mesh to be scanned with some settings."""

    name: str
    """Of its folder."""
    mesh: str
    """Path of the mesh as it was given, for the summary."""
    path: str
    """Absolute path of the mesh."""
    sha256: str | None
    """Of the mesh file; None if it can't be read."""
    settings: Settings
    folder: str
    """Absolute path of the folder for the results."""
    overwrite: bool = False

    def is_done(self) -> bool:
        """Whether the folder holds the whole result of this mesh, these settings and this version of the program."""
        folder = Path(self.folder)
        try:
            report = read_report(folder)
            mesh = report["mesh"]
            is_same = (
                mesh["sha256"] == self.sha256
                and mesh["file"] == Path(self.path).name
                and report["settings"] == dataclasses.asdict(self.settings)
                and report["versions"]["scan3d"] == version("scan3d")
            )
            return is_same and set(report["files"]) == unchanged(folder)
        except (InputError, KeyError, TypeError):
            return False


class Outcome(NamedTuple):
    """What a worker says of a run."""

    error: str
    """A sentence if the run has failed, or an empty string."""
    seconds: float = 0.0
    notices: tuple[str, ...] = ()
    """Sentences about what is missing in the result, such as pictures."""


def _runs(
    paths: Sequence[Path], choices: Iterable[tuple[Mapping[str, Any], Settings]], out: Path, overwrite: bool
) -> list[Run]:
    """Every mesh with every choice, which is what a grid varies and all settings; none of them twice."""
    combined: dict[Settings, Mapping[str, Any]] = {}
    for varied, settings in choices:
        combined.setdefault(settings, varied)
    hashes = [_sha256(path) for path in paths]
    pairs = [(k, settings) for k in range(len(paths)) for settings in combined]
    labels = {settings: [f"{name}={_text(value)}" for name, value in of.items()] for settings, of in combined.items()}
    names = _distinct([_allowed("_".join([paths[k].stem, *labels[settings]])) for k, settings in pairs])
    return [
        Run(name, str(paths[k]), str(paths[k].absolute()), hashes[k], settings, str(out.absolute() / name), overwrite)
        for name, (k, settings) in zip(names, pairs, strict=True)
    ]


def _sha256(path: Path) -> str | None:
    try:
        return sha256(path) if path.is_file() else None
    except (OSError, ValueError):
        return None


def _outcomes(runs: Sequence[Run], executor: Executor | None) -> Iterator[tuple[Run, Outcome]]:
    """What becomes of each run, as they are finished; without an executor they are made here, one after the other."""
    if executor is None:
        yield from ((run, perform(run)) for run in runs)
        return
    end = executor.kill if isinstance(executor, Workers) else bool
    futures = {executor.submit(perform, run): run for run in runs}
    with undone_if_ended(end):
        for future in as_completed(futures):
            run = futures[future]
            try:
                outcome = future.result()
            # a run tells its own failures: what is raised here concerns the worker, in the words of its executor
            except Exception as error:
                why = " ".join(f"{type(error).__name__}: {error}".split())
                if isinstance(error, BrokenExecutor):
                    why = "the operating system may have ended it for lack of memory"
                outcome = Outcome(f"its worker was lost ({why}); start the batch again to repeat the run")
            yield run, outcome


def perform(run: Run) -> Outcome:
    """Make a run and write its results; whatever goes wrong is told in a sentence."""
    notices: list[str] = []
    with _ONE_AT_A_TIME:
        start = time.perf_counter()
        error = ""
        try:
            if not run.is_done():  # by a worker that was lost after it
                pipeline.scan(run.path, run.settings, run.folder, overwrite=run.overwrite, notify=notices.append)
        except InputError as refusal:
            error = str(refusal)
        except MemoryError:
            error = "there is not enough memory for this scan; take fewer slices or samples, or fewer jobs"
        except OSError as failure:
            error = f"{failure.strerror or failure}{f' ({failure.filename})' if failure.filename else ''}"
        # an error of the program or of a library concerns this run; the others are made
        except Exception as failure:
            logging.getLogger("scan3d").debug("run %s", run.name, exc_info=True)
            error = f"the program has failed: {type(failure).__name__}: {failure}"
        return Outcome(" ".join(error.split()), round(time.perf_counter() - start, 3), tuple(notices))


@contextmanager
def scheduled(address: str) -> Iterator[Executor]:
    """The executor of a Dask cluster, given the address of its scheduler, such as ``tcp://node1:8786``.

    Its workers need this program in the same version, and the folders of meshes and results under the same paths.  Leaving the
    block cancels what is not finished.

    Raises InputError if dask.distributed is not installed, or if no scheduler answers.
    """
    try:
        from distributed import Client
    except ImportError:
        raise InputError("a scheduler needs dask.distributed: pip install 'scan3d[cluster]'") from None
    try:
        client = Client(address, timeout=_PATIENCE_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"no Dask scheduler answers at {address} ({error}); start one with 'dask scheduler', and give the address "
            "it prints"
        ) from None
    with client:
        executor = client.get_executor(pure=False)
        try:
            yield executor
        finally:
            executor.shutdown(wait=False)


# --- meshes, grids and names ---


def mesh_files(given: Iterable[str | os.PathLike[str]]) -> list[Path]:
    """The mesh files that are meant, in the order in which they are given, each once.

    given
        files, which need not exist; folders, for the mesh files in them; and patterns such as ``parts/**/*.stl``.  Files that
        a scan has written are left out of folders and patterns.

    Raises InputError for folders and patterns without a mesh, and if nothing is given.
    """
    found: dict[str, Path] = {}
    for entry in given:
        for path in _meant(os.fspath(entry)):
            found.setdefault(os.path.abspath(path), path)
    if not found:
        raise InputError("there is no mesh to scan; name mesh files, folders, or patterns such as 'parts/*.stl'")
    return list(found.values())


def _meant(name: str) -> list[Path]:
    path = Path(name)
    is_pattern = glob.has_magic(name) and not path.exists()
    if not path.is_dir() and not is_pattern:
        return [path]
    # pathlib follows no links in ``**``, which may lead back to a folder that they stand in
    files = Path(path.anchor).glob(str(path.relative_to(path.anchor))) if is_pattern else path.iterdir()
    meshes = [file for file in sorted(files) if file.suffix[1:].lower() in FORMATS and file.is_file()]
    written = {folder: earlier_files(folder) for folder in {file.parent for file in meshes}}
    meshes = [file for file in meshes if file.name not in written[file.parent]]
    if not meshes:
        what = "the pattern" if is_pattern else "the folder"
        raise InputError(f"{what} {name} has no mesh file; expected files that end with .{', .'.join(FORMATS)}")
    return meshes


def combinations(data: Mapping[str, Any], source: str = "the grid") -> list[dict[str, Any]]:
    """The settings that vary in each combination of lists of values by setting.

    Of ``{"friction": [0.0, 0.3], "noise": [0.0, 1e-4]}`` they are four; a value that is no list is that of all combinations.  A
    vector for ``axis`` or a pair for ``friction`` is a list in the list of values.

    `source` is the name of the grid in messages.  Raises InputError for empty lists and a grid without settings.
    """
    values = {
        key: list(value) if isinstance(value, (list, tuple)) or hasattr(value, "tolist") else [value]
        for key, value in data.items()
    }
    if empty := next((key for key, value in values.items() if not value), ""):
        raise InputError(f"{source}: the list of values for {empty} is empty; leave {empty} out, or give a value")
    if not values:
        raise InputError(f"{source} has no settings; expected lists of values, such as friction = [0.0, 0.3]")
    return [dict(zip(values, choice, strict=True)) for choice in itertools.product(*values.values())]


def _text(value: Any) -> str:
    return ",".join(map(_text, value)) if isinstance(value, (list, tuple)) else str(value).replace(":", "-")


def _allowed(text: str) -> str:
    """The beginning of the text, with a hyphen for characters that a file system or a shell may not take."""
    return re.sub(r"[^\w.,=+-]+", "-", text)[:100].strip(".-") or "body"


def _distinct(names: Sequence[str]) -> list[str]:
    """The names, with a number behind those that others have too; file systems may not distinguish capitals."""
    taken, following = {name.casefold() for name in BATCH}, dict[str, Iterator[int]]()
    chosen = []
    for name in names:
        # numbers go on where those of the same name have ended
        numbers = following.setdefault(name.casefold(), itertools.count(2))
        numbered = (f"{name}-{number}" for number in numbers)
        candidate = next(one for one in itertools.chain([name], numbered) if one.casefold() not in taken)
        taken.add(candidate.casefold())
        chosen.append(candidate)
    return chosen


# --- the summary ---


def _row(run: Run, failure: Outcome | None) -> Row:
    row: Row = dict.fromkeys(COLUMNS)
    row |= {"run": run.name, "mesh": run.mesh, "mesh_sha256": run.sha256 or "", **dataclasses.asdict(run.settings)}
    if failure is None:
        try:
            return {**row, "status": DONE, "error": "", **_figures(read_report(Path(run.folder)))}
        except (InputError, KeyError) as error:
            failure = Outcome(f"its results can't be read: {error}")
    return {**row, "status": FAILED, "error": failure.error, "surface_method": "", "seconds": failure.seconds}


def _figures(report: Any) -> Row:
    def entry(part: Any, key: str) -> Any:
        return (part or {}).get(key)

    row = {name: reduce(entry, place, report) for name, place in _FIGURES.items()}
    if row["hausdorff_mesh"] is None:  # the mesh itself was scanned
        row["hausdorff_mesh"] = row["hausdorff"]
    return row | {"warnings": len(report["warnings"]), "seconds": round(sum(report["timings_s"].values()), 3)}


def _csv(rows: Sequence[Row]) -> bytes:
    """The rows as CSV in UTF-8, with a header; what is not known is empty, and numbers have all digits.

    A text that a spreadsheet would take for a formula, such as the name of a mesh, begins with an apostrophe.
    """
    stream = io.StringIO()
    writer = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: _cell(value) for name, value in row.items()} for row in rows)
    return stream.getvalue().encode(errors="replace")  # file names may hold bytes that are no characters


def _cell(value: Any) -> Any:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str) and value.startswith(("=", "+", "-", "@")):
        try:
            float(value)
        except ValueError:
            return f"'{value}"
    return value
