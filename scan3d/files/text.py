"""JSON and TOML of plain values, and tables as text."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping
from types import NoneType
from typing import Any

import numpy as np
from numpy.typing import NDArray


def to_json(data: Mapping[str, Any]) -> bytes:
    """JSON with NaN and infinities as null."""
    return (json.dumps(_plain(data), indent=2, ensure_ascii=False, allow_nan=False) + "\n").encode(errors="replace")


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if isinstance(value, (str, int, float, NoneType)) else str(value)


def rows_as_text(columns: Iterable[NDArray[Any]], separator: str = ",", start: str = "") -> bytes:
    """Lines of columns (n,), with as few digits as are needed to read the same bits back."""
    # numpy writes float32 with fewer digits, Python the others faster
    cells = (map(str, column if column.dtype == np.float32 else column.tolist()) for column in columns)
    return "".join(f"{start}{separator.join(row)}\n" for row in zip(*cells, strict=True)).encode()


def to_toml(data: Mapping[str, Any]) -> str:
    """TOML of plain values and tables."""
    lines = [
        f"{_toml_key(key)} = {_toml_value(value)}" for key, value in data.items() if not isinstance(value, Mapping)
    ]
    for key, value in data.items():
        if isinstance(value, Mapping):
            lines += ["", f"[{_toml_key(key)}]"]
            lines += [f"{_toml_key(name)} = {_toml_value(item)}" for name, item in value.items()]
    return "\n".join(lines) + "\n"


def _toml_key(key: str) -> str:
    return key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else _toml_value(key)


def _toml_value(value: Any) -> str:
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_toml_value, value)) + "]"
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_toml_key(key)} = {_toml_value(item)}" for key, item in value.items()) + "}"
    if isinstance(value, str):
        # JSON strings are basic strings of TOML, except for one control character
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    # repr gives all digits of a float, str the date format of TOML
    return repr(value) if isinstance(value, (int, float)) else str(value)
