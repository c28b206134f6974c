"""One run of a batch: what it computes, whether that is done, and its row of the summary."""

from __future__ import annotations

import dataclasses
import hashlib
import logging
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from scan3d import scans
from scan3d.batches.names import body_names, distinct, run_name
from scan3d.errors import InputError
from scan3d.files.whole import read_report, unchanged
from scan3d.settings import Settings

Row = dict[str, Any]
"""A row of the summary, by column."""
DONE, FAILED = "done", "failed"

_SETTINGS = tuple(field.name for field in dataclasses.fields(Settings))
COLUMNS: dict[str, type] = {
    "run": str,
    "mesh": str,
    "mesh_sha256": str,
    **{field.name: type(field.default) for field in dataclasses.fields(Settings)},
    "status": str,
    "error": str,
    "scanned": str,
    "hausdorff": float,
    "hausdorff_relative": float,
    "hausdorff_mesh": float,
    "certificate": float,
    "certificate_relative": float,
    "contacts": float,
    "contact_error": float,
    "friction_estimated": float,
    "surface_method": str,
    "volume_error": float,
    "normals_median_deg": float,
    "coverage": float,
    "warnings": float,
    "seconds": float,
}
"""The columns of the summary with the types of their values; numbers that are not known are None."""

# Scans of one process are made one after the other: a scheduler may give a process several threads, and libraries that read and
# draw meshes are not made for that.
_ONE_AT_A_TIME = threading.Lock()


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
            return is_same and set(report["files"]) == set(unchanged(folder))
        except (InputError, KeyError, TypeError):
            return False

    def row(self, outcome: Outcome | None = None) -> Row:
        """The row of the summary, of what the folder holds, or of a run that has failed."""
        row: Row = dict.fromkeys(COLUMNS)
        row |= {"run": self.name, "mesh": self.mesh, "mesh_sha256": self.sha256 or ""}
        row |= dataclasses.asdict(self.settings)
        if outcome is not None and outcome.error:
            return {**row, "status": FAILED, "error": outcome.error, "surface_method": "", "seconds": outcome.seconds}
        return {**row, "status": DONE, "error": "", **_numbers(read_report(Path(self.folder)))}


class Outcome(NamedTuple):
    """What a worker says of a run."""

    error: str
    """A sentence if the run has failed, or an empty string."""
    seconds: float
    notices: tuple[str, ...] = ()
    """Sentences about what is missing in the result, such as pictures."""


def runs_of(
    paths: Sequence[Path],
    choices: Iterable[tuple[Mapping[str, Any], Settings]],
    out: Path,
    *,
    overwrite: bool = False,
) -> list[Run]:
    """The runs of a batch: every mesh with every choice, which is what a grid varies and all settings; none of them twice."""
    combined: dict[Settings, Mapping[str, Any]] = {}
    for varied, settings in choices:
        combined.setdefault(settings, varied)
    bodies = body_names(paths)
    pairs = [(k, settings) for k in range(len(paths)) for settings in combined]
    names = distinct([run_name(bodies[k], combined[settings]) for k, settings in pairs])
    hashes = [_sha256(path) for path in paths]
    folder = out.absolute()
    return [
        Run(
            name=name,
            mesh=str(paths[k]),
            path=str(paths[k].absolute()),
            sha256=hashes[k],
            settings=settings,
            folder=str(folder / name),
            overwrite=overwrite,
        )
        for name, (k, settings) in zip(names, pairs, strict=True)
    ]


def perform(run: Run, attempt: int = 1) -> Outcome:
    """Make a run and write its results; whatever goes wrong is told in a sentence.

    `attempt` makes repeated calls different for schedulers that remember the results of equal ones.
    """
    notices: list[str] = []
    with _ONE_AT_A_TIME:
        start = time.perf_counter()
        try:
            _scan(run, notices.append)
            error = ""
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


def _scan(run: Run, notify: Callable[[str], None]) -> None:
    """Make a run, unless another process has made it."""
    if not run.is_done():
        scans.perform(run.path, run.settings, run.folder, overwrite=run.overwrite, notify=notify)


def _numbers(report: Mapping[str, Any]) -> Row:
    """The columns that a report fills."""

    def value(section: str, name: str) -> Any:
        return (report.get(section) or {}).get(name)

    return {
        "scanned": value("mesh", "scanned"),
        "hausdorff": value("hausdorff", "two_sided"),
        "hausdorff_relative": value("hausdorff", "relative"),
        "hausdorff_mesh": (value("hausdorff", "mesh_itself") or report.get("hausdorff") or {}).get("two_sided"),
        "certificate": value("certificate", "bound"),
        "certificate_relative": value("certificate", "relative"),
        "contacts": value("counts", "contacts"),
        "contact_error": value("contact_error", "max"),
        "friction_estimated": value("friction", "estimated_median"),
        "surface_method": value("surface", "method"),
        "volume_error": value("surface", "volume_error"),
        "normals_median_deg": value("normals", "median_deg"),
        "coverage": value("coverage", "surface"),
        "warnings": len(report["warnings"]),
        "seconds": round(sum(report["timings_s"].values()), 3),
    }


def _sha256(path: Path) -> str | None:
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest() if path.is_file() else None
    except (OSError, ValueError):
        return None
