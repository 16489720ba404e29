"""Simulated hands that push: with an increasing force, with a given force, or along a path."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf, sqrt

import numpy as np

from meshes.base.arrays import Array
from tissue.haptics.hand.hand import Hand, HandAction, HandParameters, Path, minimum_jerk
from tissue.haptics.proxy.held_tool import HeldTool
from tissue.models.tissue_model import TICK_S
from tissue.motion.quaternion import Triple

THRESHOLDS = 2.0
"""Drop of the felt force to which a participant reacts, in discrimination thresholds.

The value is assumed. If two forces differ by one threshold, a participant compares them correctly
in 75 % of the trials. A reaction to a drop of one threshold would be too unreliable.
"""


@dataclass
class FeltDrop:
    """Detector of a drop of the felt force below its largest previous value.

    A participant feels the mean force over ``integration_s``. Let F be the largest previous mean. A
    drop is noticed when F minus the mean exceeds `THRESHOLDS` times kappa (F + F0).

    Attributes
    ----------
    kappa, offset_N
        Weber fraction kappa, and term F0 for low forces [N].
    integration_s
        Averaging time of the force [s].
    """

    kappa: float
    offset_N: float
    integration_s: float

    def __post_init__(self) -> None:
        self._last = deque([0.0] * max(round(self.integration_s / TICK_S), 1))
        self._sum = self._largest = 0.0

    def feel(self, force_N: float) -> bool:
        """Add a force [N], positive against the push, and return True if a drop is noticed."""
        self._last.append(force_N)
        self._sum += force_N - self._last.popleft()
        mean = self._sum / len(self._last)
        self._largest = max(self._largest, mean)
        return self._largest - mean > THRESHOLDS * self.kappa * (self._largest + self.offset_N)


class PushingHand:
    """Simulated hand that pushes along a line with a force that increases until the hand stops.

    The position of the device along the line is s(t). The aim a(t), which is the target position of
    the hand, is ahead of the device. The grip pushes with K (a - s), where K is the stiffness of
    grip and reflex. The aim follows the felt motion of the device. In addition, it advances at the
    speed rate / K::

        da/dt = (s(t - r) - s(t - r - w)) / w + rate / K

    Here r is the reaction time and w the averaging time of a participant. On a tissue of constant
    stiffness, the force increases at the given rate. Stiffness, damping and mass of the grip
    respond at once to a sudden motion of the device. The reflex responds after the reflex time, and
    the aim after the reaction time.

    The hand notices an event if the felt force drops, or if `see` is called. The hand stops one
    reaction time after it has noticed an event. The aim then moves, in one minimum-jerk
    submovement, to the position of the device at the time of the stop. Noise and tremor are as in
    `tissue.haptics.hand.hand.Hand`.

    The felt force is the force that skin and tendons carry: the sum of grip, reflex and noise.

    Parameters
    ----------
    parameters
        Parameters of the hand.
    start_m
        Start position of the device [m], shape (3,).
    direction
        Unit direction of the push, shape (3,).
    rate_N_s
        Rate of increase of the force [N/s].
    felt
        Detector of a drop of the force; None if the hand notices no drop.
    integration_s
        Averaging time of the motion [s].
    rng
        Random generator of this hand.

    Attributes
    ----------
    felt_N
        Force on the device along the push [N].
    aim_m, advance_m
        Distances that the aim and the device have moved along the push [m].
    noticed_s, stop_s
        Times at which an event is noticed and the hand stops [s]. Each time is infinite until it is
        known.
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
    ) -> None:
        self._person = parameters
        self._felt = felt
        self._gain = rate_N_s / (parameters.stiffness_N_m * (1.0 + parameters.reflex_share))
        self._start: list[float] = np.asarray(start_m).tolist()
        self._line: list[float] = np.asarray(direction).tolist()
        self._window = max(round(integration_s / TICK_S), 1)
        self._past = deque([0.0] * (round(parameters.reaction_s / TICK_S) + self._window + 1))
        self.aim_m = self._speed = 0.0
        self._left: tuple[float, float] | None = None
        self.felt_N = self.advance_m = 0.0
        self.noticed_s = self.stop_s = inf
        self._hand = Hand(parameters, self, rng=rng)

    def see(self, time_s: float) -> None:
        """Make the hand stop one reaction time after a visible event.

        The call has no effect if the hand has already noticed an event.
        """
        if time_s < self.noticed_s:
            self.noticed_s = time_s
            self.stop_s = time_s + self._person.reaction_s

    def stop(self, time_s: float) -> None:
        """Make the hand stop at a time, without a reaction time."""
        self.noticed_s = self.stop_s = time_s

    def at(self, time_s: float) -> tuple[Triple, Triple]:
        """Return position [m] and velocity [m/s] of the aim."""
        (x, y, z) = self._start
        (i, j, k) = self._line
        aim = self.aim_m
        speed = self._speed
        return (x + aim * i, y + aim * j, z + aim * k), (speed * i, speed * j, speed * k)

    def act(self, time_s: float, position_m: Triple) -> HandAction:
        """Return the action of the hand when the device is at ``position_m`` [m]."""
        before = self.advance_m
        moved = [at - start for at, start in zip(position_m, self._start, strict=True)]
        self.advance_m = self._along(moved)
        self._past.append(self.advance_m)
        self._past.popleft()
        self.aim_m += TICK_S * self._speed
        self._lead(time_s)
        action = self._hand.act(time_s, position_m)
        grip = action.grip
        off = self._along(action.aim_m) - self._along(self._start) - self.advance_m
        slips = self._along(action.aim_velocity_m_s) - (self.advance_m - before) / TICK_S
        self.felt_N = (
            grip.stiffness_N_m * off + grip.damping_N_s_m * slips + self._along(action.push_N)
        )
        if self._felt is not None and self._felt.feel(self.felt_N):
            self.see(time_s)
        return action

    def _along(self, vector: Sequence[float]) -> float:
        """Return the component of a vector along the push."""
        return sum(a * i for a, i in zip(vector, self._line, strict=True))

    def _lead(self, time_s: float) -> None:
        """Update the speed of the aim from the felt motion of the device."""
        if time_s < self.stop_s:
            follows = (self._past[self._window] - self._past[0]) / (self._window * TICK_S)
            self._speed = follows + self._gain
            return
        if self._left is None:
            self._left = self.aim_m, self.advance_m
        share, speed = minimum_jerk((time_s - self.stop_s) / self._person.submovement_s)
        there, back = self._left
        self.aim_m = there + share * (back - there)
        self._speed = speed * (back - there) / self._person.submovement_s


SHARE = 0.35
"""Motion of the hand in a correction, divided by the tool's visible position error; assumed.

The value applies if the tool moves as far as the hand. With a value of 0.5, milling overshoots: the
sideways error is as large as the wanted depth.
"""
LEAST_YIELD = 0.6
"""Smallest ratio of tool motion to hand motion that a simulated operator expects; assumed.

Values from 1 to 0.2 were compared. With 0.6, milling does not overshoot, and reaming ends 0.2 mm
before its target depth, instead of 0.5 mm.
"""


@dataclass
class CompensatedPath:
    """Path of a hand that moves beyond the target, so that the tool reaches the target.

    If a hand moved only to the target, the tool would stop where spring and resistance balance. At
    every correction of the hand, this path therefore adds a share of the visible position error of
    the tool. The share is larger if the tool moved less than the hand in the last corrections.

    Attributes
    ----------
    path
        Target position of the tool.
    tool
        Tool that the haptic device moves, with its present position.
    lead_s
        Look-ahead of the simulated hand: it evaluates the path at the present time plus `lead_s`
        [s].
    furthest_m
        Largest distance by which the hand moves beyond the path [m].
    """

    path: Path
    tool: HeldTool
    lead_s: float
    furthest_m: float
    beyond_m: Array = field(default_factory=lambda: np.zeros(3))
    _aims_m: list[Array] = field(default_factory=list)
    _tip_m: Array = field(default_factory=lambda: np.zeros(3))
    _yields: float = 1.0

    def __call__(self, time_s: float) -> Array:
        """Return the hand's target position at a time [s]; each call counts as a correction."""
        # Before this time, the path has not required any motion of the tool.
        if time_s > self.lead_s:
            self._learn()
            self.beyond_m += (
                SHARE / self._yields * (self.path(time_s - self.lead_s) - self.tool.tip_m)
            )
            size = sqrt(self.beyond_m @ self.beyond_m)
            self.beyond_m *= min(self.furthest_m / size, 1.0) if size > 0.0 else 1.0
        aim = self.path(time_s) + self.beyond_m
        self._aims_m = [*self._aims_m[-2:], aim]
        self._tip_m = self.tool.tip_m.copy()
        return aim

    def _learn(self) -> None:
        """Update the ratio of tool motion to hand motion.

        It is computed with the hand motion of the correction before the last one.
        """
        if len(self._aims_m) == 3:
            went = self.tool.tip_m - self._tip_m
            aimed = self._aims_m[1] - self._aims_m[0]
            square = float(aimed @ aimed)
            if square > 0.0:
                # The ratio is the mean of its old and new value, so that one unusual correction has
                # half of its effect. The factor is a design choice.
                self._yields += 0.5 * (
                    min(max(float(went @ aimed) / square, LEAST_YIELD), 1.0) - self._yields
                )


@dataclass
class Thrust:
    """Intended force along a line; the force ends when the tool has completed its path.

    The target position of the hand follows the tool.

    Attributes
    ----------
    start_m, path_m
        Start position and path vector of the tool [m], shape (3,).
    tool
        Tool that the haptic device moves, with its present position.
    push_N
        Push at the device [N].
    stretch_m
        Distance by which the device is ahead of the tool under this push [m].
    """

    start_m: Array
    path_m: Array
    tool: HeldTool
    push_N: float
    stretch_m: float

    @property
    def share(self) -> float:
        """Share of the path that the tool has completed, 0 to 1."""
        gone = float((self.tool.tip_m - self.start_m) @ self.path_m) / float(
            self.path_m @ self.path_m
        )
        return min(max(gone, 0.0), 1.0)

    def path(self, time_s: float) -> Array:
        """Return the hand's target position at a time [s]: ``stretch_m`` ahead of the tool."""
        share = self.share
        aim: Array = self.start_m + share * self.path_m
        # Before the start and after the end there is no push, so that the spring is not stretched.
        if time_s <= 0.0 or share == 1.0:
            return aim
        return aim + self.stretch_m * self.path_m / sqrt(self.path_m @ self.path_m)

    def push(self, time_s: float) -> Array:
        """Return the intended force [N], shape (3,), at a time [s]."""
        if self.share == 1.0:
            return np.zeros(3)
        force: Array = self.push_N * self.path_m / sqrt(self.path_m @ self.path_m)
        return force
