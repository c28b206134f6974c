"""Rods: the scales of real rods, and text that names no rod."""

import math

import pytest

from scan3d import InputError, Rod
from scan3d.rods import SLENDERNESS, parse_rod


def test_against_the_formula_of_a_round_bar():
    rod = parse_rod("steel:0.3x50")
    assert rod.length_m == pytest.approx(0.05, rel=1e-15)
    assert rod.bending_stiffness_Nm2 == pytest.approx(210e9 * math.pi * (0.15e-3) ** 4 / 4, rel=1e-12)
    assert rod.moment_unit_Nm == pytest.approx(rod.force_unit_N * rod.length_m, rel=1e-12)


def test_a_rod_by_its_length_is_the_slender_steel_wire():
    assert Rod.of_length(0.05) == Rod.wire(0.05, 0.05 * SLENDERNESS, 210e9)
    assert Rod.of_length(0.05).bending_stiffness_Nm2 == pytest.approx(
        parse_rod("steel:0.3x50").bending_stiffness_Nm2, rel=1e-12
    )


@pytest.mark.parametrize("bad", [0.0, -0.05, math.nan, math.inf])
def test_a_rod_needs_positive_numbers(bad):
    with pytest.raises(InputError, match="positive length"):
        Rod(bad, 1e-4)
    with pytest.raises(InputError, match="positive bending stiffness"):
        Rod(0.05, bad)
    for diameter, modulus in ((bad, 2e11), (1e-3, bad)):
        with pytest.raises(InputError, match="positive diameter and modulus"):
            Rod.wire(0.05, diameter, modulus)


@pytest.mark.parametrize(
    "text",
    ["", "steel", "steel:0.3", "0.3x50", "gold:0.3x50", "steel:x50", "steel:0.3x", "steel:0.3 x 50", "steel:0.3x50 mm"],
)
def test_text_that_names_no_rod_is_refused_with_an_example(text):
    with pytest.raises(InputError, match=r"steel:0\.3x50.*nitinol") as error:
        parse_rod(text)
    assert repr(text) in str(error.value)
