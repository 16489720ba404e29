"""Static equilibrium of a nonlinear body: Newton's method on its energy, with a rigid sphere if one presses.

Each Newton step solves with the tangent by conjugate gradients, preconditioned by one factorisation of the stiffness at
rest, and stops at a direction of negative curvature (Steihaug 1983, SIAM J. Numer. Anal. 20:626): the direction always
lowers the energy. The step is halved until energy and slope fall; a step that turns a cell over has infinite energy
and is never taken. A sphere's multipliers are corrected between such solves.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_array

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_positive
from tissue.fem.conjugate_gradients import conjugate_gradients
from tissue.fem.hyperelastic import NonlinearBody
from tissue.fem.obstacle import RigidSphere
from tissue.fem.outcome import Solution, SolverOutcome
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import HeldBody

__all__ = ["NewtonSolution", "NewtonSolver"]

HALVINGS = 30
ARMIJO = 1e-4
ROUNDING = 1e-12
POSITIONS = 4e-13
"""Rounding of nodal forces over stiffness times size of the body."""
CORRECTIONS = 60
"""Corrections of a sphere's multipliers: each leaves a tenth of the penetration or less."""
LINEAR_LIMIT = 500


@dataclass(frozen=True, eq=False)
class NewtonSolution(Solution):
    """Displacement and how it was reached, in how many steps of Newton's method.

    The residual is the largest force that nothing balances, over the largest that something does.

    Attributes
    ----------
    force_N
        Derivative of the elastic energy [N], shape (n, 3): what the supports and the sphere push with.
    tool_force_N
        Force that the body pushes the sphere with [N], shape (3,); zero without one.
    """

    force_N: Array
    tool_force_N: Array


class NewtonSolver:
    """Equilibria of a body with held components.

    Parameters
    ----------
    body
        The body.
    held
        Components whose displacement is prescribed, shape (n, 3).
    tolerance
        Residual force allowed, over the largest force in the body.
    step_limit
        Newton steps allowed in a solve.
    precondition
        Close to the inverse of the stiffness at rest of the free components, on vectors; default: its factorisation.

    Raises
    ------
    InputError
        If what is held leaves a part free to move, or the shape is wrong.
    """

    def __init__(
        self,
        body: NonlinearBody,
        held: NDArray[np.bool_],
        *,
        tolerance: float = 1e-8,
        step_limit: int = 60,
        precondition: Callable[[Array], Array] | None = None,
    ) -> None:
        if held.shape != body.nodes_m.shape or not held.any():
            raise InputError(
                f"held must mark components of shape {body.nodes_m.shape}, got {int(held.sum())} of {held.shape}: "
                "hold a face"
            )
        self.body, self.held = body, held
        self._tolerance = require_positive("tolerance", tolerance, "use 1e-8")
        self._step_limit = step_limit
        self._free = np.flatnonzero(~held.ravel())
        rest = body.stiffness(np.zeros(held.shape))
        self.rest_diagonal = rest.diagonal()
        """Diagonal of the stiffness at rest [N/m], shape (3n,)."""
        # A turned body without stress has forces of rounding alone, and no other to compare them with.
        extent = float(np.ptp(body.nodes_m, axis=0).max())
        self._rounding_N = POSITIONS * float(self.rest_diagonal.max()) * extent
        self._rounding_J = ROUNDING * 1e-2 * float(self.rest_diagonal.max()) * extent**2
        self.precondition = precondition or _at_rest(HeldBody(rest, body.nodes_m, held))
        """Close to the inverse of the stiffness at rest; another solver with the same supports may use it."""

    def solve(
        self,
        held_m: Array | None = None,
        *,
        sphere: RigidSphere | None = None,
        start_m: Array | None = None,
    ) -> NewtonSolution:
        """Equilibrium with held components at ``held_m`` [m], shape (n, 3), from ``start_m`` [m]; default: zero.

        With a sphere, its multipliers are corrected until it is settled.

        Raises
        ------
        InputError
            If a held displacement is not finite.
        """
        now = np.zeros(self.held.shape) if start_m is None else np.array(start_m, dtype=np.float64)
        goal = np.zeros(self.held.shape) if held_m is None else held_m
        if not np.isfinite(goal).all():
            raise InputError("held_m must be finite, got NaN or infinity: name every node, 0 where it stays")
        move = np.where(self.held, goal - now, 0.0)
        steps = 0
        if move.any():
            now = self._moved_on(now, move)
        for _ in range(CORRECTIONS):
            now, outcome, residual, more = self._minimum(now, sphere)
            steps += more
            if outcome is not SolverOutcome.CONVERGED or sphere is None or sphere.settled(self.body.nodes_m + now):
                break
            outcome = SolverOutcome.NOT_CONVERGED
        _, force = self.body.energy_and_force(now)
        push = sphere.force_N(self.body.nodes_m + now) if sphere is not None else np.zeros(3)
        return NewtonSolution(now, outcome, steps, residual, force, push)

    def _moved_on(self, start: Array, move: Array) -> Array:
        """The start with held components moved and the free ones following to first order, if no cell turns over."""
        tangent = self.body.stiffness(start)
        following = start + move + self._direction(tangent, -(tangent @ move.ravel()), 1e-3)
        return following if np.isfinite(self.body.energy_and_force(following)[0]) else start + move

    def _minimum(self, now: Array, sphere: RigidSphere | None) -> tuple[Array, SolverOutcome, float, int]:
        """Newton's method from here with the sphere's multipliers kept: place, outcome, residual and steps."""
        energy, size, slope = self._state(now, sphere)
        if not np.isfinite(energy):
            return now, SolverOutcome.INVERTED, np.inf, 0
        for step_count in range(self._step_limit + 1):
            left = float(np.abs(slope).max())
            residual = left / size if size > 0.0 else float(left > 0.0)
            if residual <= self._tolerance or left <= self._rounding_N:
                return now, SolverOutcome.CONVERGED, residual, step_count
            if step_count == self._step_limit:
                break
            accuracy = max(min(0.1, residual), 0.1 * self._tolerance / residual)
            step = self._direction(self._whole(now, sphere), -slope.ravel(), accuracy)
            downhill = float(np.sum(slope * step))
            share = 1.0
            for _ in range(HALVINGS):
                trial = now + share * step
                there = self._state(trial, sphere)
                lower = there[0] <= energy + ARMIJO * share * downhill
                rounding = (
                    there[0] <= energy + ROUNDING * abs(energy) + self._rounding_J
                )  # near the end the slope alone is exact
                if lower or (rounding and abs(float(np.sum(there[2] * step))) <= 0.5 * abs(downhill)):
                    break
                share *= 0.5
            else:
                return now, SolverOutcome.STALLED, residual, step_count
            now, (energy, size, slope) = trial, there
        return now, SolverOutcome.NOT_CONVERGED, residual, self._step_limit

    def _state(self, displacement: Array, sphere: RigidSphere | None) -> tuple[float, float, Array]:
        """Energy [J], largest force in the body [N], and the energy's derivative, zero where held [N]."""
        energy, force = self.body.energy_and_force(displacement)
        size, slope = np.abs(force).max(), force
        if sphere is not None and np.isfinite(energy):
            extra, push = sphere.energy_and_force(self.body.nodes_m + displacement)
            energy, size, slope = energy + extra, max(size, np.abs(push).max()), force.copy()
            slope[sphere.nodes] += push
        return energy, float(size), np.where(self.held, 0.0, slope)

    def _whole(self, displacement: Array, sphere: RigidSphere | None) -> bsr_array:
        """Second derivative of the energy."""
        tangent = self.body.stiffness(displacement)
        if sphere is not None:
            row = np.repeat(np.arange(self.body.space.node_count), np.diff(tangent.indptr))
            diagonal = np.flatnonzero(row == tangent.indices)  # one block a node, in rising order
            tangent.data[diagonal[sphere.nodes]] += sphere.blocks(self.body.nodes_m + displacement)
        return tangent

    def _direction(self, whole: bsr_array, load: Array, accuracy: float) -> Array:
        """Conjugate gradients for the free components, ended early at negative curvature."""
        free, full = self._free, np.zeros(self.held.size)

        def product(step: Array) -> Array:
            full[free] = step
            return np.asarray((whole @ full)[free])

        found = conjugate_gradients(
            product, load[free], precondition=self.precondition, tolerance=accuracy, limit=LINEAR_LIMIT,
            error=lambda now: float(np.sqrt(now.slopes[-1] / now.slopes[0])),
        )  # fmt: skip
        bent = found.outcome is SolverOutcome.INDEFINITE and found.iterations == 0
        full[free] = self.precondition(load[free]) if bent else found.displacement_m
        return full.reshape(self.held.shape)


def _at_rest(body: HeldBody) -> Callable[[Array], Array]:
    """Displacements of the free components by the stiffness at rest."""
    solver = DirectSolver(body)
    return lambda force: solver.solve(body.whole(force)).displacement_m.ravel()[body.free]
