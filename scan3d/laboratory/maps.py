"""Maps: what the columns of a laboratory's table mean, as a TOML file that can be kept and shared.

`Map` and its parts hold what the file says, in SI units; `read_map` checks every name and value in it.  `guess_map` writes a
first one from the names in the header and the sizes of the numbers.  What it can't find is a text in parentheses, which no
column has, so that the map is refused until it is completed.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from scan3d.arrays import Array
from scan3d.files.recordings import TABLE, gravity_of, read_known
from scan3d.files.tables import Layout, Table, guessed_layout, read_table
from scan3d.files.text import (
    REQUIRED,
    Section,
    Transducer,
    did_you_mean,
    read_frame,
    read_rod,
    read_section,
    read_transducer,
)
from scan3d.laboratory.bags import bag_files, is_bag
from scan3d.laboratory.logs import stated_units
from scan3d.recording import Known
from scan3d.rigs import SHOWS, Frame, RigUncertainty, accuracy_of
from scan3d.rods import Gravity, Rod
from scan3d.units import FACTORS, UNITS_M, is_finite, spelled, without_unit

Reference = str | int
"""A column: its name, or its number from 1; with ``-`` before a name its sign is reversed, and
an empty text stands for a column that does not exist."""

ORIENTATIONS = ("quaternion", "euler", "rotvec", "matrix")
DIRECTIONS = ("-x", "both")
WRENCH_IN = ("sensor", "world")
MISSING = ("refuse", "drop")
POSITION_IN = ("world", "clamp", "inverse")
ORIENTATION_OF = ("clamp", "world")


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
    of: str = "clamp"
    """Whose orientation it is: that of the clamp in the world, or its inverse, that of the world in the clamp's frame."""


@dataclass(frozen=True)
class Columns:
    """Which columns hold what."""

    position: tuple[Reference, ...]
    orientation: Orientation
    force: tuple[Reference, ...]
    """Of the sensor's x, y and z axes; empty texts stand for channels that it does not have, or that its matrix gives."""
    moment: tuple[Reference, ...]
    signals: tuple[Reference, ...] = ()
    """Of a sensor that logs volts, counts or strains, which its matrix makes force and moment of."""
    time: Reference | None = None
    sweep: Reference | None = None
    move: Reference | None = None

    position_in: str = "world"
    """Frame of the position's components: world or clamp, for a body on a turntable; inverse: the world's origin in the clamp's
    frame, of which inverse poses have the position."""

    def names(self) -> list[str]:
        """Those of the columns that have one."""
        vectors = (*self.position, *self.orientation.columns, *self.force, *self.moment, *self.signals)
        return [name for name in (*vectors, self.time, self.sweep, self.move) if isinstance(name, str) and name]


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
    gains: Array
    """(6,) what is added to the tared channels of a calibrated sensor, as multiples of them."""
    transducer: Transducer
    """What makes channels, in the units of the map, of the signals that the sensor logs."""
    known: Known | None = None
    """What is known in the place of one of fx, fy and mz that was not measured."""
    gravity: Gravity | None = None
    """Tared wherever the import takes off what the sensor shows in the air."""
    reversed_sign: bool = False
    """Whether the sensor shows the action of the rod on the clamp."""
    wrench_in: str = "sensor"
    """Frame of the components of force and moment: the sensor's, or the world's in which the poses are."""
    wrench_delay_s: float = 0.0
    """By how much the times of the wrench are later than those of the poses."""
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
ROS_UNITS = {"time": "s", "length": "m", "angle": "rad", "force": "N", "moment": "N m"}
"""The columns of a ROS bag, and their units, which may be left out of its map."""


def read_map(source: str | Path | Mapping[str, Any] | Map) -> Map:
    """The map of a TOML file, or of the same contents as a mapping.

    Raises InputError that names the file, the section and the entry, says what was expected, and which name was probably meant.
    """
    if isinstance(source, Map):
        return source
    if isinstance(source, Mapping):
        return _map(Section("the map", source))
    name = Path(source).name
    return _map(read_section(source, "map", f"; scan3d import RAW --map {name} --guess writes one"))


def _check_completed(top: Section) -> None:
    """Raise InputError that names all that a first map leaves open, if that are several entries."""
    columns, rod = top.data.get("columns", {}), top.data.get("rod", {})
    left = [
        f"[columns] {entry}" for entry, value in columns.items() if re.search(_PLACE, json.dumps(value, default=str))
    ]
    left += [f"[rod] {entry}" for entry in ("length_m", "bending_stiffness_Nm2") if rod.get(entry) == 0]
    if len(left) > 1:
        raise top.error("", f"a first map leaves open {', '.join(left)}; complete them")


def _map(top: Section) -> Map:
    _check_completed(top)
    layout, ros = _layout(top.section("table")), top.section("ros")
    topics = _topics(ros)
    columns, units, usual = top.section("columns"), top.section("units"), {"time": "s", "angle": "deg"}
    if "signals" in columns:  # of a matrix in SI units, as a calibration finds it
        usual |= {"force": "N", "moment": "N m"}
    if "ros" in top and not columns:
        columns, usual = Section(top.file, ROS_COLUMNS, "columns"), ROS_UNITS
    clamp, sensor, filters = top.section("clamp"), top.section("sensor"), top.section("filter")
    wrench = ros if "ros" in top else columns
    sweeps, noise = top.section("sweeps"), top.section("noise")
    read, air = _columns(columns), _air(top.section("tare"))
    transducer = _transducer(sensor, read.signals)
    with sensor.errors_named():  # for a calibration, which finds it among the recording's sources
        accuracy_of(sensor.any("accuracy", 0.0))
    tares = air != "none"
    gravity = gravity_of(top.section("gravity"), True if tares else REQUIRED) if "gravity" in top else None
    made = Map(
        columns=read,
        rod=read_rod(top.section("rod")),
        factors=_factors(units, usual),
        clamp=read_frame(clamp),
        sensor=read_frame(sensor),
        gains=np.zeros(6),
        transducer=transducer,
        reversed_sign=sensor.word("shows", SHOWS) == SHOWS[1],
        wrench_in=wrench.word("wrench_in", WRENCH_IN),
        wrench_delay_s=wrench.number("wrench_delay_s", 0.0),
        air=air,
        known=read_known(top.section("known")) if "known" in top else None,
        # an import that tares takes off the weight, whatever the log was before
        gravity=gravity and replace(gravity, tared=gravity.tared or tares),
        lowpass_hz=filters.number("lowpass_hz", None, above=0),
        rate_hz=filters.number("rate_hz", None, above=0),
        directions=sweeps.word("directions", DIRECTIONS),
        noise_force_N=noise.number("force_N", None, at_least=0),
        noise_moment_Nm=noise.number("moment_Nm", None, at_least=0),
        noise_pose_m=noise.number("pose_m", None, at_least=0),
        unit=top.word("unit", tuple(UNITS_M), "mm"),
        table_m=top.number(TABLE, None),
        layout=layout,
        topics=topics,
        name=top.file,
        text=top.data,
    )
    top.finish()
    return made


def _topics(section: Section) -> Topics:
    frames, pose = section.texts("tf", 2), section.text("pose", "")
    if frames and pose:
        raise section.error("tf", "and pose can't both be given: the clamp's poses come from one of them")
    return Topics(section.text("wrench", ""), pose, (frames[0], frames[1]) if frames else None)


def _layout(section: Section) -> Layout:
    delimiter = section.text("delimiter", "")
    named = {"comma": ",", "semicolon": ";", "tab": "\t", "space": " ", "whitespace": " "}
    delimiter = named.get(delimiter, delimiter)
    if len(delimiter) > 1:
        raise section.error("delimiter", f"must be one character, or {', '.join(named)}; got {delimiter!r}")
    decimal = section.word("decimal", (".", ","))
    return Layout(
        delimiter,
        decimal,
        section.integer("header", None, at_least=0),
        section.boolean("units_row", False),
        section.text("comment", "#"),
        section.word("missing", MISSING),
    )


def _columns(section: Section) -> Columns:
    if not section:
        raise section.error("", "is missing; it says which columns hold position, orientation, force and moment")
    signals = section.any("signals")
    if signals is not None and ("force" in section or "moment" in section):
        raise section.error("signals", "can't be given beside force and moment, which [sensor] matrix makes of them")
    return Columns(
        position=_references(section, "position", (3,)),
        orientation=_orientation(section),
        force=_channels(section, "force", {2: (0, 1), 3: (0, 1, 2)}) if signals is None else ("", "", ""),
        moment=_channels(section, "moment", {1: (2,), 3: (0, 1, 2)}) if signals is None else ("", "", ""),
        signals=() if signals is None else _references(section, "signals", range(1, 100)),
        **{
            key: _column(section, key, value)
            for key in ("time", "sweep", "move")
            if (value := section.any(key)) is not None
        },
        position_in=section.word("position_in", POSITION_IN),
    )


def _transducer(section: Section, signals: tuple[Reference, ...]) -> Transducer:
    """What makes force and moment of the signals of a sensor; empty if it logs them itself."""
    if signals:
        return read_transducer(section, len(signals))
    if wrong := [name for name in Transducer._fields if name in section]:
        raise section.error(wrong[0], "belongs to the columns that [columns] signals names, which is missing")
    return Transducer((), (), ())


def _references(section: Section, key: str, counts: Sequence[int]) -> tuple[Reference, ...]:
    """Columns in a list of one of the given lengths."""
    wanted = " or ".join(map(str, counts))
    value = section.any(key)
    if value is None:
        raise section.error(key, f"is missing; it names {wanted} columns of the table")
    if not isinstance(value, (list, tuple)) or len(value) not in counts:
        raise section.error(key, f"must be a list of {wanted} columns; got {value!r}")
    return tuple(_column(section, key, one) for one in value)


def _column(section: Section, key: str, value: Any) -> Reference:
    if isinstance(value, bool) or not isinstance(value, (str, int)):
        raise section.error(key, f"must name columns by text or by number, got {value!r}")
    if isinstance(value, int) and value < 1:
        raise section.error(key, f"counts columns from 1, got {value}")
    return value


def _channels(section: Section, key: str, places: Mapping[int, tuple[int, ...]]) -> tuple[Reference, ...]:
    """Three references, empty where the sensor has no such channel."""
    given = _references(section, key, tuple(places))
    axes = places[len(given)]
    return tuple(given[axes.index(axis)] if axis in axes else "" for axis in range(3))


def _orientation(section: Section) -> Orientation:
    inner = section.section("orientation")
    kinds = [kind for kind in ORIENTATIONS if kind in inner]
    if len(kinds) != 1:
        what = f"one of {', '.join(ORIENTATIONS)}, such as {{quaternion = ['qw', 'qx', 'qy', 'qz']}}"
        raise section.error("orientation", f"needs {what}{did_you_mean(inner.data, ORIENTATIONS)}")
    kind, of = kinds[0], inner.word("of", ORIENTATION_OF)
    if kind == "quaternion":
        return Orientation(kind, _references(inner, kind, (4,)), order=inner.word("order", ("wxyz", "xyzw")), of=of)
    if kind in ("rotvec", "matrix"):
        return Orientation(kind, _references(inner, kind, (3 if kind == "rotvec" else 9,)), of=of)
    convention = inner.text("convention", "xyz")
    try:
        Rotation.from_euler(convention, np.zeros((1, len(convention))))
    except (ValueError, TypeError):
        raise inner.error(
            "convention",
            "must be one to three axes, as in scipy's Rotation: lower case for fixed axes, such as xyz, upper case for "
            f"turning axes, such as ZYX; got {convention!r}",
        ) from None
    return Orientation(kind, _references(inner, kind, (len(convention),)), convention, of=of)


def _factors(section: Section, usual: Mapping[str, str]) -> dict[str, float]:
    """What the units are in SI units; a length, force or moment whose unit is guessed would be wrong by a factor of 1000."""
    factors = {}
    for quantity, known in FACTORS.items():
        unit = section.text(quantity, usual.get(quantity, REQUIRED))
        name = spelled(unit, quantity)
        if name is None:
            near = did_you_mean([unit], known)
            raise section.error(quantity, f"must be a unit of {quantity}: {', '.join(known)}; got {unit!r}{near}")
        factors[quantity] = known[name]
    return factors


def _air(section: Section) -> str | tuple[tuple[float, float], ...]:
    air = section.any("air", "auto")
    if isinstance(air, str) and air in ("auto", "none"):
        return air
    expected = "must be 'auto', 'none', or stretches in seconds, such as [[0.0, 1.5], [20.0, 21.0]]"
    if not isinstance(air, (list, tuple)) or not air:
        raise section.error("air", f"{expected}; got {air!r}")
    for pair in air:
        right = isinstance(pair, (list, tuple)) and len(pair) == 2 and all(map(is_finite, pair))
        if not right or not pair[0] < pair[1]:
            raise section.error("air", f"{expected}; got {pair!r}")
    return tuple((float(start), float(end)) for start, end in air)


# Names of columns without units, capital letters, underscores and the like, as laboratories and robots use them.
_WORDS = {
    "time": r"t|time|timestamp|times|stamp|headerstamp|rosbagtimestamp|zeit|elapsed|elapsedtime|timesec|clock|xvalue",
    "sweep": r"sweep|sweepnumber|sweepno|scan|stroke|line",
    "move": r"move|motion|phase|segment|state",
}
_VECTORS = ("position", "force", "moment")
_PREFIX = {
    "position": r"(?:tcp|pos|position|pose|p|clamp|ee|tool|flange|actual|cart|translation|poseposition|actualtcppose|rist)*",
    "force": r"(?:ft|sensor|wrench|tcp|wrenchforce|ati|actual)*(?:f|force|kraft)",
    "moment": r"(?:ft|sensor|wrench|tcp|wrenchtorque|ati|actual)*(?:t|m|torque|moment|tau|mz)",
    "quaternion": r"(?:tcp|pose|ori|orientation|rot|rotation|ee|tool)*(?:q|quat|quaternion|o|orientation|rotation)",
}
# Vectors of numbered columns.  Franka's wrench in the frame K of the tool comes before that in the base's.
_WRENCHES = (r"kfexthatk", r"(?:actual|raw|tcp|ft|ati|sensor|o)*(?:f|ft|force|wrench|forcetorque|fexthatk)")
_EULER = ((("roll", "pitch", "yaw"), "xyz"), (("a", "b", "c"), "ZYX"), (("rx", "ry", "rz"), "xyz"))
"""Names of angles, and the convention that goes with them: A, B and C are those of KUKA."""


# What stands in a first map for a column that was not found.
_PLACE = r'"\((?:(?:position|force|moment) [xyz]|q[wxyz])\)"'


class FirstMap(NamedTuple):
    """A map that is to be completed."""

    text: str
    open: tuple[str, ...]
    """What is not known."""


def guess_map(path: str | Path) -> FirstMap:
    """A first map of a table or a ROS bag.  Raises InputError if it can't be read."""
    path = Path(path)
    if is_bag(path):
        bag_files(path)
        return FirstMap(_HEAD + _BAG + _rest("as it is in a bag"), ("sensor", "rod"))
    layout = guessed_layout(path)
    table = read_table(path, layout)
    left: list[str] = []
    position, force, moment = (_vector(table, _PREFIX[entry]) for entry in _VECTORS)
    # a position and a rotation vector, as of Universal Robots, or Franka's matrix by columns, whose last one is the position
    poses = (
        *((words, range(6)) for words in (r"(?:actual|tcp|ee|tool|pose)+", r"(?:target|tcp|pose)+")),
        (r"otee", (12, 13, 14, 0, 4, 8, 1, 5, 9, 2, 6, 10)),
    )
    pose = next((found for words, numbers in poses if (found := _numbered(table, words, numbers))), [])
    wrench = next((found for words in _WRENCHES if (found := _numbered(table, words, range(6)))), [])
    if None in position and pose:
        position = pose[:3]
    if None in (*force, *moment) and wrench:
        force, moment = wrench[:3], wrench[3:]
    if force[2] is None and None not in force[:2]:
        force = force[:2]
    if moment[:2] == [None, None] and moment[2] is not None:
        moment = moment[2:]
    logged = {entry: _first(table, words) for entry, words in _WORDS.items()}
    columns = [f"{entry} = {_toml(name)}" for entry, name in logged.items() if name is not None]
    if re.search("actualtcpforce0$|ofexthatk0$", _bare(str(force[0]))):
        columns.append('wrench_in = "world"             # as the robot\'s manual says')
    angles, orientation = _found_orientation(table, pose[3:], left)
    vectors = dict(zip(_VECTORS, (position, force, moment), strict=True))
    for entry, found in vectors.items():
        if None in found:
            left.append(entry)
        named = [f"({entry} {axis})" if name is None else name for name, axis in zip(found, "xyz", strict=False)]
        columns.append(f"{entry} = {_toml(named)}")
        if entry == "position":
            columns.append(f"orientation = {orientation}")
    quantities = [
        ("time", [logged["time"]], _unit_of_time(table, logged["time"])),
        ("length", position, "m"),
        ("angle", angles, "rad" if "rotvec" in orientation else "deg"),
        ("force", force, "N"),
        ("moment", moment, "N m"),
    ]
    units = []
    for quantity, names, usual in quantities:
        known = [table.names.index(name) for name in names if name is not None]
        stated = [unit for column in known if (unit := stated_units(table, column).get(quantity, ("", None))[0])]
        if known and not stated:
            left.append(f"unit of {quantity}")
        guess = "" if stated else "   # a guess: check it"
        units.append(f"{quantity} = {_toml([*stated, usual][0])}{guess}")
    if not table.names:
        left.append("columns")
    entries = []
    if layout.decimal == ",":
        entries += ['decimal = ","', f"delimiter = {_toml(layout.delimiter)}"]
    if layout.units_row:
        entries.append("units_row = true              # the line below the names states the units")
    if layout.header not in (None, 1):
        number = f"header = {layout.header}"
        entries.append(f"{number}                    # line with the names of the columns; 0: there is none")
    entries = ["[table]", *entries, ""] if entries else []
    text = "\n".join([_HEAD, *entries, "[columns]", *columns, "", "[units]", *units, ""])
    return FirstMap(text + _rest("as the sensor's manual says"), (*left, "sensor", "rod"))


def _first(table: Table, pattern: str, parts: int = 2) -> str | None:
    """The first column whose name, without its unit, in small letters and digits, matches a pattern.

    Of names in parts, such as field.pose.position.x or /tool/pose/position/x, so many of the last parts will do, or more.
    """
    for name in (*table.names, *table.others):
        if re.fullmatch(pattern, _bare(name)):
            table.refuse_other(name)
            return name
    for name in (*table.names, *table.others):
        all_parts = re.split("[./]", name)
        if any(re.fullmatch(pattern, _bare(".".join(all_parts[k:]))) for k in range(1, len(all_parts) - parts + 1)):
            table.refuse_other(name)
            return name
    return None


def _bare(name: str) -> str:
    """A name without its unit, in small letters and digits."""
    return re.sub("[^a-z0-9]", "", without_unit(re.sub(r"\[(\d+)\]", r"_\1", name)).lower())


def _numbered(table: Table, pattern: str, numbers: Sequence[int]) -> list[str | None]:
    """The columns of a vector whose names match a pattern and end with numbers; none if one of them is missing."""
    found = [_first(table, f"(?:{pattern}){number}", parts=1) for number in numbers]
    return [] if None in found else found


def _vector(table: Table, words: str) -> list[str | None]:
    """The columns of x, y and z, or those numbered 0, 1 and 2, of names that are more than a number."""
    named = [_first(table, words + axis) for axis in "xyz"]
    return named if any(named) else _numbered(table, re.sub(r"\*$", "+", words), range(3)) or named


def _found_orientation(table: Table, turn: list[str | None], left: list[str]) -> tuple[list[str | None], str]:
    """The columns of angles, if there are any, and the entry of the map; `turn` are those of a pose's vector or matrix."""
    quaternion = [_first(table, _PREFIX["quaternion"] + axis) for axis in "wxyz"]
    if None not in quaternion:
        return [], f"{{quaternion = {_toml(quaternion)}}}"
    if quaternion := _numbered(table, _PREFIX["quaternion"], range(4)):
        left.append("order of the quaternion")
        return [], f'{{quaternion = {_toml(quaternion)}, order = "xyzw"}}  # a guess: check the order'
    for names, convention in _EULER:
        found = [_first(table, _PREFIX["position"] + name) for name in names]
        if names[0] == "rx" and None in found and len(turn) == 3:
            found = turn
        if None in found:
            continue
        if names[0] == "rx":
            return found, f"{{rotvec = {_toml(found)}}}              # or euler, with a convention"
        left.append("convention")
        return found, f'{{euler = {_toml(found)}, convention = "{convention}"}}  # a guess: check the convention'
    if len(turn) == 9:
        return [], f"{{matrix = {_toml(turn)}}}"
    left.append("orientation")
    return [], '{quaternion = ["(qw)", "(qx)", "(qy)", "(qz)"]}'


def _unit_of_time(table: Table, name: str | None) -> str:
    """The unit in which a time, also one since 1970, and the rows' distance have a plausible size."""
    values = table.columns[table.names.index(name)] if name is not None else np.empty(0)
    if values.dtype.kind != "f" or not np.isfinite(values).any():
        return "s"
    largest, step = np.nanmax(np.abs(values)), (np.nanmax(values) - np.nanmin(values)) / len(values)
    if largest > 1e17 or (step > 1e5 and largest < 1e14):
        return "ns"
    if largest > 1e14 or (step > 1e2 and largest < 1e11):
        return "us"
    return "ms" if largest > 1e11 else "s"


def _toml(value: object) -> str:
    return json.dumps(value, ensure_ascii=False)


_HEAD = """\
# What the columns of the table mean; see "Measurements" in the manual of scan3d.  Check every line.
# table_height_m = 0.0          # height z of the table, if the body stands on one
"""
_BAG = """
[ros]
# wrench = "/wrench"            # topic of geometry_msgs/WrenchStamped, if there are several
# pose = "/pose"                # topic of geometry_msgs/PoseStamped, or:
# tf = ["world", "clamp"]       # the frames of tf
"""


def _rest(signs: str) -> str:
    return f"""
[clamp]                         # the clamp's frame in the one whose pose is logged: y along the rod, sweeps along -x
position_mm = [0, 0, 0]
euler_deg = [0, 0, 0]           # "xyz", as all angles below

[sensor]                        # the sensor's frame in the clamp's, {signs}
position_mm = [0, 0, 0]
euler_deg = [0, 0, 0]
shows = "clamp-on-rod"          # or "rod-on-clamp"
# accuracy = 0.005              # standard deviation of the gains of its channels, for scan3d calibrate

[tare]
air = "auto"                    # or [[from_s, to_s], ...], or "none"

[filter]
# lowpass_hz = 50
# rate_hz = 100

[rod]                           # state the length, and the stiffness or diameter_m and modulus_Pa
length_m = 0.0
bending_stiffness_Nm2 = 0.0
diameter_m = 0.0
"""
