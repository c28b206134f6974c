"""The command ``scan3d reconstruct`` for a table of one sweep in one plane."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cyclopts import Group, Parameter

from scan3d.cli.options import Output
from scan3d.cli.terminal import print_result, table
from scan3d.errors import UsageError
from scan3d.numbers import length, number
from scan3d.rods import parse_rod

OPTIONS = Parameter(
    group=Group(
        "One sweep in one plane",
        help="The table may be a .csv of one sweep, or of touches at one place of the base, with the columns x0, f0x, f0y, "
        "m0z (dimensionless) or x0_m, f0x_N, f0y_N, m0z_Nm.  One reaction may be missing if [known] in its TOML file has the "
        "friction, or contact = 'tip'.",
    )
)
# Names of the files that are written into the folder.
_PICTURE, _CONTACTS = "sweep.png", "contacts.csv"


def reconstruct(
    recording: Path,
    rod_name: str | None,
    noise_force: float | None,
    noise_moment: float | None,
    out: Path | None,
    overwrite: bool,
    output: Output,
) -> int:
    """Contour and friction of one sweep: a summary, the contacts as CSV, and a picture."""
    from scan3d.files.recordings import sidecar
    from scan3d.files.whole import atomic, check_file, folder, write_atomic
    from scan3d.laboratory.one_sweep import contacts_csv, read_sweep, reconstruct_sweep
    from scan3d.pictures import charts

    rod = parse_rod(rod_name) if rod_name else None
    if rod_name and rod is None:
        raise UsageError("--rod auto is for simulated scans; name the rod as MATERIAL:DIAMETERxLENGTH")
    # in the folder of the table, or where --out says
    place = recording.parent if out is None else out
    picture = place if place.suffix.lower() in (".png", ".pdf") else place / _PICTURE
    contacts = picture.with_name(_CONTACTS)
    found = reconstruct_sweep(read_sweep(recording, rod, noise_force, noise_moment))
    inputs = {"table": recording, "TOML file of the table": sidecar(recording)}
    with folder(picture.parent):
        text = contacts_csv(found)
        check_file(picture, inputs, overwrite, "--out")
        check_file(contacts, inputs, overwrite, "--out", text)
        with atomic(picture) as path:
            charts.draw(charts.sweep_figure, found, path)
        write_atomic(contacts, text)
    data = _data(found) | {"files": [str(contacts), str(picture)]}
    return print_result(output, data, table("", _rows(data)))


def _data(found: Any) -> dict[str, Any]:
    """The key figures of a sweep; lengths in mm if the rod is known, else in rod lengths."""
    import numpy as np

    import planar

    sweep, contacts, touching, tangential = found.sweep, found.contacts, found.touching, found.tangential
    scale, unit = (1e3 * sweep.rod.length_m, "mm") if sweep.rod else (1.0, "rod lengths")
    codes, counts = np.unique(contacts.status[~touching & ~found.undetermined], return_counts=True)
    friction, s1 = contacts.friction[tangential], scale * contacts.s1[touching]
    data = {
        "unit": unit,
        "samples": len(sweep),
        "direction": sweep.direction,
        "contacts": int(touching.sum()),
        "tip": int(touching.sum() - tangential.sum()),
        "tangential": int(tangential.sum()),
        "undetermined": int(found.undetermined.sum()),
        "without_contact": {planar.Status(c).sentence: int(n) for c, n in zip(codes, counts, strict=True)},
        "s1": [float(s1.min()), float(s1.max())],
        "friction_assumed": sweep.known.friction if sweep.known else None,
        "friction_median": float(np.median(friction)) if len(friction) else None,
        "friction_range": [float(friction.min()), float(friction.max())] if len(friction) else None,
    }
    if found.noisy:
        sd = scale * found.errors.largest[touching]
        data["place_sd_median"], data["place_sd_largest"] = float(np.nanmedian(sd)), float(np.nanmax(sd))
        data["friction_sd_median"] = float(np.nanmedian(found.friction_sd[tangential])) if len(friction) else None
        data["only_rounding"] = found.only_rounding
    return data


def _rows(data: dict[str, Any]) -> list[tuple[str, str]]:
    unit, friction = data["unit"], "not known, as no contact is tangential"
    ask = "give the noise by --noise-force and --noise-moment"

    def size(value: float, digits: int = 3) -> str:
        return length(value, unit, digits=digits) if unit == "mm" else f"{number(value, digits)} {unit}"

    if data["friction_assumed"] is not None:
        friction = f"{number(data['friction_assumed'])}, assumed: it stands in [known]"
    elif data["friction_median"] is not None:
        low, high = map(number, data["friction_range"])
        friction = f"{number(data['friction_median'])}, median of {low} to {high}"
        if "friction_sd_median" in data:
            friction += f", standard deviation of one contact {number(data['friction_sd_median'], 2)}"
    place = f"not known: {ask}"
    if "place_sd_median" in data:
        median, largest = (size(data[f"place_sd_{name}"], 2) for name in ("median", "largest"))
        by_rounding = f"; by rounding alone: {ask}" if data["only_rounding"] else ""
        place = f"{median}, median of the standard deviations; largest {largest}{by_rounding}"
    without = [("without contact", f"{count}: {reason}") for reason, count in data["without_contact"].items()]
    left = [("undetermined", f"{data['undetermined']}: the reactions measured leave the contact open")]
    return [
        ("samples", f"{data['samples']}, base moving in {'-' if data['direction'] < 0 else '+'}x"),
        ("contacts", f"{data['contacts']} ({data['tip']} of the tip, {data['tangential']} tangential)"),
        *without,
        *(left if data["undetermined"] else []),
        ("s1", " to ".join(size(value, 4) for value in data["s1"])),
        ("friction", friction),
        ("error of the place", place),
        ("written to", ", ".join(data["files"])),
    ]
