"""A live run on topics of ROS 2: a process beside the ticks that publishes it by the names of CRTK."""

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from tissue.builders.parts import Parts
from tissue.scene.scene import Scene
from tissue.simulation.live.window import WindowProcess
from tissue.simulation.simulate import RunObserver, TakesEvents

__all__ = ["Ros2Observer", "Ros2Process", "require_ros2"]

LOOK_TICKS = 200
"""Ticks between two looks whether the process is still there."""
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


class Ros2Process(WindowProcess):
    """What publishes a run on topics, as the ticks see it: rows go out, nothing comes back."""

    module = "tissue.links.ros2"
    place = "must publish the run for ROS 2"
    remedy = "mend that, or run without --ros2"
    shows_tissue = False

    def note(self) -> str:
        """What was published, in half a sentence."""
        return f"published {int(self.frames)} times as {self.address}"


class Ros2Observer:
    """Goes along with a live run and publishes it; the ticks never wait for it, and go on without it.

    Parameters
    ----------
    scene
        What is run.
    along
        The run's other observer.
    box
        Gives the corners of the box about the path [m].

    Attributes
    ----------
    note
        What was published, once the run has ended.
    """

    def __init__(self, scene: Scene, along: RunObserver, *, box: Callable[[Parts], tuple[Array, Array]]) -> None:
        self.timing_columns = along.timing_columns
        self.note = ""
        self._scene, self._along, self._box = scene, along, box
        self._process: Ros2Process | None = None
        self._failed: list[tuple[float, str]] = []

    def on_begin(self, parts: Parts, columns: tuple[str, ...]) -> None:
        """Begin to publish."""
        low, high = self._box(parts)
        self._process = Ros2Process(self._scene, parts, columns, low_m=low, high_m=high)
        try:
            self._along.on_begin(parts, columns)
        except BaseException:
            self._process.end()
            raise

    def before_tick(self, index: int) -> None:
        """Wait with the other observer."""
        self._along.before_tick(index)

    def on_tick(self, index: int, row: Array, times: Array) -> bool:
        """Publish the tick; whether the run goes on."""
        process = self._process
        if process is not None:
            process.show(index, row, NO_CLOCK)
            if index % LOOK_TICKS == 0 and (words := process.failed()) is not None:
                self._failed.append((float(row[0]), f"the topics of ROS 2 ended by themselves: {words}"))
                self._end()
        return self._along.on_tick(index, row, times)

    def on_event(self, time_s: float, what: str) -> None:
        """Hand on what has happened."""
        along: Any = self._along
        if isinstance(along, TakesEvents):
            along.on_event(time_s, what)

    def on_end(self) -> list[tuple[float, str]]:
        """End the other observer and the topics."""
        try:
            return self._along.on_end() + self._failed
        finally:
            self._end()

    def _end(self) -> None:
        if self._process is not None:
            process, self._process = self._process, None
            process.end()
            self.note = process.note()
