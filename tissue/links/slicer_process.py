"""Publisher of a live run for 3D Slicer: frame, messages, tool target, and process.

The publisher runs in its own process, ``python -m tissue.links.slicer_process FOLDER``.
"""

import sys
from pathlib import Path
from time import perf_counter, time
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array
from meshes.base.placement import Placement
from tissue.links import igtl_messages as igtl
from tissue.links.igtl_messages import IgtlError, parse_transform
from tissue.links.igtl_server import Client, IgtlServer, Received
from tissue.links.publishing import RunPublisher, publish
from tissue.motion.motion import matrix_of
from tissue.scene.scene import Scene
from tissue.show.figures.tool_mesh import faces_of, tool_surface
from tissue.show.viewer.live.live_scene import Readings, read_start
from tissue.simulation.bone_surface import with_layers
from tissue.simulation.live.shared import BoneSurface, OrganSurface, Start, tissue_surface

if TYPE_CHECKING:
    import pyvista

__all__ = ["TARGET", "Publisher", "SlicerContent", "SlicerFrame", "SlicerTarget"]


LPS_TO_RAS: Array = np.diag([-1.0, -1.0, 1.0, 1.0])
"""Conversion from LPS (left, posterior, superior) to RAS (right, anterior, superior) axes."""


class SlicerFrame:
    """Rigid transform between the scene frame [mm] and RAS [mm].

    If the anatomy of the scene comes from a file, the scene is aligned with that file. Any other
    scene has no patient frame. Such a scene is aligned with the files of its run, such as
    ``bone.nrrd``, which 3D Slicer interprets as LPS.

    Parameters
    ----------
    placement
        Placement of the scene frame in the frame of the file; None for a scene without a file.

    Attributes
    ----------
    matrix
        Homogeneous matrix from the scene [mm] to RAS [mm], shape (4, 4).
    """

    def __init__(self, placement: Placement | None) -> None:
        self.matrix = LPS_TO_RAS.copy()
        # without a placement, the axes of the scene are LPS axes
        if placement is not None:
            self.matrix = LPS_TO_RAS @ _pose(placement.origin_mm, placement.rotation)

    def points(self, points_mm: ArrayLike) -> Array:
        """Convert points of the scene [mm], shape (n, 3), to RAS [mm]."""
        return np.asarray(points_mm) @ self.matrix[:3, :3].T + self.matrix[:3, 3]

    def vector(self, vector: Array) -> Array:
        """Convert a force, a torque or another vector of the scene to RAS, shape (3,)."""
        return np.asarray(self.matrix[:3, :3] @ vector)

    def pose(self, tip_mm: ArrayLike, rotation: ArrayLike) -> Array:
        """Return the matrix from a tool frame to RAS [mm], shape (4, 4).

        The arguments are the tip [mm] and the orientation, shape (3, 3), in the scene.
        """
        return np.asarray(self.matrix @ _pose(tip_mm, rotation))

    def pose_in_scene(self, matrix: Array) -> tuple[Array, Array]:
        """Convert a tool pose in RAS to the tip [mm] and orientation, shape (3, 3), in the scene.

        The pose is a homogeneous matrix [mm], shape (4, 4).
        """
        pose = np.linalg.inv(self.matrix) @ matrix
        return pose[:3, 3], pose[:3, :3]


def _pose(origin: ArrayLike, rotation: ArrayLike) -> Array:
    """Return a homogeneous matrix, shape (4, 4)."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = origin
    return matrix


# names of the messages, which 3D Slicer uses as names of its nodes
TOOL = "tissue-tool"
SHAPE = "tissue-tool-shape"
TISSUE = "tissue-anatomy"
IMAGE = "tissue-image"
FORCE = "tissue-force"
TORQUE = "tissue-torque"
WRENCH = "tissue-wrench"
WORDS = "tissue-force-text"
STATE = "tissue"


class SlicerContent:
    """Builder of the messages of a run.

    Parameters
    ----------
    scene
        Scene of the run.
    frame
        Frame of the scene in RAS.
    start
        Initial data from the ticks.
    """

    def __init__(self, scene: Scene, frame: SlicerFrame, start: Start) -> None:
        self._scene = scene
        self._frame = frame
        self._start = start
        self._number = 0

    def scene_messages(self) -> list[bytes]:
        """Return the messages that do not change during a run.

        The messages are the tool shape in its own frame, the voxel image, and the faces of an
        anatomy without voxels and mesh, such as a wall.
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
            # the origin is the corner of the first voxel, but the position of an image is the
            # centre of the first voxel
            first_mm = 1e3 * self._start["origin_m"].astype(float) + 0.5 * spacing_mm
            voxels = self._frame.matrix @ _pose(first_mm, spacing_mm * np.eye(3))
            messages.append(self._packed("IMAGE", IMAGE, igtl.image_body(density, voxels)))
        for name, face in faces_of(self._scene).items():
            body = self._mesh(face.triangulate())
            # a name in the header has at most 20 bytes
            messages.append(self._packed("POLYDATA", f"tissue-{name}"[:20], body))
        return messages

    def surface_message(self, tissue: BoneSurface | OrganSurface) -> bytes:
        """Return the current surface of the tissue.

        The surface of a bone has the layer as a value at each point.
        """
        surface = tissue.surface
        # organs have no layers, and an empty mesh has no cells with layers
        if not isinstance(tissue, BoneSurface) or not surface.n_cells:
            return self._packed("POLYDATA", TISSUE, self._mesh(surface.triangulate()))
        layers = np.zeros(surface.n_points)
        layers[surface.regular_faces] = with_layers(surface, tissue.volume).cell_data["layer"][
            :, None
        ]
        return self._packed("POLYDATA", TISSUE, self._mesh(surface, layer=layers))

    def pose_message(self, read: Readings) -> bytes | None:
        """Return the pose of the tool tip, or None if the row has no pose yet."""
        # a quaternion of zeros means that the row has not been written yet
        if not read.turn.any():
            return None
        pose = self._frame.pose(read.tip_mm, matrix_of(read.turn))
        return self._packed("TRANSFORM", TOOL, igtl.transform_body(pose))

    def force_messages(self, read: Readings, kind: str) -> list[bytes]:
        """Return messages with force and torque of the tissue on the tool, and the simulated time.

        For the kind SENSOR, the result is one message for the force and one for the torque. For the
        kind NDARRAY, it is one message.
        """
        force, torque = self._load(read)
        self._number += 1
        bodies = [
            ("SENSOR", FORCE, igtl.sensor_body(force, igtl.NEWTON)),
            ("SENSOR", TORQUE, igtl.sensor_body(torque, igtl.NEWTON_METRE)),
        ]
        # an array holds all six numbers; a sensor message has one unit
        if kind == "NDARRAY":
            bodies = [("NDARRAY", WRENCH, igtl.ndarray_body(np.concatenate([force, torque])))]
        metadata = {"time_s": f"{read.numbers['time_s']:.3f}"}
        return [self._packed(*each, metadata=metadata, number=self._number) for each in bodies]

    def words_message(self, read: Readings) -> bytes:
        """Return a message with force and torque on the tool, as text for display in 3D Slicer."""
        force, torque = self._load(read)
        x, y, z = force
        text = (
            f"{read.numbers['time_s']:.2f} s: force {np.linalg.norm(force):.2f} N, to the right "
            f"{x:.2f}, to the front {y:.2f}, up {z:.2f} N; torque "
            f"{1e3 * np.linalg.norm(torque):.1f} mN m"
        )
        return self._packed("STRING", WORDS, igtl.string_body(text))

    def status_message(self, read: Readings | None) -> bytes:
        """Return a status message with the simulated time and the number of missed deadlines.

        Before the first tick, `read` is None, and the message states that the run begins.
        """
        text = "begins"
        if read is not None:
            text = "{time_s:.2f} s, {missed:.0f} deadlines of 1 ms missed".format_map(read.numbers)
        body = igtl.status_body(igtl.STATUS_OK, f"{self._scene.name}: {text}", name="OK")
        return self._packed("STATUS", STATE, body)

    def event_message(self, text: str) -> bytes:
        """Return the message of an event."""
        return self._packed("STRING", "tissue-events", igtl.string_body(text))

    def end_message(self) -> bytes:
        """Return the message that reports the end of the run."""
        body = igtl.status_body(
            igtl.STATUS_SHUT_DOWN, f"{self._scene.name}: the run has ended", name="SHUT_DOWN"
        )
        return self._packed("STATUS", STATE, body)

    def _load(self, read: Readings) -> tuple[Array, Array]:
        """Return force [N] and torque [N m] in RAS."""
        return self._frame.vector(read.force_N), self._frame.vector(read.torque_Nm)

    def _mesh(self, mesh: "pyvista.PolyData", **scalars: Array) -> bytes:
        triangles = mesh.regular_faces.reshape(-1, 3)  # keep the shape of an empty mesh
        return igtl.polydata_body(self._frame.points(mesh.points), triangles, scalars=scalars)

    def _packed(self, kind: str, name: str, body: bytes, **options: Any) -> bytes:
        return igtl.packed(kind, name, body, time_s=time(), **options)


TARGET = "tissue-target"
"""Name of the transform that moves the tool."""
OFF = 0.01
"""Largest accepted deviation of R R^T from the identity, for a rotation R.

Transforms in single precision have a deviation of 1e-7. A scale of 1 % has a deviation of 0.02, so
the transform is ignored.
"""


class SlicerTarget:
    """Receiver of transforms with the name `TARGET`, from one client at a time.

    Parameters
    ----------
    frame
        Frame of the scene in RAS.
    start
        ``low_m``, ``high_m``: box of the tip [m]. ``start_turn``: first orientation of the tool,
        shape (3, 3). ``drives``: True if a client may move the tool.

    Attributes
    ----------
    ignored
        Number of ignored transforms with the name `TARGET`.
    """

    def __init__(self, frame: SlicerFrame, start: Start) -> None:
        self._frame = frame
        self._turn = start["start_turn"].astype(np.float64)
        self._low = 1e3 * start["low_m"].astype(float)
        self._high = 1e3 * start["high_m"].astype(float)
        self._drives = bool(start["drives"])
        self._driver: Client | None = None
        self.ignored = 0

    def wanted(self, received: Received, clients: list[Client]) -> Array | None:
        """Return the target pose of a transform, shape (7,), or None.

        The pose consists of the tip in the scene [mm] and the rotation relative to the first
        orientation (x, y, z, w). The result is None for a transform with another name and for an
        ignored transform. A transform is ignored if it is not a rigid motion, or if clients may not
        move the tool. It is also ignored while another client, which sent a target earlier, is
        still connected.
        """
        if received.header.name != TARGET:
            return None
        # the first client that sends a target moves the tool until it disconnects
        if self._driver not in clients:
            self._driver = received.client
        try:
            matrix = parse_transform(received.content)
        except IgtlError:
            # not a rotation, so the transform is ignored below
            matrix = np.zeros((4, 4))
        turn = matrix[:3, :3]
        rigid = np.abs(turn.T @ turn - np.eye(3)).max() < OFF and np.linalg.det(turn) > 0.0
        if not (self._drives and rigid and self._driver is received.client):
            self.ignored += 1
            return None
        from scipy.spatial.transform import Rotation

        tip_mm, rotation = self._frame.pose_in_scene(matrix)
        quaternion = Rotation.from_matrix(rotation @ self._turn.T).as_quat()
        # tissue is only prepared in a box around the scripted path, see `window.reach_m`
        return np.concatenate([np.clip(tip_mm, self._low, self._high), quaternion])


FRAME_S = 0.02
"""Interval between two poses [s]. 50 poses per second appear as a continuous motion."""
WORDS_S = 0.2
STATUS_S = 1.0
SURFACE_S = 1.0
"""Shortest interval between two surfaces [s].

`WORDS_S` and `STATUS_S` are the intervals between two texts of the force and between two states.

A user cannot read a text that changes faster. Surfaces are the largest messages.
"""
WAIT_S = 0.005
"""Longest wait in a call of the server [s], a quarter of the interval between poses."""
LINGERS_S = 2.0
"""Longest time for sending the last messages after the end of the run [s]."""
STREAMS = ("SENSOR", "NDARRAY")
"""Message types that are only sent to clients that request them.

3D Slicer would report each of these messages as an error.
"""


class Publisher(RunPublisher):
    """Server that sends the newest row, the events and the changing surface of a live run.

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
        scene, start = read_start(folder)
        self.server = IgtlServer(int(start["port"]))
        self.address = "{}:{}".format(*self.server.address)
        placed = start.get("file_to_scene_mm")
        # lengths are sent in mm, for any length unit of the file
        record = {"file_to_scene_mm": placed, "file_unit_mm": 1.0}
        frame = SlicerFrame(None if placed is None else Placement.from_record(record))
        self._start = start
        self._tissue = tissue_surface(start, self._arrays)
        self._content = SlicerContent(scene, frame, start)
        self._target = SlicerTarget(frame, start)
        self._lasting = self._content.scene_messages()
        self._surface = b"" if self._tissue is None else self._content.surface_message(self._tissue)
        self._behind: set[Client] = set()
        """Clients that have not received the newest surface yet."""
        self._read: Readings | None = None
        self._event = 0
        self._posed = self._worded = self._stated = self._drawn = 0.0
        self._sent = 0

    def step(self) -> None:
        """Send due messages and handle received messages."""
        fresh, received = self.server.poll(WAIT_S)
        for client in fresh:
            for message in [self._content.status_message(self._read), *self._lasting]:
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

        The frame counter shows that this process is running.
        """
        server = self.server
        self._arrays["counts"][:] = (
            self._sent,
            server.accepted,
            server.refused,
            self._target.ignored,
        )
        self._arrays["frames"][0] += 1

    def _take(self, received: Received) -> None:
        """Handle a request or a tool target from a client; ignore other messages."""
        kind = received.header.kind
        client = received.client
        verb, _, stream = kind.partition("_")
        if stream in STREAMS:
            # before the first row, no data is available for an answer
            if verb == "GET" and self._read is not None:
                self._send_to(client, self._read, stream)
            # start or stop a stream; OpenIGTLink requires a reply of type RTS
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
        # no row yet, or the last row has been sent already
        if message is None or message[0] == self._turn:
            return
        self._turn, row = message
        read = self._read = Readings.of(self._columns, row, self._start)
        self._posed = now
        pose = self._content.pose_message(read)
        if pose is not None:
            self._send(pose, is_stream=True)
        for stream in STREAMS:
            for client in [each for each in self.server.clients if stream in each.wants]:
                self._send_to(client, read, stream)
        if now - self._worded >= WORDS_S:
            self._worded = now
            self._send(self._content.words_message(read), is_stream=True)
        if now - self._stated >= STATUS_S:
            self._stated = now
            self._send(self._content.status_message(read), is_stream=True)

    def _send_events(self) -> None:
        """Send the new events that are still in the shared memory."""
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

    def _send_to(self, client: Client, read: Readings, stream: str) -> None:
        """Send the force to a client that has requested it."""
        for message in self._content.force_messages(read, stream):
            self._sent += self.server.send(message, to=[client], is_stream=True)

    def _send(self, message: bytes, *, is_stream: bool = False) -> None:
        self._sent += self.server.send(message, is_stream=is_stream)


if __name__ == "__main__":
    publish(Publisher, *sys.argv[1:])
