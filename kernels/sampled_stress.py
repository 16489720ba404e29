"""Energy, stress and its tangent at some points of a body under laws of principal stretches, each with its own volume.

The laws are those of ``kernels.tet_hyperelastic``. For a body that moves in a few modes, the gradients of these at
the points are all that is needed: neither nodes nor cells.
"""

import warp as wp

from kernels.tet_hyperelastic import derivatives, pair_moduli, stretches_of

__all__ = ["sampled_moduli", "sampled_stress"]

wp.set_module_options({"enable_backward": False, "max_unroll": 1})


@wp.kernel
def sampled_stress(
    # points
    volume: wp.array(dtype=wp.float64),  # [point] [m3]
    moduli: wp.array2d(dtype=wp.float64),  # [point, 2]: kappa, mu [Pa]
    # law
    terms: wp.array2d(dtype=wp.float64),  # [term, 2]: s, alpha
    powers: wp.array(dtype=wp.float64),  # [power - 2]: c
    # state
    gradient: wp.array2d(dtype=wp.float64),  # [point, 3 i + j], derivative of displacement i by position j
    # out
    energy_out: wp.array(dtype=wp.float64),  # [point] [J], infinite where a point is turned over
    stress_out: wp.array2d(dtype=wp.float64),  # [point, 3 i + j], derivative of the energy [J]; 0 there
):
    """Energy of each point's volume and its derivative by the displacement's gradient there."""
    point = wp.tid()
    f = wp.mat33d()
    for i in range(3):
        for j in range(3):
            f[i, j] = gradient[point, 3 * i + j]
        f[i, i] = f[i, i] + wp.float64(1.0)
    stress = wp.mat33d()
    energy = wp.float64(wp.INF)
    if wp.determinant(f) > wp.float64(0.0):
        stretch, v = stretches_of(f)
        density, slope, _curvature = derivatives(stretch, moduli[point, 1], moduli[point, 0], terms, powers)
        energy = volume[point] * density
        along = wp.diag(wp.cw_div(slope, wp.cw_mul(stretch, stretch)))
        stress = volume[point] * (f * v * along * wp.transpose(v))
    energy_out[point] = energy
    for i in range(3):
        for j in range(3):
            stress_out[point, 3 * i + j] = stress[i, j]


@wp.kernel
def sampled_moduli(
    # points
    volume: wp.array(dtype=wp.float64),
    moduli: wp.array2d(dtype=wp.float64),
    # law
    terms: wp.array2d(dtype=wp.float64),
    powers: wp.array(dtype=wp.float64),
    # state, no point of it turned over
    gradient: wp.array2d(dtype=wp.float64),
    # out
    moduli_out: wp.array3d(dtype=wp.float64),  # [point, 3 i + j, 3 k + m], second derivative of the energy [J]
):
    """Second derivative of each point's energy by the displacement's gradient there."""
    point = wp.tid()
    f = wp.mat33d()
    for i in range(3):
        for j in range(3):
            f[i, j] = gradient[point, 3 * i + j]
        f[i, i] = f[i, i] + wp.float64(1.0)
    stretch, v = stretches_of(f)
    _energy, slope, curvature = derivatives(stretch, moduli[point, 1], moduli[point, 0], terms, powers)
    first = wp.cw_div(slope, stretch)
    second = wp.cw_div(curvature, wp.outer(stretch, stretch)) - wp.diag(wp.cw_div(first, stretch))
    along, across = pair_moduli(stretch, first, second)
    one = wp.float64(1.0)
    u = f * v * wp.diag(wp.cw_div(wp.vec3d(one, one, one), stretch))
    for k in range(3):
        for m in range(3):
            turned = wp.outer(wp.vec3d(u[k, 0], u[k, 1], u[k, 2]), wp.vec3d(v[m, 0], v[m, 1], v[m, 2]))
            local = wp.mat33d()
            for i in range(3):
                for j in range(3):
                    if i == j:
                        for n in range(3):
                            local[i, i] = local[i, i] + second[i, n] * turned[n, n]
                    else:
                        local[i, j] = along[i, j] * turned[i, j] + across[i, j] * turned[j, i]
            change = volume[point] * (u * local * wp.transpose(v))
            for i in range(3):
                for j in range(3):
                    moduli_out[point, 3 * i + j, 3 * k + m] = change[i, j]
