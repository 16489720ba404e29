"""Explicit time step of heat conduction on a rectilinear grid of partly filled cells.

The method is finite volumes. Two neighbouring cells have the filled fractions f and g. Heat is
conducted through the fraction a of the area of their common face::

    C f dT/dt = sum over faces of G a (T_neighbour - T) + P,    a = min(max(f, g), 2 min(f, g))

T is the temperature, C the heat capacity of a full cell, G the conductance between two full cells,
and P the heating power in the cell. The fraction a is 1 between a full and a half-full cell,
because a cut parallel to the face leaves the whole face open. As the smaller filled fraction tends
to zero, a also tends to zero. An almost empty cell therefore does not shorten the stable time step.
An empty cell does not store or conduct heat, so the surface of the remaining body is insulated.
"""

import warp as wp

from kernels.arrays import Singles3D

OPEN = 2.0
"""Largest ratio of a face's conducting fraction to the smaller filled fraction of its two cells.

Compared with a ratio of 1, the stable time step is shorter by this factor.
"""


@wp.func
def open_share(filled: float, other: float):
    """Compute the conducting fraction of the face between two cells from their filled fractions."""
    return wp.min(wp.max(filled, other), OPEN * wp.min(filled, other))


@wp.kernel
def conduct(
    # state
    temperature: Singles3D,  # rise [K]
    filled: Singles3D,  # fraction of the cell that holds material
    # conductance between a cell and the next one along an axis [W/K], if both are full
    along_x: Singles3D,
    along_y: Singles3D,
    along_z: Singles3D,
    heat_capacity: Singles3D,  # heat capacity of the full cell [J/K]
    power: Singles3D,  # heat put into the cell [W]
    step_s: float,
    plane_offset: int,
    # out
    temperature_out: Singles3D,
):
    """Compute the temperature rise [K] in each cell after one time step."""
    i, j, m = wp.tid()
    i += plane_offset
    f = filled[i, j, m]
    here = temperature[i, j, m]
    if f <= 0.0:
        temperature_out[i, j, m] = 0.0
        return
    total = power[i, j, m]
    if i > 0:
        total += (
            along_x[i - 1, j, m]
            * open_share(f, filled[i - 1, j, m])
            * (temperature[i - 1, j, m] - here)
        )
    if i + 1 < filled.shape[0]:
        total += (
            along_x[i, j, m]
            * open_share(f, filled[i + 1, j, m])
            * (temperature[i + 1, j, m] - here)
        )
    if j > 0:
        total += (
            along_y[i, j - 1, m]
            * open_share(f, filled[i, j - 1, m])
            * (temperature[i, j - 1, m] - here)
        )
    if j + 1 < filled.shape[1]:
        total += (
            along_y[i, j, m]
            * open_share(f, filled[i, j + 1, m])
            * (temperature[i, j + 1, m] - here)
        )
    if m > 0:
        total += (
            along_z[i, j, m - 1]
            * open_share(f, filled[i, j, m - 1])
            * (temperature[i, j, m - 1] - here)
        )
    if m + 1 < filled.shape[2]:
        total += (
            along_z[i, j, m]
            * open_share(f, filled[i, j, m + 1])
            * (temperature[i, j, m + 1] - here)
        )
    temperature_out[i, j, m] = here + step_s * total / (f * heat_capacity[i, j, m])
