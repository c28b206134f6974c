"""Columns of files of arrays: Parquet, MATLAB, numpy and HDF5, by the libraries made for them, and sheets of Excel as text.

The names and the sizes of all arrays are read before any of them is loaded: a few kilobytes may hold what fits into no memory,
and what is refused is refused before the work.  pyarrow, h5py and openpyxl are optional.  Arrays are columns by their names,
those of several columns by names that end in _0, _1 and so on.
"""

from __future__ import annotations

import csv
import io
import math
import zipfile
import zlib
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from datetime import date, datetime, time
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scan3d.errors import InputError
from scan3d.workers import check_memory

PARQUET = ".parquet"
SHEETS = (".xlsx", ".xlsm")
_MISSING = "Parquet files need pyarrow: pip install 'scan3d[parquet]', or take a .csv"
_PICKLED = "holds Python objects, which are not read because they can run programs; save plain arrays of numbers"
_TWO_RATES = "bring two rates to the same times, as by interpolation, and save arrays of one length"
# An import holds each number up to about so many times, and needs so many bytes for a text.
_COPIES, _TEXT, _WIDEST = 6, 100, 100
# Rows of an array that may be channels, as MATLAB's files have them.
_CHANNELS = 16


class _Stored(NamedTuple):
    """An array in a file, which is loaded when it is needed."""

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    load: Callable[[], NDArray[Any]]
    refused: str = ""
    """Why it is not read, if it is not."""

    def turned(self) -> _Stored:
        """The array with its axes in the opposite order."""
        return self._replace(shape=self.shape[::-1], load=lambda: self.load().T)

    def upright(self) -> _Stored:
        """The array with a row for each of its many samples, and a column for each channel."""
        lies = len(self.shape) == 2 and self.shape[0] <= _CHANNELS and self.shape[1] > _WIDEST
        return self.turned() if lies else self

    def columns(self) -> list[str]:
        """Their names, of an array that is wider than any log those of the first ones."""
        return [*_split_array(self.name, np.empty((0, *(min(n, _WIDEST) for n in self.shape[1:])), self.dtype))]

    def memory(self) -> float:
        """Bytes that its columns need at least."""
        each = _TEXT if self.dtype.kind in "OSU" else max(self.dtype.itemsize, 8)
        return math.prod(map(float, self.shape)) * each


class Columns(NamedTuple):
    """The columns of a file."""

    values: dict[str, NDArray[Any]]
    """(n,) each by name: numbers as float64 (NaN where there is none), times in seconds, or text."""
    others: dict[str, str]
    """What the file has beside them, by name, with the clause that says why it is no column, and what to do."""


def check_single(file: str, header: Sequence[str], names: Iterable[str]) -> None:
    """Raise InputError if one of some names is that of several columns in the header of a file."""
    if repeated := [name for name in names if header.count(name) > 1]:
        raise InputError(f"{file}: its header has {', '.join(repeated)} more than once; keep one column of each name")


def read_columns(path: Path, wanted: Collection[str] = ()) -> Columns:
    """The columns of a file, and what is none.

    Of files that hold arrays of any kind columns are the arrays of one or two axes whose first one is as long as those of most,
    or of most of the `wanted` columns; arrays with a row for each channel are turned.  The columns of an array without a name
    are called by their numbers, from 1.  Raises InputError if a library is missing or
    can't read the file, if it holds no arrays, two of one name, or more than fits into memory, and OSError.
    """
    with _errors_named(path), ExitStack() as opened:
        arrays = list(_READERS[path.suffix.lower()](path, opened))
        names = [one.name for one in arrays]
        check_single(path.name, names, sorted({*names}))
        refused = {one.name: one.refused for one in arrays if one.refused}
        kinds = [
            one.upright()
            for one in arrays
            if one.dtype.kind in "iufbmMUSOV" and len(one.shape) in (1, 2) and not one.refused
        ]
        named = [one for one in kinds if not {*wanted}.isdisjoint(one.columns())]
        lengths = Counter(one.shape[0] for one in named or kinds)
        if not lengths and refused:
            raise InputError(f"{path.name} {next(iter(refused.values()))}")
        if not lengths:
            raise InputError(f"{path.name} holds no arrays of numbers of one or two axes, which are columns of a table")
        rows = max(lengths, key=lambda length: (lengths[length], length))
        chosen = [one for one in kinds if one.shape[0] == rows]
        _check_size(path, sum(one.memory() for one in chosen))
        columns: dict[str, NDArray[Any]] = {}
        for one in chosen:
            columns |= _split_array(one.name, one.load())
        others = {
            name: f"has {one.shape[0]} rows, and {chosen[0].columns()[0]!r}, as most arrays, {rows}; {_TWO_RATES}"
            for one in kinds
            if one.shape[0] != rows
            for name in one.columns()
        }
        return Columns({name: _values(column) for name, column in columns.items()}, others | refused)


def _check_size(path: Path, size: float) -> None:
    check_memory(_COPIES * size, f"reading {path.name}", "take a smaller file")


def _split_array(name: str, values: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """The columns of an array (n,), (n, k), or of records."""
    if values.dtype.names:
        fields = {f"{name}.{field}".lstrip("."): values[field] for field in values.dtype.names}
        return {key: column for field, part in fields.items() for key, column in _split_array(field, part).items()}
    if values.ndim == 1 or values.shape[1] == 1:
        return {name or "1": values.reshape(len(values))}
    return {f"{name}_{k}" if name else str(k + 1): column for k, column in enumerate(values.T)}


def _parquet(path: Path, _: ExitStack) -> Iterator[_Stored]:
    try:
        from pyarrow import parquet, types
    except ImportError:
        raise InputError(_MISSING) from None
    # pyarrow's dataset layer, which is the default, takes longer to start than to read
    with parquet.ParquetFile(path) as file:
        schema = file.schema_arrow
        text = sum(types.is_string(kind) or types.is_large_string(kind) for kind in schema.types)
        _check_size(path, float(file.metadata.num_rows) * (8 * (len(schema) - text) + _TEXT * text))
        table = file.read()
    yield from (
        _loaded(name, column.to_numpy()) for name, column in zip(table.column_names, table.columns, strict=True)
    )


def _loaded(name: str, values: NDArray[Any]) -> _Stored:
    return _Stored(name, values.shape, values.dtype, lambda: values)


def _numpy(path: Path, opened: ExitStack) -> Iterator[_Stored]:
    if not zipfile.is_zipfile(path):
        with open(path, "rb") as file:
            yield _npy("", file, lambda: np.load(path, allow_pickle=False))
        return
    archive = opened.enter_context(zipfile.ZipFile(path))
    for member in archive.infolist():
        if member.filename.endswith(".npy"):
            name = member.filename.removesuffix(".npy")
            with archive.open(member) as file:
                yield _npy(name, file, partial(_member, archive, member))


def _member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> NDArray[Any]:
    with archive.open(member) as file:
        return np.lib.format.read_array(file, allow_pickle=False)


def _npy(name: str, file: Any, load: Callable[[], NDArray[Any]]) -> _Stored:
    """An array in numpy's format, whose header is read.  Raises ValueError for other contents."""
    start = file.read(8)
    if not start.startswith(np.lib.format.MAGIC_PREFIX) and start[:1] == b"\x80":  # how a pickle begins
        return _Stored(name, (), np.dtype(object), load, _PICKLED)
    version = np.lib.format.read_magic(io.BytesIO(start))
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(file)
    return _Stored(name, shape, dtype, load, _PICKLED if dtype.hasobject else "")


def _matlab(path: Path, opened: ExitStack) -> Iterator[_Stored]:
    from scipy.io import loadmat, whosmat

    if _is_hdf5(path):
        yield from (one.turned() for one in _hdf5(path, opened))  # as MATLAB has its axes
        return
    _check_size(path, _unpacked(path))
    variables = whosmat(path)
    names = [name for name, _, _ in variables]
    check_single(path.name, names, sorted({*names}))
    # numbers may be stored in fewer bytes than they need
    _check_size(path, 8 * sum(math.prod(map(float, shape)) for _, shape, _ in variables))
    yield from _flat("", loadmat(path, simplify_cells=True))


def stated_text(path: Path, name: str) -> str:
    """A text by its name in a file of MATLAB, as that of the unit in a cloud; empty if there is none, and for other files.

    Raises InputError as `read_columns`, and OSError.
    """
    if path.suffix.lower() != ".mat":
        return ""
    from scipy.io import loadmat

    with _errors_named(path):
        if not _is_hdf5(path):
            value = loadmat(path, variable_names=[name], simplify_cells=True).get(name)
            return value if isinstance(value, str) else ""
        with _h5py().File(path, "r") as file:
            value = file.get(name)
            is_text = value is not None and value.attrs.get("MATLAB_class") == b"char"
            return "".join(map(chr, np.asarray(value).ravel())) if is_text else ""  # a text is numbers of UTF-16


def _is_hdf5(path: Path) -> bool:
    """Whether a file of MATLAB is of its version 7.3."""
    with open(path, "rb") as file:
        return file.read(20).startswith(b"MATLAB 7.3")


def _h5py() -> Any:
    try:
        import h5py
    except ImportError:
        raise InputError("HDF5 files, and those of MATLAB 7.3, need h5py: pip install 'scan3d[tables]'") from None
    return h5py


def _unpacked(path: Path) -> float:
    """How many bytes the elements of a MAT-file of level 5 have when they are no longer compressed; 0 for older files.

    Source: The MathWorks, MAT-File Format, R2024a: each element begins with its type and its size, also a compressed one.
    """
    with open(path, "rb") as file:
        order = {b"IM": "little", b"MI": "big"}.get(file.read(128)[126:])
        size = 0
        while order is not None and len(tag := file.read(8)) == 8:
            kind, count = (int.from_bytes(part, order) for part in (tag[:4], tag[4:]))  # type: ignore[arg-type]
            place = file.tell()
            if kind == 15:  # compressed
                tag = zlib.decompressobj().decompress(file.read(min(count, 1 << 10)), 8)
            size += int.from_bytes(tag[4:], order)  # type: ignore[arg-type]
            file.seek(place + count)
    return float(size)


def _flat(name: str, value: Any) -> Iterator[_Stored]:
    if isinstance(value, Mapping):
        for key, inner in value.items():
            if not str(key).startswith("__"):
                yield from _flat(f"{name}.{key}".lstrip("."), inner)
    elif isinstance(value, np.ndarray):
        yield _loaded(name, value)


def _hdf5(path: Path, opened: ExitStack) -> Iterator[_Stored]:
    h5py = _h5py()
    found: list[_Stored] = []

    def take(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and 0 < len(item.shape) <= 2 and not name.startswith("#"):
            is_text = h5py.check_string_dtype(item.dtype)
            found.append(
                _Stored(name, item.shape, item.dtype, lambda: np.asarray(item.asstr()[()] if is_text else item[()]))
            )

    opened.enter_context(h5py.File(path, "r")).visititems(take)
    yield from found


_ADVICE = {
    PARQUET: ("Parquet's", "save it again"),
    ".npy": ("numpy's", "save plain arrays of numbers"),
    ".mat": ("MATLAB's", "save arrays or structs of numbers, and tables by table2struct"),
    ".h5": ("HDF5's", "save it again"),
    **dict.fromkeys(SHEETS, ("Excel's", "save it again, or as a .csv")),
}


@contextmanager
def _errors_named(path: Path) -> Iterator[None]:
    try:
        yield
    except InputError:
        raise
    # the libraries raise various errors for damaged files
    except Exception as error:
        if isinstance(error, OSError) and error.errno:
            raise
        what = " ".join(str(error).split()) or type(error).__name__
        whose, advice = _ADVICE[
            {".pq": PARQUET, ".npz": ".npy", ".hdf5": ".h5"}.get(ending := path.suffix.lower(), ending)
        ]
        raise InputError(f"can't read {path.name} as a file of {whose} format: {what}; {advice}") from None


_READERS: dict[str, Callable[[Path, ExitStack], Iterator[_Stored]]] = {
    **dict.fromkeys((PARQUET, ".pq"), _parquet),
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
    with _errors_named(path), open(path, "rb") as file:
        with zipfile.ZipFile(file) as parts:
            _check_size(path, sum(part.file_size for part in parts.infolist()))
        book = load_workbook(file, read_only=True, data_only=True)
        rows = csv.writer(text, delimiter="\t", lineterminator="\n")
        for row in book.worksheets[0].iter_rows(values_only=True):
            values = (cell.isoformat() if isinstance(cell, (datetime, date, time)) else cell for cell in row)
            cells = ["" if cell is None else " ".join(str(cell).split()) for cell in values]
            filled = [k for k, cell in enumerate(cells) if cell]
            rows.writerow(cells[: filled[0] + 1] if len(filled) == 1 else cells)  # a title is no row of the table
    return text.getvalue()


def _values(column: NDArray[Any]) -> NDArray[Any]:
    if column.dtype.kind in "mM":
        missing = np.isnat(column)
        if column.dtype.kind == "M" and not missing.all():
            column = column - column[int(np.argmin(missing))]
        return np.where(missing, np.nan, column.astype("timedelta64[ns]").astype(np.int64) * 1e-9)
    if column.dtype.kind in "iufb":
        return column.astype(np.float64)
    texts = (value.decode(errors="replace") if isinstance(value, bytes) else value for value in column)
    return np.array(["" if value is None else str(value) for value in texts], dtype=object)


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
