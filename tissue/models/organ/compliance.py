"""Compliance of the nodes that a tool may touch.

It is complete, computed column by column where the tool is, or taken from a reduced basis.
"""

from functools import cached_property
from typing import Literal

import numpy as np

from meshes.base.arrays import Array, Ints
from meshes.base.progress import Progress
from tissue.fem.solvers.condensed import SCHUR_UNKNOWNS, surface_compliance_m_N
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import HeldBody
from tissue.fem.solvers.lazy_compliance import LazyCompliance
from tissue.fem.solvers.multigrid import MultigridSolver
from tissue.fem.solvers.reduced import ReducedSolver

__all__ = ["FACTOR_UNKNOWNS", "CompliancePath", "Factor", "compliance_of"]

FACTOR_UNKNOWNS = 200_000
"""Largest number of unknowns for which frames are solved by a factor.

Above it multigrid is used, because a factor would take gigabytes.
"""
CompliancePath = Literal["condensed", "lazy", "reduced"]
"""Method used to compute the compliance.

It is taken from its own factor and kept on disk, computed column by column while the tool moves, or
taken from a reduced basis.
"""


class Factor:
    """Sparse factor that is made when it is first needed.

    Where it would need too much memory, multigrid replaces it.
    """

    def __init__(self, body: HeldBody) -> None:
        self._body = body
        self._last = np.zeros(0, dtype=np.int64)

    @cached_property
    def solver(self) -> DirectSolver | MultigridSolver:
        """Solver of the organ."""
        if len(self._body.free) > FACTOR_UNKNOWNS:
            return MultigridSolver(self._body)
        return DirectSolver(self._body, last=self._last)

    def expect(self, nodes: Ints) -> None:
        """Request that the compliance between some nodes is read off the factor.

        This applies only where the factor is not made yet and not too large.
        """
        if "solver" not in self.__dict__ and len(self._body.free) <= SCHUR_UNKNOWNS:
            self._last = np.union1d(self._last, nodes)

    def solve_all(self, loads_N: Array) -> Array:
        """Return displacements [m] under several loads [N], shape (loads, n, 3) both."""
        return np.stack([self.solve(load) for load in loads_N])

    def solve(self, load_N: Array) -> Array:
        """Return the displacement [m] under a load [N], shape (n, 3)."""
        found = self.solver.solve(load_N)
        if not found.converged:
            raise RuntimeError(f"the organ could not be solved: {found.outcome.value}")
        displacement: Array = found.displacement_m
        return displacement


def compliance_of(
    body: HeldBody,
    touchable: Ints,
    factor: Factor,
    *,
    path: CompliancePath,
    basis_size: int,
    report: Progress,
) -> tuple[Array, LazyCompliance | None]:
    """Return the compliance of the touchable nodes [m/N] and the object that fills it.

    The compliance has shape (3t, 3t). The object fills it while the tool moves; it is None where
    the compliance is complete.
    """
    doing = "condensing the compliance to the surface that can be touched"
    if path == "condensed":
        return surface_compliance_m_N(
            body,
            touchable,
            solver=lambda: factor.solver,
            progress=lambda share: report(doing, share),
        ), None
    if path == "reduced":
        size = min(basis_size, 3 * len(touchable))
        return ReducedSolver(factor.solver, touchable, size=size).compliance_m_N(), None
    count = 3 * len(touchable)
    return np.full((count, count), np.nan), LazyCompliance(factor.solver, touchable)
