"""Heat conduction on a regular grid, one explicit step.

Finite volumes with the harmonic mean of the conductivities across each face::

    rho c dT/dt = div(k grad T) + q

A face to a cell without material is insulated. Stable for steps up to h^2 / (6 a) with the largest diffusivity a.
"""

import warp as wp

__all__ = ["conduct"]

wp.set_module_options({"enable_backward": False})


@wp.func
def flow(
    temperature: wp.array3d(dtype=wp.float32),
    conductivity: wp.array3d(dtype=wp.float32),
    here: float,
    k: float,
    i: int,
    j: int,
    m: int,
):
    """Conductivity times temperature difference [W/m] to cell (i, j, m), 0 outside the grid or the material."""
    if i < 0 or j < 0 or m < 0:
        return float(0.0)
    if i >= temperature.shape[0] or j >= temperature.shape[1] or m >= temperature.shape[2]:
        return float(0.0)
    other = conductivity[i, j, m]
    if other <= 0.0:
        return float(0.0)
    return 2.0 * k * other / (k + other) * (temperature[i, j, m] - here)


@wp.kernel
def conduct(
    # state
    temperature: wp.array3d(dtype=wp.float32),  # rise [K]
    conductivity: wp.array3d(dtype=wp.float32),  # [W/(m K)], 0 where there is no material
    heat_capacity: wp.array3d(dtype=wp.float32),  # volumetric [J/(m3 K)]
    power: wp.array3d(dtype=wp.float32),  # heat put in [W] a cell
    step_s: float,
    spacing: float,  # [m]
    plane_offset: int,
    # out
    temperature_out: wp.array3d(dtype=wp.float32),
):
    """Temperature rise one step later."""
    i, j, m = wp.tid()
    i += plane_offset
    k = conductivity[i, j, m]
    here = temperature[i, j, m]
    if k <= 0.0:
        temperature_out[i, j, m] = 0.0
        return
    total = flow(temperature, conductivity, here, k, i - 1, j, m)
    total += flow(temperature, conductivity, here, k, i + 1, j, m)
    total += flow(temperature, conductivity, here, k, i, j - 1, m)
    total += flow(temperature, conductivity, here, k, i, j + 1, m)
    total += flow(temperature, conductivity, here, k, i, j, m - 1)
    total += flow(temperature, conductivity, here, k, i, j, m + 1)
    gain = total / (spacing * spacing) + power[i, j, m] / (spacing * spacing * spacing)
    temperature_out[i, j, m] = here + step_s * gain / heat_capacity[i, j, m]
