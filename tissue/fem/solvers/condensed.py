"""Compliance of the nodes that may be touched: ``W = H K^-1 H^T``, found once and kept on disk.

With it a contact solve knows nothing of the inside (Duriez et al. 2006, IEEE Trans. Vis. Comput. Graph. 12:36). Where
nothing else is wanted it is read off one factor; else back-substitutions give it, and the displacement of all nodes
that are shown.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kernels.launcher import core_count
from meshes.base.cache import cached_arrays
from meshes.base.errors import InputError
from tissue.fem.outcome import SolverOutcome
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.schur import schur_compliance_m_N
from tissue.fem.solvers.solution import ColumnSolver, HeldBody, Solution

__all__ = ["LIMIT_BYTES", "CondensedSolver", "SurfaceCompliance", "compliance_bytes", "surface_compliance"]

Array = NDArray[np.float64]
Nodes = NDArray[np.int64]
LIMIT_BYTES = 2_000_000_000
"""Dense matrices above this are refused; columns are then found where the tool is, by ``LazyCompliance``."""
SCHUR_UNKNOWNS = 60_000
"""Above this the factor is not taken apart: copies of both halves would take gigabytes."""
CHUNK = 8
"""Nodes whose columns one thread finds at a time."""


@dataclass(frozen=True, eq=False)
class SurfaceCompliance:
    """How touchable nodes, and nodes that are shown, give to forces on touchable nodes.

    Attributes
    ----------
    touchable
        Touchable nodes, shape (t,).
    matrix_m_N
        W [m/N], symmetric bitwise, shape (3t, 3t), x, y, z node by node.
    shown
        Nodes that are shown, shape (s,).
    response_m_N
        Their displacement for unit forces on the touchable nodes [m/N], float32, shape (3t, 3s).
    asymmetry
        Largest difference of W from its transpose before it was made symmetric, relative to the largest entry.
    """

    touchable: Nodes
    matrix_m_N: Array
    shown: Nodes
    response_m_N: NDArray[np.float32]
    asymmetry: float

    def shown_displacement_m(self, force_N: Array) -> Array:
        """Displacement of the shown nodes [m], shape (s, 3), for forces on the touchable ones [N], shape (t, 3)."""
        flat = np.asarray(force_N, dtype=np.float64).ravel()
        pushed = np.flatnonzero(flat)
        return np.asarray(flat[pushed] @ self.response_m_N[pushed]).reshape(-1, 3)


def compliance_bytes(touchable_count: int, shown_count: int) -> int:
    """Memory of a compliance: 8 bytes an entry of W, 4 of the response of the shown nodes."""
    return 9 * touchable_count * (8 * touchable_count + 4 * shown_count)


def surface_compliance(
    body: HeldBody,
    touchable: Nodes,
    *,
    shown: Nodes | None = None,
    limit_bytes: int = LIMIT_BYTES,
    solver: Callable[[], ColumnSolver] | None = None,
    progress: Callable[[float], None] | None = None,
) -> SurfaceCompliance:
    """The compliance from the cache, or found from a factor.

    Parameters
    ----------
    body
        The stiffness and what holds it, at rest.
    touchable
        Nodes that a tool may touch, each once, shape (t,).
    shown
        Nodes whose displacement is wanted too, shape (s,). Default: none.
    limit_bytes
        Memory above which it is refused.
    solver
        Makes what finds columns where the cache has no answer and they are asked for one by one. Default: a factor.
    progress
        Called with the share that is done, in (0, 1].

    Raises
    ------
    InputError
        If there is nothing to touch, a node does not exist, is not in the body or is named twice, the memory exceeds
        the limit, or supports are displaced.
    """
    touchable = _checked("touchable", touchable, body)
    shown = np.zeros(0, dtype=np.int64) if shown is None else _checked("shown", shown, body)
    if len(touchable) == 0:
        raise InputError("touchable must name at least one node, got none: give nodes of the surface")
    needed = compliance_bytes(len(touchable), len(shown))
    if needed > limit_bytes:
        raise InputError(
            f"touchable and shown must fit in {limit_bytes / 1e9:.3g} GB, got {len(touchable)} and {len(shown)} nodes "
            f"that need {needed / 1e9:.3g} GB: name fewer, or find columns where the tool is (LazyCompliance)"
        )
    body.require_rest()
    blocks = body.sprung
    key = [blocks.data, blocks.indices, blocks.indptr, body.supports.fixed, touchable, shown]

    def make() -> dict[str, NDArray[np.generic]]:
        """The matrix, and what moves the nodes that are shown."""
        if len(shown) == 0 and len(body.free) <= SCHUR_UNKNOWNS:
            return {
                "matrix": schur_compliance_m_N(body, touchable),
                "response": np.empty((3 * len(touchable), 0), dtype=np.float32),
                "asymmetry": np.array(0.0),
            }
        return _found(solver() if solver else DirectSolver(body), touchable, shown, progress)

    kept = cached_arrays("compliance", key, make)
    matrix, response = kept["matrix"].astype(np.float64, copy=False), kept["response"].astype(np.float32, copy=False)
    return SurfaceCompliance(touchable, matrix, shown, response, float(kept["asymmetry"]))


def _found(
    solver: ColumnSolver, touchable: Nodes, shown: Nodes, progress: Callable[[float], None] | None
) -> dict[str, NDArray[np.generic]]:
    axes = np.arange(3)
    rows, shown_rows = ((3 * nodes[:, None] + axes).ravel() for nodes in (touchable, shown))
    matrix = np.empty((len(rows), len(rows)))
    response = np.empty((len(rows), len(shown_rows)), dtype=np.float32)

    def fill(start: int) -> int:
        part = slice(start, min(start + 3 * CHUNK, len(rows)))
        columns = solver.columns(rows[part])
        matrix[part], response[part] = columns[rows].T, columns[shown_rows].T
        return part.stop

    # A back-substitution releases the interpreter lock.
    with ThreadPoolExecutor(core_count(), thread_name_prefix="compliance") as threads:
        for done in threads.map(fill, range(0, len(rows), 3 * CHUNK)):
            if progress is not None:
                progress(done / len(rows))
    asymmetry = np.abs(matrix - matrix.T).max() / np.abs(matrix).max()
    return {"matrix": 0.5 * (matrix + matrix.T), "response": response, "asymmetry": np.array(asymmetry)}


def _checked(name: str, nodes: Nodes, body: HeldBody) -> Nodes:
    nodes = np.asarray(nodes, dtype=np.int64).ravel()
    count = len(body.nodes_m)
    if len(nodes) and (nodes.min() < 0 or nodes.max() >= count):
        raise InputError(f"{name} must name nodes 0 to {count - 1}, got {nodes.min()} to {nodes.max()}: number them so")
    if len(np.unique(nodes)) != len(nodes):
        raise InputError(f"{name} must name each node once, got {len(nodes) - len(np.unique(nodes))} twice: drop them")
    loose = int((~body.carrying[nodes]).sum())
    if loose:
        raise InputError(f"{name} must be nodes of cells, got {loose} that no cell uses: leave them out")
    return nodes


class CondensedSolver:
    """The compliance as a path to ``K u = f``, for loads on touchable nodes.

    Parameters
    ----------
    body
        The stiffness and what holds it, at rest.
    compliance
        Its compliance, with all nodes shown.

    Raises
    ------
    InputError
        If not all nodes are shown.
    """

    tolerance = 1e-4
    """What single precision of the response leaves in the energy norm: 2e-6 to 1e-5 on livers."""

    def __init__(self, body: HeldBody, compliance: SurfaceCompliance) -> None:
        if len(compliance.shown) != len(body.nodes_m):
            raise InputError(f"compliance must show all {len(body.nodes_m)} nodes, got {len(compliance.shown)}: "
                             "name all as shown")  # fmt: skip
        self.body, self.compliance = body, compliance

    def solve(self, load_N: Array, *, start_m: Array | None = None) -> Solution:
        """Displacement under nodal forces [N], shape (n, 3), on touchable nodes; ``start_m`` is ignored.

        Raises
        ------
        InputError
            As `Solver`, and if forces act on free components of nodes that are not touchable.
        """
        right = self.body.right_side(load_N)
        norm = float(np.linalg.norm(right))
        load = self.body.whole(right)
        force = load[self.compliance.touchable].copy()
        load[self.compliance.touchable] = 0.0
        if load.any():
            raise InputError("load_N must act on touchable nodes, got forces on others: take the direct path")
        displacement = np.empty(self.body.nodes_m.shape)
        displacement[self.compliance.shown] = self.compliance.shown_displacement_m(force)
        touched = self.compliance.matrix_m_N @ force.ravel()
        displacement[self.compliance.touchable] = touched.reshape(-1, 3)
        left = right - (self.body.sprung @ displacement.ravel())[self.body.free]
        share = float(np.linalg.norm(left)) / norm if norm else 0.0
        return Solution(displacement, SolverOutcome.CONVERGED, 0, share)
