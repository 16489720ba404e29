"""Publisher of a live run on ROS 2 topics.

Run in its own process by ``python -m tissue.links.ros2 FOLDER``.
"""

import json
import os
import signal
import sys
from importlib import import_module
from pathlib import Path
from time import perf_counter, sleep
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tissue.simulation.live.shared import SharedArrays

__all__ = ["Ros2Publisher"]

NAMESPACE = "tissue"
"""Namespace of the topics, such as /tissue/measured_cp."""
FRAME = "tissue_scene"
"""Frame of poses and of all vectors: the frame of the scene."""
DEPTH = 10
"""Queue length for slow readers, as in CRTK's client [messages]."""
STATE_S = 1.0
"""Interval between repeated messages of an unchanged state [s]."""
PAUSED_S = 0.5
"""Time without a tick after which the run counts as paused [s]."""
LOOK_S = 1e-3
"""Interval between two checks for a new row [s]."""
NICE = 5
"""Niceness of the process, so that the ticks take precedence on a busy machine."""
POSE = (*(f"tool_{c}_mm" for c in "xyz"), *(f"tool_q{c}" for c in "xyzw"))
TWIST = (*(f"velocity_{c}_mm_s" for c in "xyz"), *(f"angular_velocity_{c}_rad_s" for c in "xyz"))
WRENCH = (*(f"model_force_{c}_N" for c in "xyz"), *(f"model_torque_{c}_Nm" for c in "xyz"))


class Ros2Publisher:
    """Publisher of a live run with CRTK names, in m, m/s, rad/s, N and N m.

    Topics:

    - ``measured_cp``: pose of the tool tip, z from tip to shank.
    - ``measured_cv``: velocity of the tool.
    - ``measured_cf``: load of the tissue on the tool, torques about the tip.
    - ``operating_state``, if crtk_msgs is installed: ENABLED while ticks run, PAUSED while they
      pause, DISABLED at the end.

    Parameters
    ----------
    folder
        Folder that `tissue.simulation.live.publisher.PublishingProcess` has filled.

    Attributes
    ----------
    topics
        Names of the published topics.
    """

    def __init__(self, folder: Path) -> None:
        self._arrays = SharedArrays(folder)
        columns = json.loads((folder / "columns.json").read_text("utf-8"))
        self._places = {
            names: [columns.index(name) for name in names] for names in (POSE, TWIST, WRENCH)
        }
        self._rclpy: Any = import_module("rclpy")
        signals = import_module("rclpy.signals").SignalHandlerOptions
        self._rclpy.init(args=[], signal_handler_options=signals.NO)
        self._node = self._rclpy.create_node("tissue", namespace=NAMESPACE)
        self._geometry: Any = import_module("geometry_msgs.msg")
        self.topics = ["measured_cp", "measured_cv", "measured_cf"]
        kinds = (
            self._geometry.PoseStamped,
            self._geometry.TwistStamped,
            self._geometry.WrenchStamped,
        )
        self._pose, self._twist, self._wrench = (
            self._node.create_publisher(kind, topic, DEPTH)
            for kind, topic in zip(kinds, self.topics, strict=True)
        )
        self._turn = 0
        self._state = ""
        self._stated_s = 0.0
        self._row_s = perf_counter()
        self._states: Any = None
        try:
            self._new_state: Any = import_module("crtk_msgs.msg").OperatingState
        except ImportError:
            return
        qos = import_module("rclpy.qos")
        # keep the last state for readers that connect later
        last = qos.QoSProfile(depth=1, durability=qos.DurabilityPolicy.TRANSIENT_LOCAL)
        self._states = self._node.create_publisher(self._new_state, "operating_state", last)
        self.topics.append("operating_state")

    @property
    def over(self) -> bool:
        """True if the ticks have ended."""
        return bool(self._arrays["ended"][0])

    def step(self) -> None:
        """Publish a new row, and the state if it is due."""
        now = perf_counter()
        found = self._arrays.read("row")
        if found is not None and found[0] != self._turn:
            self._turn, row = found
            self._row_s = now
            self._publish(row)
        state = "ENABLED" if now - self._row_s < PAUSED_S else "PAUSED"
        if state != self._state or now - self._stated_s >= STATE_S:
            self._publish_state(state)

    def end(self) -> None:
        """Publish the end of the run and shut down ROS 2."""
        self._publish_state("DISABLED")
        self._node.destroy_node()
        self._rclpy.try_shutdown()

    def _publish(self, row: NDArray[np.float64]) -> None:
        """Publish pose, velocity and force of a tick."""
        header = {"frame_id": FRAME, "stamp": self._node.get_clock().now().to_msg()}
        pose = self._geometry.PoseStamped()
        twist = self._geometry.TwistStamped()
        wrench = self._geometry.WrenchStamped()
        x, y, z, *turn = row[self._places[POSE]].tolist()
        _fill(pose.pose.position, "xyz", [1e-3 * x, 1e-3 * y, 1e-3 * z])
        _fill(pose.pose.orientation, "xyzw", turn)
        x, y, z, *spin = row[self._places[TWIST]].tolist()
        _fill(twist.twist.linear, "xyz", [1e-3 * x, 1e-3 * y, 1e-3 * z])
        _fill(twist.twist.angular, "xyz", spin)
        loads = row[self._places[WRENCH]].tolist()
        _fill(wrench.wrench.force, "xyz", loads[:3])
        _fill(wrench.wrench.torque, "xyz", loads[3:])
        for publisher, message in (
            (self._pose, pose),
            (self._twist, twist),
            (self._wrench, wrench),
        ):
            _fill(message.header, header, header.values())
            publisher.publish(message)
        self._arrays["frames"][0] += 1

    def _publish_state(self, state: str) -> None:
        self._state = state
        self._stated_s = perf_counter()
        if self._states is None:
            return
        message = self._new_state()
        message.header.stamp = self._node.get_clock().now().to_msg()
        message.state = state
        message.is_homed = True
        message.is_busy = False
        self._states.publish(message)


def _fill(message: Any, names: Any, values: Any) -> None:
    """Set fields of a message."""
    for name, value in zip(names, values, strict=True):
        setattr(message, name, value)


def _main(folder: str) -> None:
    """Connect to ROS 2, report the topics on standard output, and publish until the ticks end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the ticks determine the end of this process
    if hasattr(os, "nice"):
        os.nice(NICE)
    standard_output = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    try:
        publisher = Ros2Publisher(Path(folder))
    except Exception as error:
        # rclpy raises its own error types; the user reads the last printed line
        sys.exit(f"{type(error).__name__}: {' '.join(str(error).split())}")
    topics = ", ".join(f"/{NAMESPACE}/{topic}" for topic in publisher.topics)
    print(f"ready {topics}", file=standard_output, flush=True)
    while not publisher.over:
        publisher.step()
        sleep(LOOK_S)
    publisher.step()
    publisher.end()


if __name__ == "__main__":
    _main(*sys.argv[1:])
