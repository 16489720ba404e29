"""Quasi-static torque balance of a tool coupled to a haptic device by a spring of rotation."""

from math import inf, sqrt

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import require_positive
from tissue.motion.quaternion import Quaternion, exponential, product, turn_between

__all__ = ["UPRIGHT", "HeldTurn"]

UPRIGHT: Quaternion = (0.0, 0.0, 0.0, 1.0)
FADE = 0.8
"""Factor per tick by which a remembered stiffness decays."""
LEAST_RAD = 1e-5
"""Smallest rotation for an estimate of the tissue stiffness [rad]; a tool of 20 mm moves 0.2 um."""
FURTHEST_RAD = 2.5
"""Largest rotation of the spring [rad]: at pi it would pull to either side."""


class HeldTurn:
    """Rotation of the tool from its first orientation, as a unit quaternion.

    Spring and tissue balance, k theta + T = 0. Here theta is the rotation vector from tool to
    device, and T the torque on the tool about its tip. One Newton step per tick uses the torque of
    the last tick. An isotropic stiffness of the tissue is estimated from the change of torque along
    the last rotations of the tool. A larger value is used at once, a smaller one gradually. Without
    a torque, the tool has the orientation of the device.

    Parameters
    ----------
    stiffness_Nm_rad
        Stiffness of the spring, in the tissue's newton metres [N m/rad]; infinite for a tool that
        turns with its device.
    """

    def __init__(self, stiffness_Nm_rad: float = inf) -> None:
        if stiffness_Nm_rad < inf:
            require_positive("stiffness_Nm_rad", stiffness_Nm_rad, "use 0.3")
        self.stiffness_Nm_rad = stiffness_Nm_rad
        self.quaternion: Quaternion = UPRIGHT
        self._learnt = 0.0
        self._before = UPRIGHT
        self._torque = np.zeros(3)

    def follow(self, device: Quaternion, torque_Nm: Array) -> Quaternion:
        """Take a Newton step of the balance, and return the rotation of the tool.

        ``torque_Nm`` is the torque on the tool [N m], shape (3,).
        """
        spring = self.stiffness_Nm_rad
        if spring == inf or not any(torque_Nm.tolist()):
            self.quaternion = device
            return device
        self._learn(torque_Nm)
        difference = np.array(turn_between(self.quaternion, device))
        turn = (spring * difference + torque_Nm) / (spring + self._learnt)
        if float((turn - difference).dot(torque_Nm)) <= 0.0:
            self.quaternion = device
            return device
        x, y, z = turn - difference
        size = sqrt(x * x + y * y + z * z)
        share = min(FURTHEST_RAD / size, 1.0)
        self.quaternion = product(exponential((share * x, share * y, share * z)), device)
        return self.quaternion

    def _learn(self, torque_Nm: Array) -> None:
        """Update the estimated stiffness from the last rotation."""
        turned = np.array(turn_between(self._before, self.quaternion))
        square = float(turned.dot(turned))
        if square > LEAST_RAD**2:
            self._learnt = max(
                -float(turned.dot(torque_Nm - self._torque)) / square, FADE * self._learnt
            )
            self._before = self.quaternion
            self._torque = np.array(torque_Nm)
