"""Strain and stress at points of trilinear cells, with von Mises and principal stresses.

With g_a the gradients of the shape functions: ``grad u = sum u_a g_a^T``, ``e = sym grad u``,
``s = lambda tr(e) I + 2 mu e``. Principal stresses in closed form (Smith 1961, Commun. ACM 4:168).
"""

import warp as wp

from kernels.hexahedra import corner_gradients

__all__ = ["invariants", "point_stress"]

wp.set_module_options({"enable_backward": False})

THIRD_TURN = wp.constant(wp.float64(2.0943951023931953))


@wp.func
def principal_values(stress: wp.mat33d):
    """Compute the eigenvalues of a symmetric matrix, largest first."""
    mean = wp.trace(stress) / wp.float64(3.0)
    shifted = stress - wp.diag(wp.vec3d(mean, mean, mean))
    size = wp.sqrt(wp.ddot(shifted, shifted) / wp.float64(6.0))
    values = wp.vec3d(mean, mean, mean)
    if size > wp.float64(0.0):
        half = wp.determinant(shifted / size) / wp.float64(2.0)
        angle = wp.acos(wp.clamp(half, wp.float64(-1.0), wp.float64(1.0))) / wp.float64(3.0)
        first = mean + wp.float64(2.0) * size * wp.cos(angle)
        last = mean + wp.float64(2.0) * size * wp.cos(angle + THIRD_TURN)
        values = wp.vec3d(first, wp.float64(3.0) * mean - first - last, last)
    return values


@wp.kernel
def point_stress(
    # points
    point: wp.array(dtype=wp.int32),  # rows of the next three arrays
    cell_of: wp.array(dtype=wp.int32),
    place: wp.array(dtype=wp.vec3d),  # place in the cell, 0 to 1 along each edge
    lame: wp.array2d(dtype=wp.float64),  # [row, 2]: lambda, mu [Pa]
    # cells
    cell_nodes: wp.array2d(dtype=wp.int32),
    displacement: wp.array(dtype=wp.vec3d),  # [node] [m]
    edge: wp.float64,  # [m]
    offset: int,
    # out
    stress_out: wp.array2d(dtype=wp.float64),  # [point, 6] [Pa]: xx, yy, zz, yz, xz, xy
):
    """Compute the stress at each point."""
    i = wp.tid() + offset
    row = point[i]
    cell = cell_of[row]
    gradients = corner_gradients(place[row], wp.float64(1.0) / edge)
    gradient = wp.mat33d()
    for a in range(8):
        gradient += wp.outer(
            displacement[cell_nodes[cell, a]],
            wp.vec3d(gradients[a, 0], gradients[a, 1], gradients[a, 2]),
        )
    strain = wp.float64(0.5) * (gradient + wp.transpose(gradient))
    pressure = lame[row, 0] * wp.trace(strain)
    stress = wp.float64(2.0) * lame[row, 1] * strain + wp.diag(
        wp.vec3d(pressure, pressure, pressure)
    )
    for k in range(3):
        stress_out[i, k] = stress[k, k]
    stress_out[i, 3] = stress[1, 2]
    stress_out[i, 4] = stress[0, 2]
    stress_out[i, 5] = stress[0, 1]


@wp.kernel
def invariants(
    components: wp.array2d(dtype=wp.float64),  # [point, 6] [Pa]: xx, yy, zz, yz, xz, xy
    offset: int,
    # out
    von_mises_out: wp.array(dtype=wp.float64),  # [point] [Pa]
    principal_out: wp.array(dtype=wp.vec3d),  # [point] [Pa], largest first
):
    """Compute von Mises and principal stresses of each stress."""
    i = wp.tid() + offset
    yz = components[i, 3]
    xz = components[i, 4]
    xy = components[i, 5]
    stress = wp.mat33d(components[i, 0], xy, xz, xy, components[i, 1], yz, xz, yz, components[i, 2])
    mean = wp.trace(stress) / wp.float64(3.0)
    deviator = stress - wp.diag(wp.vec3d(mean, mean, mean))
    von_mises_out[i] = wp.sqrt(wp.float64(1.5) * wp.ddot(deviator, deviator))
    principal_out[i] = principal_values(stress)
