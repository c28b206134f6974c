"""Logs of rigs that probe, with and without sweeps between, come back as the contacts that the rig felt."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from raw_tables import write

import scan3d
from scan3d import InputError
from scan3d.files.recordings import RAW_COLUMNS
from scan3d.files.text import rod_section
from scan3d.geometry.distance import distances
from scan3d.laboratory.importing import convert, load
from scan3d.laboratory.maps import read_map
from scan3d.planning.rig import RigPlan, parse_envelope, plan_poses
from scan3d.poses import MOVES, Move
from scan3d.simulation.rig import Faults, Place, Size, simulate_rig, standing

pytestmark = pytest.mark.slow

AROUND = "cylinder:76x46"
PLACE = Place((3.0, -20.0, 1.0), (10.0, 30.0, -5.0))
FAULTS = Faults(
    rate_hz=40, sensor=PLACE, shows="rod-on-clamp", bias=Size(fraction=0.5), drift=Size(fraction=0.05),
    noise=Size(2e-6, 2e-7), jitter_um=10, lag_ms=5,
)  # fmt: skip


@cache
def mug():
    return standing(scan3d.load_mesh("meshes/hollow/mug.stl"))


@cache
def poses(kind):
    """Some of the planned probings, sweeps in one slice, or these after those."""
    rod = scan3d.Rod(0.09, 4e-4)
    plan = RigPlan(parse_envelope(AROUND), probing=kind != "sweeps", rod=rod, slices=1, samples=24, speed=200.0)
    planned = plan_poses(plan)
    if kind == "sweeps":
        return planned
    few = planned.sweep % 12 == 0
    chosen = replace(
        planned, **{name: getattr(planned, name)[few] for name in ("sweep", "position_m", "quaternion", "move")}
    )
    if kind == "probings":
        return chosen
    swept = poses("sweeps")
    columns = {
        name: np.concatenate([getattr(chosen, name), getattr(swept, name)])
        for name in ("position_m", "quaternion", "move")
    }
    return replace(chosen, sweep=np.concatenate([chosen.sweep, swept.sweep + 10_000]), **columns)


@cache
def log(kind, faults=FAULTS):
    return simulate_rig(mug(), poses(kind), faults=faults, friction=(0.0, 0.3), model="planar")


def columns_of(kind, faults=FAULTS):
    """A table as `scan3d simulate` writes it, with the moves."""
    found = log(kind, faults)
    values = [
        found.time_s,
        *(1e3 * found.position_m.T),
        *found.quaternion.T,
        *found.wrench.T[:3],
        *(1e3 * found.wrench.T[3:]),
    ]
    return dict(zip(RAW_COLUMNS, [*values, found.sweep], strict=True)) | {"move": np.array(MOVES)[found.move]}


def map_of(*told, **sections):
    data = {
        "columns": {
            "time": "t_s",
            "position": ["x_mm", "y_mm", "z_mm"],
            "orientation": {"quaternion": ["qw", "qx", "qy", "qz"]},
            "force": ["Fx_N", "Fy_N", "Fz_N"],
            "moment": ["Tx_Nmm", "Ty_Nmm", "Tz_Nmm"],
            **{name: name for name in told},
        },
        "units": {"length": "mm", "force": "N", "moment": "N mm"},
        "sensor": {"position_mm": list(PLACE.position_mm), "euler_deg": list(PLACE.euler_deg), "shows": "rod-on-clamp"},
        "rod": rod_section(log("probings").rod),
    }
    return read_map(data | sections)


def imported(folder, columns, chosen):
    return convert(load(write(folder / "raw.csv", columns), chosen), chosen)


@pytest.fixture(scope="module", params=["probings", "both"])
def kind(request):
    return request.param


@pytest.mark.parametrize(
    ("kind", "told"),
    [
        pytest.param(kind, told, marks=pytest.mark.trust if (i + k) % 2 else ())
        for i, kind in enumerate(["probings", "both"])
        for k, told in enumerate([(), ("sweep",), ("move",), ("sweep", "move")])
    ],
)
def test_what_was_probed_comes_back(tmp_path, kind, told):
    raw = log(kind)
    found = imported(tmp_path, columns_of(kind), map_of(*told))
    recording, felt = found.recording, raw.move == Move.PROBE
    numbers = [np.unique(raw.sweep[felt]), np.unique(raw.sweep[raw.move == Move.SWEEP])]
    assert found.summary.probings == len(np.unique(recording.sweep[recording.in_probings]))
    assert len(numbers[0]) * 0.98 <= found.summary.probings <= len(numbers[0])
    assert found.summary.sweeps == found.summary.probings + len(numbers[1])
    cloud = scan3d.reconstruct(recording, model="planar")
    exact = scan3d.reconstruct(simulate_rig(mug(), poses(kind), friction=(0.0, 0.3)).recording(), model="planar")
    assert 0.95 * exact.probed.sum() <= cloud.probed.sum() <= 1.02 * exact.probed.sum()
    assert np.percentile(distances(cloud.points[cloud.probed], mug()), 99) < 0.005 * cloud.rod_length
    assert cloud.probed.all() == (kind == "probings")


def test_thinned_and_filtered_logs_keep_what_was_felt(tmp_path, kind):
    plain = imported(tmp_path, columns_of(kind), map_of())
    thinned = imported(tmp_path, columns_of(kind), map_of(filter={"rate_hz": 8}))
    assert len(thinned.recording) < 0.4 * len(plain.recording)
    assert thinned.summary.sweeps_with_contact >= 0.98 * plain.summary.sweeps_with_contact


def test_moves_that_can_not_be_right_are_refused(tmp_path):
    columns = columns_of("both")
    row = int(np.argmax(columns["move"] == "probe"))
    wrong = columns["move"].copy()
    wrong[row] = "poke"
    with pytest.raises(
        InputError, match=rf"raw\.csv: line {row + 2} has 'poke' in column 'move', where one of approach, .*probe"
    ):
        imported(tmp_path, columns | {"move": wrong}, map_of("move"))
    wrong[row] = "sweep"
    with pytest.raises(
        InputError, match=r"line \d+ has the move probe in column 'sweep' .*number sweeps and probings apart"
    ):
        imported(tmp_path, columns | {"move": wrong}, map_of("move", "sweep"))
    exchanged = np.where(
        columns["move"] == "probe", "sweep", np.where(columns["move"] == "sweep", "probe", columns["move"])
    )
    with pytest.raises(InputError, match=r"runs of rows with the move probe the clamp does not go straight along \+y"):
        imported(tmp_path, columns | {"move": exchanged}, map_of("move"))


def test_sweeps_that_a_wrong_frame_makes_look_like_probings_are_none(tmp_path):
    columns = columns_of("sweeps")
    turned = map_of("sweep", clamp={"position_mm": [0, 0, 0], "euler_deg": [0, 0, 90]})
    with pytest.raises(InputError, match=r"the clamp moves .*mostly along .y of its own frame"):
        imported(tmp_path, columns, turned)


def test_sweeps_alone_have_no_probings(tmp_path):
    for told in ((), ("sweep",), ("move",)):
        found = imported(tmp_path, columns_of("sweeps"), map_of(*told))
        assert found.summary.probings == 0
        assert not found.recording.in_probings.any()


def test_probings_that_touch_nothing_need_their_moves(tmp_path):
    """Of such a log it was said that all would be right with another orientation, in which nothing is touched either."""
    columns, rng = columns_of("probings"), np.random.default_rng(0)
    columns |= {name: 1e-6 * rng.standard_normal(len(values)) for name, values in columns.items() if name[0] in "FT"}
    with pytest.raises(InputError, match="name the column of the moves") as refused:
        imported(tmp_path, columns, map_of())
    assert "all would be right" not in str(refused.value)
    assert imported(tmp_path, columns, map_of("move")).summary.probings > 100


def test_a_rod_whose_thickness_is_left_out_is_told():
    told = "the simulated rod has no thickness, because of the body that is not convex"
    for diameter in (0.0, 0.0005):
        thick = replace(poses("probings"), rod=scan3d.Rod(0.09, 4e-4, diameter))
        warnings = simulate_rig(mug(), thick, model="planar").warnings
        assert any(told in sentence for sentence in warnings) == (diameter > 0)
