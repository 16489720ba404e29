"""Stiffness of grid cells, summed over their material particles, and stress at points in cells.

A material particle is an integration point with a volume. Its weight w is its remaining volume, and
lambda and mu are its Lame constants. The gradient of corner a's shape function at the particle is
g_a. ``w B^T D B`` has the blocks::

    K_ab = w [lambda g_a g_b^T + mu g_b g_a^T + mu (g_a . g_b) I]

In a cell that is cut or holds few particles, some deformation modes have no energy (unresolved
modes). With a single particle, for example, the stiffness has a rank of 6 instead of 18. A fraction
s of a stabilising energy is therefore added. The stabilising energy is that of a full cell with the
mean shear modulus, in the modes whose gradient varies inside the cell. Its stiffness matrix for
Lame constants of 1 is ``inner``. For linear displacement fields, the stabilising energy is zero, so
the patch test is still exact::

    K_ab += s (sum w mu / h^3) inner_ab,   s = strength (1 - min(1, min_i 12 sum w (x_i - 1/2)^2 / h^3))

The sums are over the particles of the cell, h is the cell's edge length, and x_i is a particle's
coordinate from 0 to 1. The ratio s / strength is 0 if the particles have the second moment of a
full cell, as particles at Gauss points have. For a single particle in the middle, the ratio is 1.
The method is hourglass control (Flanagan and Belytschko 1981, Int. J. Numer. Methods Eng. 17:679),
scaled by this ratio.

Springs between points x of the cell and the ground add ``sum N_a(x) N_b(x) S`` to K_ab. S is the 3
x 3 stiffness of a spring, and N_a is the shape function of corner a.

The module also computes the stress ``sigma = lambda tr(e) I + 2 mu e`` at points of the cells. The
displacement gradient is ``grad u = sum u_a g_a^T``, and the strain is ``e = sym grad u``."""  # noqa: E501 a table

import warp as wp

from kernels.arrays import (
    Doubles,
    Doubles2D,
    Int32s,
    Int32s2D,
    Matrices,
    Matrices2D,
    Shorts,
    Vectors,
)
from kernels.constants import HALF, ONE, TWO, ZERO
from kernels.hexahedra import BLOCKS, block_of, corner_gradients

FULL_STEPS = wp.float64(65535.0)
"""Stored value of the remaining volume of a particle that has lost no material."""


@wp.kernel
def particle_stiffness(
    # particles, sorted by cell
    place: Vectors,  # position in the cell, 0 to 1 along each edge
    volume: Doubles,  # [m3]
    lame: Doubles2D,  # [particle, 2]: lambda, mu [Pa]
    remaining: Shorts,  # steps of 1/65535
    # cells
    cell_start: Int32s,  # [cell + 1], first particle of each cell
    changed: Int32s,  # cells to recompute
    edge: wp.float64,  # [m]
    strength: wp.float64,
    # [block] [m], stiffness of a full cell with Lame constants of 1, minus the stiffness integrated
    # with one point at the centre
    inner: Matrices,
    spring_row: Int32s,  # [cell], its row in the next array, or -1
    spring: Matrices2D,  # [row, block] [N/m], contribution of springs to the ground
    offset: int,
    # out
    stiffness_out: Matrices2D,  # [cell, block] [N/m]
    fill_out: Doubles,  # [cell], volume of its particles / volume of the cell
):
    """Compute the stiffness of the changed cells as a sum over their material particles.

    Only the upper triangle of the block matrix (3 x 3 blocks) is computed. The blocks on the
    diagonal are made exactly symmetric.
    """
    cell = changed[wp.tid() + offset]
    for block in range(BLOCKS):
        stiffness_out[cell, block] = wp.mat33d()
    fill = wp.float64(0.0)
    shear = wp.float64(0.0)
    moment = wp.vec3d()
    for p in range(cell_start[cell], cell_start[cell + 1]):
        weight = volume[p] * wp.float64(remaining[p]) / FULL_STEPS
        if weight > ZERO:
            at = place[p]
            gradients = corner_gradients(at, ONE / edge)
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
                        + wp.mat33d(s, ZERO, ZERO, ZERO, s, ZERO, ZERO, ZERO, s)
                    )
                    stiffness_out[cell, block] = stiffness_out[cell, block] + k_ab
                    block += 1
            fill += weight
            shear += w_mu
            middle = at - wp.vec3d(HALF, HALF, HALF)
            moment += weight * wp.cw_mul(middle, middle)
    volume_of_cell = edge * edge * edge
    fill_out[cell] = fill / volume_of_cell
    seen = wp.float64(12.0) * wp.min(moment) / volume_of_cell
    missing = strength * wp.max(ONE - seen, ZERO) * shear / volume_of_cell
    for block in range(BLOCKS):
        stiffness_out[cell, block] = stiffness_out[cell, block] + missing * inner[block]
    row = spring_row[cell]
    if row >= 0:
        for block in range(BLOCKS):
            stiffness_out[cell, block] = stiffness_out[cell, block] + spring[row, block]
    # Sums of symmetric terms are symmetric only up to rounding. Mirror them for exact symmetry.
    for a in range(8):
        diagonal = stiffness_out[cell, block_of(a, a)]
        diagonal[1, 0] = diagonal[0, 1]
        diagonal[2, 0] = diagonal[0, 2]
        diagonal[2, 1] = diagonal[1, 2]
        stiffness_out[cell, block_of(a, a)] = diagonal


@wp.kernel
def point_stress(
    # points
    cell_of: Int32s,
    place: Vectors,  # position in the cell, 0 to 1 along each edge
    lame: Doubles2D,  # [row, 2]: lambda, mu [Pa]
    # cells
    cell_nodes: Int32s2D,
    displacement: Vectors,  # [node] [m]
    edge: wp.float64,  # [m]
    offset: int,
    # out
    stress_out: Doubles2D,  # [point, 6] [Pa]: xx, yy, zz, yz, xz, xy
):
    """Compute the stress tensor [Pa] at each point from the displacements of the nodes."""
    row = wp.tid() + offset
    cell = cell_of[row]
    gradients = corner_gradients(place[row], ONE / edge)
    gradient = wp.mat33d()
    for a in range(8):
        gradient += wp.outer(
            displacement[cell_nodes[cell, a]],
            wp.vec3d(gradients[a, 0], gradients[a, 1], gradients[a, 2]),
        )
    strain = HALF * (gradient + wp.transpose(gradient))
    pressure = lame[row, 0] * wp.trace(strain)
    stress = TWO * lame[row, 1] * strain + wp.diag(wp.vec3d(pressure, pressure, pressure))
    for k in range(3):
        stress_out[row, k] = stress[k, k]
    stress_out[row, 3] = stress[1, 2]
    stress_out[row, 4] = stress[0, 2]
    stress_out[row, 5] = stress[0, 1]
