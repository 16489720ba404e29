"""Tool with inertia that cuts, coupled to a haptic device by a spring and a damper."""

from math import inf, pi, sqrt
from typing import Protocol, runtime_checkable

import numpy as np
from scipy.linalg.lapack import dgesv

from meshes.base.arrays import Array
from tissue.haptics.proxy.held_tool import HeldTool, HeldTurn
from tissue.models.tissue_model import Response
from tissue.motion.motion import matrix_of
from tissue.motion.quaternion import Quaternion, exponential, product, turn_between

NATURAL_Hz = 40.0
"""Natural frequency of the tool on the coupling spring [Hz]; it determines the tool's mass.

The value is below the rate at which encoder steps excite the tool. At 5 mm/s, steps of 55 um have a
rate of 91 Hz. For a spring of 28 kN/m, as in reaming, the mass is 0.44 kg. Handpieces have a mass
of 0.05 to 0.5 kg.
"""
DAMPING_RATIO = 1.0
"""Damping of the tool in free space, divided by the critical damping.

At critical damping, encoder steps do not make the tool oscillate.
"""
GYRATION_M = 0.05
"""Assumed radius of gyration of the tool about its tip [m], as for a rod of 0.09 m length."""
LEVER = np.array([1.0, 1.0, 1.0, GYRATION_M, GYRATION_M, GYRATION_M])
"""Factors that convert a wrench to six forces [N] and a velocity to six speeds [m/s].

A wrench contains force [N] and torque [N m] and is divided by the factors. A velocity contains
velocity [m/s] and angular velocity [rad/s] and is multiplied by the factors. The last three factors
are the radius of gyration [m], so that the inertia of all six components is the mass of the tool.
"""
LEVERS = np.outer(LEVER, LEVER)
"""Divisors for the derivatives of a wrench with respect to a velocity, see `LEVER`."""
TOLERANCE = 1e-6
"""Largest residual of the force balance, relative to the force that drives the tool.

The value is the relative rounding error of forces in single precision.
"""
LEAST_N = 1e-4
"""Residual of the force balance that is always accepted [N].

Because of this value, a tool at rest needs no Newton step.

The value is far below any force that a device can render.
"""
MOST_STEPS = 24
"""Largest number of evaluations of the force in a tick.

The value limits the time of a tick. When it is reached, the tool keeps the last accepted velocity.
"""
SLOW = 1e-6
"""Velocity at which Newton's method restarts, divided by the velocity of a free tool.

The value is a design choice. At this velocity, no edge force of the cutter has reached its full
value. The velocity is not zero, so that the direction of motion is defined.
"""
SHORTEST = 1e-4
"""Share of a Newton step below which the line search accepts a point without a test.

The value is a design choice. Such a small share means that the force has a kink near the point. At
a kink, the test of the line search fails for every share of the step.
"""


@runtime_checkable
class CutTissue(Protocol):
    """Interface of a tissue that computes the force on a tool for any velocity of the tool."""

    def find_bone(self, tip_m: Array, rotation: Array, velocity: Array, step_s: float) -> None:
        """Find the bone around the tool at the pose that the tool would reach in a step.

        ``velocity`` contains velocity and angular velocity along the axes of the tool, shape (6,).
        """

    def forces(self, velocity: Array, *, unknowns: int) -> tuple[Array, Array]:
        """Return the force and torque on the tool, linearised at a velocity.

        The first array is the value of the linear function at zero velocity, shape (6,). The second
        array, shape (6, unknowns), has its derivatives with respect to the first 3 or all 6
        components of the velocity. With 3 unknowns, the torque in the first array is the torque at
        ``velocity``, not at zero velocity.

        All vectors have components along the axes of the tool at the pose of `find_bone`.
        """


class CuttingTool(HeldTool):
    """Tool with inertia in a tissue that yields only to cutting, such as bone.

    In a step T, the velocity v of the tip satisfies::

        m (v - v_before) / T = k (x_device - x - T v) + b (v_device - v) + F(v)

    Here x and v are position and velocity of the tip, m is the mass of the tool, and k and b are
    stiffness and damping of the coupling. F is the force of the tissue, a Lipschitz function of the
    velocity. The bone at the cutting elements is found only once per step, at the pose that the
    tool would reach with its present velocity. Newton's method solves this force balance. The force
    is differentiable except at kinks, where it has different slopes on the two sides (semi-smooth).

    For a device that can apply torque, the angular velocity is computed by a second balance. This
    balance of torques contains the moment of inertia about the tip, the rotational spring and a
    damper. Otherwise, the tool turns with the device.

    Parameters
    ----------
    stiffness_N_m, tip_m, turn
        See `HeldTool`.

    Attributes
    ----------
    mass_kg
        Mass of the tool at its tip [kg].
    steps
        Number of evaluations of the force in the last step.
    tip_m, velocity, wrench
        See `HeldTool`.
    """

    velocity: Array
    wrench: Array

    def __init__(self, stiffness_N_m: float, tip_m: Array, turn: HeldTurn | None = None) -> None:
        super().__init__(stiffness_N_m, tip_m, turn)
        self.mass_kg = stiffness_N_m / (2.0 * pi * NATURAL_Hz) ** 2
        self.velocity = np.zeros(6)
        self.wrench = np.zeros(6)
        self.steps = 0
        # mass and step for which the terms of the balance were computed
        self._prepared: tuple[float, float] | None = None
        self._tissue: CutTissue | None = None
        self._start = np.eye(3)
        # rotation in the last search, and its matrix
        self._searched: Quaternion | None = None
        self._rotation = np.eye(3)

    def set_tissue(self, tissue: CutTissue, rotation: Array) -> None:
        """Set the tissue, and the initial rotation from tool to world."""
        self._tissue = tissue
        self._start = rotation.copy()
        self._searched = None

    def rest(self) -> None:
        """Set velocity and wrench of the tool to zero."""
        self.velocity[:] = 0.0
        self.wrench[:] = 0.0

    def follow(
        self,
        device_m: Array,
        device: Quaternion,
        velocity: Array,
        response: Response,
        step_s: float,
    ) -> Array:
        """Move one step towards the device, and return the tip position."""
        if self._prepared != (self.mass_kg, step_s):
            self._prepare(step_s)
        unknowns = len(self._falling)
        free = slice(unknowns)
        turned = self._turn.quaternion
        found = self.velocity.copy()
        left = np.zeros(6)
        np.subtract(device_m, self.tip_m, out=left[:3])
        if unknowns == 6 or device != turned:
            left[3:] = turn_between(turned, device)
        if unknowns == 3:
            found[3:] = left[3:] / step_s
        # The driving forces are given at zero velocity. They decrease linearly with the velocity.
        driving = self._inertia * found[free] + self._springs * left[free]
        driving += self._dampers * velocity[free]
        if self._tissue is not None:
            if any(found[3:].tolist()):
                turned = product(exponential(tuple(step_s * found[3:])), turned)
            if turned != self._searched:
                self._searched = turned
                self._rotation = matrix_of(np.array(turned)) @ self._start
            self._balance(self._tissue, driving, found, step_s)
        else:
            found[free] = driving / self._falling / self._lever
        self.velocity = found
        self.tip_m += step_s * found[:3]
        self._turn.quaternion = (
            device
            if unknowns == 3
            else product(exponential(tuple(step_s * found[3:])), self._turn.quaternion)
        )
        return self.tip_m

    def _prepare(self, step_s: float) -> None:
        """Compute the terms of the force balance that depend only on the mass and the time step."""
        springs = np.full(3, self.stiffness_N_m)
        turning = self._turn.stiffness_Nm_rad
        if turning < inf:
            # The rotational spring acts like a spring at the radius of gyration.
            springs = np.append(springs, np.full(3, turning / GYRATION_M**2))
        dampers = 2.0 * DAMPING_RATIO * np.sqrt(self.mass_kg * springs)
        inertia = self.mass_kg / step_s
        self._falling = inertia + springs * step_s + dampers
        self._resisting = np.diag(self._falling)
        self._lever = lever = LEVER[: len(springs)]
        self._inertia = lever * inertia
        self._springs = lever * springs
        self._dampers = lever * dampers
        self._prepared = self.mass_kg, step_s

    def _balance(self, tissue: CutTissue, driving: Array, velocity: Array, step_s: float) -> None:
        """Change the velocity until ``falling u = driving + F(u)``, and set `wrench`.

        The unknowns u are the first three or all six components of the velocity, multiplied by
        `LEVER`. ``driving`` is the force of inertia, spring and damper at zero velocity. This force
        decreases with the velocity, and ``falling`` is the decrease per velocity. The balance is
        solved in components along the axes of the tool. The argument `velocity` is the velocity
        before the step.
        """
        rotation = self._rotation
        falling = self._falling
        lever = self._lever
        unknowns = len(driving)
        free = slice(unknowns)
        turns = unknowns == 6
        now = velocity.reshape(2, 3).dot(rotation).reshape(6)
        tissue.find_bone(self.tip_m + step_s * velocity[:3], rotation, now, step_s)
        driven = driving.reshape(-1, 3).dot(rotation).reshape(unknowns)
        accepted = TOLERANCE * sqrt(driven.dot(driven)) + LEAST_N
        line = _Line(now[free] * lever)
        is_slow = False
        best = line.tried
        meets = False
        for count in range(1, MOST_STEPS + 1):
            self.steps = count
            tried = line.tried
            now[free] = tried / lever
            value, slopes = tissue.forces(now, unknowns=unknowns)
            if turns:
                value = value / LEVER
                slopes = slopes / LEVERS
            force = value[free] + slopes[free].dot(tried)
            missing = driven + force - falling * tried
            is_close = sqrt(missing.dot(missing)) <= accepted
            if is_close or line.accepts(missing):
                best = tried
                self.wrench[3:] = value[3:]
                meets = float(force.dot(force)) > 0.0
                if is_close:
                    break
                line.begin(self._resisting - slopes[free], missing)
            elif not is_slow:
                # Near zero velocity no edge force has reached its full value. A Newton step from
                # there does not jump over the range in which an edge force increases. From a
                # velocity in this range, a step could jump back.
                is_slow = True
                line = _Line(SLOW * driven / falling)
        if not meets:
            self.wrench[:] = 0.0
            velocity[free] = driving / falling / lever
            return
        velocity[free] = best.reshape(-1, 3).dot(rotation.T).reshape(unknowns) / lever
        self.wrench[3:] = rotation.dot(self.wrench[3:])
        # The force is changed by the residual, so that the momentum balance is exact. A change of
        # the velocity instead would change the force of the tissue far more.
        self.wrench[free] = lever * (falling * lever * velocity[free] - driving)


class _Line:
    """Line search along Newton steps: monotonicity test of Deuflhard (2004), algorithm NLEQ-ERR.

    At a trial point, the residual and the matrix at the start of the step give a simplified Newton
    correction. The point is accepted if the correction is shorter than the step. Otherwise, a
    shorter step is tried.

    Attributes
    ----------
    tried
        Next point to evaluate, shape (n,).
    """

    def __init__(self, start: Array) -> None:
        self.tried = start.copy()
        self._start = start
        self._system = np.zeros((0, 0))
        self._step = np.zeros(0)
        self._share = 0.0

    def begin(self, matrix: Array, missing: Array) -> None:
        """Begin a Newton step at the accepted point, with its matrix and residual."""
        self._start = self.tried
        self._system = matrix
        *_, self._step, _ = dgesv(matrix, missing)
        # After a shortened step, the next step is at most four times as long.
        self._share = min(1.0, 4.0 * self._share) if self._share > 0.0 else 1.0
        self.tried = self._start + self._share * self._step

    def accepts(self, missing: Array) -> bool:
        """Return True to accept the tried point with this residual; otherwise, shorten the step."""
        share = self._share
        if share == 0.0:
            return True
        *_, left, _ = dgesv(self._system, missing)
        size = sqrt(self._step.dot(self._step))
        if left.dot(left) <= ((1.0 - 0.25 * share) * size) ** 2 or share < SHORTEST:
            return True
        bent = left - (1.0 - share) * self._step
        guess = 0.5 * size * share * share / sqrt(bent.dot(bent))
        self._share = min(max(guess, 0.1 * share), 0.5 * share)
        self.tried = self._start + self._share * self._step
        return False
