"""ROS bags of both generations, written by rosbags for these tests."""

import shutil

import numpy as np
import pytest
import trimesh
from raw_tables import Rig, disturbed, map_of, sensed, track
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

import scan3d
from scan3d import InputError
from scan3d.laboratory.bags import is_bag
from scan3d.laboratory.importing import convert, load
from scan3d.laboratory.maps import read_map

RIG = Rig((0.0, 30.0, 0.0), (0.0, -20.0, 0.0), drift=0.0)
START = 1_700_000_000 * 10**9


@pytest.fixture(scope="module")
def recording():
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=15.0)
    return scan3d.simulate(mesh, scan3d.Plan(slices=2, sweeps=2, samples=20))


class Bag:
    def __init__(self, path, generation):
        self.first = generation == 1
        self.store = get_typestore(Stores.ROS1_NOETIC if self.first else Stores.ROS2_HUMBLE)
        name = "tf2_msgs/msg/TFMessage"
        if name not in self.store.types:
            self.store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", name))
        self.writer = Writer1(path) if self.first else Writer2(path, version=9)
        self.connections, self.count = {}, 0

    def stamp(self, ns, frame="world"):
        types = self.store.types
        time = types["builtin_interfaces/msg/Time"](sec=ns // 10**9, nanosec=ns % 10**9)
        more = {"seq": self.count} if self.first else {}
        return types["std_msgs/msg/Header"](stamp=time, frame_id=frame, **more)

    def make(self, name, *values):
        return self.store.types[name](*values)

    def put(self, topic, kind, ns, message):
        if topic not in self.connections:
            self.connections[topic] = self.writer.add_connection(topic, kind, typestore=self.store)
        serialize = self.store.serialize_ros1 if self.first else self.store.serialize_cdr
        self.count += 1
        # received a while after it was measured
        self.writer.write(self.connections[topic], ns + 5_000_000, serialize(message, kind))

    def wrench(self, topic, ns, values):
        force, torque = (self.make("geometry_msgs/msg/Vector3", *map(float, part)) for part in (values[:3], values[3:]))
        kind = "geometry_msgs/msg/WrenchStamped"
        self.put(topic, kind, ns, self.make(kind, self.stamp(ns), self.make("geometry_msgs/msg/Wrench", force, torque)))

    def pose(self, topic, ns, position, turn):
        place = self.make("geometry_msgs/msg/Point", *map(float, position))
        w, x, y, z = map(float, turn)
        kind = "geometry_msgs/msg/PoseStamped"
        pose = self.make("geometry_msgs/msg/Pose", place, self.make("geometry_msgs/msg/Quaternion", x, y, z, w))
        self.put(topic, kind, ns, self.make(kind, self.stamp(ns), pose))

    def transform(self, topic, ns, parent, child, position, turn):
        w, x, y, z = map(float, turn)
        shift = self.make("geometry_msgs/msg/Vector3", *map(float, position))
        inner = self.make("geometry_msgs/msg/Transform", shift, self.make("geometry_msgs/msg/Quaternion", x, y, z, w))
        one = self.make("geometry_msgs/msg/TransformStamped", self.stamp(ns, parent), child, inner)
        kind = "tf2_msgs/msg/TFMessage"
        self.put(topic, kind, ns, self.make(kind, [one]))


def written(path, generation, log, poses, static=(0,), parents=("flange",)):
    """A bag with the wrenches of a log at 1 kHz, and its poses by 'pose' or 'tf' at the same times.

    The static transform is published at the rows `static`, in `parents` in turn.
    """
    values, _ = disturbed(sensed(log.wrench, RIG), RIG)
    bag = Bag(path, generation)
    flange = Rotation.from_euler("xyz", [0.3, -0.2, 0.5])
    offset = np.array([0.01, -0.02, 0.03])
    with bag.writer:
        for k, ns in enumerate((START + np.round(log.time * 1e9).astype(np.int64)).tolist()):
            bag.wrench("/ft", ns, values[k])
            if poses == "tf" and k in static:
                parent = parents[k % len(parents)]
                bag.transform("/tf_static", ns, parent, "clamp", offset, flange.as_quat(scalar_first=True))
            if poses == "pose":
                bag.pose("/tool", ns, log.position[k], log.quaternion[k])
            else:
                turn = Rotation.from_quat(log.quaternion[k], scalar_first=True) * flange.inv()
                place = log.position[k] - turn.apply(offset)
                bag.transform("/tf", ns, "world", "flange", place, turn.as_quat(scalar_first=True))
    return path


def made(recording, ros):
    data = map_of(recording.rod, RIG)
    del data["columns"], data["units"]
    return data | {"ros": ros}


@pytest.mark.slow
@pytest.mark.parametrize(("generation", "poses"), [(1, "tf"), (2, "pose")])
def test_a_bag_gives_the_recording_back(tmp_path, recording, generation, poses):
    log = track(recording, air=25)
    path = written(tmp_path / ("run.bag" if generation == 1 else "run"), generation, log, poses)
    assert is_bag(path)
    back = scan3d.import_table(path, made(recording, {"tf": ["world", "clamp"]} if poses == "tf" else {}))
    rows = log.row[log.row >= 0]
    assert back.six_axis
    assert back.source["table"] == path.name
    assert back.position_m == pytest.approx(recording.position_m[rows], abs=1e-12)
    assert np.abs(back.axes() - recording.axes()[rows]).max() < 1e-12
    assert back.force_N == pytest.approx(recording.force_N[rows], abs=1e-12)
    assert back.moment_Nm == pytest.approx(recording.moment_Nm[rows], abs=1e-14)


def test_static_transforms_hold_for_all_times(tmp_path, recording):
    log = track(recording, air=25)
    path = written(tmp_path / "run", 2, log, "tf", static=(20, 23, 40))
    map = read_map(made(recording, {"tf": ["world", "clamp"]}))
    summary = convert(load(path, map), map).summary
    assert (summary.rows, summary.left_out["without a pose"]) == (len(log.time), 0)


@pytest.mark.slow
def test_topics_that_are_not_there(tmp_path, recording):
    log, world = track(recording, air=25), ["world", "clamp"]
    written(tmp_path / "run", 2, log, "pose")
    written(tmp_path / "tf.bag", 1, log, "tf")
    written(tmp_path / "several", 2, log, "tf", static=(0, 1), parents=("flange", "camera"))
    (tmp_path / "cut.bag").write_bytes((tmp_path / "tf.bag").read_bytes()[:50])
    for name, ros, sentence in (
        ("run", {"wrench": "/ftt"}, r"run has no topic '/ftt' of WrenchStamped, .*; it has /ft; did you mean /ft\?"),
        ("run", {"tf": world}, r"run: tf has no chain from 'world' to 'clamp'.*it has no frames"),
        ("run", {"pose": "/a", "tf": world}, r"\[ros\] tf and pose can't both be given"),
        ("tf.bag", {}, r"tf\.bag has no topic of PoseStamped; record one, or name the frames of tf"),
        ("tf.bag", {"tf": ["wrld", "clamp"]}, r"no chain from 'wrld' to 'clamp'.*; did you mean world"),
        ("tf.bag", {"tf": ["flange", "clamp"]}, r"nothing moves between 'flange' and 'clamp' in tf"),
        ("several", {"tf": world}, r"several: tf has 'clamp' in several frames, flange, camera, where one is"),
        ("cut.bag", {}, r"can't read the bag .*cut\.bag"),
        ("none.bag", {}, r"can't read the bag .*none\.bag: No such file"),
    ):
        with pytest.raises(InputError, match=sentence):
            scan3d.import_table(tmp_path / name, made(recording, ros))


def test_without_rosbags_the_message_says_what_to_install(tmp_path, recording, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "rosbags.highlevel", None)
    with pytest.raises(InputError, match=r"ROS bags need rosbags: pip install 'scan3d\[ros\]'"):
        scan3d.import_table(tmp_path / "run.bag", made(recording, {}))


def test_what_a_killed_recorder_leaves(tmp_path, recording):
    """Without metadata.yaml, in one file or in numbered ones, and cut off, with the command that saves what is whole."""
    log, map = track(recording, air=25), made(recording, {})
    whole = scan3d.import_table(written(tmp_path / "run", 2, log, "pose"), map)
    (tmp_path / "run" / "metadata.yaml").unlink()
    assert is_bag(tmp_path / "run")
    assert np.array_equal(scan3d.import_table(tmp_path / "run", map).position_m, whole.position_m)
    (tmp_path / "run" / "run.db3").rename(tmp_path / "run" / "run_0.db3")
    shutil.copy(tmp_path / "run" / "run_0.db3", tmp_path / "run" / "other.db3")
    data = (tmp_path / "run" / "run_0.db3").read_bytes()
    with Writer2(tmp_path / "m", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        writer.add_connection("/ft", "geometry_msgs/msg/WrenchStamped", typestore=get_typestore(Stores.ROS2_HUMBLE))
    mcap = (tmp_path / "m" / "m.mcap").read_bytes()
    (tmp_path / "parts").mkdir()
    # of several files the one that is cut, and files under the names that a recorder gives them while it writes or compresses
    for name, written_so_far in (
        ("cut.db3", data[: len(data) // 2]),
        ("cut.mcap", mcap[:-9]),
        ("parts/m_0.mcap", mcap),
        ("parts/m_1.mcap", mcap[:-9]),
        ("x.bag.active", data),
        ("x.db3.zstd", data),
    ):
        (tmp_path / name).write_bytes(written_so_far)
    for name, sentence in (
        ("run", r"several bags, other\.db3, run_0\.db3, where one is expected; name one"),
        ("cut.db3", r"cut off, as when its recorder was killed: sqlite3 cut\.db3"),
        ("cut.mcap", r"killed: mcap recover cut\.mcap"),
        ("parts", r"mcap recover m_1\.mcap"),
        ("x.bag.active", r"mv x\.bag\.active x\.bag; rosbag reindex x\.bag"),
        ("x.db3.zstd", "zstd -d x"),
    ):
        with pytest.raises(InputError, match=sentence):
            scan3d.import_table(tmp_path / name, map)


@pytest.mark.parametrize(("kind", "ros"), [("Wrench", {}), ("Wrench", {"wrench": "ft"}), ("Pose", {})])
def test_messages_without_a_stamp_are_named(tmp_path, recording, kind, ros):
    bag = Bag(tmp_path / "run", 2)
    with bag.writer:
        bag.writer.add_connection("/ft", f"geometry_msgs/msg/{kind}", typestore=bag.store)
        if ros or kind == "Pose":
            bag.wrench("/wrench", START, range(6))
    with pytest.raises(InputError, match=rf"/ft is a {kind}, which has no time of .*; record it as {kind}Stamped"):
        scan3d.import_table(tmp_path / "run", made(recording, ros))


def test_the_number_of_messages_is_known_before_the_work(tmp_path, recording, monkeypatch):
    path = written(tmp_path / "run", 2, track(recording, air=25), "pose")
    monkeypatch.setattr("scan3d.workers.memory_bytes", lambda: 1e5)
    with pytest.raises(InputError, match="reading run needs about"):
        scan3d.import_table(path, made(recording, {}))
