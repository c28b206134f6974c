"""The command `batch`: its options, its progress and what it prints."""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from argparse import Namespace
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from scan3d.cli import interruptions
from scan3d.cli.progress import Progress, duration
from scan3d.cli.terminal import one_line, print_result, print_settings, table
from scan3d.settings import UsageError, settings, varied_settings

if TYPE_CHECKING:
    from scan3d.batches import Batch
    from scan3d.batches.running import BatchProgress

EXAMPLES = {
    "batch": """\
  scan3d batch meshes --out study --jobs 2
  scan3d batch 'parts/**/*.stl' @more.txt --out study --friction 0.0:0.4 --slices 32
  scan3d batch egg.stl cube.stl --out study --grid grid.toml
  scan3d batch meshes --out study --scheduler tcp://node1:8786""",
}
# Failures that are printed; the summary has all of them.
_MOST_PRINTED = 20


def add_batch(commands: Any) -> argparse.ArgumentParser:
    """Add the command, without the options of settings and output; its parser."""
    batch: argparse.ArgumentParser = commands.add_parser(
        "batch",
        help="many scans: meshes, and combinations of settings, with one summary",
        description="Scans every mesh, with every combination of the settings in --grid. What an earlier call has finished\n"
        "with the same mesh, settings and version is not repeated, and failures do not stop the other runs.",
    )
    batch.add_argument(
        "mesh",
        nargs="+",
        metavar="MESH",
        help="mesh files, folders of them, patterns such as 'parts/*.stl', or @FILE with one of these in each line",
    )
    batch.add_argument(
        "--out",
        required=True,
        metavar="DIR",
        help="folder for the summary and for the results of each run",
    )
    where = batch.add_mutually_exclusive_group()
    where.add_argument("--jobs", type=int, default=1, metavar="N", help="runs side by side on this machine (default 1)")
    where.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="address of the scheduler of a Dask cluster, such as tcp://node1:8786 (needs scan3d[cluster])",
    )
    batch.add_argument(
        "--grid", metavar="FILE", help="TOML file with lists of values by setting; every combination is a run"
    )
    batch.set_defaults(command="batch")
    return batch


def batch(arguments: Namespace) -> int:
    """Many scans with one summary."""
    if arguments.jobs < 1:
        raise UsageError(f"--jobs must be a whole number of at least 1, got {arguments.jobs}")
    choices = _choices(arguments)
    if arguments.print_config:
        if arguments.grid:
            raise UsageError("--print-config prints one setting; leave out --grid")
        return print_settings(arguments, dataclasses.asdict(choices[0][1]))
    from scan3d.batches import scheduled
    from scan3d.batches.study import perform_batch
    from scan3d.workers import Workers

    start = time.monotonic()
    with scheduled(arguments.scheduler) if arguments.scheduler else Workers(arguments.jobs) as executor:
        done = perform_batch(
            arguments.mesh,
            arguments.out,
            choices,
            executor,
            inputs={"grid": arguments.grid, "file of settings": arguments.config},
            overwrite=arguments.overwrite,
            progress=_report(arguments.progress),
            notify=arguments.progress.say,
        )
    return _print(arguments, done, time.monotonic() - start)


def _choices(arguments: Namespace) -> list[tuple[dict[str, Any], Any]]:
    """What the grid varies, and all settings, of each of its combinations."""
    names = {field.name for field in dataclasses.fields(settings({}))}
    given = {name: value for name, value in vars(arguments).items() if name in names}
    if arguments.grid is None:
        return [({}, settings(given, arguments.config))]
    from scan3d.batches.grid import read_grid

    grid = read_grid(arguments.grid)
    chosen = varied_settings(given, grid, arguments.config, grid_source=arguments.grid)
    return list(zip(grid, chosen, strict=True))


def _report(progress: Progress) -> Callable[[BatchProgress], None]:
    """Shows how many runs are finished, and the time left."""

    def show(done: BatchProgress) -> None:
        interruptions.check()
        failed = f", {done.failed} failed" if done.failed else ""
        left = "" if done.seconds_left is None else f", {duration(done.seconds_left)} left"
        progress.tell(f"{done.done}/{done.total} runs{failed}{left}")

    return show


def _print(arguments: Namespace, done: Batch, seconds: float) -> int:
    failed, total = done.failures, len(done.rows)
    before = f", {total - done.computed} of them by an earlier call" if done.computed < total else ""
    heading = f"{total} runs{before}: {total - len(failed)} done, {len(failed)} failed, in {duration(seconds)}"
    rows = [(name, _figures(row)) for name, row in done.ranks._asdict().items() if row is not None]
    rows += [("failed", f"{row['run']}: {row['error']}") for row in failed[:_MOST_PRINTED]]
    if len(failed) > _MOST_PRINTED:
        rows.append(("failed", f"and {len(failed) - _MOST_PRINTED} more, which summary.csv names"))
    rows.append(("written to", str(arguments.out)))
    data = {
        "out": str(arguments.out),
        "counts": {"runs": total, "done": total - len(failed), "failed": len(failed)},
        "computed": done.computed,
        "seconds": round(seconds, 3),
        **{name: None if row is None else row["run"] for name, row in done.ranks._asdict().items()},
        "runs": list(done.rows),
    }
    print_result(arguments, data, table(heading, rows, sys.stdout))
    if failed:
        print(
            f"scan3d: {len(failed)} of {total} runs failed; summary.csv in {one_line(str(arguments.out))} says why",
            file=sys.stderr,
        )
    return 1 if failed else 0


def _figures(row: dict[str, Any]) -> str:
    certified = row["certificate_relative"]
    bound = "" if certified is None else f", certified {certified:.1e}"
    return f"{row['hausdorff_relative']:.1e} of the diagonal{bound} ({row['run']})"
