"""Compliance ``W = H K^-1 H^T`` of the surface nodes that a tool may touch.

K is the stiffness matrix, and H selects the touchable unknowns. With W, a contact solver needs no
unknowns inside the body (Duriez et al. 2006, IEEE Trans. Vis. Comput. Graph. 12:36). W is read from
one factor of K and stored on disk. If this needs too much memory, W is computed by
back-substitutions.

The touchable unknowns t are eliminated last, after the other unknowns r. The last block of L in ``K
= L L^T`` is then the factor of the Schur complement: ``S = K_tt - K_tr K_rr^-1 K_rt = L_tt
L_tt^T``. The compliance is ``W = S^-1``. No back-substitution is needed. With 36,000 unknowns,
1,350 of them touchable, back-substitutions would take twenty times as long.
"""

from collections import OrderedDict, deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Condition, Thread

import numpy as np
from numpy.typing import NDArray

from kernels.cores import core_count
from meshes.base.arrays import Array, Ints
from meshes.base.cache import cached_arrays
from meshes.base.errors import InputError
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import ColumnSolver, HeldBody, components_of

LIMIT_BYTES = 2_000_000_000
"""Largest allowed memory of a dense compliance matrix [bytes].

For a larger matrix, use ``LazyCompliance``, which computes only columns near the tool.
"""
SCHUR_UNKNOWNS = 100_000
"""Largest number of unknowns for which the compliance is read from the factor.

With more unknowns, the temporary copies would take more than 4 GB.
"""
CHUNK = 48
"""Number of columns of the compliance that one thread computes at a time.

For 36,000 unknowns the columns take 14 MB. With loads and copies, a thread needs 70 MB, in addition
to the memory of the back-substitution.
"""


def surface_compliance_m_N(
    body: HeldBody,
    touchable: Ints,
    *,
    limit_bytes: int = LIMIT_BYTES,
    solver: Callable[[], ColumnSolver] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Array:
    """Return the compliance W of touchable nodes [m/N], from the cache or from a factor.

    W has shape (3t, 3t) for t touchable nodes, and is bitwise symmetric. The order of rows and
    columns is x, y, z of the first node, x, y, z of the second node, and so on.

    Parameters
    ----------
    body
        Stiffness matrix and supports.
    touchable
        Nodes that a tool may touch, without duplicates, shape (t,).
    limit_bytes
        Largest memory of W [bytes].
    solver
        Function that returns a solver for the body, called if W is not in the cache. Default: a new
        factorisation.
    progress
        Function that is called with the completed share, in (0, 1].

    Raises
    ------
    InputError
        If W would need more memory than the limit.
    """
    # 8 bytes for each number, three components for each node
    needed = 8 * (3 * len(touchable)) ** 2
    if needed > limit_bytes:
        raise InputError(
            "touchable",
            f"fit in {limit_bytes / 1000000000.0:.3g} GB",
            f"{len(touchable)} nodes that need {needed / 1000000000.0:.3g} GB",
            "name fewer nodes, or compute columns only near the tool (LazyCompliance)",
        )
    blocks = body.stiffness
    key = [blocks.data, blocks.indices, blocks.indptr, body.fixed, touchable]

    def make() -> dict[str, NDArray[np.generic]]:
        """Compute W from a factor, by the method that fits the number of unknowns."""
        factor = solver() if solver else None
        if len(body.free) > SCHUR_UNKNOWNS:
            return {"matrix": _found(factor or DirectSolver(body), touchable, progress)}
        if not (isinstance(factor, DirectSolver) and np.isin(touchable, factor.last).all()):
            factor = DirectSolver(body, last=touchable)
        return {"matrix": factor.compliance_between(touchable)}

    return cached_arrays("compliance", key, make)["matrix"].astype(np.float64, copy=False)


def _found(
    solver: ColumnSolver, touchable: Ints, progress: Callable[[float], None] | None
) -> Array:
    """Compute the symmetric compliance matrix [m/N], shape (3t, 3t), by back-substitutions."""
    rows = components_of(touchable)
    matrix = np.empty((len(rows), len(rows)))

    def fill(start: int) -> int:
        part = slice(start, min(start + CHUNK, len(rows)))
        matrix[part] = solver.columns(rows[part])[rows].T
        return part.stop

    # A back-substitution releases the interpreter lock.
    with ThreadPoolExecutor(core_count(), thread_name_prefix="compliance") as threads:
        for done in threads.map(fill, range(0, len(rows), CHUNK)):
            if progress is not None:
                progress(done / len(rows))
    return 0.5 * (matrix + matrix.T)


def reduced_compliance_m_N(solver: ColumnSolver, touchable: Ints, size: int) -> Array:
    """Return the compliance of t touchable nodes in a reduced basis [m/N], shape (3t, 3t).

    The basis is the proper orthogonal decomposition, in the energy norm, of the displacements for
    all unit forces on the touchable nodes. The Gram matrix of these displacements is the compliance
    matrix W itself. The reduced compliance is the part of W with the largest eigenvalues, which is
    the best matrix of this rank (Eckart and Young 1936, Psychometrika 1:211). The omitted part of W
    acts mostly at the loaded nodes. The diagonal blocks of this part are added, like the residual
    flexibility for omitted modes (MacNeal 1971, Comput. Struct. 1:581).

    Parameters
    ----------
    solver
        Solver for the displacements under unit forces.
    touchable
        Nodes that carry load, shape (t,).
    size
        Number of modes in the basis.
    """
    whole = _found(solver, touchable, None)
    values, vectors = np.linalg.eigh(whole)
    leading = vectors[:, -size:]
    cut = (leading * values[-size:].clip(min=0.0)) @ leading.T
    nodes = np.arange(len(touchable))
    view = cut.reshape(len(nodes), 3, len(nodes), 3)
    view[nodes, :, nodes, :] = whole.reshape(view.shape)[nodes, :, nodes, :]
    return 0.5 * (cut + cut.T)


class LazyCompliance:
    """Columns of a compliance matrix for the nodes that were requested last.

    A node is identified by its index among the touchable nodes. ``want`` requests the nodes near
    the tool. ``fill`` computes the requested columns in the caller's thread, before the ticks.
    ``start`` starts a thread that computes requested columns during the ticks. ``pour`` only copies
    computed values. If the buffer is full, the columns of the node with the oldest request are
    dropped.

    Parameters
    ----------
    solver
        Solver for the columns: a direct solver, or multigrid if a factor would not fit into memory.
    touchable
        Nodes that may be touched, shape (t,).
    capacity_bytes
        Memory of the buffer for columns [bytes].
    """

    def __init__(
        self, solver: ColumnSolver, touchable: Ints, *, capacity_bytes: int = 500_000_000
    ) -> None:
        self._solver = solver
        self._touchable = np.asarray(touchable, np.int64)
        self._rows = components_of(self._touchable)
        # three columns, 8 bytes for each number
        each = 3 * 8 * len(self._rows)
        self.capacity = min(capacity_bytes // max(each, 1), len(self._touchable))
        """Number of nodes that the buffer holds."""
        self._columns = np.empty((self.capacity, len(self._touchable), 3, 3))
        self._slot = np.full(len(self._touchable), -1)
        self._used: OrderedDict[int, None] = OrderedDict()
        self._spare = list(range(self.capacity))[::-1]
        self._wanted: set[int] = set()
        self._waiting: deque[int] = deque()
        self._arrived: deque[int] = deque()
        self._changed = Condition()
        self._thread: Thread | None = None
        self._problem: BaseException | None = None
        self._ended = False

    def want(self, nodes: Ints) -> None:
        """Request the columns of nodes, most urgent first.

        Earlier requests whose columns are not computed yet are dropped.

        Raises
        ------
        InputError
            If more nodes are requested than the buffer holds.
        """
        if len(nodes) > self.capacity:
            raise InputError(
                "nodes",
                f"be at most the {self.capacity} that the buffer holds",
                len(nodes),
                "allow more memory, or ask for fewer nodes",
            )
        with self._changed:
            self._waiting.clear()
            self._wanted = set(map(int, nodes))
            for node in map(int, nodes[::-1]):
                if self._slot[node] < 0:
                    self._waiting.appendleft(node)
                else:
                    self._used.move_to_end(node)
            if self._waiting:
                self._changed.notify_all()

    def pour(self, matrix_m_N: Array) -> int:
        """Write the blocks of one newly computed node into a matrix of all touchable nodes.

        The matrix has shape (3t, 3t). The method writes the blocks between this node and all
        computed nodes. Other blocks stay unchanged. A call writes only one node, to keep a tick
        short.

        Returns
        -------
        int
            Number of nodes still to be written.

        Raises
        ------
        RuntimeError
            If the background thread failed.
        """
        if self._problem is not None:
            raise RuntimeError("the compliance could not be found") from self._problem
        with self._changed:
            while self._arrived and self._slot[self._arrived[0]] < 0:
                self._arrived.popleft()
            if not self._arrived:
                return 0
            node = self._arrived.popleft()
            others = np.fromiter(self._used, dtype=np.int64)
            there = self._columns[self._slot[node], others]
            back = self._columns[self._slot[others], node]
            blocks = 0.5 * (there + back.transpose(0, 2, 1))
            left = len(self._arrived)
        view = matrix_m_N.reshape(len(self._touchable), 3, len(self._touchable), 3)
        view[node, :, others, :] = blocks
        view[others, :, node, :] = blocks.transpose(0, 2, 1)
        return left

    def fill(self) -> None:
        """Compute all requested columns in this thread."""
        while (node := self._next()) is not None:
            self._find(node)

    def start(self) -> None:
        """Start the background thread that computes the requested nodes."""
        if self._thread is None:
            self._thread = Thread(target=self._serve, name="compliance", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """End the background thread after it has computed its present node."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        if self._thread is not None:
            self._thread.join()
        self._thread = None
        self._ended = False

    def _serve(self) -> None:
        try:
            while True:
                with self._changed:
                    while not self._waiting and not self._ended:
                        self._changed.wait()
                    if self._ended:
                        return
                node = self._next()
                if node is not None:
                    self._find(node)
        except BaseException as problem:
            self._problem = problem

    def _next(self) -> int | None:
        with self._changed:
            return self._waiting.popleft() if self._waiting else None

    def _find(self, node: int) -> None:
        """Compute the three columns of one node.

        A back-substitution releases the interpreter lock, so that other threads can run.
        """
        unknowns = 3 * self._touchable[node] + np.arange(3)
        columns = self._solver.columns(unknowns)[self._rows].reshape(-1, 3, 3).transpose(0, 2, 1)
        with self._changed:
            if self._slot[node] >= 0:
                return  # the node was requested again during its computation
            if not self._spare and node not in self._wanted:
                return  # the tool has moved to other nodes
            if not self._spare:
                oldest = next(other for other in self._used if other not in self._wanted)
                del self._used[oldest]
                self._spare.append(int(self._slot[oldest]))
                self._slot[oldest] = -1
            slot = self._spare.pop()
            self._columns[slot] = columns
            self._slot[node] = slot
            self._used[node] = None
            self._arrived.append(node)
