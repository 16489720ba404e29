"""Publishes a live run for 3D Slicer, run by ``python -m tissue.links.slicer_process FOLDER`` in
a process.
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
from tissue.simulation.live.shared import SharedArrays
from tissue.simulation.live.surfaces import Start, tissue_surface

__all__ = ["Publisher"]

FRAME_S = 0.02
"""Time between two poses [s]."""
WORDS_S, STATUS_S, SURFACE_S = 0.2, 1.0, 1.0
"""Least time between two texts of the force, two states and two surfaces [s]."""
WAIT_S = 0.005
"""How long the server may be waited for at a time [s]."""
LINGERS_S = 2.0
"""How long the last messages may take once the run has ended [s]."""
STREAMS = ("SENSOR", "NDARRAY")
"""What a client has to ask for, for 3D Slicer takes neither and would report each one as an
error.
"""
NICE = 5
"""On a busy machine the ticks come first."""
Array = NDArray[np.float64]


class Publisher:
    """A run while it goes on, at a port: the newest row, events, and the tissue's surface as it
    changes.

    Parameters
    ----------
    folder
        Folder that `tissue.simulation.live.slicer.SlicerProcess` has filled.

    Attributes
    ----------
    server
        Who is connected.

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
        """Clients that have yet to get the newest surface."""
        self._row = np.zeros(0)
        self._turn = 0
        self._event = 0
        self._posed = self._worded = self._stated = self._drawn = 0.0
        self._sent = 0

    @property
    def over(self) -> bool:
        """Whether the ticks have ended."""
        return bool(self._arrays["ended"][0])

    def step(self) -> None:
        """Send what is due and take what has come."""
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
        """Send what is left and that the run has ended, and close."""
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
        """Report what was sent, and that this process works."""
        counts = self._sent, self.server.accepted, self.server.refused, self._target.ignored
        self._arrays["counts"][:] = counts
        self._arrays["frames"][0] += 1

    def _take(self, received: Received) -> None:
        """Take a message of a client: a question, or where it wants the tool; others are left."""
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
        """Send the newest row, as far as that is due."""
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
        """Send the events that are new, as far as they are still held."""
        count = int(self._arrays["events_count"][0])
        held = self._arrays["events"]
        for number in range(max(self._event, count - len(held)), count):
            text = bytes(held[number % len(held)]).rstrip(b"\0").decode("utf-8", "ignore")
            self._send(self._content.event_message(text))
        self._event = count

    def _send_surface(self) -> None:
        """Send the tissue's surface where it has changed, once a second at most."""
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
        """Send the force to a client that has asked for it."""
        for message in self._content.force_messages(self._row, stream):
            self._sent += self.server.send(message, to=[client], is_stream=True)

    def _send(self, message: bytes, *, is_stream: bool = False) -> None:
        self._sent += self.server.send(message, is_stream=is_stream)


def _main(folder: str) -> None:
    """Open the port, report it on the standard output, and publish until the ticks end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the ticks decide when it ends
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
