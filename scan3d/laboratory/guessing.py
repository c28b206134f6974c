"""A first map of a table, from the names in its header and the sizes of its numbers.

What can't be found is written as a text in parentheses, which no column has, so that the map is refused until it is completed.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scan3d.arrays import Array
from scan3d.errors import InputError
from scan3d.laboratory.bags import is_bag
from scan3d.laboratory.layouts import sniffed
from scan3d.laboratory.maps import Layout
from scan3d.laboratory.quantities import FACTORS, stated_unit, unit_of_cell
from scan3d.laboratory.tables import RawTable, first_lines, read_table

# Names of columns without units, capital letters, underscores and the like, as laboratories and robots use them.
_WORDS = {
    "time": r"t|time|timestamp|times|stamp|zeit|elapsed|elapsedtime|timesec|clock",
    "sweep": r"sweep|sweepnumber|sweepno|scan|stroke|line",
    "move": r"move|motion|phase|segment|state",
}
_PREFIX = {
    "position": r"(?:tcp|pos|position|pose|p|clamp|ee|tool|flange|actual|cart|translation|poseposition|actualtcppose)*",
    "force": r"(?:ft|sensor|wrench|tcp|wrenchforce|ati|actual)*(?:f|force|kraft)",
    "moment": r"(?:ft|sensor|wrench|tcp|wrenchtorque|ati|actual)*(?:t|m|torque|moment|tau|mz)",
    "quaternion": r"(?:tcp|pose|ori|orientation|rot|rotation|poseorientation|ee|tool)*(?:q|quat|quaternion|o|orientation)",
}
_EULER = ((("roll", "pitch", "yaw"), "xyz"), (("a", "b", "c"), "ZYX"), (("rx", "ry", "rz"), "xyz"))
"""Names of angles, and the convention that goes with them: A, B and C are those of KUKA."""
# Angles beyond this can't be radians, positions whose range is beyond this can't be metres.
_LARGEST_RAD, _LARGEST_M = 2 * math.pi + 0.01, 3.0


@dataclass(frozen=True)
class Guess:
    """A first map: its text, and what it leaves open."""

    text: str
    open: tuple[str, ...]


def guess_map(path: str | Path) -> Guess:
    """A first map of a table or a ROS bag.  Raises InputError if it can't be read."""
    path = Path(path)
    if is_bag(path):
        return Guess(_HEAD + _BAG + _rest("as it is in a bag"), ("sensor", "rod"))
    layout = Layout()
    if path.suffix.lower() not in (".parquet", ".pq"):
        try:
            data = path.read_bytes()
        except OSError as error:
            raise InputError(f"can't read the table {path}: {error.strerror or error}") from None
        layout = sniffed(first_lines(data), layout).layout
    return _Guesser(read_table(path, layout), layout).guess()


def bare(name: str) -> str:
    """A column's name without its unit, in small letters and digits."""
    text = re.sub(r"[\[(].*?[\])]", "", name)
    stated = stated_unit(text)
    if stated is not None:
        text = re.sub(r"(_[A-Za-zµμ]+|\bin [\wµμ°·. ]+)$", "", text)
    return re.sub(r"[^a-z0-9]", "", text.lower())


class _Guesser:
    """Finds columns by their names."""

    def __init__(self, table: RawTable, layout: Layout) -> None:
        self.table, self.layout = table, layout
        self.bare = [bare(name) for name in table.names]
        self.open: list[str] = []

    def guess(self) -> Guess:
        lines = [_HEAD, *self._layout(), "[columns]", *self._columns(), "", "[units]", *self._units(), ""]
        if not self.table.names:
            self.open.append("columns")
        return Guess("\n".join(lines) + _rest("as the sensor's manual says"), (*self.open, "sensor", "rod"))

    def _layout(self) -> list[str]:
        layout, lines = self.layout, []
        if layout.decimal == ",":
            lines.append('decimal = ","')
            lines.append(f"delimiter = {_toml(layout.delimiter)}")
        if layout.units_row:
            lines.append("units_row = true              # the line below the names states the units")
        if layout.header is not None and layout.header != 1:
            lines.append(
                f"header = {layout.header}                    # line with the names of the columns; 0: there is none"
            )
        return ["[table]", *lines, ""] if lines else []

    def _columns(self) -> list[str]:
        lines = []
        for entry in ("time", "sweep", "move"):
            found = self._first(_WORDS[entry])
            if found is not None:
                lines.append(f"{entry} = {_toml(found)}")
        self.position = self._vector("position", "xyz")
        orientation, text = self._orientation()
        self.angles = orientation
        self.force, self.moment = self._vector("force", "xyz"), self._vector("moment", "xyz")
        planar = [self._one("moment", "z")]
        if None in self.force and self.force[2] is None and None not in self.force[:2]:
            self.force = self.force[:2]
        if None in self.moment and planar[0] is not None:
            self.moment = planar
        lines.append(f"position = {self._listed('position', self.position, 'xyz')}")
        lines.append(f"orientation = {text}")
        lines.append(f"force = {self._listed('force', self.force, 'xyz')}")
        lines.append(f"moment = {self._listed('moment', self.moment, 'xyz')}")
        return lines

    def _first(self, pattern: str) -> str | None:
        return next(
            (name for name, key in zip(self.table.names, self.bare, strict=True) if re.fullmatch(pattern, key)), None
        )

    def _one(self, entry: str, axis: str) -> str | None:
        return self._first(_PREFIX[entry] + axis)

    def _vector(self, entry: str, axes: str) -> list[str | None]:
        return [self._one(entry, axis) for axis in axes]

    def _orientation(self) -> tuple[list[str | None], str]:
        quaternion = self._vector("quaternion", "wxyz")
        if None not in quaternion:
            return [], f"{{quaternion = {_toml(quaternion)}}}"
        for names, convention in _EULER:
            found = [self._first(_PREFIX["position"] + name) for name in names]
            if None not in found:
                if names[0] == "rx" and self._largest(found) <= _LARGEST_RAD:
                    return found, f"{{rotvec = {_toml(found)}}}              # or euler, with a convention"
                self.open.append("convention")
                return (
                    found,
                    f'{{euler = {_toml(found)}, convention = "{convention}"}}  # a guess: check the convention',
                )
        self.open.append("orientation")
        return [], '{quaternion = ["(qw)", "(qx)", "(qy)", "(qz)"]}'

    def _listed(self, entry: str, found: Sequence[str | None], axes: str) -> str:
        if None in found:
            self.open.append(entry)
        return _toml([f"({entry} {axis})" if name is None else name for name, axis in zip(found, axes, strict=False)])

    def _units(self) -> list[str]:
        columns = {
            "time": [self._first(_WORDS["time"])], "length": self.position, "angle": self.angles, "force": self.force,
            "moment": self.moment,
        }  # fmt: skip
        usual = {
            "time": "s",
            "length": "mm" if self._range(self.position) > _LARGEST_M else "m",
            "angle": "deg" if self._largest(self.angles) > _LARGEST_RAD else "rad",
            "force": "N",
            "moment": "N m",
        }
        lines = []
        for quantity, names in columns.items():
            stated = next((unit for name in names if (unit := self._stated(name, quantity))), None)
            comment = "" if stated else "   # a guess: check it"
            if not stated and any(names):
                self.open.append(f"unit of {quantity}")
            lines.append(f"{quantity} = {_toml(stated or usual[quantity])}{comment}")
        return lines

    def _stated(self, name: str | None, quantity: str) -> str | None:
        """The unit of a quantity that the header or the row of units states for a column."""
        if name is None:
            return None
        k = self.table.names.index(name)
        cells = [unit_of_cell(self.table.units[k])] if k < len(self.table.units) else []
        found = [*cells, stated_unit(name)]
        return next((unit[1] for unit in found if unit is not None and unit[1] in FACTORS[quantity]), None)

    def _values(self, names: Sequence[str | None]) -> list[Array]:
        columns = [self.table.names.index(name) for name in names if name is not None]
        return [v for v in (self.table.columns[k] for k in columns) if v.dtype.kind == "f" and np.isfinite(v).any()]

    def _range(self, names: Sequence[str | None]) -> float:
        return max((float(np.nanmax(v) - np.nanmin(v)) for v in self._values(names)), default=0.0)

    def _largest(self, names: Sequence[str | None]) -> float:
        return max((float(np.nanmax(np.abs(v))) for v in self._values(names)), default=0.0)


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
