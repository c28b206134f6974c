"""Results as text, and as tables of pandas."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from enum import IntEnum
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from planar.arrays import Array

if TYPE_CHECKING:
    import pandas


class Explained(IntEnum):
    """Codes with a sentence that explains each: ``NAME = number, sentence``."""

    sentence: str

    def __new__(cls, value: int, sentence: str = "") -> Explained:
        member = int.__new__(cls, value)
        member._value_, member.sentence = value, sentence
        return member


def words(values: NDArray[np.int8], kinds: type[IntEnum]) -> list[str]:
    """The names (n,) of coded values (n,)."""
    return [kinds(value).name.lower() for value in values.tolist()]


def counted(title: str, phase: NDArray[np.int8], kinds: type[IntEnum]) -> str:
    """How many samples there are, and how many of each phase."""
    counts = ", ".join(f"{np.count_nonzero(phase == kind)} {kind.name.lower()}" for kind in kinds)
    return f"{title}: {len(phase)} samples, {counts}"


def to_frame(columns: Mapping[str, Array | Sequence[str]]) -> pandas.DataFrame:
    """A data frame of the columns (n,) but those of NaN alone.  Raises ImportError without pandas."""
    try:
        import pandas
    except ImportError as error:
        raise ImportError(f"to_pandas needs pandas, which can't be imported ({error}): pip install pandas") from None
    return pandas.DataFrame(
        {
            name: column
            for name, column in columns.items()
            if not len(column) or isinstance(column, list) or not np.isnan(column).all()
        }
    )
