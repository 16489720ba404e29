"""Publisher of a live run for 3D Slicer.

Run in its own process by ``python -m tissue.links.slicer_process FOLDER``.
"""

import json
import os
import signal
import sys
from pathlib import Path
from time import perf_counter, time

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.base.placement import Placement
from tissue.links import igtl_messages as igtl
from tissue.links.igtl_server import Client, IgtlServer, Received
from tissue.links.slicer_content import SlicerContent
from tissue.links.slicer_frame import SlicerFrame
from tissue.links.slicer_target import SlicerTarget
from tissue.scene.scene import Scene
from tissue.simulation.live.shared import SharedArrays, Start, tissue_surface

__all__ = ["Publisher"]

FRAME_S = 0.02
"""Interval between two poses [s]."""
WORDS_S, STATUS_S, SURFACE_S = 0.2, 1.0, 1.0
"""Shortest interval between two force texts, two states and two surfaces [s]."""
WAIT_S = 0.005
"""Longest wait for the server at a time [s]."""
LINGERS_S = 2.0
"""Longest time to send the last messages after the end of the run [s]."""
STREAMS = ("SENSOR", "NDARRAY")
"""Streams that a client must request, because 3D Slicer would report each one as an error."""
NICE = 5
"""Niceness of the process, so that the ticks take precedence on a busy machine."""
Array = NDArray[np.float64]


class Publisher:
    """Server of a live run: newest row, events and the changing surface of the tissue.

    Parameters
    ----------
    folder
        Folder that `tissue.simulation.live.publisher.SlicerProcess` has filled.

    Attributes
    ----------
    server
        OpenIGTLink server with the connected clients.

    Raises
    ------
    InputError
        If the port is taken.
    """

    def __init__(self, folder: Path) -> None:
        self._arrays = SharedArrays(folder)
        with np.load(folder / "start.npz", allow_pickle=False) as file:
            start: Start = dict(file)
        scene = Scene.read_back((folder / "scene.json").read_text("utf-8"))
        columns = tuple(json.loads((folder / "columns.json").read_text("utf-8")))
        self.server = IgtlServer(int(start["port"]))
        placed = start.get("file_to_scene_mm")
        record = {"file_to_scene_mm": placed, "file_unit_mm": 1.0}
        frame = SlicerFrame(None if placed is None else Placement.from_record(record))
        self._tissue = tissue_surface(start, self._arrays)
        self._content = SlicerContent(scene, columns, frame, start)
        self._target = SlicerTarget(frame, start)
        self._lasting = self._content.scene_messages()
        self._surface = b"" if self._tissue is None else self._content.surface_message(self._tissue)
        self._behind: set[Client] = set()
        """Clients that do not have the newest surface yet."""
        self._row = np.zeros(0)
        self._turn = 0
        self._event = 0
        self._posed = self._worded = self._stated = self._drawn = 0.0
        self._sent = 0

    @property
    def over(self) -> bool:
        """True if the ticks have ended."""
        return bool(self._arrays["ended"][0])

    def step(self) -> None:
        """Send due messages and handle received messages."""
        fresh, received = self.server.poll(WAIT_S)
        for client in fresh:
            for message in [self._content.status_message(self._row), *self._lasting]:
                self._sent += self.server.send(message, to=[client])
            self._behind.add(client)
        for each in received:
            self._take(each)
        self._take_row()
        self._send_events()
        self._send_surface()
        self._count()

    def end(self) -> None:
        """Send the remaining messages and the end of the run, and close the server."""
        self._take_row()
        self._send_events()
        self._send(self._content.end_message())
        began = perf_counter()
        while (
            any(client.waits for client in self.server.clients)
            and perf_counter() - began < LINGERS_S
        ):
            self.server.poll(WAIT_S)
        self._count()
        self.server.close()

    def _count(self) -> None:
        """Write the message counts and increment the frame counter.

        The frame counter shows that this process works.
        """
        counts = self._sent, self.server.accepted, self.server.refused, self._target.ignored
        self._arrays["counts"][:] = counts
        self._arrays["frames"][0] += 1

    def _take(self, received: Received) -> None:
        """Handle a message of a client: a request or a tool target; other messages are ignored."""
        kind = received.header.kind
        client = received.client
        verb, _, stream = kind.partition("_")
        if stream in STREAMS:
            if verb == "GET" and self._row.size:
                self._send_to(client, stream)
            elif verb in ("STT", "STP"):
                (client.wants.add if verb == "STT" else client.wants.discard)(stream)
                reply = igtl.packed(f"RTS_{stream}", received.header.name, b"\0", time_s=time())
                self._sent += self.server.send(reply, to=[client])
        elif kind == "TRANSFORM":
            wanted = self._target.wanted(received, self.server.clients)
            if wanted is not None:
                self._arrays.write("target", wanted)

    def _take_row(self) -> None:
        """Send the newest row if it is due."""
        now = perf_counter()
        if now - self._posed < FRAME_S:
            return
        message = self._arrays.read("row")
        if message is None or message[0] == self._turn:
            return
        self._turn, self._row = message
        self._posed = now
        pose = self._content.pose_message(self._row)
        if pose is not None:
            self._send(pose, is_stream=True)
        for stream in STREAMS:
            for client in [each for each in self.server.clients if stream in each.wants]:
                self._send_to(client, stream)
        if now - self._worded >= WORDS_S:
            self._worded = now
            self._send(self._content.words_message(self._row), is_stream=True)
        if now - self._stated >= STATUS_S:
            self._stated = now
            self._send(self._content.status_message(self._row), is_stream=True)

    def _send_events(self) -> None:
        """Send the new events that are still stored."""
        count = int(self._arrays["events_count"][0])
        held = self._arrays["events"]
        for number in range(max(self._event, count - len(held)), count):
            text = bytes(held[number % len(held)]).rstrip(b"\0").decode("utf-8", "ignore")
            self._send(self._content.event_message(text))
        self._event = count

    def _send_surface(self) -> None:
        """Send the surface of the tissue if it has changed, at most once a second."""
        if self._tissue is None:
            return
        if perf_counter() - self._drawn >= SURFACE_S:
            if self._tissue.update():
                self._surface = self._content.surface_message(self._tissue)
                self._behind |= set(self.server.clients)
            self._drawn = perf_counter()
        ready = [client for client in self._behind if not client.waits]
        self._sent += self.server.send(self._surface, to=ready)
        self._behind -= set(ready)

    def _send_to(self, client: Client, stream: str) -> None:
        """Send the force to a client that has requested it."""
        for message in self._content.force_messages(self._row, stream):
            self._sent += self.server.send(message, to=[client], is_stream=True)

    def _send(self, message: bytes, *, is_stream: bool = False) -> None:
        self._sent += self.server.send(message, is_stream=is_stream)


def _main(folder: str) -> None:
    """Open the port, report it on standard output, and publish until the ticks end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the ticks determine the end of this process
    if hasattr(os, "nice"):
        os.nice(NICE)
    standard_output = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    try:
        publisher = Publisher(Path(folder))
    except InputError as error:
        sys.exit(str(error))
    host, port = publisher.server.address
    print(f"ready {host}:{port}", file=standard_output, flush=True)
    while not publisher.over:
        publisher.step()
    publisher.end()


if __name__ == "__main__":
    _main(*sys.argv[1:])
