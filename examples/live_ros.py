# %% [markdown]
"""How does a robot under ROS 2 get contacts while it touches?

A node that takes the wrench of the sensor (`geometry_msgs/WrenchStamped` on `wrench`) and the pose of its frame by tf, and
publishes each contact (`PoseWithCovarianceStamped` on `contact`, its x axis along the normal where that is known) and twice a
second all of them (`sensor_msgs/PointCloud2` on `contacts`).

    python examples/live_ros.py RIG.toml --ros-args -r wrench:=/ft_sensor/wrench -p base_frame:=base_link

RIG.toml is a calibration by `scan3d calibrate`, whose flange is the frame of tf (`clamp_frame`; by default that of the wrench),
or the TOML file of a recording.  The tests run this script with stubs in the place of ROS; it has not been run on a robot.
"""

import sys
from collections import deque

import numpy as np
import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped, WrenchStamped
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.time import Time
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import PointCloud2, PointField
from tf2_ros import Buffer, TransformListener

import scan3d

FLOAT32 = 7  # of PointField
COLUMNS = ("x", "y", "z", "force")
UNKNOWN = 1e6  # variance of an orientation that is not known, in rad²
WAITING = 1000  # wrenches that wait for their transform at most


class Contacts(Node):
    """Publishes the contacts of a rig."""

    def __init__(self, rig: str) -> None:
        super().__init__("contacts")
        self.live = scan3d.Live(rig, unit="m")
        self.base = self.declare_parameter("base_frame", "base_link").value
        self.clamp = self.declare_parameter("clamp_frame", "").value
        self.buffer = Buffer()
        self.listener = TransformListener(self.buffer, self)
        self.waiting: deque[WrenchStamped] = deque(maxlen=WAITING)
        self.contact = self.create_publisher(PoseWithCovarianceStamped, "contact", 10)
        self.cloud = self.create_publisher(PointCloud2, "contacts", 1)
        self.create_subscription(WrenchStamped, "wrench", self.take, qos_profile_sensor_data)
        self.create_timer(0.5, self.publish_cloud)

    def take(self, message: WrenchStamped) -> None:
        """A wrench waits for its transform, which comes later than it."""
        self.waiting.append(message)
        while self.waiting:
            first = self.waiting[0]
            frame, when = self.clamp or first.header.frame_id, Time.from_msg(first.header.stamp)
            if not self.buffer.can_transform(self.base, frame, when):
                break
            self.push(self.waiting.popleft(), self.buffer.lookup_transform(self.base, frame, when).transform)

    def push(self, message, transform) -> None:
        """One row in, and its contact out."""
        stamp, place, turn = message.header.stamp, transform.translation, transform.rotation
        force, torque = message.wrench.force, message.wrench.torque
        contact = self.live.push(
            stamp.sec + 1e-9 * stamp.nanosec,
            (place.x, place.y, place.z),
            (turn.w, turn.x, turn.y, turn.z),
            (force.x, force.y, force.z, torque.x, torque.y, torque.z),
        )
        if contact is None:
            return
        out = PoseWithCovarianceStamped()
        out.header.frame_id, out.header.stamp = self.base, stamp
        covariance, pose = np.zeros((6, 6)), out.pose.pose
        covariance[:3, :3], covariance[3:, 3:] = contact.covariance, UNKNOWN * np.eye(3)
        x, y, z, w = 0.0, 0.0, 0.0, 1.0
        if np.isfinite(contact.normal).all():
            x, y, z, w = Rotation.align_vectors(contact.normal[None], [[1.0, 0.0, 0.0]])[0].as_quat()
            covariance[3:, 3:] = np.diag([UNKNOWN, 0.0, 0.0])
        out.pose.covariance = covariance.ravel().tolist()
        pose.position.x, pose.position.y, pose.position.z = map(float, contact.point)
        pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w = map(float, (x, y, z, w))
        self.contact.publish(out)

    def publish_cloud(self) -> None:
        """All contacts so far."""
        rows = np.array([[*one.point, one.force_N] for one in self.live.contacts], dtype="<f4").reshape(
            -1, len(COLUMNS)
        )
        out = PointCloud2(height=1, width=len(rows), point_step=4 * len(COLUMNS), row_step=rows.nbytes, is_dense=True)
        out.header.frame_id, out.header.stamp = self.base, self.get_clock().now().to_msg()
        out.fields = [PointField(name=name, offset=4 * k, datatype=FLOAT32, count=1) for k, name in enumerate(COLUMNS)]
        out.data = rows.tobytes()
        self.cloud.publish(out)


# %% The node
def main(words: list[str]) -> None:
    rclpy.init(args=words)
    node = Contacts(words[0])
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()


if __name__ == "__main__":
    main(sys.argv[1:])
