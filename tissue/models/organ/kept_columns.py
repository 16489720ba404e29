"""Compliance of the places that are pressed, from the organ's one factor: read off it, or column by column.

What is expected to be touched is eliminated last, and its compliance is there with the factor. Elsewhere a press takes
back-substitutions, each column once; for a hundred nodes a quarter to a half of the factor's time.
"""

from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np

from kernels.cores import core_count
from meshes.base.arrays import Array, Ints
from tissue.fem.solvers.direct import DirectSolver
from tissue.models.organ.compliance import Factor

__all__ = ["KeptColumns"]

TOGETHER = 16
"""Columns in one back-substitution, on one thread of BLAS: more gain nothing, and threads on small blocks lose."""
LIMIT_BYTES = 1_000_000_000
"""Memory above which the columns of earlier places are dropped."""


class KeptColumns:
    """Displacements of an organ's surface under unit forces on its nodes, kept from press to press.

    Parameters
    ----------
    factor
        The organ's factor, which is made when the first compliance is needed.
    surface
        Nodes of the surface in rising order, shape (s,).
    """

    def __init__(self, factor: Factor, surface: Ints) -> None:
        self._factor, self._surface = factor, surface
        self._rows = (3 * surface[:, None] + np.arange(3)).ravel()
        self._columns: dict[int, Array] = {}

    def between(self, nodes: Ints) -> Array:
        """Compliance between some nodes of the surface [m/N], symmetric, shape (3t, 3t)."""
        solver = self._factor.solver
        if isinstance(solver, DirectSolver) and np.isin(nodes, solver.last).all():
            return solver.compliance_between(nodes)
        missing = [int(node) for node in nodes if int(node) not in self._columns]
        if 8 * 3 * len(self._rows) * (len(self._columns) + len(missing)) > LIMIT_BYTES:
            self._columns.clear()
            missing = [int(node) for node in nodes]
        self._find(missing)
        rows = (3 * np.searchsorted(self._surface, nodes)[:, None] + np.arange(3)).ravel()
        matrix: Array = np.concatenate([self._columns[int(node)][rows] for node in nodes], axis=1)
        return 0.5 * (matrix + matrix.T)

    def _find(self, nodes: list[int]) -> None:
        from threadpoolctl import threadpool_limits

        solver, each = self._factor.solver, TOGETHER // 3
        solve = partial(solver.columns, together=TOGETHER) if isinstance(solver, DirectSolver) else solver.columns
        parts = [nodes[start : start + each] for start in range(0, len(nodes), each)]

        def find(part: list[int]) -> Array:
            found: Array = solve((3 * np.array(part)[:, None] + np.arange(3)).ravel())[self._rows]
            return found

        # A back-substitution releases the interpreter lock.
        with threadpool_limits(1, "blas"), ThreadPoolExecutor(core_count(), thread_name_prefix="columns") as threads:
            for part, columns in zip(parts, threads.map(find, parts), strict=True):
                for place, node in enumerate(part):
                    self._columns[node] = columns[:, 3 * place : 3 * place + 3].copy()
