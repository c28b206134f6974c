"""The command ``scan3d reconstruct`` for a table of one sweep in one plane.

Numerical libraries are imported inside the functions, so that ``scan3d --help`` is quick.
"""

from __future__ import annotations

import sys
from argparse import Namespace
from pathlib import Path
from typing import Any

from scan3d.choices import METHODS
from scan3d.cli.terminal import print_result, table
from scan3d.settings import UsageError

EXAMPLES = """
  scan3d reconstruct sweep.csv
  scan3d reconstruct sweep.csv --rod steel:0.3x50 --noise-force 1e-4 --noise-moment 2e-6 --out sweep"""
# Names of the files that are written into the folder.
_PICTURE, _CONTACTS = "sweep.png", "contacts.csv"
_ASK_NOISE = "give the noise by --noise-force and --noise-moment"
# Options of one sweep, and those that need a recording, with the values that count as not given.
_OF_SWEEP = {"rod": None, "noise_force": None, "noise_moment": None}
_OF_RECORDING = {
    "truth": None,
    "hull": False,
    "method": METHODS[0],
    "model": None,
    "rig": None,
    "table": None,
    "strict": False,
}


def add_options(parser: Any) -> None:
    """Add the options of one sweep to those of ``reconstruct``."""
    group = parser.add_argument_group(
        "one sweep in one plane",
        "REC may be a .csv of one sweep, with the columns x0, f0x, f0y, m0z (dimensionless) or x0_m, f0x_N, f0y_N, m0z_Nm.",
    )
    group.add_argument(
        "--rod", metavar="ROD", help="MATERIAL:DIAMETERxLENGTH in mm, such as steel:0.3x50, for columns in SI units"
    )
    for name, what in (("force", "each force component"), ("moment", "the moment")):
        group.add_argument(
            f"--noise-{name}",
            type=float,
            metavar="SIGMA",
            help=f"standard deviation of {what}, in the unit of its column (default: that of the .toml, or unknown)",
        )


def is_one_sweep(arguments: Namespace) -> bool:
    """Whether the table is one sweep in one plane.  Raises UsageError for options of the other kind of table."""
    from scan3d.files.sweeps import is_sweep

    one_sweep = is_sweep(arguments.recording)
    if not one_sweep and arguments.out is None:
        raise UsageError("the following arguments are required: --out")
    refused = _OF_RECORDING if one_sweep else _OF_SWEEP
    if given := [
        f"--{name.replace('_', '-')}" for name, default in refused.items() if getattr(arguments, name) != default
    ]:
        name, needed = Path(arguments.recording).name, "one sweep in one plane"
        reason = f"a recording with poses, and {name} is {needed}" if one_sweep else f"{needed}, which {name} is not"
        raise UsageError(f"{', '.join(given)} can be used only with {reason}")
    return one_sweep


def reconstruct(arguments: Namespace) -> int:
    """Contour and friction of one sweep: a summary, the contacts as CSV, and a picture."""
    from scan3d.files.recordings import sidecar
    from scan3d.files.sweeps import contacts_csv, read_sweep
    from scan3d.files.whole import atomic, check_file, folder, write_atomic
    from scan3d.pictures.one_sweep import sweep_picture
    from scan3d.reconstruction.one_sweep import reconstruct_sweep
    from scan3d.rods import parse_rod

    rod = parse_rod(arguments.rod) if arguments.rod else None
    if arguments.rod and rod is None:
        raise UsageError("--rod auto is for simulated scans; name the rod as MATERIAL:DIAMETERxLENGTH")
    picture, contacts = _paths(arguments)
    found = reconstruct_sweep(read_sweep(arguments.recording, rod, arguments.noise_force, arguments.noise_moment))
    inputs = {"table": arguments.recording, "TOML file of the table": sidecar(arguments.recording)}
    with folder(picture.parent):
        text = contacts_csv(found)
        check_file(picture, inputs, arguments.overwrite, "--out")
        check_file(contacts, inputs, arguments.overwrite, "--out", text)
        with atomic(picture) as path:
            sweep_picture(found, path)
        write_atomic(contacts, text)
    data = _data(found) | {"files": [str(contacts), str(picture)]}
    return print_result(arguments, data, table("", _rows(data), sys.stdout))


def _paths(arguments: Namespace) -> tuple[Path, Path]:
    """The picture and the table of contacts: in the folder of the table, or where --out says."""
    out = Path(arguments.recording).parent if arguments.out is None else Path(arguments.out)
    picture = out if out.suffix.lower() in (".png", ".pdf") else out / _PICTURE
    return picture, picture.with_name(_CONTACTS)


def _data(found: Any) -> dict[str, Any]:
    """The key figures of a sweep; lengths in mm if the rod is known, else in rod lengths."""
    import numpy as np

    import planar

    sweep, contacts, touching, tangential = found.sweep, found.contacts, found.touching, found.tangential
    scale, unit = (1e3 * sweep.rod.length_m, "mm") if sweep.rod else (1.0, "rod lengths")
    codes, counts = np.unique(contacts.status[~touching], return_counts=True)
    friction, s1 = contacts.friction[tangential], scale * contacts.s1[touching]
    data = {
        "unit": unit,
        "samples": len(sweep),
        "direction": sweep.direction,
        "contacts": int(touching.sum()),
        "tip": int(touching.sum() - tangential.sum()),
        "tangential": int(tangential.sum()),
        "without_contact": {planar.Status(c).sentence: int(n) for c, n in zip(codes, counts, strict=True)},
        "s1": [float(s1.min()), float(s1.max())],
        "friction_median": float(np.median(friction)) if len(friction) else None,
        "friction_range": [float(friction.min()), float(friction.max())] if len(friction) else None,
    }
    if found.noisy:
        sd = scale * found.place_sd[touching]
        data["place_sd_median"], data["place_sd_largest"] = float(np.nanmedian(sd)), float(np.nanmax(sd))
        data["friction_sd_median"] = float(np.nanmedian(found.friction_sd[tangential])) if len(friction) else None
        data["only_rounding"] = found.only_rounding
    return data


def _rows(data: dict[str, Any]) -> list[tuple[str, str]]:
    """The key figures as rows (label, value)."""
    unit = data["unit"]
    low, high = data["s1"]
    rows = [
        ("samples", f"{data['samples']}, base moving in {'-' if data['direction'] < 0 else '+'}x"),
        ("contacts", f"{data['contacts']} ({data['tip']} of the tip, {data['tangential']} tangential)"),
        *(("without contact", f"{count}: {reason}") for reason, count in data["without_contact"].items()),
        ("s1", f"{low:.4g} to {high:.4g} {unit}"),
    ]
    if data["friction_median"] is None:
        rows.append(("friction", "not known, as no contact is tangential"))
    else:
        low, high = data["friction_range"]
        sd = (
            f", standard deviation of one contact {data['friction_sd_median']:.2g}"
            if "friction_sd_median" in data
            else ""
        )
        rows.append(("friction", f"{data['friction_median']:.4g}, median of {low:.4g} to {high:.4g}{sd}"))
    if "place_sd_median" not in data:
        rows.append(("error of the place", f"not known: {_ASK_NOISE}"))
        return [*rows, ("written to", ", ".join(data["files"]))]
    median, largest = data["place_sd_median"], data["place_sd_largest"]
    by_rounding = f"; by rounding alone: {_ASK_NOISE}" if data["only_rounding"] else ""
    sds = f"{median:.2g} {unit}, median of the standard deviations; largest {largest:.2g}{by_rounding}"
    rows.append(("error of the place", sds))
    return [*rows, ("written to", ", ".join(data["files"]))]
