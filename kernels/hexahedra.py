"""Trilinear hexahedra of a Cartesian grid.

The module contains gradients of shape functions, the packed cell stiffness, and the product of this
stiffness and a vector.

Corner ``a = 4 i + 2 j + k`` of a cell has the position ``(i, j, k)`` in units of the edge length. A
cell's stiffness is a symmetric matrix of 24 x 24. Its ``BLOCKS`` blocks (a, b) of 3 x 3 with a <= b
are stored row after row. The blocks with a > b are transposes of stored blocks, so the matrix is
symmetric to the last bit. To multiply the stiffness of a grid by a vector, no matrix is assembled.
First, the forces at the corners of each cell are computed. Then, for every node, the forces from
its cells (at most eight) are summed in fixed order. There are no atomic operations, and the result
has the same bits on any number of threads.
"""

import warp as wp

from kernels.arrays import Bytes, Int32s, Int32s2D, Matrices2D, Vectors, Vectors2D
from kernels.constants import ONE

BLOCKS = 36
"""Number of stored 3 x 3 blocks of a cell's stiffness: the upper triangle of 8 x 8 blocks."""
CornerGradients = wp.types.matrix(shape=(8, 3), dtype=wp.float64)


@wp.func
def block_of(a: int, b: int):
    """Return the index of the stored stiffness block of corners a and b, for a <= b."""
    return a * 8 - (a * (a - 1)) / 2 + b - a


@wp.func
def carries(live: Bytes, cell: int):
    """Return whether a cell exists and carries load. The index -1 means that there is no cell."""
    if cell < 0:
        return False
    return live[cell] != wp.uint8(0)


@wp.func
def cell_block(stiffness: Matrices2D, cell: int, a: int, b: int):
    """Return the stiffness block [N/m] of corners a and b of a cell."""
    if a <= b:
        return stiffness[cell, block_of(a, b)]
    return wp.transpose(stiffness[cell, block_of(b, a)])


@wp.func
def corner_gradients(at: wp.vec3d, inverse_edge: wp.float64):
    """Compute the gradients [1/m] of the eight shape functions at a position in the cell.

    Each coordinate of the position ranges from 0 to 1 across the cell.
    """
    gradients = CornerGradients()
    for a in range(8):
        x = at[0]
        y = at[1]
        z = at[2]
        sx = ONE
        sy = ONE
        sz = ONE
        if (a & 4) == 0:
            x = ONE - x
            sx = -ONE
        if (a & 2) == 0:
            y = ONE - y
            sy = -ONE
        if (a & 1) == 0:
            z = ONE - z
            sz = -ONE
        gradients[a, 0] = sx * y * z * inverse_edge
        gradients[a, 1] = x * sy * z * inverse_edge
        gradients[a, 2] = x * y * sz * inverse_edge
    return gradients


@wp.kernel
def cell_products(
    # cells
    cells: Int32s,  # cells to multiply
    row: Int32s,  # row of each cell in the stiffness
    cell_nodes: Int32s2D,  # [cell, corner]
    live: Bytes,  # [cell], 0 if the cell carries no load
    stiffness: Matrices2D,  # [row, block] [N/m]
    displacement: Vectors,  # [node] [m]
    offset: int,
    # out
    corner_force_out: Vectors2D,  # [place in cells, corner] [N]
):
    """Compute the forces ``f_a = sum_b K_ab u_b`` at the corners of each cell."""
    i = wp.tid() + offset
    cell = cells[i]
    at = row[i]
    for a in range(8):
        corner_force_out[i, a] = wp.vec3d()
    if live[cell] == wp.uint8(0):
        return
    block = int(0)
    for a in range(8):
        u_a = displacement[cell_nodes[cell, a]]
        force = corner_force_out[i, a] + stiffness[at, block] * u_a
        block += 1
        for b in range(a + 1, 8):
            k_ab = stiffness[at, block]
            force += k_ab * displacement[cell_nodes[cell, b]]
            corner_force_out[i, b] = corner_force_out[i, b] + u_a * k_ab
            block += 1
        corner_force_out[i, a] = force


@wp.kernel
def gather_cells(
    # nodes
    nodes: Int32s,  # nodes of the cells
    # [index in nodes, corner]: index of the cell in which the node is this corner
    node_cells: Int32s2D,
    corner_force: Vectors2D,  # [place in the cells, corner] [N]
    offset: int,
    # out
    force_out: Vectors,  # [node] [N], the forces are added
):
    """Add the corner forces of adjacent cells to the force at each node, in a fixed order."""
    i = wp.tid() + offset
    force = force_out[nodes[i]]
    for a in range(8):
        cell = node_cells[i, a]
        if cell >= 0:
            force += corner_force[cell, a]
    force_out[nodes[i]] = force
