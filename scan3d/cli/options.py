"""Options that several commands share.  No numerical library is imported here, so that ``scan3d --help`` is quick."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, make_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

from cyclopts import Group, Parameter, Token

from scan3d.settings import Settings, settings


def _whole(_: Any, tokens: Sequence[Token]) -> int:
    """A whole number: cyclopts would take 4.5 as 4."""
    try:
        return int(tokens[0].value)
    except ValueError:
        raise ValueError(f"expected a whole number, got {tokens[0].value!r}") from None


File = Annotated[Path, Parameter(metavar="FILE")]
Folder = Annotated[Path, Parameter(metavar="DIR")]
Mesh = Annotated[Path, Parameter(metavar="MESH")]
Rig = Annotated[Path | None, Parameter(metavar="RIG")]
Number = Annotated[int, Parameter(metavar="N", converter=_whole)]
Body = Annotated[str, Parameter(metavar="BODY")]
Overwrite = Annotated[
    bool, Parameter(help="replace also files that scan3d did not write, or that were changed since", show_default=False)
]
Strict = Annotated[
    bool,
    Parameter(help="exit with 1 if the recording contradicts the model (results are written)", show_default=False),
]
Flag = Annotated[bool, Parameter(show_default=False)]


@Parameter(name="*")
@dataclass(frozen=True)
class Output:
    """How a command prints its result."""

    json: Annotated[bool, Parameter(help="print the result as JSON", show_default=False)] = False
    quiet: Annotated[bool, Parameter(help="print no progress and no summary", show_default=False)] = False
    progress: Annotated[Any, Parameter(parse=False)] = None


@dataclass(frozen=True)
class _Chosen:
    """The settings of a scan as the command line and a file give them."""

    config: Annotated[File | None, Parameter(help="settings from a TOML file")] = None
    print_config: Annotated[Flag, Parameter(help="print the resulting settings as such a file, and exit")] = False

    def given(self) -> dict[str, Any]:
        """Those of the command line."""
        values = {one.name: getattr(self, one.name) for one in fields(Settings)}
        return {name: value for name, value in values.items() if value is not None and value is not False}

    def chosen(self) -> Settings:
        """All settings.  Raises InputError as `scan3d.settings.settings`."""
        return settings(self.given(), self.config)


def _options() -> Any:
    """A class with an option for each field of `Settings`, None or False where it is not given."""
    kinds = get_type_hints(Settings)
    made: list[tuple[str, Any, Any]] = []
    for one in fields(Settings):
        shown: Any = False if one.default is False else lambda _, default=one.default: default
        parameter = Parameter(
            help=one.metadata["meaning"], show_default=shown, allow_leading_hyphen=kinds[one.name] is str
        )
        kind = Number if kinds[one.name] is int else kinds[one.name]
        if kind is bool:
            made.append((one.name, Annotated[bool, parameter], False))
        else:
            made.append((one.name, Annotated[kind | None, parameter], field(default=None)))
    group = Group("Settings", help="The command line takes precedence over --config, and --config over the defaults.")
    return Parameter(name="*", group=group)(
        make_dataclass("Options", made, bases=(_Chosen,), namespace={"__module__": __name__}, frozen=True)
    )


if TYPE_CHECKING:
    Options = _Chosen
else:
    Options = _options()
