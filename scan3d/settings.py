"""Settings of a scan: those of the commands, of `scan3d.scan` and `scan3d.batch`, and of files in TOML.

`Settings` is their one source: the options of the commands, the signatures in Python and the keys of a file are made of its
fields.  Settings from a file take precedence over the defaults, and those of the command line over the file.
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any, Literal, TypedDict, TypeVar, get_args, get_origin, get_type_hints

from scan3d.choices import METHODS, Method, Model, Probing, Spacing, one_of
from scan3d.errors import InputError, UsageError
from scan3d.files.text import did_you_mean, parse_rod, read_section, rod_text, to_float
from scan3d.rods import Rod
from scan3d.units import Unit

if TYPE_CHECKING:
    from scan3d.planning.plan import Plan

SLICES_FOR_TOLERANCE = 1024
"""Slices along each axis at most, where a tolerance is given and their number is not."""
_Function = TypeVar("_Function", bound=Callable[..., Any])


def _setting(default: Any, meaning: str) -> Any:
    return field(default=default, metadata={"meaning": meaning})


@dataclass(frozen=True)
class Settings:
    """The settings of a scan, in the types that a TOML file has; the metadata of each field say what it means."""

    model: Model = _setting("planar", "model of contact; a round rod in space leaves the plane of its sweep")
    slices: int = _setting(
        64,
        "number of slices; adaptive spacing takes fewer where more would not lower the bound; in the spatial model "
        "0.4 times as many sweeps from each of 12 directions",
    )
    spacing: Spacing = _setting(
        "adaptive", "heights of the slices: adaptive where the bound is widest, cosine dense at the ends"
    )
    axis: str = _setting(
        "z",
        "normal of the slices: x, y, z, several such as xyz, a vector such as 1,1,0, or free: in any plane, by facets",
    )
    sweeps: str = _setting(
        "auto", "sweeps per slice, or in the spatial model per direction, or auto: as many as the body needs"
    )
    samples: int = _setting(64, "samples per sweep")
    friction: str = _setting(
        "0.3", "coefficient of friction, or a range such as 0.0:0.4 from which every sample draws its own"
    )
    rod: str = _setting(
        "auto",
        "MATERIAL:DIAMETERxLENGTH in mm, such as steel:0.3x50; any rod as a table, like [rod] of a recording; or auto: a "
        "length that fits the body",
    )
    bead: float = _setting(
        0.0,
        "diameter, in the mesh's unit, of a ball on the rod's tip, with which the body is probed in the spatial model: "
        "where it has passed no part of a body of any shape is; 0: none",
    )
    clearance: float = _setting(0.3, "distance of the base line from the slice, in rod lengths")
    tolerance: float = _setting(
        0.0,
        "certified bound at which adaptive spacing stops, relative to the diagonal; as many slices and samples as it "
        "takes",
    )
    probing: Probing = _setting(
        "auto",
        "also move the rod along itself until it touches: auto on bodies that are not convex, after an eighth of the "
        "slices, in at most three times as many planes; off; or only",
    )
    known: float = _setting(0.0, "share of the surface with a contact nearby at which probing ends; 0: nothing is left")
    stop_force: str = _setting("auto", "force that ends a probing, in EI/L² such as 0.01, or with a unit such as 2mN")
    noise: float = _setting(0.0, "standard deviation of force and moment, in EI/L² and EI/L")
    seed: int = _setting(0, "seed of the random numbers; the same seed gives the same files")
    unit: Unit = _setting("mm", "unit of the mesh's coordinates")
    method: Method = _setting(
        "auto", "surface from the contacts; bracket estimates it between the certified bounds, auto chooses"
    )
    reach: float = _setting(
        0.0,
        "radius, in the mesh's unit, of the finest feature of a body that is not convex, its gaps, edges and grooves "
        "included, which bounds it from both sides; 0: not known",
    )
    hull: bool = _setting(False, "scan the convex hull of a body that is not convex")

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise InputError(f"method must be one of {', '.join(METHODS)}, got {self.method!r}")
        if not 0 <= self.reach < float("inf"):
            raise InputError(f"reach must be a radius >= 0, got {self.reach}")

    def plan(self) -> Plan:
        """The plan that the settings describe.  Raises InputError that names the invalid setting."""
        # imported here because `scan3d --help` needs the defaults only, and numpy would make it slow
        from scan3d.planning.plan import Plan

        if self.method == "regression" and not self.noise:
            raise InputError(
                "the method regression weights the contacts by the noise of force and moment; state --noise, or use auto, "
                "bracket or hull"
            )
        read = {"axis": _axis(self.axis), "sweeps": _sweeps(self.sweeps), "friction": _friction(self.friction)}
        same = {one.name: getattr(self, one.name) for one in fields(Plan) if hasattr(self, one.name)}
        return Plan(**same | read | {"rod": parse_rod(self.rod)})


class Given(TypedDict, total=False):
    """Settings as a program in Python may give them, by name; what is left out has its default."""

    model: Model
    slices: int
    spacing: Spacing
    axis: str | Sequence[float]
    sweeps: int | Literal["auto"]
    samples: int
    friction: float | str | tuple[float, float]
    rod: str | Rod
    bead: float
    clearance: float
    tolerance: float
    probing: Probing
    known: float
    stop_force: float | str
    noise: float
    seed: int
    unit: Unit
    method: Method
    reach: float
    hull: bool


def shows_settings(function: _Function) -> _Function:
    """The function, whose keywords ``**settings`` stand one by one in its signature and at the end of its docstring.

    `help` and completion show them with their choices or types, their defaults and what they mean.
    """
    shown = inspect.signature(function)
    types = {name: str(given.__forward_arg__) for name, given in Given.__annotations__.items()}
    kind = inspect.Parameter.KEYWORD_ONLY
    keywords = [
        inspect.Parameter(one.name, kind, default=one.default, annotation=types[one.name]) for one in fields(Settings)
    ]
    others = [parameter for parameter in shown.parameters.values() if parameter.name != "settings"]
    function.__signature__ = shown.replace(parameters=[*others, *keywords])  # type: ignore[attr-defined]
    hints = get_type_hints(Settings).items()
    choices = {name: f": {one_of(get_args(type))}" for name, type in hints if get_origin(type) is Literal}
    meanings = "\n".join(
        f"    {one.name}{choices.get(one.name, '')} (default {one.default})\n        {one.metadata['meaning']}"
        for one in fields(Settings)
    )
    function.__doc__ = f"{inspect.cleandoc(function.__doc__ or '')}\n\nSettings:\n\n{inspect.cleandoc(meanings)}\n"
    return function


def settings(
    given: Mapping[str, Any], config: str | os.PathLike[str] | None = None, source: str = "the command line"
) -> Settings:
    """The defaults, replaced by the settings of the file `config` and then by those in `given`.

    `source` is where those were given, for messages.

    Raises InputError for a file that cannot be read, for unknown settings and for values of the wrong type or out of range;
    UsageError if the file is not at fault.
    """
    return varied_settings(given, [{}], config, source)[0]


def varied_settings(
    given: Mapping[str, Any],
    grid: Sequence[Mapping[str, Any]],
    config: str | os.PathLike[str] | None = None,
    source: str = "the command line",
    grid_source: str = "the grid",
) -> list[Settings]:
    """The settings of each combination of a grid, which take precedence over those in `given` and in the file `config`.

    Raises InputError as `settings`, and for values of the grid; UsageError for a setting that is given and in the grid.
    """
    file = (str(config), {} if config is None else read_section(config, "settings", name=str(config)).data)
    _merged(file)
    try:
        _merged((source, given))
    except InputError as error:
        raise UsageError(str(error)) from None
    found = []
    for values in grid:
        twice = sorted(given.keys() & values.keys())
        if twice:
            raise UsageError(f"{twice[0]} is in {grid_source}, and is given beside it as well; leave one of them out")
        chosen = _merged(file, (source, given), (grid_source, values))
        try:
            chosen.plan()
        except InputError as error:
            _merged(file).plan()  # raises if the file is at fault by itself
            if not values:
                raise UsageError(str(error)) from None
            named = ", ".join(f"{name} = {value!r}" for name, value in values.items())
            raise InputError(f"{grid_source}, {named}: {error}") from None
        found.append(chosen)
    return found


def _merged(*layers: tuple[str, Mapping[str, Any]]) -> Settings:
    """The defaults, replaced by the settings of each layer, which is a pair of its source and its values by name."""
    merged = Settings()
    known = {one.name: type(one.default) for one in fields(Settings)}
    for source, values in layers:
        unknown = sorted(set(values) - set(known))
        if unknown:
            raise InputError(
                f"{source}: unknown setting {', '.join(unknown)}; known are "
                f"{', '.join(known)}{did_you_mean(unknown, known)}"
            )
        merged = replace(merged, **{name: _typed(source, name, values[name], known[name]) for name in values})
    if merged.tolerance > 0 and not any("slices" in values for _, values in layers):
        return replace(merged, slices=SLICES_FOR_TOLERANCE)
    return merged


def _typed(source: str, name: str, value: Any, kind: type) -> Any:
    """A value of a file or a program in the type of the setting; a list becomes text as on the command line."""
    if hasattr(value, "tolist"):  # a number or an array of numpy
        value = value.tolist()
    if name == "rod" and isinstance(value, (Rod, Mapping)):
        value = rod_text(value)
    if kind is str and isinstance(value, (list, tuple)):
        value = (":" if name == "friction" else ",").join(str(item) for item in value)
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if kind is str and is_number:
        value = str(value)
    if kind is float and is_number:
        value = to_float(value)
    if type(value) is not kind:
        expected = {int: "a whole number", float: "a number", bool: "true or false", str: "text"}[kind]
        raise InputError(f"{source}: {name} must be {expected}, got {value!r}")
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


def _sweeps(text: str) -> int | None:
    try:
        return None if text == "auto" else int(text)
    except ValueError:
        raise InputError(f"sweeps must be 'auto' or a whole number, got {text!r}") from None
