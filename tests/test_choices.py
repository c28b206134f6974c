"""Every list of allowed values stands in choices.py only, and settings, parser, help and completion use it."""

import argparse
import ast
from pathlib import Path

import pytest

from scan3d import Plan, choices, surfaces
from scan3d.choices import one_of
from scan3d.cli.completion import script
from scan3d.cli.parser import VALUES, parser
from scan3d.files import exports
from scan3d.settings import Settings
from scan3d.units import UNITS_M

ROOT = Path(__file__).parents[1]
LISTS = {name: values for name, values in vars(choices).items() if name.isupper()}
MODULES = sorted((ROOT / "scan3d").rglob("*.py"))
# Options that take one of the values, by command.
OPTIONS = [
    *(
        (command, name, values)
        for command in ("scan", "simulate")
        for name, values in VALUES.items()
        if name not in ("axis", "camera")
    ),
    ("reconstruct", "method", choices.METHODS),
    ("show", "view", choices.VIEWS),
    ("show", "color", choices.COLORS),
    ("show", "camera", choices.CAMERAS),
    ("show", "movie_of", choices.MOVIES),
    ("export", "what", choices.EXPORTS),
    ("completion", "shell", choices.SHELLS),
]


def copies(source: str) -> list[str]:
    """The names of the lists of choices.py that the source contains as a tuple, a list or a set of strings."""
    names = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Tuple | ast.List | ast.Set):
            strings = [getattr(element, "value", None) for element in node.elts]
            # two names in another order may be something else: a picture of the cloud, and one of the surface
            names += [
                name
                for name, values in LISTS.items()
                if tuple(strings) == values or (len(values) > 2 and set(map(str, strings)) == set(values))
            ]
    return names


def action(command: str, option: str) -> argparse.Action:
    commands = next(action for action in parser()._actions if action.choices).choices
    return next(action for action in commands[command]._actions if action.dest == option)


def test_copies_are_found() -> None:
    # in a source made for it, so that the next test can fail
    assert copies("SPACINGS = ['adaptive', 'cosine', 'uniform']") == ["SPACINGS"]
    assert copies("for view in ('surface', 'cloud'): pass") == ["EXPORTS"]
    assert copies("for view in ('cloud', 'surface'): pass") == []
    assert sorted(copies((ROOT / "scan3d" / "choices.py").read_text(encoding="utf-8"))) == sorted(LISTS)


@pytest.mark.parametrize(
    "module", [path for path in MODULES if path.name != "choices.py"], ids=lambda path: str(path.relative_to(ROOT))
)
def test_no_other_module_has_a_copy_of_a_list(module: Path) -> None:
    assert copies(module.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    ("command", "option", "values"), OPTIONS, ids=lambda value: value if type(value) is str else ""
)
def test_the_help_lists_exactly_the_values(command: str, option: str, values: tuple[str, ...]) -> None:
    text = action(command, option).help or ""
    listed = one_of(values)
    assert listed in text
    # nothing before the list, and nothing after it, continues it
    before, _, after = text.partition(listed)
    assert before == "" or before.endswith(": ")
    assert after == "" or after[0] in ";:," or after.startswith(" (default ")
    assert one_of(("a", "b", "c")) == "a, b or c"


def test_parser_and_completion_take_the_lists() -> None:
    for command, option, values in OPTIONS:
        allowed = action(command, option).choices or VALUES[option]
        assert tuple(allowed) == values
    assert VALUES["spacing"] is choices.SPACINGS
    assert VALUES["method"] is choices.METHODS
    for shell in choices.SHELLS:
        for name, values in ((name, LISTS[name]) for name in LISTS if name != "STANDOFFS"):
            assert " ".join(values) in script(parser(), shell, VALUES), name


def test_settings_and_plan_accept_exactly_the_lists() -> None:
    accepted = {
        "method": (choices.METHODS, lambda value: Settings(method=value)),
        "spacing": (choices.SPACINGS, lambda value: Plan(spacing=value)),
        "unit": (tuple(UNITS_M), lambda value: Plan(unit=value)),
    }
    for name, (values, make) in accepted.items():
        for value in values:
            make(value)
        with pytest.raises(ValueError, match=f"{name} must be one of {', '.join(values)}, got 'magic'"):
            make("magic")


def test_other_packages_hand_on_the_same_lists() -> None:
    assert surfaces.METHODS is choices.METHODS
    assert tuple(exports._ENDINGS) == choices.EXPORTS
