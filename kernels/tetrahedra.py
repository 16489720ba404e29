"""Stiffness and stress of straight-sided tetrahedra.

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

The module also computes strain and stress in linear or quadratic tetrahedra, averaged over groups
of points.

At a point with the barycentric coordinates l, the displacement gradient is ``sum_A u_A (sum_c
(slope_Ac . l) g_c)^T``. The strain is the symmetric part of this gradient, and the stress is the
material stiffness D times the strain. A group is either the centre of one cell, or a set of points
at one node, with one point for each adjacent cell. In the average, the weight of a point is the
volume of the point's cell.
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
from kernels.constants import HALF, TWO, ZERO
from kernels.particle_stiffness import principal_values, von_mises

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
    along = wp.cross(v, w)
    six = wp.dot(u, along)
    first = along / six
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
    """Compute ``S / V`` for a pair of nodes in a cell. Return the cell's index and the matrix.

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


@wp.kernel
def group_stress(
    # groups
    group_start: Int32s,  # [group + 1]
    member: Int32s,  # cell x points per cell + point
    # places and shape functions
    place_at: wp.array(dtype=wp.vec4d),  # [point in a cell], barycentric coordinates
    slope: wp.array2d(dtype=wp.vec4d),  # [shape function, corner], barycentric derivative
    # cells
    cell_nodes: Int32s2D,  # [cell, shape function]
    gradient: Vectors2D,  # [cell, corner] [1/m]
    volume: Doubles,  # [cell] [m3]
    stiffness: Doubles3D,  # [1 or cell, 6, 6] [Pa], xx, yy, zz, yz, xz, xy
    displacement: Vectors,  # [node] [m]
    offset: int,
    # out
    strain_out: Doubles2D,  # [group, 6], tensor components
    stress_out: Doubles2D,  # [group, 6] [Pa]
    von_mises_out: Doubles,  # [group] [Pa]
    principal_out: Vectors,  # [group] [Pa], largest first
):
    """Compute the mean strain and stress of each group of points; 0 for an empty group."""
    group = wp.tid() + offset
    strain = wp.mat33d()
    voigt = wp.vector(length=6, dtype=wp.float64)
    total = wp.float64(0.0)
    for i in range(group_start[group], group_start[group + 1]):
        cell = member[i] / place_at.shape[0]
        at = place_at[member[i] - cell * place_at.shape[0]]
        moved = wp.mat33d()
        for a in range(slope.shape[0]):
            along = wp.vec3d()
            for c in range(4):
                along += wp.dot(slope[a, c], at) * gradient[cell, c]
            moved += wp.outer(displacement[cell_nodes[cell, a]], along)
        here = HALF * (moved + wp.transpose(moved))
        weight = volume[cell]
        row = wp.min(cell, stiffness.shape[0] - 1)
        for k in range(6):
            value = wp.float64(0.0)
            for j in range(3):
                value += stiffness[row, k, j] * here[j, j]
            value += TWO * (
                stiffness[row, k, 3] * here[1, 2]
                + stiffness[row, k, 4] * here[0, 2]
                + stiffness[row, k, 5] * here[0, 1]
            )
            voigt[k] = voigt[k] + weight * value
        strain += weight * here
        total += weight
    if total > ZERO:
        strain = strain / total
        voigt = voigt / total
    for k in range(6):
        stress_out[group, k] = voigt[k]
    for k in range(3):
        strain_out[group, k] = strain[k, k]
    strain_out[group, 3] = strain[1, 2]
    strain_out[group, 4] = strain[0, 2]
    strain_out[group, 5] = strain[0, 1]
    stress = wp.mat33d(
        voigt[0],
        voigt[5],
        voigt[4],
        voigt[5],
        voigt[1],
        voigt[3],
        voigt[4],
        voigt[3],
        voigt[2],
    )
    von_mises_out[group] = von_mises(stress)
    principal_out[group] = principal_values(stress)
