"""Many scans in one call, with one summary: `batch`."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from scan3d.batches.grid import combinations, read_grid
from scan3d.batches.meshes import mesh_files
from scan3d.batches.running import Report, outcomes
from scan3d.batches.runs import Outcome, Row, Run, runs_of
from scan3d.batches.summary import Ranks, csv_bytes, failures, parquet_table, ranks
from scan3d.errors import InputError
from scan3d.files.whole import BATCH, Inputs, Replacement, replacing
from scan3d.pictures.overview import overview
from scan3d.scans import StoredScan
from scan3d.scans import open as open_scan
from scan3d.settings import Settings, varied_settings
from scan3d.settings import settings as chosen_settings

SCHEMA = 1
"""Number of the format of ``batch.json``."""


@dataclass(frozen=True, repr=False)
class Batch:
    """The summary of a batch."""

    folder: Path
    """With ``summary.csv``, ``index.html``, ``batch.json``, and a folder for each run."""
    rows: tuple[Row, ...]
    """The rows of the summary, by column, in the order of the runs."""
    computed: int
    """Number of runs that this call has made; the others were done before."""

    @property
    def ranks(self) -> Ranks:
        """The rows of the best, the median and the worst run by the Hausdorff distance relative to the diagonal."""
        return ranks(self.rows)

    @property
    def failures(self) -> list[Row]:
        """The rows of the runs that have failed."""
        return failures(self.rows)

    def open(self, run: str) -> StoredScan:
        """The results of a run, by its name.  Raises InputError as `scan3d.open`, and for a run that has failed."""
        for row in self.failures:
            if row["run"] == run:
                raise InputError(f"the run {run} has failed: {row['error']}")
        return open_scan(self.folder / run)

    def __repr__(self) -> str:
        return f"Batch of {len(self.rows)} runs, {len(self.failures)} failed, in {self.folder}"


def batch(
    paths: str | os.PathLike[str] | Iterable[str | os.PathLike[str]],
    out: str | os.PathLike[str],
    executor: Executor | None = None,
    *,
    grid: str | os.PathLike[str] | Mapping[str, Any] | None = None,
    overwrite: bool = False,
    progress: Report = lambda _: None,
    notify: Callable[[str], None] = lambda _: None,
    **settings: Any,
) -> Batch:
    """Scan many meshes, each with one setting or with every combination of a grid, and summarise the results in a folder.

    paths
        mesh files, folders for the mesh files in them, patterns such as ``parts/**/*.stl``, and lists ``@FILE`` with one of
        these in each line.
    out
        folder for the summary, and for a folder of results for each run, as ``scan3d scan`` writes them.
    executor
        any `concurrent.futures.Executor`, such as `scan3d.workers.Workers` for processes that compute with one thread each, or
        the executor of a Dask client; None: the runs are made in this process, one after the other.
    grid
        lists of values by setting, or the path of a TOML file with them, as `scan3d.batches.grid.combinations` describes.
    overwrite
        whether files in the folder that the program did not write may be replaced.
    progress
        called with a `scan3d.batches.running.BatchProgress` as runs are finished, and about once a second.
    notify
        called with a sentence on what is missing in results, such as pictures, once for each sentence.
    settings
        those of all runs, as in `scan3d.scan`.

    A run that fails is a row of the summary, and the others are made.  A run whose worker is lost is tried a second time.  What
    an earlier call has finished with the same mesh, settings and version of the program is not repeated.  The results do not
    depend on the executor, apart from times.

    Raises InputError for meshes, settings and grids that can't be used, if a setting is given twice, and if the folder can't be
    written into or holds files that must not be replaced.
    """
    return perform_batch(
        [paths] if isinstance(paths, (str, os.PathLike)) else list(paths),
        out,
        _choices(grid, settings),
        executor,
        inputs={"grid": Path(grid)} if isinstance(grid, (str, os.PathLike)) else {},
        overwrite=overwrite,
        progress=progress,
        notify=notify,
    )


def _choices(
    grid: str | os.PathLike[str] | Mapping[str, Any] | None, given: Mapping[str, Any]
) -> list[tuple[Mapping[str, Any], Settings]]:
    """What a grid varies, and all settings, of each of its combinations; `given` are the settings of all runs."""
    if grid is None:
        return [({}, chosen_settings(given, source="scan3d.batch"))]
    if isinstance(grid, (str, os.PathLike)):
        varied, named = read_grid(grid), str(grid)
    else:
        varied, named = combinations(grid), "the grid"
    return list(zip(varied, varied_settings(given, varied, source="scan3d.batch", grid_source=named), strict=True))


def perform_batch(
    given: Iterable[str | os.PathLike[str]],
    out: str | os.PathLike[str],
    choices: Sequence[tuple[Mapping[str, Any], Settings]],
    executor: Executor | None,
    *,
    inputs: Inputs,
    overwrite: bool,
    progress: Report,
    notify: Callable[[str], None],
) -> Batch:
    """The work of `batch` and of the command.

    choices
        for each combination of the grid what it varies, by name, and all settings.
    inputs
        files that the batch reads besides the meshes, which are not overwritten.
    """
    paths = mesh_files(given)
    folder = Path(out)
    runs = runs_of(paths, choices, folder, overwrite=overwrite)
    with replacing(folder, with_recording=False, inputs=inputs, overwrite=overwrite, kind=BATCH) as result:
        missing = [run for run in runs if not run.is_done()]
        found = dict(zip([run.name for run in missing], outcomes(missing, executor, len(runs), progress), strict=True))
        for notice in dict.fromkeys(notice for outcome in found.values() for notice in outcome.notices):
            notify(notice)
        rows = tuple(_row(run, found.get(run.name)) for run in runs)
        _write(result, folder, rows)
    return Batch(folder, rows, len(missing))


def _row(run: Run, outcome: Outcome | None) -> Row:
    try:
        return run.row(outcome)
    except (InputError, KeyError) as error:
        return run.row(Outcome(f"its results can't be read: {error}", 0.0))


def _write(result: Replacement, folder: Path, rows: Sequence[Row]) -> None:
    """Write the summary."""
    result.put("summary.csv", csv_bytes(rows))
    table = parquet_table(rows)
    if table is not None:
        result.put("summary.parquet", table)
    ranked = ranks(rows)
    named = {name: None if row is None else row["run"] for name, row in ranked._asdict().items()}
    result.put("index.html", overview(folder, rows, named))
    failed = len(failures(rows))
    result.commit(
        {
            "schema": SCHEMA,
            "versions": {"scan3d": version("scan3d")},
            "counts": {"runs": len(rows), "done": len(rows) - failed, "failed": failed},
            **named,
            "runs": list(rows),
        }
    )
