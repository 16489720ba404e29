"""Processes that publish a live run, and the process for ROS 2.

A process begins with its run, is checked by the ticks and ends with the run.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from importlib.util import find_spec
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from tissue.scene.scene import Scene
from tissue.simulation.builders.parts import Parts
from tissue.simulation.live.clock import LOOK_TICKS
from tissue.simulation.live.window import WindowProcess
from tissue.simulation.observer import RunObserver

__all__ = ["Publisher", "PublishingProcess", "Ros2Process", "Ros2Publisher", "require_ros2"]

NO_CLOCK = (0.0, 0.0, 0.0, 0.0)
"""Clock that is sent to ROS 2, which does not show it."""
ROS2_PACKAGES = ("rclpy", "geometry_msgs")
Array = NDArray[np.float64]
Box = Callable[[Parts], tuple[Array, Array]]
"""Function that returns the corners of the box around the path [m]."""


class PublishingProcess(WindowProcess, ABC):
    """Process that receives a run and publishes it."""

    @abstractmethod
    def note(self) -> str:
        """Return text on what was published, as half a sentence."""


Process = TypeVar("Process", bound=PublishingProcess)


class Publisher(RunObserver, ABC, Generic[Process]):
    """Observer that publishes a live run.

    The ticks never wait for its process, and continue if it ends.

    Parameters
    ----------
    scene
        Scene of the run.
    box
        Returns the corners of the box around the path [m].

    Attributes
    ----------
    note
        Text on what was published, once the run has ended.
    """

    what = ""
    """Name of the process in the event of its end."""
    ends_run = False
    """True if the run ends with its process."""

    def __init__(self, scene: Scene, box: Box) -> None:
        self.note = ""
        self._scene = scene
        self._box = box
        self._process: Process | None = None
        self._failed: list[tuple[float, str]] = []

    @abstractmethod
    def _begun(
        self, parts: Parts, columns: tuple[str, ...], low_m: Array, high_m: Array
    ) -> Process:
        """Begin the process for a run within a box [m]."""

    @abstractmethod
    def _show(self, process: Process, index: int, row: Array, times: Array) -> None:
        """Send a tick to the process."""

    def on_begin(self, parts: Parts, columns: tuple[str, ...]) -> None:
        """Begin to publish."""
        self._process = self._begun(parts, columns, *self._box(parts))

    def on_tick(self, index: int, row: Array, times: Array) -> bool:
        """Publish the tick; return whether the run continues."""
        if self._process is None:
            return True
        self._show(self._process, index, row, times)
        if index % LOOK_TICKS == 0 and (words := self._process.failed()) is not None:
            with_run = ", and the run with it" * self.ends_run
            self._failed.append((float(row[0]), f"{self.what} ended by itself{with_run}: {words}"))
            self._end()
            return not self.ends_run
        return True

    def on_end(self) -> list[tuple[float, str]]:
        """End the process."""
        self._end()
        return self._failed

    def _end(self) -> None:
        if self._process is not None:
            process = self._process
            self._process = None
            process.end()
            self.note = process.note()


class Ros2Process(PublishingProcess):
    """Process that publishes a run on topics of ROS 2 by the names of CRTK."""

    module = "tissue.links.ros2"
    place = "must publish the run for ROS 2"
    remedy = "fix that, or run without --ros2"
    shows_tissue = False

    def note(self) -> str:
        """Return text on what was published, as half a sentence."""
        return f"published {int(self.frames)} times as {self.address}"


class Ros2Publisher(Publisher[Ros2Process]):
    """Observer that publishes a live run on topics of ROS 2."""

    what = "publishing for ROS 2"

    def _begun(
        self, parts: Parts, columns: tuple[str, ...], low_m: Array, high_m: Array
    ) -> Ros2Process:
        return Ros2Process(self._scene, parts, columns, low_m=low_m, high_m=high_m)

    def _show(self, process: Ros2Process, index: int, row: Array, times: Array) -> None:
        process.show(index, row, NO_CLOCK)


def require_ros2() -> None:
    """Check that the Python packages of ROS 2 are installed.

    Raises
    ------
    InputError
        If a package is missing; the message names it and how to install it.
    """
    missing = [name for name in ROS2_PACKAGES if find_spec(name) is None]
    if missing:
        raise InputError(
            "--ros2",
            "have the Python packages of ROS 2",
            f"no {missing[0]}",
            (
                "source the setup.bash of an installation, such as /opt/ros/jazzy, and run "
                "tissue with the Python that it is for"
            ),
        )
