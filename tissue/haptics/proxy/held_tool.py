"""Where a tool is that hangs on a device by a spring: in balance with what it cuts, or with what
pushes it back.
"""

from abc import ABC, abstractmethod

import numpy as np
from scipy.linalg.lapack import dgesv

from meshes.base.arrays import Array
from meshes.base.errors import require_positive
from tissue.haptics.proxy.held_turn import HeldTurn
from tissue.models.tissue_model import Response
from tissue.motion.quaternion import Quaternion

__all__ = ["FADE", "HeldTool", "PressingTool"]

FADE = 0.8
"""Share of a resistance that is still reckoned with a tick after it is gone."""
LEAST_M = 2e-6
"""Displacement from which the stiffness of a tissue is learnt [m]."""


class HeldTool(ABC):
    """A law for the pose of a tool; the spring's pull is the stiffness times the distance to the
    device.

    The device is where it would have the tool: its position in the tool's metres, its turn from its
    first orientation.

    Parameters
    ----------
    stiffness_N_m
        Of the spring, in the tissue's newtons [N/m].
    tip_m
        Where the tip starts [m], shape (3,).
    turn
        Spring of rotation; without it the tool turns as its device does.

    Attributes
    ----------
    tip_m
        Where the tip is [m], shape (3,).
    push
        Force [N] and torque [N m] on a driven tool that rests, but those of the tissue, shape (6,);
        else zero.
    driven
        Whether its last motion was made against resistance, and so at a speed and with a heading of
        its own.
    heading
        Where it goes, or would go, when it is driven: a unit vector, shape (3,).
    """

    def __init__(self, stiffness_N_m: float, tip_m: Array, turn: HeldTurn | None = None) -> None:
        self._turn = turn or HeldTurn()
        self.stiffness_N_m = require_positive(
            "stiffness_N_m", stiffness_N_m, "use 1e3 on an organ, 1e4 on bone"
        )
        self.tip_m = np.array(tip_m, dtype=float)
        self.driven = False
        self.heading = np.zeros(3)
        self.push = np.zeros(6)

    @property
    def quaternion(self) -> Quaternion:
        """The tool's turn from its first orientation."""
        return self._turn.quaternion

    @abstractmethod
    def follow(
        self, device_m: Array, device: Quaternion, response: Response, heading: Array, step_s: float
    ) -> Array:
        """Go a step towards the device [m], given the last response and the unit heading it was
        given for; the tip.
        """

    @abstractmethod
    def lands(self, response: Response, heading: Array) -> bool:
        """Whether this answer to its new place shows that it has met more than it knew of, so
        that it follows anew.
        """


class PressingTool(HeldTool):
    """A tool on a tissue that pushes it back, such as an organ or a wall.

    The tip is where spring and tissue balance, k (x_device - x) + F(x) = 0, by one Newton step a
    tick from the force F and stiffness K of the last one: x' = x + (k + K)^-1 (k (x_device - x) +
    F). A tissue that does not know its K is taken as alike in all directions, as stiff as its force
    has changed along the tip's last motions; a greater value counts at once, a smaller one
    gradually. A balance in which the tissue would pull where it has pushed is none: the tip is
    where the device is, and so it is where nothing touches.
    """

    def __init__(self, stiffness_N_m: float, tip_m: Array, turn: HeldTurn | None = None) -> None:
        super().__init__(stiffness_N_m, tip_m, turn)
        self._spring = self.stiffness_N_m * np.eye(3)
        self._learnt = 0.0
        self._free = True
        self._before_m = self.tip_m.copy()
        self._before_N = np.zeros(3)

    def follow(
        self, device_m: Array, device: Quaternion, response: Response, heading: Array, step_s: float
    ) -> Array:
        """Make a Newton step of the balance."""
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

    def lands(self, response: Response, heading: Array) -> bool:
        """Whether a free tool has gone into the tissue."""
        return self._free and any(response.wrench[:3].tolist())

    def _learn(self, force_N: Array) -> None:
        """Take the stiffness from what the last motion has changed."""
        moved = self.tip_m - self._before_m
        changed = force_N - self._before_N
        square = float(moved.dot(moved))
        if square > LEAST_M**2:
            self._learnt = max(-float(moved.dot(changed)) / square, FADE * self._learnt)
            self._before_m[:] = self.tip_m
            self._before_N[:] = force_N
