"""Assembled stiffness of tetrahedra: 3x3 blocks, each pair of nodes summed once and mirrored."""

from functools import cache

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import bsr_array

from kernels.launcher import SplitLaunch
from kernels.tetrahedra import pair_stiffness, pair_stiffness_isotropic
from meshes.base.arrays import Array, Int32s
from tissue.fem.pattern import local_pairs
from tissue.fem.shapes import EDGES, gradient_products
from tissue.fem.space import Space
from tissue.materials.elasticity import elasticity_rows

__all__ = ["assemble", "pair_tables"]


def assemble(space: Space, elasticity: ArrayLike) -> bsr_array:
    """Return the stiffness matrix [N/m] of linear elastic cells, in blocks of 3x3.

    Its shape is (unknowns, unknowns). Both triangles are stored and are bitwise equal, on any
    number of cores. Integrals are exact.

    Parameters
    ----------
    space
        Nodes and cells; it stores the positions of the blocks after the first call.
    elasticity
        Lame constants [Pa], shape (2,) or (m, 2), or stiffness matrices [Pa], shape (6, 6) or (m,
        6, 6), as `tissue.materials.elasticity` makes them.

    Raises
    ------
    InputError
        If the elasticity has another shape or is not positive definite.
    """
    rows = elasticity_rows(elasticity, space.cell_count)
    device = space.device
    pattern = space.pattern

    def on(values: NDArray[np.generic], dtype: type) -> wp.array[object]:
        return wp.array(values, dtype=dtype, device=device, copy=False)

    corners, weights = pair_tables(space.order)
    blocks = wp.empty(len(pattern.column), dtype=wp.mat33d, device=device)
    inputs = [
        *(
            on(part, wp.int32)
            for part in (pattern.pair_start, pattern.contribution, pattern.place, pattern.mirror)
        ),
        on(corners, wp.int32),
        on(weights, wp.float64),
        *space.gradients,
        on(rows, wp.float64),
        0,
    ]
    SplitLaunch(
        pair_stiffness_isotropic if rows.ndim == 2 else pair_stiffness,
        dim=len(pattern.place),
        inputs=inputs,
        outputs=[blocks],
        offset_index=len(inputs) - 1,
        device=device,
    )()
    return bsr_array(
        (blocks.numpy(), pattern.column, pattern.row_start), shape=(space.unknown_count,) * 2
    )


@cache
def pair_tables(order: int) -> tuple[Int32s, Array]:
    """Return the corners of the shape functions of each pair in a cell, and their weights.

    Both arrays have shape (p, 4).

    The corners of A are i, j and those of B k, n; weights belong to the products ik, in, jk, jn of
    the gradients.
    """
    products = gradient_products(4, order)
    ends = np.concatenate([np.stack([np.arange(4)] * 2, axis=1), EDGES[: len(products) - 4]])
    a, b = local_pairs(len(products)).T
    corners = np.concatenate([ends[a], ends[b]], axis=1)
    i, j, k, n = corners.T
    weights = np.stack([products[a, b, p, q] for p, q in ((i, k), (i, n), (j, k), (j, n))], axis=1)
    # A corner has one gradient: counted once.
    weights[:, 1:] *= np.stack([k != n, i != j, (i != j) & (k != n)], axis=1)
    return corners.astype(np.int32), weights
