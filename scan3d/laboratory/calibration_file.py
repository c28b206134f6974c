"""RIG.toml: a calibration as a file, for reconstruction and import."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from scan3d.arrays import Array
from scan3d.errors import InputError
from scan3d.files.reading import did_you_mean, read_toml
from scan3d.files.text import to_toml
from scan3d.files.whole import Inputs, check_file, folder, write_atomic
from scan3d.laboratory.calibration_quantities import COVERAGE_FACTOR
from scan3d.laboratory.calibration_reference import KINDS
from scan3d.laboratory.calibration_result import Calibration
from scan3d.rods import Rod

# Number of the format.
_SCHEMA = 1
_MARK = "# rig calibrated by scan3d\n"
_SECTIONS = (
    "schema",
    "rod",
    "sensor",
    "clamp",
    "tare",
    *KINDS,
    "noise",
    "fit",
    "quantities",
    "uncertainty",
    "covariance",
    "map",
)


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
    deviations = [float(value) for value in rig.standard_deviations[known]]
    return {
        "schema": _SCHEMA,
        "rod": {
            "length_m": rig.rod.length_m,
            "bending_stiffness_Nm2": rig.rod.bending_stiffness_Nm2,
            "diameter_m": rig.rod.diameter_m,
        },
        "sensor": {"position_mm": _numbers(1000 * rig.sensor_position_m), "euler_deg": _numbers(rig.sensor_euler_deg)},
        "clamp": {"position_mm": _numbers(1000 * rig.clamp_position_m), "euler_deg": _numbers(rig.clamp_euler_deg)},
        "tare": {
            "force_N": _numbers(rig.tare[:3]),
            "moment_Nm": _numbers(rig.tare[3:]),
            "drift_force_N": _numbers(rig.drift[:3]),
            "drift_moment_Nm": _numbers(rig.drift[3:]),
        },
        **_reference(rig),
        "noise": {"force_N": rig.noise_force_N, "moment_Nm": rig.noise_moment_Nm, "pose_m": rig.pose_noise_m},
        "fit": {
            "chi2_per_freedom": rig.chi2,
            "consistency": rig.consistency,
            "freedom": rig.freedom,
            **rig.details,
            "sentences": list(rig.sentences),
        },
        "quantities": {name: float(value) for name, value in zip(rig.names, rig.values, strict=True)},
        "uncertainty": {"coverage_factor": COVERAGE_FACTOR} | dict(zip(names, deviations, strict=True)),
        "covariance": {
            "quantities": names,
            "well": [bool(good) for good, is_known in zip(rig.well, known, strict=True) if is_known],
            "matrix": [_numbers(row) for row in rig.covariance[np.ix_(known, known)]],
        },
        **({"map": dict(rig.map_frames)} if rig.map_frames else {}),
    }


def read_rig(path: str | Path) -> Calibration:
    """Read a calibration.  Raises InputError with the name of the file and the error in it.

    A file by hand needs [rod], [sensor] and [clamp] only; what it lacks of the rest counts as not known.
    """
    name = Path(path).name
    try:
        data = read_toml(path)
    except InputError:
        raise
    except (OSError, ValueError) as error:
        raise InputError(f"can't read the rig {path}: {getattr(error, 'strerror', None) or error}") from None
    unknown = sorted(set(data) - set(_SECTIONS))
    if unknown or data.get("schema", _SCHEMA) != _SCHEMA:
        what = f"unknown names: {', '.join(unknown)}" if unknown else f"schema {data['schema']!r}, expected {_SCHEMA}"
        raise InputError(f"{name}: {what}{did_you_mean(unknown, _SECTIONS)}; scan3d calibrate writes such a file")
    parts = {title: _table(name, data, title) for title in _SECTIONS[1:]}
    try:
        return _calibration(parts)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None


def _calibration(parts: Mapping[str, Mapping[str, Any]]) -> Calibration:
    rod = parts["rod"]
    fit, noise = parts["fit"], parts["noise"]
    names = tuple(str(name) for name in parts["quantities"])
    values = np.array([_number("quantities", parts["quantities"], name) for name in names])
    deviations = np.array([_number("uncertainty", parts["uncertainty"], name, math.inf) for name in names])
    covariance, well = np.zeros((len(names), len(names))), np.zeros(len(names), dtype=bool)
    listed = parts["covariance"].get("quantities", [])
    if listed:
        rows = [names.index(name) if name in names else -1 for name in listed]
        matrix = _matrix(parts["covariance"].get("matrix", []))
        goods = parts["covariance"].get("well", [])
        if min(rows) < 0 or matrix.shape != (len(rows), len(rows)) or len(goods) != len(rows):
            raise InputError("[covariance] must have quantities of [quantities], and a row, a column and well for each")
        covariance[np.ix_(rows, rows)], well[rows] = matrix, goods
    details = {
        key: value
        for key, value in fit.items()
        if key not in ("chi2_per_freedom", "consistency", "freedom", "sentences")
    }
    return Calibration(
        rod=Rod(
            _number("rod", rod, "length_m"),
            _number("rod", rod, "bending_stiffness_Nm2"),
            _number("rod", rod, "diameter_m", 0.0),
        ),
        sensor_position_m=_three("sensor", parts["sensor"], "position_mm") / 1000,
        sensor_euler_deg=_three("sensor", parts["sensor"], "euler_deg"),
        clamp_position_m=_three("clamp", parts["clamp"], "position_mm") / 1000,
        clamp_euler_deg=_three("clamp", parts["clamp"], "euler_deg"),
        tare=np.concatenate([_three("tare", parts["tare"], key) for key in ("force_N", "moment_Nm")]),
        drift=np.concatenate([_three("tare", parts["tare"], key) for key in ("drift_force_N", "drift_moment_Nm")]),
        names=names,
        values=values,
        standard_deviations=deviations,
        covariance=covariance,
        well=tuple(map(bool, well)),
        sentences=tuple(map(str, fit.get("sentences", ()))),
        chi2=_number("fit", fit, "chi2_per_freedom", math.nan),
        consistency=_number("fit", fit, "consistency", math.nan),
        freedom=int(_number("fit", fit, "freedom", 0)),
        pose_noise_m=_number("noise", noise, "pose_m", 0.0),
        noise_force_N=_number("noise", noise, "force_N", 0.0),
        noise_moment_Nm=_number("noise", noise, "moment_Nm", 0.0),
        reference=_read_reference(parts),
        details=details,
        map_frames={
            title: _table("[map]", parts["map"], title) for title in ("sensor", "clamp") if title in parts["map"]
        },
    )


def _reference(rig: Calibration) -> dict[str, Any]:
    """The section of what was touched."""
    return {rig.reference["kind"]: {k: v for k, v in rig.reference.items() if k != "kind"}} if rig.reference else {}


def _read_reference(parts: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """What was touched, of the first of its sections."""
    for kind in KINDS:
        if parts[kind]:
            section, found = parts[kind], {"kind": kind}
            for name, value in section.items():
                if name in ("position_mm", "euler_deg", "normal"):
                    _three(kind, section, name)
                elif name in ("diameter_mm", "offset_mm"):
                    _number(kind, section, name)
                found[name] = value
            return found
    return {}


def _matrix(rows: Any) -> Array:
    """The rows of a matrix; an empty one for what is no matrix of numbers."""
    try:
        return np.array(rows, dtype=float)
    except (ValueError, TypeError):
        return np.empty((0, 0))


def _numbers(values: Array) -> list[float]:
    return [float(value) for value in values]


def _table(name: str, data: Mapping[str, Any], title: str) -> Mapping[str, Any]:
    table = data.get(title, {})
    if not isinstance(table, Mapping):
        raise InputError(f"{name}: {title} must be a section [{title}], got {table!r}")
    return table


def _number(section: str, table: Mapping[str, Any], name: str, default: float | None = None) -> float:
    value = table.get(name, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InputError(
            f"[{section}] {name} must be a number, got {value!r}" if name in table else f"[{section}] lacks {name}"
        )
    return float(value)


def _three(section: str, table: Mapping[str, Any], name: str) -> Array:
    value = table.get(name, [0.0, 0.0, 0.0])
    right = isinstance(value, list) and len(value) == 3
    if not right or not all(
        isinstance(x, (int, float)) and not isinstance(x, bool) and math.isfinite(x) for x in value
    ):
        raise InputError(f"[{section}] {name} must be three numbers, got {value!r}")
    return np.array(value, dtype=float)
