"""Stiffness of the cells of a grid, summed over the material particles they hold.

For an isotropic particle of weight w (the volume left of it) with Lame constants lambda and mu, and
g_a the gradient of corner a's shape function at the particle, ``w B^T D B`` has the blocks::

    K_ab = w [lambda g_a g_b^T + mu g_b g_a^T + mu (g_a . g_b) I]

A cell that is cut, or holds few particles, does not see the modes that vary inside it (a single
particle gives rank 6 of the 18 that it needs). A part s of an energy is added to it: the energy
that a full cell of its mean shear modulus has in these modes alone (``inner``, which is zero for
every linear field, so that the patch test stays exact)::

    K_ab += s (sum w mu / h^3) inner_ab,   s = strength (1 - min(1, min_i 12 sum w (x_i - 1/2)^2 / h^3))

The bracket is the share of the second moment of a full cell that the particles lack: 0 for Gauss
points, 1 for a single particle in the middle. The idea is hourglass control (Flanagan and
Belytschko 1981, Int. J. Numer. Methods Eng. 17:679), scaled by the share that the particles lack.

Springs to the ground at points x of the cell, of 3 x 3 stiffness S, add ``sum N_a(x) N_b(x) S``.
"""  # noqa: E501 a table

import warp as wp

from kernels.hexahedra import block_of, corner_gradients

__all__ = ["particle_stiffness"]

wp.set_module_options({"enable_backward": False})

FULL_STEPS = wp.constant(wp.float64(65535.0))


@wp.kernel
def particle_stiffness(
    # particles, sorted by cell
    place: wp.array(dtype=wp.vec3d),  # place in the cell, 0 to 1 along each edge
    volume: wp.array(dtype=wp.float64),  # [m3]
    lame: wp.array2d(dtype=wp.float64),  # [particle, 2]: lambda, mu [Pa]
    remaining: wp.array(dtype=wp.uint16),  # steps of 1/65535
    # cells
    cell_start: wp.array(dtype=wp.int32),  # [cell + 1], first particle of each cell
    changed: wp.array(dtype=wp.int32),  # cells to sum again
    edge: wp.float64,  # [m]
    strength: wp.float64,
    # [block] [m], full cell of unit Lame constants less its value at the centre
    inner: wp.array(dtype=wp.mat33d),
    spring_row: wp.array(dtype=wp.int32),  # [cell], its row in the next array, or -1
    spring: wp.array2d(
        dtype=wp.mat33d
    ),  # [row, block] [N/m], contribution of springs to the ground
    offset: int,
    # out
    stiffness_out: wp.array2d(dtype=wp.mat33d),  # [cell, block] [N/m]
    fill_out: wp.array(dtype=wp.float64),  # [cell], volume of its particles over its own
):
    """Sum the stiffness of the changed cells over their particles.

    The upper triangle is summed first and then mirrored.
    """
    cell = changed[wp.tid() + offset]
    for block in range(36):
        stiffness_out[cell, block] = wp.mat33d()
    fill = wp.float64(0.0)
    shear = wp.float64(0.0)
    moment = wp.vec3d()
    for p in range(cell_start[cell], cell_start[cell + 1]):
        weight = volume[p] * wp.float64(remaining[p]) / FULL_STEPS
        if weight > wp.float64(0.0):
            at = place[p]
            gradients = corner_gradients(at, wp.float64(1.0) / edge)
            w_lambda = weight * lame[p, 0]
            w_mu = weight * lame[p, 1]
            block = int(0)
            for a in range(8):
                g_a = wp.vec3d(gradients[a, 0], gradients[a, 1], gradients[a, 2])
                for b in range(a, 8):
                    g_b = wp.vec3d(gradients[b, 0], gradients[b, 1], gradients[b, 2])
                    s = w_mu * wp.dot(g_a, g_b)
                    k_ab = (
                        w_lambda * wp.outer(g_a, g_b)
                        + w_mu * wp.outer(g_b, g_a)
                        + wp.mat33d(
                            s,
                            wp.float64(0.0),
                            wp.float64(0.0),
                            wp.float64(0.0),
                            s,
                            wp.float64(0.0),
                            wp.float64(0.0),
                            wp.float64(0.0),
                            s,
                        )
                    )
                    stiffness_out[cell, block] = stiffness_out[cell, block] + k_ab
                    block += 1
            fill += weight
            shear += w_mu
            middle = at - wp.vec3d(wp.float64(0.5), wp.float64(0.5), wp.float64(0.5))
            moment += weight * wp.cw_mul(middle, middle)
    volume_of_cell = edge * edge * edge
    fill_out[cell] = fill / volume_of_cell
    seen = wp.float64(12.0) * wp.min(moment) / volume_of_cell
    missing = strength * wp.max(wp.float64(1.0) - seen, wp.float64(0.0)) * shear / volume_of_cell
    for block in range(36):
        stiffness_out[cell, block] = stiffness_out[cell, block] + missing * inner[block]
    row = spring_row[cell]
    if row >= 0:
        for block in range(36):
            stiffness_out[cell, block] = stiffness_out[cell, block] + spring[row, block]
    for a in range(8):
        diagonal = stiffness_out[cell, block_of(a, a)]
        diagonal[1, 0] = diagonal[0, 1]
        diagonal[2, 0] = diagonal[0, 2]
        diagonal[2, 1] = diagonal[1, 2]
        stiffness_out[cell, block_of(a, a)] = diagonal
