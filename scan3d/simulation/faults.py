"""What real rigs do to a log: a TOML file of faults, read and checked.

Sizes of bias, drift, noise and quanta are given in N and N·m (`force_N`, `moment_Nm`), or as a `fraction` of the largest force
and of the largest moment of the log.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from scan3d.arrays import Array
from scan3d.errors import InputError
from scan3d.files.reading import did_you_mean, read_toml, to_float
from scan3d.frames import to_inner, turn_of

SHOWS = ("clamp-on-rod", "rod-on-clamp")
"""Which wrench the sensor shows; the first is that of a recording."""
DRIFTS = ("linear", "random-walk")
RATE_HZ = 1000.0
_TOP = ("seed", "rate_hz", "speed_mm_s")


@dataclass(frozen=True)
class Size:
    """A size of forces and moments: absolute, or relative to the largest of the log."""

    force_N: float = 0.0
    moment_Nm: float = 0.0
    fraction: float = 0.0

    def of(self, largest: tuple[float, float]) -> tuple[float, float]:
        """In N and N·m; the absolute and the relative part are added."""
        return self.force_N + self.fraction * largest[0], self.moment_Nm + self.fraction * largest[1]

    def __bool__(self) -> bool:
        return bool(self.force_N or self.moment_Nm or self.fraction)


@dataclass(frozen=True)
class Frame:
    """A sensor's frame in that of the clamp: its origin in mm, and its turn as "xyz" Euler angles in degrees."""

    position_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    euler_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def seen(self, force: Array, moment: Array) -> tuple[Array, Array]:
        """Force (n, 3) and moment (n, 3) at the clamp, as a sensor in this frame measures them: about its own origin."""
        return to_inner(force, moment, turn_of(self.euler_deg), np.array(self.position_mm) / 1000)


@dataclass(frozen=True)
class Faults:
    """The faults of a rig; by default none.  `read_faults` describes the keys of the file that has them."""

    seed: int = 0
    rate_hz: float = RATE_HZ
    speed_mm_s: float | None = None
    """Of the clamp; None: as planned."""
    sensor: Frame = field(default_factory=Frame)
    nominal: Frame = field(default_factory=Frame)
    """What the experimenter takes for the sensor's frame."""
    shows: str = SHOWS[0]
    bias: Size = field(default_factory=Size)
    bias_force_N: tuple[float, ...] | None = None
    bias_moment_Nm: tuple[float, ...] | None = None
    drift: Size = field(default_factory=Size)
    drift_kind: str = DRIFTS[0]
    noise: Size = field(default_factory=Size)
    pink: Size = field(default_factory=Size)
    quantum: Size = field(default_factory=Size)
    quantum_um: float = 0.0
    lag_ms: float = 0.0
    jitter_um: float = 0.0
    clock_ms: float = 0.0
    length_error: float = 0.0
    stiffness_error: float = 0.0
    missing: float = 0.0
    gap_ms: float = 0.0


# The keys of each section: the field of `Faults`, and the check of the value.
_KEYS: dict[str, dict[str, str]] = {
    "sensor": {"position_mm": "vector", "euler_deg": "vector", "shows": "shows", "nominal": "frame"},
    "bias": {"force_N": "vector", "moment_Nm": "vector", "fraction": "size"},
    "drift": {"kind": "drift", "force_N": "size", "moment_Nm": "size", "fraction": "size"},
    "noise": {
        "force_N": "size",
        "moment_Nm": "size",
        "fraction": "size",
        "pink_force_N": "size",
        "pink_moment_Nm": "size",
        "pink_fraction": "size",
    },
    "quantisation": {"force_N": "size", "moment_Nm": "size", "fraction": "size", "position_um": "size"},
    "lag": {"ms": "size"},
    "pose": {"jitter_um": "size", "clock_ms": "number"},
    "rod": {"length_error": "relative", "stiffness_error": "relative"},
    "missing": {"fraction": "part", "gap_ms": "size"},
}


def read_faults(path: str | Path) -> Faults:
    """The faults in a TOML file, all of whose keys are optional.

    ==================  ================================================================================================
    ``seed``            of all random numbers, 0 by default; the option ``--seed`` takes precedence
    ``rate_hz``         rows per second, 1000 by default
    ``speed_mm_s``      of the clamp; by default that of the plan
    ``[sensor]``        ``position_mm``, ``euler_deg`` ("xyz"): its frame in the clamp's; ``shows``: "clamp-on-rod" or
                        "rod-on-clamp"; ``nominal = {position_mm, euler_deg}``: what the experimenter takes them for
    ``[bias]``          ``force_N``, ``moment_Nm``: three numbers each; or ``fraction``, in a random direction
    ``[drift]``         ``kind``: "linear" or "random-walk"; size at the end of the log
    ``[noise]``         standard deviation of each channel: white, and with the prefix ``pink_`` that of 1/f noise
    ``[quantisation]``  steps of the channels; ``position_um``: of the positions
    ``[lag]``           ``ms``: time constant of a low-pass of the first order before the wrench is logged
    ``[pose]``          ``jitter_um``: standard deviation of each logged coordinate; ``clock_ms``: delay of the wrenches
    ``[rod]``           ``length_error``, ``stiffness_error``: relative differences of the true rod from the nominal one
    ``[missing]``       ``fraction`` of the rows that are lost, in gaps of ``gap_ms``; by default of one row
    ==================  ================================================================================================

    Raises InputError with the name of the file and the error in it.
    """
    path = Path(path)
    try:
        data = read_toml(path)
    except OSError as error:
        raise InputError(f"can't read the faults {path}: {error.strerror or error}") from None
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"{path} is not a TOML file of faults: {error}") from None
    try:
        return faults_of(data)
    except InputError as error:
        raise InputError(f"{path.name}: {error}") from None


def faults_of(data: Mapping[str, Any]) -> Faults:
    """The faults that the contents of a file describe, as `read_faults`."""
    _check_names("", data, (*_TOP, *_KEYS))
    sections: dict[str, dict[str, Any]] = {}
    for name, keys in _KEYS.items():
        section = data.get(name, {})
        if not isinstance(section, Mapping):
            raise InputError(f"{name} must be a section [{name}], got {section!r}")
        _check_names(f"[{name}] has ", section, tuple(keys))
        sections[name] = {key: _CHECKS[keys[key]](f"[{name}] {key}", value) for key, value in section.items()}
    seed = data.get("seed", 0)
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise InputError(f"seed must be a whole number of at least 0, got {seed!r}")
    sensor, bias, noise = dict(sections["sensor"]), sections["bias"], sections["noise"]
    drift, quantum = dict(sections["drift"]), dict(sections["quantisation"])
    given = {name: data[name] for name in ("rate_hz", "speed_mm_s") if name in data}
    for name, value in given.items():
        if _number(name, value) <= 0:
            raise InputError(f"{name} must be a number above 0, got {value!r}")
    rod, pose = sections["rod"], sections["pose"]
    return Faults(
        seed=seed,
        rate_hz=float(given.get("rate_hz", RATE_HZ)),
        speed_mm_s=float(given["speed_mm_s"]) if "speed_mm_s" in given else None,
        nominal=sensor.pop("nominal", Frame()),
        shows=sensor.pop("shows", SHOWS[0]),
        sensor=Frame(**sensor),
        bias=Size(fraction=bias.get("fraction", 0.0)),
        bias_force_N=bias.get("force_N"),
        bias_moment_Nm=bias.get("moment_Nm"),
        drift_kind=drift.pop("kind", DRIFTS[0]),
        drift=Size(**drift),
        noise=Size(**{key: value for key, value in noise.items() if not key.startswith("pink_")}),
        pink=Size(**{key.removeprefix("pink_"): value for key, value in noise.items() if key.startswith("pink_")}),
        quantum_um=quantum.pop("position_um", 0.0),
        quantum=Size(**quantum),
        lag_ms=sections["lag"].get("ms", 0.0),
        jitter_um=pose.get("jitter_um", 0.0),
        clock_ms=pose.get("clock_ms", 0.0),
        length_error=rod.get("length_error", 0.0),
        stiffness_error=rod.get("stiffness_error", 0.0),
        missing=sections["missing"].get("fraction", 0.0),
        gap_ms=sections["missing"].get("gap_ms", 0.0),
    )


def _check_names(where: str, section: Mapping[str, Any], known: tuple[str, ...]) -> None:
    unknown = sorted(set(section) - set(known))
    if unknown:
        raise InputError(
            f"{where}unknown names: {', '.join(unknown)}; known are {', '.join(known)}{did_you_mean(unknown, known)}"
        )


def _number(name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(to_float(value)):
        raise InputError(f"{name} must be a number, got {value!r}")
    return float(value)


def _size(name: str, value: Any) -> float:
    if _number(name, value) < 0:
        raise InputError(f"{name} must be a number >= 0, got {value!r}")
    return float(value)


def _part(name: str, value: Any) -> float:
    if not 0 <= _number(name, value) < 1:
        raise InputError(f"{name} must lie from 0 to less than 1, got {value!r}")
    return float(value)


def _relative(name: str, value: Any) -> float:
    if not -1 < _number(name, value) < 1:
        raise InputError(
            f"{name} must be a relative difference between -1 and 1, such as 0.02 for two per cent more, got {value!r}"
        )
    return float(value)


def _vector(name: str, value: Any) -> tuple[float, ...]:
    if not isinstance(value, list) or len(value) != 3:
        raise InputError(f"{name} must be a list of three numbers, got {value!r}")
    return tuple(_number(name, item) for item in value)


def _frame(name: str, value: Any) -> Frame:
    if not isinstance(value, Mapping):
        raise InputError(f"{name} must be a table {{position_mm = [...], euler_deg = [...]}}, got {value!r}")
    _check_names(f"{name} has ", value, ("position_mm", "euler_deg"))
    return Frame(**{key: _vector(f"{name} {key}", item) for key, item in value.items()})  # type: ignore[arg-type]


def _one_of(known: tuple[str, ...]) -> Any:
    def check(name: str, value: Any) -> str:
        if value not in known:
            known_names = " or ".join(f'"{item}"' for item in known)
            raise InputError(f"{name} must be {known_names}, got {value!r}{did_you_mean([str(value)], known)}")
        return str(value)

    return check


_CHECKS = {
    "vector": _vector,
    "size": _size,
    "number": _number,
    "part": _part,
    "relative": _relative,
    "frame": _frame,
    "shows": _one_of(SHOWS),
    "drift": _one_of(DRIFTS),
}
