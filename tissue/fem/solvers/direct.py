"""Sparse factorisation: exact to rounding, many right sides for one factor.

Multifrontal Cholesky over nested dissection of the coordinates. At 35,000 unknowns it takes a
quarter of the time of SciPy's SuperLU with an equal order of elimination (docs/decisions.md).

The order of elimination is nested dissection by coordinates, which keeps a factor sparse (George
1973, SIAM J. Numer. Anal. 10:345).

The factorisation is multifrontal (Duff and Reid 1983, ACM Trans. Math. Softw. 9:302).

Blocks of unknowns are eliminated one after the other. Each is eliminated in a dense front ``[[A,
B^T], [B, C]]`` of its unknowns and of the later unknowns that it changes. ``A = L L^T``, ``B L^-T``
is kept, and ``C - B A^-1 B^T`` is added to the front that eliminates the first of the later
unknowns. Nearly all of the time is then spent in LAPACK and in BLAS of level 3.
"""

from copy import copy
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.linalg.blas import dsyrk, dtrsm, dtrsv
from scipy.linalg.lapack import dpotrf, dpotri
from scipy.sparse import bsr_array, csc_array, csr_array, tril
from threadpoolctl import threadpool_limits

from meshes.base.arrays import Array, Flags, Ints
from meshes.base.errors import InputError
from tissue.fem.conjugate_gradients import Solution, SolverOutcome
from tissue.fem.solvers.held_body import HeldBody, components_of, pointwise_graph

__all__ = [
    "DirectSolver",
    "Front",
    "Multifrontal",
    "NotPositiveDefiniteError",
    "dissected",
    "fronts_of",
]


@dataclass(frozen=True, eq=False)
class Front:
    """Block of unknowns that is eliminated at once.

    Attributes
    ----------
    start, stop
        Its unknowns, in order of elimination.
    below
        Later unknowns that its elimination changes, rising, shape (r,).
    children
        Fronts whose changes reach this one first.
    """

    start: int
    stop: int
    below: Ints
    children: list[int]


def fronts_of(lower: csc_array, starts: Ints) -> list[Front]:
    """Return the fronts of blocks of unknowns in order of elimination, children before parents.

    Parameters
    ----------
    lower
        Lower triangle of the matrix in order of elimination, shape (n, n).
    starts
        First unknown of each block and n, rising, shape (blocks + 1,).
    """
    marked = np.zeros(lower.shape[0], np.bool_)
    block_of = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    children: list[list[int]] = [[] for _ in starts[1:]]
    fronts: list[Front] = []
    for block, (start, stop) in enumerate(
        zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True)
    ):
        marked[lower.indices[lower.indptr[start] : lower.indptr[stop]]] = True
        for child in children[block]:
            marked[fronts[child].below] = True
        below = stop + np.flatnonzero(marked[stop:])
        marked[start:] = False
        if len(below):
            children[int(block_of[below[0]])].append(block)
        fronts.append(Front(start, stop, below, children[block]))
    return fronts


FEW_RUNS = 16
"""Largest number of pairs of consecutive runs for which a block is added pair by pair."""
SHORT = 6
"""Mean number of rows of a run below which a block is added entry by entry.

Neither number is critical: on 51,795 unknowns of a liver, `FEW_RUNS` of 1 to 64 and `SHORT` of 2 to
12 take equal times within the scatter of a tenth.
"""


class NotPositiveDefiniteError(InputError):
    """Error for a matrix without a Cholesky factor."""


class Multifrontal:
    """Cholesky factor of a symmetric matrix, made once.

    Parameters
    ----------
    matrix
        Symmetric and positive definite, in order of elimination, shape (n, n); its lower triangle
        alone is read.
    starts
        First unknown of each block that is eliminated at once, and n, rising, shape (blocks + 1,).
    fronts
        Fronts of another matrix with these blocks and the same pattern; default: they are found.

    Raises
    ------
    NotPositiveDefiniteError
        If the matrix is not positive definite to rounding.
    """

    def __init__(
        self, matrix: csc_array, starts: Ints, *, fronts: list[Front] | None = None
    ) -> None:
        lower = csc_array(tril(matrix, format="csc"))
        self._count = lower.shape[0]
        self.fronts = fronts_of(lower, starts) if fronts is None else fronts
        self._diagonal: list[Array] = []
        """L of each front, shape (k, k), Fortran order."""
        self._under: list[Array] = []
        """``B L^-T`` of each front, shape (r, k), Fortran order."""
        changes: dict[int, Array] = {}
        place = np.zeros(self._count, np.int64)
        for number, front in enumerate(self.fronts):
            changed = self._eliminate(front, lower, changes, place)
            if len(front.below):
                changes[number] = changed

    @property
    def entries(self) -> int:
        """Number of entries of the factor."""
        return sum(part.size for part in [*self._diagonal, *self._under])

    def solve(self, right: Array) -> Array:
        """Return the solution for one or several right sides, shape (n,) or (n, m)."""
        if np.ndim(right) == 1:
            return self._solve_one(right)
        found = np.array(right, dtype=np.float64, order="C").reshape(
            self._count, int(np.prod(np.shape(right)[1:]))
        )
        parts = list(zip(self.fronts, self._diagonal, self._under, strict=True))
        for front, diagonal, under in parts:
            values = found[front.start : front.stop]
            # Columns of a compliance are 0 in most fronts.
            if not values.any():
                continue
            values[:] = dtrsm(1.0, diagonal, values, lower=1)
            if len(front.below):
                found[front.below] -= under @ values
        for front, diagonal, under in reversed(parts):
            values = found[front.start : front.stop]
            if len(front.below):
                values -= under.T @ found[front.below]
            values[:] = dtrsm(1.0, diagonal, values, lower=1, trans_a=1)
        return found.reshape(np.shape(right))

    def _solve_one(self, right: Array) -> Array:
        """Return the solution for one right side, shape (n,).

        The routines for one side read each entry once, and take 0.6 of the time of the others.
        """
        found = np.array(right, dtype=np.float64)
        parts = list(zip(self.fronts, self._diagonal, self._under, strict=True))
        for front, diagonal, under in parts:
            values = found[front.start : front.stop]
            if not values.any():
                continue
            values[:] = dtrsv(diagonal, values, lower=1)
            if len(front.below):
                found[front.below] -= under @ values
        for front, diagonal, under in reversed(parts):
            values = found[front.start : front.stop]
            if len(front.below):
                values -= under.T @ found[front.below]
            values[:] = dtrsv(diagonal, values, lower=1, trans=1)
        return found

    def inverse_of_last(self, count: int) -> Array:
        """Return the block of the inverse that belongs to the last unknowns, shape (count, count).

        It is bitwise symmetric. The count must not exceed the block that is eliminated last.
        """
        inverse, _ = dpotri(self._diagonal[-1], lower=1)
        inverse = inverse[-count:, -count:]
        whole: Array = np.tril(inverse) + np.tril(inverse, -1).T
        return whole

    def with_last(self, unknowns: Ints, added: Array) -> "Multifrontal":
        """Return the factor with a matrix added to some unknowns of the last block.

        All unknowns must be in the block that is eliminated last.
        """
        lower = np.tril(self._diagonal[-1])
        block = lower @ lower.T
        at = unknowns - (self._count - len(block))
        block[np.ix_(at, at)] += added
        diagonal, _ = dpotrf(np.asfortranarray(block), lower=1, overwrite_a=1)
        found = copy(self)
        found._diagonal = [*self._diagonal[:-1], diagonal]
        return found

    def last_block(self, count: int) -> Array:
        """Return the matrix condensed onto the last unknowns, shape (count, count).

        The count must be that of the block that is eliminated last.
        """
        lower = np.tril(self._diagonal[-1])
        assert len(lower) == count
        condensed: Array = lower @ lower.T
        return condensed

    def _eliminate(
        self, front: Front, lower: csc_array, changes: dict[int, Array], place: Ints
    ) -> Array:
        count = front.stop - front.start
        after = len(front.below)
        diagonal, under, change = (
            np.zeros(shape, order="F") for shape in ((count, count), (after, count), (after, after))
        )
        place[front.below] = np.arange(after)
        first = lower.indptr[front.start]
        end = lower.indptr[front.stop]
        rows = lower.indices[first:end]
        values = lower.data[first:end]
        columns = np.repeat(np.arange(count), np.diff(lower.indptr[front.start : front.stop + 1]))
        inside = rows < front.stop
        diagonal[rows[inside] - front.start, columns[inside]] = values[inside]
        under[place[rows[~inside]], columns[~inside]] = values[~inside]
        for child in front.children:
            block = changes.pop(child)
            below = self.fronts[child].below
            split = int(np.searchsorted(below, front.stop))
            here = _Rows.of(below[:split] - front.start)
            there = _Rows.of(place[below[split:]])
            _add(diagonal, here, here, block[:split, :split])
            _add(under, there, here, block[split:, :split])
            _add(change, there, there, block[split:, split:])
        diagonal, failed = dpotrf(diagonal, lower=1, overwrite_a=1)
        if failed:
            raise NotPositiveDefiniteError(
                "stiffness",
                "be positive definite",
                f"none at unknown {front.start + failed - 1}",
                "check moduli and sliver cells",
            )
        if after:
            under = dtrsm(1.0, diagonal, under, side=1, lower=1, trans_a=1, overwrite_b=1)
            change = dsyrk(-1.0, under, beta=1.0, c=change, lower=1, overwrite_c=1)
        self._diagonal.append(diagonal)
        self._under.append(under)
        return change


@dataclass(frozen=True)
class _Rows:
    """Rising rows of a matrix, with the start and end of each run of consecutive rows."""

    at: Ints
    runs: list[tuple[int, int]]

    @classmethod
    def of(cls, at: Ints) -> "_Rows":
        cuts = [0, *(1 + np.flatnonzero(np.diff(at) != 1)).tolist(), len(at)]
        return cls(at, list(pairwise(cuts)))


def _add(target: Array, rows: _Rows, columns: _Rows, block: Array) -> None:
    """Add a block to some rows and columns of a matrix in place.

    Of a square block, the lower triangle is added; the upper triangle may be added too. Long runs
    of rows, which are contiguous in memory, are added run by run.
    """
    if not block.size:
        return
    transposed = target.T
    added = block.T
    at = rows.at
    to = columns.at
    square = rows is columns
    if len(rows.runs) * len(columns.runs) <= FEW_RUNS:
        for a, b in rows.runs:
            for c, d in columns.runs:
                if not square or c < b:
                    transposed[to[c] : to[c] + d - c, at[a] : at[a] + b - a] += added[c:d, a:b]
    elif len(rows.runs) * SHORT <= len(at):
        for a, b in rows.runs:
            end = b if square else len(to)
            transposed[to[:end], at[a] : at[a] + b - a] += added[:end, a:b]
    else:
        transposed[np.ix_(to, at)] += added


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
        Solver of the same body with another stiffness of the same pattern, whose order of
        elimination is used again instead of `last`; default: the order is found.

    Raises
    ------
    NotPositiveDefiniteError
        If the stiffness is not positive definite to rounding.
    """

    # Residual over the load from which a solve is inaccurate. Well-shaped cells leave 1e-12, so
    # that this allows for contrasts and slivers.
    tolerance = 1e-8

    def __init__(
        self, body: HeldBody, *, last: Ints | None = None, like: "DirectSolver | None" = None
    ) -> None:
        self.body = body
        self._order_of: _Order = _Order.of(body, last) if like is None else like._order_of
        self.last = self._order_of.last
        """Nodes that were eliminated last, rising."""
        self._order = self._order_of.unknowns
        self._position = self._order_of.position
        self._matrix = self._order_of.ordered(body.stiffness)
        # Threads on small blocks took five times longer on a busy machine.
        with threadpool_limits(1, "blas"):
            self._factor: Multifrontal = Multifrontal(
                self._matrix,
                self._order_of.starts,
                fronts=None if like is None else like._factor.fronts,
            )

    def solve(self, load_N: Array) -> Solution:
        """Solve for the displacement under nodal forces [N], shape (n, 3)."""
        right = self.body.right_side(load_N)
        norm = float(np.linalg.norm(right))
        if norm == 0.0:
            return Solution(self.body.whole(right), SolverOutcome.CONVERGED, 0, 0.0)
        place = self._position[self.body.free]
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
        found = self._factor.solve(load_N.ravel()[self._order])
        moved = np.zeros(load_N.size)
        moved[self._order] = found
        return moved.reshape(load_N.shape)

    def displacements_m(self, loads_N: Array) -> Array:
        """Return the displacements [m] under several loads [N], shape (3n, k) both, unchecked."""
        moved = np.zeros_like(loads_N)
        for start in range(0, loads_N.shape[1], TOGETHER):
            several = np.ascontiguousarray(loads_N[self._order, start : start + TOGETHER])
            moved[self._order, start : start + TOGETHER] = self._factor.solve(several)
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
        at = self._position[columns]
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
            unknowns = components_of(nodes)
            return self.columns(unknowns)[unknowns]
        at = np.searchsorted(self.last, nodes)
        rows = components_of(at)
        between: Array = self._compliance_of_last_m_N[np.ix_(rows, rows)]
        return between

    def stiffness_of_last(self) -> Array:
        """Return the stiffness [N/m] condensed onto the nodes eliminated last, shape (3k, 3k).

        Zero for held nodes.
        """
        free = np.isin(components_of(self.last), self.body.free)
        whole = np.zeros((len(free), len(free)))
        if free.any():
            whole[np.ix_(free, free)] = self._factor.last_block(int(free.sum()))
        return whole

    @cached_property
    def _compliance_of_last_m_N(self) -> Array:
        free = np.isin(components_of(self.last), self.body.free)
        whole = np.zeros((len(free), len(free)))
        if free.any():
            whole[np.ix_(free, free)] = self._factor.inverse_of_last(int(free.sum()))
        return whole
