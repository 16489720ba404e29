"""Static equilibrium of a nonlinear body by Newton's method, with an optional rigid sphere.

Conjugate gradients compute the direction of a Newton step from the tangent. The preconditioner is a
factorisation of the stiffness at rest. The iterations stop at a direction of negative curvature
(Steihaug 1983, SIAM J. Numer. Anal. 20:626), so that the resulting direction always lowers the
energy. The step is halved until the energy decreases. Near the minimum, differences of the energy
are rounding errors. There the slope along the step must fall to half instead. A step that inverts a
cell has infinite energy and is never used. The contact multipliers of a sphere are corrected
between two runs of Newton's method.

The sphere is rigid and without friction. Contact is evaluated at the surface nodes, with an
augmented Lagrangian (Simo and Laursen 1992, Comput. Struct. 42:97). Let g be the depth of a node
inside the sphere, k a penalty and p a multiplier [N]. The energy is ``sum (max(0, p + k g)^2 - p^2)
/ 2 k``. After each equilibrium ``p <- max(0, p + k g)``. In the end g <= 0 at nodes with p = 0, and
g = 0 at nodes with p > 0, for any penalty.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import bsr_array

from meshes.base.arrays import Array, Flags, Ints
from meshes.base.errors import InputError
from tissue.fem.conjugate_gradients import Solution, SolverOutcome, conjugate_gradients
from tissue.fem.hyperelastic import LinearBody, NonlinearBody
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import HeldBody


class RigidSphere:
    """Rigid sphere that may be in contact with the nodes of a surface.

    Parameters
    ----------
    nodes
        Nodes that may touch the sphere, shape (s,).
    penalty_N_m
        Contact penalty of each node [N/m], shape (s,). Ten times the stiffness of the node is a
        suitable value.
    radius_m
        Radius [m].
    centre_m
        Centre [m], shape (3,).
    tolerance
        Allowed final distance of a node in contact from the surface of the sphere, divided by the
        radius. A node is in contact if it lies inside the sphere or carries a contact force.
    """

    def __init__(
        self,
        nodes: Ints,
        penalty_N_m: Array,
        *,
        radius_m: float,
        centre_m: Array,
        tolerance: float = 1e-6,
    ) -> None:
        self.nodes = nodes
        self.radius_m = radius_m
        self._penalty = penalty_N_m
        self._tolerance_m = self.radius_m * tolerance
        self._multiplier = np.zeros(len(nodes))
        self.centre_m = centre_m
        """Centre [m], shape (3,). If it moves, the multipliers are kept as a first guess."""

    def energy_and_force(self, positions_m: Array) -> tuple[float, Array]:
        """Return the contact energy [J] and its derivative [N], shape (s, 3).

        The derivative is with respect to the positions of ``nodes``.
        """
        pressed, outward, _ = self._pressed(positions_m)
        energy = 0.5 * np.sum((pressed**2 - self._multiplier**2) / self._penalty)
        return float(energy), -pressed[:, None] * outward

    def blocks(self, positions_m: Array) -> Array:
        """Return the second derivatives of the energy [N/m] for each node, shape (s, 3, 3)."""
        pressed, outward, distance = self._pressed(positions_m)
        along = outward[:, :, None] * outward[:, None]
        stiff = np.where(pressed > 0.0, self._penalty, 0.0)
        return stiff[:, None, None] * along - (pressed / distance)[:, None, None] * (
            np.eye(3) - along
        )

    def settled(self, positions_m: Array) -> bool:
        """Return True if the contact conditions are satisfied; if not, correct the multipliers."""
        pressed, _, distance = self._pressed(positions_m)
        violation = np.maximum(self.radius_m - distance, -self._multiplier / self._penalty)
        if np.abs(violation).max() <= self._tolerance_m:
            return True
        self._multiplier = pressed
        return False

    def _pressed(self, positions_m: Array) -> tuple[Array, Array, Array]:
        """Return force [N], direction from the centre and distance to the centre [m] by node."""
        from_centre = positions_m[self.nodes] - self.centre_m
        # A node at the centre has no direction; the lower bound avoids a division by zero.
        distance = np.maximum(np.linalg.norm(from_centre, axis=1), 1e-3 * self.radius_m)
        pressed = np.maximum(0.0, self._multiplier + self._penalty * (self.radius_m - distance))
        return pressed, from_centre / distance[:, None], distance


HALVINGS = 30
"""Number of halvings of a step, to 1e-9 of its length, after which the solver has stalled."""
ARMIJO = 1e-4
"""Share of the predicted decrease of the energy that a step must achieve (Armijo 1966)."""
ROUNDING = 1e-12
"""Relative rounding error of an energy: 1e-16 for each of 1e5 cells, with a margin."""
POSITIONS = 4e-13
"""Rounding error of nodal forces, relative to stiffness times size of the body."""
CORRECTIONS = 60
"""Largest number of corrections of the contact multipliers of a sphere.

Each correction reduces the penetration to a tenth or less.
"""
LINEAR_LIMIT = 500
"""Largest number of iterations for a direction.

A direction without convergence also lowers the energy.
"""


@dataclass(frozen=True, eq=False, kw_only=True)
class NewtonSolution(Solution):
    """Displacement, forces and outcome of a solution by Newton's method.

    The residual is the largest unbalanced force, divided by the largest internal force or contact
    force.

    Attributes
    ----------
    force_N
        Derivative of the elastic energy [N], shape (n, 3): the force of the supports and of the
        sphere on the body.
    tool_force_N
        Force of the body on the sphere [N], shape (3,); zero without a sphere.
    """

    force_N: Array
    tool_force_N: Array


class NewtonSolver:
    """Solver for equilibria of a body with prescribed displacements.

    Parameters
    ----------
    body
        The body.
    held
        True for components with a prescribed displacement, shape (n, 3).
    tolerance
        Allowed residual force, divided by the largest force in the body.
    step_limit
        Largest number of Newton steps for one equilibrium.

    Raises
    ------
    InputError
        If the held components do not prevent every rigid motion of every connected part.
    """

    def __init__(
        self,
        body: LinearBody | NonlinearBody,
        held: Flags,
        *,
        tolerance: float = 1e-8,
        step_limit: int = 60,
    ) -> None:
        self.body = body
        self.held = held
        self._tolerance = tolerance
        self._step_limit = step_limit
        self._free = np.flatnonzero(~held.ravel())
        rest = body.stiffness(np.zeros(held.shape))
        self.rest_diagonal = rest.diagonal()
        """Diagonal of the stiffness at rest [N/m], shape (3n,)."""
        # In a rotated body without stress, all forces are rounding errors. There is no larger force
        # to compare them with.
        extent = float(np.ptp(body.nodes_m, axis=0).max())
        self._rounding_N = POSITIONS * self.rest_diagonal.max() * extent
        # 1e-2 is the square of a displacement of a tenth of the body's size.
        self._rounding_J = ROUNDING * 1e-2 * self.rest_diagonal.max() * extent**2
        at_rest = HeldBody(rest, body.nodes_m, held)
        solver = DirectSolver(at_rest)
        self._precondition = lambda force: solver.solve(
            at_rest.whole(force)
        ).displacement_m.ravel()[at_rest.free]

    def solve(
        self,
        held_m: Array | None = None,
        *,
        sphere: RigidSphere | None = None,
        start_m: Array | None = None,
    ) -> NewtonSolution:
        """Solve for the equilibrium under prescribed displacements ``held_m`` [m], shape (n, 3).

        The iterations start from the displacement ``start_m`` [m], shape (n, 3). ``held_m`` and
        ``start_m`` are zero by default. The multipliers of a sphere are corrected until the contact
        conditions are satisfied.
        """
        now = np.zeros(self.held.shape) if start_m is None else np.array(start_m, np.float64)
        goal = np.zeros(self.held.shape) if held_m is None else held_m
        move = np.where(self.held, goal - now, 0.0)
        steps = 0
        if move.any():
            now = self._moved_on(now, move)
        for _ in range(CORRECTIONS):
            now, outcome, residual, more = self._minimum(now, sphere)
            steps += more
            if (
                outcome is not SolverOutcome.CONVERGED
                or sphere is None
                or sphere.settled(self.body.nodes_m + now)
            ):
                break
            outcome = SolverOutcome.NOT_CONVERGED
        _, force = self.body.energy_and_force(now)
        push = np.zeros(3)
        if sphere is not None:
            push = sphere.energy_and_force(self.body.nodes_m + now)[1].sum(axis=0)
        return NewtonSolution(now, outcome, steps, residual, force_N=force, tool_force_N=push)

    def _moved_on(self, start: Array, move: Array) -> Array:
        """Return the first displacement of the iterations after a motion of held components.

        The free components follow the held components to first order. If this motion inverts a
        cell, only the held components move.
        """
        tangent = self.body.stiffness(start)
        # The tolerance of 1e-3 is far below the error of this first-order guess.
        following = start + move + self._direction(tangent, -(tangent @ move.ravel()), 1e-3)
        return following if np.isfinite(self.body.energy_and_force(following)[0]) else start + move

    def _minimum(
        self, now: Array, sphere: RigidSphere | None
    ) -> tuple[Array, SolverOutcome, float, int]:
        """Minimise the energy by Newton's method, for constant multipliers of the sphere.

        Return displacement, outcome, residual and number of steps.
        """
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
            # If the relative accuracy of the direction equals the residual, convergence is
            # quadratic (Eisenstat and Walker 1996). An accuracy better than a tenth of the
            # tolerance is not needed.
            accuracy = max(min(0.1, residual), 0.1 * self._tolerance / residual)
            step = self._direction(self._whole(now, sphere), -slope.ravel(), accuracy)
            downhill = np.sum(slope * step)
            share = 1.0
            for _ in range(HALVINGS):
                trial = now + share * step
                there = self._state(trial, sphere)
                lower = there[0] <= energy + ARMIJO * share * downhill
                rounding = (
                    there[0] <= energy + ROUNDING * abs(energy) + self._rounding_J
                )  # near the end only the slope is accurate
                # Near the end, differences of the energy are rounding errors. Then the slope must
                # fall to half instead.
                if lower or (rounding and abs(np.sum(there[2] * step)) <= 0.5 * abs(downhill)):
                    break
                share *= 0.5
            else:
                return now, SolverOutcome.STALLED, residual, step_count
            now = trial
            (energy, size, slope) = there
        return now, SolverOutcome.NOT_CONVERGED, residual, self._step_limit

    def _state(self, displacement: Array, sphere: RigidSphere | None) -> tuple[float, float, Array]:
        """Return energy [J], largest force in the body [N] and derivative of the energy [N].

        The derivative is zero at held components.
        """
        energy, force = self.body.energy_and_force(displacement)
        size = np.abs(force).max()
        slope = force
        if sphere is not None and np.isfinite(energy):
            extra, push = sphere.energy_and_force(self.body.nodes_m + displacement)
            energy = energy + extra
            size = max(size, np.abs(push).max())
            slope = force.copy()
            slope[sphere.nodes] += push
        return energy, float(size), np.where(self.held, 0.0, slope)

    def _whole(self, displacement: Array, sphere: RigidSphere | None) -> bsr_array:
        """Return the second derivative [N/m] of the energy of body and sphere."""
        tangent = self.body.stiffness(displacement)
        if sphere is not None:
            row = np.repeat(np.arange(self.body.space.node_count), np.diff(tangent.indptr))
            diagonal = np.flatnonzero(row == tangent.indices)  # one block per node, in rising order
            tangent.data[diagonal[sphere.nodes]] += sphere.blocks(self.body.nodes_m + displacement)
        return tangent

    def _direction(self, whole: bsr_array, load: Array, accuracy: float) -> Array:
        """Solve for the free components by conjugate gradients.

        The iterations end early at a direction of negative curvature.
        """
        free = self._free
        full = np.zeros(self.held.size)

        def product(step: Array) -> Array:
            full[free] = step
            return (whole @ full)[free]

        found = conjugate_gradients(
            product,
            load[free],
            precondition=self._precondition,
            tolerance=accuracy,
            limit=LINEAR_LIMIT,
            error=lambda now: float(np.sqrt(now.slopes[-1] / now.slopes[0])),
        )
        # The first direction has negative curvature, but the preconditioned force still lowers the
        # energy.
        bent = found.outcome is SolverOutcome.INDEFINITE and found.iterations == 0
        full[free] = self._precondition(load[free]) if bent else found.displacement_m
        return full.reshape(self.held.shape)


STIFFER = 10.0
"""Contact penalty of a surface node, divided by the stiffness of the node."""
NODES = 1e-5
"""Largest allowed distance between a node in contact and the sphere, divided by the radius."""
LONGEST = 0.3
"""Longest step of the sphere, divided by its radius."""


def press_at(
    solver: NewtonSolver,
    tip_m: Array,
    direction: Array,
    *,
    radius_m: float,
    tolerance: float = NODES,
) -> tuple[NewtonSolution, RigidSphere, float]:
    """Solve for the equilibrium of a body under a rigid sphere that moves in a straight line.

    The body is at rest at the start.

    Parameters
    ----------
    solver
        Solver of the body.
    tip_m, direction
        Foremost point of the sphere at its final position [m], and unit direction of its motion,
        each of shape (3,).
    radius_m
        Radius of the sphere [m].
    tolerance
        Allowed depth of a node inside the sphere, divided by the radius.

    Returns
    -------
    The equilibrium, or the first solution that did not converge; the sphere; and the length of the
    sphere's path from its first touch of the body [m]. The length is not positive if the sphere
    does not reach the body.

    Raises
    ------
    InputError
        If the radius is not positive, or if no node of the surface lies in the sphere's path.
    """
    sphere, touching = resting_sphere(solver, tip_m, direction, radius_m, tolerance)
    depth = -radius_m - touching
    now = None
    # There is at least one step. A step of more than LONGEST radii could invert cells.
    for stop in np.linspace(touching, -radius_m, 2 + max(0, int(depth / (LONGEST * radius_m))))[1:]:
        sphere.centre_m = tip_m + stop * direction
        solution = solver.solve(sphere=sphere, start_m=now)
        if not solution.converged:
            break
        now = solution.displacement_m
    return solution, sphere, depth


def resting_sphere(
    solver: NewtonSolver, point_m: Array, direction: Array, radius_m: float, tolerance: float
) -> tuple[RigidSphere, float]:
    """Return a sphere at its first touch of a node as it moves to a point [m].

    The second value is the position of the sphere's centre relative to the point [m], measured
    along the direction of motion. It is negative in front of the point.
    """
    body = solver.body
    surface = np.unique(body.space.faces)
    offset = body.nodes_m[surface] - point_m
    # Nodes farther away than 3 radii cannot touch the sphere.
    near = np.linalg.norm(offset, axis=1) < 3.0 * radius_m
    surface = surface[near]
    offset = offset[near]
    along = offset @ direction
    aside = np.linalg.norm(offset - along[:, None] * direction, axis=1)
    inside = aside < radius_m
    if not inside.any():
        raise InputError(
            "point_m",
            "lie on the surface",
            point_m,
            "give a surface point that the sphere reaches; here no surface node lies in the path "
            "of the sphere",
        )
    touching = float((along[inside] - np.sqrt(radius_m**2 - aside[inside] ** 2)).min())
    penalty = STIFFER * solver.rest_diagonal.reshape(-1, 3)[surface].mean(axis=1)
    centre = point_m + touching * direction
    return RigidSphere(
        surface, penalty, radius_m=radius_m, centre_m=centre, tolerance=tolerance
    ), touching
