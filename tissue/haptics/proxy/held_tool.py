"""Where a tool is that hangs on a device by a spring: in balance with what it cuts, or with what pushes it back."""

from abc import ABC, abstractmethod
from math import sqrt

import numpy as np
from scipy.linalg.lapack import dgesv

from meshes.base.arrays import Array
from meshes.base.errors import require_positive
from tissue.haptics.proxy.held_turn import HeldTurn
from tissue.models.tissue_model import Response
from tissue.motion.quaternion import Quaternion

__all__ = ["CuttingTool", "HeldTool", "PressingTool"]

FADE = 0.8
"""Share of a resistance that is still reckoned with a tick after it is gone."""
LEAST_N, LEAST_N_s_m = 1e-3, 1.0
"""Edge force and resistance that count as none."""
TOO_MUCH = 1.2
"""Force of a cut over the spring's pull from which the balance is found anew: they differ by what changes in a tick."""
LEAST_M = 2e-6
"""Displacement from which the stiffness of a tissue is learnt [m]."""
ROUNDING = 1e-9
"""Share of a stretch that counts as none."""


class HeldTool(ABC):
    """A law for the pose of a tool; the spring's pull is the stiffness times the distance to the device.

    The device is where it would have the tool: its position in the tool's metres, its turn from its first orientation.

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
    pressed
        Share of the force that would make a resting tool cut, see `ToolMotion`.
    driven
        Whether its last motion was made against resistance, and so at a speed of its own.
    """

    def __init__(self, stiffness_N_m: float, tip_m: Array, turn: HeldTurn | None = None) -> None:
        self._turn = turn or HeldTurn()
        self.stiffness_N_m = require_positive("stiffness_N_m", stiffness_N_m, "use 1e3 on an organ, 1e4 on bone")
        self.tip_m = np.array(tip_m, dtype=float)
        self.pressed, self.driven = 0.0, False

    @property
    def quaternion(self) -> Quaternion:
        """The tool's turn from its first orientation."""
        return self._turn.quaternion

    @abstractmethod
    def follow(self, device_m: Array, device: Quaternion, response: Response, heading: Array, step_s: float) -> Array:
        """Go a step towards the device [m], given the last response and the unit heading it was given for; the tip."""

    @abstractmethod
    def lands(self, response: Response, heading: Array) -> bool:
        """Whether this answer to its new place shows that it has met more than it knew of, so that it follows anew."""


class CuttingTool(HeldTool):
    """A tool in a tissue that yields only by being cut, such as bone.

    The tip moves along the pull, by a length s in the step T that balances spring, cutting resistance and edge force at
    its end (implicit, for resistances up to 1e5 N s/m)::

        k (|x_device - x| - s) = edge + c s / T,    s >= 0

    Below the edge force the tool stays and presses. Where nothing resists, the tip is where the device is. Resistance
    is known for the last heading only: at an angle a to it (1 + cos a) / 2 of it counts, all straight on and nothing
    straight back, and it fades over some ticks once it is gone, lest a device whose encoder steps should jump between
    air and bone. Forces across the pull do not bend the spring.
    """

    def __init__(self, stiffness_N_m: float, tip_m: Array, turn: HeldTurn | None = None) -> None:
        super().__init__(stiffness_N_m, tip_m, turn)
        self._drag = self._edge = self._pull_N = 0.0
        self._heading = np.zeros(3)

    def follow(self, device_m: Array, device: Quaternion, response: Response, heading: Array, step_s: float) -> Array:
        """Solve the balance along the pull and move."""
        self._turn.follow(device, response.wrench[3:])
        drag = max(-float(response.resistance[:3].dot(heading)), 0.0)
        edge = max(-float(response.edge[:3].dot(heading)), 0.0)
        if drag >= FADE * self._drag:
            self._drag, self._edge, self._heading = drag, edge, heading.copy()
        else:
            self._drag, self._edge = FADE * self._drag, max(FADE * self._edge, edge)
        self.driven = self._edge > LEAST_N or self._drag > LEAST_N_s_m
        self.pressed = 0.0
        if not self.driven:
            self.tip_m[:], self._pull_N = device_m, 0.0
            return self.tip_m
        stretch = device_m - self.tip_m
        length = sqrt(stretch.dot(stretch))
        along = 0.5 * (1.0 + float(self._heading.dot(stretch)) / length) if length > 0.0 else 1.0
        pull, held = self.stiffness_N_m * length, along * self._edge
        moved = max(pull - held, 0.0) / (self.stiffness_N_m + along * self._drag / step_s)
        if moved < length * (1.0 - ROUNDING):
            self.tip_m += stretch * (moved / length)
        else:
            self.tip_m[:] = device_m
        self._pull_N = max(pull - self.stiffness_N_m * moved, 0.0)
        if moved == 0.0 and held > 0.0:
            self.pressed = min(pull / held, 1.0)
        return self.tip_m

    def lands(self, response: Response, heading: Array) -> bool:
        """Whether the cut takes more than the spring pulls; it is made, but the tool goes on at a speed of its own."""
        return -float(response.wrench[:3].dot(heading)) > TOO_MUCH * self._pull_N + LEAST_N


class PressingTool(HeldTool):
    """A tool on a tissue that pushes it back, such as an organ or a wall.

    The tip is where spring and tissue balance, k (x_device - x) + F(x) = 0, by one Newton step a tick from the force F
    and stiffness K of the last one: x' = x + (k + K)^-1 (k (x_device - x) + F). A tissue that does not know its K is
    taken as alike in all directions, as stiff as its force has changed along the tip's last motions; a greater value
    counts at once, a smaller one gradually. A balance in which the tissue would pull where it has pushed is none: the
    tip is where the device is, and so it is where nothing touches.
    """

    def __init__(self, stiffness_N_m: float, tip_m: Array, turn: HeldTurn | None = None) -> None:
        super().__init__(stiffness_N_m, tip_m, turn)
        self._spring = self.stiffness_N_m * np.eye(3)
        self._learnt, self._free = 0.0, True
        self._before_m, self._before_N = self.tip_m.copy(), np.zeros(3)

    def follow(self, device_m: Array, device: Quaternion, response: Response, heading: Array, step_s: float) -> Array:
        """Make a Newton step of the balance."""
        self._turn.follow(device, response.wrench[3:])
        force, tip, spring = response.wrench[:3], self.tip_m, self.stiffness_N_m
        if response.stiffness_N_m is None:
            self._learn(force)
        in_balance, self._free = False, not any(force.tolist())
        if not self._free:
            stretch = device_m - tip
            out_of_balance = spring * stretch + force
            if response.stiffness_N_m is None:
                step, singular = out_of_balance / (spring + self._learnt), False
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
        moved, changed = self.tip_m - self._before_m, force_N - self._before_N
        square = float(moved.dot(moved))
        if square > LEAST_M**2:
            self._learnt = max(-float(moved.dot(changed)) / square, FADE * self._learnt)
            self._before_m[:], self._before_N[:] = self.tip_m, force_N
