"""Clouds as a message of ROS 2: a bag (MCAP) with one ``sensor_msgs/PointCloud2``, by `rosbags`, which is optional.

Lengths are in metres and the axes are right-handed with z up (REP 103, https://www.ros.org/reps/rep-0103.html).
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scan3d.errors import InputError
from scan3d.files.shapes import NORMAL, POINT, Shape

TOPIC, FRAME_ID = "/scan3d/contacts", "world"
_CLOUD, _FIELD, _HEADER, _TIME = (
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/PointField",
    "std_msgs/msg/Header",
    "builtin_interfaces/msg/Time",
)
# Codes of sensor_msgs/PointField by those of numpy.
_DATATYPES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}


def point_cloud_bag(shape: Shape) -> bytes:
    """The bag of a cloud in metres, on the topic `TOPIC` in the frame `FRAME_ID` at time 0.

    The fields are x, y, z, normal_x, normal_y, normal_z, rgb where there are colours, and the scalars; points and normals in
    float32, as programs of ROS expect them, scalars in their own type.  The same cloud gives the same bytes.

    Raises InputError if rosbags is missing.
    """
    try:
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        raise InputError(
            "a bag of ROS 2 needs rosbags: pip install 'scan3d[ros]'; or export the cloud as .pcd"
        ) from None
    store = get_typestore(Stores.ROS2_HUMBLE)
    points = packed_points(shape)
    types = store.types
    fields = [
        types[_FIELD](name=name, offset=int(offset), datatype=_DATATYPES[kind.str[1:]], count=1)
        for name, (kind, offset, *_) in (points.dtype.fields or {}).items()
    ]
    message = types[_CLOUD](
        header=types[_HEADER](stamp=types[_TIME](sec=0, nanosec=0), frame_id=FRAME_ID),
        height=1,
        width=len(points),
        fields=fields,
        is_bigendian=False,
        point_step=points.itemsize,
        row_step=points.nbytes,
        data=np.frombuffer(points.tobytes(), np.uint8),
        is_dense=bool(np.isfinite(shape.points).all()),
    )
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "cloud"
        with Writer(place, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            connection = writer.add_connection(TOPIC, _CLOUD, typestore=store)
            writer.write(connection, 0, store.serialize_cdr(message, _CLOUD))
        (file,) = place.glob("*.mcap")
        return file.read_bytes()


def packed_points(shape: Shape) -> NDArray[np.void]:
    """The points (n,) as the Point Cloud Library packs them: float32, normals as normal_x …, colours as the bits of one rgb."""
    columns: dict[str, NDArray[Any]] = {name: shape.rows[name].astype("<f4") for name in POINT}
    columns |= {f"normal_{name[1:]}": shape.rows[name].astype("<f4") for name in NORMAL}
    if shape.colors is not None:
        red, green, blue = shape.colors.astype("<u4").T
        columns["rgb"] = (red << 16 | green << 8 | blue).view("<f4")
    columns |= shape.columns
    rows = np.empty(len(shape.rows), dtype=[(name, column.dtype.newbyteorder("<")) for name, column in columns.items()])
    for name, column in columns.items():
        rows[name] = column
    return rows
