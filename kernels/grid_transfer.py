"""Transfer between a fine grid and a coarse grid, and Gauss-Seidel smoothing, for multigrid.

The cells of the coarse grid have twice the edge length. Cell stiffness and residuals are
transferred to the coarse grid, and corrections are transferred to the fine grid.

The trilinear shape functions of a coarse cell are trilinear on each of its eight children (fine
cells). The stiffness of the coarse cell is therefore exactly ``K = sum P_c^T M K_c M P_c``. Here,
K_c is the stiffness of a child, P_c the interpolation to the child, and M the mask of the
components that may move. The coarse operator is the Galerkin projection of the fine operator. A
change of one fine cell changes one coarse cell.

For smoothing, the stiffness of a grid is assembled row by row, one row for each node.

The kernels assemble rows of 3 x 3 blocks, multiply the rows by a vector, and run Gauss-Seidel
sweeps. In a sweep, the nodes are updated colour by colour, with eight colours.

A row holds one block for the node itself and one block for each neighbour, at most 27 blocks. The
blocks are in this order: neighbours of lower colour, the node itself, neighbours of higher colour.
This order splits K into L + D + U: the blocks before the node's own block, this block, and the
blocks after it. The first sweep starts at zero and solves ``(L + D) v = f``. The residual after
this sweep is ``f - K v = -U v``. Both v and the residual are thus computed while K is read once.
Sums have a fixed order, and nodes that change at the same time have one colour, so they are not
neighbours. The result is therefore the same to the last bit on any number of threads.
"""

import warp as wp

from kernels.arrays import (
    Bytes,
    Int32s,
    Int32s2D,
    Matrices,
    Matrices2D,
    SingleMatrices,
    Singles,
    SingleVectors,
    Vectors,
)
from kernels.constants import HALF, ONE, ZERO
from kernels.hexahedra import BLOCKS, block_of, carries, cell_block

# nested loops over corners, compiled once
wp.set_module_options({"max_unroll": 1})


@wp.func
def share(child: int, a: int, parent: int):
    """Return the weight of the coarse corner ``parent`` at corner ``a`` of the child cell."""
    weight = wp.float64(1.0)
    for axis in range(3):
        at = ((child >> axis) & 1) + ((a >> axis) & 1)  # in half edges of the parent: 0, 1, 2
        if ((parent >> axis) & 1) == 0:
            at = 2 - at
        weight = weight * HALF * wp.float64(at)
    return weight


@wp.kernel
def coarse_stiffness(
    # fine
    cell_nodes: Int32s2D,  # [cell, corner]
    live: Bytes,  # [cell]
    stiffness: Matrices2D,  # [cell, block]
    free: Vectors,  # [node]
    # coarse
    children: Int32s2D,  # [coarse cell, child] or -1
    changed: Int32s,  # coarse cells to recompute
    offset: int,
    # out
    stiffness_out: Matrices2D,  # [coarse cell, block]
    live_out: Bytes,
):
    """Compute the stiffness of changed coarse cells from the fine cells that they contain."""
    coarse = changed[wp.tid() + offset]
    for block in range(BLOCKS):
        stiffness_out[coarse, block] = wp.mat33d()
    any_live = wp.uint8(0)
    for child in range(8):
        cell = children[coarse, child]
        if carries(live, cell):
            any_live = wp.uint8(1)
            for a in range(8):
                free_a = free[cell_nodes[cell, a]]
                for b in range(8):
                    part = wp.cw_mul(
                        wp.outer(free_a, free[cell_nodes[cell, b]]),
                        cell_block(stiffness, cell, a, b),
                    )
                    for parent_a in range(8):
                        share_a = share(child, a, parent_a)
                        if share_a != ZERO:
                            for parent_b in range(parent_a, 8):
                                weight = share_a * share(child, b, parent_b)
                                if weight != ZERO:
                                    block = block_of(parent_a, parent_b)
                                    stiffness_out[coarse, block] = (
                                        stiffness_out[coarse, block] + weight * part
                                    )
    live_out[coarse] = any_live


@wp.kernel
def restrict(
    # [coarse node, 27], fine node at 9 (dx+1) + 3 (dy+1) + dz+1, or -1
    fine_of: Int32s2D,
    free: SingleVectors,  # [fine node]
    residual: SingleVectors,  # [fine node]
    offset: int,
    # out
    load_out: SingleVectors,  # [coarse node]
):
    """Compute the load of the coarse grid by transposed interpolation of the fine residual."""
    coarse = wp.tid() + offset
    total = wp.vec3f()
    for slot in range(27):
        fine = fine_of[coarse, slot]
        if fine >= 0:
            # If the fine node lies halfway between two coarse nodes along an axis, each coarse node
            # has half of its weight.
            weight = float(1.0)
            if slot / 9 != 1:
                weight = weight * 0.5
            if (slot / 3) % 3 != 1:
                weight = weight * 0.5
            if slot % 3 != 1:
                weight = weight * 0.5
            total += weight * wp.cw_mul(free[fine], residual[fine])
    load_out[coarse] = total


@wp.kernel
def interpolate(
    coarse_of: Int32s2D,  # [fine node, 8], coarse node or -1
    weight: Singles,  # [fine node], the same for all its coarse nodes
    free: SingleVectors,  # [fine node]
    correction: SingleVectors,  # [coarse node]
    offset: int,
    # out
    vector_out: SingleVectors,  # [fine node], corrected in place
):
    """Add the coarse grid's correction to the nodes of the fine grid that may move.

    The correction is trilinear between the coarse nodes.
    """
    fine = wp.tid() + offset
    total = wp.vec3f()
    for slot in range(8):
        coarse = coarse_of[fine, slot]
        if coarse >= 0:
            total += correction[coarse]
    vector_out[fine] = vector_out[fine] + weight[fine] * wp.cw_mul(free[fine], total)


# nested loops over corners, compiled once
@wp.kernel
def assemble_rows(
    # nodes
    rows: Int32s,  # nodes whose rows are assembled again
    row_start: Int32s,  # [node + 1], first block of each row
    node_cells: Int32s2D,  # [node, corner]
    # [node, 27]: block of the neighbour at 9 (dx+1) + 3 (dy+1) + dz+1
    neighbour_block: Int32s2D,
    free: Vectors,  # [node], 1 where a component may move, 0 where it is held
    # cells
    cell_nodes: Int32s2D,
    live: Bytes,  # [cell]
    stiffness: Matrices2D,  # [cell, block] [N/m]
    offset: int,
    # out
    block_out: Matrices,  # [block] [N/m]
    single_out: SingleMatrices,  # [block], the same in single precision, for the preconditioner
    inverse_out: SingleMatrices,  # [node] [m/N], inverse of the node's own block
):
    """Assemble rows of the stiffness ``M K M``. The mask M selects components that may move.

    Components that may not move (held components) have zero stiffness. The kernel also computes the
    inverse of each node's own block. In this inverse, the diagonal is 1 for held components. At a
    free node without stiffness, the inverse is zero. Before the inversion, a small multiple of the
    block's trace is added to the diagonal, so that blocks next to empty cells can be inverted.
    """
    node = rows[wp.tid() + offset]
    for place in range(row_start[node], row_start[node + 1]):
        block_out[place] = wp.mat33d()
    free_here = free[node]
    for a in range(8):
        cell = node_cells[node, a]
        if carries(live, cell):
            for b in range(8):
                step = (
                    9 * ((b >> 2) - (a >> 2))
                    + 3 * (((b >> 1) & 1) - ((a >> 1) & 1))
                    + (b & 1)
                    - (a & 1)
                    + 13
                )
                mask = wp.outer(free_here, free[cell_nodes[cell, b]])
                place = neighbour_block[node, step]
                block_out[place] = block_out[place] + wp.cw_mul(
                    mask, cell_block(stiffness, cell, a, b)
                )
    for place in range(row_start[node], row_start[node + 1]):
        single_out[place] = wp.mat33f(block_out[place])
    centre = neighbour_block[node, 13]
    block = block_out[centre] + wp.diag(wp.vec3d(ONE, ONE, ONE) - free_here)
    size = wp.trace(block)
    inverse = wp.mat33d()
    if size > ZERO:
        # Less than the rounding error of single precision, 6e-8, in which the inverse is used.
        tiny = wp.float64(1e-9) * size
        inverse = wp.inverse(block + wp.diag(wp.vec3d(tiny, tiny, tiny)))
    inverse_out[node] = wp.mat33f(inverse)


@wp.kernel
def first_residuals(
    row_start: Int32s,
    # [node], the node's own block; blocks of lower colours come before it, of higher colours after
    # it
    diagonal_block: Int32s,
    column: Int32s,
    block: SingleMatrices,
    vector: SingleVectors,  # [node]
    offset: int,
    # out
    residual_out: SingleVectors,  # [node]
):
    """Compute the residual after the first Gauss-Seidel sweep from a zero initial vector.

    The residual at a node is not zero, because nodes with a higher colour index are updated later.
    """
    node = wp.tid() + offset
    total = wp.vec3f()
    for place in range(diagonal_block[node] + 1, row_start[node + 1]):
        total -= block[place] * vector[column[place]]
    residual_out[node] = total


@wp.kernel
def sweep_colour(
    nodes: Int32s,  # nodes of one colour
    row_start: Int32s,
    column: Int32s,
    block: SingleMatrices,
    inverse: SingleMatrices,  # [node], inverse of the node's own block
    load: SingleVectors,
    offset: int,
    # out
    vector_out: SingleVectors,  # [node], corrected in place
):
    """Run the part of a Gauss-Seidel sweep that updates the nodes of one colour.

    Each of these nodes is displaced such that the three equations of the node are satisfied.
    """
    node = nodes[wp.tid() + offset]
    left = load[node]
    for place in range(row_start[node], row_start[node + 1]):
        left -= block[place] * vector_out[column[place]]
    vector_out[node] = vector_out[node] + inverse[node] * left
