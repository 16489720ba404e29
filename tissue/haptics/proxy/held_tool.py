"""Tool that is coupled to a haptic device by a spring and touches soft tissue."""

from abc import ABC, abstractmethod
from math import inf, sqrt

import numpy as np
from scipy.linalg.lapack import dgesv

from meshes.base.arrays import Array
from tissue.models.tissue_model import Response
from tissue.motion.quaternion import UPRIGHT, Quaternion, exponential, product, turn_between

LEAST_RAD = 1e-5
"""Smallest rotation from which a rotational stiffness is estimated [rad].

At this rotation, a point at a distance of 20 mm moves by 0.2 um.
"""
FURTHEST_RAD = 2.5
"""Largest rotation of the coupling spring [rad].

At a rotation of pi, the direction of the torque would be undefined.
"""


class HeldTurn:
    """Rotation of the tool from its first orientation, as a unit quaternion.

    The torques of spring and tissue are in balance: k theta + T = 0. Here theta is the rotation
    vector from tool to device, and T the torque on the tool about its tip. One Newton step per tick
    is computed, with the torque of the last tick. An isotropic stiffness of the tissue is estimated
    from the change of torque along the last rotations of the tool. An increase of the estimate is
    used at once, and a decrease gradually. Without a torque, the tool has the orientation of the
    device.

    Parameters
    ----------
    stiffness_Nm_rad
        Stiffness of the spring, as torque on the tool (not on the device) divided by angle [N
        m/rad]. The stiffness is infinite for a tool that turns with its device.
    """

    def __init__(self, stiffness_Nm_rad: float = inf) -> None:
        self.stiffness_Nm_rad = stiffness_Nm_rad
        self.quaternion: Quaternion = UPRIGHT
        self._learnt = 0.0
        self._before = UPRIGHT
        self._torque = np.zeros(3)

    def follow(self, device: Quaternion, torque_Nm: Array) -> Quaternion:
        """Compute a Newton step of the torque balance, and return the rotation of the tool.

        ``torque_Nm`` is the torque on the tool [N m], shape (3,).
        """
        spring = self.stiffness_Nm_rad
        if spring == inf or not any(torque_Nm.tolist()):
            self.quaternion = device
            return device
        self._learn(torque_Nm)
        difference = np.array(turn_between(self.quaternion, device))
        turn = (spring * difference + torque_Nm) / (spring + self._learnt)
        # The tissue would have to pull instead of push, because the estimated stiffness is too
        # small.
        if float((turn - difference).dot(torque_Nm)) <= 0.0:
            self.quaternion = device
            return device
        x, y, z = turn - difference
        size = sqrt(x * x + y * y + z * z)
        share = min(FURTHEST_RAD / size, 1.0)
        self.quaternion = product(exponential((share * x, share * y, share * z)), device)
        return self.quaternion

    def _learn(self, torque_Nm: Array) -> None:
        """Update the estimated rotational stiffness of the tissue from the last rotation."""
        turned = np.array(turn_between(self._before, self.quaternion))
        square = float(turned.dot(turned))
        if square > LEAST_RAD**2:
            self._learnt = max(
                -float(turned.dot(torque_Nm - self._torque)) / square, FADE * self._learnt
            )
            self._before = self.quaternion
            self._torque = np.array(torque_Nm)


FADE = 0.8
"""Factor per tick by which the estimated stiffness of a tissue decays.

The estimate falls to a tenth in 10 ticks, which is about the time between two encoder steps in a
slow motion. The tool therefore does not alternate between free space and contact in this time.
"""
LEAST_M = 2e-6
"""Smallest displacement of the tip from which the tissue stiffness is estimated [m].

The value is far below an encoder step (55 um on a Touch), and far above the rounding error.
"""


class HeldTool(ABC):
    """Law for the pose of a tool that is coupled to a device by a spring.

    The spring force is the stiffness times the distance from tool to device. The pose of the device
    is given as the pose that the tool would have without a force. The position [m] is scaled by the
    motion scale, and the rotation is relative to the first orientation.

    Parameters
    ----------
    stiffness_N_m
        Stiffness of the spring, as force on the tool (not on the device) divided by distance [N/m].
    tip_m
        Start position of the tip [m], shape (3,).
    turn
        Rotational spring; without it, the tool turns with the device.

    Attributes
    ----------
    tip_m
        Position of the tip [m], shape (3,).
    velocity
        Velocity of the tip [m/s] and angular velocity [rad/s], shape (6,); None for a tool without
        inertia.
    wrench
        Force [N] and torque about the tip [N m] of the tissue in the last step, shape (6,); None
        for a tool without inertia.
    """

    velocity: Array | None = None
    wrench: Array | None = None

    def __init__(self, stiffness_N_m: float, tip_m: Array, turn: HeldTurn | None = None) -> None:
        self._turn = turn or HeldTurn()
        self.stiffness_N_m = stiffness_N_m
        self.tip_m = np.array(tip_m, dtype=float)

    @property
    def quaternion(self) -> Quaternion:
        """Rotation of the tool from its first orientation."""
        return self._turn.quaternion

    @abstractmethod
    def follow(
        self,
        device_m: Array,
        device: Quaternion,
        velocity: Array,
        response: Response,
        step_s: float,
    ) -> Array:
        """Move one step towards the device [m], and return the tip position.

        ``velocity`` is the smoothed velocity of the device [m/s] and its spin [rad/s], shape (6,).
        ``response`` is the response of the tissue in the last tick.
        """

    def has_entered(self, response: Response) -> bool:
        """Return True if the response at the new position requires another step in this tick.

        This is the case if the tool has entered the tissue from free space.
        """
        return False

    def rest(self) -> None:
        """Set the velocity of the tool to zero.

        For a tool without inertia, nothing is done.
        """
        return


class PressingTool(HeldTool):
    """Tool on a tissue that pushes back, such as an organ or a wall.

    At the tip, the forces of spring and tissue are in balance: k (x_device - x) + F(x) = 0. In each
    tick, one Newton step is computed with the force F and the tissue stiffness K of the last tick:
    x' = x + (k + K)^-1 (k (x_device - x) + F). For a tissue without a known K, an isotropic
    stiffness is estimated from the change of force along the last motions of the tip. An increase
    of the estimate is used at once, and a decrease gradually. If forces balance only when the
    tissue pulls the tool, there is no contact, and the tip moves to the device.
    """

    def __init__(self, stiffness_N_m: float, tip_m: Array, turn: HeldTurn | None = None) -> None:
        super().__init__(stiffness_N_m, tip_m, turn)
        self._spring = self.stiffness_N_m * np.eye(3)
        self._learnt = 0.0
        self._free = True
        self._before_m = self.tip_m.copy()
        self._before_N = np.zeros(3)

    def follow(
        self,
        device_m: Array,
        device: Quaternion,
        velocity: Array,
        response: Response,
        step_s: float,
    ) -> Array:
        """Compute a Newton step of the force balance, and return the tip position."""
        self._turn.follow(device, response.wrench[3:])
        force = response.wrench[:3]
        tip = self.tip_m
        spring = self.stiffness_N_m
        if response.stiffness_N_m is None:
            self._learn(force)
        in_balance = False
        self._free = not any(force.tolist())
        if not self._free:
            stretch = device_m - tip
            out_of_balance = spring * stretch + force
            if response.stiffness_N_m is None:
                step = out_of_balance / (spring + self._learnt)
                singular = False
            else:
                *_, step, singular = dgesv(self._spring + response.stiffness_N_m, out_of_balance)
            in_balance = not singular and float((step - stretch).dot(force)) > 0.0
        if in_balance:
            tip += step
        else:
            tip[:] = device_m
        return tip

    def has_entered(self, response: Response) -> bool:
        """Return True if the tool has entered the tissue from free space."""
        return self._free and any(response.wrench[:3].tolist())

    def _learn(self, force_N: Array) -> None:
        """Update the estimated stiffness of the tissue from the last motion of the tip."""
        moved = self.tip_m - self._before_m
        changed = force_N - self._before_N
        square = float(moved.dot(moved))
        if square > LEAST_M**2:
            self._learnt = max(-float(moved.dot(changed)) / square, FADE * self._learnt)
            self._before_m[:] = self.tip_m
            self._before_N[:] = force_N
