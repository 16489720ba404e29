"""Publisher of a live run on ROS 2 topics.

The publisher runs in its own process, ``python -m tissue.links.ros2 FOLDER``.
"""

import sys
from importlib import import_module
from pathlib import Path
from time import perf_counter, sleep
from typing import Any

from meshes.base.arrays import Array
from tissue.links.publishing import RunPublisher, publish

NAMESPACE = "tissue"
"""Namespace of the topics, such as /tissue/measured_cp."""
FRAME = "tissue_scene"
"""Frame of poses and of all vectors: the frame of the scene."""
DEPTH = 10
"""Queue length for slow subscribers [messages], equal to the length in CRTK's client."""
STATE_S = 1.0
"""Interval at which an unchanged state is published again [s]."""
PAUSED_S = 0.5
"""Time without a tick after which the state of the run is published as paused [s].

This time is 500 ticks, so late ticks do not count as a pause.
"""
LOOK_S = 1e-3
"""Interval between two checks for a new row of the run's trace [s].

The interval is one tick, so a new row is found soon.
"""
POSE = (*(f"tool_{c}_mm" for c in "xyz"), *(f"tool_q{c}" for c in "xyzw"))
TWIST = (*(f"velocity_{c}_mm_s" for c in "xyz"), *(f"angular_velocity_{c}_rad_s" for c in "xyz"))
WRENCH = (*(f"model_force_{c}_N" for c in "xyz"), *(f"model_torque_{c}_Nm" for c in "xyz"))


KINDS = {
    "measured_cp": "PoseStamped",
    "measured_cv": "TwistStamped",
    "measured_cf": "WrenchStamped",
}
"""Types of messages, keyed by topic."""


class RosNode:
    """ROS 2 node of this program, with a publisher for each of the given topics.

    Attributes
    ----------
    rclpy, node
        Package and node of ROS 2.
    kinds
        Types of messages, keyed by topic.

    Raises
    ------
    ImportError
        If the Python packages of ROS 2 are missing.
    """

    def __init__(self, *topics: str) -> None:
        self.rclpy: Any = import_module("rclpy")
        geometry = import_module("geometry_msgs.msg")
        signals = import_module("rclpy.signals").SignalHandlerOptions
        self.rclpy.init(args=[], signal_handler_options=signals.NO)
        self.node = self.rclpy.create_node("tissue", namespace=NAMESPACE)
        self.kinds = {topic: getattr(geometry, KINDS[topic]) for topic in topics}
        self._publishers = [
            self.node.create_publisher(kind, topic, DEPTH) for topic, kind in self.kinds.items()
        ]

    def now(self) -> Any:
        """Return the time of the node as a message."""
        return self.node.get_clock().now().to_msg()

    def publish(self, *messages: Any) -> None:
        """Publish one message for each topic, with the frame of the scene in the header."""
        header = {"frame_id": FRAME, "stamp": self.now()}
        for publisher, message in zip(self._publishers, messages, strict=True):
            fill(message.header, header, header.values())
            publisher.publish(message)

    def close(self) -> None:
        """Shut down the node and ROS 2."""
        self.node.destroy_node()
        self.rclpy.try_shutdown()


class Ros2Publisher(RunPublisher):
    """Publisher of a live run with CRTK names, in m, m/s, rad/s, N and N m.

    Topics:

    - ``measured_cp``: pose of the tool tip, z from tip to shank.
    - ``measured_cv``: velocity of the tool.
    - ``measured_cf``: force and torque of the tissue on the tool; the torque is about the tip.
    - ``operating_state``, if crtk_msgs is installed: ENABLED while ticks run, PAUSED while they
      pause, DISABLED at the end.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self._rows = [self._places(names) for names in (POSE, TWIST, WRENCH)]
        self._ros = RosNode("measured_cp", "measured_cv", "measured_cf")
        topics = list(self._ros.kinds)
        self._state = ""
        self._stated_s = 0.0
        self._row_s = perf_counter()
        self._states: Any = None
        try:
            self._new_state: Any = import_module("crtk_msgs.msg").OperatingState
        except ImportError:
            pass
        else:
            qos = import_module("rclpy.qos")
            # keep the last state for subscribers that connect later
            last = qos.QoSProfile(depth=1, durability=qos.DurabilityPolicy.TRANSIENT_LOCAL)
            topics.append("operating_state")
            self._states = self._ros.node.create_publisher(self._new_state, topics[-1], last)
        self.address = ", ".join(f"/{NAMESPACE}/{topic}" for topic in topics)

    def step(self) -> None:
        """Publish a new row, and the state if it is due."""
        now = perf_counter()
        found = self._arrays.read("row")
        if found is not None and found[0] != self._turn:
            self._turn, row = found
            self._row_s = now
            self._publish(row)
        # no new rows: the run is paused
        state = "ENABLED" if now - self._row_s < PAUSED_S else "PAUSED"
        if state != self._state or now - self._stated_s >= STATE_S:
            self._publish_state(state)
        sleep(LOOK_S)

    def end(self) -> None:
        """Publish the last row and the end of the run, and shut down ROS 2."""
        self.step()
        self._publish_state("DISABLED")
        self._ros.close()

    def _publish(self, row: Array) -> None:
        """Publish pose, velocity and force of a tick."""
        pose, twist, wrench = (kind() for kind in self._ros.kinds.values())
        parts = (
            (pose.pose.position, pose.pose.orientation),
            (twist.twist.linear, twist.twist.angular),
            (wrench.wrench.force, wrench.wrench.torque),
        )
        scales = (1e-3, 1e-3, 1.0)  # lengths of a row are in mm
        for (first, second), places, scale in zip(parts, self._rows, scales, strict=True):
            values = row[places]
            fill(first, "xyz", (scale * values[:3]).tolist())
            # an orientation has 4 values; an angular velocity or a torque has 3 values
            fill(second, "xyzw"[: len(values) - 3], values[3:].tolist())
        self._ros.publish(pose, twist, wrench)
        self._arrays["frames"][0] += 1

    def _publish_state(self, state: str) -> None:
        self._state = state
        self._stated_s = perf_counter()
        # crtk_msgs may not be installed
        if self._states is not None:
            message = self._new_state(state=state, is_homed=True, is_busy=False)
            message.header.stamp = self._ros.now()
            self._states.publish(message)


def fill(message: Any, names: Any, values: Any) -> None:
    """Set fields of a message."""
    for name, value in zip(names, values, strict=True):
        setattr(message, name, value)


if __name__ == "__main__":
    publish(Ros2Publisher, *sys.argv[1:])
