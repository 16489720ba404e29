"""Target pose of the tool from a client: validated, in the scene frame, within the tool's box."""

import numpy as np
from numpy.typing import NDArray

from tissue.links.igtl_messages import IgtlError, parse_transform
from tissue.links.igtl_server import Client, Received
from tissue.links.slicer_frame import SlicerFrame
from tissue.simulation.live.shared import Start

__all__ = ["TARGET", "SlicerTarget"]

Array = NDArray[np.float64]
TARGET = "tissue-target"
"""Name of the transform that moves the tool."""
OFF = 0.01
"""Largest deviation of a rotation times its transpose from the identity.

Single precision has a deviation of 1e-7.
"""


class SlicerTarget:
    """Receiver of transforms named `TARGET` from one client at a time.

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
        Number of ignored transforms with that name.
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

        The pose is the tip [mm] in the scene and the rotation from the first orientation (x, y, z,
        w). The result is None for a transform with another name, and for an ignored transform. A
        transform is ignored if it is not a rigid motion, or comes from a second client while the
        first client is connected, or the scene does not allow clients to move the tool.
        """
        if received.header.name != TARGET:
            return None
        if self._driver not in clients:
            self._driver = received.client
        try:
            matrix = parse_transform(received.content)
        except IgtlError:
            matrix = np.zeros((4, 4))
        turn = matrix[:3, :3]
        rigid = np.abs(turn.T @ turn - np.eye(3)).max() < OFF and np.linalg.det(turn) > 0.0
        if not (self._drives and rigid and self._driver is received.client):
            self.ignored += 1
            return None
        from scipy.spatial.transform import Rotation

        tip_mm, rotation = self._frame.pose_in_scene(matrix)
        quaternion = Rotation.from_matrix(rotation @ self._turn.T).as_quat()
        return np.concatenate([np.clip(tip_mm, self._low, self._high), quaternion])
