"""Transfer between a grid and a grid of twice its edge length.

Cell stiffness and residuals go up to the coarse grid, corrections go down to the fine grid.

A coarse cell's trilinear functions are trilinear on each of its eight children, so its stiffness is
exactly the sum of its children's through the interpolation P: ``K = sum P_c^T M K_c M P_c`` with M
the mask of the components that may move. The coarse operator is the fine one's Galerkin projection,
and one changed cell changes one coarse cell.
"""

import warp as wp

from kernels.hexahedra import block_of, carries, cell_block

__all__ = ["coarse_stiffness", "interpolate", "restrict"]

# nested loops over corners, compiled once
wp.set_module_options({"enable_backward": False, "max_unroll": 1})


@wp.func
def share(child: int, a: int, parent: int):
    """Return the weight of a parent cell's corner in corner a of its child."""
    weight = wp.float64(1.0)
    for axis in range(3):
        at = ((child >> axis) & 1) + ((a >> axis) & 1)  # 0, 1, 2 half edges along the parent
        if ((parent >> axis) & 1) == 0:
            at = 2 - at
        weight = weight * wp.float64(0.5) * wp.float64(at)
    return weight


@wp.kernel
def coarse_stiffness(
    # fine
    cell_nodes: wp.array2d(dtype=wp.int32),  # [cell, corner]
    live: wp.array(dtype=wp.uint8),  # [cell]
    stiffness: wp.array2d(dtype=wp.mat33d),  # [cell, block]
    free: wp.array(dtype=wp.vec3d),  # [node]
    # coarse
    children: wp.array2d(dtype=wp.int32),  # [coarse cell, child] or -1
    changed: wp.array(dtype=wp.int32),  # coarse cells to sum again
    offset: int,
    # out
    stiffness_out: wp.array2d(dtype=wp.mat33d),  # [coarse cell, block]
    live_out: wp.array(dtype=wp.uint8),
):
    """Compute the stiffness of the changed coarse cells from their children."""
    coarse = changed[wp.tid() + offset]
    for block in range(36):
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
                        if share_a != wp.float64(0.0):
                            for parent_b in range(parent_a, 8):
                                weight = share_a * share(child, b, parent_b)
                                if weight != wp.float64(0.0):
                                    block = block_of(parent_a, parent_b)
                                    stiffness_out[coarse, block] = (
                                        stiffness_out[coarse, block] + weight * part
                                    )
    live_out[coarse] = any_live


@wp.kernel
def restrict(
    # [coarse node, 27], fine node at 9 (dx+1) + 3 (dy+1) + dz+1, or -1
    fine_of: wp.array2d(dtype=wp.int32),
    free: wp.array(dtype=wp.vec3f),  # [fine node]
    residual: wp.array(dtype=wp.vec3f),  # [fine node]
    offset: int,
    # out
    load_out: wp.array(dtype=wp.vec3f),  # [coarse node]
):
    """Compute the load of the coarse grid: the residual through the transposed interpolation."""
    coarse = wp.tid() + offset
    total = wp.vec3f()
    for slot in range(27):
        fine = fine_of[coarse, slot]
        if fine >= 0:
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
    coarse_of: wp.array2d(dtype=wp.int32),  # [fine node, 8], coarse node or -1
    weight: wp.array(dtype=wp.float32),  # [fine node], the same for each of its coarse nodes
    free: wp.array(dtype=wp.vec3f),  # [fine node]
    correction: wp.array(dtype=wp.vec3f),  # [coarse node]
    offset: int,
    # out
    vector_out: wp.array(dtype=wp.vec3f),  # [fine node], corrected in place
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
