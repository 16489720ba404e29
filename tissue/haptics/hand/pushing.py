"""A hand that pushes with a rising force, notices that what it pushes on has given in, and
stops.
"""

from collections import deque
from dataclasses import dataclass
from math import inf

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import require_positive, require_range
from tissue.haptics.hand.hand import Hand, HandAction, HandParameters
from tissue.haptics.hand.minimum_jerk import minimum_jerk
from tissue.models.tissue_model import TICK_S
from tissue.motion.quaternion import Triple

__all__ = ["FeltDrop", "PushingHand"]

THRESHOLDS = 2.0
"""Discrimination thresholds by which the felt force has fallen when a person acts on it; assumed:
at one of them an answer is right in 75 %, which is too little to end a push that should go on."""
EASED = 0.2
"""Share of its speed with which an aim goes on after a cue; assumed."""


@dataclass
class FeltDrop:
    """Notices that a force has fallen below the greatest one that was felt.

    A person feels the mean over ``integration_s`` and notices when it lies `THRESHOLDS` thresholds
    kappa (F + F0) below the greatest mean F so far.

    Attributes
    ----------
    kappa, offset_N
        Weber's fraction and its term for low forces [N].
    integration_s
        Time over which a force is averaged [s].
    step_s
        Time between two forces [s].
    """

    kappa: float
    offset_N: float
    integration_s: float
    step_s: float = TICK_S

    def __post_init__(self) -> None:
        require_range("kappa", self.kappa, 0.0, 1.0, "use 0.07")
        require_range("offset_N", self.offset_N, 0.0, 10.0, "use 0.2")
        require_positive("integration_s", self.integration_s, "use 0.1")
        self._last = deque([0.0] * max(round(self.integration_s / self.step_s), 1))
        self._sum = self._greatest = 0.0

    def feel(self, force_N: float) -> bool:
        """Take in the next force [N], positive against the push; whether it is noticed to have
        fallen.
        """
        self._last.append(force_N)
        self._sum += force_N - self._last.popleft()
        mean = self._sum / len(self._last)
        self._greatest = max(self._greatest, mean)
        return self._greatest - mean > THRESHOLDS * self.kappa * (self._greatest + self.offset_N)


class PushingHand:
    """A hand that raises its push along a line at a rate, until it is to stop.

    The aim a(t) leads the device's advance s(t) along the line. Its grip pushes with K (a - s), K
    the grip's stiffness with its reflex, so the aim goes with the device, as it was felt to go, and
    gains on it by rate / K::

        da/dt = (s(t - r) - s(t - r - w)) / w + rate / K

    with the reaction time r and the time w over which a person averages. On a tissue of steady
    stiffness the force so rises at ``rate``; what the device does of a sudden is answered by
    stiffness, damping and mass of the grip at once, by the reflex a reflex time later and by the
    aim a reaction later. A reaction after something was noticed (the fall of the felt force, or
    what `see` reports) the hand stops: by one minimum-jerk submovement the aim goes from where it
    is to where the device is then. A reaction after a cue the aim goes on at `EASED` of its speed.
    Noise and tremor are those of `tissue.haptics.hand.hand.Hand`.

    The force that is felt is the one that skin and tendons carry: that of grip, reflex and noise on
    the device.

    Parameters
    ----------
    parameters
        The person's hand.
    start_m
        Where the device starts [m], shape (3,).
    direction
        Where it pushes to, a unit vector, shape (3,).
    rate_N_s
        Rise of the force [N/s].
    felt
        What notices a fall of the force; without it none is noticed.
    integration_s
        Time over which motion is averaged [s].
    rng
        Random generator of this hand.
    step_s
        Time between two calls [s].

    Attributes
    ----------
    felt_N
        Force on the device along the push [N].
    aim_m, advance_m
        Advance of the aim and of the device along the push [m].
    noticed_s, stop_s, eased_s
        When something was noticed, when the hand stops and when a cue slows it [s]; infinite for
        not yet.
    """

    def __init__(
        self,
        parameters: HandParameters,
        *,
        start_m: Array,
        direction: Array,
        rate_N_s: float,
        felt: FeltDrop | None,
        integration_s: float,
        rng: np.random.Generator,
        step_s: float = TICK_S,
    ) -> None:
        self._person = parameters
        self._step = step_s
        self._felt = felt
        self._gain = require_positive("rate_N_s", rate_N_s, "use 1") / (
            parameters.stiffness_N_m * (1.0 + parameters.reflex_share)
        )
        self._start: list[float] = np.asarray(start_m).tolist()
        self._line: list[float] = np.asarray(direction).tolist()
        self._window = max(round(integration_s / step_s), 1)
        self._past = deque([0.0] * (round(parameters.reaction_s / step_s) + self._window + 1))
        self.aim_m = self._speed = 0.0
        self._left: tuple[float, float] | None = None
        self.felt_N = self.advance_m = 0.0
        self.noticed_s = self.stop_s = self.eased_s = inf
        self._hand = Hand(parameters, self, rng=rng, step_s=step_s)

    def see(self, time_s: float) -> None:
        """What is seen at a time makes the hand stop a reaction later, unless it does already."""
        if time_s < self.noticed_s:
            self.noticed_s = time_s
            self.stop_s = time_s + self._person.reaction_s

    def stop(self, time_s: float) -> None:
        """Stop at a time without a reaction, as no person can."""
        self.noticed_s = self.stop_s = time_s

    def cue(self, time_s: float) -> None:
        """A cue at a time slows the hand a reaction later."""
        self.eased_s = time_s + self._person.reaction_s

    def at(self, time_s: float) -> tuple[Triple, Triple]:
        """Position [m] and velocity [m/s] of the aim."""
        (x, y, z) = self._start
        (i, j, k) = self._line
        aim = self.aim_m
        speed = self._speed
        return (x + aim * i, y + aim * j, z + aim * k), (speed * i, speed * j, speed * k)

    def act(self, time_s: float, position_m: Triple) -> HandAction:
        """What the hand does from now on, the device being at ``position_m`` [m]."""
        before = self.advance_m
        (i, j, k) = self._line
        (x, y, z) = self._start
        self.advance_m = (position_m[0] - x) * i + (position_m[1] - y) * j + (position_m[2] - z) * k
        self._past.append(self.advance_m)
        self._past.popleft()
        self.aim_m += self._step * self._speed
        self._lead(time_s)
        action = self._hand.act(time_s, position_m)
        grip = action.grip
        (a, b, c) = action.aim_m
        (u, v, w) = action.aim_velocity_m_s
        (f, g, h) = action.push_N
        off = (a * i + b * j + c * k) - (x * i + y * j + z * k) - self.advance_m
        slips = (u * i + v * j + w * k) - (self.advance_m - before) / self._step
        self.felt_N = (
            grip.stiffness_N_m * off + grip.damping_N_s_m * slips + (f * i + g * j + h * k)
        )
        if self._felt is not None and self._felt.feel(self.felt_N):
            self.see(time_s)
        return action

    def _lead(self, time_s: float) -> None:
        """Speed of the aim from now on."""
        if time_s < self.stop_s:
            follows = (self._past[self._window] - self._past[0]) / (self._window * self._step)
            self._speed = (EASED if time_s >= self.eased_s else 1.0) * (follows + self._gain)
            return
        if self._left is None:
            self._left = self.aim_m, self.advance_m
        share, speed = minimum_jerk((time_s - self.stop_s) / self._person.submovement_s)
        there, back = self._left
        self.aim_m = there + share * (back - there)
        self._speed = speed * (back - there) / self._person.submovement_s
