"""Where a tool is that cuts and hangs on a device by a spring: the balance along its feed and
across it.
"""

from math import sqrt

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import require_range
from tissue.haptics.proxy.held_tool import FADE, HeldTool
from tissue.haptics.proxy.held_turn import HeldTurn
from tissue.models.tissue_model import Response
from tissue.motion.quaternion import Quaternion

__all__ = ["CuttingTool"]

LEAST_N, LEAST_N_s_m = 1e-3, 1.0
"""Force and resistance that count as none."""
LEAST_M = 2e-7
"""Motion of a tick that counts as rest [m]: so near the cut that it lies in, voxels do not show
what a tool meets.
"""
CONE = 0.3
"""Pull across what has resisted, over that along it, below which a resting tool presses and does
not slide: Coulomb's coefficient of metal on bone, see `tissue.haptics.proxy.probing_tool`."""
PRESS = 0.02
"""Share by which the heading of a tool that presses turns to the pull a tick: one that slides on
after the next step of its device's encoders, in about 10 ms, goes on as it did."""
VISCOUS = 30.0
"""Resistance over stiffness and step from which a motion is slow by itself, so that no creeping
counts as rest.
"""
CAREFUL_M = 5e-6
"""Longest motion of a tool's first tick, each further one being at most twice as long [m]: what was
cut on another heading is free up to its surface, and full bone a micrometre on."""
TOO_MUCH = 1.2
"""Force of a cut over the spring's pull from which the balance is found anew: they differ by
what changes in a tick.
"""
SMALL_RAD = 5e-3
"""Turn of the heading below which a change of the force is laid to the place rather than to the
heading.
"""
LARGE_RAD = 0.1
"""Turn of the heading from which the tissue is asked again before the tool moves: half the width
of a shallow cut.
"""
STEADY = 0.2
"""Share of a change of the torque that the spring of rotation is given a tick: it jumps as the tool
rests and goes on, which the tool's turn has no part in."""
SLOWLY = 0.9
"""Share of a slope that is still reckoned with a tick after a smaller one was found."""
DAMPED = 6.0
"""Slope of the resistance in a Newton step over the one found: the motion that it is multiplied by
turns with the heading. Of 1 to 12 it is where a reamer does not shake in its seat and milling does
not turn too late.
"""
SMOOTH_S = 0.2
"""Time over which the tool's velocity is smoothed for the damper [s]. On three runs of milling and
one of caries the forces of a tool at the device's true and at its measured positions differ by 15
and 6 %, in the mean; with 0.07 s by 18 and 5, with 0.6 s by 13 and 8 %. A damper to the device's
velocity leaves 11 and 12 %, but a tenth of what the tissue meets would not be felt while a tool is
being slowed."""
NEAREST = 0.2
"""Least share of the pull along the heading that a turn of the heading leaves."""


class CuttingTool(HeldTool):
    """A tool in a tissue that yields only by being cut, such as bone.

    In a step T the tip moves by s u, and spring and cut balance as vectors at its end::

        k (x_device - x - s u) + b (V - s u / T) = E(u) + C(u) s / T,    s >= 0

    with the edge force E and the resistance C that the tissue gives for the unit heading u. The
    damper b acts against what differs from the tool's own smoothed velocity V: none at a steady
    pace or at rest. Without it a tool that spins, whose edge force acts across its motion, runs
    about on its spring, and any difference grows.

    Along the heading this is implicit in s, for resistances up to 1e5 N s/m; below the edge force
    the tool rests, and the tissue answers the spring in full, and with the share of the edges'
    torque that it pulls of their force. Across it the unknown is the heading: a cutter that leans
    into the tissue is pushed out of it, so that a small turn of it changes the force far more than
    a tick's motion changes the spring's. What is missing across, r, turns the heading by one Newton
    step a tick, also at rest::

        u' ~ u + r / S,    S = |dE/du| + (6 |dC/du| / T + k + b / T) s

    The slopes are how far E and C have changed with the last headings, at least E and C themselves
    for each radian; a greater one counts at once, a smaller one gradually. Before a large turn, or
    where the pull is away from the heading that the tissue was asked about, the tool waits and the
    tissue is asked again within the tick. No step is longer than the stretch along its heading, so
    the spring gives energy to the tool and never takes any; nor, against what resists, than twice
    the last one.

    What has resisted is remembered as a vector, which fades over some ticks of motion: straight on
    all of it counts, straight back nothing. Then the tip goes to where the device is, what is left
    of the stretch fading as fast. So a device whose encoder steps does not jump between air and
    bone.

    Parameters
    ----------
    stiffness_N_m, tip_m, turn
        See `HeldTool`.
    damping_N_s_m
        Of the damper, in the tissue's newtons [N s/m].
    """

    def __init__(
        self,
        stiffness_N_m: float,
        tip_m: Array,
        turn: HeldTurn | None = None,
        *,
        damping_N_s_m: float = 0.0,
    ) -> None:
        super().__init__(stiffness_N_m, tip_m, turn)
        self._damping = require_range(
            "damping_N_s_m", damping_N_s_m, 0.0, 1e6, "use a hundredth of the stiffness"
        )
        self._speed_m_s = np.zeros(3)
        self._again = False
        self._moved_m = np.zeros(3)
        self._felt = np.zeros((2, 3))
        self._last = np.zeros((2, 3))
        self._asked = np.zeros(3)
        self._slopes = [0.0, 0.0]
        self._left_m, self._twist_Nm, self._torque_Nm = np.zeros((3, 3))
        self._gone_m = self._pull_N = 0.0
        self._asks = False
        self._before_m = 0.0

    def follow(
        self, device_m: Array, device: Quaternion, response: Response, heading: Array, step_s: float
    ) -> Array:
        """Solve the balance along the heading, move, and turn the heading by what is missing
        across.
        """
        self._torque_Nm += STEADY * (response.wrench[3:] - self._torque_Nm)
        self._turn.follow(device, self._torque_Nm if self.driven else response.wrench[3:])
        # [N], [N/m]
        resisted = np.array((response.edge[:3], response.resistance[:3])) * (
            (-1.0,),
            (-1.0 / step_s,),
        )
        sizes = self._feel(resisted, response.edge[3:], heading)
        stretch = device_m - self.tip_m
        spring = self.stiffness_N_m
        damping = self._damping / step_s
        pull = spring * stretch + self._damping * self._pace_m_s(step_s)
        asked = self._asks
        self._asks = False
        self.push[:] = self._pull_N = self._gone_m = 0.0
        self.driven = sizes[0] > LEAST_N or sizes[1] * step_s > LEAST_N_s_m
        if not self.driven:
            self._let_go(stretch)
            return self.tip_m
        along = float(stretch.dot(heading))
        if along < 0.0:
            self.heading = stretch / sqrt(stretch.dot(stretch))
            return self._wait(stretch, not asked)
        edge, drag = np.maximum(np.maximum(resisted @ heading, self._felt @ heading), 0.0).tolist()
        step = max(float(pull.dot(heading)) - edge, 0.0) / (spring + damping + drag)
        if float(self._felt[0].dot(heading)) >= 0.0 or resisted.any():
            step = min(step, max(2.0 * self._before_m, CAREFUL_M))
        across = pull - resisted[0] - step * resisted[1]
        across -= float(across.dot(heading)) * heading
        missing = sqrt(across.dot(across))
        slope = (
            max(self._slopes[0], sizes[0])
            + (DAMPED * max(self._slopes[1], sizes[1]) + spring + damping) * step
        )
        self.heading = _turned(heading, across / (max(slope, missing) or 1.0), stretch)
        step = min(step, _furthest(stretch, self.heading, self._moved_m))
        if (step < LEAST_M and drag < VISCOUS * spring) or step == 0.0:
            if self._presses(stretch):
                towards = heading + PRESS * (stretch / sqrt(stretch.dot(stretch)) - heading)
                self.heading = towards / sqrt(towards.dot(towards))
            return self._wait(stretch, False)
        if missing > LARGE_RAD * slope and not asked:
            return self._wait(stretch, True)
        self.tip_m += step * self.heading
        self._moved_m = self._moved_m + step * self.heading
        self._left_m = device_m - self.tip_m
        self._gone_m = step
        self._before_m = step
        self._pull_N = float(pull.dot(self.heading)) - (spring + damping) * step
        return self.tip_m

    def lands(self, response: Response, heading: Array) -> bool:
        """Whether the cut takes more than the spring pulls, or answers a new heading; what is
        cut stays cut.
        """
        force = response.wrench[:3]
        met = -float(force.dot(heading)) if self.driven else sqrt(force.dot(force))
        moved = self._gone_m > 0.0 or not self.driven
        self._again = self._asks or (moved and met > TOO_MUCH * self._pull_N + LEAST_N)
        return self._again

    def _pace_m_s(self, step_s: float) -> Array:
        """The smoothed velocity of the tool, which a second answer in a tick leaves as it is
        [m/s].
        """
        if not self._again:
            if self.driven:
                self._speed_m_s += min(step_s / SMOOTH_S, 1.0) * (
                    self._moved_m / step_s - self._speed_m_s
                )
            else:
                self._speed_m_s[:] = 0.0
            self._moved_m = np.zeros(3)
        self._again = False
        return self._speed_m_s

    def _feel(self, resisted: Array, twist_Nm: Array, heading: Array) -> list[float]:
        """Keep what resists, and how it has changed with the heading; sizes of what is kept [N],
        [N/m].
        """
        turned = heading - self._asked
        square = float(turned.dot(turned))
        share = sqrt(square) / (square + SMALL_RAD**2)
        changed = resisted - self._last
        held = float(self.push.dot(self.push)) > (LEAST_N + 2.0 * self.stiffness_N_m * LEAST_M) ** 2
        keep = 1.0 if held else FADE
        sizes = [0.0, 0.0]
        for i in range(2):
            self._slopes[i] = max(
                share * sqrt(changed[i].dot(changed[i])), SLOWLY * self._slopes[i]
            )
            now = sqrt(resisted[i].dot(resisted[i]))
            before = keep * sqrt(self._felt[i].dot(self._felt[i]))
            sizes[i] = max(now, before)
            self._felt[i] = resisted[i] if now >= before else keep * self._felt[i]
            if i == 0 and now >= before:
                np.negative(twist_Nm, out=self._twist_Nm)
        self._asked = heading.copy()
        self._last = resisted
        return sizes

    def _wait(self, stretch: Array, asks: bool) -> Array:
        """Stay, held by the spring; the tip."""
        self._asks = asks
        self._left_m = stretch
        if not asks:
            self._before_m = 0.0
        np.multiply(stretch, self.stiffness_N_m, out=self.push[:3])
        edge = self._felt[0]
        square = float(edge.dot(edge))
        if square > 0.0:
            self.push[3:] = (
                min(max(float(self.push[:3].dot(edge)) / square, 0.0), 1.0) * self._twist_Nm
            )
        return self.tip_m

    def _presses(self, stretch: Array) -> bool:
        """Whether the pull lies in the cone about what has resisted in which a tool on bone does
        not slide.
        """
        edge = self._felt[0]
        normal = float(stretch.dot(edge))
        return normal > 0.0 and (1.0 + CONE**2) * normal**2 > float(stretch.dot(stretch)) * float(
            edge.dot(edge)
        )

    def _let_go(self, stretch: Array) -> None:
        """Go to the device, but for a rest of the stretch that was left."""
        left = FADE * self._left_m
        if (
            float((stretch - left).dot(left)) < 0.0
            or self.stiffness_N_m * sqrt(left.dot(left)) < LEAST_N
        ):
            left = np.zeros(3)
        self.tip_m += stretch - left
        self._left_m = left


def _turned(heading: Array, turn: Array, stretch: Array) -> Array:
    """A heading that has turned, so far as that leaves some of the stretch along it."""
    along = float(heading.dot(stretch))
    more = float(turn.dot(stretch))
    if along + more < NEAREST * along:
        turn = turn * ((NEAREST - 1.0) * along / more)
    turned: Array = heading + turn
    turned /= sqrt(turned.dot(turned))
    return turned


def _furthest(stretch: Array, heading: Array, moved: Array) -> float:
    """Longest step s from which the spring still pulls along all that was moved in a tick.

    (stretch - s u) . (moved + s u) >= 0.
    """
    more = float(stretch.dot(heading)) - float(moved.dot(heading))
    return 0.5 * (more + sqrt(more * more + 4.0 * max(float(stretch.dot(moved)), 0.0)))
