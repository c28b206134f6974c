"""ROS bags of both generations as tables, by `rosbags`, which is optional.

The rows are the wrenches (``geometry_msgs/WrenchStamped``); poses come from ``geometry_msgs/PoseStamped`` or from tf and are
interpolated at the times of the wrenches: positions linearly, orientations along great circles.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from scan3d.arrays import Array
from scan3d.errors import InputError
from scan3d.files.reading import did_you_mean
from scan3d.files.text_tables import Table
from scan3d.laboratory.maps import Topics

_WRENCH, _POSE, _TF = "WrenchStamped", "PoseStamped", "TFMessage"
NAMES = ("t", "x", "y", "z", "qw", "qx", "qy", "qz", "Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
"""Columns of the table of a bag, in SI units."""


class _Poses(NamedTuple):
    """Poses at times in ns (k,): positions (k, 3) and orientations (k, 4), w first."""

    time: NDArray[np.int64]
    position: Array
    quaternion: Array


def is_bag(path: str | Path) -> bool:
    """Whether a path is a ROS bag: a .bag, a folder with metadata.yaml, or a file of such a folder."""
    path = Path(path)
    return path.suffix in (".bag", ".db3", ".mcap") or (path.is_dir() and (path / "metadata.yaml").exists())


def read_bag(path: str | Path, topics: Topics) -> Table:
    """The table of a bag, with the columns `NAMES`.  Raises InputError if rosbags is missing or a topic can't be found."""
    path = Path(path)
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise InputError("ROS bags need rosbags: pip install 'scan3d[ros]', or export the topics as a table") from None
    folder = path.parent if path.suffix in (".db3", ".mcap") and (path.parent / "metadata.yaml").exists() else path
    try:
        with AnyReader([folder], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            wrench_topic = _topic(path.name, reader, _WRENCH, topics.wrench, "wrench")
            stamps, values = _wrenches(reader, wrench_topic)
            if topics.frames is not None:
                poses = _by_tf(path.name, reader, *topics.frames)
            else:
                poses = _stamped(reader, _topic(path.name, reader, _POSE, topics.pose, "pose"))
    except (AnyReaderError, OSError) as error:
        raise InputError(f"can't read the bag {path}: {error}") from None
    covered = (
        (stamps >= poses.time[0]) & (stamps <= poses.time[-1]) if len(poses.time) > 1 else np.ones(len(stamps), bool)
    )
    if not covered.any():
        raise InputError(
            f"{path.name}: the poses and the wrenches have no time in common; check the clocks, and [ros] of the map"
        )
    stamps, values = stamps[covered], values[covered]
    position, quaternion = _at(poses, stamps)
    seconds = (stamps - stamps[0]) * 1e-9
    table = np.column_stack([seconds, position, quaternion, values])
    return Table(path.name, NAMES, tuple(np.ascontiguousarray(column) for column in table.T))


def _topic(name: str, reader: Any, kind: str, given: str, entry: str) -> str:
    """The topic that is given, or the only one of a kind."""
    found = sorted({c.topic for c in reader.connections if c.msgtype.split("/")[-1] == kind})
    if given:
        if given not in found:
            raise InputError(
                f"{name} has no topic {given!r} of {kind}, which [ros] {entry} of the map names; it has "
                f"{', '.join(found) or 'none'}{did_you_mean([given], found)}"
            )
        return given
    if len(found) != 1:
        which = f"has several topics of {kind}: {', '.join(found)}" if found else f"has no topic of {kind}"
        further = ", or the frames of tf as tf = ['world', 'clamp']" if entry == "pose" else ""
        raise InputError(f"{name} {which}; name one as {entry} under [ros] of the map{further}")
    return str(found[0])


def _messages(reader: Any, topic: str) -> Any:
    connections = [c for c in reader.connections if c.topic == topic]
    for connection, received, raw in reader.messages(connections=connections):
        yield received, reader.deserialize(raw, connection.msgtype)


def _stamp(message: Any, received: int) -> int:
    """The time of measurement in ns, or that of reception if the message does not state it."""
    stamp = message.header.stamp
    return int(stamp.sec) * 10**9 + int(stamp.nanosec) or received


def _wrenches(reader: Any, topic: str) -> tuple[NDArray[np.int64], Array]:
    stamps, values = [], []
    for received, message in _messages(reader, topic):
        force, torque = message.wrench.force, message.wrench.torque
        stamps.append(_stamp(message, received))
        values.append((force.x, force.y, force.z, torque.x, torque.y, torque.z))
    return np.array(stamps, dtype=np.int64), np.array(values, dtype=np.float64).reshape(-1, 6)


def _stamped(reader: Any, topic: str) -> _Poses:
    stamps: list[int] = []
    values: list[tuple[float, ...]] = []
    for received, message in _messages(reader, topic):
        position, turn = message.pose.position, message.pose.orientation
        stamps.append(_stamp(message, received))
        values.append((position.x, position.y, position.z, turn.w, turn.x, turn.y, turn.z))
    return _poses(stamps, values)


def _poses(stamps: list[int], values: list[tuple[float, ...]]) -> _Poses:
    """Poses in the order of time, each time once."""
    time, first = np.unique(np.array(stamps, dtype=np.int64), return_index=True)
    table = np.array(values, dtype=np.float64).reshape(-1, 7)[first]
    return _Poses(time, table[:, :3], table[:, 3:])


def _by_tf(name: str, reader: Any, world: str, clamp: str) -> _Poses:
    """The poses of one frame in another, along the chain of transforms between them."""
    edges: dict[str, tuple[str, list[int], list[tuple[float, ...]]]] = {}
    for connection in (c for c in reader.connections if c.msgtype.split("/")[-1] == _TF):
        for received, message in _messages(reader, connection.topic):
            for one in message.transforms:
                parent, child = one.header.frame_id.lstrip("/"), one.child_frame_id.lstrip("/")
                shift, turn = one.transform.translation, one.transform.rotation
                edge = edges.setdefault(child, (parent, [], []))
                edge[1].append(_stamp(one, received))
                edge[2].append((shift.x, shift.y, shift.z, turn.w, turn.x, turn.y, turn.z))
    chain: list[_Poses] = []
    frame = clamp.lstrip("/")
    while frame != world.lstrip("/") and frame in edges and len(chain) <= len(edges):
        chain.append(_poses(*edges[frame][1:]))
        frame = edges[frame][0]
    if frame != world.lstrip("/"):
        known = sorted({*edges, *(edge[0] for edge in edges.values())})
        raise InputError(
            f"{name}: tf has no chain from {world!r} to {clamp!r}, which [ros] tf of the map names; it has "
            f"{', '.join(known) or 'no frames'}{did_you_mean([world, clamp], known)}"
        )
    moving = [poses for poses in chain if len(poses.time) > 1]
    if not moving:
        raise InputError(f"{name}: nothing moves between {world!r} and {clamp!r} in tf; check [ros] tf of the map")
    start, end = max(poses.time[0] for poses in moving), min(poses.time[-1] for poses in moving)
    time = np.unique(np.concatenate([poses.time for poses in moving]))
    time = time[(time >= start) & (time <= end)]
    position, turn = np.zeros((len(time), 3)), Rotation.identity(len(time))
    for poses in chain:  # from the clamp to the world
        shift, quaternion = _at(poses, time)
        outer = Rotation.from_quat(quaternion, scalar_first=True)
        position, turn = shift + outer.apply(position), outer * turn
    return _Poses(time, position, turn.as_quat(scalar_first=True))


def _at(poses: _Poses, time: NDArray[np.int64]) -> tuple[Array, Array]:
    """Positions (n, 3) and orientations (n, 4) at times (n,) in ns; a single pose holds for all times."""
    if len(poses.time) == 1:
        return np.repeat(poses.position, len(time), axis=0), np.repeat(poses.quaternion, len(time), axis=0)
    seconds, at = (poses.time - poses.time[0]) * 1e-9, (time - poses.time[0]) * 1e-9
    position = np.stack([np.interp(at, seconds, column) for column in poses.position.T], axis=1)
    turns = Slerp(seconds, Rotation.from_quat(poses.quaternion, scalar_first=True))
    return position, turns(np.clip(at, seconds[0], seconds[-1])).as_quat(scalar_first=True)
