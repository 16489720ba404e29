"""Energy and stress at some points of a body under laws of principal stretches, each with a volume of its own.

The laws are those of ``kernels.tet_hyperelastic``. Who knows how far a displacement in a few modes stretches the body at
the points needs neither nodes nor cells.
"""

import warp as wp

from kernels.tet_hyperelastic import derivatives, stretches_of

__all__ = ["sampled_stress"]

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
