"""Preconditioned conjugate gradients, and the solution with its outcome."""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from math import nan

import numpy as np

from meshes.base.arrays import Array


class SolverOutcome(Enum):
    """Outcome of a solver. The text of a failure states its cause and how to fix it."""

    CONVERGED = "the displacement has converged within the tolerance"
    NOT_CONVERGED = (
        "the largest number of iterations was reached. Allow more iterations, raise "
        "the tolerance, or take smaller steps"
    )
    INACCURATE = "rounding is too large. Fix sliver cells, or lower the contrast of moduli"
    INDEFINITE = (
        "the stiffness is not positive definite. Check moduli, Poisson's ratio, sliver cells and "
        "loose parts"
    )
    UNSUPPORTED = "nothing holds the body. Fix nodes that carry load, or give them springs"


@dataclass(frozen=True, eq=False)
class Solution:
    """Displacement computed by a solver, and the solver's outcome.

    Attributes
    ----------
    displacement_m
        Nodal displacements [m], shape (n, 3). If the outcome is not CONVERGED, this is the last
        iterate.
    outcome
        Convergence, or the cause of a failure.
    iterations
        Number of iterations; 0 for a direct solver.
    residual
        Norm of ``f - K u`` over the free components, divided by the norm of f.
    error
        Estimated error of an iterative solver in the energy norm, divided by the energy norm of the
        displacement.
    """

    displacement_m: Array
    outcome: SolverOutcome
    iterations: int
    residual: float
    error: float = nan

    @property
    def converged(self) -> bool:
        """True if the solver converged, so that the displacement may be used."""
        return self.outcome is SolverOutcome.CONVERGED


LEAST_SHARE = 1e-13
"""Ratio of residual to load below which the residual is a rounding error."""


@dataclass(eq=False)
class Iterate:
    """State of the conjugate gradient iterations.

    Attributes
    ----------
    found
        Present displacement.
    residual
        Load minus the stiffness times the displacement.
    slopes
        Scalar products ``r . B r`` for the present and all earlier residuals r. B is the
        preconditioner.
    factors
        For each step so far: factor with which the previous direction enters the direction of the
        step.
    lengths
        Step lengths of all steps so far.
    """

    found: Array
    residual: Array
    slopes: list[float] = field(default_factory=list)
    factors: list[float] = field(default_factory=list)
    lengths: list[float] = field(default_factory=list)


def conjugate_gradients(
    product: Callable[[Array], Array],
    load: Array,
    *,
    precondition: Callable[[Array], Array],
    error: Callable[[Iterate], float],
    tolerance: float,
    limit: int,
    start: Array | None = None,
    least_curvature: Callable[[Array], float] = lambda direction: 0.0,
    correct_last: bool = False,
) -> Solution:
    """Solve ``K u = f`` for a symmetric positive definite K, on arrays of any shape.

    The factor with which the last direction enters the next direction is computed with the formula
    of Polak and Ribiere. The formula allows a preconditioner that is slightly unsymmetric or is
    computed in single precision (Golub and Ye 1999, SIAM J. Sci. Comput. 21:1305).

    Parameters
    ----------
    product
        Function that multiplies displacements by K.
    load
        Right-hand side f (forces), zero at held components.
    precondition
        Function that multiplies forces by B, an approximate inverse of K.
    error
        Function that estimates the relative error of an iterate. The iterations end when this
        estimate is at most ``tolerance``.
    limit
        Largest number of iterations.
    start
        Displacement at the start of the iterations; default: zero.
    least_curvature
        Function that returns the lower limit of ``p . K p`` for a direction p. If ``p . K p`` is
        not above the limit, K is treated as not positive definite.
    correct_last
        True to add ``B r`` to the converged solution, where r is the last residual. This product is
        known without further work. It reduces the error if no eigenvalue of ``B K`` is above 2.
    """
    norm = np.sqrt(dot(load, load))
    if norm == 0.0:
        return Solution(np.zeros_like(load), SolverOutcome.CONVERGED, 0, residual=0.0, error=0.0)
    found = np.zeros_like(load) if start is None else start
    now = Iterate(found, load - product(found) if found.any() else load)
    before = now.residual
    direction = np.zeros_like(load)
    estimate = np.inf
    while True:
        corrected = precondition(now.residual)
        slope = dot(now.residual, corrected)
        left = float(np.sqrt(dot(now.residual, now.residual)) / norm)
        outcome = SolverOutcome.INDEFINITE
        if not np.isfinite(slope) or slope < 0.0:
            break
        now.slopes.append(slope)
        estimate = float(error(now))
        if estimate <= tolerance or left <= LEAST_SHARE:
            outcome = SolverOutcome.CONVERGED
            if correct_last:
                now.found = now.found + corrected
            break
        if len(now.lengths) == limit:
            outcome = SolverOutcome.NOT_CONVERGED
            break
        # A negative factor restarts from the preconditioned residual (Polak and Ribiere +).
        factor = max(0.0, (slope - dot(before, corrected)) / now.slopes[-2]) if now.lengths else 0.0
        direction = corrected + factor * direction
        along = product(direction)
        curvature = dot(direction, along)
        if not curvature > least_curvature(direction):
            break
        # Not `slope`: with an inexact preconditioner residual and old direction are not orthogonal.
        length = dot(now.residual, direction) / curvature
        now.factors.append(factor)
        now.lengths.append(length)
        now.found = now.found + length * direction
        before = now.residual
        now.residual = now.residual - length * along
    return Solution(now.found, outcome, len(now.lengths), residual=left, error=estimate)


def dot(a: Array, b: Array) -> float:
    """Return the scalar product with a summation order independent of the number of cores."""
    return float(np.einsum("i,i->", a.ravel(), b.ravel()))
