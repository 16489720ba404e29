"""Publication of a live run for ROS 2 and for 3D Slicer, each in a separate process.

Each process begins and ends with the run. The thread that runs the ticks checks that the processes
still exist.
"""

import socket
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import PRESENT, InputError
from meshes.voxels.volume import FULL
from tissue.haptics.device.recorded import MouseDevice
from tissue.motion.motion import Events
from tissue.scene.scene import Scene
from tissue.simulation.builders.parts import Parts, opens_device
from tissue.simulation.live.shared import AnyArray, Layout
from tissue.simulation.live.window import WindowProcess
from tissue.simulation.observer import LOOK_TICKS
from tissue.simulation.simulate import RunObserver

ROS2_PACKAGES = ("rclpy", "geometry_msgs")
PORT = 18944
"""Default port of OpenIGTLink, for example in 3D Slicer."""
LOCAL = "127.0.0.1"
EVENTS = 64
EVENT_BYTES = 256
"""Largest size of the text of an event [bytes]; `EVENTS` is the number of stored events.

Events are stored until the other process has sent them. The memory for events is shared by two
processes, so its size is fixed. A run reports few events per second.
"""


class PublishingProcess(WindowProcess):
    """Process that publishes a live run on topics of ROS 2, with the topic names of CRTK."""

    process = "ros2"
    place = "must publish the run for ROS 2"
    remedy = "Fix this problem, or run without --ros2"
    shows_tissue = False

    def note(self) -> str:
        """Return the end of a sentence about the published data."""
        return f"published {int(self.frames)} times as {self.address}"


class Publisher(RunObserver):
    """Observer that publishes a live run on topics of ROS 2.

    The ticks never wait for the process that publishes. If this process ends, the run continues.

    Parameters
    ----------
    scene
        Scene of the run.

    Attributes
    ----------
    note
        Text about the published data; set after the run.
    """

    what = "publishing for ROS 2"
    """Description of this process for the event that reports an unexpected end."""
    ends_run = False
    """True if the end of the process also ends the run."""

    def __init__(self, scene: Scene) -> None:
        self.note = ""
        self._scene = scene
        self._process: Any = None
        self._failed: Events = []

    def on_begin(self, parts: Parts, columns: tuple[str, ...]) -> None:
        """Start the process that publishes."""
        self._process = PublishingProcess(self._scene, parts, columns)

    def on_tick(self, index: int, row: Array, times: Array) -> bool:
        """Publish the tick; return True if the run continues."""
        if self._process is None:
            return True
        self._process.show(index, row, times)
        if index % LOOK_TICKS == 0 and (words := self._process.failed()) is not None:
            with_run = ", and the run ended with it" * self.ends_run
            self._failed.append((float(row[0]), f"{self.what} ended by itself{with_run}: {words}"))
            self.on_end()
            return not self.ends_run
        return True

    def on_end(self) -> Events:
        """End the process that publishes."""
        if self._process is not None:
            process = self._process
            self._process = None
            process.end()
            self.note = process.note()
        return self._failed


def require_ros2() -> None:
    """Check that the Python packages of ROS 2 are installed.

    Raises
    ------
    InputError
        If a package is missing. The message shows how to install it.
    """
    missing = [name for name in ROS2_PACKAGES if find_spec(name) is None]
    if missing:
        raise InputError(
            "--ros2",
            f"find the Python package {missing[0]} of ROS 2",
            "none",
            (
                "source the setup.bash of an installation, such as /opt/ros/jazzy, and "
                "run tissue with the Python of this installation"
            ),
        )


@dataclass(frozen=True, kw_only=True)
class SlicerLink:
    """Settings of the link between a live run and 3D Slicer.

    Attributes
    ----------
    port
        Port of this computer on which 3D Slicer can connect; 0 for any free port.
    drives
        Whether the tool follows the transform ``tissue-target`` that a client sends.
    opened
        Function that is called with address and port before the first tick, when a client can
        connect.
    """

    port: int = PORT
    drives: bool = False
    opened: Callable[[str], object] | None = None


def require_link(link: SlicerLink, scene: Scene, *, web: bool) -> None:
    """Check, before the scene is built, that the port and the source of tool motion can be used.

    Raises
    ------
    InputError
        If the port does not exist or another program uses the port. The error is also raised if
        both a client and a page or real device would move the tool.
    """
    mover = "--web" if web else scene.held.kind if opens_device(scene) else None
    if link.drives and mover is not None:
        raise InputError(
            "--slicer-drives",
            f"be left out with {mover}, which also moves the tool",
            PRESENT,
            "remove one of the two",
        )
    try:
        socket.create_server((LOCAL, link.port)).close()
    except (OSError, OverflowError) as error:
        why = getattr(error, "strerror", None) or "no port"
        raise InputError(
            "--slicer-port",
            f"be a free port of {LOCAL}",
            f"{link.port} ({why})",
            "end the program that uses it, or give another port",
        ) from None


class SlicerProcess(WindowProcess):
    """Process that publishes a run for 3D Slicer and receives tool poses from a client.

    The thread that runs the ticks sends rows of the trace and events to this process.

    Parameters
    ----------
    scene, parts, columns
        As for `WindowProcess`.
    link
        Settings of the link.
    """

    process = "slicer"
    place = "must publish the run for 3D Slicer"
    remedy = "Fix this problem, or run without --slicer"
    request = "target"

    def __init__(
        self,
        scene: Scene,
        parts: Parts,
        columns: tuple[str, ...],
        link: SlicerLink,
    ) -> None:
        layout: Layout = {
            "target": ("float64", (7,)),
            "target_turn": ("int64", (1,)),
            "events": ("uint8", (EVENTS, EVENT_BYTES)),
            "events_count": ("int64", (1,)),
            "counts": ("int64", (4,)),
        }
        start: dict[str, AnyArray] = {
            "port": np.array(link.port),
            "start_turn": parts.motion.rotations()[0],
            "drives": np.array(link.drives),
        }
        if parts.placement is not None:
            start["file_to_scene_mm"] = parts.placement.file_to_scene_mm
        if (volume := parts.volume) is not None:
            density = volume.density_kg_m3 * (volume.fraction / FULL)
            start["density_kg_m3"] = np.rint(density).astype(np.uint16)
        super().__init__(scene, parts, columns, more_layout=layout, more_start=start)
        self._events = self.arrays["events"]
        self._events_count = self.arrays["events_count"]
        self._ignored = (
            "were not rigid or came from a second client" if link.drives else "need --slicer-drives"
        )

    def report(self, what: str) -> None:
        """Send a sentence to the client."""
        text = np.frombuffer(what.encode()[:EVENT_BYTES], dtype=np.uint8)
        slot = self._events[int(self._events_count[0]) % EVENTS]
        slot[: len(text)] = text
        slot[len(text) :] = 0
        self._events_count[0] += 1

    def note(self) -> str:
        """Return the end of a sentence about the clients and the messages sent to them."""
        sent, clients, refused, ignored = self.arrays["counts"].tolist()
        words = [
            f"published at {self.address} by OpenIGTLink: {sent} messages to {clients} clients"
        ]
        if refused:
            words.append(f"{refused} disconnected, because they sent invalid data or did not read")
        if ignored:
            words.append(
                f"{ignored} transforms tissue-target ignored, because they {self._ignored}"
            )
        return ", ".join(words)


class SlicerPublisher(Publisher):
    """Observer that publishes a live run for 3D Slicer; a client may move the tool.

    Parameters
    ----------
    scene
        Scene of the run.
    link
        Port, and whether a client drives the tool.
    mouse
        Device that the transform of a client moves; None if no client moves the tool. With a
        device, the run ends when the publishing process ends.
    """

    what = "the link to 3D Slicer"

    def __init__(self, scene: Scene, link: SlicerLink, mouse: MouseDevice | None = None) -> None:
        super().__init__(scene)
        self._link = link
        self._mouse = mouse
        self.ends_run = mouse is not None

    def on_begin(self, parts: Parts, columns: tuple[str, ...]) -> None:
        """Start the process that publishes, and report its address."""
        self._process = SlicerProcess(self._scene, parts, columns, self._link)
        if self._link.opened is not None:
            self._link.opened(self._process.address)

    def before_tick(self, index: int) -> None:
        """Apply the tool pose that a client requests."""
        if self._mouse is not None and self._process is not None:
            self._process.steer(self._mouse)

    def on_event(self, time_s: float, what: str) -> None:
        """Publish an event."""
        if self._process is not None:
            self._process.report(f"{time_s:.3f} s: {what}")
