"""Compliance of the surface nodes that a tool may touch.

There are three methods. The first method computes the complete matrix. The second method computes
columns for the nodes near the tool during the run. The third method computes the matrix from a
reduced basis.
"""

from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Literal

import numpy as np

from kernels.cores import core_count
from meshes.base.arrays import Array, Ints
from meshes.base.progress import Progress
from tissue.fem.solvers.compliance import (
    SCHUR_UNKNOWNS,
    LazyCompliance,
    reduced_compliance_m_N,
    surface_compliance_m_N,
)
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import HeldBody, components_of
from tissue.fem.solvers.multigrid import MultigridSolver
from tissue.system.blas_threads import one_blas_thread

CONDENSING = "condensing the compliance to the surface that can be touched"
FACTOR_UNKNOWNS = 200_000
"""Largest number of unknowns of an organ whose stiffness matrix is factorised.

For larger organs a multigrid solver is used, because a factor would take gigabytes of memory.
"""
CompliancePath = Literal["condensed", "lazy", "reduced"]
"""Method used to compute the compliance.

``condensed``: the complete matrix is computed by a factorisation, and cached on disk. ``lazy``:
columns are computed while the tool moves. ``reduced``: the matrix is computed from a reduced basis.
"""


class Factor:
    """Sparse factor of an organ's stiffness matrix, computed when it is first needed.

    If the factor would need too much memory, a multigrid solver is used instead.
    """

    def __init__(self, body: HeldBody) -> None:
        self._body = body
        self._last = np.zeros(0, np.int64)

    @cached_property
    def solver(self) -> DirectSolver | MultigridSolver:
        """Solver for the organ's displacement under nodal forces."""
        if len(self._body.free) > FACTOR_UNKNOWNS:
            return MultigridSolver(self._body)
        return DirectSolver(self._body, last=self._last)

    def expect(self, nodes: Ints) -> None:
        """Request a factor from which the compliance between the given nodes can be read directly.

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


def compliance_of(
    body: HeldBody,
    touchable: Ints,
    factor: Factor,
    *,
    path: CompliancePath,
    basis_size: int,
    report: Progress,
) -> tuple[Array, LazyCompliance | None]:
    """Return the compliance of t touchable nodes [m/N], and an object for missing entries.

    The compliance has shape (3t, 3t). The second result is None if the compliance is complete.
    Otherwise missing entries are NaN, and the second result fills them while the tool moves.
    """
    if path == "condensed":
        found = surface_compliance_m_N(
            body,
            touchable,
            solver=lambda: factor.solver,
            progress=lambda share: report(CONDENSING, share),
        )
        return found, None
    count = 3 * len(touchable)
    if path == "reduced":
        return reduced_compliance_m_N(factor.solver, touchable, min(basis_size, count)), None
    return np.full((count, count), np.nan), LazyCompliance(factor.solver, touchable)


TOGETHER = 16
"""Number of compliance columns in one back-substitution, which uses one thread of BLAS.

More columns are not faster, and several threads are slower on small blocks.
"""
LIMIT_BYTES = 1_000_000_000
"""Memory above which all columns stored in earlier presses are dropped [bytes].

On a surface of 5,000 nodes, the columns of a touched node need 0.36 MB, so the columns of 2,800
nodes fit.
"""


class KeptColumns:
    """Displacements of an organ's surface under unit forces on its nodes, stored for later presses.

    Parameters
    ----------
    factor
        The organ's factor, which is made when the first compliance is needed.
    surface
        Nodes of the surface in rising order, shape (s,).
    """

    def __init__(self, factor: Factor, surface: Ints) -> None:
        self._factor = factor
        self._surface = surface
        self._rows = components_of(surface)
        self._columns: dict[int, Array] = {}

    def between(self, nodes: Ints) -> Array:
        """Return the symmetric compliance matrix of t surface nodes [m/N], shape (3t, 3t)."""
        solver = self._factor.solver
        if isinstance(solver, DirectSolver) and np.isin(nodes, solver.last).all():
            return solver.compliance_between(nodes)
        wanted = nodes.tolist()
        missing = [node for node in wanted if node not in self._columns]
        # Three columns of 8-byte numbers for each node.
        if 8 * 3 * len(self._rows) * (len(self._columns) + len(missing)) > LIMIT_BYTES:
            self._columns.clear()
            missing = wanted
        self._find(missing)
        rows = components_of(np.searchsorted(self._surface, nodes))
        matrix = np.concatenate([self._columns[node][rows] for node in wanted], axis=1)
        # Rounding differs between columns, but the contact solver needs a symmetric matrix.
        return 0.5 * (matrix + matrix.T)

    def _find(self, nodes: list[int]) -> None:
        solver = self._factor.solver
        each = TOGETHER // 3
        parts = [nodes[start : start + each] for start in range(0, len(nodes), each)]

        def find(part: list[int]) -> Array:
            return solver.columns(components_of(np.array(part)))[self._rows]

        # A back-substitution releases the interpreter lock.
        with (
            one_blas_thread(),
            ThreadPoolExecutor(core_count(), thread_name_prefix="columns") as threads,
        ):
            for part, columns in zip(parts, threads.map(find, parts), strict=True):
                for place, node in enumerate(part):
                    self._columns[node] = columns[:, 3 * place : 3 * place + 3].copy()
