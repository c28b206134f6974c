"""Numbers for people: units by size, digits by the uncertainty, and what is written is never narrower than what is known."""

import math
import re
from decimal import Decimal
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import scan3d
from scan3d.units import (
    FORCES,
    UNITS_M,
    force,
    length,
    lengths,
    moment,
    number,
    plus_minus,
    point,
    reaction_unit,
    share,
    unit_for,
    volume,
)

SIZES = {"nm": 1e-9, "µm": 1e-6, "mm": 1e-3, "m": 1.0, "in": 0.0254}
positive = st.floats(1e-12, 1e6)


def metres(text):
    value, unit = text.split()
    return float(value.replace(",", "")) * SIZES[unit]


TEXTS = [
    *((number(value), text) for value, text in (
        (0.0, "0"), (0.305, "0.305"), (51434.2, "51,400"), (8.54e-5, "8.54e-05"), (-12.0, "-12"), (math.nan, "nan"),
        (math.inf, "infinite"), (2e12, "2e+12"),
    )),
    *((length(*value), text) for *value, text in (
        (5.33e-5, "mm", "53.3 nm"), (5.33e-5, "m", "53.3 µm"), (0.0333, "cm", "333 µm"), (1250.0, "mm", "1.25 m"),
        (0.0, "mm", "0 mm"), (-3.46945e-15, "mm", "under 1 nm"), (0.0021, "in", "0.0021 in"), (math.inf, "mm", "unknown"),
    )),
    # lengths that belong together have one unit, and the decimals of the largest
    (lengths((42.0, 41.984, 56.00001), "mm"), (["42", "41.98", "56"], "mm")),
    (lengths((0.05, -3.4e-15, -0.0), "m"), (["50", "0", "0"], "mm")), (lengths((), "mm"), ([], "mm")),
    (force(0.0192), "19.2 mN"), (force(3.16), "3.16 N"), (force(3.1e-6, digits=2), "3.1 µN"), (force(-2e-19), "under 1 nN"),
    (force(0.0), "0 N"), (force(math.nan), "unknown"), (force(0.0192, -3.1e-6, 0), "(19.2, 0, 0) mN"),
    (force(0.12345, up=True), "124 mN"), (moment(0.00132), "1.32 N mm"), (moment(4e-7), "400 µN mm"),
    (moment(1.5, -0.25), "(1.5, -0.25) N m"), (point((0.05, -3.4e-15, 0.2), "m"), "(50, 0, 200) mm"),
    *((reaction_unit(largest, FORCES)[0], unit) for largest, unit in ((0.0, "N"), (2e-12, "nN"), (3e-3, "mN"), (40.0, "N"))),
    # a value has the digits that its uncertainty leaves
    *((plus_minus(*value), text) for *value, text in (
        (13192.2, 13188.6, 13195.7, "13,192 ± 4"), (0.012, -0.022, 0.046, "0.012 ± 0.034"), (8000.0, 8000.0, 8000.0, "8,000"),
        (8000.0, 8000.0, 8000.0 + 1e-9, "8,000.000 ± 0.001"), (5.0, 4.0, math.inf, "5 ± unknown"),
    )),
    (volume(13192.2, 13188.6, 13195.7, "mm"), "13,192 ± 4 mm³"),
    (volume(1.31922e-5, 1.31886e-5, 1.31957e-5, "m"), "13,192 ± 4 mm³"),
    (volume(101e3, 94321, 991e3, "mm"), "90,000 to 1,000,000 mm³"), (volume(2.0, 0.0, math.inf, "mm"), "2 ± unknown mm³"),
    *((share(part), text) for part, text in (
        (0.5, "50 %"), (2.6e-3, "0.26 %"), (5.4e-5, "54 ppm"), (5.6e-7, "0.56 ppm"), (1e-16, "under 0.001 ppm"), (0.0, "0 %"),
    )),
]  # fmt: skip


@pytest.mark.parametrize(("text", "expected"), TEXTS)
def test_text_of_numbers(text, expected):
    assert text == expected


def test_no_sentence_of_the_program_has_another_rule():
    """A length, force, moment, angle or share that is formatted by itself comes out as ``3.1e-05 mm`` or ``1e+02 %``."""
    own = re.compile(r"\{[^{}]*:\.\d[gf]\}\s?(mm|m|mN|N|N m|nm|µm|°|%|\{[\w.]*unit\})(?![\w²]| m²)")
    product = [path for path in Path(scan3d.__file__).parent.rglob("*.py") if path.name != "numbers.py"]
    assert [(path.name, found[0]) for path in product for found in own.finditer(path.read_text())] == []


@given(positive, st.sampled_from(sorted(UNITS_M)))
def test_what_is_written_of_a_bound_is_no_less_than_the_bound(value, unit):
    text, true = length(value, unit, up=True), value * UNITS_M[unit]
    if text == "under 1 nm":
        assert Decimal(value) * Decimal(str(UNITS_M[unit])) < Decimal("1e-9")  # 1e-6 mm is less than that as a float
    else:
        assert true * (1 - 1e-12) <= metres(text) <= 1.011 * true
        assert re.fullmatch(r"[\d,.]+(e[-+]\d+)? (nm|µm|mm|m|in)", text)
    part = share(value, up=True)
    assert part.startswith("under") or float(part.split()[0].replace(",", "")) >= value * (
        100 if part.endswith("%") else 1e6
    ) * (1 - 1e-12)


@given(st.floats(-1e6, 1e6), positive, positive)
def test_the_interval_that_is_written_contains_the_true_one(value, below, above):
    low, high = value - below, value + above
    middle, _, off = plus_minus(value, low, high).replace(",", "").partition(" ± ")
    slack = 1e-12 * (abs(value) + above + below) + 5.1e-7 * abs(value) * (
        not off
    )  # seven digits, without an uncertainty
    middle, off = float(middle), float(off or 0.0)
    assert middle - off <= low + slack
    assert middle + off >= high - slack
    assert off <= 1.6 * max(above, below) + 1.1e-6 * max(abs(value), above, below)


@given(positive, st.sampled_from(sorted(UNITS_M)))
def test_the_unit_of_a_size_holds_it(value, unit):
    symbol, size = unit_for(value, unit)
    ratio = value * UNITS_M[unit] / float(size)
    assert symbol == "in" or value * UNITS_M[unit] < 1e-9 * (1 + 1e-12) or 1 - 1e-12 <= ratio < 1000 or symbol == "m"
