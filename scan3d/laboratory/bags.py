"""ROS bags of both generations as tables, by `rosbags`, which is optional.

The rows are the wrenches (``geometry_msgs/WrenchStamped``); poses come from ``geometry_msgs/PoseStamped`` or from tf and are
interpolated at the times of the wrenches: positions linearly, orientations along great circles.  Transforms on /tf_static, and
those that never change, hold for all times.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from scan3d.arrays import Array
from scan3d.errors import InputError
from scan3d.files.tables import Layout, Table
from scan3d.files.text import check_readable, did_you_mean
from scan3d.workers import check_memory

if TYPE_CHECKING:
    from scan3d.laboratory.maps import Topics

# The files of ROS 2, and the memory for a message of a pose or a wrench: a dozen numbers, as Python has them.
_PARTS, _MEMORY_PER_MESSAGE = (".db3", ".mcap"), 600
# Files that recorders leave when they are killed, or compress, and the command that makes a bag of each.
_TO_MAKE_WHOLE = {
    ".bag.active": "its recorder was killed: mv {0} {1}.bag; rosbag reindex {1}.bag",
    ".db3.zstd": "it is compressed: zstd -d {0}",
    ".mcap.zstd": "it is compressed: zstd -d {0}",
}
_WRENCH, _POSE, _TF = "WrenchStamped", "PoseStamped", "TFMessage"
NAMES = ("t", "x", "y", "z", "qw", "qx", "qy", "qz", "Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
"""Columns of the table of a bag, in SI units."""


class _Poses(NamedTuple):
    """Poses at times in ns (k,): positions (k, 3), NaN where the pose is not known, and orientations (k, 4), w first."""

    time: NDArray[np.int64]
    position: Array
    quaternion: Array


def is_bag(path: str | Path) -> bool:
    """Whether a path is a ROS bag: a .bag, a folder with metadata.yaml or with files of ROS 2, or one of these files."""
    path = Path(path)
    if not path.is_dir():
        return path.name.endswith((".bag", *_PARTS, *_TO_MAKE_WHOLE))
    endings = (*_PARTS, *_TO_MAKE_WHOLE)
    return (path / "metadata.yaml").exists() or any(file.name.endswith(endings) for file in path.iterdir())


def bag_files(path: Path) -> list[Path]:
    """The folder or the files of a bag.

    A recorder that was killed has left no metadata.yaml, but files that are numbered.  Raises InputError if the bag is not
    there, if a part of it is a device or a pipe, and if a folder holds files that are not parts of one bag.
    """
    for ending, command in _TO_MAKE_WHOLE.items():
        compressed = [path] if path.is_file() else [] if (path / "metadata.yaml").exists() else path.glob(f"*{ending}")
        for file in (file for file in compressed if file.name.endswith(ending)):
            raise InputError(f"can't read {file.name} as it is: {command.format(file.name, file.name[: -len(ending)])}")
    folder = path.parent if path.suffix in _PARTS and (path.parent / "metadata.yaml").exists() else path
    try:
        files = sorted(folder.iterdir()) if folder.is_dir() else [folder]
        for file in files:
            if not file.is_dir():
                check_readable(file, memory_per_byte=0)  # bags are read message by message
    except OSError as error:
        raise InputError(f"can't read the bag {path}: {error.strerror or error}") from None
    if folder / "metadata.yaml" in files or not folder.is_dir():
        return [folder]
    parts = [file for file in files if file.suffix in _PARTS]
    if len({re.sub(r"_\d+$", "", file.stem) for file in parts}) > 1:
        raise InputError(
            f"{path} has no metadata.yaml, and several bags, {', '.join(file.name for file in parts)}, where one is expected; "
            "name one of the files"
        )
    return parts


def _is_cut(file: Path) -> bool:
    """Whether a file of a bag can't be read by itself."""
    from rosbags.highlevel import AnyReader

    try:
        with AnyReader([file]):
            return False
    except Exception:  # as in `read_bag`
        return True


def read_bag(path: str | Path, topics: Topics) -> Table:
    """The table of a bag, with the columns `NAMES`.  Raises InputError if rosbags is missing or a topic can't be found."""
    path = Path(path)
    try:
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise InputError("ROS bags need rosbags: pip install 'scan3d[ros]', or export the topics as a table") from None
    files = bag_files(path)
    try:
        with AnyReader(files, default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            count = sum(one.msgcount for one in reader.connections)
            check_memory(
                _MEMORY_PER_MESSAGE * count, f"reading {path.name}", "record less, or only the topics that are needed"
            )
            topic = _topic(path.name, reader, _WRENCH, topics.wrench, "wrench")
            stamped, values = _samples(path.name, reader, topic, _wrench)
            if topics.frames is None:
                topic = _topic(path.name, reader, _POSE, topics.pose, "pose")
                poses = _poses(*_samples(path.name, reader, topic, _stamped_pose))
            else:
                edges = _transforms(path.name, reader)
    except InputError:
        raise
    except Exception as error:  # rosbags has one of its own in each part; a damaged length gives a MemoryError
        what, file = " ".join(str(error).split()) or type(error).__name__, next(filter(_is_cut, files), files[0])
        command = {
            ".bag": f"rosbag reindex {file.name}",
            ".mcap": f"mcap recover {file.name} -o whole.mcap",
            ".db3": f"sqlite3 {file.name} .recover | sqlite3 whole.db3",
        }.get(file.suffix, f"ros2 bag reindex {file.name}")
        raise InputError(
            f"can't read the bag {path}: {what.removesuffix('.')}; if it is cut off, as when its recorder was killed: {command}"
        ) from None
    if topics.frames is not None:
        poses = _by_tf(path.name, edges, *topics.frames)
    if np.isnan(poses.position).all():
        raise InputError(
            f"{path.name}: all poses have a quaternion of length 0, or no numbers; the bag states no orientation"
        )
    stamps = np.array(stamped, dtype=np.int64)
    position, quaternion = _at(poses, stamps)
    known = np.isfinite(position).all(axis=1)
    if not known.any():
        raise InputError(
            f"{path.name}: the poses and the wrenches have no time in common; check the clocks, and [ros] of the map"
        )
    seconds = (stamps - stamps[known][0]) * 1e-9
    table = np.column_stack([seconds, position, quaternion, values])[known]
    columns = tuple(np.ascontiguousarray(column) for column in table.T)
    return Table(path.name, NAMES, columns, layout=Layout(), left_out={"without a pose": int((~known).sum())})


def _topic(name: str, reader: Any, kind: str, given: str, entry: str) -> str:
    topics = {c.topic: c.msgtype.split("/")[-1] for c in reader.connections}
    found = sorted(topic for topic in topics if topics[topic] == kind)
    bare = kind.removesuffix("Stamped")
    unstamped = [topic for topic in topics if topics[topic] == bare]
    if unstamped and (not found or f"/{given.lstrip('/')}" in unstamped):
        raise InputError(
            f"{name} has no topic of {kind} for [ros] {entry} of the map: {unstamped[0]} is a {bare}, which has no time of "
            f"measurement; record it as {kind}"
        )
    if given:
        given = given if given in found else f"/{given.lstrip('/')}"  # also without the first slash
        if given not in found:
            raise InputError(
                f"{name} has no topic {given!r} of {kind}, which [ros] {entry} of the map names; it has "
                f"{', '.join(found) or 'none'}{did_you_mean([given], found)}"
            )
        return given
    if len(found) != 1:
        which = (
            f"has several topics of {kind}: {', '.join(found)}; name" if found else f"has no topic of {kind}; record"
        )
        further = ", or name the frames of tf as tf = ['world', 'clamp']" if entry == "pose" else ""
        raise InputError(f"{name} {which} one{f' as {entry} under [ros] of the map' if found else ''}{further}")
    return str(found[0])


def _messages(reader: Any, topic: str) -> Any:
    connections = [c for c in reader.connections if c.topic == topic]
    for connection, received, raw in reader.messages(connections=connections):
        yield received, reader.deserialize(raw, connection.msgtype)


def _stamp(message: Any, received: int) -> int:
    """The time of measurement in ns, or that of reception if the message does not state it."""
    stamp = message.header.stamp
    return int(stamp.sec) * 10**9 + int(stamp.nanosec) or received


def _samples(
    name: str, reader: Any, topic: str, read: Callable[[str, Any], tuple[float, ...]]
) -> tuple[list[int], list[tuple[float, ...]]]:
    """The times in ns and the values of all messages, which are read by a function of their place and their content."""
    stamps, values = [], []
    for number, (received, message) in enumerate(_messages(reader, topic), 1):
        stamps.append(_stamp(message, received))
        values.append(read(f"{name}: message {number} of {topic}", message))
    if not stamps:
        raise InputError(f"{name} has no message on {topic}")
    return stamps, values


def _wrench(_: str, message: Any) -> tuple[float, ...]:
    force, torque = message.wrench.force, message.wrench.torque
    return force.x, force.y, force.z, torque.x, torque.y, torque.z


def _stamped_pose(where: str, message: Any) -> tuple[float, ...]:
    return _pose(where, message.pose.position, message.pose.orientation)


def _pose(where: str, place: Any, turn: Any) -> tuple[float, ...]:
    """Position and quaternion of a message, NaN where it states none: a quaternion that was never set is zero.

    Raises InputError for other quaternions that are not of length 1, as in tables.
    """
    values = (place.x, place.y, place.z, turn.w, turn.x, turn.y, turn.z)
    length = math.hypot(*values[3:])
    if length == 0 or not math.isfinite(sum(values)):
        return (math.nan, math.nan, math.nan, 1.0, 0.0, 0.0, 0.0)
    if abs(length - 1) > 1e-3:
        raise InputError(f"{where} has a quaternion of length {length:.4g}, where 1 is expected")
    return values


def _poses(stamps: list[int], values: list[tuple[float, ...]]) -> _Poses:
    """Poses in the order of time, each time once."""
    time, first = np.unique(np.array(stamps, dtype=np.int64), return_index=True)
    table = np.array(values, dtype=np.float64).reshape(-1, 7)[first]
    return _Poses(time, table[:, :3], table[:, 3:])


class _Edge(NamedTuple):
    """What tf says of a frame in its parent, of which there should be one."""

    parents: dict[str, None]
    stamps: list[int]
    values: list[tuple[float, ...]]


def _transforms(name: str, reader: Any) -> dict[str, _Edge]:
    """The edges of tf by their child; of a static one only the last message, which holds for all times."""
    edges: dict[str, _Edge] = {}
    for topic in sorted({c.topic for c in reader.connections if c.msgtype.split("/")[-1] == _TF}):
        is_static = topic.split("/")[-1] == "tf_static"
        for number, (received, message) in enumerate(_messages(reader, topic), 1):
            for one in message.transforms:
                parent, child = one.header.frame_id.lstrip("/"), one.child_frame_id.lstrip("/")
                where = f"{name}: message {number} of {topic}, from {parent!r} to {child!r},"
                edge = edges.setdefault(child, _Edge({}, [], []))
                edge.parents[parent] = None
                values = _pose(where, one.transform.translation, one.transform.rotation)
                if is_static:
                    edge.stamps.clear()
                    edge.values.clear()
                edge.stamps.append(_stamp(one, received))
                edge.values.append(values)
    return edges


def _by_tf(name: str, edges: dict[str, _Edge], world: str, clamp: str) -> _Poses:
    """The poses of one frame in another, along the chain of transforms between them."""
    chain: list[_Poses] = []
    frame = clamp.lstrip("/")
    while frame != world.lstrip("/") and frame in edges and len(chain) <= len(edges):
        edge = edges[frame]
        if len(edge.parents) > 1:
            raise InputError(
                f"{name}: tf has {frame!r} in several frames, {', '.join(edge.parents)}, where one is expected; record the bag "
                "with one of their publishers, or name other frames as tf under [ros] of the map"
            )
        unchanged = len(set(edge.values)) == 1
        chain.append(_poses(edge.stamps[:1], edge.values[:1]) if unchanged else _poses(edge.stamps, edge.values))
        (frame,) = edge.parents
    if frame != world.lstrip("/"):
        known = sorted({*edges, *(parent for edge in edges.values() for parent in edge.parents)})
        raise InputError(
            f"{name}: tf has no chain from {world!r} to {clamp!r}, which [ros] tf of the map names as world and clamp; it has "
            f"{', '.join(known) or 'no frames'}{did_you_mean(sorted({world, clamp} - {*known}), known)}"
        )
    moving = [poses for poses in chain if len(poses.time) > 1]
    if not moving:
        raise InputError(f"{name}: nothing moves between {world!r} and {clamp!r} in tf; check [ros] tf of the map")
    time = np.unique(np.concatenate([poses.time for poses in moving]))
    position, turn = np.zeros((len(time), 3)), Rotation.identity(len(time))
    for poses in chain:  # from the clamp to the world
        shift, quaternion = _at(poses, time)
        outer = Rotation.from_quat(quaternion, scalar_first=True)
        position, turn = shift + outer.apply(position), outer * turn
    return _Poses(time, position, turn.as_quat(scalar_first=True))


def _at(poses: _Poses, time: NDArray[np.int64]) -> tuple[Array, Array]:
    """Positions (n, 3) and orientations (n, 4) at times (n,) in ns; a single pose holds for all times.

    Positions are NaN outside the times of the poses, and beside a pose that is not known.
    """
    if len(poses.time) == 1:
        return np.repeat(poses.position, len(time), axis=0), np.repeat(poses.quaternion, len(time), axis=0)
    seconds, at = (poses.time - poses.time[0]) * 1e-9, (time - poses.time[0]) * 1e-9
    columns = [np.interp(at, seconds, column, left=np.nan, right=np.nan) for column in poses.position.T]
    turns = Slerp(seconds, Rotation.from_quat(poses.quaternion, scalar_first=True))
    return np.stack(columns, axis=1), turns(np.clip(at, seconds[0], seconds[-1])).as_quat(scalar_first=True)
