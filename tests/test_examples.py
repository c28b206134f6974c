"""The scripts in examples/ run, draw, and show what their docstrings state.

Every script there is imported and drawn.  The statements of the paper have tests of their own; the
transitions that a script prints are checked against reference values, derived twice and integrated numerically.
"""

import importlib.util
import json
import re
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from unittest.mock import MagicMock

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure
from small_scans import EGG
from test_against_reference_values import TABLE

import scan3d

pytestmark = pytest.mark.slow

EXAMPLES = Path(__file__).parents[1] / "examples"
SCRIPTS = sorted(path.stem for path in EXAMPLES.glob("*.py"))


@pytest.fixture(autouse=True)
def _as_scripts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Scripts import each other by name, as when they are run, and draw without a screen."""
    monkeypatch.syspath_prepend(EXAMPLES)
    matplotlib.use("Agg")


def example(name: str) -> ModuleType:
    return importlib.import_module(name)


def check_picture(script: ModuleType, tmp_path: Path, *options: str) -> None:
    script.main([*options, "--out", str(tmp_path / "a.png")])
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


def smaller(function, **fewer):
    """The function with these options in the place of what the script asks for."""
    return lambda *given, **options: function(*given, **{**options, **fewer})


def test_scripts_draw_whose_own_tests_do_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What they compute is held by the tests of sweeps, of errors and of sweeps in space."""
    reaches = example("what_a_rod_reaches")
    for sweeps in ("near", "far", "aimed"):
        monkeypatch.setattr(reaches, sweeps, getattr(reaches, sweeps)[::5])
    monkeypatch.setattr(scan3d, "scan", smaller(scan3d.scan, slices=2, sweeps=3, samples=8))
    drawn = ["one_sweep", "paper_figure_3", "paper_figure_4", "paper_figure_5", "what_a_rod_reaches", "whisker"]
    run = ["friction_from_touch", "rod_for_a_sensor", "sphere_off_equator"]
    assert [name for name in SCRIPTS if name not in drawn + run and f"test_{name}" not in globals()] == []
    for name in drawn:
        figure = example(name).draw()
        assert isinstance(figure, Figure)
        figure.canvas.draw()
    for name in run:
        check_picture(example(name), tmp_path)


@pytest.mark.rendering
def test_the_notebook_runs(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(EXAMPLES)
    notebook = json.loads((EXAMPLES / "from_mesh_to_surface.ipynb").read_text(encoding="utf-8"))
    code = ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]
    exec("\n".join(code).replace("slices=24", "slices=6, samples=16"), {})
    within, truth = map(float, re.findall(r"([\d.e-]+) mm", capsys.readouterr().out.splitlines()[-1]))
    assert 0 < truth < within


def test_one_sweep() -> None:
    script = example("one_sweep")
    assert script.largest_error < 1e-13
    assert script.largest_turn < 1e-12
    assert script.friction == pytest.approx(0.3, abs=1e-12)
    header, _, *rows = script.table().splitlines()
    assert header.count("|") == 6
    for row, known in zip(rows, TABLE.values(), strict=True):
        expected = [known.to_tangential_x0, known.to_tip_x0, known.snap_off_x0]
        assert [float(cell.split(",")[0]) for cell in row.split("|")[3:6]] == pytest.approx(expected, abs=1e-6)


def test_whisker(monkeypatch: pytest.MonkeyPatch) -> None:
    script = example("whisker")
    sweep, contacts = script.read(script.whisker, script.whisker, script.ellipse)
    pressed = np.hypot(sweep.f0x, sweep.f0y) > 0.01
    assert np.abs(contacts.point - sweep.point)[pressed].max() < 1e-8
    # the figures of the manual, of which two suffice
    monkeypatch.setattr(
        script, "NEARLY", {name: script.NEARLY[name] for name in ("tip 10 % thinner", "curvature 0.02/L")}
    )
    rows = script.table().splitlines()[2:]
    manual = (EXAMPLES.parent / "docs" / "rig.md").read_text(encoding="utf-8")
    assert all(row in manual for row in rows)


def test_live_contacts(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(scan3d, "Plan", smaller(scan3d.Plan, samples=12))
    live = example("live_contacts").main([])
    page, *lines, last = capsys.readouterr().out.splitlines()
    assert page.startswith("http://127.0.0.1:")
    said = f"{len(live.cloud)} of {len(live.contacts)} contacts are left in the cloud of {len(live.recording)} rows"
    assert last == said
    assert len(lines) >= len(live.cloud) > 100


def test_live_ros(monkeypatch: pytest.MonkeyPatch) -> None:
    ros = MagicMock()  # in the place of ROS, with messages that keep what is written
    for name in ("rclpy", "rclpy.node", "rclpy.qos", "rclpy.time", "geometry_msgs", "sensor_msgs", "tf2_ros"):
        monkeypatch.setitem(sys.modules, name, ros)
    for name in ("geometry_msgs.msg", "sensor_msgs.msg"):
        monkeypatch.setitem(sys.modules, name, ros)
    ros.Node = type("Node", (), {"__init__": lambda *_: None, "__getattr__": lambda *_: MagicMock()})
    ros.PoseWithCovarianceStamped.side_effect = lambda: MagicMock()
    ros.PointCloud2.side_effect = ros.PointField.side_effect = lambda **fields: MagicMock(**fields)
    ros.Time.from_msg.side_effect = lambda stamp: stamp.sec
    recording = scan3d.simulate(scan3d.load_mesh(EGG), scan3d.Plan(model="spatial", slices=2, sweeps=2, samples=16))
    node = example("live_ros").Contacts(recording)
    places, turns, (forces, moments) = recording.position_m, recording.quaternion[:, [1, 2, 3, 0]], recording.wrench()

    def vector(values: np.ndarray) -> SimpleNamespace:
        return SimpleNamespace(**dict(zip("xyzw", values.tolist(), strict=False)))

    node.buffer.lookup_transform.side_effect = lambda base, frame, k: SimpleNamespace(
        transform=SimpleNamespace(translation=vector(places[k]), rotation=vector(turns[k]))
    )
    node.buffer.can_transform.side_effect = lambda base, frame, k: k > 0 or arrived
    for k in range(len(recording)):
        arrived = k > 4  # the first transform comes late
        message = MagicMock()
        message.header.stamp.sec, message.header.stamp.nanosec = k, 0
        message.wrench = SimpleNamespace(force=vector(forces[k]), torque=vector(moments[k]))
        node.take(message)
        assert arrived or not node.contact.publish.called
    found = [call.args[0].pose.pose.position for call in node.contact.publish.call_args_list]
    live = scan3d.Live(recording, unit="m")
    pushed = [
        live.push(k, places[k], recording.quaternion[k], np.append(forces[k], moments[k])) for k in range(len(places))
    ]
    points = [contact.point for contact in pushed if contact is not None]
    np.testing.assert_allclose([(one.x, one.y, one.z) for one in found], points, atol=1e-9)
    node.publish_cloud()
    (sent,) = node.cloud.publish.call_args.args
    rows = np.frombuffer(sent.data, dtype="<f4").reshape(sent.width, -1)
    np.testing.assert_allclose(rows[:, :3], points, atol=1e-6)


def test_gaussian_process(capsys: pytest.CaptureFixture[str]) -> None:
    example("gaussian_process").main([str(EGG), "--touches", "150"])
    _, _, by_process, by_scan3d = capsys.readouterr().out.splitlines()
    for row in (by_process, by_scan3d):
        assert 0 < float(re.findall(r"([\d.]+)%", row)[0]) < 5
    assert 50 < float(re.search(r"holds of (\d+)%", by_process)[1]) <= 100
    assert "at most" in by_scan3d


def test_mujoco_log() -> None:
    script = example("mujoco_log")
    if importlib.util.find_spec("mujoco") is None:
        with pytest.raises(SystemExit, match="pip install mujoco"):
            script.main([])
        return
    points = script.main([]).points[:, :2] / 1e3
    off = np.hypot(*(points - script.CENTRE_M).T) - script.RADIUS_M
    # two parts in a thousand of the rod: its links, its damping and the depth to which MuJoCo's bodies sink in
    assert np.abs(off).max() < 2e-3 * script.ROD.length_m


def test_methods_by_meshes(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(scan3d, "Plan", smaller(scan3d.Plan, samples=16))
    meshes = EXAMPLES.parent / "meshes"
    example("methods_by_meshes").main([str(meshes / "cube.stl"), "--slices", "8", "--spacing", "cosine"])
    header, rule, cube = capsys.readouterr().out.splitlines()
    named = dict(zip(header.split(" | "), cube.split(" | "), strict=True))
    assert rule == "|---" * (header.count("|") - 1) + "|"
    assert named["| body"] == "| cube"
    # the hull of the contacts is close to the cube, which is not smooth enough for a support function
    assert float(named["hull"].split(",")[0]) < 0.01
    assert named["support"] == "–"


@pytest.mark.open3d
def test_error_by_slices(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    script = example("error_by_slices")
    for method in ("bracket", "ball-pivoting"):  # which other tests compare with the hull
        monkeypatch.delitem(script.METHODS, method)
    # coarse, for what is compared are slices, not facets
    errors = script.measure(script.QUICK_SLICES, script.QUICK_SUBDIVISIONS)
    for curves in errors.values():
        assert (curves.bound > curves.hausdorff["hull"]).all()
        for method in ("hull", "poisson"):
            assert (np.diff(curves.hausdorff[method]) < 0).all()
        assert np.isfinite(curves.hausdorff["support"]).any()
    # the caps at the poles determine the error: half of it for twice the slices by even spacing, a quarter at Chebyshev's nodes
    few, many = (errors["uniform"].hausdorff["hull"][i] for i in (0, 1))
    assert few / many == pytest.approx(2, rel=0.02)
    few, many = (errors["cosine"].hausdorff["hull"][i] for i in (0, 1))
    assert few / many == pytest.approx(4, rel=0.1)
    # the legend names every curve, and the panels share their axes
    figure = script.figure(errors)
    assert len(figure.legends[0].get_texts()) == len(script.METHODS) + 1
    assert [len(axes.lines) for axes in figure.axes] == [len(script.METHODS) + 2] * 2
    measured = {(script.QUICK_SLICES, script.QUICK_SUBDIVISIONS): errors}
    monkeypatch.setattr(script, "measure", lambda *setting: measured[setting])
    check_picture(script, tmp_path, "--quick")


@pytest.mark.trust
def test_rig_loop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    script = example("rig_loop")
    results = script.measure(2)
    for rows in results.values():
        sweeps, bound, error = rows.T
        assert (np.diff(sweeps) > 0).all()
        assert (np.diff(bound) < 0).all()
        assert (error < bound).all()
    measured, exact = results.values()
    assert measured[-1, 1] < 1.5 * exact[-1, 1]
    monkeypatch.setattr(script, "measure", lambda batches: results)
    check_picture(script, tmp_path, "--quick")


def test_own_measurements(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    script = example("own_measurements")
    monkeypatch.setattr(scan3d, "Plan", smaller(scan3d.Plan, sweeps=5, samples=12))
    # the conversion to the laboratory's table and back loses nothing: the recording is that of the simulation
    script.laboratory(tmp_path / "table.csv", slices=4)
    header, *rows = (tmp_path / "table.csv").read_text().splitlines()
    assert tuple(header.split(",")) == script.COLUMNS
    made = script.recording(tmp_path / "table.csv")
    assert len(made) == len(rows)
    mesh = scan3d.load_mesh(script.MESH)
    plan = scan3d.Plan(slices=4, spacing="adaptive", friction=(0.1, 0.4), rod=script.ROD)
    straight = scan3d.simulate(mesh, plan)
    for name in ("position_m", "force_N", "moment_Nm"):
        np.testing.assert_allclose(getattr(made, name), getattr(straight, name), rtol=0, atol=1e-15)
    np.testing.assert_allclose(made.axes(), straight.axes(), rtol=0, atol=1e-15)
    # and so does that by a map, of a body on a turntable
    data = {
        "columns": {
            "sweep": "sweep",
            "position": ["-travel_mm", "-distance_mm", "height_mm"],
            "position_in": "clamp",
            "orientation": {"euler": ["turn_deg"], "convention": "z"},
            "force": ["across_mN", "along_mN"],
            "moment": ["moment_uNm"],
        },
        "units": {"length": "mm", "force": "mN", "moment": "uN m"},
        "sensor": {"shows": "rod-on-clamp"},
        "tare": {"air": "none"},
        "rod": {"length_m": 0.06, "diameter_m": 0.3e-3, "modulus_Pa": 210e9},
    }
    found = scan3d.import_table(tmp_path / "table.csv", data)
    assert np.array_equal(found.sweep, made.sweep)
    assert found.rod == made.rod
    np.testing.assert_allclose(found.position_m, made.position_m, rtol=0, atol=1e-15)
    np.testing.assert_allclose(found.axes(), made.axes(), rtol=0, atol=1e-14)
    for name in ("force_N", "moment_Nm"):
        np.testing.assert_allclose(getattr(found, name), getattr(made, name), rtol=1e-14)

    monkeypatch.setattr(script.scanned, "__defaults__", (4,))
    check_picture(script, tmp_path)
    certified, known = (
        float(line) for line in re.findall(r"within ([0-9.e-]+) mm[;,] volume", capsys.readouterr().out)
    )
    assert known <= certified


def test_what_planarity_costs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    script = example("what_planarity_costs")
    at = {height: k for k, height in enumerate(script.HEIGHTS)}
    between = (script.HEIGHTS >= 0.25) & (script.HEIGHTS <= 0.75)
    for (_, friction), cost in script.COSTS.items():
        # from a quarter to three quarters of the height much is refused, and without friction nearly everything
        assert (cost.refused[between] > (0.25 if friction else 0.95)).all()
        assert (np.diff(cost.refused) > -0.05).all()
        assert cost.spatial.max() < 1e-10
        if not friction:
            continue
        # the others are off by per cents of the diagonal
        read = between & np.isfinite(cost.median)
        assert read.any()
        assert 0.012 < cost.median[read].min() <= cost.median[read].max() < 0.043
        assert 0.024 < cost.largest[read].min() <= cost.largest[read].max() < 0.062
        # and already in a slice nearly in the middle
        assert cost.median[at[0.02]] == pytest.approx(0.004, abs=0.0005)
    assert max(cost.out_of_plane[between].max() for cost in script.COSTS.values()) == pytest.approx(0.4, abs=0.01)
    check_picture(script, tmp_path)
    assert len(capsys.readouterr().out.splitlines()) == 2 + 4 * len(script.HEIGHTS)


def test_rod_that_slides_away(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    script = example("rod_that_slides_away")
    # (S23) says where the sweep without friction becomes unstable; on the sphere, in the middle
    np.testing.assert_allclose(script.MEASURED, script.LIMITS, rtol=0, atol=2e-4)
    assert script.LIMITS[script.RATIOS.index(1.0)] == pytest.approx(0, abs=1e-9)
    # friction slows the growth, which the estimate predicts to 30 %
    grown = [script.ON_SPHERE[friction][-1] for friction in (0.3, 0.6)]
    assert grown == pytest.approx([66, 6.5], rel=0.05)
    for friction, deviation in script.ON_SPHERE.items():
        known = np.isfinite(deviation)
        np.testing.assert_allclose(script.ESTIMATES[friction][known], deviation[known], rtol=0.3)
    check_picture(script, tmp_path)
    assert len(capsys.readouterr().out.splitlines()) == len(script.FRICTIONS) + len(script.RATIOS)
