"""Data layout for the matrix product in `kernels.cell_strips`: cell weights and vectors.

A strip consists of eight cells in a row, which are processed at once. A lane is the position of a
cell in its strip. The kernels compute the weights of cells and the diagonal of the stiffness, run a
smoothing step, and convert vectors between node order and lane order.
"""

from typing import Any

import warp as wp

from kernels.arrays import (
    Bytes,
    Doubles,
    Doubles2D,
    Doubles3D,
    Int32s,
    Int32s2D,
    Matrices2D,
    Shorts,
    Singles2D,
    Singles3D,
    Vectors,
)
from kernels.cell_strips import WEIGHTS, lanes_of
from kernels.constants import HALF, ONE, ZERO
from kernels.hexahedra import block_of, carries
from kernels.particle_stiffness import FULL_STEPS

wp.set_module_options({"max_unroll": 1})

LANES_F = lanes_of(wp.float32)
LaneRows = wp.array2d(dtype=LANES_F)


@wp.kernel
def cube_weights(
    # particles, sorted by cell
    place: Vectors,  # position in the cell, 0 to 1 along each edge
    volume: Doubles,  # [m3]
    lame: Doubles2D,  # [particle, 2]: lambda, mu [Pa]
    remaining: Shorts,  # steps of 1/65535
    # cells
    cell_start: Int32s,  # [cell + 1], first particle of each cell
    live: Bytes,  # [cell], 0 if the cell carries no load
    regular: Bytes,  # [cell], 1 if its particles are centres of cubes
    strip: wp.array(dtype=wp.vec2i),  # [cell]: its strip, and its lane in the strip
    changed: Int32s,  # cells to recompute
    edge: wp.float64,  # [m]
    strength: wp.float64,  # strength of the unresolved modes, see kernels.particle_stiffness
    offset: int,
    # out
    # [strip, WEIGHTS, lane] [N/m], zero in cells that are not regular
    weight_out: Doubles3D,
    single_out: Singles3D,  # rounded to single precision
):
    """Compute the weights of the changed cells in the storage format of `kernels.cell_strips`."""
    cell = changed[wp.tid() + offset]
    row = strip[cell][0]
    lane = strip[cell][1]
    for i in range(WEIGHTS):
        weight_out[row, i, lane] = ZERO
    shear = wp.float64(0.0)
    moment = wp.vec3d()
    middle = wp.vec3d(HALF, HALF, HALF)
    if live[cell] != wp.uint8(0) and regular[cell] != wp.uint8(0):
        for p in range(cell_start[cell], cell_start[cell + 1]):
            left = volume[p] * wp.float64(remaining[p]) / FULL_STEPS
            at = place[p] - middle
            cube = int(0)
            for axis in range(3):
                cube = 2 * cube
                if at[axis] > ZERO:
                    cube += 1
            # V / 16 h^2, see WEIGHTS
            share = left / (wp.float64(16.0) * edge * edge)
            weight_out[row, cube, lane] = weight_out[row, cube, lane] + share * lame[p, 0]
            weight_out[row, 8 + cube, lane] = weight_out[row, 8 + cube, lane] + share * lame[p, 1]
            shear += left * lame[p, 1]
            moment += left * wp.cw_mul(at, at)
    whole = edge * edge * edge
    # A full cell has the second moment V / 12 about its centre. The part that the particles lack is
    # unresolved.
    missing = wp.max(ONE - wp.float64(12.0) * wp.min(moment) / whole, ZERO)
    weight_out[row, 16, lane] = strength * missing * shear / whole * edge / wp.float64(12.0)
    for i in range(WEIGHTS):
        single_out[row, i, lane] = wp.float32(weight_out[row, i, lane])


@wp.kernel
def to_lanes(
    slot: Int32s,  # [node]
    vector: wp.array(dtype=Any),  # [node]
    offset: int,
    # out
    lanes_out: wp.array2d(dtype=Any),  # [component, slot]
):
    """Copy a vector from node order to lane order.

    The input and the output may have single or double precision.
    """
    node = wp.tid() + offset
    for c in range(3):
        lanes_out[c, slot[node]] = lanes_out.dtype(vector[node][c])


@wp.kernel
def from_lanes(
    slot: Int32s,  # [node]
    lanes: wp.array2d(dtype=Any),  # [component, slot]
    offset: int,
    # out
    vector_out: wp.array(dtype=Any),  # [node]
):
    """Copy a vector from lane order to node order.

    The input and the output may have single or double precision.
    """
    node = wp.tid() + offset
    at = slot[node]
    value = vector_out[node]
    for c in range(3):
        value[c] = type(value[c])(lanes[c, at])
    vector_out[node] = value


@wp.kernel
def node_diagonals(
    nodes: Int32s,  # nodes whose cells changed
    node_cells: Int32s2D,  # [node, corner]
    live: Bytes,  # [cell]
    stiffness: Matrices2D,  # [cell, block] [N/m]
    free: Vectors,  # [node], 1 where a component may move, 0 where it is held
    slot: Int32s,  # [node]
    largest: wp.float64,  # upper bound of the eigenvalues of D^-1 K
    offset: int,
    # out
    diagonal_out: Vectors,  # [node] [N/m], 1 on held components
    # [component, slot] [m/N], 1 / (bound D); 0 if held or empty
    inverse_out: Singles2D,
):
    """Compute the stiffness diagonal D at the given nodes, and ``1 / (largest * D)``."""
    node = nodes[wp.tid() + offset]
    total = wp.vec3d()
    for a in range(8):
        cell = node_cells[node, a]
        if carries(live, cell):
            total += wp.get_diag(stiffness[cell, block_of(a, a)])
    for c in range(3):
        inverse = wp.float64(0.0)
        if free[node][c] * total[c] > ZERO:
            inverse = ONE / (largest * total[c])
        inverse_out[c, slot[node]] = wp.float32(inverse)
        total[c] = wp.where(free[node][c] > ZERO, total[c], ONE)
    diagonal_out[node] = total


@wp.kernel
def smooth(
    # [component, lanes], 1 / (largest eigenvalue x diagonal); 0 if held
    inverse: LaneRows,
    share: float,  # weight of the last direction in the next direction
    gain: float,  # weight of the residual in the next direction
    offset: int,
    # out
    force_out: LaneRows,  # K times the last direction; set to zero
    residual_out: LaneRows,  # reduced by this product
    direction_out: LaneRows,  # set to the next direction
    vector_out: LaneRows,  # increased by the last direction
):
    """Run one smoothing step: ``v += d``, ``r -= K d``, ``d = share d + gain D^-1 r``.

    Here, v is the vector, r the residual, d the search direction and K the stiffness. ``inverse``
    contains D^-1. D is the diagonal of K, multiplied by an upper bound of the eigenvalues of (diag
    K)^-1 K. The product K d is read from ``force_out``.
    """
    i = wp.tid() + offset
    for c in range(3):
        direction = direction_out[c, i]
        residual = residual_out[c, i] - force_out[c, i]
        vector_out[c, i] = vector_out[c, i] + direction
        residual_out[c, i] = residual
        direction_out[c, i] = share * direction + gain * wp.cw_mul(inverse[c, i], residual)
        force_out[c, i] = LANES_F()
