"""Stiffness of straight-sided tetrahedra.

The gradients g_c of the barycentric coordinates are constant in a cell. For a pair of shape
functions A and B, the exact integral of ``grad A (grad B)^T`` over a cell is ``S = V sum_cd w_cd
g_c g_d^T``. V is the volume of the cell, and the weights w_cd depend only on the pair of shape
functions. The stiffness block of the pair is linear in S::

    K_AB[i, j] = sum_pq C[ip, jq] S[p, q]            any material
    K_AB = lambda S + mu S^T + mu tr(S) I            isotropic

Quadratic cells lock (become too stiff) as lambda / mu increases. Lambda is therefore split into two
parts. For the part ``softened``, the matrix ``M = V mean(grad A) mean(grad B)^T`` is used instead
of S. This part only resists the mean volume change of a cell::

    K_AB = K_AB - softened (S - M)

For each pair of nodes, one thread sums the contributions of the cells in fixed order, and writes
the sum and the transpose of the sum. The matrix is therefore symmetric to the last bit, on any
number of threads.
"""

import warp as wp

from kernels.arrays import (
    Doubles,
    Doubles2D,
    Doubles3D,
    Int32s,
    Int32s2D,
    Matrices,
    Vectors,
    Vectors2D,
)
from kernels.constants import ZERO

wp.set_module_options({"max_unroll": 1})


@wp.kernel
def cell_gradients(
    nodes: Vectors,  # [m]
    cell_nodes: Int32s2D,  # [cell, 4 or more], corners first
    offset: int,
    # out
    gradient_out: Vectors2D,  # [cell, corner] [1/m]
    volume_out: Doubles,  # [cell] [m3]
):
    """Compute the gradients of the barycentric coordinates, and the volume, of each cell."""
    cell = wp.tid() + offset
    origin = nodes[cell_nodes[cell, 0]]
    u = nodes[cell_nodes[cell, 1]] - origin
    v = nodes[cell_nodes[cell, 2]] - origin
    w = nodes[cell_nodes[cell, 3]] - origin
    normal = wp.cross(v, w)
    six = wp.dot(u, normal)
    first = normal / six
    second = wp.cross(w, u) / six
    third = wp.cross(u, v) / six
    gradient_out[cell, 0] = -(first + second + third)
    gradient_out[cell, 1] = first
    gradient_out[cell, 2] = second
    gradient_out[cell, 3] = third
    volume_out[cell] = six / wp.float64(6.0)


@wp.func
def gradient_product(
    contribution: int,
    pair_corner: Int32s2D,
    pair_weight: Doubles2D,
    gradient: Vectors2D,
):
    """Compute the matrix ``S / V`` for two nodes of a cell, and return it with the cell's index.

    S is the integral of the product of the gradients of the two shape functions, and V is the
    volume of the cell. If ``contribution`` is negative, the pair is reversed and S is transposed.
    """
    entry = contribution
    if contribution < 0:
        entry = -contribution - 1  # bitwise complement of the entry
    pairs = pair_corner.shape[0]
    cell = entry / pairs
    pair = entry - cell * pairs
    product_term = (
        pair_weight[pair, 0] * gradient[cell, pair_corner[pair, 2]]
        + pair_weight[pair, 1] * gradient[cell, pair_corner[pair, 3]]
    )
    product = wp.outer(gradient[cell, pair_corner[pair, 0]], product_term)
    if pair_corner[pair, 0] != pair_corner[pair, 1]:
        product_term = (
            pair_weight[pair, 2] * gradient[cell, pair_corner[pair, 2]]
            + pair_weight[pair, 3] * gradient[cell, pair_corner[pair, 3]]
        )
        product += wp.outer(gradient[cell, pair_corner[pair, 1]], product_term)
    if contribution < 0:
        product = wp.transpose(product)
    return cell, product


@wp.func
def write_pair(
    block: wp.mat33d,
    place: int,
    mirror: int,
    block_out: Matrices,
):
    """Write the stiffness block of a pair of nodes, and its transpose for the reversed pair.

    A block on the diagonal of the matrix is made exactly symmetric.
    """
    if place == mirror:
        block[1, 0] = block[0, 1]
        block[2, 0] = block[0, 2]
        block[2, 1] = block[1, 2]
        block_out[place] = block
    else:
        block_out[place] = block
        block_out[mirror] = wp.transpose(block)


@wp.kernel
def pair_stiffness_isotropic(
    # pairs of nodes
    pair_start: Int32s,  # [pair + 1]
    # cell x pairs per cell + pair; bitwise complement: reversed pair
    contribution: Int32s,
    place: Int32s,  # [pair], index of the block
    mirror: Int32s,  # [pair], index of the transposed block
    # pairs of shape functions
    pair_corner: Int32s2D,  # [pair in cell, 4]: 2 corners of A, 2 of B
    pair_weight: Doubles2D,  # [pair in cell, 4]
    pair_mean: Doubles2D,  # [pair in cell, 4], weights of the mean gradients
    # cells
    gradient: Vectors2D,  # [cell, corner] [1/m]
    volume: Doubles,  # [cell] [m3]
    lame: Doubles2D,  # [1 or cell, 2]: lambda, mu [Pa]
    softened: Doubles,  # [1 or cell], part of lambda that uses M [Pa]
    offset: int,
    # out
    block_out: Matrices,  # [N/m]
):
    """Compute the stiffness block of each pair of nodes, for isotropic cells."""
    pair = wp.tid() + offset
    last = lame.shape[0] - 1
    first_sum = wp.mat33d()
    shear_sum = wp.mat33d()
    for i in range(pair_start[pair], pair_start[pair + 1]):
        cell, product = gradient_product(contribution[i], pair_corner, pair_weight, gradient)
        row = wp.min(cell, last)
        first_sum += (volume[cell] * lame[row, 0]) * product
        shear_sum += (volume[cell] * lame[row, 1]) * product
        less = softened[wp.min(cell, softened.shape[0] - 1)]
        if less > ZERO:
            _cell, mean = gradient_product(contribution[i], pair_corner, pair_mean, gradient)
            first_sum += (volume[cell] * less) * (mean - product)
    across = wp.trace(shear_sum)
    block = first_sum + wp.transpose(shear_sum) + wp.diag(wp.vec3d(across, across, across))
    write_pair(block, place[pair], mirror[pair], block_out)


@wp.func
def voigt(i: int, j: int):
    """Return the index of tensor component (i, j) in the order xx, yy, zz, yz, xz, xy."""
    # The pairs (1, 2), (0, 2) and (0, 1) add up to 3, 2 and 1.
    where = 6 - i - j
    if i == j:
        where = i
    return where


@wp.kernel
def pair_stiffness(
    # pairs of nodes
    pair_start: Int32s,
    contribution: Int32s,
    place: Int32s,
    mirror: Int32s,
    # pairs of shape functions
    pair_corner: Int32s2D,
    pair_weight: Doubles2D,
    pair_mean: Doubles2D,
    # cells
    gradient: Vectors2D,
    volume: Doubles,
    stiffness: Doubles3D,  # [1 or cell, 6, 6] [Pa]
    softened: Doubles,
    offset: int,
    # out
    block_out: Matrices,
):
    """Compute the stiffness block of each pair of nodes, for cells of any linear material."""
    pair = wp.tid() + offset
    last = stiffness.shape[0] - 1
    block = wp.mat33d()
    for n in range(pair_start[pair], pair_start[pair + 1]):
        cell, product = gradient_product(contribution[n], pair_corner, pair_weight, gradient)
        product = volume[cell] * product
        row = wp.min(cell, last)
        for i in range(3):
            for j in range(3):
                total = wp.float64(0.0)
                for p in range(3):
                    for q in range(3):
                        total += stiffness[row, voigt(i, p), voigt(j, q)] * product[p, q]
                block[i, j] = block[i, j] + total
        less = softened[wp.min(cell, softened.shape[0] - 1)]
        if less > ZERO:
            _cell, mean = gradient_product(contribution[n], pair_corner, pair_mean, gradient)
            block += less * (volume[cell] * mean - product)
    write_pair(block, place[pair], mirror[pair], block_out)
