"""Reports are read from folders that others may have edited: the fields that are shown are checked by name."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from scan3d.errors import InputError
from scan3d.units import UNITS_M

SCHEMA = 1
"""Number of the format of reports, `scan3d.report.SCHEMA`."""


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < math.inf and _fits(value)


def _fits(value: float) -> bool:
    try:
        float(value)
    except OverflowError:
        return False
    return True


def _is_count(value: Any) -> bool:
    return _is_number(value) and value >= 0 and value == int(value)


def _is_text(value: Any) -> bool:
    return isinstance(value, str)


def _is_size(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 3 and all(map(_is_number, value))


def _is_unit(value: Any) -> bool:
    return isinstance(value, str) and value in UNITS_M


def _are_distances(value: Any) -> bool:
    return isinstance(value, Mapping) and all(_is_number(value.get(name)) for name in ("two_sided", "relative"))


_Check = tuple[Callable[[Any], bool], str]
_NUMBER: _Check = (_is_number, "a number")
_COUNT: _Check = (_is_count, "a whole number >= 0")
_TEXT: _Check = (_is_text, "text")
_UNIT: _Check = (_is_unit, f"one of {', '.join(UNITS_M)}")
_DISTANCES: _Check = (_are_distances, "an object with the numbers two_sided and relative")
# The fields that are used, by section; each may be missing or null.
_FIELDS: dict[str, dict[str, _Check]] = {
    "mesh": {
        "file": _TEXT,
        "path": _TEXT,
        "sha256": _TEXT,
        "unit": _UNIT,
        "extents": (_is_size, "three numbers"),
        "scanned": _TEXT,
    },
    "settings": {"hull": (lambda value: isinstance(value, bool), "true or false")},
    "source": {},
    "counts": {"contacts": _COUNT, "slices": _COUNT, "sweeps": _COUNT},
    "contact_error": {"max": _NUMBER},
    "friction": {"estimated_median": _NUMBER},
    "surface": {"method": _TEXT, "faces": _COUNT},
    "hausdorff": {"two_sided": _NUMBER, "relative": _NUMBER, "mesh_itself": _DISTANCES},
    "certificate": {"bound": _NUMBER, "relative": _NUMBER, "unit": _UNIT},
}


def checked_report(data: Any, path: Path) -> Mapping[str, Any]:
    """A report as it was read.  Raises InputError that names the first field that is not what the program writes."""
    if not isinstance(data, Mapping):
        raise InputError(f"{path} is not a report: expected a JSON object; run the scan again")
    if data.get("schema", SCHEMA) != SCHEMA:
        raise InputError(
            f"{path}: schema {data['schema']!r} is not known, expected {SCHEMA}; was it written by a newer version?"
        )
    for section, fields in _FIELDS.items():
        part = data.get(section)
        if part is None:
            continue
        if not isinstance(part, Mapping):
            raise InputError(f"{path}: {section} must be an object, got {part!r}; run the scan again")
        for name, (is_right, expected) in fields.items():
            value = part.get(name)
            if value is not None and not is_right(value):
                raise InputError(f"{path}: {section}.{name} must be {expected}, got {value!r}; run the scan again")
    return data
