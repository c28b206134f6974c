"""Files of arrays: what is refused before it is loaded, and why, against files that numpy, h5py, scipy and pyarrow write."""

import pickle
import re
import tracemalloc
import zipfile
import zlib

import h5py
import numpy as np
import pyarrow
import pytest
from pyarrow import parquet
from scipy.io import savemat

from scan3d import InputError
from scan3d.files.columns import read_columns
from scan3d.files.tables import read_table
from scan3d.laboratory.logs import read_log
from scan3d.laboratory.maps import guess_map, read_map

NAMES = {"position": ["x", "y", "z"], "force": ["Fx", "Fy", "Fz"], "moment": ["Tx", "Ty", "Tz"]}


def hdf5(path, arrays):
    with h5py.File(path, "w") as file:
        for name, values in arrays.items():
            file.create_dataset(name, data=values, compression="gzip")


def parquet_file(path, arrays):
    parquet.write_table(pyarrow.table(arrays), path)


WRITERS = {
    "log.npz": lambda path, arrays: np.savez_compressed(path, **arrays),
    "log.mat": lambda path, arrays: savemat(path, arrays, do_compression=True),
    "log.h5": hdf5,
    "log.parquet": parquet_file,
}


@pytest.mark.slow
@pytest.mark.parametrize("file", WRITERS)
def test_sizes_are_known_before_the_work(tmp_path, monkeypatch, file):
    """A file of some kilobytes with 64 MB of zeros: 8 bytes for each number, and hardly any memory before the refusal."""
    path = tmp_path / file
    WRITERS[file](path, {"a": np.zeros(8_000_000)})
    assert path.stat().st_size < 2e6
    monkeypatch.setattr("scan3d.workers.memory_bytes", lambda: 1e8)
    tracemalloc.start()
    with pytest.raises(InputError, match=rf"reading {file} needs about 0\.\d+ GB, and this machine has 0\.1 GB"):
        read_columns(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 2e7


def test_the_size_of_a_struct_and_of_an_npy_and_a_sheet(tmp_path, monkeypatch):
    savemat(tmp_path / "log.mat", {"log": {"a": np.zeros(8_000_000)}}, do_compression=True)
    with open(tmp_path / "log.npy", "wb") as file:
        np.lib.format.write_array_header_2_0(file, {"descr": "<f8", "fortran_order": False, "shape": (10**9, 10**9)})
    with zipfile.ZipFile(tmp_path / "log.xlsx", "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("xl/worksheets/sheet1.xml", b"0" * 50_000_000)
    monkeypatch.setattr("scan3d.workers.memory_bytes", lambda: 1e8)
    for name in ("log.mat", "log.npy", "log.xlsx"):
        with pytest.raises(InputError, match=f"reading {name} needs about"):
            read_table(tmp_path / name)


def test_a_row_of_another_kind_may_be_as_large_as_it_is(tmp_path, monkeypatch):
    """Arrays that are no columns are not loaded."""
    np.savez_compressed(tmp_path / "log.npz", a=np.arange(3.0), b=np.arange(3.0), image=np.zeros((3000, 3000)))
    monkeypatch.setattr("scan3d.workers.memory_bytes", lambda: 1e6)
    assert [*read_columns(tmp_path / "log.npz").values] == ["a", "b"]


def test_two_arrays_of_one_name(tmp_path):
    np.savez(tmp_path / "log.npz", a=np.zeros(3))
    with zipfile.ZipFile(tmp_path / "log.npz", "a") as file, pytest.warns(UserWarning, match="Duplicate name"):
        file.writestr("a.npy", file.read("a.npy"))
    with pytest.raises(InputError, match=r"log\.npz: its header has a more than once"):
        read_columns(tmp_path / "log.npz")
    savemat(tmp_path / "log.mat", {"a": np.zeros(3)})
    data = (tmp_path / "log.mat").read_bytes()
    (tmp_path / "log.mat").write_bytes(data + data[128:])
    with pytest.raises(InputError, match=r"log\.mat: its header has a more than once"):
        read_columns(tmp_path / "log.mat")


def test_pickles_are_not_read_and_nobody_is_told_to(tmp_path):
    objects = np.array([{}, None], dtype=object)
    np.save(tmp_path / "objects.npy", objects)
    np.savez(tmp_path / "objects.npz", b=objects)
    (tmp_path / "pickle.npy").write_bytes(pickle.dumps([1.0, 2.0]))
    for name in ("objects.npy", "objects.npz", "pickle.npy"):
        with pytest.raises(InputError, match=rf"{re.escape(name)} holds Python objects, which are not read") as error:
            read_columns(tmp_path / name)
        assert "allow_pickle" not in str(error.value)
    np.savez(tmp_path / "notes.npz", a=np.zeros(3), notes=objects)
    values, others = read_columns(tmp_path / "notes.npz")
    assert [*values] == ["a"]
    assert others["notes"].startswith("holds Python objects, which are not read")


def arrays_of_two_rates(file):
    n = {"position": 20, "force": 40, "moment": 40}
    found = {name: np.arange(n[kind], dtype=float) for kind, names in NAMES.items() for name in names}
    found |= {f"q{axis}": np.full(20, float(axis == "w")) for axis in "wxyz"}
    if file == "log.npz":
        pose, wrench = (np.stack([found[name] for name in names], 1) for names in (NAMES["position"], NAMES["force"]))
        return {name: values for name, values in found.items() if name[0] == "q"} | {"p": pose, "F": wrench}
    return found


@pytest.mark.parametrize("file", ["log.npz", "log.mat", "log.h5"])
def test_two_rates_are_called_so(tmp_path, file):
    """The file has the columns, and the sentence says so, also where the map is guessed."""
    arrays = arrays_of_two_rates(file)
    # MATLAB's vectors are columns
    WRITERS[file](tmp_path / file, {name: values.reshape(len(values), -1) for name, values in arrays.items()})
    force = [f"F_{k}" for k in range(3)] if file == "log.npz" else NAMES["force"]
    position = [f"p_{k}" for k in range(3)] if file == "log.npz" else NAMES["position"]
    columns = {"position": position, "orientation": {"quaternion": ["qw", "qx", "qy", "qz"]}, "force": force}
    data = {
        "columns": columns | {"moment": force},
        "units": {"length": "mm", "force": "N", "moment": "N mm"},
        "rod": {"length_m": 0.1, "bending_stiffness_Nm2": 1e-4},
    }
    table, map = read_table(tmp_path / file, read_map(data).layout), read_map(data)
    with pytest.raises(InputError) as error:
        read_log(table, map)
    rows = (40, 20) if len({*table.others} & {*force}) else (20, 40)
    assert re.search(rf"{rows[0]} rows, and .* {rows[1]}; bring two rates to the same times", str(error.value))
    if file != "log.npz":
        with pytest.raises(InputError, match="bring two rates to the same times"):
            guess_map(tmp_path / file)


@pytest.mark.parametrize("order", ["<", ">"])
def test_unpacked_sizes_of_either_order_of_bytes(tmp_path, monkeypatch, order):
    """By the format's description: a compressed element of 800 MB in a file of 1 kB."""
    tag = np.array([14, 800_000_000], dtype=f"{order}u4").tobytes()
    packed = zlib.compress(tag + bytes(1000))
    head = b"MATLAB 5.0 MAT-file".ljust(124) + np.array([0x0100, 0x4D49], dtype=f"{order}u2").tobytes()
    (tmp_path / "log.mat").write_bytes(head + np.array([15, len(packed)], dtype=f"{order}u4").tobytes() + packed)
    monkeypatch.setattr("scan3d.workers.memory_bytes", lambda: 1e8)
    with pytest.raises(InputError, match=r"needs about 4\.8 GB"):
        read_columns(tmp_path / "log.mat")


@pytest.mark.parametrize("missing", [[], [3], [0], [0, 1], range(5)])
def test_times_that_are_missing_are_no_times(tmp_path, missing):
    """Dates count from the first one that is there."""
    stamps = np.datetime64("2026-05-01T10:00", "ns") + 250_000_000 * np.arange(5).astype("timedelta64[ns]")
    spans = stamps - stamps[0]
    for values in (stamps, spans):
        values[[*missing]] = "NaT"
    parquet_file(tmp_path / "log.parquet", {"stamp": stamps, "span": spans})
    found = read_columns(tmp_path / "log.parquet").values
    expected = np.where(np.isin(np.arange(5), [*missing]), np.nan, 0.25 * np.arange(5))
    np.testing.assert_array_equal(found["span"], expected)
    np.testing.assert_array_equal(found["stamp"], expected - 0.25 * next((k for k in range(5) if k not in missing), 0))
