"""Touches of other probes: places and normals with known errors of known bodies, and files of them."""

import json

import h5py
import numpy as np
import pytest
import trimesh
from scipy.io import savemat

import scan3d
from scan3d.bounds import certificate, enclosure
from scan3d.bounds.planes import outer_body, planes_of_touches
from scan3d.cli import main
from scan3d.cloud import NormalSource
from scan3d.files.points import read_points
from scan3d.files.shapes import export
from scan3d.geometry.hulls import hull
from scan3d.pipeline import analyse
from scan3d.reconstruction.touches import contradictions
from scan3d.report import report, summary
from tests.robustness.everyday import EVERYDAY, mesh_of
from tests.sample_bodies import MESHES, convex_hausdorff, random_body


def touched(mesh, count, seed, place_sd=0.0, normal_sd=0.0):
    """Places (n, 3) on a mesh and its normals there, with errors of these deviations, the first in diagonals."""
    rng = np.random.default_rng([seed, count])
    points, face = trimesh.sample.sample_surface(mesh, count, seed=seed)
    normals = np.array(mesh.face_normals[face])
    points = points + place_sd * np.linalg.norm(mesh.extents) * rng.normal(size=points.shape)
    across = rng.normal(size=normals.shape)
    across -= (across * normals).sum(axis=1, keepdims=True) * normals
    size = normal_sd * np.linalg.norm(across, axis=1, keepdims=True)
    turned = np.cos(size) * normals + np.sin(size) * across / np.linalg.norm(across, axis=1, keepdims=True)
    return points, turned


def bounded(mesh, count, seed, place_sd=0.0, normal_sd=0.0):
    """The certified bound of the surface from touches over its distance, and whether the volume is in its interval."""
    points, normals = touched(mesh, count, seed, place_sd, normal_sd)
    stated = {"place_sd": place_sd * np.linalg.norm(mesh.extents), "normal_sd": normal_sd} if place_sd else {}
    cloud = scan3d.touches(points, normals, **stated)
    assert cloud.convex
    assert not contradictions(cloud)
    bounds = enclosure(cloud)
    surface = scan3d.surface(cloud, bounds=bounds)
    low, high = bounds.volume
    apart = convex_hausdorff(hull(surface.vertices), mesh)
    return certificate(bounds, surface).bound / apart, low * (1 - 1e-9) <= mesh.volume <= high * (1 + 1e-9)


def test_a_margin_of_places_leaves_the_deviations_of_normals():
    points, normals = touched(trimesh.creation.icosphere(4, 10.0), 400, 0, 0.0, 0.05)
    bounds = enclosure(scan3d.touches(points, normals, place_sd=1e-3, normal_sd=0.05), 1e-3)
    directions = random_body(0).vertex_normals
    assert (bounds.support(directions)[1] >= 10.0 - 0.04).all()  # the facets of the sphere lie 0.03 inside
    assert bounds.confidence < 1


@pytest.mark.slow
@pytest.mark.parametrize("noise", [(0.0, 0.0), (1e-4, 0.0), (1e-4, 1e-2), (1e-3, 5e-2)])
@pytest.mark.parametrize("seed", range(4))  # and 200 bodies in `make trust`
def test_bounds_hold_for_convex_bodies(seed, noise):
    ratio, is_inside = bounded(random_body(seed), (80, 300)[seed % 2], seed, *noise)
    assert ratio >= 1
    assert is_inside


@pytest.mark.trust
@pytest.mark.parametrize("block", range(10))
def test_two_hundred_bodies_are_bounded(block):
    for seed in range(20 * block, 20 * block + 20):
        rng = np.random.default_rng([seed, 5])
        count, place_sd, normal_sd = (
            rng.choice(of) for of in ([60, 300, 1000], [0.0, 1e-5, 1e-4, 1e-3], [0.0, 1e-3, 0.05])
        )
        ratio, is_inside = bounded(random_body(seed), int(count), seed, place_sd, normal_sd * (place_sd > 0))
        assert ratio >= 1
        assert is_inside


def test_planes_of_all_touches_leave_a_sphere_what_its_tangent_planes_do():
    """Of a unit sphere touched in the directions of an icosahedron the outer body is the dodecahedron."""
    points = trimesh.creation.icosahedron().vertices.view(np.ndarray)
    points = points / np.linalg.norm(points, axis=1, keepdims=True)
    corners, _ = outer_body(planes_of_touches(points, points, np.zeros(12), np.zeros(12)), hull(points))
    # circumradius over inradius of a dodecahedron
    expected = np.sqrt(3) / 4 * (1 + np.sqrt(5)) / np.sqrt(25 / 10 + 11 / 10 * np.sqrt(5)) * 2
    assert np.linalg.norm(corners, axis=1) == pytest.approx(np.full(20, expected))


def test_a_side_without_touches_is_not_bounded():
    points, normals = touched(trimesh.creation.icosphere(), 300, 0)
    cloud = scan3d.touches(points[normals[:, 2] > 0.05], normals[normals[:, 2] > 0.05])
    assert enclosure(cloud).bound == np.inf
    on_table = scan3d.touches(cloud.points, cloud.normals, table=-1.0)
    assert np.isfinite(enclosure(on_table).bound)
    assert enclosure(scan3d.touches(points)).bound == np.inf


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["mug", *(pytest.param(name, marks=pytest.mark.trust) for name in ("chair", "bowl", "torus"))]
)
def test_bodies_of_any_shape(name):
    mesh = mesh_of(name)
    size = np.linalg.norm(mesh.extents)
    cloud = scan3d.touches(*touched(mesh, 3000, 0))
    assert not cloud.convex
    surface = scan3d.surface(cloud)
    assert surface.is_watertight
    assert surface.euler_number == EVERYDAY[name].euler
    assert scan3d.compare(surface, mesh).hausdorff < 0.05 * size


@pytest.mark.slow
def test_normals_that_were_estimated_do_not_count_as_measured():
    points, normals = touched(trimesh.creation.torus(10, 4), 1000, 0)
    normals[::4] = np.nan
    found = report(analyse(scan3d.touches(points, normals)), settings={})
    assert dict(summary(found)[1])["touches"] == "1000, 750 of them with normals"


@pytest.mark.slow
def test_touches_that_the_surface_lacks_are_told(call, tmp_path, no_pictures):
    """A bent sheet that is thinner than touches are apart."""
    sheet = trimesh.boolean.union(
        [trimesh.creation.box((60, 40, 0.36)), trimesh.creation.box((0.36, 40, 30)).apply_translation((29.8, 0, 15))],
        engine="manifold",
    )
    path, out = tmp_path / "touches.csv", tmp_path / "out"
    np.savetxt(path, np.hstack(touched(sheet, 2000, 0)), delimiter=",", header="x,y,z,nx,ny,nz", comments="")
    code, words, _ = call("surface", path, "--out", out)
    assert code == 0
    off = json.loads((out / "report.json").read_text())["counts"]["off_surface"]
    assert off > 500
    assert f"; {off} of 2000 touches lie off this surface" in words
    assert f"{off} of 2000 touches are farther from the surface than touches are apart" in words


def test_normals_that_point_inwards_are_turned_and_mixed_ones_refused():
    mesh = random_body(2)
    points, normals = touched(mesh, 200, 0)
    assert scan3d.touches(points, -3 * normals).normals == pytest.approx(normals)
    with pytest.raises(scan3d.InputError, match="turn all of them outwards"):
        scan3d.touches(points, normals * np.where(np.arange(200) % 2, 1, -1)[:, None])


def test_errors_that_are_not_stated_take_the_certificate_back(call, tmp_path, no_pictures):
    """Wrong normals contradict the places; wrong places are those of no convex body."""
    mesh = random_body(1)
    points, normals = touched(mesh, 400, 0, 0.0, 0.05)
    cloud = scan3d.touches(points, normals)
    assert cloud.convex
    assert "state the normals' deviation" in contradictions(cloud)[0].message
    assert not contradictions(scan3d.touches(points, normals, normal_sd=0.05))
    off = touched(mesh, 400, 0, 1e-2)
    assert not scan3d.touches(*off).convex
    assert scan3d.touches(*off, place_sd=1e-2 * np.linalg.norm(mesh.extents)).convex
    path = tmp_path / "touches.csv"
    np.savetxt(path, np.hstack([points, normals]), delimiter=",", header="x,y,z,nx,ny,nz", comments="")
    code, out, err = call("surface", path, "--out", tmp_path / "out", "--strict", "--json")
    assert code == 1
    assert '"bound": null' in out
    assert "warning: " in err


@pytest.mark.slow
def test_one_command_from_points_to_a_certificate(call, tmp_path):
    mesh = random_body(5)
    points, normals = touched(mesh, 500, 3)
    path = tmp_path / "ball.xyz"
    np.savetxt(path, np.hstack([points, -normals]))
    code, out, err = call("surface", path)
    assert code == 0
    assert "point inwards: all are turned round" in err
    assert "certified from touch" in out
    result = scan3d.open(tmp_path / "ball-scan")
    assert convex_hausdorff(hull(result.surface.vertices), mesh) <= result.certificate.bound
    assert result.cloud.points == pytest.approx(points)
    assert (tmp_path / "ball-scan" / "view.html").exists()
    with pytest.raises(scan3d.InputError, match="another probe"):
        _ = result.recording


@pytest.mark.parametrize("ending", [".csv", ".ply", ".pcd", ".mat", ".xyzn"])
def test_exported_contacts_are_read_as_touches(ending, tmp_path):
    """As the program writes them, in every format of clouds, single precision within its rounding."""
    mesh = random_body(5)
    points, normals = touched(mesh, 100, 1)
    factor = np.random.default_rng(1).normal(size=(100, 3, 3))
    covariance = factor @ factor.swapaxes(1, 2)
    cloud = scan3d.touches(points, normals, covariance=covariance, normal_sd=0.02, unit="cm")
    path = tmp_path / f"cloud{ending}"
    scan3d.save(cloud, path)
    again = scan3d.touches(path, unit="cm")
    assert again.points == pytest.approx(points, rel=1e-6, abs=1e-5)
    assert again.normals == pytest.approx(normals, abs=1e-6)
    if ending != ".xyzn":
        largest = np.linalg.norm(factor, ord=2, axis=(1, 2))
        assert again.place_sd == pytest.approx(largest, rel=1e-5)
        assert again.covariance == pytest.approx(covariance, abs=1e-5)
        scan3d.save(cloud, tmp_path / "a.ply")
        export(tmp_path / "a.ply", tmp_path / f"m{ending}", unit="m")
        assert scan3d.touches(tmp_path / f"m{ending}").covariance == pytest.approx(1e-4 * covariance, abs=1e-9)
        assert again.normal_sd == pytest.approx(np.full(100, 0.02))
    if ending != ".xyzn":
        assert scan3d.touches(path).unit == "cm"
        with pytest.raises(scan3d.InputError, match="is in cm"):
            scan3d.touches(path, unit="mm")


@pytest.mark.parametrize("source", [NormalSource.UNKNOWN, NormalSource.SURFACE])
def test_exact_touches_without_normals_stay_exact_in_files(source, tmp_path):
    """Normals that are not known add no deviation; those that were estimated have one, with which they certify nothing."""
    cloud = scan3d.touches(*touched(random_body(5), 200, 1))
    cloud.normal_source[::2] = source
    if source == NormalSource.UNKNOWN:
        cloud.normals[::2] = np.nan
    scan3d.save(cloud, tmp_path / "a.csv")
    again = scan3d.touches(tmp_path / "a.csv")
    assert np.isfinite(again.normals[::2]).all() == bool(source)
    if source:
        assert (again.normal_sd[::2] == np.pi).all()
    else:
        assert again.place_sd is None
        assert again.normal_sd is None


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("X [mm];Y [mm];Z [mm];sigma\n1,5;2;3;0,1\n4;5;6;0,1\n", {"x": [1.5, 4], "place_sd": [0.1, 0.1]}),
        ("x_m y_m z_m normal_x normal_y normal_z\n1 2 3 0 0 1\n4 5 6 0 1 0\n", {"x": [1, 4], "ny": [0, 1]}),
        ("x,y,z,normal_sd_deg,quality\n1,2,3,180,good\n4,5,6,90,bad\n", {"normal_sd": [np.pi, np.pi / 2]}),
        ("1 2 3\n4 5 6\n", {"z": [3, 6]}),
    ],
)
def test_tables_of_other_programs(text, expected, tmp_path):
    path = tmp_path / "points.csv"
    path.write_text(text)
    found = read_points(path)
    for name, values in expected.items():
        assert found.columns[name] == pytest.approx(np.array(values, dtype=float))


def test_arrays_are_read_as_touches(tmp_path):
    normals = np.random.default_rng(0).normal(size=(50, 3))
    points = 3 * normals
    np.save(tmp_path / "places.npy", points)
    np.save(tmp_path / "both.npy", np.hstack([points, normals]))
    np.savez(tmp_path / "named.npz", points=points, normals=normals)
    savemat(tmp_path / "any.mat", {"P": points})
    for name, known in (("places.npy", 3), ("both.npy", 6), ("named.npz", 6), ("any.mat", 3)):
        found = read_points(tmp_path / name)
        assert list(found.columns) == ["x", "y", "z", "nx", "ny", "nz"][:known]
        assert np.array_equal(found.stacked(("x", "y", "z")), points)
    with h5py.File(tmp_path / "v73.mat", "w", userblock_size=512) as file:
        file["points"] = points.T
        file["unit"] = np.array([[ord("c")], [ord("m")]], dtype=np.uint16)
        file["unit"].attrs["MATLAB_class"] = np.bytes_("char")
    with open(tmp_path / "v73.mat", "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")
    assert read_points(tmp_path / "v73.mat").unit == "cm"
    np.savez(tmp_path / "other.npz", a=points[:, 0], b=points[:, 1], c=points[:, 2])
    with pytest.raises(scan3d.InputError, match=r"other\.npz has no column x, y or z"):
        read_points(tmp_path / "other.npz")


def test_tables_and_points_that_can_not_be_are_told(tmp_path):
    normals = scan3d.load_mesh("meshes/egg.stl").face_normals[::40]
    for table, message in (
        (-10.0, None),
        (-9.0, "lie down to z = -"),
        (100.0, "where the table is at 100 mm; move the frame of"),
    ):
        cloud = scan3d.touches(10 * normals, normals, table=table)
        assert [message in found.message for found in contradictions(cloud)] == [True] * (message is not None)
    (tmp_path / "points.csv").mkdir()
    with pytest.raises(scan3d.InputError, match=r"points.csv is a folder; give touches as a \.csv"):
        scan3d.touches(tmp_path / "points.csv")


def test_errors_that_are_stated_in_part_are_told(tmp_path):
    """They counted as none, and the touches as exact."""
    normals = scan3d.load_mesh("meshes/egg.stl").face_normals[::40]
    names = ["xx", "xy", "xz", "yy", "yz", "zz"]
    values = np.hstack([20 * normals, np.tile([1e-4, 0, 0, 1e-4, 0, 1e-4], (len(normals), 1))])

    def table(columns, head):
        np.savetxt(tmp_path / "t.csv", values[:, columns], "%.12g", ",", header=f"x_mm,y_mm,z_mm,{head}", comments="")
        return tmp_path / "t.csv"

    for unit in ("mm2", "mm^2", "mm²"):
        cloud = scan3d.touches(table(slice(None), ",".join(f"cov_{name}_{unit}" for name in names)))
        assert cloud.place_sd == pytest.approx(0.01)
    with pytest.raises(scan3d.InputError, match=r"t\.csv has cov_xx, cov_yy, cov_zz of cov_xx, cov_xy, cov_xz, cov_yy"):
        scan3d.touches(table([0, 1, 2, 3, 6, 8], "cov_xx,cov_yy,cov_zz"))
    with pytest.raises(scan3d.InputError, match=r"t\.csv has nx, ny of nx, ny, nz: add the others"):
        scan3d.touches(table([0, 1, 2, 3, 4], "nx,ny"))


def test_clouds_of_several_rods_are_one(tmp_path, no_pictures):
    rng, paths = np.random.default_rng(0), []
    normals = rng.normal(size=(600, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    for k, unit in enumerate(("mm", "m")):
        rows, size = slice(k, None, 2), {"mm": 1.0, "m": 1e-3}[unit]
        head = f"x_{unit},y_{unit},z_{unit},nx,ny,nz,place_sd_{unit}"
        values = np.hstack([20 * size * normals[rows], normals[rows], np.full((300, 1), 0.01 * size)])
        np.savetxt(tmp_path / f"{unit}.csv", values, "%.17g", ",", header=head, comments="")
        paths.append(tmp_path / f"{unit}.csv")
    order = np.r_[0:600:2, 1:600:2]
    cloud = scan3d.touches(paths)
    assert cloud.points == pytest.approx(20 * normals[order], abs=1e-12)
    assert cloud.normals == pytest.approx(normals[order], abs=1e-12)
    assert cloud.place_sd == pytest.approx(0.01)
    assert cloud.unit == "mm"
    out = tmp_path / "both"
    assert main(["surface", *map(str, paths), "--out", str(out), "--quiet"]) == 0
    source = json.loads((out / "report.json").read_text())["source"]
    assert [source["file"], source["further"][0]["file"]] == ["mm.csv", "m.csv"]
    (tmp_path / "plain.csv").write_text("x,y,z\n1,2,3\n")
    with pytest.raises(scan3d.InputError, match=r"mm\.csv states its unit and plain\.csv does not"):
        scan3d.touches([paths[0], tmp_path / "plain.csv"])
    (tmp_path / "exact.csv").write_text("x_mm,y_mm,z_mm\n1,2,3\n")
    with pytest.raises(scan3d.InputError, match=r"exact\.csv has no column place_sd, as others have"):
        scan3d.touches([paths[0], tmp_path / "exact.csv"])


def test_normals_that_a_rod_only_tells_in_its_slices_bound_nothing(tmp_path):
    """The planes of the last slices of this body, as its normals incline them there, cut some of it off."""
    plan = scan3d.Plan(slices=5, samples=24, sweeps=8, friction=(0.0, 0.4), seed=6)
    of_rod = scan3d.reconstruct(scan3d.simulate(random_body(6), plan))
    normals = scan3d.load_mesh("meshes/egg.stl").face_normals[::40]
    for ending in (".ply", ".csv"):
        scan3d.save(of_rod, tmp_path / f"rod{ending}")
        cloud = scan3d.touches(tmp_path / f"rod{ending}")
        assert np.isfinite(cloud.normals).all(axis=1).sum() == np.isfinite(of_rod.normals).all(axis=1).sum()
        assert np.isinf(enclosure(cloud).bound)
        # those of another probe are measured
        scan3d.save(scan3d.touches(20 * normals, normals), tmp_path / f"probe{ending}")
        assert np.isfinite(enclosure(scan3d.touches(tmp_path / f"probe{ending}")).bound)


def test_clouds_of_cameras_with_places_that_are_missing(tmp_path):
    path = tmp_path / "cloud.pcd"
    head = "VERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\nWIDTH 3\nHEIGHT 1\nPOINTS 3\nDATA {}\n"
    path.write_text(head.format("ascii") + "1 2 3 0\nnan nan nan 0\n4 5 6 0\n")
    assert read_points(path).left_out == 1
    path.write_bytes(head.format("binary").encode() + np.arange(12, dtype="<f4").tobytes())
    assert read_points(path).columns["y"] == pytest.approx([1, 5, 9])
    path.write_text(head.format("binary_compressed"))
    with pytest.raises(scan3d.InputError, match="save it as binary or ascii"):
        read_points(path)


def crossed(mesh, places, outward):
    """Where lines that come in against directions (n, 3) first meet a convex body, with its normals; those that miss it left
    out."""
    planes = np.unique(
        np.column_stack([mesh.face_normals, (mesh.face_normals * mesh.triangles[:, 0]).sum(axis=1)]), axis=0
    )
    begin = places + np.linalg.norm(mesh.extents) * outward
    rate, room = -outward @ planes[:, :3].T, planes[:, 3] - begin @ planes[:, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        enters, leaves = np.where(rate < 0, room / rate, -np.inf), np.where(rate > 0, room / rate, np.inf)
    first, hits = enters.argmax(axis=1), enters.max(axis=1) < leaves.min(axis=1)
    return (begin - enters.max(axis=1)[:, None] * outward)[hits], planes[first, :3][hits]


@pytest.mark.slow
def test_touches_where_next_says_bound_a_body_better_than_others(tmp_path, capsys, no_pictures):
    mesh, count = hull(random_body(3).vertices), 60
    points, normals = touched(mesh, count, 0)
    columns, out, places = "x_mm,y_mm,z_mm,nx,ny,nz", tmp_path / "out", tmp_path / "places.csv"
    for _ in range(4):
        np.savetxt(tmp_path / "t.csv", np.hstack([points, normals]), "%.17g", ",", header=columns, comments="")
        assert main(["surface", str(tmp_path / "t.csv"), "--out", str(out), "--quiet", "--overwrite"]) == 0
        assert main(["next", str(out), "--out", str(places), "--sweeps", "20", "--quiet", "--overwrite"]) == 0
        aimed = read_points(places)
        assert aimed.unit == "mm"
        found = crossed(mesh, aimed.stacked(("x", "y", "z")), aimed.stacked(("nx", "ny", "nz")))
        points, normals = np.vstack([points, found[0]]), np.vstack([normals, found[1]])
    others = touched(mesh, len(points), 1)
    assert enclosure(scan3d.touches(points, normals)).bound < 0.6 * enclosure(scan3d.touches(*others)).bound
    aim = ["next", str(out), "--tolerance", "1", "--quiet"]
    assert main([*aim, "--out", str(places), "--overwrite"]) == 0
    assert places.read_text() == columns + "\n"
    assert main([*aim, "--out", str(places)]) == 0  # it would be the same
    # neither touches with the same columns nor those of the result are replaced
    places.write_text(f"{columns}\n1,2,3,0,0,1\n")
    for path, given, sentence in ((places, (), "give --overwrite"), (tmp_path / "t.csv", ("--overwrite",), "never")):
        before = path.read_bytes()
        assert main([*aim, "--out", str(path), *given]) == 1
        assert sentence in capsys.readouterr().err
        assert path.read_bytes() == before
    assert main(["next", str(out), "--out", str(places), "--around", "cylinder:9x9"]) == 2
    assert "no clamp" in capsys.readouterr().err
    np.savetxt(tmp_path / "t.csv", points, "%.17g", ",", header="x,y,z", comments="")
    assert main(["surface", str(tmp_path / "t.csv"), "--out", str(out), "--quiet", "--overwrite"]) == 0
    assert main(["next", str(out), "--out", str(places)]) == 1
    assert "has 0 touches with normals" in capsys.readouterr().err


@pytest.mark.slow
def test_next_names_what_touches_of_a_body_that_is_not_convex_leave_unknown(tmp_path, no_pictures):
    mesh = scan3d.load_mesh(MESHES / "hollow" / "mug.stl")
    points, normals = touched(mesh, 3000, 0)
    seen = points[:, 0] < np.quantile(points[:, 0], 0.8)
    path, out, places = tmp_path / "t.csv", tmp_path / "out", tmp_path / "places.csv"
    np.savetxt(path, np.hstack([points, normals])[seen], "%.17g", ",", header="x,y,z,nx,ny,nz", comments="")
    assert main(["surface", str(path), "--out", str(out), "--quiet"]) == 0
    assert main(["next", str(out), "--out", str(places), "--sweeps", "5", "--quiet"]) == 0
    unknown = json.loads((out / "report.json").read_text())["coverage"]["unknown"]
    assert unknown
    assert np.loadtxt(places, delimiter=",", skiprows=1, usecols=(0, 1, 2), ndmin=2)[0] == pytest.approx(
        unknown[0]["center"]
    )
