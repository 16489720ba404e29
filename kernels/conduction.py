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
def heat_flow(
    conductance: float,
    temperature: Singles3D,
    filled: Singles3D,
    fraction: float,
    here: float,
    i: int,
    j: int,
    m: int,
):
    """Compute the heat flow [W] from the neighbouring cell (i, j, m) into a cell.

    ``fraction`` and ``here`` are the filled fraction and the temperature rise [K] of the cell that
    receives the heat.
    """
    other = filled[i, j, m]
    # conducting fraction of the face between the two cells, see OPEN
    part = wp.min(wp.max(fraction, other), OPEN * wp.min(fraction, other))
    return conductance * part * (temperature[i, j, m] - here)


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
        total += heat_flow(along_x[i - 1, j, m], temperature, filled, f, here, i - 1, j, m)
    if i + 1 < filled.shape[0]:
        total += heat_flow(along_x[i, j, m], temperature, filled, f, here, i + 1, j, m)
    if j > 0:
        total += heat_flow(along_y[i, j - 1, m], temperature, filled, f, here, i, j - 1, m)
    if j + 1 < filled.shape[1]:
        total += heat_flow(along_y[i, j, m], temperature, filled, f, here, i, j + 1, m)
    if m > 0:
        total += heat_flow(along_z[i, j, m - 1], temperature, filled, f, here, i, j, m - 1)
    if m + 1 < filled.shape[2]:
        total += heat_flow(along_z[i, j, m], temperature, filled, f, here, i, j, m + 1)
    temperature_out[i, j, m] = here + step_s * total / (f * heat_capacity[i, j, m])
