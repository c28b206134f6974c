"""The entries of a section of a TOML file, taken one by one with their types checked."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from scan3d.errors import InputError
from scan3d.files.reading import did_you_mean, to_float


class Entries:
    """A section whose entries are taken by name; `finish` refuses those that were not asked for."""

    def __init__(self, file: str, name: str, data: Mapping[str, Any]) -> None:
        self.file, self.name, self.data = file, name, data
        self._asked: list[str] = []

    def __contains__(self, key: str) -> bool:
        return key in self.data

    def __bool__(self) -> bool:
        return bool(self.data)

    def error(self, key: str, sentence: str) -> InputError:
        section = f"[{self.name}] " if self.name else ""
        return InputError(f"{self.file}: {section}{key} {sentence}")

    def any(self, key: str, default: Any = None) -> Any:
        """The value of an entry, whatever its type."""
        self._asked.append(key)
        return self.data.get(key, default)

    def finish(self, known: Sequence[str] = ()) -> None:
        """Raise InputError for entries that were not asked for, with the name that was probably meant."""
        names = list(known) or list(dict.fromkeys(self._asked))
        unknown = sorted(set(self.data) - set(names))
        if unknown:
            section = f"[{self.name}] has " if self.name else ""
            raise InputError(
                f"{self.file}: {section}unknown names: {', '.join(unknown)}; known are {', '.join(names)}"
                f"{did_you_mean(unknown, names)}"
            )

    def section(self, key: str, *, required: bool = False) -> Entries:
        value = self.any(key, {})
        name = f"{self.name}.{key}" if self.name else key
        if not isinstance(value, Mapping):
            raise self.error(key, f"must be a section [{name}] or a table in braces, got {value!r}")
        if required and not value:
            raise self.error(key, "is missing")
        return Entries(self.file, name, value)

    def text(self, key: str, default: str | None = None) -> str:
        value = self.any(key, default)
        if value is None:
            raise self.error(key, "is missing")
        if not isinstance(value, str):
            raise self.error(key, f"must be text, got {value!r}")
        return value

    def choice(self, key: str, choices: Sequence[str], default: str) -> str:
        value = self.any(key, default)
        if not isinstance(value, str) or value not in choices:
            near = did_you_mean([value], choices) if isinstance(value, str) else ""
            raise self.error(key, f"must be one of {', '.join(choices)}; got {value!r}{near}")
        return value

    def boolean(self, key: str, default: bool) -> bool:
        value = self.any(key, default)
        if not isinstance(value, bool):
            raise self.error(key, f"must be true or false, got {value!r}")
        return value

    def integer(self, key: str, default: int | None, *, at_least: int) -> int | None:
        value = self.any(key, default)
        if value is not None and (isinstance(value, bool) or not isinstance(value, int) or value < at_least):
            raise self.error(key, f"must be a whole number of at least {at_least}, got {value!r}")
        return value

    def number(self, key: str, default: float | None = None, *, at_least: float = -math.inf) -> float | None:
        value = self.any(key, default)
        if value is None:
            return None
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.error(key, f"must be a number, got {value!r}")
        number = to_float(value)
        if not math.isfinite(number) or number < at_least:
            bound = "" if at_least == -math.inf else f" of at least {at_least:g}"
            raise self.error(key, f"must be a finite number{bound}, got {value!r}")
        return number

    def positive(self, key: str) -> float | None:
        number = self.number(key, None)
        if number is not None and number <= 0:
            raise self.error(key, f"must be positive, got {number:g}")
        return number

    def numbers(self, key: str, count: int, default: Sequence[float]) -> tuple[float, ...]:
        value = self.any(key, list(default))
        right = isinstance(value, list) and len(value) == count
        if not right or not all(isinstance(x, (int, float)) and not isinstance(x, bool) for x in value):
            raise self.error(key, f"must be a list of {count} numbers, got {value!r}")
        numbers = tuple(map(to_float, value))
        if not all(map(math.isfinite, numbers)):
            raise self.error(key, f"must be a list of {count} finite numbers, got {value!r}")
        return numbers

    def texts(self, key: str, count: int) -> tuple[str, ...]:
        """A list of texts; empty if there is no such entry."""
        value = self.any(key, None)
        if value is None:
            return ()
        if not isinstance(value, list) or len(value) != count or not all(isinstance(x, str) for x in value):
            raise self.error(key, f"must be a list of {count} names, got {value!r}")
        return tuple(value)

    def reference(self, key: str) -> str | int | None:
        """The name or number of a column; None if there is no such entry."""
        value = self.any(key, None)
        return None if value is None else self._column(key, value)

    def references(self, key: str, counts: Sequence[int]) -> tuple[str | int, ...]:
        """Columns in a list of one of the given lengths, or a single pattern that stands for all of them."""
        value = self.any(key, None)
        wanted = " or ".join(map(str, counts))
        if value is None:
            raise self.error(key, f"is missing; it names {wanted} columns of the table")
        if isinstance(value, str) and any(sign in value for sign in "*?"):
            return (value,)
        if not isinstance(value, list) or len(value) not in counts:
            raise self.error(
                key, f"must be a list of {wanted} columns, or a pattern such as 'F*' that finds them; got {value!r}"
            )
        return tuple(self._column(key, one) for one in value)

    def _column(self, key: str, value: Any) -> str | int:
        if isinstance(value, bool) or not isinstance(value, (str, int)):
            raise self.error(key, f"must name columns by text or by number, got {value!r}")
        if isinstance(value, int) and value < 1:
            raise self.error(key, f"counts columns from 1, got {value}")
        return value
