"""Every list of allowed values stands in choices.py only, and settings, options and completion use it."""

import ast
from pathlib import Path

import pytest

from scan3d import Plan, choices, surfaces
from scan3d.files import formats
from scan3d.settings import Settings
from scan3d.units import UNITS_M

ROOT = Path(__file__).parents[1]
LISTS = {name: values for name, values in vars(choices).items() if name.isupper()}


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


@pytest.mark.slow
def test_no_other_module_has_a_copy_of_a_list() -> None:
    # in a source made for it, so that the test can fail
    assert copies("SPACINGS = ['adaptive', 'cosine', 'uniform']") == ["SPACINGS"]
    assert copies("for view in ('surface', 'cloud'): pass") == ["EXPORTS"]
    assert copies("for view in ('cloud', 'surface'): pass") == []
    for module in sorted((ROOT / "scan3d").rglob("*.py")):
        if module.name != "choices.py":
            assert copies(module.read_text(encoding="utf-8")) == [], module


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
    assert tuple(formats._ENDINGS) == choices.EXPORTS
