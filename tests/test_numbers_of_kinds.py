"""The numbers that stand for kinds in files and arrays: whoever has stored them relies on them."""

import pytest

import planar
from scan3d.bracket import Gap
from scan3d.cloud import NormalSource

NUMBERS = {
    planar.Phase: ["NONE", "TIP", "TANGENTIAL"],
    planar.Status: ["OK", "NO_FORCE", "WRONG_SIDE", "NO_ROD", "INFLECTION", "BEYOND_TIP", "UNDEFINED"],
    planar.NormalSource: ["NONE", "TANGENTIAL", "FRICTION"],
    NormalSource: ["UNKNOWN", "SLICES", "FIT", "FRICTION"],
    Gap: ["SLICES", "CONTACTS", "CAPS"],
}


@pytest.mark.parametrize("kind", NUMBERS, ids=lambda kind: f"{kind.__module__}.{kind.__name__}")
def test_kinds_are_numbered_from_0(kind):
    assert {name: int(member) for name, member in kind.__members__.items()} == {
        name: number for number, name in enumerate(NUMBERS[kind])
    }
