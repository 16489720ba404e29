"""Sparse factorisation: exact to rounding, many right sides for one factor.

Multifrontal Cholesky over nested dissection of the coordinates. At 35,000 unknowns it takes a
quarter of the time of SciPy's SuperLU with an equal order of elimination (docs/decisions.md).

The order of elimination is nested dissection by coordinates, which keeps a factor sparse (George
1973, SIAM J. Numer. Anal. 10:345).
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

__all__ = ["DirectSolver", "dissected"]


LEVELS = 10
"""Number of halvings of the box along the curve: 1024 steps a side, finer than the nodes."""
LEAF = 32
"""Largest number of nodes of a set that is not cut further.

Factors take equal times with 8 to 128; with 128 they have 15 % more entries.
"""


def dissected(nodes_m: Array, graph: csr_array) -> list[Ints]:
    """Return sets of nodes in order of elimination: both sides of each cut, then their separator.

    A set is cut at the median of its longest extent. The nodes of one side that touch the other
    side form the separator.

    Parameters
    ----------
    nodes_m
        Node positions [m], shape (n, 3).
    graph
        Nodes that share a cell, shape (n, n).
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
        # A small set, or more than half of its nodes lie in its lowest plane: no cut.
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
    return np.asarray(rows @ marked.astype(np.int32) > 0)


def _along_curve(nodes_m: Array) -> Ints:
    """Return the nodes in the order of a Morton curve (Morton 1966), shape (n,).

    The curve passes each octant of a box before the next.
    """
    low = nodes_m.min(axis=0)
    steps = (
        # 1e-300: a single node has no extent
        (nodes_m - low) / max(float(np.ptp(nodes_m, axis=0).max()), 1e-300) * (2**LEVELS - 1)
    ).astype(np.int64)
    code = np.zeros(len(nodes_m), np.int64)
    for level in range(LEVELS):
        for axis in range(3):
            code |= ((steps[:, axis] >> level) & 1) << (3 * level + axis)
    return np.argsort(code, kind="stable")


TOGETHER = 48
"""Right sides in one back-substitution: with 48, each takes a ninth of the time of a single one."""


@dataclass(frozen=True, eq=False)
class _Order:
    """Order of elimination of a body, for any stiffness with one pattern.

    Attributes
    ----------
    last
        Nodes that are eliminated last, rising.
    unknowns
        Free unknowns in the order of elimination, shape (f,).
    position
        Position of each unknown in that order, -1 for held ones, shape (3n,).
    starts
        First position of each block and f, shape (blocks + 1,).
    sources, indices, indptr
        Entries of the matrix in that order by column: their places in the stiffness, and the rows
        and starts of the columns.
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
        """Find the order for a body and the nodes to eliminate last."""
        stiffness = body.stiffness
        ends = np.zeros(0, np.int64) if last is None else np.unique(last)
        graph = pointwise_graph(stiffness)
        others = np.setdiff1d(np.arange(len(body.nodes_m)), ends)
        # The last nodes need no separators.
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
        """Return the stiffness of the free unknowns in the order of elimination, (f, f)."""
        size = len(self.unknowns)
        values = stiffness.data.ravel()[self.sources]
        return csc_array((values, self.indices, self.indptr), shape=(size, size))


class DirectSolver:
    """Direct solver with a factor that is made once.

    Parameters
    ----------
    body
        The stiffness and its supports.
    last
        Nodes that are eliminated last, so that the compliance between them can be read off the
        factor.
    like
        Solver of the same body with another stiffness of the same pattern. Its order of
        elimination and its precision are used again instead of `last` and `single`; default: the
        order is found.
    single
        Whether the factor is in single precision. It is made in two thirds of the time; `solve`
        calls its solutions inaccurate.

    Raises
    ------
    NotPositiveDefiniteError
        If the stiffness is not positive definite to rounding.
    """

    # Residual over the load from which a solve is inaccurate. Well-shaped cells leave 1e-12, so
    # that this allows for contrasts and slivers.
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
        """Nodes that were eliminated last, rising."""
        self._matrix = self._order.ordered(body.stiffness)
        if single if like is None else like._matrix.dtype == np.float32:
            self._matrix = self._matrix.astype(np.float32)
        # Threads on small blocks took five times longer on a busy machine.
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
        place = self._order.position[self.body.free]
        ordered = np.empty_like(right)
        ordered[place] = right
        found = self._factor.solve(ordered)
        left = float(np.linalg.norm(ordered - self._matrix @ found)) / norm
        outcome = SolverOutcome.CONVERGED if left <= self.tolerance else SolverOutcome.INACCURATE
        return Solution(self.body.whole(found[place]), outcome, 0, left)

    def displacement_m(self, load_N: Array) -> Array:
        """Return the displacement [m] under nodal forces [N], shape (n, 3), unchecked.

        Forces on held components have no effect.
        """
        found = self._factor.solve(load_N.ravel()[self._order.unknowns])
        moved = np.zeros(load_N.size)
        moved[self._order.unknowns] = found
        return moved.reshape(load_N.shape)

    def displacements_m(self, loads_N: Array) -> Array:
        """Return the displacements [m] under several loads [N], shape (3n, k) both, unchecked."""
        moved = np.zeros_like(loads_N)
        for start in range(0, loads_N.shape[1], TOGETHER):
            several = np.ascontiguousarray(loads_N[self._order.unknowns, start : start + TOGETHER])
            moved[self._order.unknowns, start : start + TOGETHER] = self._factor.solve(several)
        return moved

    def with_springs(self, root: csr_array) -> "DirectSolver":
        """Return the solver of the body with springs on nodes that were eliminated last.

        Only the last block is factorised anew. `displacement_m` alone may be used.

        Parameters
        ----------
        root
            Square root of the stiffness of the springs [(N/m)^0.5], shape (p, 3n).
        """
        columns = np.unique(root.indices)
        at = self._order.position[columns]
        near = root[:, columns[at >= 0]].toarray()
        found = copy(self)
        # The product of an array with itself takes another BLAS routine, which rounds differently
        # from the runs of earlier versions.
        found._factor = self._factor.with_last(at[at >= 0], near.T @ near.copy())
        return found

    def columns(self, unknowns: Ints, *, together: int = TOGETHER) -> Array:
        """Return displacements of all unknowns [m/N] for unit forces on some, shape (3n, k).

        Rows of held unknowns are zero.
        """
        answers = np.zeros((len(self._order.position), len(unknowns)))
        for start in range(0, len(unknowns), together):
            at = self._order.position[unknowns[start : start + together]]
            right = np.zeros((len(self._order.unknowns), len(at)))
            pushed = np.flatnonzero(at >= 0)
            right[at[pushed], pushed] = 1.0
            answers[self._order.unknowns, start : start + len(at)] = self._factor.solve(right)
        return answers

    def compliance_between(self, nodes: Ints) -> Array:
        """Compute the compliance [m/N] between nodes, x, y, z node by node, shape (3k, 3k).

        Zero for held nodes. For nodes that were eliminated last it is read off the last block of
        the factor, the factor of their Schur complement. Other nodes take back-substitutions.
        """
        if not np.isin(nodes, self.last).all():
            unknowns = components_of(nodes)
            return self.columns(unknowns)[unknowns]
        at = np.searchsorted(self.last, nodes)
        rows = components_of(at)
        between: Array = self._compliance_of_last_m_N[np.ix_(rows, rows)]
        return between

    @cached_property
    def _compliance_of_last_m_N(self) -> Array:
        free = np.isin(components_of(self.last), self.body.free)
        whole = np.zeros((len(free), len(free)))
        if free.any():
            whole[np.ix_(free, free)] = self._factor.inverse_of_last(int(free.sum()))
        return whole
