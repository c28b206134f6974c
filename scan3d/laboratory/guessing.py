"""A first map of a table, from the names in its header and the sizes of its numbers.

What can't be found is written as a text in parentheses, which no column has, so that the map is refused until it is completed.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from scan3d.files.tables import Layout, Table, guessed_layout, read_table
from scan3d.laboratory.bags import bag_files, is_bag
from scan3d.laboratory.logs import stated_units
from scan3d.units import without_unit

# Names of columns without units, capital letters, underscores and the like, as laboratories and robots use them.
_WORDS = {
    "time": r"t|time|timestamp|times|stamp|headerstamp|rosbagtimestamp|zeit|elapsed|elapsedtime|timesec|clock",
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
# Vectors of numbered columns.  A pose is a position and a rotation vector, as of Universal Robots, or Franka's matrix by
# columns, whose last one is the position.  Franka's wrench in the frame K of the tool comes before that in the base's.
_POSES = (
    (r"(?:actual|tcp|ee|tool|pose)+", range(6)),
    (r"(?:target|tcp|pose)+", range(6)),
    (r"otee", (12, 13, 14, 0, 4, 8, 1, 5, 9, 2, 6, 10)),
)
_WRENCHES = (r"kfexthatk", r"(?:actual|raw|tcp|ft|ati|sensor|o)*(?:f|ft|force|wrench|forcetorque|fexthatk)")
# Wrenches in the frame of the base, by their first force.
_OF_BASE = "actualtcpforce0$|ofexthatk0$"
_EULER = ((("roll", "pitch", "yaw"), "xyz"), (("a", "b", "c"), "ZYX"), (("rx", "ry", "rz"), "xyz"))
"""Names of angles, and the convention that goes with them: A, B and C are those of KUKA."""


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
    position, force, moment = ([_first(table, _PREFIX[entry] + axis) for axis in "xyz"] for entry in _VECTORS)
    pose = next((found for words, numbers in _POSES if (found := _numbered(table, words, numbers))), [])
    wrench = next((found for words in _WRENCHES if (found := _numbered(table, words, range(6)))), [])
    if None in position and pose:
        position = pose[:3]
    if None in (*force, *moment) and wrench:
        force, moment = wrench[:3], wrench[3:]
    if force[2] is None and None not in force[:2]:
        force = force[:2]
    if None in moment and moment[2] is not None:
        moment = moment[2:]
    columns = [
        f"{entry} = {_toml(name)}" for entry, words in _WORDS.items() if (name := _first(table, words)) is not None
    ]
    if re.search(_OF_BASE, _bare(str(force[0]))):
        columns.append('wrench_in = "world"             # as the robot\'s manual says')
    angles, orientation = _orientation(table, pose[3:], left)
    vectors = dict(zip(_VECTORS, (position, force, moment), strict=True))
    for entry, found in vectors.items():
        if None in found:
            left.append(entry)
        named = [f"({entry} {axis})" if name is None else name for name, axis in zip(found, "xyz", strict=False)]
        columns.append(f"{entry} = {_toml(named)}")
        if entry == "position":
            columns.append(f"orientation = {orientation}")
    time = [_first(table, _WORDS["time"])]
    angle = ("angle", angles, "rad" if "rotvec" in orientation else "deg")
    quantities = [
        ("time", time, _unit_of_time(table, time[0])),
        ("length", position, "m"),
        angle,
        ("force", force, "N"),
        ("moment", moment, "N m"),
    ]
    units = [_unit(table, *quantity, left) for quantity in quantities]
    if not table.names:
        left.append("columns")
    text = "\n".join([_HEAD, *_layout(layout), "[columns]", *columns, "", "[units]", *units, ""])
    return FirstMap(text + _rest("as the sensor's manual says"), (*left, "sensor", "rod"))


def _first(table: Table, pattern: str, parts: int = 2) -> str | None:
    """The first column whose name, without its unit, in small letters and digits, matches a pattern.

    Of names in parts, such as field.pose.position.x or /tool/pose/position/x, so many of the last parts will do, or more.
    """
    for name in table.names:
        if re.fullmatch(pattern, _bare(name)):
            return name
    for name in table.names:
        all_parts = re.split("[./]", name)
        if any(re.fullmatch(pattern, _bare(".".join(all_parts[k:]))) for k in range(1, len(all_parts) - parts + 1)):
            return name
    return None


def _bare(name: str) -> str:
    """A name without its unit, in small letters and digits."""
    return re.sub("[^a-z0-9]", "", without_unit(re.sub(r"\[(\d+)\]", r"_\1", name)).lower())


def _numbered(table: Table, pattern: str, numbers: Sequence[int]) -> list[str | None]:
    """The columns of a vector whose names match a pattern and end with numbers; none if one of them is missing."""
    found = [_first(table, f"(?:{pattern}){number}", parts=1) for number in numbers]
    return [] if None in found else found


def _layout(layout: Layout) -> list[str]:
    lines = []
    if layout.decimal == ",":
        lines += ['decimal = ","', f"delimiter = {_toml(layout.delimiter)}"]
    if layout.units_row:
        lines.append("units_row = true              # the line below the names states the units")
    if layout.header not in (None, 1):
        lines.append(
            f"header = {layout.header}                    # line with the names of the columns; 0: there is none"
        )
    return ["[table]", *lines, ""] if lines else []


def _orientation(table: Table, turn: list[str | None], left: list[str]) -> tuple[list[str | None], str]:
    """The columns of angles, if there are any, and the entry of the map; `turn` are those of a pose's vector or matrix."""
    quaternion = [_first(table, _PREFIX["quaternion"] + axis) for axis in "wxyz"]
    if None not in quaternion:
        return [], f"{{quaternion = {_toml(quaternion)}}}"
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


def _unit(table: Table, quantity: str, names: Sequence[str | None], usual: str, left: list[str]) -> str:
    """The unit that the header or the row of units states for one of the columns, or the usual one."""
    columns = [table.names.index(name) for name in names if name is not None]
    stated = [unit for column in columns if (unit := stated_units(table, column).get(quantity, ("", None))[0])]
    if columns and not stated:
        left.append(f"unit of {quantity}")
    return f"{quantity} = {_toml(stated[0])}" if stated else f"{quantity} = {_toml(usual)}   # a guess: check it"


def _toml(value: object) -> str:
    return json.dumps(value, ensure_ascii=False)


_HEAD = """\
# What the columns of the table mean; see "Import" in the manual of scan3d.  Check every line.
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
