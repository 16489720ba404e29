"""Compliance of the touchable nodes, ``W = H K^-1 H^T``, computed once and kept on disk.

With W, a contact solve needs no unknowns inside the body (Duriez et al. 2006, IEEE Trans. Vis.
Comput. Graph. 12:36). W is read off one factor. Where that factor would need too much memory to be
inverted in part, W is computed by back-substitutions.

One factor: with the touchable unknowns t last, ``K = L L^T`` has the Schur complement ``S = K_tt -
K_tr K_rr^-1 K_rt = L_tt L_tt^T`` in its last block, and ``W = S^-1``. No back-substitution is made:
on 36,000 unknowns, 1,350 of them touchable, back-substitutions took twenty times as long.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from kernels.cores import core_count
from meshes.base.arrays import Array, Ints
from meshes.base.cache import cached_arrays
from meshes.base.errors import InputError
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import ColumnSolver, HeldBody

__all__ = ["LIMIT_BYTES", "SCHUR_UNKNOWNS", "compliance_bytes", "surface_compliance_m_N"]

LIMIT_BYTES = 2_000_000_000
"""Largest dense matrix allowed.

Beyond it, ``LazyCompliance`` computes columns where the tool is.
"""
SCHUR_UNKNOWNS = 100_000
"""Largest number of unknowns for which W is read off the factor.

Above it, copies of both halves would take more than 4 GB.
"""
CHUNK = 8
"""Nodes per task: one thread computes the columns of this number of nodes at a time."""


def compliance_bytes(touchable_count: int) -> int:
    """Return the memory of a compliance [bytes], 8 bytes an entry."""
    return 8 * (3 * touchable_count) ** 2


def surface_compliance_m_N(
    body: HeldBody,
    touchable: Ints,
    *,
    limit_bytes: int = LIMIT_BYTES,
    solver: Callable[[], ColumnSolver] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Array:
    """Return W [m/N] from the cache, or compute it from a factor.

    It is bitwise symmetric, shape (3t, 3t), x, y, z node by node.

    Parameters
    ----------
    body
        The stiffness and its supports.
    touchable
        Nodes that a tool may touch, each once, shape (t,).
    limit_bytes
        Largest memory of W [bytes].
    solver
        Function that makes the solver of the body if W is not in the cache. Default: a new factor.
    progress
        Called with the completed share, in (0, 1].

    Raises
    ------
    InputError
        If there is no touchable node, a node does not exist, is not in the body or is named
        twice, or the memory exceeds the limit.
    """
    _require_nodes(touchable, body)
    needed = compliance_bytes(len(touchable))
    if needed > limit_bytes:
        raise InputError(
            "touchable",
            f"fit in {limit_bytes / 1000000000.0:.3g} GB",
            f"{len(touchable)} nodes that need {needed / 1000000000.0:.3g} GB",
            "name fewer, or find columns where the tool is (LazyCompliance)",
        )
    blocks = body.stiffness
    key = [blocks.data, blocks.indices, blocks.indptr, body.fixed, touchable]

    def make() -> dict[str, NDArray[np.generic]]:
        if len(body.free) > SCHUR_UNKNOWNS:
            return {
                "matrix": _found(solver() if solver else DirectSolver(body), touchable, progress)
            }
        factor = solver() if solver else None
        if not (isinstance(factor, DirectSolver) and np.isin(touchable, factor.last).all()):
            factor = DirectSolver(body, last=touchable)
        return {"matrix": factor.compliance_between(touchable)}

    return cached_arrays("compliance", key, make)["matrix"].astype(np.float64, copy=False)


def _found(
    solver: ColumnSolver, touchable: Ints, progress: Callable[[float], None] | None
) -> Array:
    rows = (3 * touchable[:, None] + np.arange(3)).ravel()
    matrix = np.empty((len(rows), len(rows)))

    def fill(start: int) -> int:
        part = slice(start, min(start + 3 * CHUNK, len(rows)))
        matrix[part] = solver.columns(rows[part])[rows].T
        return part.stop

    # A back-substitution releases the interpreter lock.
    with ThreadPoolExecutor(core_count(), thread_name_prefix="compliance") as threads:
        for done in threads.map(fill, range(0, len(rows), 3 * CHUNK)):
            if progress is not None:
                progress(done / len(rows))
    return 0.5 * (matrix + matrix.T)


def _require_nodes(nodes: Ints, body: HeldBody) -> None:
    count = len(body.nodes_m)
    unique = len(np.unique(nodes))
    if len(nodes) == 0:
        raise InputError("touchable", "name at least one node", "none", "give nodes of the surface")
    if nodes.min() < 0 or nodes.max() >= count:
        raise InputError(
            "touchable",
            f"name nodes 0 to {count - 1}",
            f"{nodes.min()} to {nodes.max()}",
            "number them so",
        )
    if unique != len(nodes):
        raise InputError(
            "touchable", "name each node once", f"{len(nodes) - unique} twice", "drop them"
        )
    if loose := int((~body.carrying[nodes]).sum()):
        raise InputError(
            "touchable", "be nodes of cells", f"{loose} that no cell uses", "leave them out"
        )
