"""Parquet files by pyarrow, which is optional."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scan3d.errors import InputError

ENDING = ".parquet"
_MISSING = "Parquet files need pyarrow: pip install 'scan3d[parquet]', or take a .csv"


def read_columns(path: Path) -> dict[str, NDArray[Any]]:
    """The columns (n,) of a Parquet file by name: numbers as float64 (NaN where there is none), times in seconds, or text.

    Raises InputError if pyarrow is missing or can't read the file, and OSError.
    """
    try:
        from pyarrow import ArrowException, parquet
    except ImportError:
        raise InputError(_MISSING) from None
    try:
        # pyarrow's dataset layer, which is the default, takes longer to start than to read
        table = parquet.ParquetFile(path).read()
    except ArrowException as error:
        raise InputError(f"can't read {path.name} as Parquet: {error}") from None
    repeated = sorted({name for name in table.column_names if table.column_names.count(name) > 1})
    if repeated:
        raise InputError(f"{path.name} has {', '.join(repeated)} more than once; keep one column of each name")
    return {name: _values(table.column(name).to_numpy()) for name in table.column_names}


def _values(column: NDArray[Any]) -> NDArray[Any]:
    if column.dtype.kind in "mM":
        column = (column - column[:1].min()).astype("timedelta64[ns]") if column.dtype.kind == "M" else column
        return column.astype("timedelta64[ns]").astype(np.int64) * 1e-9
    if column.dtype.kind in "iufb":
        return column.astype(np.float64)
    return np.array(["" if value is None else str(value) for value in column], dtype=object)


def parquet_bytes(columns: Mapping[str, NDArray[Any]]) -> bytes:
    """A Parquet file of columns (n,).  Raises InputError if pyarrow is missing."""
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        raise InputError(_MISSING) from None
    stream = io.BytesIO()
    # measured numbers hardly repeat: dictionaries of them would only cost time
    parquet.write_table(pyarrow.table(dict(columns)), stream, use_dictionary=False, compression="snappy")
    return stream.getvalue()
