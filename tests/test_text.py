"""JSON and TOML of plain values, read back by other readers."""

import datetime
import json
import math
import os
import tomllib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scan3d import InputError
from scan3d.files.text import read_section, to_json, to_toml


def test_json_has_null_for_what_is_no_number():
    data = {"a": math.nan, "b": [math.inf, 1.5, -math.inf], "c": {"d": np.float64(math.nan), "e": np.int64(3)}}
    data |= {
        "f": np.array([[1.0, math.nan]]),
        "g": (True, None, "µ"),
        "h": np.bool_(False),
        "i": datetime.date(2024, 5, 1),
    }
    text = to_json(data)
    assert text.endswith(b"}\n")
    assert json.loads(text, parse_constant=pytest.fail) == {
        "a": None,
        "b": [None, 1.5, None],
        "c": {"d": None, "e": 3},
        "f": [[1.0, None]],
        "g": [True, None, "µ"],
        "h": False,
        "i": "2024-05-01",
    }


def test_json_holds_floats_in_full():
    values = np.random.default_rng(2).standard_normal(100)
    assert json.loads(to_json({"a": values}))["a"] == values.tolist()


text = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)
plain = st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats() | text | st.dates() | st.datetimes()
values = st.recursive(
    plain, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(text, inner, max_size=3), max_leaves=5
)


def same(a, b):
    if isinstance(a, float):
        return isinstance(b, float) and (a == b or (math.isnan(a) and math.isnan(b)))
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, list):
        return len(a) == len(b) and all(map(same, a, b))
    return type(a) is type(b) and a == b


@pytest.mark.slow
@given(st.dictionaries(text, values, max_size=5))
def test_toml_against_tomllib(data):
    assert same(data, tomllib.loads(to_toml(data)))


def test_toml_of_numpys_numbers():
    data = {"a": np.float64(0.1), "b": np.int64(3), "c": {"d": np.float32(0.5), "e": (1, 2)}}
    assert tomllib.loads(to_toml(data)) == {"a": 0.1, "b": 3, "c": {"d": 0.5, "e": [1, 2]}}


def test_a_file_name_that_is_no_utf8_does_not_stop_the_writing():
    name = os.fsdecode(b"caf\xe9.stl")
    assert json.loads(to_json({"file": name})) == {"file": "caf?.stl"}
    assert tomllib.loads(to_toml({"file": name}).encode(errors="replace").decode()) == {"file": "caf?.stl"}


MARKS = {"utf-16-le": b"\xff\xfe", "utf-16-be": b"\xfe\xff"}


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "latin-1", "no mark"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_settings_as_windows_writes_them(tmp_path, encoding, end):
    """UTF-16 with its mark, of either order, is that of PowerShell; of other bytes the line is named."""
    path, text = tmp_path / "map.toml", end.join(["a = 1", "# für µm", "b = 2", ""])
    path.write_bytes(MARKS.get(encoding, b"") + text.encode("utf-16-le" if encoding == "no mark" else encoding))
    if encoding not in ("latin-1", "no mark"):
        assert read_section(path, "map").data == {"a": 1, "b": 2}
        return
    with pytest.raises(InputError, match=r"map\.toml.* line [12] is no UTF-8: save it as UTF-8"):
        read_section(path, "map")
