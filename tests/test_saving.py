"""`scan3d.save`, `scan3d.load` and the tables for other libraries, against the scan that they were made of.

Files in float64 give the same bits back; PCD and binary STL hold float32, whose rounding is 6e-8 of a number.
"""

import sys

import numpy as np
import pytest
import trimesh
from small_scans import CUBE, undrawn

import scan3d
from scan3d.files.shapes import SURFACE_ENDINGS, export
from scan3d.geometry.distance import distances

SINGLE = 1e-6  # of a body of 40 mm: float32 has 6e-8 of that


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("scan") / "out"


@pytest.fixture(scope="module")
def result(folder):
    with undrawn():
        return scan3d.scan(CUBE, folder, slices=6, sweeps=4, samples=16, method="hull", friction=(0.1, 0.4))


def test_a_cloud_comes_back(result, tmp_path):
    path, cloud = tmp_path / "cloud.ply", result.cloud
    cloud.save(path, truth=CUBE)
    back = scan3d.load(path)
    assert isinstance(back, scan3d.Shape)
    assert (len(back), back.unit) == (len(cloud), "mm")
    assert np.array_equal(back.points, cloud.points)
    assert np.allclose(back.normals, cloud.normals, atol=1e-6, equal_nan=True)
    assert np.array_equal(back.columns["row"], cloud.row)
    assert np.allclose(back.columns["friction"], cloud.friction, rtol=1e-6, equal_nan=True)
    assert np.allclose(back.columns["quality"], distances(cloud.points, result.analysis.truth), atol=SINGLE * 40)
    # and what was loaded is saved in the same way
    back.save(tmp_path / "again.ply")
    assert (tmp_path / "again.ply").read_bytes() == path.read_bytes()
    assert repr(back).startswith("Shape\n  contacts ")
    assert len(repr(back).splitlines()) <= 10


@pytest.mark.parametrize("ending", SURFACE_ENDINGS)
def test_a_surface_is_saved_as_the_command_exports_it(result, folder, tmp_path, ending):
    saved, exported = tmp_path / f"saved{ending}", tmp_path / f"exported{ending}"
    scan3d.save(result.surface, saved)
    export(folder, exported)
    assert saved.read_bytes() == exported.read_bytes()
    if ending in (".vtp", ".mat"):
        return
    back = scan3d.load(saved)
    assert isinstance(back, trimesh.Trimesh)
    assert back.is_watertight
    scale = {".glb": 1e3}.get(ending, 1)  # GLB is in metres
    assert back.units == ("m" if ending == ".glb" else "mm")
    assert scan3d.compare(trimesh.Trimesh(scale * back.vertices, back.faces), result.surface).hausdorff < SINGLE * 40
    if ending == ".ply":
        assert np.allclose(back.vertex_attributes["bound"], result.certificate.at_vertices, rtol=1e-6)


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_a_recording_comes_back(result, tmp_path, ending):
    if ending == ".parquet":
        pytest.importorskip("pyarrow")
    scan3d.save(result.recording, tmp_path / f"log{ending}")
    back = scan3d.load(tmp_path / f"log{ending}")
    assert np.array_equal(back.position_m, result.recording.position_m)
    assert back.rod.bending_stiffness_Nm2 == result.recording.rod.bending_stiffness_Nm2


def test_units_of_surfaces_and_points(result, tmp_path):
    inches = result.surface.copy()
    inches.units = "in"
    scan3d.save(inches, tmp_path / "a.stl")
    assert scan3d.load(tmp_path / "a.stl").units == "in"
    scan3d.save(inches, tmp_path / "b.stl", unit="cm")
    assert scan3d.load(tmp_path / "b.stl").units == "cm"
    assert scan3d.load(CUBE).units is None
    assert scan3d.load(CUBE, unit="in").units == "in"


def test_pandas_has_the_columns_of_the_cloud(result):
    table = result.cloud.to_pandas(CUBE)
    assert len(table) == len(result.cloud)
    assert np.array_equal(table[["x", "y", "z"]].to_numpy(), result.cloud.points)
    assert np.array_equal(table["force"], result.cloud.force_N)
    assert table["quality"].max() < 1e-9
    assert set(table["phase"]) == {"tip", "tangential"}
    assert set(table["normal_source"]) <= {"slices", "fit", "friction", "hull", "facet", "unknown"}
    assert "quality" not in result.cloud.to_pandas()


def test_pyvista_has_normals_friction_and_deviations(result):
    data = result.cloud.to_pyvista(result.analysis.truth)
    assert np.array_equal(data.points, result.cloud.points)
    assert np.allclose(data["Normals"], result.cloud.normals, atol=1e-6, equal_nan=True)
    assert {"friction", "force", "quality", "phase"} <= set(data.point_data.keys())
    surface = scan3d.results.to_pyvista(result.surface, CUBE)
    assert surface.n_cells == len(result.surface.faces)
    assert np.allclose(surface["quality"], distances(result.surface.vertices, result.analysis.truth))
    assert np.allclose(surface["bound"], result.certificate.at_vertices, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.open3d
def test_open3d_has_normals_friction_and_deviations(result):
    cloud = result.cloud.to_open3d(CUBE)
    assert np.array_equal(cloud.point["positions"].numpy(), result.cloud.points)
    assert np.allclose(cloud.point["normals"].numpy(), result.cloud.normals, atol=1e-6, equal_nan=True)
    assert cloud.point["friction"].numpy().shape == (len(result.cloud), 1)
    assert cloud.point["quality"].numpy().max() < 1e-9
    mesh = scan3d.results.to_open3d(result.surface)
    assert np.array_equal(mesh.triangle["indices"].numpy(), result.surface.faces)


@pytest.mark.parametrize("library", ["pandas", "open3d"])
def test_a_missing_library_is_named(result, monkeypatch, library):
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(scan3d.InputError, match=rf"to_{library} needs {library}, which can't be imported"):
        getattr(result.cloud, f"to_{library}")()
    if library == "open3d":
        with pytest.raises(scan3d.InputError, match=r"pip install 'scan3d\[open3d\]'$"):
            scan3d.results.to_open3d(result.surface)


def test_what_can_not_be_saved(result, tmp_path):
    (tmp_path / "mine.ply").write_text("mine", encoding="utf-8")
    metres = result.surface.copy()
    metres.units = "furlong"
    wrong = [
        ((3, "a.ply"), r"only a recording, a cloud or a surface \(trimesh.Trimesh\) can be saved, got a int"),
        ((result.surface, "a.csv"), r"a surface can't be written as \.csv, which holds a cloud"),
        ((result.cloud, "mine.ply"), r"can't be recognised as written by scan3d; give .*\(overwrite=True\)"),
        ((metres, "a.ply"), r"the surface is in 'furlong'; give its unit as one of m, cm"),
    ]
    for (what, name), sentence in wrong:
        with pytest.raises(scan3d.InputError, match=sentence):
            scan3d.save(what, tmp_path / name)
    with pytest.raises(scan3d.InputError, match="unit must be one of m, cm, mm, um, in, got 'ell'"):
        scan3d.save(result.surface, tmp_path / "a.ply", unit="ell")
    result.cloud.save(tmp_path / "mine.ply", overwrite=True)
    assert len(scan3d.load(tmp_path / "mine.ply")) == len(result.cloud)


def test_what_can_not_be_loaded(result, tmp_path):
    files = {
        "a.txt": ("", r"can't load a\.txt: expected a file ending in \.csv, .* or \.glb"),
        "a.ply": ("ply\n", r"a\.ply can't be read as PLY|a\.ply is cut off"),
    }
    for name, (text, sentence) in files.items():
        (tmp_path / name).write_text(text, encoding="utf-8")
        with pytest.raises(scan3d.InputError, match=sentence):
            scan3d.load(tmp_path / name)
    with pytest.raises(
        scan3d.InputError, match=r"there is no file .*; give a recording, .* and a folder to scan3d.open"
    ):
        scan3d.load(tmp_path)
    with pytest.raises(scan3d.InputError, match="unit must be one of m, cm, mm, um, in, got 'ell'"):
        scan3d.load(CUBE, unit="ell")
    for thing, name in ((result.surface, "s.stl"), (result.cloud, "c.ply")):
        scan3d.save(thing, tmp_path / name)
        with pytest.raises(scan3d.InputError, match=f"{name} is in mm, as it states itself, and not in in"):
            scan3d.load(tmp_path / name, unit="in")
