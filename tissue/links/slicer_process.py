"""Publisher of a live run for 3D Slicer over OpenIGTLink.

The publisher runs in its own process, ``python -m tissue.links.slicer_process FOLDER``.
"""

import sys
from pathlib import Path
from time import perf_counter, time
from typing import TYPE_CHECKING, Any

import numpy as np

from meshes.base.arrays import Array
from tissue.links import igtl_messages as igtl
from tissue.links.igtl_messages import IgtlError, parse_transform
from tissue.links.igtl_server import Client, IgtlServer, Received
from tissue.links.publishing import RunPublisher, publish
from tissue.show.figures.tool_mesh import faces_of, pose, tool_surface
from tissue.show.viewer.live.live_scene import Readings, read_start
from tissue.simulation.bone_surface import with_layers
from tissue.simulation.live.shared import BoneSurface, Start, tissue_surface

if TYPE_CHECKING:
    import pyvista

LPS_TO_RAS: Array = np.diag([-1.0, -1.0, 1.0, 1.0])
"""Conversion from LPS (left, posterior, superior) to RAS (right, anterior, superior) axes."""
# names of the messages, which 3D Slicer uses as names of its nodes
TOOL = "tissue-tool"
SHAPE = "tissue-tool-shape"
TISSUE = "tissue-anatomy"
IMAGE = "tissue-image"
FORCE = "tissue-force"
TORQUE = "tissue-torque"
WRENCH = "tissue-wrench"
WORDS = "tissue-force-text"
EVENTS = "tissue-events"
STATE = "tissue"
TARGET = "tissue-target"
"""Name of the transform that moves the tool."""
OFF = 0.01
"""Largest accepted deviation of R R^T from the identity, for a rotation R.

Transforms in single precision have a deviation of 1e-7. A scale of 1 % has a deviation of 0.02, so
a transform with such a scale is ignored.
"""
FRAME_S = 0.02
"""Interval between two poses [s]. 50 poses per second appear as a continuous motion."""
WORDS_S = 0.2
STATUS_S = 1.0
SURFACE_S = 1.0
"""Shortest interval between two surfaces [s].

`WORDS_S` and `STATUS_S` are the intervals between two texts of the force and between two states.

Surfaces are rare because they are the largest messages. A user could not read texts that change
faster.
"""
WAIT_S = 0.005
"""Longest wait in a call of the server [s], a quarter of the interval between poses."""
LINGERS_S = 2.0
"""Longest time for sending the last messages after the end of the run [s]."""
STREAMS = ("SENSOR", "NDARRAY")
"""Message types that are only sent to clients that request them.

3D Slicer would report each of these messages as an error.
"""


def scene_to_ras(start: Start) -> Array:
    """Return the homogeneous matrix from scene to RAS coordinates [mm], shape (4, 4).

    If the anatomy of the scene comes from a file, the scene is aligned with that file. Any other
    scene has no patient frame. Such a scene is aligned with files of its run, such as
    ``bone.nrrd``; 3D Slicer reads these files as LPS.
    """
    placed = start.get("file_to_scene_mm")
    return LPS_TO_RAS if placed is None else np.asarray(LPS_TO_RAS @ np.linalg.inv(placed))


class Publisher(RunPublisher):
    """Server that sends the newest trace row, the events and the changing surface of a live run.

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
        super().__init__(folder)
        self._scene, self._start = read_start(folder)
        self.server = IgtlServer(int(self._start["port"]))
        self.address = "{}:{}".format(*self.server.address)
        self._to_ras = scene_to_ras(self._start)
        self._tissue = tissue_surface(self._start, self._arrays)
        self._lasting = self._scene_messages()
        self._surface = b"" if self._tissue is None else self._surface_message()
        self._behind: set[Client] = set()
        """Clients that have not received the newest surface yet."""
        self._driver: Client | None = None
        self._read: Readings | None = None
        self._posed = self._worded = self._stated = self._drawn = 0.0
        self._event = self._sent = self._ignored = self._number = 0

    def step(self) -> None:
        """Send due messages and handle received messages."""
        fresh, received = self.server.poll(WAIT_S)
        for client in fresh:
            for message in [self._status_message(), *self._lasting]:
                self._send(message, to=[client])
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
        self._send(self._state("the run has ended", igtl.STATUS_SHUT_DOWN, "SHUT_DOWN"))
        until = perf_counter() + LINGERS_S
        while any(each.waits for each in self.server.clients) and perf_counter() < until:
            self.server.poll(WAIT_S)
        self._count()
        self.server.close()

    def _count(self) -> None:
        """Write the message counts and increment the frame counter.

        The frame counter shows that this process is running.
        """
        server = self.server
        self._arrays["counts"][:] = self._sent, server.accepted, server.refused, self._ignored
        self._arrays["frames"][0] += 1

    def _take(self, received: Received) -> None:
        """Handle a request or a tool target from a client; ignore other messages."""
        header = received.header
        client = received.client
        verb, _, stream = header.kind.partition("_")
        if stream in STREAMS:
            # before the first row, no data is available for an answer
            if verb == "GET" and self._read is not None:
                self._send_load(self._read, stream, to=[client])
            # start or stop a stream; OpenIGTLink requires a reply of type RTS
            elif verb in ("STT", "STP"):
                (client.wants.add if verb == "STT" else client.wants.discard)(stream)
                self._send(self._packed(f"RTS_{stream}", header.name, b"\0"), to=[client])
        elif header.kind == "TRANSFORM" and header.name == TARGET:
            # the first client that sends a target moves the tool until it disconnects
            if self._driver not in self.server.clients:
                self._driver = client
            wanted = self._target(received.content) if client is self._driver else None
            if wanted is None or not self._start["drives"]:
                self._ignored += 1
            else:
                self._arrays.write("target", wanted)

    def _target(self, content: bytes) -> Array | None:
        """Return the pose that a transform requests, shape (7,); None if the motion is not rigid.

        The pose consists of the tip in the scene [mm] and a quaternion (x, y, z, w) for the
        rotation relative to the first orientation.
        """
        from scipy.spatial.transform import Rotation

        try:
            matrix = parse_transform(content)
        except IgtlError:
            return None
        turn = matrix[:3, :3]
        if np.abs(turn.T @ turn - np.eye(3)).max() > OFF or np.linalg.det(turn) < 0.0:
            return None
        start = self._start
        wanted = np.linalg.inv(self._to_ras) @ matrix
        # tissue is only prepared in a box around the scripted path, see `window.reach_m`
        tip_mm = np.clip(wanted[:3, 3], 1e3 * start["low_m"], 1e3 * start["high_m"])
        quaternion = Rotation.from_matrix(wanted[:3, :3] @ start["start_turn"].T).as_quat()
        return np.concatenate([tip_mm, quaternion])

    def _take_row(self) -> None:
        """Send the newest trace row if it is due."""
        now = perf_counter()
        if now - self._posed < FRAME_S:
            return
        message = self._arrays.read("row")
        # no row yet, or the last row has been sent already
        if message is None or message[0] == self._turn:
            return
        self._turn, row = message
        read = self._read = Readings.of(self._columns, row, self._start)
        self._posed = now
        # a quaternion of zeros means that the row has not been written yet
        if read.turn.any():
            placed = igtl.transform_body(self._to_ras @ pose(read.tip_mm, read.turn))
            self._send(self._packed("TRANSFORM", TOOL, placed), is_stream=True)
        for stream in STREAMS:
            clients = [each for each in self.server.clients if stream in each.wants]
            if clients:
                self._send_load(read, stream, to=clients)
        if now - self._worded >= WORDS_S:
            self._worded = now
            self._send(self._words_message(read), is_stream=True)
        if now - self._stated >= STATUS_S:
            self._stated = now
            self._send(self._status_message(), is_stream=True)

    def _send_events(self) -> None:
        """Send the new events that are still in the shared memory."""
        count = int(self._arrays["events_count"][0])
        held = self._arrays["events"]
        for number in range(max(self._event, count - len(held)), count):
            text = bytes(held[number % len(held)]).rstrip(b"\0").decode("utf-8", "ignore")
            self._send(self._packed("STRING", EVENTS, igtl.string_body(text)))
        self._event = count

    def _send_surface(self) -> None:
        """Send the surface of the tissue if it has changed, at most once a second."""
        if self._tissue is None:
            return
        if perf_counter() - self._drawn >= SURFACE_S:
            if self._tissue.update():
                self._surface = self._surface_message()
                self._behind |= set(self.server.clients)
            self._drawn = perf_counter()
        ready = [client for client in self._behind if not client.waits]
        self._send(self._surface, to=ready)
        self._behind -= set(ready)

    def _send_load(self, read: Readings, stream: str, *, to: list[Client]) -> None:
        """Send force and torque of the tissue on the tool, with the simulated time.

        A SENSOR message has one unit, so force and torque are two messages.
        """
        force, torque = self._load(read)
        self._number += 1
        bodies = [
            ("SENSOR", FORCE, igtl.sensor_body(force, igtl.NEWTON)),
            ("SENSOR", TORQUE, igtl.sensor_body(torque, igtl.NEWTON_METRE)),
            ("NDARRAY", WRENCH, igtl.ndarray_body(np.concatenate([force, torque]))),
        ]
        metadata = {"time_s": f"{read.numbers['time_s']:.3f}"}
        for kind, name, body in bodies:
            if kind == stream:
                message = self._packed(kind, name, body, metadata=metadata, number=self._number)
                self._send(message, to=to, is_stream=True)

    def _send(self, message: bytes, **options: Any) -> None:
        self._sent += self.server.send(message, **options)

    def _scene_messages(self) -> list[bytes]:
        """Return the messages that do not change during a run.

        The messages are the shape of the tool in the tool's frame, the voxel image, and the faces
        of an anatomy that has neither voxels nor a mesh, such as a wall.
        """
        messages = []
        tool = tool_surface(self._scene.tool)
        if tool is not None:
            triangles = tool.triangulate()
            body = igtl.polydata_body(triangles.points, triangles.regular_faces)
            messages.append(self._packed("POLYDATA", SHAPE, body))
        density = self._start.get("density_kg_m3")
        if density is not None:
            spacing_mm = 1e3 * float(self._start["spacing_m"])
            voxels = np.diag([spacing_mm, spacing_mm, spacing_mm, 1.0])
            # the origin is the corner of the first voxel, but the position of an image is the
            # centre of the first voxel
            voxels[:3, 3] = 1e3 * self._start["origin_m"] + 0.5 * spacing_mm
            body = igtl.image_body(density, self._to_ras @ voxels)
            messages.append(self._packed("IMAGE", IMAGE, body))
        for name, face in faces_of(self._scene).items():
            # a name in the header has at most 20 bytes
            messages.append(self._mesh(f"tissue-{name}"[:20], face.triangulate()))
        return messages

    def _surface_message(self) -> bytes:
        """Return the current surface of the tissue; for bone, with the layer at each point."""
        tissue = self._tissue
        assert tissue is not None
        surface = tissue.surface
        # organs have no layers, and an empty mesh has no cells with layers
        if not isinstance(tissue, BoneSurface) or not surface.n_cells:
            return self._mesh(TISSUE, surface.triangulate())
        layers = np.zeros(surface.n_points)
        of_cells = with_layers(surface, tissue.volume).cell_data["layer"]
        layers[surface.regular_faces] = of_cells[:, None]
        return self._mesh(TISSUE, surface, layer=layers)

    def _words_message(self, read: Readings) -> bytes:
        """Return force and torque on the tool as text for display in 3D Slicer."""
        force, torque = self._load(read)
        x, y, z = force
        text = (
            f"{read.numbers['time_s']:.2f} s: force {np.linalg.norm(force):.2f} N, to the right "
            f"{x:.2f}, to the front {y:.2f}, up {z:.2f} N; torque "
            f"{1e3 * np.linalg.norm(torque):.1f} mN m"
        )
        return self._packed("STRING", WORDS, igtl.string_body(text))

    def _status_message(self) -> bytes:
        """Return a STATUS message: simulated time and missed deadlines, or the start of the run."""
        text = "begins"
        if self._read is not None:
            numbers = self._read.numbers
            text = "{time_s:.2f} s, {missed:.0f} deadlines of 1 ms missed".format_map(numbers)
        return self._state(text, igtl.STATUS_OK, "OK")

    def _state(self, text: str, code: int, name: str) -> bytes:
        body = igtl.status_body(code, f"{self._scene.name}: {text}", name=name)
        return self._packed("STATUS", STATE, body)

    def _load(self, read: Readings) -> Array:
        """Return force [N] and torque [N m] in RAS, shape (2, 3)."""
        return np.stack([read.force_N, read.torque_Nm]) @ self._to_ras[:3, :3].T

    def _mesh(self, name: str, mesh: "pyvista.PolyData", **scalars: Array) -> bytes:
        triangles = mesh.regular_faces.reshape(-1, 3)  # keep the shape of an empty mesh
        points_mm = np.asarray(mesh.points) @ self._to_ras[:3, :3].T + self._to_ras[:3, 3]
        return self._packed(
            "POLYDATA", name, igtl.polydata_body(points_mm, triangles, scalars=scalars)
        )

    def _packed(self, kind: str, name: str, body: bytes, **options: Any) -> bytes:
        return igtl.packed(kind, name, body, time_s=time(), **options)


if __name__ == "__main__":
    publish(Publisher, *sys.argv[1:])
