"""Quasi-static force balance of a cutting tool coupled to a haptic device."""

from math import sqrt

import numpy as np

from meshes.base.arrays import Array
from tissue.haptics.proxy.held_tool import FADE, HeldTool, HeldTurn
from tissue.models.tissue_model import Response
from tissue.motion.quaternion import Quaternion

__all__ = ["CuttingTool"]

LEAST_N = 1e-3
LEAST_N_s_m = 1.0
"""Force [N] and resistance [N s/m] below which both count as zero."""
LEAST_M = 2e-7
"""Motion per tick below which a tool counts as resting [m].

So close to the previous cut surface, the voxels do not resolve the engagement of the tool.
"""
TANGENT_M_S = 1e-3
"""Lowest speed at which the cutting force is linearised [m/s].

The edge force of a slower burr is partial. At rest it is zero, with a steep derivative. Such a
tangent does not show the force that starts a motion, and its memory slows the tool afterwards. On
three runs of milling, a shift of the device path by 1 nm changes the force by 18 to 54 % with the
tangent at the tool's own speed, and by 10 to 21 % with this speed. Before the edge force was
partial, the change was 9 to 20 %.
"""
CONE = 0.3
"""Tangential over normal pull below which a resting tool presses and does not slide.

The direction of the felt resistance is the normal. The value is Coulomb's coefficient of metal on
bone, see `tissue.haptics.proxy.probing_tool`.
"""
PRESS = 0.02
"""Share per tick by which the direction of motion of a pressing tool turns to the pull.

A tool that slides again after the next encoder step of its device, in about 10 ms, keeps its
direction.
"""
VISCOUS = 30.0
"""Resistance over stiffness and step above which slow motion does not count as rest."""
CAREFUL_M = 5e-6
"""Longest motion of a tool in its first tick [m]; each further motion is at most twice as long.

Material cut in another direction is free up to its surface, and full bone a micrometre behind it.
"""
TOO_MUCH = 1.2
"""Ratio of cutting force to spring pull above which the balance is solved again.

Both differ by the changes within a tick.
"""
SMALL_RAD = 5e-3
"""Turn of the direction of motion below which a force change is attributed to the position."""
LARGE_RAD = 0.1
"""Turn of the direction of motion above which the tissue is evaluated again before the tool moves.

It is half the width of a shallow cut.
"""
STEADY = 0.2
"""Share of a torque change that is applied to the spring of rotation in a tick.

The torque jumps when the tool rests and starts again, which is unrelated to its rotation.
"""
SLOWLY = 0.9
"""Factor per tick by which a remembered slope decays after a smaller slope."""
DAMPED = 6.0
"""Slope of the resistance in a Newton step, relative to the measured slope.

The motion multiplied by it turns with the direction of motion. Among values from 1 to 12, a reamer
does not vibrate in its seat with this value, and milling does not turn too late.
"""
SMOOTH_S = 0.2
"""Smoothing time of the tool velocity for the damper [s].

On three milling runs and one caries run, the forces with the true and with the measured device
positions differ by 15 and 6 % on average. With 0.07 s they differ by 18 and 5 %, with 0.6 s by 13
and 8 %. A damper to the device velocity gives 11 and 12 %. However, a tenth of the tissue force
would then not be felt while a tool is slowed.
"""
NEAREST = 0.2
"""Smallest share of the pull along the direction of motion that remains after a turn."""


class CuttingTool(HeldTool):
    """Tool in a tissue that yields only to cutting, such as bone.

    In a step T, the tip moves by s u. Spring and cutting force balance as vectors at its end::

        k (x_device - x - s u) + b (V - s u / T) = E(u) + C(u) s / T,    s >= 0

    E is the edge force and C the resistance of the tissue for the unit direction of motion u. They
    are the tangent of the cutting force at the speed of the tool, at least at `TANGENT_M_S`. The
    damper b acts on the difference from the tool's own smoothed velocity V. It is zero at a steady
    speed or at rest. Without the damper, a spinning tool, whose edge force acts across its motion,
    moves erratically on its spring, and any difference grows.

    Along the direction of motion, the balance is implicit in s, for resistances up to 1e5 N s/m.
    Below the edge force, the tool rests. The tissue then balances the spring in full. The edge
    torque is scaled by the share of the edge force that the spring pulls. Across this direction,
    the unknown is the direction itself. A cutter that leans into the tissue is pushed out of it. A
    small turn therefore changes the force far more than the motion of a tick changes the spring
    force. The force residual r across turns the direction by one Newton step per tick, also at
    rest::

        u' ~ u + r / S,    S = |dE/du| + (6 |dC/du| / T + k + b / T) s

    The slopes are the changes of E and C with the last directions, at least E and C themselves per
    radian. A larger slope is used at once, a smaller one gradually. Before a large turn, or if the
    pull points away from the evaluated direction, the tool waits and the tissue is evaluated again
    within the tick. No step is longer than the stretch along its direction. The spring therefore
    gives energy to the tool and never takes any. Against resistance, no step is longer than twice
    the last one.

    The felt resistance is stored as a vector and fades over some ticks of motion. All of it acts on
    motion straight ahead, and it does not act on motion straight back. The tip then moves to the
    device, and the remaining stretch fades at the same rate. A device with encoder steps therefore
    does not jump between air and bone.

    Parameters
    ----------
    stiffness_N_m, tip_m, turn
        See `HeldTool`.
    damping_N_s_m
        Coefficient of the damper, in the tissue's newtons [N s/m].
    """

    tangent_m_s = TANGENT_M_S

    def __init__(
        self,
        stiffness_N_m: float,
        tip_m: Array,
        turn: HeldTurn | None = None,
        *,
        damping_N_s_m: float = 0.0,
    ) -> None:
        super().__init__(stiffness_N_m, tip_m, turn)
        self._damping = damping_N_s_m
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
        """Solve the balance along the direction of motion, move, and turn by the residual."""
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
        # A motion straight back meets no resistance and may be long.
        if float(self._felt[0].dot(heading)) >= 0.0 or resisted.any():
            step = min(step, max(2.0 * self._before_m, CAREFUL_M))
        across = pull - resisted[0] - step * resisted[1]
        across -= float(across.dot(heading)) * heading
        missing = sqrt(across.dot(across))
        slope = (
            max(self._slopes[0], sizes[0])
            + (DAMPED * max(self._slopes[1], sizes[1]) + spring + damping) * step
        )
        # At most one radian, where no slope is known yet.
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
        """Return whether the cut requires another evaluation within the tick.

        It does if the cutting force exceeds the pull of the spring, or a new direction was
        requested. Material that has been cut is not restored.
        """
        force = response.wrench[:3]
        # A free tool may land on bone from any side.
        met = -float(force.dot(heading)) if self.driven else sqrt(force.dot(force))
        moved = self._gone_m > 0.0 or not self.driven
        self._again = self._asks or (moved and met > TOO_MUCH * self._pull_N + LEAST_N)
        return self._again

    def _pace_m_s(self, step_s: float) -> Array:
        """Return the smoothed velocity of the tool [m/s].

        A second evaluation in a tick does not change it.
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
        """Store the resistance and its change with direction; return its sizes [N], [N/m]."""
        turned = heading - self._asked
        square = float(turned.dot(turned))
        # One over the turn, but zero for a turn well below SMALL_RAD.
        share = sqrt(square) / (square + SMALL_RAD**2)
        changed = resisted - self._last
        # A tool that rests against a pull has not left the tissue: what it felt does not fade. A
        # stretch of twice the smallest motion is no pull.
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
        """Rest, held by the spring, and return the tip."""
        self._asks = asks
        self._left_m = stretch
        # A tool that has rested starts with a careful step.
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
        """Return whether the pull lies in the friction cone around the felt resistance.

        A tool on bone does not slide within this cone.
        """
        edge = self._felt[0]
        normal = float(stretch.dot(edge))
        return normal > 0.0 and (1.0 + CONE**2) * normal**2 > float(stretch.dot(stretch)) * float(
            edge.dot(edge)
        )

    def _let_go(self, stretch: Array) -> None:
        """Move to the device, except for a fading rest of the stretch."""
        # The rest is dropped once the device has moved back over it, or its force is negligible.
        left = FADE * self._left_m
        if (
            float((stretch - left).dot(left)) < 0.0
            or self.stiffness_N_m * sqrt(left.dot(left)) < LEAST_N
        ):
            left = np.zeros(3)
        self.tip_m += stretch - left
        self._left_m = left


def _turned(heading: Array, turn: Array, stretch: Array) -> Array:
    """Return the turned direction, limited so that some of the stretch remains along it."""
    along = float(heading.dot(stretch))
    more = float(turn.dot(stretch))
    if along + more < NEAREST * along:
        turn = turn * ((NEAREST - 1.0) * along / more)
    turned: Array = heading + turn
    turned /= sqrt(turned.dot(turned))
    return turned


def _furthest(stretch: Array, heading: Array, moved: Array) -> float:
    """Return the longest step s for which the spring pulls along the whole motion of a tick.

    The condition is (stretch - s u) . (moved + s u) >= 0.
    """
    more = float(stretch.dot(heading)) - float(moved.dot(heading))
    # The larger root of the quadratic equation.
    return 0.5 * (more + sqrt(more * more + 4.0 * max(float(stretch.dot(moved)), 0.0)))
