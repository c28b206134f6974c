"""Settings of a scan, as text and numbers: those of the commands, of `scan3d.scan` and of `scan3d.batch`.

Settings from a TOML file take precedence over the defaults, and those of the command line over the file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scan3d.choices import METHODS, Method, Model, Spacing
from scan3d.errors import InputError
from scan3d.files.reading import dent_size, did_you_mean, read_toml, to_float
from scan3d.rods import parse_rod
from scan3d.units import Unit

if TYPE_CHECKING:
    from scan3d.planning.plan import Plan

SLICES_FOR_TOLERANCE = 1024
"""Slices along each axis at most, where a tolerance is given and their number is not."""
# The types of settings as error messages name them.
_KINDS = {int: "a whole number", float: "a number", bool: "true or false", str: "text"}


class UsageError(InputError):
    """A setting with a value that can't be used.  The command line exits with 2, as for an option that it does not know."""


@dataclass(frozen=True)
class Settings:
    """The settings of `scan3d scan`, in the types that a TOML file has."""

    model: Model = "planar"
    slices: int = 64
    spacing: Spacing = "adaptive"
    axis: str = "z"
    sweeps: str = "auto"
    samples: int = 64
    friction: str = "0.3"
    rod: str = "auto"
    clearance: float = 0.3
    tolerance: float = 0.0
    noise: float = 0.0
    seed: int = 0
    unit: Unit = "mm"
    method: Method = "auto"
    hull: bool = False
    clip_dent: str = "0"

    def __post_init__(self) -> None:
        dent_size(self.clip_dent)
        if self.method not in METHODS:
            raise InputError(f"method must be one of {', '.join(METHODS)}, got {self.method!r}")

    def plan(self) -> Plan:
        """The plan that the settings describe.  Raises InputError that names the invalid setting."""
        # imported here because `scan3d --help` needs the defaults only, and numpy would make it slow
        from scan3d.planning.plan import Plan

        return Plan(
            model=self.model,
            slices=self.slices,
            spacing=self.spacing,
            axis=_axis(self.axis),
            sweeps=None if self.sweeps == "auto" else _integer("sweeps", self.sweeps),
            samples=self.samples,
            friction=_friction(self.friction),
            clearance=self.clearance,
            tolerance=self.tolerance,
            rod=parse_rod(self.rod),
            noise=self.noise,
            seed=self.seed,
            unit=self.unit,
        )


def settings(given: Mapping[str, Any], config: str | Path | None = None, source: str = "the command line") -> Settings:
    """The defaults, replaced by the settings of the file `config` and then by those in `given`.

    `source` is where those were given, for messages.

    Raises InputError for a file that cannot be read, for unknown settings and for values of the wrong type or out of range;
    UsageError if the file is not at fault.
    """
    file = {} if config is None else _read(config)
    try:
        chosen = _merged((str(config), file), (source, given))
        chosen.plan()
    except InputError as error:
        if config is not None:
            _merged((str(config), file)).plan()
        raise UsageError(str(error)) from None
    return chosen


def varied_settings(
    given: Mapping[str, Any],
    grid: Sequence[Mapping[str, Any]],
    config: str | Path | None = None,
    source: str = "the command line",
    grid_source: str = "the grid",
) -> list[Settings]:
    """The settings of each combination of a grid, which take precedence over those in `given` and in the file `config`.

    Raises InputError as `settings`, and for values of the grid; UsageError for a setting that is given and in the grid.
    """
    file = {} if config is None else _read(config)
    _merged((str(config), file))
    try:
        _merged((source, given))
    except InputError as error:
        raise UsageError(str(error)) from None
    found = []
    for values in grid:
        twice = sorted(given.keys() & values.keys())
        if twice:
            raise UsageError(f"{twice[0]} is given by {source} and by {grid_source}; leave one of them out")
        chosen = _merged((str(config), file), (source, given), (grid_source, values))
        try:
            chosen.plan()
        except InputError as error:
            named = ", ".join(f"{name} = {value!r}" for name, value in values.items())
            raise InputError(f"{grid_source}, {named}: {error}") from None
        found.append(chosen)
    return found


def _merged(*layers: tuple[str, Mapping[str, Any]]) -> Settings:
    """The defaults, replaced by the settings of each layer, which is a pair of its source and its values by name."""
    merged: Settings = Settings()
    known = {field.name: type(field.default) for field in fields(Settings)}
    for source, values in layers:
        unknown = sorted(set(values) - set(known))
        if unknown:
            raise InputError(
                f"{source}: unknown setting {', '.join(unknown)}; known are {', '.join(known)}{did_you_mean(unknown, known)}"
            )
        merged = replace(merged, **{name: _typed(source, name, values[name], known[name]) for name in values})
    if merged.tolerance > 0 and not any("slices" in values for _, values in layers):
        return replace(merged, slices=SLICES_FOR_TOLERANCE)
    return merged


def _read(path: str | Path) -> dict[str, Any]:
    try:
        return read_toml(path)
    except OSError as error:
        raise InputError(f"can't read the settings {path}: {error.strerror or error}") from None
    except ValueError as error:
        raise InputError(f"{path} is not a TOML file of settings: {error}") from None


def _typed(source: str, name: str, value: Any, kind: type) -> Any:
    """A value of a file or a program in the type of the setting; a list becomes text as on the command line."""
    if hasattr(value, "tolist"):  # a number or an array of numpy
        value = value.tolist()
    if kind is str and isinstance(value, (list, tuple)):
        value = (":" if name == "friction" else ",").join(str(item) for item in value)
    if kind is str and isinstance(value, (int, float)) and not isinstance(value, bool):
        value = str(value)
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        value = to_float(value)
    if type(value) is not kind:
        raise InputError(f"{source}: {name} must be {_KINDS[kind]}, got {value!r}")
    return value


def _friction(text: str) -> float | tuple[float, float]:
    try:
        numbers = [float(part) for part in text.split(":")]
    except ValueError:
        numbers = []
    if len(numbers) == 1:
        return numbers[0]
    if len(numbers) == 2:
        return numbers[0], numbers[1]
    raise InputError(f"friction must be a number, such as 0.3, or a range LOW:HIGH, such as 0.0:0.4; got {text!r}")


def _axis(text: str) -> str | tuple[float, ...]:
    if "," not in text:
        return text
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"axis must be x, y, z or three numbers, such as 1,1,0; got {text!r}") from None


def _integer(name: str, text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise InputError(f"{name} must be 'auto' or a whole number, got {text!r}") from None
