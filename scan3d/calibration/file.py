"""RIG.toml: a calibration as a file, for reconstruction and import."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from scan3d.arrays import Array
from scan3d.calibration.report import COVERAGE_FACTOR, Calibration
from scan3d.errors import InputError
from scan3d.files.section import Section, read_rod, read_section
from scan3d.files.text import to_toml
from scan3d.files.whole import Inputs, check_file, folder, write_atomic

# Number of the format.
_SCHEMA = 1
_MARK = "# rig calibrated by scan3d\n"
_FIT = ("chi2_per_freedom", "consistency", "freedom", "sentences")


def check_path(path: str | Path, inputs: Inputs, overwrite: bool) -> None:
    """Raise InputError if a calibration must not be written at the path."""
    if Path(path).suffix != ".toml":
        raise InputError(f"a rig is written as .toml, got {Path(path).name!r}")
    check_file(path, inputs, overwrite, "--out")


def write_rig(calibration: Calibration, path: str | Path, *, overwrite: bool = False) -> None:
    """Write a calibration; numbers have all digits.

    Raises InputError if it can't be written, and, unless `overwrite` is true, if it would replace a file that is no rig.
    """
    check_path(path, {}, overwrite)
    with folder(Path(path).parent):
        write_atomic(path, (_MARK + to_toml(sections(calibration))).encode(errors="replace"))


def sections(calibration: Calibration) -> dict[str, Any]:
    """The contents of the file, of plain values."""
    rig = calibration
    known = np.isfinite(rig.standard_deviations)
    names = [name for name, is_known in zip(rig.names, known, strict=True) if is_known]
    reference = {key: value for key, value in rig.reference.items() if key != "kind"}
    return {
        "schema": _SCHEMA,
        "rod": {
            "length_m": rig.rod.length_m,
            "bending_stiffness_Nm2": rig.rod.bending_stiffness_Nm2,
            "diameter_m": rig.rod.diameter_m,
        },
        "sensor": _frame(rig.sensor_position_m, rig.sensor_euler_deg),
        "clamp": _frame(rig.clamp_position_m, rig.clamp_euler_deg),
        "tare": {
            "force_N": rig.tare[:3].tolist(),
            "moment_Nm": rig.tare[3:].tolist(),
            "drift_force_N": rig.drift[:3].tolist(),
            "drift_moment_Nm": rig.drift[3:].tolist(),
        },
        **({rig.reference["kind"]: reference} if reference else {}),
        "noise": {"force_N": rig.noise_force_N, "moment_Nm": rig.noise_moment_Nm, "pose_m": rig.pose_noise_m},
        "fit": {
            "chi2_per_freedom": rig.chi2,
            "consistency": rig.consistency,
            "freedom": rig.freedom,
            **rig.details,
            "sentences": list(rig.sentences),
        },
        "quantities": dict(zip(rig.names, rig.values.tolist(), strict=True)),
        "uncertainty": {"coverage_factor": COVERAGE_FACTOR}
        | dict(zip(names, rig.standard_deviations[known].tolist(), strict=True)),
        "covariance": {
            "quantities": names,
            "well": np.array(rig.well)[known].tolist(),
            "matrix": rig.covariance[np.ix_(known, known)].tolist(),
        },
        **({"map": dict(rig.map_frames)} if rig.map_frames else {}),
    }


def _frame(position_m: Array, euler_deg: Array) -> dict[str, Any]:
    return {"position_mm": (1000 * position_m).tolist(), "euler_deg": euler_deg.tolist()}


def read_rig(path: str | Path) -> Calibration:
    """Read a calibration.  Raises InputError with the name of the file and the error in it.

    A file by hand needs [rod], [sensor] and [clamp] only; what it lacks of the rest counts as not known.
    """
    data = read_section(path, "rig")
    if data.integer("schema", _SCHEMA, at_least=0) != _SCHEMA:
        raise data.error("schema", f"must be {_SCHEMA}, got {data.any('schema')!r}")
    rod, sensor, clamp, tare = (data.section(name) for name in ("rod", "sensor", "clamp", "tare"))
    fit, noise, quantities, uncertainty = (data.section(name) for name in ("fit", "noise", "quantities", "uncertainty"))
    uncertainty.any("coverage_factor")
    frames, names = data.section("map"), tuple(quantities.data)
    covariance, well = _covariance(data.section("covariance"), names)
    calibration = Calibration(
        rod=read_rod(rod),
        sensor_position_m=_three(sensor, "position_mm") / 1000,
        sensor_euler_deg=_three(sensor, "euler_deg"),
        clamp_position_m=_three(clamp, "position_mm") / 1000,
        clamp_euler_deg=_three(clamp, "euler_deg"),
        tare=np.concatenate([_three(tare, "force_N"), _three(tare, "moment_Nm")]),
        drift=np.concatenate([_three(tare, "drift_force_N"), _three(tare, "drift_moment_Nm")]),
        names=names,
        values=np.array([quantities.number(name) for name in names]),
        standard_deviations=np.array([uncertainty.number(name, math.inf) for name in names]),
        covariance=covariance,
        well=well,
        sentences=fit.texts("sentences"),
        chi2=fit.number("chi2_per_freedom", math.nan),
        consistency=fit.number("consistency", math.nan),
        freedom=fit.integer("freedom", 0, at_least=0),
        pose_noise_m=noise.number("pose_m", 0.0),
        noise_force_N=noise.number("force_N", 0.0),
        noise_moment_Nm=noise.number("moment_Nm", 0.0),
        reference=_read_reference(data),
        details={key: fit.any(key) for key in fit.data if key not in _FIT},
        map_frames={title: dict(frames.notes(title)) for title in ("sensor", "clamp") if title in frames},
    )
    data.finish("; scan3d calibrate writes such a file")
    return calibration


def _three(section: Section, name: str) -> Array:
    return np.array(section.numbers(name, 3, (0.0, 0.0, 0.0)))


def _covariance(section: Section, names: tuple[str, ...]) -> tuple[Array, tuple[bool, ...]]:
    """The covariance (k, k) of quantities (k,), and whether they are well determined."""
    covariance, well = np.zeros((len(names), len(names))), np.zeros(len(names), dtype=bool)
    listed, matrix, good = section.texts("quantities"), section.any("matrix", []), section.any("well", [])
    wrong = section.error(
        "", "must have quantities of [quantities], and a row of numbers, a column and true or false for each"
    )
    try:
        rows = np.array([names.index(name) for name in listed], dtype=int)
        covariance[np.ix_(rows, rows)] = np.array(matrix, dtype=float).reshape(len(rows), len(rows))
        well[rows] = good
    except (ValueError, TypeError):
        raise wrong from None
    return covariance, tuple(map(bool, well))


def _read_reference(data: Section) -> dict[str, Any]:
    """What was touched; files of former versions may name a mesh."""
    sphere, plane, mesh = data.section("sphere"), data.section("plane"), data.notes("mesh")
    if sphere:
        place = list(sphere.numbers("position_mm", 3))
        return {"kind": "sphere", "diameter_mm": sphere.number("diameter_mm"), "position_mm": place}
    if plane:
        return {"kind": "plane", "normal": list(plane.numbers("normal", 3)), "offset_mm": plane.number("offset_mm")}
    return {"kind": "mesh", **mesh} if mesh else {}
