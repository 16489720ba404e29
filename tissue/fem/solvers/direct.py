"""Direct solver with a sparse Cholesky factor, for many right-hand sides.

The factorisation is multifrontal. With 35,000 unknowns it takes a quarter of the time of SciPy's
SuperLU with the same order of elimination (docs/decisions.md).

The unknowns are eliminated in the order of a nested dissection by node coordinates. This order
gives a sparse factor (George 1973, SIAM J. Numer. Anal. 10:345).
"""

from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import bsr_array, csc_array, csr_array

from meshes.base.arrays import Array, Flags, Ints
from tissue.fem.conjugate_gradients import Solution, SolverOutcome
from tissue.fem.solvers.held_body import HeldBody, components_of, pointwise_graph
from tissue.fem.solvers.multifrontal import Multifrontal
from tissue.system.blas_threads import one_blas_thread

LEVELS = 10
"""Number of halvings of the box for the Morton curve, which then has 1024 steps along a side."""
LEAF = 32
"""Largest number of nodes in a set that the dissection does not divide further.

A factorisation takes the same time with 8 to 128 nodes. With 128 the factor has 15 % more entries.
"""


def dissected(nodes_m: Array, graph: csr_array) -> list[Ints]:
    """Return sets of nodes in order of elimination, by nested dissection.

    A set of nodes is divided at the median coordinate along its longest extent. The nodes of one
    side that have a neighbour on the other side form the separator. It is eliminated after both
    sides.

    Parameters
    ----------
    nodes_m
        Node positions [m], shape (n, 3).
    graph
        Matrix with an entry for each pair of nodes that share a cell, shape (n, n).
    """
    side = np.zeros(len(nodes_m), np.int8)
    last_first: list[Ints] = []
    waiting = [_along_curve(nodes_m)] if len(nodes_m) else []
    while waiting:
        nodes = waiting.pop()
        along = (
            nodes_m[nodes, int(np.ptp(nodes_m[nodes], axis=0).argmax())]
            if len(nodes) > LEAF
            else np.zeros(1)
        )
        low = along < np.median(along)
        # A small set is not cut, nor a set with more than half of its nodes in its lowest plane.
        if not low.any():
            last_first.append(nodes)
            continue
        lower = nodes[low]
        upper = nodes[~low]
        side[lower] = 1
        side[upper] = 2
        rim_below = _touches(graph, lower, side == 2)
        rim_above = _touches(graph, upper, side == 1)
        side[nodes] = 0
        if rim_below.sum() <= rim_above.sum():
            last_first.append(lower[rim_below])
            lower = lower[~rim_below]
        else:
            last_first.append(upper[rim_above])
            upper = upper[~rim_above]
        waiting += [lower, upper]
    return last_first[::-1]


def _touches(graph: csr_array, nodes: Ints, marked: Flags) -> Flags:
    """Return a mask of the nodes that have a marked neighbour."""
    rows = graph[nodes]
    return rows @ marked.astype(np.int32) > 0


def _along_curve(nodes_m: Array) -> Ints:
    """Return the nodes in the order of a Morton curve (Morton 1966), shape (n,).

    The curve visits one octant of a box completely before the next octant.
    """
    low = nodes_m.min(axis=0)
    steps = (
        # 1e-300 avoids a division by zero: a single node has no extent
        (nodes_m - low) / max(float(np.ptp(nodes_m, axis=0).max()), 1e-300) * (2**LEVELS - 1)
    ).astype(np.int64)
    code = np.zeros(len(nodes_m), np.int64)
    for level in range(LEVELS):
        for axis in range(3):
            code |= ((steps[:, axis] >> level) & 1) << (3 * level + axis)
    return np.argsort(code, kind="stable")


TOGETHER = 48
"""Number of right-hand sides in one back-substitution."""


@dataclass(frozen=True, eq=False)
class _Order:
    """Order in which the unknowns of a body are eliminated, for all matrices with one pattern.

    Attributes
    ----------
    last
        Nodes that are eliminated last, in rising order.
    unknowns
        Free unknowns in the order of elimination, shape (f,).
    position
        Position of each unknown in the order of elimination, -1 for held unknowns, shape (3n,).
    starts
        First position of each block of unknowns that are eliminated together, shape (blocks + 1,).
        The last entry is f.
    sources, indices, indptr
        Compressed columns of the ordered matrix: position of each entry in the stiffness, row of
        each entry, and start of each column.
    """

    last: Ints
    unknowns: Ints
    position: Ints
    starts: Ints
    sources: Ints
    indices: Ints
    indptr: Ints

    @classmethod
    def of(cls, body: HeldBody, last: Ints | None) -> "_Order":
        """Compute the order for a body and for the nodes that are eliminated last."""
        stiffness = body.stiffness
        ends = np.zeros(0, np.int64) if last is None else np.unique(last)
        graph = pointwise_graph(stiffness)
        others = np.setdiff1d(np.arange(len(body.nodes_m)), ends)
        # The nodes that are eliminated last need no separators.
        sets = dissected(body.nodes_m[others], graph[others][:, others])
        blocks = [*(others[nodes] for nodes in sets), *([ends] if len(ends) else [])]
        free = np.zeros(3 * len(body.nodes_m), np.bool_)
        free[body.free] = True
        parts = [components_of(nodes) for nodes in blocks]
        parts = [kept for unknowns in parts if len(kept := unknowns[free[unknowns]])]
        unknowns = np.concatenate([np.zeros(0, np.int64), *parts])
        numbers = np.arange(stiffness.data.size).reshape(stiffness.data.shape)
        numbered = bsr_array((numbers, stiffness.indices, stiffness.indptr), shape=stiffness.shape)
        matrix = numbered.tocsr()[unknowns][:, unknowns].tocsc()
        matrix.sort_indices()
        position = np.full(3 * len(body.nodes_m), -1)
        position[unknowns] = np.arange(len(unknowns))
        starts = np.cumsum([0, *map(len, parts)])
        return cls(ends, unknowns, position, starts, matrix.data, matrix.indices, matrix.indptr)

    def ordered(self, stiffness: bsr_array) -> csc_array:
        """Return the stiffness of the free unknowns in the order of elimination, shape (f, f)."""
        size = len(self.unknowns)
        values = stiffness.data.ravel()[self.sources]
        return csc_array((values, self.indices, self.indptr), shape=(size, size))


class DirectSolver:
    """Direct solver that factorises the stiffness once.

    Parameters
    ----------
    body
        The stiffness and its supports.
    last
        Nodes that are eliminated last. The compliance between these nodes can be read from the
        factor.
    like
        Solver of the same body with another stiffness that has the same sparsity pattern. The new
        solver uses the order of elimination and the precision of `like`, and ignores `last` and
        `single`. Default: a new order is computed.
    single
        True for a factor in single precision. The factorisation then takes two thirds of the time,
        but `solve` reports the solutions as inaccurate.

    Raises
    ------
    NotPositiveDefiniteError
        If the stiffness is not positive definite within rounding errors.
    """

    # Ratio of residual to load above which a solve is inaccurate. With well-shaped cells the ratio
    # is 1e-12. The limit allows for contrasts of stiffness and for slivers.
    tolerance = 1e-8

    def __init__(
        self,
        body: HeldBody,
        *,
        last: Ints | None = None,
        like: "DirectSolver | None" = None,
        single: bool = False,
    ) -> None:
        self.body = body
        self._order: _Order = _Order.of(body, last) if like is None else like._order
        self.last = self._order.last
        """Nodes that are eliminated last, rising."""
        self._matrix = self._order.ordered(body.stiffness)
        if single if like is None else like._matrix.dtype == np.float32:
            self._matrix = self._matrix.astype(np.float32)
        # With several threads, small blocks took five times as long on a busy computer.
        with one_blas_thread():
            self._factor: Multifrontal = Multifrontal(
                self._matrix,
                self._order.starts,
                fronts=None if like is None else like._factor.fronts,
            )

    def solve(self, load_N: Array) -> Solution:
        """Solve for the displacement under nodal forces [N], shape (n, 3)."""
        right = self.body.right_side(load_N)
        norm = float(np.linalg.norm(right))
        if norm == 0.0:
            return Solution(self.body.whole(right), SolverOutcome.CONVERGED, 0, 0.0)
        load = self.body.whole(right)
        moved = self.displacement_m(load)
        unknowns = self._order.unknowns
        unbalanced = load.ravel()[unknowns] - self._matrix @ moved.ravel()[unknowns]
        left = float(np.linalg.norm(unbalanced)) / norm
        outcome = SolverOutcome.CONVERGED if left <= self.tolerance else SolverOutcome.INACCURATE
        return Solution(moved, outcome, 0, left)

    def displacement_m(self, load_N: Array) -> Array:
        """Return the displacement [m] under nodal forces [N], both of shape (n, 3).

        The forces and the result are not checked.

        Forces on held components have no effect.
        """
        found = self._factor.solve(load_N.ravel()[self._order.unknowns])
        moved = np.zeros(load_N.size)
        moved[self._order.unknowns] = found
        return moved.reshape(load_N.shape)

    def displacements_m(self, loads_N: Array) -> Array:
        """Return the displacements [m] under k loads [N], both of shape (3n, k).

        The loads and the result are not checked.
        """
        moved = np.zeros_like(loads_N)
        for start in range(0, loads_N.shape[1], TOGETHER):
            several = np.ascontiguousarray(loads_N[self._order.unknowns, start : start + TOGETHER])
            moved[self._order.unknowns, start : start + TOGETHER] = self._factor.solve(several)
        return moved

    def with_springs(self, root: csr_array) -> "DirectSolver":
        """Return a solver for the body with additional springs on nodes that are eliminated last.

        Only the last block is factorised anew. Of the returned solver, only `displacement_m` may be
        used.

        Parameters
        ----------
        root
            Square root of the stiffness of the springs [(N/m)^0.5], shape (p, 3n).
        """
        columns = np.unique(root.indices)
        at = self._order.position[columns]
        near = root[:, columns[at >= 0]].toarray()
        found = copy(self)
        # A product of an array with itself would call another BLAS routine, whose rounding differs
        # from the results of earlier versions.
        found._factor = self._factor.with_last(at[at >= 0], near.T @ near.copy())
        return found

    def columns(self, unknowns: Ints) -> Array:
        """Return the displacements [m/N] under a unit force on each of k unknowns, shape (3n, k).

        Rows of held unknowns are zero.
        """
        loads = np.zeros((len(self._order.position), len(unknowns)))
        loads[unknowns, np.arange(len(unknowns))] = 1.0
        return self.displacements_m(loads)

    def compliance_between(self, nodes: Ints) -> Array:
        """Compute the compliance between k nodes [m/N], shape (3k, 3k).

        The order of rows and columns is x, y, z node by node. The compliance of held nodes is zero.
        For nodes that are eliminated last, the compliance is computed from the last block of the
        factor, the factor of the Schur complement. For other nodes, the compliance is computed by
        back-substitution.
        """
        if not np.isin(nodes, self.last).all():
            unknowns = components_of(nodes)
            starts = range(0, len(unknowns), TOGETHER)
            # Only the wanted rows are kept, because all rows of all columns can take gigabytes.
            blocks = [
                self.columns(unknowns[start : start + TOGETHER])[unknowns] for start in starts
            ]
            return np.concatenate(blocks, axis=1)
        at = np.searchsorted(self.last, nodes)
        rows = components_of(at)
        return self._compliance_of_last_m_N[np.ix_(rows, rows)]

    @cached_property
    def _compliance_of_last_m_N(self) -> Array:
        free = np.isin(components_of(self.last), self.body.free)
        whole = np.zeros((len(free), len(free)))
        if free.any():
            whole[np.ix_(free, free)] = self._factor.inverse_of_last(int(free.sum()))
        return whole
