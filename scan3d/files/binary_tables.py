"""Tables that are no text, by the libraries made for them: Parquet, MATLAB, numpy, HDF5, and sheets of Excel as text.

pyarrow, h5py and openpyxl are optional.  Arrays are columns by their names, those of several columns by names that end in _0,
_1 and so on.
"""

from __future__ import annotations

import csv
import io
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from datetime import date, datetime, time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scan3d.errors import InputError

ENDING = ".parquet"
SHEETS = (".xlsx", ".xlsm")
_MISSING = "Parquet files need pyarrow: pip install 'scan3d[parquet]', or take a .csv"


def read_columns(path: Path) -> dict[str, NDArray[Any]]:
    """The columns (n,) of a file by name: numbers as float64 (NaN where there is none), times in seconds, or text.

    Of files that hold arrays of any kind these are the arrays of one or two axes whose first one is as long as those of most.
    The columns of an array without a name are called by their numbers, from 1.  Raises InputError if a library is missing or
    can't read the file, or if it holds no arrays, and OSError.
    """
    arrays = dict(_READERS[path.suffix.lower()](path))
    kinds = {name: values for name, values in arrays.items() if values.dtype.kind in "iufbmMUSOV"}
    lengths = Counter(len(values) for values in kinds.values() if values.ndim in (1, 2))
    if not lengths:
        raise InputError(f"{path.name} holds no arrays of numbers of one or two axes, which are columns of a table")
    rows = max(lengths, key=lambda length: (lengths[length], length))
    columns: dict[str, NDArray[Any]] = {}
    for name, values in kinds.items():
        if values.ndim in (1, 2) and len(values) == rows:
            columns |= _split(name, values)
    return {name: _values(column) for name, column in columns.items()}


def _split(name: str, values: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """The columns of an array (n,), (n, k), or of records."""
    if values.dtype.names:
        fields = {f"{name}.{field}".lstrip("."): values[field] for field in values.dtype.names}
        return {key: column for field, part in fields.items() for key, column in _split(field, part).items()}
    if values.ndim == 1 or values.shape[1] == 1:
        return {name or "1": values.reshape(len(values))}
    return {f"{name}_{k}" if name else str(k + 1): column for k, column in enumerate(values.T)}


def _parquet(path: Path) -> Iterator[tuple[str, NDArray[Any]]]:
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
    yield from ((name, table.column(name).to_numpy()) for name in table.column_names)


def _numpy(path: Path) -> Iterator[tuple[str, NDArray[Any]]]:
    with _errors_named(path, "numpy's", "save plain arrays of numbers"), open(path, "rb") as file:
        loaded = np.load(file, allow_pickle=False)
        yield from {"": loaded}.items() if isinstance(loaded, np.ndarray) else loaded.items()


def _matlab(path: Path) -> Iterator[tuple[str, NDArray[Any]]]:
    from scipy.io import loadmat

    with open(path, "rb") as file:
        is_hdf5 = file.read(20).startswith(b"MATLAB 7.3")
    if is_hdf5:
        # as MATLAB has its axes
        yield from ((name, values.T) for name, values in _hdf5(path))
        return
    with _errors_named(path, "MATLAB's", "save arrays or structs of numbers, and tables by table2struct"):
        yield from _flat("", loadmat(path, simplify_cells=True))


def _flat(name: str, value: Any) -> Iterator[tuple[str, NDArray[Any]]]:
    if isinstance(value, Mapping):
        for key, inner in value.items():
            if not str(key).startswith("__"):
                yield from _flat(f"{name}.{key}".lstrip("."), inner)
    elif isinstance(value, np.ndarray):
        yield name, value


def _hdf5(path: Path) -> Iterator[tuple[str, NDArray[Any]]]:
    try:
        import h5py
    except ImportError:
        raise InputError("HDF5 files, and those of MATLAB 7.3, need h5py: pip install 'scan3d[tables]'") from None
    found: list[tuple[str, NDArray[Any]]] = []

    def take(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and 0 < len(item.shape) <= 2 and not name.startswith("#"):
            values = np.asarray(item.asstr()[()] if h5py.check_string_dtype(item.dtype) else item[()])
            found.append((name, values))

    with _errors_named(path, "HDF5's", "save it again"), h5py.File(path, "r") as file:
        file.visititems(take)
    yield from found


@contextmanager
def _errors_named(path: Path, whose: str, advice: str) -> Iterator[None]:
    try:
        yield
    except (InputError, OSError) as error:
        if isinstance(error, InputError) or error.errno:
            raise
        raise InputError(f"can't read {path.name} as a file of {whose} format: {error}; {advice}") from None
    # the libraries raise various errors for damaged files
    except Exception as error:
        what = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"can't read {path.name} as a file of {whose} format: {what}; {advice}") from None


_READERS: dict[str, Callable[[Path], Iterator[tuple[str, NDArray[Any]]]]] = {
    **dict.fromkeys((ENDING, ".pq"), _parquet),
    **dict.fromkeys((".npy", ".npz"), _numpy),
    ".mat": _matlab,
    **dict.fromkeys((".h5", ".hdf5"), _hdf5),
}
ENDINGS = tuple(_READERS)


def sheet_text(path: Path) -> str:
    """The first sheet of a workbook as text, a line for each row and tabs between the cells.

    Raises InputError if openpyxl is missing or can't read it, and OSError.
    """
    try:
        from openpyxl import load_workbook
    except ImportError:
        raise InputError("tables of Excel need openpyxl: pip install 'scan3d[tables]', or save a .csv") from None
    text = io.StringIO()
    with _errors_named(path, "Excel's", "save it again, or as a .csv"), open(path, "rb") as file:
        book = load_workbook(file, read_only=True, data_only=True)
        rows = csv.writer(text, delimiter="\t", lineterminator="\n")
        for row in book.worksheets[0].iter_rows(values_only=True):
            cells = ["" if cell is None else " ".join(_cell(cell).split()) for cell in row]
            filled = [k for k, cell in enumerate(cells) if cell]
            rows.writerow(cells[: filled[0] + 1] if len(filled) == 1 else cells)  # a title is no row of the table
    return text.getvalue()


def _cell(value: Any) -> str:
    return value.isoformat() if isinstance(value, (datetime, date, time)) else str(value)


def _values(column: NDArray[Any]) -> NDArray[Any]:
    if column.dtype.kind in "mM":
        column = (column - column[:1].min()).astype("timedelta64[ns]") if column.dtype.kind == "M" else column
        return column.astype("timedelta64[ns]").astype(np.int64) * 1e-9
    if column.dtype.kind in "iufb":
        return column.astype(np.float64)
    return np.array(["" if value is None else _text(value) for value in column], dtype=object)


def _text(value: Any) -> str:
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


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
