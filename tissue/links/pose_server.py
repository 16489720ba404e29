"""Server that receives poses of a tool from another program and returns wrenches on the tool.

The server uses the network or ROS 2.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.haptics.real.network import NetworkAdapter
from tissue.links.ros2 import NAMESPACE, RosNode, fill

if TYPE_CHECKING:
    from tissue.scene.coupling import Hardware

LOOK_S = 0.05
"""Longest time between two checks for a request to stop the server [s].

The server waits for a pose between two checks. A received pose ends this wait.
"""


class PosedLoop(Protocol):
    """Loop, such as `tissue.Loop` without a device, to which the caller passes poses."""

    def step(self, pose: ArrayLike, /) -> Array:
        """Move the tool to a pose [mm]; return force [N] and torque [N m], shape (6,)."""

    def reset(self, pose: ArrayLike, /) -> None:
        """Restore the uncut tissue and place the tool at a pose."""


def serve_network(
    loop: PosedLoop,
    hardware: "Hardware",
    *,
    opened: Callable[[str], object],
    ends: Callable[[], bool] = lambda: False,
) -> int:
    """Answer every pose of a client with a wrench; return the number of answers.

    After each accepted ``hello`` message, the tissue is restored to its uncut state, and the tool
    is put at the first pose of the client. For each later pose, the loop runs a step. A client that
    sends an invalid pose gets an error message, and its session ends.

    Parameters
    ----------
    loop
        Loop to step.
    hardware
        Settings with an address ``udp://HOST:PORT`` or ``ws://HOST:PORT``.
    opened
        Function that is called with the address when the server starts to listen.
    ends
        Function that returns True when the server must stop.
    """
    answers = 0
    greeted = 0
    with NetworkAdapter(hardware) as adapter:
        opened(adapter.address)
        while not ends():
            adapter.wait(LOOK_S)
            sample = adapter.poll()
            if sample is None:
                continue
            pose = np.array([*sample.position_m, *sample.quaternion])
            pose[:3] *= 1e3
            hellos = adapter.session.counts["hellos"]
            try:
                if hellos != greeted:
                    loop.reset(pose)
                    greeted = hellos
                    wrench = np.zeros(6)
                else:
                    wrench = loop.step(pose)
            except InputError as error:
                adapter.refuse(str(error))
                continue
            adapter.push(wrench[:3], wrench[3:])
            answers += 1
    return answers


def serve_ros2(
    loop: PosedLoop, *, opened: Callable[[str], object], ends: Callable[[], bool] = lambda: False
) -> int:
    """Answer each pose on ``servo_cp`` by ``measured_cp`` (pose) and ``measured_cf`` (wrench).

    At the first pose, the tissue is restored to its uncut state. Names and units follow CRTK: m, N
    and N m, in the frame of the scene. An invalid pose is logged as an error of the node and is not
    answered. Returns the number of answers.

    Raises
    ------
    InputError
        If the Python packages of ROS 2 are missing.
    """
    try:
        ros = RosNode("measured_cp", "measured_cf")
    except ImportError as missing:
        raise InputError(
            "--ros2",
            "be used with the packages of ROS 2",
            f"the error {missing}",
            "source the setup.bash of ROS 2 first",
        ) from None
    place_of, force_of = ros.kinds.values()
    answers = 0

    def answer(message: Any) -> None:
        """Step the loop to a pose and publish the result."""
        nonlocal answers
        at = message.pose.position
        turn = message.pose.orientation
        pose = [1e3 * at.x, 1e3 * at.y, 1e3 * at.z, turn.x, turn.y, turn.z, turn.w]
        try:
            if answers == 0:
                loop.reset(pose)
                wrench = np.zeros(6)
            else:
                wrench = loop.step(pose)
        except InputError as error:
            ros.node.get_logger().error(str(error))
            return
        answers += 1
        force = force_of()
        fill(force.wrench.force, "xyz", wrench[:3].tolist())
        fill(force.wrench.torque, "xyz", wrench[3:].tolist())
        ros.publish(place_of(pose=message.pose), force)

    # The queue has one entry: a pose that arrives during a step replaces the waiting pose.
    ros.node.create_subscription(place_of, "servo_cp", answer, 1)
    try:
        opened(f"/{NAMESPACE}/servo_cp")
        while not ends():
            ros.rclpy.spin_once(ros.node, timeout_sec=LOOK_S)
    finally:
        ros.close()
    return answers
