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

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import NDArray

from kernels.cores import core_count
from meshes.base.arrays import Array, Ints
from meshes.base.cache import cached_arrays
from meshes.base.errors import InputError
from tissue.fem.solvers.direct import DirectSolver
from tissue.fem.solvers.held_body import ColumnSolver, HeldBody, components_of
from tissue.system.blas_threads import one_blas_thread

LIMIT_BYTES = 2_000_000_000
"""Largest allowed memory of a compliance matrix [bytes]."""
SCHUR_UNKNOWNS = 100_000
"""Largest number of unknowns for which the compliance is read from the factor.

With more unknowns, the temporary copies would take more than 4 GB.
"""
CHUNK = 48
"""Number of columns of the compliance that one thread computes at a time.

For 36,000 unknowns the columns take 14 MB. With loads and copies, a thread needs 70 MB, in addition
to the memory of the back-substitution. The number is a multiple of 3, so a block contains all three
columns of a node.
"""


def surface_compliance_m_N(
    body: HeldBody,
    touchable: Ints,
    *,
    limit_bytes: int = LIMIT_BYTES,
    solver: Callable[[], ColumnSolver] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Array:
    """Return the compliance W of touchable nodes [m/N], from the cache or from a factorisation.

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
        Function that returns a solver for the body. It is called only if W is not in the cache.
        Default: a new factorisation.
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
            "use a shorter path or longer edges",
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


def columns_at(solver: ColumnSolver, unknowns: Ints, rows: Ints) -> Iterator[Array]:
    """Yield columns of the inverse stiffness, restricted to given rows [m/N], block by block.

    Several threads compute the blocks. The linear algebra of each block uses one thread.

    Parameters
    ----------
    solver
        Solver for the displacements under unit forces.
    unknowns, rows
        Unknowns that are loaded by a unit force, shape (k,), and unknowns whose displacements are
        returned, shape (r,). A block has at most `CHUNK` columns, shape (r, c).
    """
    chunks = [unknowns[start : start + CHUNK] for start in range(0, len(unknowns), CHUNK)]
    # A back-substitution releases the interpreter lock.
    with (
        one_blas_thread(),
        ThreadPoolExecutor(core_count(), thread_name_prefix="compliance") as threads,
    ):
        yield from threads.map(lambda chunk: solver.columns(chunk)[rows], chunks)


def _found(
    solver: ColumnSolver, touchable: Ints, progress: Callable[[float], None] | None
) -> Array:
    """Compute the symmetric compliance matrix [m/N], shape (3t, 3t), by back-substitutions."""
    rows = components_of(touchable)
    matrix = np.empty((len(rows), len(rows)))
    done = 0
    for block in columns_at(solver, rows, rows):
        matrix[done : done + block.shape[1]] = block.T
        done += block.shape[1]
        if progress is not None:
            progress(done / len(rows))
    return 0.5 * (matrix + matrix.T)


def reduced_compliance_m_N(solver: ColumnSolver, touchable: Ints, size: int) -> Array:
    """Return the compliance of t touchable nodes in a reduced basis [m/N], shape (3t, 3t).

    The basis is computed by proper orthogonal decomposition (in the energy norm) of the
    displacements due to unit forces on the touchable nodes. The Gram matrix of these displacements
    is the compliance matrix W itself. The reduced compliance is the part of W that belongs to the
    largest eigenvalues. It is the best approximation of W with this number of modes (Eckart and
    Young 1936, Psychometrika 1:211). The omitted part of W affects mostly the loaded nodes
    themselves. The diagonal blocks of the omitted part are added to the result, like the residual
    flexibility of omitted modes (MacNeal 1971, Comput. Struct. 1:581).

    Parameters
    ----------
    solver
        Solver for the displacements under unit forces.
    touchable
        Nodes that carry load, shape (t,).
    size
        Number of modes in the basis. A number above 3t is treated as 3t.
    """
    whole = _found(solver, touchable, None)
    values, vectors = np.linalg.eigh(whole)
    leading = vectors[:, -size:]
    cut = (leading * values[-size:].clip(min=0.0)) @ leading.T
    nodes = np.arange(len(touchable))
    view = cut.reshape(len(nodes), 3, len(nodes), 3)
    view[nodes, :, nodes, :] = whole.reshape(view.shape)[nodes, :, nodes, :]
    return 0.5 * (cut + cut.T)
