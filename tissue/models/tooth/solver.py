"""When conjugate gradients on hexahedral cells have arrived."""

from collections.abc import Callable

import numpy as np

from meshes.base.arrays import Array
from tissue.fem.conjugate_gradients import Iterate, IterativeSolution, conjugate_gradients, dot

__all__ = ["solve_cells"]

LEAST_CURVATURE = 1e-12
"""Share of ``p . D p``, D the diagonal, below which ``p . K p`` is rounding: p is then a motion that nothing resists. A
tooth of 1e5 nodes in a ligament a million times softer has 1e-8."""


def solve_cells(
    product: Callable[[Array], Array],
    load_N: Array,
    *,
    diagonal: Array,
    precondition: Callable[[Array], Array],
    start_m: Array,
    tolerance: float,
    limit: int,
) -> IterativeSolution:
    """Solve ``K u = f``; stops where the error's energy norm is below ``tolerance`` times that of the solution.

    The latter is ``sqrt(u . f)``. The former is taken as ``sqrt(r . B r)``, the preconditioner's estimate, or
    ``sqrt(r . D^-1 r / 24)`` if that is more, with D the diagonal: a lower bound, since a cell's 24 eigenvalues of
    ``D^-1 K`` are not negative and sum to 24. It sees a load on a motion that nothing resists and the preconditioner
    leaves out.

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
    by_diagonal = np.divide(1.0 / 24.0, diagonal, out=np.zeros_like(diagonal), where=diagonal > 0.0)

    def error(now: Iterate) -> float:
        energy = dot(now.found, load_N)
        size = max(now.slopes[-1], dot(now.residual, now.residual * by_diagonal))
        return float(np.sqrt(size / energy)) if energy > 0.0 else np.inf

    return conjugate_gradients(
        product, load_N, precondition=precondition, error=error, tolerance=tolerance, limit=limit, start=start_m,
        least_curvature=lambda direction: LEAST_CURVATURE * dot(direction, diagonal * direction), correct_last=True,
    )  # fmt: skip
