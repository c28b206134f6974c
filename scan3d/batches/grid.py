"""Grids of settings: lists of values, every combination of which is a run."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from scan3d.errors import InputError
from scan3d.files.reading import read_toml

# Largest number of combinations.  More would take weeks, and come of a mistake.
_MOST = 100_000

Grid = list[dict[str, Any]]
"""The settings of each combination, by name."""


def read_grid(path: str | os.PathLike[str]) -> Grid:
    """The combinations of a TOML file; see `combinations`.  Raises InputError for a file that can't be read, and as there."""
    try:
        data = read_toml(Path(path))
    except OSError as error:
        raise InputError(f"can't read the grid {path}: {error.strerror or error}") from None
    except ValueError as error:
        raise InputError(f"{path} is not a TOML file of a grid: {error}") from None
    return combinations(data, str(path))


def combinations(data: Mapping[str, Any], source: str = "the grid") -> Grid:
    """The combinations of lists of values by setting.

    Of ``{"friction": [0.0, 0.3], "noise": [0.0, 1e-4]}`` they are four; a value that is no list is that of all combinations.  A
    value that is a table is a grid of its own, which also has the values outside the tables: several tables make one
    combination after the other.  A vector for ``axis`` or a pair for ``friction`` is a list in the list of values.

    `source` is the name of the grid in messages.  Raises InputError for empty lists, tables in tables, a setting that is both
    in a table and outside, a grid without settings, and more than 100 000 combinations.
    """
    common = {name: value for name, value in data.items() if not isinstance(value, Mapping)}
    tables = {name: value for name, value in data.items() if isinstance(value, Mapping)}
    found: Grid = []
    for name, table in (tables or {"": {}}).items():
        nested = [key for key, value in table.items() if isinstance(value, Mapping)]
        if nested:
            raise InputError(f"{source}: [{name}.{nested[0]}] is a table in a table; expected lists of values")
        twice = sorted(common.keys() & table.keys())
        if twice:
            raise InputError(f"{source}: {twice[0]} stands in [{name}] and outside; leave one of them out")
        values = {key: _values(source, key, value) for key, value in {**common, **table}.items()}
        if not values:
            raise InputError(f"{source} has no settings; expected lists of values, such as friction = [0.0, 0.3]")
        number = len(found) + math.prod(map(len, values.values()))
        if number > _MOST:
            raise InputError(f"{source} has {number} combinations, where {_MOST} are allowed; leave values out")
        found += [dict(zip(values, choice, strict=True)) for choice in itertools.product(*values.values())]
    return found


def _values(source: str, name: str, value: Any) -> list[Any]:
    values = list(value) if isinstance(value, (list, tuple)) or hasattr(value, "tolist") else [value]
    if not values:
        raise InputError(f"{source}: the list of values for {name} is empty; leave {name} out, or give a value")
    return values
