"""Forces on the elements of a rotating cutter, averaged over a revolution.

Mechanistic model with chip and edge coefficients (Altintas 2012, Manufacturing Automation, ch. 2)
and a size effect, per element::

    h  = (v . n) 2 pi / (N omega)                      chip thickness
    c  = h (max(h, h_min) / h_0) ** -m                 effective chip thickness
    e  = min(h / h_min, 1)                             share of the edge force
    dF = -(N A / (2 pi r)) [(K_tc c + K_te e) t + (K_rc c + K_re e) n + (K_ac c + K_ae e) a] share

with every K scaled by (density / reference density) ** exponent of the layer. Below the minimum
chip thickness h_min the force is proportional to h, so that it is a Lipschitz function of the
velocity. With m = 0 and h_min = 0 the law is linear in h. Elements that do not advance do not cut.

The share is the part of the element's width that lies below the surface of the bone, see
`kernels.engagement`. In a tick of length T it is taken at the middle of the element's motion, over
its width or its way through the surface, whichever is longer. An element that reaches the bone
within the tick therefore cuts for the rest of it.

The kernel returns the tangent of the force at a given velocity.
"""

import warp as wp

from kernels.elements import CHUNK, LANES, Elements, lanes8, lever16
from kernels.engagement import DENSITY, DISTANCE, LAYER, SLOPE, WIDTH

__all__ = [
    "AREA",
    "MOTION_ROWS",
    "RATE",
    "SLOPES",
    "VALUE",
    "Coefficients",
    "cutting_forces",
]

wp.set_module_options({"enable_backward": False})

VALUE, SLOPES, RATE, AREA = 0, 6, 42, 43
"""Places in the sums.

First the tangent's value at zero velocity: force [N] and torque about the tip [N m]. Then, for each
of up to six unknowns, the derivative of both by the unknown. Then the removal rate [m3/s] and the
engaged area of each layer [m2].
"""
MOTION_ROWS = 5
rows8 = wp.types.vector(length=LANES, dtype=wp.int32)


@wp.struct
class Coefficients:
    """Cutting coefficients at each layer's reference density, each at its places in a lever.

    Each layer has two rows. Row 2 layer holds from the minimum chip thickness on. Row 2 layer + 1
    holds below it: there the force is the thickness times the chip row, and the edge row is 0.
    """

    chip: wp.array(dtype=lever16)  # [row] [Pa]
    edge: wp.array(dtype=lever16)  # [row] [N/m]
    # [layer, density in kg/m3]: (density / reference) ** exponent
    strength: wp.array2d(dtype=wp.float32)
    # [layer]: exponent m of the size effect, minimum and reference chip thickness [m]
    size: wp.array(dtype=wp.vec3)


@wp.kernel
def cutting_forces(
    elements: Elements,
    coefficients: Coefficients,
    found: wp.array2d(dtype=lanes8),  # [eight elements, row], see `kernels.engagement.DISTANCE`
    # rows, in the tool's frame: velocity of the tip [m/s], angular velocity [rad/s], both at which
    # the place of `found` was reached, number of unknowns and length of the tick [s] and speed
    motion: wp.array2d(dtype=wp.float64),
    chip_per_speed: float,  # 2 pi / (N omega) [s]
    chunk_offset: int,
    # out
    sums_out: wp.array2d(dtype=wp.float64),  # [chunk, AREA + layers], tool frame: see VALUE
):
    """Sum the forces on one chunk of elements, as a tangent.

    The unknowns are the speed (1), the velocity of the tip (3), or both velocities (6). For the
    speed, the velocities are those at speed 1.
    """
    chunk = wp.tid() + chunk_offset
    for m in range(sums_out.shape[1]):
        sums_out[chunk, m] = wp.float64(0.0)
    unknowns = int(motion[4, 0])
    tick = float(motion[4, 1])
    speed = float(motion[4, 2])
    thickness_per_advance = speed * chip_per_speed
    velocity = row_of(motion, 0)
    turning = row_of(motion, 1)
    # Only elements that advance by more than the rounding of an advance cut.
    least = 1.0e-5 * wp.length(velocity)
    value = lever16()
    slope_0 = lever16()
    slope_1 = lever16()
    slope_2 = lever16()
    slope_3 = lever16()
    slope_4 = lever16()
    slope_5 = lever16()
    rate = float(0.0)
    first = chunk * (CHUNK // LANES)
    last = wp.min(first + CHUNK // LANES, elements.lanes.shape[0])
    for eight in range(first, last):
        width = found[eight, WIDTH]
        nx = elements.lanes[eight, 3]
        ny = elements.lanes[eight, 4]
        nz = elements.lanes[eight, 5]
        px = elements.lanes[eight, 0]
        py = elements.lanes[eight, 1]
        pz = elements.lanes[eight, 2]
        # moments of the normals: derivatives of the advance by the angular velocity
        mx = wp.cw_mul(py, nz) - wp.cw_mul(pz, ny)
        my = wp.cw_mul(pz, nx) - wp.cw_mul(px, nz)
        mz = wp.cw_mul(px, ny) - wp.cw_mul(py, nx)
        by_tip = velocity[0] * nx + velocity[1] * ny + velocity[2] * nz
        by_turn = turning[0] * mx + turning[1] * my + turning[2] * mz
        advances = by_tip + by_turn
        # Weights of eight elements: of the chip row and the edge row in the value, and of
        # the chip row in the derivatives by the advance and by the way through the surface.
        chip_value = lanes8()
        edge_value = lanes8()
        by_advance = lanes8()
        chip_by_way = lanes8()
        edge_by_way = lanes8()
        rows = rows8()
        cuts = int(0)
        moves = int(0)
        lane = int(0)
        while lane < LANES:
            advance = advances[lane]
            if width[lane] > 0.0 and advance > least:
                e = eight * LANES + lane
                way = tick * way_of(found, eight, lane, velocity, turning, px, py, pz)
                before = tick * way_of(
                    found, eight, lane, row_of(motion, 2), row_of(motion, 3), px, py, pz
                )
                engaged = share_of(found[eight, DISTANCE][lane] - before, way, width[lane])
                if engaged.share > 0.0:
                    cuts = 1
                    layer = int(found[eight, LAYER][lane])
                    strength = coefficients.strength[layer, int(found[eight, DENSITY][lane])]
                    # of cutting edge in bone, by the bone's strength [m]
                    length = elements.edge_length[e] * strength
                    part = length * engaged.share
                    thickness = advance * thickness_per_advance
                    tangent = tangent_at(thickness, coefficients.size[layer])
                    known = wp.where(unknowns == 3, by_turn[lane], 0.0)
                    gain = part * tangent.slope * chip_per_speed
                    by_advance[lane] = gain
                    chip_value[lane] = part * tangent.value + gain * known * speed
                    edge_value[lane] = part
                    if engaged.by_way != 0.0:
                        moves = 1
                        grown = length * engaged.by_way * tick
                        thick = grown * (tangent.slope * thickness + tangent.value)
                        # the part of the way that the unknowns make
                        made = wp.where(
                            unknowns == 3,
                            wp.dot(slope_at(found, eight, lane), velocity),
                            way / wp.max(tick, 1.0e-9),
                        )
                        chip_by_way[lane] = thick
                        edge_by_way[lane] = grown
                        chip_value[lane] -= thick * made
                        edge_value[lane] -= grown * made
                    rows[lane] = 2 * layer + tangent.is_below
                    area = elements.area[e] * engaged.share
                    rate += area * advance * speed
                    sums_out[chunk, AREA + layer] += wp.float64(area)
            lane += 1
        # The sums have a loop of their own. The share and the power would push them out of the
        # registers at every element: in one loop the kernel takes 1.2 times as long.
        if cuts == 1:
            for j in range(LANES):
                lever = elements.lever[eight * LANES + j]
                chip = wp.cw_mul(coefficients.chip[rows[j]], lever)
                edge = wp.cw_mul(coefficients.edge[rows[j]], lever)
                value += chip_value[j] * chip + edge_value[j] * edge
                loads = by_advance[j] * chip
                if unknowns == 1:
                    slope_0 += advances[j] * loads
                else:
                    slope_0 += nx[j] * loads
                    slope_1 += ny[j] * loads
                    slope_2 += nz[j] * loads
                    if unknowns == 6:
                        slope_3 += mx[j] * loads
                        slope_4 += my[j] * loads
                        slope_5 += mz[j] * loads
                    if moves == 1:
                        loads = chip_by_way[j] * chip + edge_by_way[j] * edge
                        toward = slope_at(found, eight, j)
                        slope_0 += toward[0] * loads
                        slope_1 += toward[1] * loads
                        slope_2 += toward[2] * loads
                        if unknowns == 6:
                            moment = wp.cross(wp.vec3(px[j], py[j], pz[j]), toward)
                            slope_3 += moment[0] * loads
                            slope_4 += moment[1] * loads
                            slope_5 += moment[2] * loads
    set_loads(value, chunk, VALUE, sums_out)
    set_loads(slope_0, chunk, SLOPES, sums_out)
    if unknowns > 1:
        set_loads(slope_1, chunk, SLOPES + 6, sums_out)
        set_loads(slope_2, chunk, SLOPES + 12, sums_out)
    if unknowns == 6:
        set_loads(slope_3, chunk, SLOPES + 18, sums_out)
        set_loads(slope_4, chunk, SLOPES + 24, sums_out)
        set_loads(slope_5, chunk, SLOPES + 30, sums_out)
    sums_out[chunk, RATE] = wp.float64(rate)


@wp.func
def row_of(motion: wp.array2d(dtype=wp.float64), row: int):
    """Convert a row of ``motion`` to single precision."""
    return wp.vec3(float(motion[row, 0]), float(motion[row, 1]), float(motion[row, 2]))


@wp.func
def slope_at(found: wp.array2d(dtype=lanes8), eight: int, lane: int):
    """Return the gradient of an element's distance to the surface."""
    return wp.vec3(
        found[eight, SLOPE][lane], found[eight, SLOPE + 1][lane], found[eight, SLOPE + 2][lane]
    )


@wp.func
def way_of(
    found: wp.array2d(dtype=lanes8),
    eight: int,
    lane: int,
    velocity: wp.vec3,
    turning: wp.vec3,
    px: lanes8,
    py: lanes8,
    pz: lanes8,
):
    """Compute the rate at which an element's distance to the surface grows [m/s]."""
    moving = velocity + wp.cross(turning, wp.vec3(px[lane], py[lane], pz[lane]))
    return wp.dot(slope_at(found, eight, lane), moving)


@wp.struct
class Engaged:
    """Mean share of an element below the surface in a tick."""

    share: wp.float32
    by_way: wp.float32  # derivative by the way through the surface [1/m]


@wp.func
def share_of(distance: float, way: float, width: float):
    """Compute the share of an element that starts at a distance and moves by ``way`` [m]."""
    engaged = Engaged()
    middle = distance + 0.5 * way
    extent = wp.max(width, wp.abs(way))
    share = 0.5 - middle / extent
    engaged.share = wp.clamp(share, 0.0, 1.0)
    if way != 0.0 and share > 0.0 and share < 1.0:
        engaged.by_way = -0.5 / extent
        if wp.abs(way) > width:
            engaged.by_way += wp.sign(way) * middle / (extent * extent)
    return engaged


@wp.struct
class Tangent:
    """Tangent of the effective chip thickness, as a function of the thickness."""

    slope: wp.float32  # derivative
    value: wp.float32  # value at zero thickness [m]
    is_below: wp.int32  # 1 below the minimum chip thickness, whose row has the size effect there


@wp.func
def tangent_at(thickness: float, size: wp.vec3):
    """Compute the tangent at a chip thickness [m], for a size effect as in `Coefficients`."""
    exponent = size[0]
    tangent = Tangent()
    tangent.slope = 1.0
    # Below the minimum both forces are proportional to the thickness.
    if thickness < size[1]:
        tangent.is_below = 1
    elif exponent > 0.0:
        scale = wp.pow(thickness / size[2], -exponent)
        tangent.slope = (1.0 - exponent) * scale
        tangent.value = exponent * scale * thickness
    return tangent


@wp.func
def set_loads(sums: lever16, chunk: int, place: int, sums_out: wp.array2d(dtype=wp.float64)):
    """Write a chunk's force and torque at their places."""
    for c in range(3):
        sums_out[chunk, place + c] = wp.float64(force_of(sums)[c])
        sums_out[chunk, place + 3 + c] = wp.float64(torque_of(sums)[c])


@wp.func
def force_of(sums: lever16):
    """Return the force on the elements whose loads, with their levers, sum to ``sums``."""
    return -wp.vec3(sums[0] + sums[5], sums[1] + sums[6], sums[7] + sums[11])


@wp.func
def torque_of(sums: lever16):
    """Return the torque about the tip, for the same elements as in `force_of`."""
    return -wp.vec3(sums[2] + sums[8] + sums[12], sums[3] + sums[9] + sums[13], sums[4] + sums[10])
