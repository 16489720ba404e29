"""Preconditioned conjugate gradients that return how they ended."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tissue.fem.outcome import SolverOutcome
from tissue.fem.solvers.solution import Solution

__all__ = ["ParticleSolution", "conjugate_gradients"]

Array = NDArray[np.float64]
LEAST_SHARE = 1e-13
"""Residuals below this share of the load are rounding."""
LEAST_CURVATURE = 1e-12
"""Share of ``p . D p``, D the diagonal, below which ``p . K p`` is rounding: p is then a motion that nothing resists. A
tooth of 1e5 nodes in a ligament a million times softer has 1e-8."""


@dataclass(frozen=True, eq=False)
class ParticleSolution(Solution):
    """Displacement and how it was reached, with an estimate of its error.

    Attributes
    ----------
    error
        Estimated error in the energy norm, relative to the energy norm of the displacement.
    """

    error: float


def conjugate_gradients(
    product: Callable[[Array], Array],
    load_N: Array,
    *,
    diagonal: Array,
    precondition: Callable[[Array], Array],
    start_m: Array,
    tolerance: float,
    limit: int,
) -> ParticleSolution:
    """Solve ``K u = f`` for a symmetric positive definite K.

    Stops where the error's energy norm is below ``tolerance`` times ``sqrt(u . f)``, that of the solution. It is taken
    as ``sqrt(r . B r)``, the preconditioner's estimate, or ``sqrt(r . D^-1 r / 24)`` if that is more, with D the
    diagonal: a lower bound, since a cell's 24 eigenvalues of ``D^-1 K`` are not negative and sum to 24. It sees a load
    on a motion that nothing resists and the preconditioner leaves out. The direction's factor is Polak and Ribiere's,
    which forgives a preconditioner in single precision (Golub and Ye 1999, SIAM J. Sci. Comput. 21:1305).

    Parameters
    ----------
    product
        K times nodal displacements, shape (n, 3).
    load_N
        Nodal forces [N], shape (n, 3), zero where nodes are held.
    diagonal
        Diagonal of K [N/m], shape (n, 3).
    precondition
        B times nodal forces, close to K's inverse.
    start_m
        First guess [m], shape (n, 3).
    tolerance
        Relative error in the energy norm.
    limit
        Iterations allowed.
    """
    displacement = start_m.copy()
    residual = load_N - product(displacement) if displacement.any() else load_N.copy()
    load_norm = np.sqrt(dot(load_N, load_N))
    if load_norm == 0.0:
        return ParticleSolution(np.zeros_like(load_N), SolverOutcome.CONVERGED, 0, residual=0.0, error=0.0)
    by_diagonal = np.divide(1.0 / 24.0, diagonal, out=np.zeros_like(diagonal), where=diagonal > 0.0)
    before, step, last_slope, outcome, error = residual, np.zeros_like(load_N), 1.0, SolverOutcome.NOT_CONVERGED, np.inf
    iteration = 0
    while True:
        corrected = precondition(residual)
        slope = dot(residual, corrected)
        left = np.sqrt(dot(residual, residual)) / load_norm
        energy = dot(displacement, load_N)
        if not np.isfinite(slope) or slope < 0.0:
            outcome = SolverOutcome.INDEFINITE
            break
        size = max(slope, dot(residual, residual * by_diagonal))
        error = np.sqrt(size / energy) if energy > 0.0 else np.inf
        if error <= tolerance or left <= LEAST_SHARE:
            outcome = SolverOutcome.CONVERGED
            break
        if iteration == limit:
            break
        factor = 0.0 if iteration == 0 else max(0.0, (slope - dot(before, corrected)) / last_slope)
        step = corrected + factor * step
        along = product(step)
        curvature = dot(step, along)
        if not curvature > LEAST_CURVATURE * dot(step, diagonal * step):
            outcome = SolverOutcome.INDEFINITE
            break
        length = dot(residual, step) / curvature
        displacement += length * step
        before, last_slope = residual, slope
        residual = residual - length * along
        iteration += 1
    return ParticleSolution(displacement, outcome, iteration, residual=float(left), error=float(error))


def dot(a: Array, b: Array) -> float:
    """Scalar product, summed in the same order on any number of cores."""
    return float(np.einsum("ij,ij->", a, b))
