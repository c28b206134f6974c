"""The commands for a laboratory: each function takes parsed arguments and returns an exit code."""

from __future__ import annotations

import dataclasses
import sys
from argparse import Namespace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scan3d.cli.terminal import one_line, print_result, printable, table
from scan3d.errors import InputError

if TYPE_CHECKING:
    from scan3d.laboratory.importing import Imported
    from scan3d.laboratory.tables import RawTable

# Rows that a trial run prints.
_FIRST = 6
# Stretches in the air that are listed.
_LISTED = 3


def import_(arguments: Namespace) -> int:
    """Make a recording of a laboratory's table, or a first map of it."""
    if arguments.guess:
        return _guess(arguments)
    if not arguments.map:
        arguments.misuse("--map says what the columns mean; --guess writes a first one")
    if not (arguments.out or arguments.dry_run):
        arguments.misuse("--out names the recording; --dry-run only shows what would become of the table")
    from scan3d.files.recordings import check_path, read_recording, sidecar, write_recording
    from scan3d.files.whole import check_file, check_pair, folder, write_atomic
    from scan3d.laboratory.importing import KIND, convert, load
    from scan3d.laboratory.maps import read_map
    from scan3d.laboratory.rigged import with_rig
    from scan3d.recording import joined

    inputs = {"table": arguments.raw, "map": arguments.map, "rig": arguments.rig}
    if arguments.after:
        inputs |= {"recording before": arguments.after, "TOML file of the recording before": sidecar(arguments.after)}
    writes = arguments.out and not arguments.dry_run
    if arguments.out:
        check_path(arguments.out)
    if writes:
        check_pair(arguments.out, sidecar(arguments.out), inputs, arguments.overwrite, kind=KIND)
    page = arguments.html or (str(Path(arguments.raw).with_suffix(".html")) if arguments.dry_run else None)
    if page:
        check_file(page, inputs, arguments.overwrite, "--html")
    chosen = read_map(arguments.map)
    if arguments.rig:
        chosen = with_rig(chosen, arguments.rig)
    raw = load(arguments.raw, chosen)
    imported = convert(raw, chosen)
    if writes:
        with folder(Path(arguments.out).parent):
            before = [read_recording(arguments.after)] if arguments.after else []
            write_recording(joined([*before, imported.recording]), arguments.out, overwrite=True)  # checked above
    header, rows = _first_rows(raw, imported)
    facts = _facts(imported)
    if page:
        write_atomic(page, _page(imported, facts, header, rows), "--html")
    data = dataclasses.asdict(imported.summary) | {"recording": str(arguments.out) if writes else None, "page": page}
    _print_import(arguments, data, facts, header, rows, str(page or ""))
    for note in imported.summary.notes:
        print(f"scan3d: note: {one_line(note)}", file=sys.stderr)
    return 0


def _guess(arguments: Namespace) -> int:
    from scan3d.files.whole import folder, write_atomic
    from scan3d.laboratory.guessing import guess_map

    path = Path(arguments.map) if arguments.map else Path(arguments.raw).with_suffix(".map.toml")
    if path.exists() and not arguments.overwrite:
        raise InputError(f"{path} exists already; give --overwrite to replace it, or choose another place with --map")
    guess = guess_map(arguments.raw)
    with folder(path.parent, "--map"):
        write_atomic(path, guess.text.encode(), "--map")
    text = printable(f"a first map, written to {path}; check every line, and complete: {', '.join(guess.open)}")
    return print_result(arguments, {"map": str(path), "open": list(guess.open)}, text)


def _print_import(
    arguments: Namespace,
    data: dict[str, Any],
    facts: list[tuple[str, str]],
    header: list[str],
    rows: list[list[str]],
    page: str,
) -> None:
    written = [("written to", path) for path in (data["recording"], page) if path]
    text = table(f"{data['table']}, imported", [*facts, *written], sys.stdout)
    if arguments.dry_run:
        text += "\n\n" + _aligned(header, rows)
    print_result(arguments, data, text)


def _aligned(header: list[str], rows: list[list[str]]) -> str:
    widths = [max(len(row[k]) for row in [header, *rows]) for k in range(len(header))]
    return "\n".join(
        printable("  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True)))
        for row in [header, *rows]
    )


def _first_rows(raw: RawTable, imported: Imported) -> tuple[list[str], list[list[str]]]:
    """The first rows of the recording, with the rows of the table that they come from."""
    recording, log = imported.recording, imported.log
    header = ["row", "fx", "fy", "fz", "mx", "my", "mz", "", "sweep", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"]
    header += ["fx_N", "fy_N", "mz_Nm"]
    rows = []
    for k in range(min(_FIRST, len(recording))):
        source = int(imported.kept[k])
        shown = [f"{value:.4g}" for value in log.wrench[source]]
        pose = [*recording.position_m[k], *recording.quaternion[k]]
        made = [*recording.force_N[k], recording.moment_Nm[k]]
        line = str(int(log.row[source]) + (raw.first or 1))
        rows.append(
            [
                line,
                *shown,
                "→",
                str(recording.sweep[k]),
                *(f"{value:.4f}" for value in pose),
                *(f"{value:.4g}" for value in made),
            ]
        )
    return header, rows


def _facts(imported: Imported) -> list[tuple[str, str]]:
    """What was done, as rows (label, value)."""
    done = imported.summary
    rate = "" if done.rate_hz is None else f" in {done.seconds:.4g} s, {done.rate_hz:.4g} Hz"
    left_out = ", ".join(f"{count} {reason}" for reason, count in done.left_out.items() if count) or "none"
    rows = [
        ("table", f"{done.rows} rows{rate}"),
        (
            "recording",
            f"{done.samples} samples in {done.sweeps} sweeps, {done.sweeps_with_contact} of them with contact",
        ),
        ("left out", left_out),
        ("axes", "six, for the model in space" if done.six_axis else "three, for the planar model"),
    ]
    if done.air:
        unit = "s" if done.rate_hz is not None else "rows"
        some = ", ".join(f"{a:.4g} to {b:.4g}" for a, b in done.air[:_LISTED]) + (
            ", ..." if len(done.air) > _LISTED else ""
        )
        force, moment = (max(abs(x) for x in part) for part in (done.zero[:3], done.zero[3:]))
        change = tuple(max(part) for part in (done.drift[:3], done.drift[3:]))
        rows += [
            ("in the air", f"{len(done.air)} stretches, {100 * done.air_fraction:.3g} % of the rows: {some} {unit}"),
            ("zero taken off", f"up to {1e3 * force:.3g} mN and {1e6 * moment:.3g} mN mm"),
            ("drift", f"up to {1e3 * change[0]:.3g} mN and {1e6 * change[1]:.3g} mN mm"),
        ]
    else:
        rows.append(("in the air", "not tared"))
    noise = f"{1e3 * done.noise_force_N:.3g} mN and {1e6 * done.noise_moment_Nm:.3g} mN mm, standard deviations"
    filtered = "" if done.noise_factor == 1 else f"; the filter leaves {done.noise_factor:.2g} of white noise"
    return [*rows, ("noise", noise + filtered)]


def _page(imported: Imported, facts: list[tuple[str, str]], header: list[str], rows: list[list[str]]) -> bytes:
    from scan3d.pictures.import_page import ImportView, import_page

    return import_page(
        ImportView(
            name=imported.summary.table,
            clock=imported.clock - imported.clock[0],
            clock_label="row" if imported.log.time_s is None else "time in s",
            raw=imported.log.wrench,
            zero=imported.zero,
            air=imported.air,
            converted=imported.wrench,
            sweep=imported.sweep,
            position_mm=imported.position_m * 1e3,
            facts=facts,
            notes=imported.summary.notes,
            header=header,
            rows=rows,
        )
    )
