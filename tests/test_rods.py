"""Rods: the scales of real rods, and text that names no rod."""

import math

import pytest

from scan3d import InputError, Rod
from scan3d.rods import MODULI_PA, SLENDERNESS, parse_rod

# EI/L² and EI/L of real wires, worked out by hand from I = π d⁴ / 64.  Steels differ by some 3 % in their modulus (these two
# are for 205 GPa), and two digits are given.
SCALES = [
    ("steel:0.3x50", 33e-3, 1.6e-3),
    ("steel:0.5x100", 63e-3, 6.3e-3),
    ("nitinol:0.25x75", 2.6e-3, 0.19e-3),
]


@pytest.mark.parametrize(("text", "force_N", "moment_Nm"), SCALES)
def test_scales_of_real_rods(text, force_N, moment_Nm):
    rod = parse_rod(text)
    assert rod.force_unit_N == pytest.approx(force_N, rel=0.05)
    assert rod.moment_unit_Nm == pytest.approx(moment_Nm, rel=0.05)


def test_against_the_formula_of_a_round_bar():
    rod = parse_rod("steel:0.3x50")
    assert rod.length_m == pytest.approx(0.05, rel=1e-15)
    assert rod.bending_stiffness_Nm2 == pytest.approx(210e9 * math.pi * (0.15e-3) ** 4 / 4, rel=1e-12)
    assert rod.moment_unit_Nm == pytest.approx(rod.force_unit_N * rod.length_m, rel=1e-12)


@pytest.mark.parametrize("material", MODULI_PA)
def test_every_material_can_be_named(material):
    assert parse_rod(f"{material}:0.5x80") == Rod.wire(0.08, 0.5e-3, MODULI_PA[material])


def test_a_rod_by_its_length_is_the_slender_steel_wire():
    assert Rod.of_length(0.05) == Rod.wire(0.05, 0.05 * SLENDERNESS, 210e9)
    assert Rod.of_length(0.05).bending_stiffness_Nm2 == pytest.approx(
        parse_rod("steel:0.3x50").bending_stiffness_Nm2, rel=1e-12
    )


def test_auto_leaves_the_rod_to_the_body():
    assert parse_rod("auto") is None


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


@pytest.mark.parametrize("text", ["steel:0x50", "steel:0.3x0", "steel:0.3x-50", "steel:1ex50", "steel:--1x50"])
def test_impossible_numbers_are_refused_with_the_text_of_the_rod(text):
    with pytest.raises(InputError, match=rf"rod '{text}'"):
        parse_rod(text)
