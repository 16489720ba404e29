"""Equilibrium of a nonlinear body under nodal forces that change little by little: L-BFGS on one factor.

Each step needs one evaluation of the internal forces and one solve with a factor, at first of the stiffness at rest.
What the last steps found of the curvature (Liu and Nocedal 1989, Math. Program. 45:503) belongs to the body alone, not
to the forces, so it stays from one load to the next. Where steps become many, the stiffness there is factorised.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_array

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.fem.hyperelastic import NonlinearBody
from tissue.fem.solvers.direct import DirectSolver

__all__ = ["Followed", "QuasiNewton"]

MEMORY = 12
"""Steps whose curvature is kept."""
HALVINGS = 12
ARMIJO, ROUNDING = 1e-4, 1e-12
SMALL = 1e-3
"""Share of the greatest load so far below which a load counts as that much: less need not be balanced."""
MANY = 8
"""Steps of a solve after which the stiffness of where it is takes the place of the one before."""


@dataclass(frozen=True, eq=False)
class Followed:
    """An equilibrium, or how near to one it came.

    Attributes
    ----------
    displacement_m, internal_N
        Displacement [m] and the internal forces there [N], shape (n, 3).
    residual
        Largest force that nothing balances, over the largest of the load and of what was carried before.
    steps
        Steps taken.
    """

    displacement_m: Array
    internal_N: Array
    residual: float
    steps: int


class QuasiNewton:
    """Follows a load.

    Parameters
    ----------
    body
        The body.
    fixed
        Components that are held where they are, shape (n, 3).
    at_rest
        Factor of the stiffness at rest.
    factorise
        Makes that of another stiffness [N/m]; raises `InputError` where it cannot.

    Attributes
    ----------
    factor
        The factor of last, of the stiffness at rest or of a place that was passed since.
    """

    def __init__(
        self,
        body: NonlinearBody,
        fixed: NDArray[np.bool_],
        at_rest: DirectSolver,
        factorise: Callable[[bsr_array], DirectSolver],
    ) -> None:
        self._body, self._fixed, self.at_rest, self._factorise = body, fixed, at_rest, factorise
        self.factor = at_rest
        self._displacement = np.zeros(fixed.shape)
        self._energy, self._internal = body.energy_and_force(self._displacement)
        self._greatest_N = 0.0
        self._pairs: deque[tuple[Array, Array, float]] = deque(maxlen=MEMORY)

    def follow(self, load_N: Array, *, tolerance: float, step_limit: int) -> Followed:
        """Go on to the equilibrium under a load [N], shape (n, 3), from where the last one ended."""
        carried = np.where(self._fixed, 0.0, self._internal)
        now_N = float(max(np.abs(load_N).max(), np.abs(carried).max()))
        self._greatest_N = max(self._greatest_N, now_N)
        size, steps = max(now_N, SMALL * self._greatest_N), 0
        left = np.where(self._fixed, 0.0, load_N - self._internal)
        while (worst := float(np.abs(left).max())) > tolerance * size and steps < step_limit:
            step = self._inverse(left)
            if not self._advance(step, load_N, float(np.sum(left * step))):
                if self.factor is self.at_rest and not self._pairs:
                    break
                self.factor = self.at_rest
                self._pairs.clear()
            left = np.where(self._fixed, 0.0, load_N - self._internal)
            steps += 1
            if steps % MANY == 0:
                self.take_stiffness()
        return Followed(self._displacement, self._internal, worst / size if size else 0.0, steps)

    def _advance(self, step: Array, load_N: Array, slope: float) -> bool:
        """Take a step, shortened until the energy falls; false where no length of it does."""
        if slope <= 0.0:
            return False
        before, share = self._energy - float(np.sum(load_N * self._displacement)), 1.0
        for _ in range(HALVINGS):
            moved = self._displacement + share * step
            energy, internal = self._body.energy_and_force(moved)
            allowed = before - ARMIJO * share * slope + ROUNDING * abs(self._energy)
            if np.isfinite(energy) and energy - float(np.sum(load_N * moved)) <= allowed:
                break
            share *= 0.5
        else:
            return False
        change, force = share * step, np.where(self._fixed, 0.0, internal - self._internal)
        curved = float(np.sum(change * force))
        if curved > 0.0:
            self._pairs.append((change, force, 1.0 / curved))
        self._displacement, self._energy, self._internal = moved, energy, internal
        return True

    def take_stiffness(self) -> None:
        """Go on with the stiffness of this place."""
        self._pairs.clear()
        try:
            self.factor = self._factorise(self._body.stiffness(self._displacement))
        except InputError:
            self.factor = self.at_rest

    def _inverse(self, left_N: Array) -> Array:
        """The inverse of the stiffness about here, times forces (two loops of Nocedal 1980)."""
        forces, shares = left_N.copy(), []
        for change, force, inverse in reversed(self._pairs):
            share = inverse * float(np.sum(change * forces))
            shares.append(share)
            forces -= share * force
        step = self.factor.solve(forces).displacement_m
        for (change, force, inverse), share in zip(self._pairs, reversed(shares), strict=True):
            step += change * (share - inverse * float(np.sum(force * step)))
        return step
