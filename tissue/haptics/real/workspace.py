"""Mapping of a device's workspace into the scene: rotation, translation and clutch."""

from math import isfinite, radians

import numpy as np

from meshes.base.arrays import Array
from tissue.motion.motion import matrix_of
from tissue.motion.quaternion import (
    Quaternion,
    Triple,
    conjugate,
    exponential,
    is_nearly_unit,
    product,
    unit,
)

__all__ = ["Workspace"]

NO_TURN: Quaternion = (0.0, 0.0, 0.0, 1.0)


class Workspace:
    """Mapping of device poses into the scene, and of forces back into the device axes.

    Positions become ``R x + d``. The rotation R is constant, and d places the first pose at the
    start of the tool. While the clutch is held, the pose in the scene stays. When it is released, d
    and the reference orientation are updated, so that the pose continues without a jump. As R is a
    rotation, force times velocity is the same power in both frames.

    Parameters
    ----------
    turn_deg
        Rotation of the device's axes into the world's, about the world's x, then y, then z
        [degrees].
    start_m
        Position of the first pose in the scene [m].

    Attributes
    ----------
    is_placed
        True after the first pose.
    """

    def __init__(self, turn_deg: Triple, start_m: Triple) -> None:
        x, y, z = map(radians, turn_deg)
        self._turn = product(
            exponential((0.0, 0.0, z)),
            product(exponential((0.0, y, 0.0)), exponential((x, 0.0, 0.0))),
        )
        self._matrix = matrix_of(np.array(self._turn))
        self._rows: list[list[float]] = self._matrix.tolist()
        self._start = start_m
        self.forget()

    def forget(self) -> None:
        """Make the next pose the first one."""
        self.is_placed = False
        self._clutched = False
        self._shift: Triple = (0.0, 0.0, 0.0)
        self._pose: tuple[Triple, Quaternion] = (self._start, NO_TURN)
        self._from = NO_TURN
        self._onto = NO_TURN

    def turned(self, vector: Triple) -> Triple:
        """Return a vector in the device's axes in the world's axes."""
        a, b, c = vector
        x, y, z = self._rows
        return (
            x[0] * a + x[1] * b + x[2] * c,
            y[0] * a + y[1] * b + y[2] * c,
            z[0] * a + z[1] * b + z[2] * c,
        )

    def at_device(self, vector: Array) -> Array:
        """Return a vector in the world's axes in the device's axes, shape (3,)."""
        return vector @ self._matrix

    def pose(
        self, position_m: Triple, quaternion: Quaternion, *, clutched: bool
    ) -> tuple[Triple, Quaternion]:
        """Return position [m] and orientation in the scene for a device pose.

        The orientation in the scene starts without a rotation.
        """
        if clutched and self.is_placed:
            self._clutched = True
            return self._pose
        x, y, z = self.turned(position_m)
        turned = self._in_world(quaternion)
        usable = isfinite(x + y + z) and is_nearly_unit(turned)
        if usable and (self._clutched or not self.is_placed):
            (a, b, c), onto = self._pose
            self._shift = (a - x, b - y, c - z)
            self._onto = onto
            self._from = conjugate(turned)
            self.is_placed = True
            self._clutched = clutched
        a, b, c = self._shift
        pose = (x + a, y + b, z + c), product(product(turned, self._from), self._onto)
        if usable:
            self._pose = pose
        return pose

    def _in_world(self, quaternion: Quaternion) -> Quaternion:
        """Return an orientation of the device in the world's axes.

        A quaternion that is far from unit length keeps its length, so that the loop's guard refuses
        it.
        """
        length_one = (unit(quaternion) if is_nearly_unit(quaternion) else None) or quaternion
        return product(product(self._turn, length_one), conjugate(self._turn))
