"""Compliance where the tool is: columns computed on demand in a bounded buffer.

They are computed in the background.
"""

from collections import OrderedDict, deque
from threading import Condition, Thread

import numpy as np

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError
from tissue.fem.solvers.held_body import ColumnSolver

__all__ = ["LazyCompliance"]


class LazyCompliance:
    """Columns of ``W = H K^-1 H^T`` for the nodes that were requested last.

    Nodes are named by their position among the touchable nodes. ``want`` requests the nodes near
    the tool. ``fill`` computes their columns in the caller's thread, before the ticks. ``start``
    lets a thread compute them in parallel. ``pour`` only copies. The node with the oldest request
    is dropped first.

    Parameters
    ----------
    solver
        Solver for the columns: a factor, or multigrid where a factor would not fit.
    touchable
        Nodes that may be touched, shape (t,).
    capacity_bytes
        Memory of the buffer.

    Raises
    ------
    InputError
        If the buffer does not hold a single node.
    """

    def __init__(
        self, solver: ColumnSolver, touchable: Ints, *, capacity_bytes: int = 500_000_000
    ) -> None:
        self._solver = solver
        self._touchable = np.asarray(touchable, dtype=np.int64)
        self._rows = (3 * self._touchable[:, None] + np.arange(3)).ravel()
        each = 3 * 8 * len(self._rows)
        self.capacity = min(capacity_bytes // max(each, 1), len(self._touchable))
        """Nodes that the buffer holds."""
        if self.capacity < 1:
            raise InputError(
                "capacity_bytes", f"hold one node, {each} bytes", capacity_bytes, "allow more"
            )
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
        """Request nodes, most urgent first.

        Earlier requests that are not computed yet are dropped.

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
                "allow more memory, or ask for fewer",
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
        """Write one newly computed node into a matrix of all touchable nodes, shape (3t, 3t).

        The method writes the blocks between this node and all computed nodes, with equal values on
        every call. Other blocks stay unchanged. One node per call keeps a tick short.

        Returns
        -------
        int
            Nodes still to be written.

        Raises
        ------
        InputError
            If the matrix has another shape or is not contiguous.
        RuntimeError
            If the background thread failed.
        """
        if self._problem is not None:
            raise RuntimeError("the compliance could not be found") from self._problem
        if (
            matrix_m_N.shape != (len(self._rows), len(self._rows))
            or not matrix_m_N.flags.c_contiguous
        ):
            raise InputError(
                "matrix_m_N",
                f"be contiguous of shape {(len(self._rows),) * 2}",
                f"shape {matrix_m_N.shape}",
                "make it with np.full",
            )
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
        """End the thread after its present node."""
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
        """Compute the columns of one node, three right sides.

        A factor releases the interpreter lock during the solve.
        """
        unknowns = 3 * self._touchable[node] + np.arange(3)
        columns = self._solver.columns(unknowns)[self._rows].reshape(-1, 3, 3).transpose(0, 2, 1)
        with self._changed:
            if self._slot[node] >= 0:
                return  # already computed: it was requested again during its computation
            if not self._spare and node not in self._wanted:
                return  # the tool has moved on
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
