"""How a tool is turned that hangs on a device by a spring of rotation: in balance with the
torque of what it meets.
"""

from math import inf, sqrt

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import require_positive
from tissue.motion.quaternion import Quaternion, exponential, product, turn_between

__all__ = ["UPRIGHT", "HeldTurn"]

UPRIGHT: Quaternion = (0.0, 0.0, 0.0, 1.0)
FADE = 0.8
"""Share of a stiffness that is still reckoned with a tick after it is gone."""
LEAST_RAD = 1e-5
"""Turn from which the stiffness of a tissue is learnt [rad]; a tool of 20 mm moves 0.2 um."""
FURTHEST_RAD = 2.5
"""Greatest turn of the spring [rad]: at pi it would pull to either side."""


class HeldTurn:
    """The tool's turn from its first orientation, as a unit quaternion next to the device's.

    Spring and tissue balance, k theta + T = 0, with theta the rotation vector from tool to device
    and T the torque on the tool about its tip, by one Newton step a tick from the torque of the
    last one. The tissue is taken as alike about all axes, as stiff as its torque has changed along
    the tool's last turns; a greater value counts at once, a smaller one gradually. Where nothing
    turns the tool it is as the device is.

    Parameters
    ----------
    stiffness_Nm_rad
        Of the spring, in the tissue's newton metres [N m/rad]; infinite for a tool that turns as
        its device does.
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
        """Make a Newton step of the balance with the torque on the tool [N m], shape (3,); the
        tool's turn.
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
        """Take the stiffness from what the last turn has changed."""
        turned = np.array(turn_between(self._before, self.quaternion))
        square = float(turned.dot(turned))
        if square > LEAST_RAD**2:
            self._learnt = max(
                -float(turned.dot(torque_Nm - self._torque)) / square, FADE * self._learnt
            )
            self._before = self.quaternion
            self._torque = np.array(torque_Nm)
