"""Whose files there are: a run overwrites neither its own input nor, unless asked to, what the program did not write."""

from __future__ import annotations

import errno
import json
import os
import re
import tomllib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

from scan3d.errors import InputError
from scan3d.files.journal import digest, locate
from scan3d.files.reading import read_small
from scan3d.units import UNITS_M

REPORT = "report.json"
RECORDING = ("recording.csv", "recording.toml")
RESULTS = ("cloud.ply", "surface.ply", "view.html", "cloud.png", "surface.png", REPORT)
"""The files of a result in the order in which they appear; the report, which names the others, is the last."""


class Kind(NamedTuple):
    """A kind of result: a folder's report, which names the other files with their SHA-256."""

    report: str
    results: tuple[str, ...]
    """The files in the order in which they appear, with the report as the last."""
    further: tuple[str, ...] = ()
    """Files that only some results of this kind have."""


SCAN = Kind(REPORT, RESULTS, RECORDING)
BATCH = Kind("batch.json", ("summary.csv", "summary.parquet", "index.html", "batch.json"))
Inputs = Mapping[str, str | Path | None]
"""What a run reads: the path of each, by what it is, such as ``mesh``."""

_ASK = "give --overwrite (overwrite=True) to replace it, or choose another place with"
# Bytes at the beginning and at the end of a file in which its mark is looked for: headers are shorter.
_LOOKED_AT = 1 << 12
_UNIT = "|".join(UNITS_M)
# What only this program writes, by file ending.  Points as bare numbers (.xyz, .xyzn) have no place for a mark.
_MARKS = {
    ".ply": rb"\Aply\n(comment [^\n]*\n|format [^\n]*\n)*comment scan3d (cloud|surface)\n",
    ".pcd": rb"\A# .PCD [^\n]*\n# scan3d cloud\n",
    ".obj": rb"\A# scan3d surface\n",
    ".stl": rb"\Ascan3d surface, unit ",
    ".glb": rb"metres_per_unit_of_recording",
    ".mcap": rb"\A\x89MCAP0\r\n(?s:.*)/scan3d/contacts",
    ".vtp": rb'Name="unit"(?s:.*)Name="frame"',
    ".csv": rf"\A(x_({_UNIT}),y_({_UNIT}),z_({_UNIT}),nx,ny,nz|x0(_m)?,x(_m)?,y(_m)?,s1(_m)?,phase,status)\b".encode(),
    ".png": rb"\A\x89PNG(?s:.*)Software\0scan3d",
    ".pdf": rb"/Creator \(scan3d\)",
    ".svg": rb"\A<\?xml [^\n]*\n(?s:.*)<dc:title>scan3d</dc:title>",
    ".toml": rb"\A# rig calibrated by scan3d\n",
    ".gif": rb"\AGIF8(?s:.*)scan3d",
    ".mp4": rb"scan3d",
}
_PAGE = rb"\A<!DOCTYPE html>\n<html[^>]*><head>[^\n]*scan3d</title>"


def earlier_files(folder: Path, kind: Kind = SCAN) -> dict[str, str | None]:
    """Names of the files that the report in a folder says were written, with their SHA-256 where it is stated.

    Empty if the folder has no report, or one of another program.
    """
    try:
        data: Any = json.loads(locate(folder / kind.report, "").read_text(encoding="utf-8"))
        if kind.report not in data["files"] or "scan3d" not in data["versions"]:
            return {}
        sha256 = data.get("sha256") or {}
        return {name: sha256.get(name) for name in data["files"] if name in kind.results + kind.further}
    except (OSError, ValueError, TypeError, KeyError, AttributeError):
        return {}


def unchanged(folder: Path, kind: Kind = SCAN) -> dict[str, str]:
    """The files of the result in a folder that are as the program wrote them, with their SHA-256."""
    found = {}
    for name, sha256 in earlier_files(folder, kind).items():
        with suppress(OSError):
            now = digest(folder / name)
            if sha256 in (None, now):
                found[name] = now
    return found


def check_result(
    folder: Path, names: Iterable[str], inputs: Inputs, overwrite: bool, option: str = "--out", kind: Kind = SCAN
) -> None:
    """Raise InputError if a result in the folder would replace a file that it must not."""
    ours = unchanged(folder, kind)
    for name in names:
        path = folder / name
        check_path(path, inputs, option)
        if path.exists() and name not in ours and not overwrite:
            since = " or was changed since" if name in earlier_files(folder, kind) else ""
            raise InputError(f"{path} was not written by scan3d{since}; {_ASK} {option}")


def check_file(path: str | Path, inputs: Inputs, overwrite: bool, option: str, contents: bytes | None = None) -> None:
    """Raise InputError if a single file must not be written at the path; nothing is lost if it has the `contents` already."""
    path = Path(path)
    check_path(path, inputs, option)
    if path.name in RESULTS + RECORDING and earlier_files(path.parent):
        raise InputError(f"{path} belongs to the scan in {path.parent}; choose another place with {option}")
    if path.exists() and not overwrite and not _has_mark(path) and contents != path.read_bytes():
        raise InputError(f"{path} can't be recognised as written by scan3d; {_ASK} {option}")


def check_recording(
    path: str | Path, sidecar: Path, inputs: Inputs, overwrite: bool, option: str = "--out", kind: str = "simulation"
) -> None:
    """Raise InputError if a recording must not be written at the path, with its TOML file; one of the same kind is replaced."""
    for file in (Path(path), sidecar):
        check_path(file, inputs, option)
        if file.name in RECORDING and earlier_files(file.parent):
            raise InputError(f"{file} belongs to the scan in {file.parent}; choose another place with {option}")
    if not overwrite:
        check_sidecar(sidecar, f"; {_ASK} {option}")
        if Path(path).exists() and _kind(sidecar) != kind:
            made = "simulated" if kind == "simulation" else "imported"
            raise InputError(f"{path} is not a recording that scan3d has {made}; {_ASK} {option}")


def check_companion(path: Path, sidecar: Path, kind: str, option: str) -> None:
    """Raise InputError if files would be replaced whose TOML file does not name `kind` as its source."""
    for file in (sidecar, path):
        if file.exists() and _kind(sidecar) != kind:
            raise InputError(f"{file} can't be recognised as written by scan3d; {_ASK} {option}")


def check_sidecar(sidecar: Path, advice: str) -> None:
    """Raise InputError if the TOML file of a recording would replace one that is something else."""
    if sidecar.exists() and _kind(sidecar) is None:
        raise InputError(f"{sidecar} is not the TOML file of a recording{advice}")


def check_belongs(folder: Path, report: Mapping[str, Any], names: Iterable[str]) -> None:
    """Raise InputError if a file in a folder is not the one that the report names; reports without hashes name none."""
    stated = report.get("sha256")
    if not isinstance(stated, Mapping):
        return
    for name in names:
        path = locate(folder / name, "")
        if name in stated and path.is_file() and digest(path) != stated[name]:
            raise InputError(
                f"{folder / name} is not the file that {REPORT} beside it names: it was changed, or is of another run; run "
                "the scan again, or give the path of the file alone"
            )


def check_path(path: Path, inputs: Inputs, option: str) -> None:
    """Raise InputError unless the path is free or a regular file, and no input."""
    if not path.exists():
        return
    for what, source in inputs.items():
        if source is not None and Path(source).exists() and os.path.samefile(path, source):
            raise InputError(
                f"{path} is the {what} that this run reads, which is never overwritten; choose another place with {option}"
            )
    if path.is_dir():
        raise InputError(f"can't write {path}: {os.strerror(errno.EISDIR)}; choose another place with {option}")
    if not path.is_file():
        raise InputError(f"can't write {path}: it is a device or a pipe; choose another place with {option}")


def _has_mark(path: Path) -> bool:
    """Whether a file can be recognised as written by this program."""
    mark = _MARKS.get(path.suffix.lower(), _PAGE)
    with open(path, "rb") as file:
        begin = file.read(_LOOKED_AT)
        file.seek(max(len(begin), os.path.getsize(path) - _LOOKED_AT))
        return re.search(mark, begin + file.read(_LOOKED_AT)) is not None


def _kind(sidecar: Path) -> str | None:
    """What the TOML file of a recording says of its source, "" if nothing; None if it is no such file."""
    try:
        data: Any = tomllib.loads(sidecar.read_text(encoding="utf-8-sig"))
        return str(data.get("source", {}).get("kind", "")) if "length_m" in data["rod"] else None
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def read_report(folder: Path) -> Mapping[str, Any]:
    """A scan's report.json; empty if the file does not exist.  Raises InputError if it can't be read."""
    path = locate(folder / REPORT, "")
    if not path.exists():
        return {}
    try:
        data = json.loads(read_small(path))
    except InputError:
        raise
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"can't read {path}: {error}; run the scan again") from None
    if not isinstance(data, Mapping):
        raise InputError(f"{path} is not a report: expected a JSON object; run the scan again")
    return data
