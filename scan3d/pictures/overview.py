"""The page of a batch: all its bodies as small pictures, the best, the median and the worst run, and the failures.

`overview.html` beside this module is the page without runs: ``@NAME@`` and the like are filled in here.
"""

from __future__ import annotations

import base64
import html
import io
import re
from collections.abc import Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import quote

from scan3d.files.whole import locate
from scan3d.geometry.convexity import HULL_OF_MESH
from scan3d.units import unit_symbol

_FAILED = "failed"


def overview(folder: Path, rows: Sequence[Mapping[str, Any]], ranked: Mapping[str, str | None]) -> bytes:
    """The page (HTML, UTF-8) of a batch, which needs no network.

    folder
        that of the batch; each run has a folder in it, with its picture.
    rows
        of the summary, by column.
    ranked
        the names of the best, the median and the worst run, or None.

    Besides the times, the same results give the same bytes.
    """
    failed = [row for row in rows if row["status"] == _FAILED]
    marks = {run: mark for mark, run in reversed([*ranked.items()]) if run is not None}
    varied = _varied(rows)
    cards = [_card(number, folder, row, marks.get(row["run"], ""), varied) for number, row in enumerate(rows)]
    reasons = _cells([(row["run"], row["error"]) for row in failed])
    filled = {
        "NAME": html.escape(f"Batch {folder.resolve().name}"),
        "COUNTS": f"{len(rows)} runs: {len(rows) - len(failed)} done, {len(failed)} failed",
        "RANKED": _ranked(rows, ranked),
        "FAILURES": f"<h2>Failures</h2>\n<table>{reasons}</table>" if failed else "",
        "CARDS": "\n".join(cards),
    }
    blank = files("scan3d.pictures").joinpath("overview.html").read_text(encoding="utf-8")
    return re.sub("@([A-Z]+)@", lambda match: filled[match[1]], blank).encode(errors="replace")


def _varied(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """The settings that differ between the runs."""
    names = [*rows[0]] if rows else []
    settings = names[names.index("mesh_sha256") + 1 : names.index("status")] if names else []
    return [name for name in settings if len({row[name] for row in rows}) > 1]


def _ranked(rows: Sequence[Mapping[str, Any]], ranked: Mapping[str, str | None]) -> str:
    by_name = {row["run"]: row for row in rows}
    parts = [
        f"{mark}: {_percent(by_name[run]['hausdorff_relative'])} ({_link(run)})"
        for mark, run in ranked.items()
        if run is not None
    ]
    hulls = any(row["scanned"] == HULL_OF_MESH for row in rows)
    body = f"mesh, or to the {HULL_OF_MESH} where that was scanned" if hulls else "mesh"
    return f"Hausdorff distance to the {body}, of its bounding box's diagonal – {', '.join(parts)}" if parts else ""


def _card(number: int, folder: Path, row: Mapping[str, Any], mark: str, varied: Sequence[str]) -> str:
    name, kind, cells = html.escape(row["run"]), "", _cells([(name, str(row[name])) for name in varied])
    if row["status"] == _FAILED:
        kind, mark, shown = " failed", "failed", f'<div class="none">{html.escape(row["error"])}</div>'
    else:
        name, cells, shown = _link(row["run"]), cells + _cells(_figures(row)), _picture(folder / row["run"])
    label = f'<span class="mark">{mark}</span>' if mark else ""
    values = [number, row["hausdorff_relative"], row["certificate_relative"], row["seconds"]]
    data = " ".join(
        f'data-{name}="{"" if value is None else value}"'
        for name, value in zip(("number", "error", "certified", "seconds"), values, strict=True)
    )
    return f'<div class="card{kind}" {data}>{label}<h3>{name}</h3>{shown}<table>{cells}</table></div>'


def _cells(figures: Sequence[tuple[str, str]]) -> str:
    return "".join(f"<tr><th>{html.escape(name)}</th><td>{html.escape(value)}</td></tr>" for name, value in figures)


def _figures(row: Mapping[str, Any]) -> list[tuple[str, str]]:
    unit = unit_symbol(row["unit"])
    certified = "nothing"
    if row["certificate"] is not None:
        certified = f"{row['certificate']:.3g} {unit} ({_percent(row['certificate_relative'])})"
    figures = [("certified within", certified), ("contacts", f"{row['contacts']:.0f}")]
    if row["hausdorff"] is not None:
        distance = f"{row['hausdorff']:.3g} {unit} ({_percent(row['hausdorff_relative'])})"
        is_hull = row["scanned"] == HULL_OF_MESH
        figures.insert(0, ("Hausdorff distance", distance + (f" to the {HULL_OF_MESH}" if is_hull else "")))
        if is_hull:
            figures.insert(1, ("to the mesh itself", f"{row['hausdorff_mesh']:.3g} {unit}"))
    figures += [("surface", row["surface_method"] or ""), ("time", f"{row['seconds']:.3g} s")]
    if row["warnings"]:
        figures.append(("warnings", f"{row['warnings']:.0f}"))
    return figures


def _percent(value: float | None) -> str:
    return "unknown" if value is None else f"{100 * value:.2g} %"


def _link(run: str) -> str:
    return f'<a href="{html.escape(quote(run, safe=""))}/view.html">{html.escape(run)}</a>'


def _picture(folder: Path) -> str:
    """An <img> that contains the picture of a run, reduced to 350 pixels, or a remark where there is none."""
    from PIL import Image

    try:
        with Image.open(locate(folder / "surface.png")) as picture:
            small, file = picture.convert("RGB").reduce(4), io.BytesIO()
    except OSError:  # of a machine that can't render
        return '<div class="none">no picture</div>'
    small.save(file, "JPEG", quality=85)
    data = base64.b64encode(file.getvalue()).decode()
    size = f'width="{small.width}" height="{small.height}"'
    return f'<img {size} loading="lazy" alt="{html.escape(folder.name)}" src="data:image/jpeg;base64,{data}">'
