"""Energy, force and tangent stiffness of tetrahedra of any order under large deformation.

The deformation gradient at a quadrature point is ``F = sum x_a g_a^T``. Here ``g_a = sum_c
reference[q, a, c] grad L_c`` is the gradient of node a's shape function, and ``L_c`` are the
barycentric coordinates of the undeformed corners. With the first Piola-Kirchhoff stress ``P = d psi
/ dF``, the force is ``f_a = sum_q w P g_a``, where w is the volume that the quadrature point q
represents. The tangent stiffness is ``K_ab = d f_a / d x_b``. The module contains three laws for
the energy density psi:

linear          psi = mu e:e + (lambda/2) (tr e)^2,              e = sym(F) - I
corotational    psi = mu |F - R|^2 + (lambda/2) (tr S - 3)^2,    F = R S, R the rotation, S = S^T
neo-Hookean     psi = (mu/2) (|F|^2 - 3) - mu ln J + (lambda/2) (ln J)^2,   J = det F

The neo-Hookean law of this module does not separate the change of volume from the change of shape,
unlike that in ``kernels.tet_hyperelastic``. At small strain, the two neo-Hookean laws have the same
moduli as the linear law.

The corotational law is the linear law in the rotated frame. The tangent of the corotational law
includes the derivative of the rotation: ``(tr S I - S) w = axial(R^T dF - dF^T R)`` with ``R^T dR =
[w]x``. The neo-Hookean law follows Bonet and Wood 2008, Nonlinear Continuum Mechanics. All three
laws are equal in the limit of small strain. The energy of an inverted cell (J <= 0) is infinite,
except with the linear law.
"""

import warp as wp

from kernels.arrays import (
    Doubles,
    Doubles2D,
    Doubles3D,
    Int32s,
    Int32s2D,
    Matrices,
    Matrices2D,
    Vectors,
    Vectors2D,
)
from kernels.constants import HALF, THREE, TWO, ZERO
from kernels.tetrahedra import write_pair

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

LINEAR = wp.constant(0)
COROTATIONAL = wp.constant(1)
NEO_HOOKEAN = wp.constant(2)
POLAR_STEPS = wp.constant(30)
"""Largest number of Newton steps in `rotation_of`, which converges after about ten steps."""
IDENTITY = wp.constant(wp.mat33d(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0))


@wp.func
def rotation_of(f: wp.mat33d):
    """Compute the rotation R of the polar decomposition F = R S, for det F > 0.

    The method is Newton's method with scaled steps (Higham 1986).
    """
    x = f
    for _ in range(POLAR_STEPS):
        y = wp.transpose(wp.inverse(x))
        scale = wp.sqrt(wp.sqrt(wp.ddot(y, y) / wp.ddot(x, x)))
        new = HALF * (scale * x + y / scale)
        change = new - x
        x = new
        # rounding of double precision, 2e-16, squared
        if wp.ddot(change, change) < wp.float64(1.0e-31):
            break
    return x


@wp.func
def gradient_of(
    cell: int,
    q: int,
    a: int,
    reference: Doubles3D,
    corner: Vectors2D,
):
    """Compute the gradient [1/m] of the shape function of node ``a`` at quadrature point ``q``."""
    g = wp.vec3d()
    for c in range(4):
        g += reference[q, a, c] * corner[cell, c]
    return g


@wp.func
def deformation(
    cell: int,
    q: int,
    nodes: Int32s2D,
    reference: Doubles3D,
    corner: Vectors2D,
    displacement: Vectors,
):
    """Compute the deformation gradient of a cell at quadrature point ``q``."""
    f = wp.mat33d(IDENTITY)
    for a in range(nodes.shape[1]):
        f += wp.outer(displacement[nodes[cell, a]], gradient_of(cell, q, a, reference, corner))
    return f


@wp.kernel
def tet_force(
    # mesh
    nodes: Int32s2D,  # [cell, node of the cell]
    # [cell, corner], gradient of the barycentric coordinate [1/m]
    corner: Vectors2D,
    volume: Doubles,  # [cell] [m3]
    # finite element: derivatives of the shape functions by barycentric coordinates, volume
    # fractions
    reference: Doubles3D,  # [point, node of the cell, corner]
    share: Doubles,  # [point]
    # law
    law: int,
    lame: Doubles2D,  # [cell, 2]: lambda, mu [Pa]
    # state
    displacement: Vectors,  # [node] [m]
    offset: int,
    # out
    energy_out: Doubles,  # [cell] [J]
    force_out: Vectors2D,  # [cell, node of the cell], derivative of the energy [N]
):
    """Compute the energy of each cell, and the energy's derivative by node positions."""
    cell = wp.tid() + offset
    lam = lame[cell, 0]
    mu = lame[cell, 1]
    for a in range(nodes.shape[1]):
        force_out[cell, a] = wp.vec3d()
    energy = wp.float64(0.0)
    for q in range(share.shape[0]):
        f = deformation(cell, q, nodes, reference, corner, displacement)
        j = wp.determinant(f)
        weight = share[q] * volume[cell]
        stress = wp.mat33d()
        density = wp.float64(0.0)
        if law == LINEAR:
            strain = HALF * (f + wp.transpose(f)) - IDENTITY
            dilation = wp.trace(strain)
            density = mu * wp.ddot(strain, strain) + HALF * lam * dilation * dilation
            stress = TWO * mu * strain + lam * dilation * IDENTITY
        elif j <= ZERO:
            density = wp.float64(wp.INF)
        elif law == COROTATIONAL:
            r = rotation_of(f)
            dilation = wp.ddot(r, f) - THREE
            density = mu * wp.ddot(f - r, f - r) + HALF * lam * dilation * dilation
            stress = TWO * mu * (f - r) + lam * dilation * r
        else:
            log_j = wp.log(j)
            density = HALF * mu * (wp.ddot(f, f) - THREE) - mu * log_j + HALF * lam * log_j * log_j
            stress = mu * f + (lam * log_j - mu) * wp.transpose(wp.inverse(f))
        energy += weight * density
        for a in range(nodes.shape[1]):
            force_out[cell, a] = force_out[cell, a] + weight * (
                stress * gradient_of(cell, q, a, reference, corner)
            )
    energy_out[cell] = energy


@wp.kernel
def tet_stiffness(
    # pairs a <= b of a cell's nodes
    pair_first: Int32s,
    pair_second: Int32s,
    # mesh
    nodes: Int32s2D,
    corner: Vectors2D,
    volume: Doubles,
    # element
    reference: Doubles3D,
    share: Doubles,
    # law
    law: int,
    lame: Doubles2D,
    # state without inverted cells
    displacement: Vectors,
    offset: int,
    # out
    block_out: Matrices2D,  # [cell, pair] [N/m]
):
    """Compute the upper triangle of the blocks of each cell's tangent stiffness."""
    cell = wp.tid() + offset
    lam = lame[cell, 0]
    mu = lame[cell, 1]
    for pair in range(pair_first.shape[0]):
        block_out[cell, pair] = wp.mat33d()
    for q in range(share.shape[0]):
        f = deformation(cell, q, nodes, reference, corner, displacement)
        weight = share[q] * volume[cell]
        turn = wp.mat33d(IDENTITY)  # frame of the gradients: identity, R, or F^-T
        # The values below are for the linear law. The other laws replace the values that differ.
        spin = wp.mat33d()
        c_dot = mu
        c_ab = lam
        c_ba = mu
        c_spin = wp.float64(0.0)
        if law == COROTATIONAL:
            turn = rotation_of(f)
            stretch = wp.transpose(turn) * f
            stretch = HALF * (stretch + wp.transpose(stretch))
            spin = wp.inverse(wp.trace(stretch) * IDENTITY - stretch)
            spin = HALF * (spin + wp.transpose(spin))
            c_dot = TWO * mu
            c_ba = wp.float64(0.0)
            c_spin = TWO * mu - lam * (wp.trace(stretch) - THREE)
        elif law == NEO_HOOKEAN:
            turn = wp.transpose(wp.inverse(f))
            c_ba = mu - lam * wp.log(wp.determinant(f))
        for pair in range(pair_first.shape[0]):
            g_a = gradient_of(cell, q, pair_first[pair], reference, corner)
            g_b = gradient_of(cell, q, pair_second[pair], reference, corner)
            t_a = turn * g_a
            t_b = turn * g_b
            k_ab = (
                c_dot * wp.dot(g_a, g_b) * IDENTITY
                + c_ab * wp.outer(t_a, t_b)
                + c_ba * wp.outer(t_b, t_a)
            )
            if law == COROTATIONAL:
                k_ab += c_spin * (turn * (wp.skew(g_a) * spin * wp.skew(g_b)) * wp.transpose(turn))
            block_out[cell, pair] = block_out[cell, pair] + weight * k_ab


@wp.kernel
def gather_forces(
    start: Int32s,  # [node + 1]
    place: Int32s,  # flat index of each contribution in the cells' forces
    share: Vectors,
    offset: int,
    # out
    force_out: Vectors,  # [node] [N]
):
    """Sum the forces of the cells at each node, in a fixed order of the cells."""
    node = wp.tid() + offset
    total = wp.vec3d()
    for k in range(start[node], start[node + 1]):
        total += share[place[k]]
    force_out[node] = total


@wp.kernel
def gather_blocks(
    pair_start: Int32s,  # [pair of nodes + 1]
    contribution: Int32s,  # flat index in the blocks; complement: transposed
    place: Int32s,  # [pair of nodes], index of the block
    mirror: Int32s,  # [pair of nodes], index of the transposed block
    share: Matrices,
    offset: int,
    # out
    block_out: Matrices,  # [N/m]
):
    """Sum the stiffness of the cells for each pair of nodes, and write the sum and its transpose.

    The matrix is therefore symmetric to the last bit.
    """
    pair = wp.tid() + offset
    total = wp.mat33d()
    for k in range(pair_start[pair], pair_start[pair + 1]):
        entry = contribution[k]
        if entry < 0:
            total += wp.transpose(share[-entry - 1])
        else:
            total += share[entry]
    write_pair(total, place[pair], mirror[pair], block_out)
