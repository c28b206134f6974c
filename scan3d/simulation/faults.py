"""What real rigs do to a log: a TOML file of faults, read and checked.

Sizes of bias, drift, noise and quanta are given in N and N·m (`force_N`, `moment_Nm`), or as a `fraction` of the largest force
and of the largest moment of the log.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from scan3d.arrays import Array
from scan3d.files.section import Section, read_section
from scan3d.frames import to_inner, turn_of

SHOWS = ("clamp-on-rod", "rod-on-clamp")
"""Which wrench the sensor shows; the first is that of a recording."""
DRIFTS = ("linear", "random-walk")
RATE_HZ = 1000.0


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
    return _faults(read_section(path, "faults"))


def faults_of(data: Mapping[str, Any]) -> Faults:
    """The faults that the contents of a file describe, as `read_faults`."""
    return _faults(Section("the faults", data))


def _faults(top: Section) -> Faults:
    sensor, bias, drift, noise = (top.section(name) for name in ("sensor", "bias", "drift", "noise"))
    quantum, pose, rod, missing = (top.section(name) for name in ("quantisation", "pose", "rod", "missing"))
    found = Faults(
        seed=top.integer("seed", 0, at_least=0),
        rate_hz=top.number("rate_hz", RATE_HZ, above=0),
        speed_mm_s=top.number("speed_mm_s", None, above=0),
        sensor=_frame(sensor),
        nominal=_frame(sensor.section("nominal")),
        shows=sensor.word("shows", SHOWS),
        bias=Size(fraction=bias.number("fraction", 0.0, at_least=0)),
        bias_force_N=bias.numbers("force_N", 3, None),
        bias_moment_Nm=bias.numbers("moment_Nm", 3, None),
        drift_kind=drift.word("kind", DRIFTS),
        drift=_size(drift),
        noise=_size(noise),
        pink=_size(noise, "pink_"),
        quantum=_size(quantum),
        quantum_um=quantum.number("position_um", 0.0, at_least=0),
        lag_ms=top.section("lag").number("ms", 0.0, at_least=0),
        jitter_um=pose.number("jitter_um", 0.0, at_least=0),
        clock_ms=pose.number("clock_ms", 0.0),
        length_error=rod.number("length_error", 0.0, above=-1, below=1),
        stiffness_error=rod.number("stiffness_error", 0.0, above=-1, below=1),
        missing=missing.number("fraction", 0.0, at_least=0, below=1),
        gap_ms=missing.number("gap_ms", 0.0, at_least=0),
    )
    top.finish()
    return found


def _size(section: Section, prefix: str = "") -> Size:
    names = ("force_N", "moment_Nm", "fraction")
    return Size(*(section.number(prefix + name, 0.0, at_least=0) for name in names))


def _frame(section: Section) -> Frame:
    position, angles = (section.numbers(name, 3, (0.0, 0.0, 0.0)) for name in ("position_mm", "euler_deg"))
    return Frame((position[0], position[1], position[2]), (angles[0], angles[1], angles[2]))
