"""Sparse factorisation: exact to rounding, many right sides for one factor.

Multifrontal Cholesky over nested dissection of the coordinates. At 35,000 unknowns it takes a
quarter of the time of SuperLU with an equal order of elimination (docs/decisions.md). A stiffness
that is not positive definite to rounding is factorised by SciPy's SuperLU on diagonal pivots. The
check of the residual applies to its solutions too.

The order of elimination is nested dissection by coordinates, which keeps a factor sparse (George
1973, SIAM J. Numer. Anal. 10:345).
"""

from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.sparse import csc_array, csr_array
from scipy.sparse.linalg import splu

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError
from tissue.fem.conjugate_gradients import Solution, SolverOutcome
from tissue.fem.solvers.held_body import HeldBody, pointwise_graph
from tissue.fem.solvers.multifrontal import Multifrontal, NotPositiveDefiniteError

__all__ = ["DirectSolver", "SuperLUFactor", "dissected", "dissection", "factorised"]


class SuperLUFactor:
    """Factor of a symmetric matrix, made once.

    Parameters
    ----------
    matrix
        Matrix in order of elimination, shape (n, n).

    Raises
    ------
    RuntimeError
        If the matrix is singular.
    """

    def __init__(self, matrix: csc_array) -> None:
        self._factor = splu(
            matrix, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )

    def solve(self, right: Array) -> Array:
        """Return the solution for one or several right sides, shape (n,) or (n, m)."""
        found: Array = self._factor.solve(np.asfortranarray(right))
        return found

    def inverse_of_last(self, count: int) -> Array:
        """Return the block of the inverse of the last unknowns, shape (count, count)."""
        upper = self._factor.U[-count:, -count:].toarray()
        # S = U^T D^-1 U with D the diagonal of U: its inverse is V D V^T with V the inverse of U.
        # D has negative entries where the matrix is indefinite.
        pivots = np.diag(upper)
        half = solve_triangular(upper, np.diag(np.sqrt(np.abs(pivots))))
        whole: Array = (half * np.sign(pivots)) @ half.T
        return whole


LEVELS = 10
"""Number of halvings of the box along the curve."""
LEAF = 32
"""Largest number of nodes of a set that is not cut further."""


def dissection(nodes_m: Array, graph: csr_array) -> Ints:
    """Return the nodes in order of elimination, shape (n,); parameters as of `dissected`."""
    return np.concatenate(dissected(nodes_m, graph))


def dissected(nodes_m: Array, graph: csr_array, *, leaf: int = LEAF) -> list[Ints]:
    """Return sets of nodes in order of elimination: both sides of each cut, then their separator.

    A set is cut at the median of its longest extent. The nodes of one side that touch the other
    side form the separator.

    Parameters
    ----------
    nodes_m
        Node positions [m], shape (n, 3).
    graph
        Nodes that share a cell, shape (n, n).
    leaf
        Sets of at most this many nodes are not cut further.
    """
    side = np.zeros(len(nodes_m), dtype=np.int8)
    last_first: list[Ints] = []
    waiting = [_along_curve(nodes_m)]
    while waiting:
        nodes = waiting.pop()
        along = (
            nodes_m[nodes, int(np.ptp(nodes_m[nodes], axis=0).argmax())]
            if len(nodes) > leaf
            else np.zeros(1)
        )
        low = along < np.median(along)
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


def _touches(graph: csr_array, nodes: Ints, marked: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask of the nodes that have a marked neighbour."""
    rows = graph[nodes]
    return np.asarray(rows @ marked.astype(np.int32) > 0)


def _along_curve(nodes_m: Array) -> Ints:
    """Return the nodes in the order of a Morton curve (Morton 1966), shape (n,).

    The curve passes each octant of a box before the next.
    """
    low = nodes_m.min(axis=0)
    steps = (
        (nodes_m - low) / max(float(np.ptp(nodes_m, axis=0).max()), 1e-300) * (2**LEVELS - 1)
    ).astype(np.int64)
    code = np.zeros(len(nodes_m), dtype=np.int64)
    for level in range(LEVELS):
        for axis in range(3):
            code |= ((steps[:, axis] >> level) & 1) << (3 * level + axis)
    return np.argsort(code, kind="stable")


TOGETHER = 48
"""Right sides in one back-substitution: with 48, each takes a ninth of the time of a single one."""


class Factor(Protocol):
    """Result of a factorisation, unknowns in order of elimination."""

    def solve(self, right: Array) -> Array:
        """Return the solution for one or several right sides, shape (n,) or (n, m)."""

    def inverse_of_last(self, count: int) -> Array:
        """Return the block of the inverse of the last unknowns, shape (count, count)."""


class DirectSolver:
    """Direct solver with a factor that is made once.

    Parameters
    ----------
    body
        The stiffness and its supports.
    last
        Nodes that are eliminated last, so that the compliance between them can be read off the
        factor.
    definite
        Refuse a stiffness that is not positive definite, instead of using SuperLU for it.

    Raises
    ------
    InputError
        If the matrix cannot be factorised.
    NotPositiveDefiniteError
        If the matrix is not positive definite and `definite` is set.
    """

    tolerance = 1e-8

    def __init__(self, body: HeldBody, *, last: Ints | None = None, definite: bool = False) -> None:
        self.body = body
        self.last = np.zeros(0, dtype=np.int64) if last is None else np.unique(last)
        """Nodes that were eliminated last, rising."""
        blocks = dissected(body.nodes_m, pointwise_graph(body.stiffness))
        if len(self.last):
            blocks = [*(nodes[~np.isin(nodes, self.last)] for nodes in blocks), self.last]
        self._order, self._matrix, self._factor = factorised(body, blocks, definite=definite)
        self._position = np.full(3 * len(body.nodes_m), -1)
        self._position[self._order] = np.arange(len(self._order))

    def solve(self, load_N: Array, *, start_m: Array | None = None) -> Solution:
        """Solve for the displacement under nodal forces [N], shape (n, 3).

        ``start_m`` is ignored.
        """
        right = self.body.right_side(load_N)
        norm = float(np.linalg.norm(right))
        if norm == 0.0:
            return Solution(self.body.whole(right), SolverOutcome.CONVERGED, 0, 0.0)
        place = self._position[self.body.free]
        ordered = np.empty_like(right)
        ordered[place] = right
        found = self._factor.solve(ordered)
        left = float(np.linalg.norm(ordered - self._matrix @ found)) / norm
        # The energy is positive for any load where K is positive definite.
        energy = float(found @ ordered)
        outcome = SolverOutcome.CONVERGED if left <= self.tolerance else SolverOutcome.INACCURATE
        if not np.isfinite(left) or energy <= 0.0:
            outcome = SolverOutcome.INDEFINITE
        return Solution(self.body.whole(found[place]), outcome, 0, left)

    def columns(self, unknowns: Ints, *, together: int = TOGETHER) -> Array:
        """Return displacements of all unknowns [m/N] for unit forces on some, shape (3n, k).

        Rows of held unknowns are zero.
        """
        answers = np.zeros((len(self._position), len(unknowns)))
        for start in range(0, len(unknowns), together):
            at = self._position[unknowns[start : start + together]]
            right = np.zeros((len(self._order), len(at)))
            pushed = np.flatnonzero(at >= 0)
            right[at[pushed], pushed] = 1.0
            answers[self._order, start : start + len(at)] = self._factor.solve(right)
        return answers

    def compliance_between(self, nodes: Ints) -> Array:
        """Compute the compliance [m/N] between nodes, x, y, z node by node, shape (3k, 3k).

        Zero for held nodes. For nodes that were eliminated last it is read off the last block of
        the factor, the factor of their Schur complement. Other nodes take back-substitutions.
        """
        if not np.isin(nodes, self.last).all():
            unknowns = (3 * nodes[:, None] + np.arange(3)).ravel()
            return self.columns(unknowns)[unknowns]
        at = np.searchsorted(self.last, nodes)
        rows = (3 * at[:, None] + np.arange(3)).ravel()
        between: Array = self._compliance_of_last_m_N[np.ix_(rows, rows)]
        return between

    @cached_property
    def _compliance_of_last_m_N(self) -> Array:
        free = np.isin((3 * self.last[:, None] + np.arange(3)).ravel(), self.body.free)
        whole = np.zeros((len(free), len(free)))
        if free.any():
            whole[np.ix_(free, free)] = self._factor.inverse_of_last(int(free.sum()))
        return whole


def factorised(
    body: HeldBody, blocks: list[Ints], *, definite: bool = False
) -> tuple[Ints, csc_array, Factor]:
    """Return the free unknowns in order of elimination, their matrix, and its factor.

    Parameters
    ----------
    body
        The stiffness and its supports.
    blocks
        Nodes that are eliminated together, in order; each node belongs to one block.
    definite
        Refuse a matrix that is not positive definite, instead of using SuperLU for it.

    Raises
    ------
    InputError
        If the matrix cannot be factorised.
    NotPositiveDefiniteError
        If the matrix is not positive definite and `definite` is set.
    """
    free = np.zeros(3 * len(body.nodes_m), dtype=np.bool_)
    free[body.free] = True
    parts = [(3 * nodes[:, None] + np.arange(3)).ravel() for nodes in blocks]
    parts = [kept for unknowns in parts if len(kept := unknowns[free[unknowns]])]
    kept = np.concatenate([np.zeros(0, dtype=np.int64), *parts])
    matrix = body.stiffness.tocsr()[kept][:, kept].tocsc()
    matrix.sort_indices()
    from threadpoolctl import threadpool_limits

    try:
        # Threads on small blocks took five times longer on a busy machine.
        with threadpool_limits(1, "blas"):
            return kept, matrix, Multifrontal(matrix, np.cumsum([0, *map(len, parts)]))
    except NotPositiveDefiniteError:
        if definite:
            raise
    try:
        return kept, matrix, SuperLUFactor(matrix)
    except RuntimeError as problem:
        raise InputError(
            "stiffness",
            "be positive definite",
            f"one without a factor ({problem})",
            "check moduli and sliver cells",
        ) from problem
