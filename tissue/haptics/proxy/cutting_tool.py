"""Tool with inertia that cuts, coupled to a haptic device by a spring and a damper."""

from math import inf, sqrt
from typing import Protocol, runtime_checkable

import numpy as np
from scipy.linalg.lapack import dgesv

from meshes.base.arrays import Array
from tissue.haptics.proxy.held_tool import HeldTool, HeldTurn
from tissue.models.tissue_model import Response
from tissue.motion.motion import matrix_of
from tissue.motion.quaternion import Quaternion, exponential, product, turn_between

__all__ = ["CutTissue", "CuttingTool"]

MASS_KG = 0.1
"""Mass of the tool at its tip [kg], for a handpiece of 0.05 to 0.5 kg; chosen."""
FREQ = 0.0
DAMPING_RATIO = 1.0
"""Ratio of the damper to that of a critically damped tool in free space; chosen."""
GYRATION_M = 0.05
"""Radius of gyration of the tool about its tip [m]: of a rod of 0.09 m; chosen."""
TOLERANCE = 1e-6
"""Largest residual of the balance, relative to the force that drives the tool.

It is the rounding of forces in single precision.
"""
LEAST_N = 1e-4
"""Residual that is always accepted [N]."""
MOST_STEPS = 24
"""Largest number of evaluations of the force in a tick."""
REDUCED = 0.5
"""Ratio by which a step must reduce the residual to be followed by another Newton step."""


@runtime_checkable
class CutTissue(Protocol):
    """Tissue whose force on a tool is known for any velocity."""

    def find_bone(self, tip_m: Array, rotation: Array) -> None:
        """Find the bone around the whole tool at a pose."""

    def forces(
        self, velocity: Array, before: Array, step_s: float, *, unknowns: int
    ) -> tuple[Array, Array]:
        """Return the tangent of force and torque on the tool at a velocity."""


class CuttingTool(HeldTool):
    """Tool with inertia in a tissue that yields only to cutting, such as bone.

    In a step T, the velocity v of the tip satisfies::

        m (v - v_before) / T = k (x_device - x - T v) + b (v_device - v) + F(v)

    F is the force of the tissue in this step, a Lipschitz function of the velocity. Its elements
    are found once, at the pose that the tool would reach with its present velocity. Newton's method
    solves the balance. The force is differentiable except at kinks, where it has a slope on each
    side (semi-smooth). A step that does not reduce the residual is halved.

    For a device that plays torque, the angular velocity is a further unknown, with the moment of
    inertia about the tip, the spring of rotation and its damper. For any other device, the tool
    turns with the device.

    Parameters
    ----------
    stiffness_N_m, tip_m, turn
        See `HeldTool`.

    Attributes
    ----------
    mass_kg
        Mass of the tool at its tip [kg].
    velocity
        Velocity of the tip [m/s] and angular velocity [rad/s], shape (6,).
    wrench
        Force [N] of the tissue and its torque about the tip [N m] in the last step, shape (6,).
    steps
        Evaluations of the force in the last step.
    """

    def __init__(self, stiffness_N_m: float, tip_m: Array, turn: HeldTurn | None = None) -> None:
        super().__init__(stiffness_N_m, tip_m, turn)
        self.mass_kg = MASS_KG if FREQ == 0.0 else stiffness_N_m / (6.2831853 * FREQ) ** 2
        self.velocity = np.zeros(6)
        self.wrench = np.zeros(6)
        self.steps = 0
        self._tissue: CutTissue | None = None
        self._start = np.eye(3)

    def meet(self, tissue: CutTissue, rotation: Array) -> None:
        """Put the tool, with its first orientation from tool to world, into a tissue."""
        self._tissue = tissue
        self._start = rotation.copy()

    def rest(self) -> None:
        """Stop the tool where it is."""
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
        """Move a step towards the device, and return the tip."""
        spring = self.stiffness_N_m
        turning = self._turn.stiffness_Nm_rad
        mass = self.mass_kg
        inertia = mass * GYRATION_M**2
        damping = 2.0 * DAMPING_RATIO * sqrt(mass * spring)
        before = self.velocity.copy()
        left = np.array(turn_between(self._turn.quaternion, device))
        driving = np.zeros(6)
        driving[:3] = (
            mass / step_s * before[:3] + spring * (device_m - self.tip_m) + damping * velocity[:3]
        )
        held = np.full(6, mass / step_s + spring * step_s + damping)
        if turning == inf:
            unknowns = 3
            before[3:] = left / step_s
        else:
            unknowns = 6
            twisting = 2.0 * DAMPING_RATIO * sqrt(inertia * turning)
            driving[3:] = inertia / step_s * before[3:] + turning * left + twisting * velocity[3:]
            held[3:] = inertia / step_s + turning * step_s + twisting
        turned = product(exponential(tuple(step_s * before[3:])), self._turn.quaternion)
        if self._tissue is not None:
            self._tissue.find_bone(
                self.tip_m + step_s * before[:3], matrix_of(np.array(turned)) @ self._start
            )
        found = self._balance(driving, held, before, step_s, unknowns)
        self.velocity = found
        self.tip_m += step_s * found[:3]
        self._turn.quaternion = (
            device
            if turning == inf
            else product(exponential(tuple(step_s * found[3:])), self._turn.quaternion)
        )
        return self.tip_m

    def _balance(
        self, driving: Array, held: Array, before: Array, step_s: float, unknowns: int
    ) -> Array:
        """Return the velocity at which ``held v = driving + F(v)``, and set `wrench`."""
        velocity = before.copy()
        if self._tissue is None:
            self.wrench[:] = 0.0
            velocity[:unknowns] = driving[:unknowns] / held[:unknowns]
            return velocity
        free = slice(unknowns)
        accepted = TOLERANCE * sqrt(driving.dot(driving)) + LEAST_N
        matrix = np.diag(held[free])
        best = velocity
        step = np.zeros(unknowns)
        share = 0.0
        system = matrix
        for count in range(1, MOST_STEPS + 1):
            value, slopes = self._tissue.forces(velocity, before, step_s, unknowns=unknowns)
            wrench = value + slopes.dot(velocity[free])
            residual = driving[free] + wrench[free] - held[free] * velocity[free]
            self.steps = count
            if sqrt(residual.dot(residual)) <= accepted:
                best = velocity
                self.wrench[:] = wrench
                break
            if share > 0.0:
                # The correction that the slopes at the start of the step ask for at its end.
                *_, left, _ = dgesv(system, residual)
                size = sqrt(step.dot(step))
                if sqrt(left.dot(left)) > (1.0 - 0.25 * share) * size:
                    bent = left - (1.0 - share) * step
                    guess = 0.5 * size * share * share / sqrt(bent.dot(bent))
                    share = min(max(guess, 0.1 * share), 0.5 * share)
                    if share > 1e-4:
                        velocity = best.copy()
                        velocity[free] += share * step
                        continue
            best = velocity
            self.wrench[:] = wrench
            system = matrix - slopes[free]
            *_, step, _ = dgesv(system, residual)
            share = 1.0 if share == 0.0 else min(1.0, 4.0 * share)
            velocity = best.copy()
            velocity[free] += share * step
        self.last = best.copy()
        # The momentum is balanced exactly by the force that has been found.
        best[free] = (driving[free] + self.wrench[free]) / held[free]
        return best
