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
_ASK_NOISE = "give the noise by --noise-force and --noise-moment"


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
    from scan3d.pictures.charts import sweep_picture

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
            sweep_picture(found, path)
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
    """The key figures as rows (label, value)."""
    unit = data["unit"]
    low, high = data["s1"]

    def size(value: float, digits: int = 3) -> str:
        return length(value, unit, digits=digits) if unit == "mm" else f"{number(value, digits)} {unit}"

    rows = [
        ("samples", f"{data['samples']}, base moving in {'-' if data['direction'] < 0 else '+'}x"),
        ("contacts", f"{data['contacts']} ({data['tip']} of the tip, {data['tangential']} tangential)"),
        *(("without contact", f"{count}: {reason}") for reason, count in data["without_contact"].items()),
        *(
            [("undetermined", f"{data['undetermined']}: two reactions leave several contacts open")]
            if data["undetermined"]
            else []
        ),
        ("s1", f"{size(low, 4)} to {size(high, 4)}"),
    ]
    if data["friction_median"] is None:
        rows.append(("friction", "not known, as no contact is tangential"))
    else:
        low, high = data["friction_range"]
        sd = (
            f", standard deviation of one contact {number(data['friction_sd_median'], 2)}"
            if "friction_sd_median" in data
            else ""
        )
        rows.append(("friction", f"{number(data['friction_median'])}, median of {number(low)} to {number(high)}{sd}"))
    if "place_sd_median" not in data:
        rows.append(("error of the place", f"not known: {_ASK_NOISE}"))
        return [*rows, ("written to", ", ".join(data["files"]))]
    median, largest = data["place_sd_median"], data["place_sd_largest"]
    by_rounding = f"; by rounding alone: {_ASK_NOISE}" if data["only_rounding"] else ""
    sds = f"{size(median, 2)}, median of the standard deviations; largest {size(largest, 2)}{by_rounding}"
    rows.append(("error of the place", sds))
    return [*rows, ("written to", ", ".join(data["files"]))]
