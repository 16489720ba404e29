"""Stiffness of straight-sided tetrahedra, linear and quadratic, summed by pairs of nodes.

The gradients g_c of the barycentric coordinates are constant in a cell, so for shape functions A
and B the exact integral of the products of their gradients is ``S = V sum_cd w_cd g_c g_d^T`` with
weights that depend on the pair alone, and the block of the stiffness is linear in it::

    K_AB[i, j] = sum_pq C[ip, jq] S[p, q]            any material
    K_AB = lambda S + mu S^T + mu tr(S) I            isotropic

A pair is summed over its cells in fixed order by one thread and written twice, once transposed: the
matrix equals its transpose bitwise, on any number of threads.
"""

import warp as wp

__all__ = ["cell_gradients", "pair_stiffness", "pair_stiffness_isotropic"]

wp.set_module_options({"enable_backward": False, "max_unroll": 1})


@wp.kernel
def cell_gradients(
    nodes: wp.array(dtype=wp.vec3d),  # [m]
    cell_nodes: wp.array2d(dtype=wp.int32),  # [cell, 4 or more], corners first
    offset: int,
    # out
    gradient_out: wp.array2d(dtype=wp.vec3d),  # [cell, corner] [1/m]
    volume_out: wp.array(dtype=wp.float64),  # [cell] [m3]
):
    """Compute gradients of the barycentric coordinates and the volume of each cell."""
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
    pair_corner: wp.array2d(dtype=wp.int32),
    pair_weight: wp.array2d(dtype=wp.float64),
    gradient: wp.array2d(dtype=wp.vec3d),
):
    """Compute S of a pair over the cell's volume, transposed where the pair is reversed."""
    entry = contribution
    if contribution < 0:
        entry = -contribution - 1  # its bitwise complement
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
    block_out: wp.array(dtype=wp.mat33d),
):
    """Write a pair's block and its transpose; on the diagonal the upper half is mirrored."""
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
    pair_start: wp.array(dtype=wp.int32),  # [pair + 1]
    # cell times pairs a cell plus pair; complement: reversed
    contribution: wp.array(dtype=wp.int32),
    place: wp.array(dtype=wp.int32),  # [pair], block written
    mirror: wp.array(dtype=wp.int32),  # [pair], block of the transpose
    # pairs of shape functions
    pair_corner: wp.array2d(dtype=wp.int32),  # [pair in cell, 4]: two corners of A, two of B
    pair_weight: wp.array2d(dtype=wp.float64),  # [pair in cell, 4]
    # cells
    gradient: wp.array2d(dtype=wp.vec3d),  # [cell, corner] [1/m]
    volume: wp.array(dtype=wp.float64),  # [cell] [m3]
    lame: wp.array2d(dtype=wp.float64),  # [1 or cell, 2]: lambda, mu [Pa]
    offset: int,
    # out
    block_out: wp.array(dtype=wp.mat33d),  # [N/m]
):
    """Compute the blocks of isotropic cells."""
    pair = wp.tid() + offset
    last = lame.shape[0] - 1
    first_sum = wp.mat33d()
    shear_sum = wp.mat33d()
    for i in range(pair_start[pair], pair_start[pair + 1]):
        cell, product = gradient_product(contribution[i], pair_corner, pair_weight, gradient)
        row = wp.min(cell, last)
        first_sum += (volume[cell] * lame[row, 0]) * product
        shear_sum += (volume[cell] * lame[row, 1]) * product
    across = wp.trace(shear_sum)
    block = first_sum + wp.transpose(shear_sum) + wp.diag(wp.vec3d(across, across, across))
    write_pair(block, place[pair], mirror[pair], block_out)


@wp.func
def voigt(i: int, j: int):
    """Return the place of a tensor component in the order xx, yy, zz, yz, xz, xy."""
    where = 6 - i - j
    if i == j:
        where = i
    return where


@wp.kernel
def pair_stiffness(
    # pairs of nodes
    pair_start: wp.array(dtype=wp.int32),
    contribution: wp.array(dtype=wp.int32),
    place: wp.array(dtype=wp.int32),
    mirror: wp.array(dtype=wp.int32),
    # pairs of shape functions
    pair_corner: wp.array2d(dtype=wp.int32),
    pair_weight: wp.array2d(dtype=wp.float64),
    # cells
    gradient: wp.array2d(dtype=wp.vec3d),
    volume: wp.array(dtype=wp.float64),
    stiffness: wp.array3d(dtype=wp.float64),  # [1 or cell, 6, 6] [Pa]
    offset: int,
    # out
    block_out: wp.array(dtype=wp.mat33d),
):
    """Compute the blocks of cells of any linear material."""
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
    write_pair(block, place[pair], mirror[pair], block_out)
