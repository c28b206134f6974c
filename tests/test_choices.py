"""Settings and plans accept exactly the values that choices.py lists."""

import pytest

from scan3d import Plan, choices, surfaces
from scan3d.files import formats
from scan3d.settings import Settings
from scan3d.units import UNITS_M


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
