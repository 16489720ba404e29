"""Equilibrium of a nonlinear body under slowly changing nodal forces, solved by L-BFGS.

Each step needs one evaluation of the internal forces, and one back-substitution with a factorised
stiffness. The first factor belongs to the stiffness at rest. The curvature pairs of the last steps
(Liu and Nocedal 1989, Math. Program. 45:503) depend on the body and not on the forces. The pairs
therefore stay valid when the load changes. When an equilibrium needs many steps, the stiffness at
the present displacement is factorised.

Springs may hold some nodes near prescribed displacements. The springs represent a rigid tool,
because tissue that is pressed deeply may be stable only in contact with the tool. If only the
forces of the tool act on the tissue, its tangent is indefinite, and there is no equilibrium nearby.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.sparse import bsr_array, csr_array

from meshes.base.arrays import Array, Flags, Ints
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import components_of
from tissue.fem.solvers.multifrontal import NotPositiveDefiniteError

MEMORY = 12
"""Number of last steps whose curvature pairs are stored."""
HALVINGS = 12
"""Number of halvings of a step, down to 1/4096, before the direction of the step is discarded."""
ARMIJO = 1e-4
"""Share of the predicted decrease of the energy that a step must achieve (Armijo 1966)."""
ROUNDING = 1e-12
"""Relative rounding error of the energy."""
SMALL = 1e-3
"""Smallest reference force of the residual, relative to the largest load so far.

The residual is the largest unbalanced force divided by a reference force, usually the largest force
of the load. The reference force is at least `SMALL` times the largest load so far. A smaller load
is therefore not balanced exactly.
"""
MANY = 8
"""Number of steps for one equilibrium after which the present stiffness is factorised."""
SMALLEST_PART = 1.0 / 16.0
"""Smallest fraction of a load change that is tried before the last equilibrium is kept."""


class Body(Protocol):
    """Interface of a body with an elastic energy, such as `NonlinearBody`."""

    def energy_and_force(self, displacement_m: Array) -> tuple[float, Array]:
        """Return the energy [J] and the internal forces [N], shape (n, 3).

        The forces are the derivative of the energy with respect to the displacement.
        """

    def stiffness(self, displacement_m: Array, *, definite: bool = False) -> bsr_array:
        """Return the tangent stiffness [N/m], shape (3n, 3n).

        If `definite`, all its eigenvalues are positive.
        """


@dataclass(frozen=True, eq=False)
class Springs:
    """Coupled springs that hold nodes of a body near given positions.

    The energy is ``|root u - rest|^2 / 2``, where u holds all displacement components.

    Attributes
    ----------
    root
        Square root of the stiffness [(N/m)^0.5], shape (p, 3n).
    rest
        Product of `root` and the displacement at which the springs are at rest [J^0.5], shape (p,).
    """

    root: csr_array
    rest: Array

    @classmethod
    def none(cls, unknowns: int) -> "Springs":
        """Return an empty set of springs for a body with ``unknowns`` displacement components."""
        return cls(csr_array((0, unknowns)), np.zeros(0))

    @classmethod
    def holding(
        cls, nodes: Ints, compliance_m_N: Array, target_m: Array, *, unknowns: int
    ) -> "Springs":
        """Return springs with a given compliance that hold nodes near given positions.

        The root of the springs' stiffness is the inverse of the Cholesky factor of the compliance.

        Parameters
        ----------
        nodes
            Nodes to hold, shape (k,).
        compliance_m_N
            Compliance matrix of the springs at the nodes [m/N], positive definite, shape (3k, 3k).
        target_m
            Displacements of the nodes at which the springs are at rest [m], shape (k, 3).
        unknowns
            Number of displacement components of the body.
        """
        columns = components_of(nodes)
        order = np.argsort(columns)
        lower = cholesky(compliance_m_N, lower=True)
        inverse = solve_triangular(lower, np.eye(len(columns))[:, order], lower=True)
        rows = np.repeat(np.arange(len(inverse)), len(columns))
        places = np.tile(columns[order], len(inverse))
        root = csr_array((inverse.ravel(), (rows, places)), shape=(len(inverse), unknowns))
        return cls(root, solve_triangular(lower, target_m.ravel(), lower=True))

    def at(self, share: float, start_m: Array) -> "Springs":
        """Return springs whose targets lie between a start displacement and the present targets.

        Parameters
        ----------
        share
            Position of the targets between the start displacement (0) and the present targets (1).
            With 0, the springs exert no force at the start displacement.
        start_m
            Displacement of the nodes at the start [m], shape (n, 3).
        """
        if share == 1.0:
            return self
        start = self.root @ start_m.ravel()
        return replace(self, rest=start + share * (self.rest - start))

    def energy_and_force(self, displacement_m: Array) -> tuple[float, Array]:
        """Compute the energy [J] and the forces on the nodes [N], shape (n, 3)."""
        stretch = self.root @ displacement_m.ravel() - self.rest
        return 0.5 * float(stretch @ stretch), -(self.root.T @ stretch).reshape(-1, 3)

    def product(self, change_m: Array) -> Array:
        """Compute the change of the restoring forces due to a displacement [N], shape (n, 3)."""
        return (self.root.T @ (self.root @ change_m.ravel())).reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class Followed:
    """Equilibrium, or the state closest to equilibrium if no equilibrium was found.

    Attributes
    ----------
    displacement_m, internal_N
        Displacement [m], and internal forces at this displacement [N], each of shape (n, 3).
    load_N
        Sum of the load and the forces of the springs [N], shape (n, 3).
    residual
        Largest unbalanced force, divided by a reference force. The reference is the largest nodal
        force in the load or in the initial internal forces. The reference is at least `SMALL` times
        the largest reference of all earlier solutions.
    steps
        Number of steps.
    reached
        Fraction of the change of load and springs that was applied, from 0 to 1. If the fraction is
        below 1, the displacement is the equilibrium for this fraction of the change.
    """

    displacement_m: Array
    internal_N: Array
    load_N: Array
    residual: float
    steps: int
    reached: float


@dataclass(frozen=True, eq=False)
class _State:
    """Displacement [m], energy [J] and internal forces [N] of a body."""

    displacement_m: Array
    energy_J: float
    internal_N: Array


@dataclass(eq=False)
class _Tangent:
    """Cholesky factor of the stiffness of a body at a displacement [m].

    If `is_definite` is true, the eigenvalues of the stiffness were made positive before the
    factorisation. Pickling omits the factor, which is computed again at its first use.
    """

    displacement_m: Array
    is_definite: bool
    factor: DirectSolver | None

    def __reduce__(self) -> tuple[type["_Tangent"], tuple[Array, bool, None]]:
        return _Tangent, (self.displacement_m, self.is_definite, None)


class QuasiNewton:
    """Solver that follows the equilibrium of a body under a changing load.

    Parameters
    ----------
    body
        The body.
    fixed
        True for components with zero displacement, shape (n, 3).
    at_rest
        Factorised stiffness at zero displacement. `at_rest` and `factorise` must eliminate the
        nodes with springs last.
    factorise
        Function that factorises a stiffness [N/m]. It raises `NotPositiveDefiniteError` if the
        stiffness has no Cholesky factor.

    Attributes
    ----------
    factor
        Factorised stiffness in use, at rest or at a later displacement.
    indefinite
        Number of tangent matrices so far that were not positive definite.
    """

    RECORD = ("_largest_N", "indefinite")
    """Names of the attributes that `restart` does not change."""

    def __init__(
        self,
        body: Body,
        fixed: Flags,
        at_rest: DirectSolver,
        factorise: Callable[[bsr_array], DirectSolver],
    ) -> None:
        self._body = body
        self._fixed = fixed
        self.at_rest = at_rest
        self._factorise = factorise
        self.factor = at_rest
        self._tangent: _Tangent | None = None
        self._last = self._state_at(np.zeros(fixed.shape))
        self._largest_N = 0.0
        self.indefinite = 0
        self._memory: deque[tuple[Array, Array]] = deque(maxlen=MEMORY)
        self._pairs: list[tuple[Array, Array, float]] = []
        self._springs = Springs.none(fixed.size)
        # Factor with springs. It is made when it is needed.
        self._held: DirectSolver | None = None

    def follow(
        self, load_N: Array, *, tolerance: float, step_limit: int, springs: Springs | None = None
    ) -> Followed:
        """Solve for the equilibrium under a load, starting from the last solution.

        Parameters
        ----------
        load_N
            Load [N], shape (n, 3).
        tolerance, step_limit
            Allowed residual, and largest number of steps.
        springs
            Springs that act in addition to the load; default: no springs.
        """
        wanted = springs or Springs.none(self._fixed.size)
        start = self._last
        carried = np.where(self._fixed, 0.0, start.internal_N)
        now_N = float(max(np.abs(load_N).max(), np.abs(carried).max()))
        self._largest_N = max(self._largest_N, now_N)
        allowed_N = tolerance * max(now_N, SMALL * self._largest_N)
        reached = 0.0
        followed = start
        part = 1.0
        steps = 0
        while reached < 1.0 and steps < step_limit and part >= SMALLEST_PART:
            goal = min(reached + part, 1.0)
            self._spring_up(wanted.at(goal, start.displacement_m))
            load = load_N if goal == 1.0 else carried + goal * (load_N - carried)
            # The first attempt may use half of the steps. The others are for smaller parts of the
            # change.
            limit = step_limit if reached or part < 1.0 else (step_limit + 1) // 2
            steps += self._reach(load, allowed_N, min(limit, step_limit - steps))
            if np.abs(self._left(load)[1]).max() <= allowed_N:
                reached = goal
                followed = self._last
                continue
            self._last = followed
            part *= 0.5
            self.take_stiffness()
        self._spring_up(wanted)
        acting, left = self._left(load_N)
        size = allowed_N / tolerance
        residual = float(np.abs(left).max()) / size if size else 0.0
        last = self._last
        return Followed(last.displacement_m, last.internal_N, acting, residual, steps, reached)

    def restart(self, displacement_m: Array) -> None:
        """Set the displacement [m], shape (n, 3), from which the next call of `follow` starts.

        If the displacement inverts a cell, the next call starts from zero displacement.
        """
        self._last = self._state_at(displacement_m)
        if not np.isfinite(self._last.energy_J):
            self._last = self._state_at(np.zeros_like(displacement_m))
        self._take_factor(self.at_rest)
        self._tangent = None

    def state(self) -> dict[str, Any]:
        """Return the state on which later solutions depend, except the attributes in `RECORD`.

        The arrays in the state are not copied, because `follow` replaces them and does not write to
        them.
        """
        return {"last": self._last, "memory": list(self._memory), "tangent": self._tangent}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore a state returned by `state` of this solver or of an equal solver."""
        tangent: _Tangent | None = state["tangent"]
        factor = self.at_rest
        if tangent is not None:
            if tangent.factor is None:
                at_m = tangent.displacement_m
                stiffness = self._body.stiffness(at_m, definite=tangent.is_definite)
                tangent.factor = self._factorise(stiffness)
            factor = tangent.factor
        self._last = state["last"]
        self._take_factor(factor)
        self._tangent = tangent
        self._memory.extend(state["memory"])

    @property
    def displacement_m(self) -> Array:
        """Displacement of the last solution [m], shape (n, 3)."""
        return self._last.displacement_m

    def _reach(self, load_N: Array, allowed_N: float, limit: int) -> int:
        """Take steps towards the equilibrium under a load, and return the number of steps."""
        steps = 0
        left = self._left(load_N)[1]
        while np.abs(left).max() > allowed_N and steps < limit:
            step = self._inverse(left)
            if not self._advance(step, load_N, float(np.sum(left * step))):
                # Without curvature pairs, there is no other direction to try.
                if not self._memory:
                    break
                self._take_factor(self.factor)
            left = self._left(load_N)[1]
            steps += 1
            if steps % MANY == 0:
                self.take_stiffness()
        return steps

    def _state_at(self, displacement_m: Array) -> _State:
        return _State(displacement_m, *self._body.energy_and_force(displacement_m))

    def _left(self, load_N: Array) -> tuple[Array, Array]:
        """Return load plus spring forces, and unbalanced forces [N], each of shape (n, 3)."""
        acting = load_N + self._springs.energy_and_force(self.displacement_m)[1]
        return acting, np.where(self._fixed, 0.0, acting - self._last.internal_N)

    def _advance(self, step: Array, load_N: Array, slope: float) -> bool:
        """Take a step; halve its length until the energy decreases.

        Return False if no length of the step decreases the energy.
        """
        if slope <= 0.0:
            return False
        last = self._last
        before = self._energy_J(last, load_N)
        share = 1.0
        for _ in range(HALVINGS):
            moved = self._state_at(last.displacement_m + share * step)
            allowed = before - ARMIJO * share * slope + ROUNDING * abs(last.energy_J)
            if np.isfinite(moved.energy_J) and self._energy_J(moved, load_N) <= allowed:
                break
            share *= 0.5
        else:
            return False
        change = share * step
        force = np.where(self._fixed, 0.0, moved.internal_N - last.internal_N)
        self._memory.append((change, force))
        self._pair(change, force)
        self._last = moved
        return True

    def _energy_J(self, state: _State, load_N: Array) -> float:
        """Compute the energy of the body, the load and the springs [J]."""
        moved_m = state.displacement_m
        outer = self._springs.energy_and_force(moved_m)[0] - float(np.sum(load_N * moved_m))
        return state.energy_J + outer

    def take_stiffness(self) -> None:
        """Factorise the tangent at the present displacement.

        A tangent that is not positive definite is replaced by a tangent with positive eigenvalues
        at each quadrature point.
        """
        at_m = self.displacement_m
        is_definite = False
        try:
            factor = self._factorise(self._body.stiffness(at_m))
        except NotPositiveDefiniteError:
            self.indefinite += 1
            is_definite = True
            factor = self._factorise(self._body.stiffness(at_m, definite=True))
        self._take_factor(factor)
        self._tangent = _Tangent(at_m, is_definite, factor)

    def _take_factor(self, factor: DirectSolver) -> None:
        """Replace the factor and discard the curvature pairs of the last steps."""
        self.factor = factor
        self._memory.clear()
        self._pairs.clear()
        self._held = None

    def _spring_up(self, springs: Springs) -> None:
        """Replace the springs and keep the curvature pairs of the body."""
        self._springs = springs
        self._held = None
        self._pairs.clear()
        for change, force in self._memory:
            self._pair(change, force)

    def _pair(self, change: Array, force: Array) -> None:
        """Store a change of displacement and the resulting change of force as a curvature pair.

        The pair is stored only if the curvature of body and springs together is positive along the
        change.
        """
        whole = force + np.where(self._fixed, 0.0, self._springs.product(change))
        curved = np.sum(change * whole)
        if curved > 0.0:
            self._pairs.append((change, whole, 1.0 / curved))
            del self._pairs[:-MEMORY]

    def _solve(self, forces_N: Array) -> Array:
        """Return displacements [m], shape (n, 3), under forces on the body with springs."""
        if self._held is None:
            self._held = self.factor
            if self._springs.root.shape[0]:
                self._held = self.factor.with_springs(self._springs.root)
        return self._held.displacement_m(forces_N)

    def _inverse(self, left_N: Array) -> Array:
        """Apply the approximate inverse stiffness to forces (two-loop recursion, Nocedal 1980)."""
        forces = left_N.copy()
        shares = []
        for change, force, inverse in reversed(self._pairs):
            share = inverse * np.sum(change * forces)
            shares.append(share)
            forces -= share * force
        step = self._solve(forces)
        for (change, force, inverse), share in zip(self._pairs, reversed(shares), strict=True):
            step += change * (share - inverse * np.sum(force * step))
        return step
