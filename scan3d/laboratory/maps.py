"""Maps: what the columns of a laboratory's table mean, as a TOML file that can be kept and shared.

`Map` and its parts hold what the file says, in SI units; `read_map` checks every name and value in it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from scan3d.arrays import Array
from scan3d.errors import InputError
from scan3d.files.reading import read_toml
from scan3d.files.recordings import TABLE
from scan3d.laboratory.entries import Entries
from scan3d.laboratory.quantities import factor
from scan3d.rigs import RigUncertainty
from scan3d.rods import Rod
from scan3d.units import UNITS_M

Reference = str | int
"""A column: its name, a pattern with ``*`` or ``?``, or its number from 1; with ``-`` before a name its sign is reversed, and
an empty text stands for a column that does not exist."""

SECTIONS = (
    "table", "ros", "columns", "units", "clamp", "sensor", "tare", "filter", "sweeps", "rod", "noise", "unit", TABLE,
)  # fmt: skip
ORIENTATIONS = {"quaternion": 4, "euler": 3, "rotvec": 3}
"""Kinds of orientation, and how many columns each has; Euler angles may have fewer, one for each letter of the convention."""
SHOWS = ("clamp-on-rod", "rod-on-clamp")
DIRECTIONS = ("-x", "both")
MISSING = ("refuse", "drop")


@dataclass(frozen=True)
class Layout:
    """How a text table is written; empty and None where this is to be found from the table."""

    delimiter: str = ""
    decimal: str = "."
    header: int | None = None
    """Number of the line with the names of the columns, from 1; 0 if there is no such line."""
    units_row: bool = False
    """Whether the line below the names states the units."""
    comment: str = "#"
    missing: str = "refuse"
    """What becomes of rows with an empty cell: refuse or drop."""


@dataclass(frozen=True)
class Topics:
    """The topics of a ROS bag; empty where there is only one of its kind."""

    wrench: str = ""
    pose: str = ""
    frames: tuple[str, str] | None = None
    """World and clamp, if the poses come from tf."""


@dataclass(frozen=True)
class Orientation:
    """The columns of the orientation, and how they are read."""

    kind: str
    columns: tuple[Reference, ...]
    convention: str = "xyz"
    """Of Euler angles, as in `scipy.spatial.transform.Rotation`."""
    order: str = "wxyz"
    """Of a quaternion's columns: wxyz or xyzw."""


@dataclass(frozen=True)
class Columns:
    """Which columns hold what."""

    position: tuple[Reference, ...]
    orientation: Orientation
    force: tuple[Reference, ...]
    """Of the sensor's x, y and z axes; empty texts stand for channels that it does not have."""
    moment: tuple[Reference, ...]
    time: Reference | None = None
    sweep: Reference | None = None
    move: Reference | None = None
    position_in: str = "world"
    """Frame of the position's components: world or clamp, for a body on a turntable."""


@dataclass(frozen=True)
class Frame:
    """A frame in another one: its origin and its turn (a matrix whose columns are its axes)."""

    position_m: Array
    turn: Array

    @property
    def trivial(self) -> bool:
        return not self.position_m.any() and bool((self.turn == np.eye(3)).all())


@dataclass(frozen=True)
class Map:
    """What a table's columns mean."""

    columns: Columns
    rod: Rod
    factors: Mapping[str, float]
    """What the units of time, length, angle, force and moment are in SI units."""
    clamp: Frame
    """The clamp's frame in the one whose pose is logged."""
    sensor: Frame
    """The sensor's frame in the clamp's."""
    reversed_sign: bool = False
    """Whether the sensor shows the action of the rod on the clamp."""
    air: str | tuple[tuple[float, float], ...] = "auto"
    """Stretches in the air in seconds, 'auto' to find them, or 'none' for a table that is tared already."""
    lowpass_hz: float | None = None
    rate_hz: float | None = None
    directions: str = "-x"
    """Which strokes count as sweeps: those along -x of the clamp's frame, or also those back."""
    noise_force_N: float | None = None
    noise_moment_Nm: float | None = None
    noise_pose_m: float | None = None
    unit: str = "mm"
    table_m: float | None = None
    """Height z of the table on which the body stands, in the world of the clamp's pose."""
    layout: Layout = field(default_factory=Layout)
    topics: Topics = field(default_factory=Topics)
    name: str = "the map"
    """Of its file, for messages."""
    text: Mapping[str, Any] = field(default_factory=dict)
    """The contents of the file, for the recording's source."""
    rig: Mapping[str, Any] = field(default_factory=dict)
    """The calibrated rig whose frames and rod these are, for the recording's source; empty if there is none."""
    uncertainty: RigUncertainty | None = None
    """What is not known exactly of that rig."""


ROS_COLUMNS: dict[str, Any] = {
    "time": "t",
    "position": ["x", "y", "z"],
    "orientation": {"quaternion": ["qw", "qx", "qy", "qz"]},
    "force": ["Fx", "Fy", "Fz"],
    "moment": ["Tx", "Ty", "Tz"],
}
"""The columns of a ROS bag, whose units are those of SI."""


def read_map(source: str | Path | Mapping[str, Any] | Map) -> Map:
    """The map of a TOML file, or of the same contents as a mapping.

    Raises InputError that names the file, the section and the entry, says what was expected, and which name was probably meant.
    """
    if isinstance(source, Map):
        return source
    if isinstance(source, Mapping):
        return _map(source, "the map")
    path = Path(source)
    try:
        return _map(read_toml(path), path.name)
    except InputError:
        raise
    except OSError as error:
        raise InputError(
            f"can't read the map {path}: {error.strerror or error}; scan3d import RAW --map {path.name} --guess writes one"
        ) from None
    except ValueError as error:
        raise InputError(f"{path.name} is not a TOML file: {error}") from None


def _map(data: Mapping[str, Any], name: str) -> Map:
    top = Entries(name, "", data)
    sections = {key: top.section(key) for key in SECTIONS if key not in ("unit", TABLE)}
    unit, table = top.choice("unit", tuple(UNITS_M), "mm"), top.number(TABLE)
    top.finish(SECTIONS)
    topics = _topics(sections["ros"])
    if "ros" in data and "columns" not in data:
        sections["columns"] = Entries(name, "columns", ROS_COLUMNS)
        defaults = {"time": "s", "length": "m", "angle": "rad", "force": "N", "moment": "N m"}
    else:
        defaults = {}
    tare, filters, sweeps, noise = (sections[key] for key in ("tare", "filter", "sweeps", "noise"))
    sensor = sections["sensor"]
    made = Map(
        columns=_columns(sections["columns"]),
        rod=_rod(sections["rod"]),
        factors=_factors(sections["units"], defaults),
        clamp=_frame(sections["clamp"]),
        reversed_sign=sensor.choice("shows", SHOWS, SHOWS[0]) == SHOWS[1],
        sensor=_frame(sensor),
        air=_air(tare),
        lowpass_hz=filters.positive("lowpass_hz"),
        rate_hz=filters.positive("rate_hz"),
        directions=sweeps.choice("directions", DIRECTIONS, DIRECTIONS[0]),
        noise_force_N=noise.number("force_N", None, at_least=0.0),
        noise_moment_Nm=noise.number("moment_Nm", None, at_least=0.0),
        noise_pose_m=noise.number("pose_m", None, at_least=0.0),
        unit=unit,
        table_m=table,
        layout=_layout(sections["table"]),
        topics=topics,
        name=name,
        text=data,
    )
    for entries in sections.values():
        entries.finish()
    return made


def _topics(entries: Entries) -> Topics:
    frames = entries.texts("tf", 2)
    pose = entries.text("pose", "")
    if frames and pose:
        raise entries.error("tf", "and pose can't both be given: the clamp's poses come from one of them")
    return Topics(entries.text("wrench", ""), pose, (frames[0], frames[1]) if frames else None)


def _layout(entries: Entries) -> Layout:
    delimiter = entries.text("delimiter", "")
    named = {"comma": ",", "semicolon": ";", "tab": "\t", "space": " ", "whitespace": " "}
    delimiter = named.get(delimiter, delimiter)
    if len(delimiter) > 1:
        raise entries.error("delimiter", f"must be one character, or {', '.join(named)}; got {delimiter!r}")
    decimal = entries.choice("decimal", (".", ","), ".")
    if delimiter == decimal:
        raise entries.error("decimal", f"and delimiter can't both be {decimal!r}")
    return Layout(
        delimiter,
        decimal,
        entries.integer("header", None, at_least=0),
        entries.boolean("units_row", False),
        entries.text("comment", "#"),
        entries.choice("missing", MISSING, MISSING[0]),
    )


def _columns(entries: Entries) -> Columns:
    if not entries:
        raise InputError(
            f"{entries.file}: [columns] is missing; it says which columns hold position, orientation, force and moment"
        )
    force = _channels(entries, "force", {2: (0, 1), 3: (0, 1, 2)})
    moment = _channels(entries, "moment", {1: (2,), 3: (0, 1, 2)})
    return Columns(
        position=entries.references("position", (3,)),
        orientation=_orientation(entries),
        force=force,
        moment=moment,
        time=entries.reference("time"),
        sweep=entries.reference("sweep"),
        move=entries.reference("move"),
        position_in=entries.choice("position_in", ("world", "clamp"), "world"),
    )


def _channels(entries: Entries, name: str, places: Mapping[int, tuple[int, ...]]) -> tuple[Reference, ...]:
    """Three references, empty where the sensor has no such channel."""
    given = entries.references(name, tuple(places))
    if len(given) == 1 and isinstance(given[0], str) and any(sign in given[0] for sign in "*?"):
        return given
    axes = places[len(given)]
    return tuple(given[axes.index(axis)] if axis in axes else "" for axis in range(3))


def _orientation(entries: Entries) -> Orientation:
    inner = entries.section("orientation", required=True)
    kinds = [kind for kind in ORIENTATIONS if kind in inner]
    if len(kinds) != 1:
        raise entries.error(
            "orientation", f"needs one of {', '.join(ORIENTATIONS)}, such as {{quaternion = ['qw', 'qx', 'qy', 'qz']}}"
        )
    kind = kinds[0]
    convention = "xyz"
    if kind == "euler":
        convention = inner.text("convention", "xyz")
        try:
            Rotation.from_euler(convention, np.zeros((1, len(convention))))
        except (ValueError, TypeError):
            raise inner.error(
                "convention",
                "must be one to three axes, as in scipy's Rotation: lower case for fixed axes, such as xyz, upper case for "
                f"turning axes, such as ZYX; got {convention!r}",
            ) from None
    count = len(convention) if kind == "euler" else ORIENTATIONS[kind]
    columns = inner.references(kind, (count,))
    order = inner.choice("order", ("wxyz", "xyzw"), "wxyz") if kind == "quaternion" else "wxyz"
    inner.finish()
    return Orientation(kind, columns, convention, order)


def _factors(entries: Entries, defaults: Mapping[str, str]) -> dict[str, float]:
    usual = {"time": "s", "angle": "deg", **defaults}
    factors = {}
    for quantity in ("time", "length", "angle", "force", "moment"):
        # a length, force or moment whose unit is guessed would be wrong by a factor of a thousand
        unit = entries.text(quantity, usual.get(quantity))
        factors[quantity] = factor(unit, quantity, f"{entries.file}: [units] {quantity}")
    return factors


def _frame(entries: Entries) -> Frame:
    position = np.array(entries.numbers("position_mm", 3, (0.0, 0.0, 0.0))) * 1e-3
    angles = entries.numbers("euler_deg", 3, (0.0, 0.0, 0.0))
    turn = Rotation.from_euler("xyz", angles, degrees=True).as_matrix() if any(angles) else np.eye(3)
    return Frame(position, turn)


def read_frame(section: Mapping[str, Any], name: str) -> Frame:
    """The frame that `position_mm` and `euler_deg` describe, as in the sections [clamp] and [sensor] of a map."""
    return _frame(Entries(name, "", section))


def _air(entries: Entries) -> str | tuple[tuple[float, float], ...]:
    air = entries.any("air", "auto")
    if isinstance(air, str) and air in ("auto", "none"):
        return air
    expected = "must be 'auto', 'none', or stretches in seconds, such as [[0.0, 1.5], [20.0, 21.0]]"
    if not isinstance(air, list) or not air:
        raise entries.error("air", f"{expected}; got {air!r}")
    for pair in air:
        numbers = isinstance(pair, list) and all(isinstance(x, (int, float)) and not isinstance(x, bool) for x in pair)
        if not numbers or len(pair) != 2 or not pair[0] < pair[1]:
            raise entries.error("air", f"{expected}; got {pair!r}")
    return tuple((float(start), float(end)) for start, end in air)


def _rod(entries: Entries) -> Rod:
    length = entries.number("length_m")
    stiffness = entries.number("bending_stiffness_Nm2", None)
    diameter = entries.number("diameter_m", None)
    modulus = entries.number("modulus_Pa", None)
    try:
        if length is not None and stiffness is not None:
            return Rod(length, stiffness, diameter or 0.0)
        if length is not None and diameter is not None and modulus is not None:
            return Rod.wire(length, diameter, modulus)
    except InputError as error:
        raise InputError(f"{entries.file}: [rod] {error}") from None
    raise InputError(
        f"{entries.file}: [rod] needs length_m and bending_stiffness_Nm2, or length_m, diameter_m and modulus_Pa"
    )
