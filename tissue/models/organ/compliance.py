"""Factorisation of an organ's stiffness matrix, and compliance of its surface nodes."""

from functools import cached_property
from typing import Literal

import numpy as np

from meshes.base.arrays import Array, Ints
from tissue.fem.solvers.compliance import SCHUR_UNKNOWNS, columns_at
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import HeldBody, components_of
from tissue.fem.solvers.multigrid import MultigridSolver

FACTOR_UNKNOWNS = 200_000
"""Largest number of unknowns of an organ whose stiffness matrix is factorised.

For larger organs a multigrid solver is used, because a factor would take gigabytes of memory.
"""
ComplianceMethod = Literal["condensed", "reduced"]
"""Method used to compute the compliance before a run.

``condensed``: the complete matrix is computed by a factorisation, and cached on disk. ``reduced``:
the matrix is computed from a reduced basis.
"""
LIMIT_BYTES = 1_000_000_000
"""Memory above which all compliance columns from earlier presses are dropped [bytes].

On a surface of 5,000 nodes, the three columns of a touched node need 0.36 MB, so the columns of
2,800 nodes fit.
"""


class Factor:
    """Sparse factor of an organ's stiffness matrix, computed when it is first needed.

    If the factor would need too much memory, a multigrid solver is used instead. Computed columns
    of the compliance (surface displacements under unit forces) are stored and reused when a tool
    presses again.

    Parameters
    ----------
    body
        Stiffness and supports of the organ.
    surface
        Nodes of the surface in rising order, shape (s,).
    """

    def __init__(self, body: HeldBody, surface: Ints) -> None:
        self._body = body
        self._surface = surface
        self._last = np.zeros(0, np.int64)
        self._columns: dict[int, Array] = {}

    @cached_property
    def solver(self) -> DirectSolver | MultigridSolver:
        """Solver for the organ's displacement under nodal forces."""
        if len(self._body.free) > FACTOR_UNKNOWNS:
            return MultigridSolver(self._body)
        return DirectSolver(self._body, last=self._last)

    def expect(self, nodes: Ints) -> None:
        """Request a factorisation that directly contains the compliance of the given nodes.

        The request has no effect if the factor has been computed before, or if it would be too
        large.
        """
        if "solver" not in self.__dict__ and len(self._body.free) <= SCHUR_UNKNOWNS:
            self._last = np.union1d(self._last, nodes)

    def solve(self, load_N: Array) -> Array:
        """Return the displacement [m] under a load [N], shape (n, 3)."""
        found = self.solver.solve(load_N)
        if not found.converged:
            raise RuntimeError(f"the organ could not be solved: {found.outcome.value}")
        return found.displacement_m

    def compliance_between(self, nodes: Ints) -> Array:
        """Return the symmetric compliance matrix of t surface nodes [m/N], shape (3t, 3t)."""
        solver = self.solver
        if isinstance(solver, DirectSolver) and np.isin(nodes, solver.last).all():
            return solver.compliance_between(nodes)
        surface = components_of(self._surface)
        wanted = nodes.tolist()
        missing = [node for node in wanted if node not in self._columns]
        # Three columns of 8-byte numbers for each node.
        if 8 * 3 * len(surface) * (len(self._columns) + len(missing)) > LIMIT_BYTES:
            self._columns.clear()
            missing = wanted
        if missing:
            nodes_left = iter(missing)
            for block in columns_at(solver, components_of(np.array(missing)), surface):
                for columns in np.split(block, block.shape[1] // 3, axis=1):
                    # A view would keep the memory of the whole block.
                    self._columns[next(nodes_left)] = columns.copy()
        rows = components_of(np.searchsorted(self._surface, nodes))
        matrix = np.concatenate([self._columns[node][rows] for node in wanted], axis=1)
        # Rounding differs between columns, but the contact solver needs a symmetric matrix.
        return 0.5 * (matrix + matrix.T)
