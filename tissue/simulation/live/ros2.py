"""A live run on topics of ROS 2: a process beside the ticks that publishes it by the names of CRTK."""

from importlib.util import find_spec

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from tissue.builders.parts import Parts
from tissue.simulation.live.publisher import Publisher, PublishingProcess

__all__ = ["Ros2Observer", "Ros2Process", "require_ros2"]

NO_CLOCK = (0.0, 0.0, 0.0, 0.0)
"""What is sent of the clock: nobody is shown it."""
PACKAGES = ("rclpy", "geometry_msgs")
Array = NDArray[np.float64]


def require_ros2() -> None:
    """Refuse topics where the Python packages of ROS 2 are not there.

    Raises
    ------
    InputError
        Names the package and how to get it.
    """
    missing = [name for name in PACKAGES if find_spec(name) is None]
    if missing:
        raise InputError(
            f"--ros2 must have the Python packages of ROS 2, got no {missing[0]}: source the setup.bash of an "
            "installation, such as /opt/ros/jazzy, and run tissue with the Python that it is for"
        )


class Ros2Process(PublishingProcess):
    """What publishes a run on topics, as the ticks see it: rows go out, nothing comes back."""

    module = "tissue.links.ros2"
    place = "must publish the run for ROS 2"
    remedy = "mend that, or run without --ros2"
    shows_tissue = False

    def note(self) -> str:
        """What was published, in half a sentence."""
        return f"published {int(self.frames)} times as {self.address}"


class Ros2Observer(Publisher[Ros2Process]):
    """Publishes a live run on topics; arguments as for `Publisher`."""

    what = "publishing for ROS 2"

    def _begun(self, parts: Parts, columns: tuple[str, ...], low_m: Array, high_m: Array) -> Ros2Process:
        return Ros2Process(self._scene, parts, columns, low_m=low_m, high_m=high_m)

    def _show(self, process: Ros2Process, index: int, row: Array, times: Array) -> None:
        process.show(index, row, NO_CLOCK)
