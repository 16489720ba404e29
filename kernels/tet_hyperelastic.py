"""Energy, force and tangent stiffness of tetrahedra of any order, for laws of principal stretches.

The material laws are defined in ``tissue.materials.hyperelasticity``, with moduli relative to a
cell's shear modulus mu. At a quadrature point, the deformation gradient is ``F = sum x_a g_a^T``.
Here ``g_a = sum_c reference[q, a, c] grad L_c`` is the gradient of node a's shape function, and
``L_c`` are the barycentric coordinates of the undeformed corners. F has the singular value
decomposition ``U diag(l) V^T``. The principal stretches are l_i, their product is J, and the
isochoric stretches are ``b_i = l_i J^(-1/3)``. With ``S(alpha) = sum_i b_i^alpha`` and ``x = S(2) -
3``, the energy density is:

    psi = mu (sum_p (2 s_p / alpha_p^2) (S(alpha_p) - 3) + sum_k c_k x^k
        + sum_e (s_e / (2 b_e)) (exp(b_e x) - 1)) + (kappa / 4) (J^2 - 1 - 2 ln J)

The coefficients s_p, alpha_p, c_k, s_e and b_e define a law, and kappa is the bulk modulus. The
neo-Hookean law has only one term of the first sum, with the exponent 2.

Stress and tangent are computed in the frames U and V, from the derivatives of psi with respect to
``ln l_i``. The energy of an inverted cell is infinite.

The second derivative of psi with respect to F has nine eigenvalues. Three of these eigenvalues
belong to changes of the stretches, and are the eigenvalues of a 3 x 3 matrix. The remaining six
belong to shear: symmetric and antisymmetric shear in each of the three planes between two axes
(Smith, De Goes and Kim 2019, ACM Trans. Graph. 38:3). In the positive definite tangent, each
eigenvalue is replaced by its magnitude (Chen et al. 2024, SIGGRAPH).
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
from kernels.constants import HALF, ONE, THREE, TWO, ZERO
from kernels.tetrahedra import write_pair

wp.set_module_options({"max_unroll": 1})

SWEEPS = 12
"""Largest number of sweeps of Jacobi's eigenvalue method. About five sweeps are needed."""
EQUAL = wp.float64(1.0e-5)  # as in tissue.materials.hyperelasticity
SMALLEST_EIGENVALUE = wp.float64(1.0e-3)
"""Smallest eigenvalue of the positive definite tangent, relative to the shear modulus."""


@wp.func
def gradient_of(
    cell: int,
    q: int,
    a: int,
    reference: Doubles3D,
    corner: Vectors2D,
):
    """Compute the shape-function gradient [1/m] of node ``a`` at quadrature point ``q``."""
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
    f = wp.identity(n=3, dtype=wp.float64)
    for a in range(nodes.shape[1]):
        f += wp.outer(displacement[nodes[cell, a]], gradient_of(cell, q, a, reference, corner))
    return f


@wp.func
def removed(
    first: wp.float64,
    second: wp.float64,
    off: wp.float64,
    across: wp.float64,
    other: wp.float64,
    u: wp.vec3d,
    v: wp.vec3d,
):
    """Eliminate an off-diagonal entry of a symmetric 3 x 3 matrix by a rotation of two axes.

    The rotation turns the axes ``u`` and ``v``. ``across`` and ``other`` are the matrix entries
    that couple these two axes to the third axis. Return the new diagonal entries, the new values of
    ``across`` and ``other``, and the new axes.
    """
    t = ZERO
    if off != ZERO:
        theta = (second - first) / (TWO * off)
        t = ONE / (wp.abs(theta) + wp.sqrt(theta * theta + ONE))
        if theta < ZERO:
            t = -t
    cosine = ONE / wp.sqrt(t * t + ONE)
    sine = t * cosine
    return (
        first - t * off,
        second + t * off,
        cosine * across - sine * other,
        sine * across + cosine * other,
        cosine * u - sine * v,
        sine * u + cosine * v,
    )


@wp.func
def stretches_of(f: wp.mat33d):
    """Compute the principal stretches and their axes V for a deformation gradient F with det F > 0.

    The method applies Jacobi rotations to F^T F (Golub and Van Loan, section 8.5). The code
    computes each entry separately, because matrix products take three times as long.
    """
    c = wp.transpose(f) * f
    xx = c[0, 0]
    yy = c[1, 1]
    zz = c[2, 2]
    xy = c[0, 1]
    xz = c[0, 2]
    yz = c[1, 2]
    vx = wp.vec3d(ONE, ZERO, ZERO)
    vy = wp.vec3d(ZERO, ONE, ZERO)
    vz = wp.vec3d(ZERO, ZERO, ONE)
    for _ in range(SWEEPS):
        # rounding of double precision, 2e-16, squared
        if xy * xy + xz * xz + yz * yz <= wp.float64(1.0e-31) * (xx * xx + yy * yy + zz * zz):
            break
        xx, yy, xz, yz, vx, vy = removed(xx, yy, xy, xz, yz, vx, vy)
        xy = ZERO
        xx, zz, xy, yz, vx, vz = removed(xx, zz, xz, xy, yz, vx, vz)
        xz = ZERO
        yy, zz, xy, xz, vy, vz = removed(yy, zz, yz, xy, xz, vy, vz)
        yz = ZERO
    v = wp.matrix_from_cols(vx, vy, vz)
    return wp.vec3d(wp.sqrt(xx), wp.sqrt(yy), wp.sqrt(zz)), v


@wp.func
def power_sum(isochoric: wp.vec3d, alpha: wp.float64):
    """Compute S(alpha) - 3, and its first and second derivatives with respect to log stretches.

    S(alpha) is the sum of the isochoric stretches, each raised to the power alpha.
    """
    power = wp.vec3d(
        wp.pow(isochoric[0], alpha), wp.pow(isochoric[1], alpha), wp.pow(isochoric[2], alpha)
    )
    mean = (power[0] + power[1] + power[2]) / THREE
    second = wp.mat33d()
    for i in range(3):
        for j in range(3):
            second[i, j] = -alpha * alpha * (power[i] + power[j] - mean) / THREE
        second[i, i] = second[i, i] + alpha * alpha * power[i]
    return THREE * (mean - ONE), alpha * (power - wp.vec3d(mean, mean, mean)), second


@wp.func
def derivatives(
    stretch: wp.vec3d,
    shear: wp.float64,
    bulk: wp.float64,
    terms: Doubles2D,
    powers: Doubles,
    exponentials: Doubles2D,
):
    """Compute the energy density [Pa], and its first and second derivatives.

    The derivatives are with respect to the logarithms of the stretches.
    """
    j = stretch[0] * stretch[1] * stretch[2]
    isochoric = stretch / wp.pow(j, ONE / THREE)
    energy = wp.float64(0.25) * bulk * (j * j - ONE - TWO * wp.log(j))
    pressing = HALF * bulk * (j * j - ONE)
    slope = wp.vec3d(pressing, pressing, pressing)
    ones = wp.vec3d(ONE, ONE, ONE)
    curvature = bulk * j * j * wp.outer(ones, ones)
    for p in range(terms.shape[0]):
        scale = TWO * shear * terms[p, 0] / (terms[p, 1] * terms[p, 1])
        value, first, second = power_sum(isochoric, terms[p, 1])
        energy += scale * value
        slope += scale * first
        curvature += scale * second
    if powers.shape[0] + exponentials.shape[0] > 0:
        value, first, second = power_sum(isochoric, TWO)
        lower = ONE  # x^(k - 2)
        for n in range(powers.shape[0]):
            k = wp.float64(n + 2)
            c = shear * powers[n]
            energy += c * lower * value * value
            slope += c * k * lower * value * first
            curvature += c * k * lower * (value * second + (k - ONE) * wp.outer(first, first))
            lower = lower * value
        for e in range(exponentials.shape[0]):
            rate = exponentials[e, 1]
            half = HALF * shear * exponentials[e, 0]
            growth = wp.exp(rate * value)
            energy += half * (growth - ONE) / rate
            slope += half * growth * first
            curvature += half * growth * (second + rate * wp.outer(first, first))
    return energy, slope, curvature


@wp.kernel
def stretch_force(
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
    moduli: Doubles2D,  # [cell, 2]: kappa, mu [Pa]
    terms: Doubles2D,  # [term, 2]: s, alpha
    powers: Doubles,  # [power - 2]: c
    exponentials: Doubles2D,  # [exponential, 2]: s, b
    # state
    displacement: Vectors,  # [node] [m]
    offset: int,
    # out
    energy_out: Doubles,  # [cell] [J]
    force_out: Vectors2D,  # [cell, node of the cell], derivative of the energy [N]
):
    """Compute the energy of each cell, and its derivative with respect to the node positions."""
    cell = wp.tid() + offset
    for a in range(nodes.shape[1]):
        force_out[cell, a] = wp.vec3d()
    energy = wp.float64(0.0)
    for q in range(share.shape[0]):
        f = deformation(cell, q, nodes, reference, corner, displacement)
        weight = share[q] * volume[cell]
        # The cell is inverted.
        if wp.determinant(f) <= ZERO:
            energy = wp.float64(wp.INF)
        else:
            stretch, v = stretches_of(f)
            density, slope, _curvature = derivatives(
                stretch, moduli[cell, 1], moduli[cell, 0], terms, powers, exponentials
            )
            energy += weight * density
            stress = (
                f * v * wp.diag(wp.cw_div(slope, wp.cw_mul(stretch, stretch))) * wp.transpose(v)
            )
            for a in range(nodes.shape[1]):
                force_out[cell, a] = force_out[cell, a] + weight * (
                    stress * gradient_of(cell, q, a, reference, corner)
                )
    energy_out[cell] = energy


@wp.func
def at_least(value: wp.float64, smallest: wp.float64):
    """Return the magnitude of ``value``, or ``smallest`` if the magnitude is smaller."""
    return wp.max(wp.abs(value), smallest)


@wp.func
def definite(matrix: wp.mat33d, smallest: wp.float64):
    """Make a symmetric matrix positive definite by replacing eigenvalues by their magnitudes.

    Magnitudes below ``smallest`` are replaced by ``smallest``.
    """
    frame, values = wp.eig3(matrix)
    raised = wp.vec3d(
        at_least(values[0], smallest), at_least(values[1], smallest), at_least(values[2], smallest)
    )
    return frame * wp.diag(raised) * wp.transpose(frame)


@wp.func
def pair_moduli(
    stretch: wp.vec3d, first: wp.vec3d, second: wp.mat33d, is_definite: int, smallest: wp.float64
):
    """Compute the tangent moduli that couple each shear F_ij with itself and with the shear F_ji.

    ``first`` and ``second`` are the derivatives of the energy density with respect to the
    stretches. Return two symmetric matrices. The first couples F_ij with itself, the second couples
    F_ij with F_ji. The diagonals of the matrices are not used.
    """
    along = wp.mat33d()
    across = wp.mat33d()
    for i in range(3):
        for j in range(3):
            if i != j:
                a = stretch[i]
                b = stretch[j]
                # Limit of the difference quotient (computed below) for equal stretches.
                stretching = HALF * (second[i, i] + second[j, j]) - second[i, j]
                if wp.abs(a - b) >= EQUAL * (a + b):
                    stretching = (first[i] - first[j]) / (a - b)
                turning = (first[i] + first[j]) / (a + b)
                if is_definite == 1:
                    stretching = at_least(stretching, smallest)
                    turning = at_least(turning, smallest)
                along[i, j] = HALF * (stretching + turning)
                across[i, j] = HALF * (stretching - turning)
    return along, across


@wp.kernel
def stretch_stiffness(
    # pairs a <= b of a cell's nodes
    pair_first: Int32s,
    pair_second: Int32s,
    is_definite: int,  # 1 to make the eigenvalues positive
    # mesh
    nodes: Int32s2D,
    corner: Vectors2D,
    volume: Doubles,
    # element
    reference: Doubles3D,
    share: Doubles,
    # law
    moduli: Doubles2D,
    terms: Doubles2D,
    powers: Doubles,
    exponentials: Doubles2D,
    # state without inverted cells
    displacement: Vectors,
    offset: int,
    # out
    block_out: Matrices2D,  # [cell, pair] [N/m]
):
    """Compute the blocks in the upper triangle of each cell's tangent stiffness."""
    cell = wp.tid() + offset
    for pair in range(pair_first.shape[0]):
        block_out[cell, pair] = wp.mat33d()
    for q in range(share.shape[0]):
        f = deformation(cell, q, nodes, reference, corner, displacement)
        weight = share[q] * volume[cell]
        stretch, v = stretches_of(f)
        _energy, slope, curvature = derivatives(
            stretch, moduli[cell, 1], moduli[cell, 0], terms, powers, exponentials
        )
        first = wp.cw_div(slope, stretch)
        second = wp.cw_div(curvature, wp.outer(stretch, stretch)) - wp.diag(
            wp.cw_div(first, stretch)
        )
        smallest = SMALLEST_EIGENVALUE * moduli[cell, 1]
        along, across = pair_moduli(stretch, first, second, is_definite, smallest)
        if is_definite == 1:
            second = definite(second, smallest)
        u = f * v * wp.diag(wp.cw_div(wp.vec3d(ONE, ONE, ONE), stretch))
        for pair in range(pair_first.shape[0]):
            g_a = wp.transpose(v) * gradient_of(cell, q, pair_first[pair], reference, corner)
            g_b = wp.transpose(v) * gradient_of(cell, q, pair_second[pair], reference, corner)
            local = wp.mat33d()
            for i in range(3):
                for k in range(3):
                    if i == k:
                        local[i, i] = local[i, i] + second[i, i] * g_a[i] * g_b[i]
                    else:
                        local[i, i] = local[i, i] + along[i, k] * g_a[k] * g_b[k]
                        local[i, k] = (
                            second[i, k] * g_a[i] * g_b[k] + across[i, k] * g_a[k] * g_b[i]
                        )
            block = u * local * wp.transpose(u)
            # A node's own block is symmetric up to rounding. Mirror it for exact symmetry.
            if pair_first[pair] == pair_second[pair]:
                block = HALF * (block + wp.transpose(block))
            block_out[cell, pair] = block_out[cell, pair] + weight * block


@wp.kernel
def gather_forces(
    start: Int32s,  # [node + 1]
    place: Int32s,  # flat index of each contribution in the cells' forces
    share: Vectors,
    offset: int,
    # out
    force_out: Vectors,  # [node] [N]
):
    """Sum the cell forces at each node, in a fixed order of the cells."""
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

    The assembled stiffness matrix is therefore exactly symmetric.
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
