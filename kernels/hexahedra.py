"""Trilinear hexahedra of a Cartesian grid: shape functions, the packed cell stiffness, and its product with a vector.

Corner ``a = 4 i + 2 j + k`` of a cell lies at ``(i, j, k)`` of its edges. A cell's stiffness, 24 x 24 and symmetric, is
kept as the ``BLOCKS`` 3 x 3 blocks (a, b) with a <= b, row after row; the others are their transposes, so that the
matrix equals its transpose bit by bit. The product runs over cells without an assembled matrix: every cell writes its
own corner forces, then every node gathers those of its up to eight cells in fixed order. No atomics, and the same bits
on any number of threads.
"""

import warp as wp

__all__ = ["BLOCKS", "CornerGradients", "block_of", "cell_block", "cell_products", "corner_gradients", "gather_cells"]

wp.set_module_options({"enable_backward": False})

BLOCKS = 36
"""Blocks kept of a cell's 8 x 8."""
CornerGradients = wp.types.matrix(shape=(8, 3), dtype=wp.float64)


@wp.func
def block_of(a: int, b: int):
    """Place of the block of corners a <= b."""
    return a * 8 - (a * (a - 1)) / 2 + b - a


@wp.func
def cell_block(stiffness: wp.array2d(dtype=wp.mat33d), cell: int, a: int, b: int):
    """Stiffness block [N/m] of corners a and b of a cell."""
    if a <= b:
        return stiffness[cell, block_of(a, b)]
    return wp.transpose(stiffness[cell, block_of(b, a)])


@wp.func
def corner_gradients(at: wp.vec3d, inverse_edge: wp.float64):
    """Gradients [1/m] of the eight shape functions at a place in the cell, 0 to 1 along each edge."""
    one = wp.float64(1.0)
    gradients = CornerGradients()
    for a in range(8):
        x = at[0]
        y = at[1]
        z = at[2]
        sx = one
        sy = one
        sz = one
        if (a & 4) == 0:
            x = one - x
            sx = -one
        if (a & 2) == 0:
            y = one - y
            sy = -one
        if (a & 1) == 0:
            z = one - z
            sz = -one
        gradients[a, 0] = sx * y * z * inverse_edge
        gradients[a, 1] = x * sy * z * inverse_edge
        gradients[a, 2] = x * y * sz * inverse_edge
    return gradients


@wp.kernel
def cell_products(
    # cells
    cell_nodes: wp.array2d(dtype=wp.int32),  # [cell, corner]
    live: wp.array(dtype=wp.uint8),  # [cell], 0 where a cell carries nothing
    stiffness: wp.array2d(dtype=wp.mat33d),  # [cell, block] [N/m]
    displacement: wp.array(dtype=wp.vec3d),  # [node] [m]
    offset: int,
    # out
    corner_force_out: wp.array2d(dtype=wp.vec3d),  # [cell, corner] [N]
):
    """Corner forces ``f_a = sum_b K_ab u_b`` of each cell."""
    cell = wp.tid() + offset
    for a in range(8):
        corner_force_out[cell, a] = wp.vec3d()
    if live[cell] == wp.uint8(0):
        return
    block = int(0)
    for a in range(8):
        u_a = displacement[cell_nodes[cell, a]]
        force = corner_force_out[cell, a] + stiffness[cell, block] * u_a
        block += 1
        for b in range(a + 1, 8):
            k_ab = stiffness[cell, block]
            force += k_ab * displacement[cell_nodes[cell, b]]
            corner_force_out[cell, b] = corner_force_out[cell, b] + u_a * k_ab
            block += 1
        corner_force_out[cell, a] = force


@wp.kernel
def gather_cells(
    # nodes
    node_cells: wp.array2d(dtype=wp.int32),  # [node, corner]: the cell of which the node is that corner, or -1
    corner_force: wp.array2d(dtype=wp.vec3d),  # [cell, corner] [N]
    offset: int,
    # out
    force_out: wp.array(dtype=wp.vec3d),  # [node] [N]
):
    """Force at each node: the sum over its cells, in the order of their corners."""
    node = wp.tid() + offset
    force = wp.vec3d()
    for a in range(8):
        cell = node_cells[node, a]
        if cell >= 0:
            force += corner_force[cell, a]
    force_out[node] = force
