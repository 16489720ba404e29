"""Forces on the cutting elements of a rotating cutter, averaged over a revolution.

A cutting element is a small piece of the cutter's surface. The mechanistic model has chip and edge
coefficients (Altintas 2012, Manufacturing Automation, ch. 2) and a size effect. Per element::

    h  = (v . n) 2 pi / (N omega)                      chip thickness
    c  = h (max(h, h_min) / h_0) ** -m                 effective chip thickness
    e  = min(h / h_min, 1)                             share of the edge force
    dF = -(N A / (2 pi r)) [(K_tc c + K_te e) t + (K_rc c + K_re e) n + (K_ac c + K_ae e) a] share

For each element, v is the velocity, A the area, r the distance from the axis, and t, n and a are
the tangential, normal and axial directions. N is the number of teeth, and omega is the angular
speed of the spindle. Every coefficient K is scaled by (density / reference density) ** exponent,
with the reference density and the exponent of the bone layer. Below the minimum chip thickness
h_min the force is proportional to h, so the force is a Lipschitz function of the velocity. With m =
0 and h_min = 0, the force is linear in h. An element that does not advance along its outward normal
does not cut.

The factor ``share`` is the part of the element's width that lies below the surface of the bone, see
`kernels.engagement`. In each tick (1 ms step), the share is evaluated at the middle of the
element's motion. With increasing distance from the surface, the share falls from 1 to 0. The length
of this transition is the element's width or, if larger, the element's motion through the surface in
the tick. An element that reaches the bone within the tick therefore cuts for the rest of the tick.

The kernel computes the force at a given velocity, and the derivatives of the force with respect to
the velocity (the tangent). The kernel processes eight elements at once.
"""

import warp as wp

from kernels.arrays import Doubles, Doubles2D
from kernels.constants import ZERO
from kernels.elements import CHUNK, LANES, LEAST_ADVANCE, Elements, Lanes2D, lanes8
from kernels.engagement import (
    CHIP,
    DISTANCE,
    EDGE,
    LAYER,
    MINIMUM,
    SLOPE,
    WIDTH,
    Coefficients,
)

# Indices into the sums. The derivatives of force and torque by each of up to six unknowns follow
# after the areas. With three unknowns, only the force has derivatives, and the torque is the torque
# at the given velocity.
VALUE = 0  # tangent at zero velocity: force [N], torque about the tip [N m]; 6 entries
RATE = 6  # removal rate at speed 1 [m3/s]
AREA = 7  # engaged area of each layer [m2]
MOTION_ROWS = 5
"""Number of rows of the array ``motion`` that `cutting_forces` reads."""
# Lower limit of widths, motions and chip thicknesses in denominators [m].
TINY = 1.0e-12


@wp.struct
class Loads:
    """Tangential, radial and axial loads on eight cutting elements [N]."""

    tangential: lanes8
    radial: lanes8
    axial: lanes8


@wp.kernel
def cutting_forces(
    elements: Elements,
    coefficients: Coefficients,
    found: Lanes2D,  # [eight elements, row], see `kernels.engagement.DISTANCE`
    engaged: Doubles,  # [chunk], 1 where an element has bone
    # Rows, in the tool's frame: velocity of the tip [m/s], angular velocity [rad/s]; the velocity
    # and the angular velocity with which a tick would end at the pose of `found`; number of
    # unknowns, length of the tick [s] and speed.
    motion: Doubles2D,
    chip_per_speed: float,  # 2 pi / (N omega) [s]
    chunk_offset: int,
    # out
    # scratch: the sums of each of the eight lanes
    lanes_out: Lanes2D,
    # [chunk, AREA + layers + 36], tool frame, see VALUE; not written for chunks without bone
    sums_out: Doubles2D,
):
    """Sum forces and torques on one chunk of cutting elements, and their derivatives.

    The derivatives are with respect to 1, 3 or 6 unknowns: the tool's speed; the velocity of the
    tip; or the velocity of the tip and the angular velocity. If the speed is the unknown, the
    velocities in ``motion`` belong to a speed of 1.
    """
    chunk = wp.tid() + chunk_offset
    if engaged[chunk] == ZERO:
        return
    unknowns = int(motion[4, 0])
    rows = AREA + coefficients.size.shape[0] + 6 * unknowns
    for m in range(rows):
        lanes_out[chunk, m] = lanes8()
    tick = float(motion[4, 1])
    speed = float(motion[4, 2])
    velocity = row_of(motion, 0)
    turning = row_of(motion, 1)
    # If the speed is the unknown, only elements whose advance is larger than its rounding error
    # cut. If the velocity is the unknown, there is no such limit, because the force must not jump.
    least = wp.where(unknowns == 1, LEAST_ADVANCE * wp.length(velocity), 0.0)
    first = chunk * (CHUNK // LANES)
    last = wp.min(first + CHUNK // LANES, elements.lanes.shape[0])
    for eight in range(first, last):
        width = found[eight, WIDTH]
        if wp.max(width) > 0.0:
            add_eight(
                elements,
                coefficients,
                found,
                eight,
                width,
                velocity,
                turning,
                row_of(motion, 2),
                row_of(motion, 3),
                unknowns,
                tick,
                speed,
                chip_per_speed,
                least,
                chunk,
                lanes_out,
            )
    for m in range(rows):
        total = wp.float64(0.0)
        for lane in range(LANES):
            total += wp.float64(lanes_out[chunk, m][lane])
        sums_out[chunk, m] = total


@wp.func
def add_eight(
    elements: Elements,
    coefficients: Coefficients,
    found: Lanes2D,
    eight: int,
    width: lanes8,
    velocity: wp.vec3,
    turning: wp.vec3,
    velocity_before: wp.vec3,
    turning_before: wp.vec3,
    unknowns: int,
    tick: float,
    speed: float,
    chip_per_speed: float,
    least: float,
    chunk: int,
    sums_out: Lanes2D,
):
    """Add loads, removal rate and areas of eight cutting elements to the sums of their chunk."""
    px = elements.lanes[eight, 0]
    py = elements.lanes[eight, 1]
    pz = elements.lanes[eight, 2]
    nx = elements.lanes[eight, 3]
    ny = elements.lanes[eight, 4]
    nz = elements.lanes[eight, 5]
    sx = found[eight, SLOPE]
    sy = found[eight, SLOPE + 1]
    sz = found[eight, SLOPE + 2]
    # derivatives of advance and shift by the angular velocity
    mx = wp.cw_mul(py, nz) - wp.cw_mul(pz, ny)
    my = wp.cw_mul(pz, nx) - wp.cw_mul(px, nz)
    mz = wp.cw_mul(px, ny) - wp.cw_mul(py, nx)
    qx = wp.cw_mul(py, sz) - wp.cw_mul(pz, sy)
    qy = wp.cw_mul(pz, sx) - wp.cw_mul(px, sz)
    qz = wp.cw_mul(px, sy) - wp.cw_mul(py, sx)
    by_turn = along(turning, mx, my, mz)
    advance = along(velocity, nx, ny, nz) + by_turn
    shift_by_turn = along(turning, qx, qy, qz)
    passing = along(velocity, sx, sy, sz) + shift_by_turn
    before = along(velocity_before, sx, sy, sz) + along(turning_before, qx, qy, qz)
    cuts = wp.cw_mul(above(advance - least * lanes8(1.0)), above(width - lanes8(TINY)))
    distance = found[eight, DISTANCE] - tick * before
    share, partly, by_shift = share_below(distance, width, tick, passing, cuts)
    made = speed * advance
    chip, chip_slope, edge, edge_slope = chip_law(coefficients, found, eight, chip_per_speed, made)
    # The value at zero velocity is the force minus the contribution of the unknowns.
    made_shift = passing
    if unknowns == 3:
        made = made - speed * by_turn
        made_shift = made_shift - shift_by_turn
    chip_by_shift = wp.cw_mul(by_shift, chip)
    edge_by_shift = wp.cw_mul(by_shift, edge)
    chip_value = wp.cw_mul(share, chip - wp.cw_mul(chip_slope, made))
    edge_value = wp.cw_mul(share, edge - wp.cw_mul(edge_slope, made))
    chip_value -= wp.cw_mul(chip_by_shift, made_shift)
    edge_value -= wp.cw_mul(edge_by_shift, made_shift)
    chip_torque = chip_value
    edge_torque = edge_value
    if unknowns == 3:
        chip_torque = wp.cw_mul(share, chip)
        edge_torque = wp.cw_mul(share, edge)
    value = loads_of(found, eight, chip_value, edge_value)
    add_forces(elements, eight, value, lanes8(1.0), chunk, VALUE, sums_out)
    acting = loads_of(found, eight, chip_torque, edge_torque)
    add_torques(elements, eight, acting, lanes8(1.0), chunk, VALUE, sums_out)
    slopes = AREA + coefficients.size.shape[0]
    by_advance = loads_of(found, eight, wp.cw_mul(share, chip_slope), wp.cw_mul(share, edge_slope))
    if unknowns == 1:
        add_forces(elements, eight, by_advance, advance, chunk, slopes, sums_out)
        add_torques(elements, eight, by_advance, advance, chunk, slopes, sums_out)
    else:
        add_derivatives(
            elements, eight, by_advance, nx, ny, nz, mx, my, mz, unknowns, chunk, slopes, sums_out
        )
        if wp.max(partly) > 0.0:
            moving = loads_of(found, eight, chip_by_shift, edge_by_shift)
            add_derivatives(
                elements, eight, moving, sx, sy, sz, qx, qy, qz, unknowns, chunk, slopes, sums_out
            )
    area = wp.cw_mul(elements.areas[eight], share)
    sums_out[chunk, RATE] += wp.cw_mul(area, advance)
    layers = found[eight, LAYER]
    if wp.min(layers) == wp.max(layers):
        sums_out[chunk, AREA + int(layers[0])] += area
    else:
        for lane in range(LANES):
            part = lanes8()
            part[lane] = area[lane]
            sums_out[chunk, AREA + int(layers[lane])] += part


@wp.func
def share_below(distance: lanes8, width: lanes8, tick: float, passing: lanes8, cuts: lanes8):
    """Compute the mean part of each of eight elements that is below the surface in a tick.

    This part is called the share. At the start of the tick (1 ms step), the signed distance of the
    elements from the bone surface is ``distance`` [m], positive outside. The distance changes at
    the rate ``passing`` [m/s]. Elements for which ``cuts`` is 0 have a share of 0.

    Return the share, a flag that is 1 if the share is between 0 and 1, and the derivative of the
    share with respect to ``passing``.
    """
    one = lanes8(1.0)
    shift = tick * passing
    swept = wp.abs(shift)
    extent = wp.max(wp.max(width, swept), lanes8(TINY))
    middle = wp.cw_div(distance + 0.5 * shift, extent)
    raw = 0.5 * one - middle
    share = wp.cw_mul(wp.min(wp.max(raw, lanes8()), one), cuts)
    # derivative of the share by the shift, multiplied by the extent
    steep = wp.cw_mul(wp.cw_mul(above(swept - width), wp.sign(shift)), middle) - 0.5 * one
    partly = wp.cw_mul(wp.cw_mul(above(raw), one - above(raw - one)), cuts)
    by_shift = tick * wp.cw_div(wp.cw_mul(steep, partly), extent)
    return share, partly, by_shift


@wp.func
def chip_law(
    coefficients: Coefficients,
    found: Lanes2D,
    eight: int,
    chip_per_speed: float,
    advance: lanes8,
):
    """Compute the effective chip thickness and the share of the edge force of eight elements.

    ``advance`` is the speed along the normal [m/s]. Without a size effect, an advance of 0 gives a
    chip thickness of exactly 0.

    Return the chip thickness [m], its derivative with respect to the advance, the share of the edge
    force (0 to 1), and the derivative of this share with respect to the advance.
    """
    one = lanes8(1.0)
    thickness = chip_per_speed * advance
    is_above = above(thickness - found[eight, MINIMUM])
    inverse = wp.cw_div(one, wp.max(found[eight, MINIMUM], lanes8(TINY)))
    chip_slope = chip_per_speed * one
    chip = thickness
    edge_slope = chip_per_speed * wp.cw_mul(one - is_above, inverse)
    edge = wp.cw_mul(edge_slope, advance) + is_above
    if coefficients.has_size_effect == 1:
        for lane in range(LANES):
            size = coefficients.size[int(found[eight, LAYER][lane])]
            scale = wp.pow(wp.max(thickness[lane], wp.max(size[1], TINY)) / size[2], -size[0])
            chip[lane] = thickness[lane] * scale
            chip_slope[lane] = chip_per_speed * scale
            if thickness[lane] >= size[1]:
                chip_slope[lane] *= 1.0 - size[0]
    return chip, chip_slope, edge, edge_slope


@wp.func
def row_of(motion: Doubles2D, row: int):
    """Return the vector in ``row`` of ``motion``, converted to single precision."""
    return wp.vec3(float(motion[row, 0]), float(motion[row, 1]), float(motion[row, 2]))


@wp.func
def along(vector: wp.vec3, x: lanes8, y: lanes8, z: lanes8):
    """Return the scalar products of one vector with eight vectors."""
    return vector[0] * x + vector[1] * y + vector[2] * z


@wp.func
def above(values: lanes8):
    """Return 1 where a value is positive, 0.5 where it is 0, and 0 where it is negative."""
    return 0.5 * lanes8(1.0) + 0.5 * wp.sign(values)


@wp.func
def loads_of(found: Lanes2D, eight: int, chip: lanes8, edge: lanes8):
    """Return the loads on eight cutting elements [N].

    ``chip`` is the effective chip thickness [m], which multiplies the chip coefficients. ``edge``
    multiplies the edge coefficients.
    """
    loads = Loads()
    loads.tangential = wp.cw_mul(chip, found[eight, CHIP]) + wp.cw_mul(edge, found[eight, EDGE])
    loads.radial = wp.cw_mul(chip, found[eight, CHIP + 1]) + wp.cw_mul(edge, found[eight, EDGE + 1])
    loads.axial = wp.cw_mul(chip, found[eight, CHIP + 2]) + wp.cw_mul(edge, found[eight, EDGE + 2])
    return loads


@wp.func
def times(elements: Elements, eight: int, loads: lanes8, row: int):
    """Multiply the loads on eight elements by a row of `kernels.elements.Elements.lever`."""
    return wp.cw_mul(loads, elements.lever[eight, row])


@wp.func
def add_forces(
    elements: Elements,
    eight: int,
    loads: Loads,
    factor: lanes8,
    chunk: int,
    place: int,
    sums_out: Lanes2D,
):
    """Multiply the loads of eight elements by ``factor``, and add the resulting force to the sums.

    The sums of the chunk begin at the entry ``place``. The loads act on the bone, so the force on
    the tool has the opposite sign.
    """
    tangential = wp.cw_mul(loads.tangential, factor)
    radial = wp.cw_mul(loads.radial, factor)
    axial = wp.cw_mul(loads.axial, factor)
    sums_out[chunk, place] -= times(elements, eight, tangential, 0) + times(
        elements, eight, radial, 5
    )
    sums_out[chunk, place + 1] -= times(elements, eight, tangential, 1) + times(
        elements, eight, radial, 6
    )
    sums_out[chunk, place + 2] -= times(elements, eight, radial, 7) + axial


@wp.func
def add_torques(
    elements: Elements,
    eight: int,
    loads: Loads,
    factor: lanes8,
    chunk: int,
    place: int,
    sums_out: Lanes2D,
):
    """Multiply the loads of eight elements by ``factor``, and add the resulting torque to the sums.

    The other arguments are the same as in `add_forces`.
    """
    tangential = wp.cw_mul(loads.tangential, factor)
    radial = wp.cw_mul(loads.radial, factor)
    axial = wp.cw_mul(loads.axial, factor)
    sums_out[chunk, place + 3] -= (
        times(elements, eight, tangential, 2)
        + times(elements, eight, radial, 8)
        + times(elements, eight, axial, 12)
    )
    sums_out[chunk, place + 4] -= (
        times(elements, eight, tangential, 3)
        + times(elements, eight, radial, 9)
        + times(elements, eight, axial, 13)
    )
    sums_out[chunk, place + 5] -= times(elements, eight, tangential, 4) + times(
        elements, eight, radial, 10
    )


@wp.func
def add_derivatives(
    elements: Elements,
    eight: int,
    loads: Loads,
    x: lanes8,
    y: lanes8,
    z: lanes8,
    turn_x: lanes8,
    turn_y: lanes8,
    turn_z: lanes8,
    unknowns: int,
    chunk: int,
    place: int,
    sums_out: Lanes2D,
):
    """Add derivatives of force and torque with respect to velocities to the sums of a chunk.

    ``loads`` contains derivatives of the loads with respect to a speed of each element, for example
    the speed along the normal. The arguments ``x``, ``y`` and ``z`` are the derivatives of this
    speed with respect to the velocity of the tip. The arguments ``turn_x``, ``turn_y`` and
    ``turn_z`` are its derivatives with respect to the angular velocity. The products of ``loads``
    and these derivatives are added to the sums. With three unknowns, only the derivatives of the
    force are added.
    """
    add_forces(elements, eight, loads, x, chunk, place, sums_out)
    add_forces(elements, eight, loads, y, chunk, place + 6, sums_out)
    add_forces(elements, eight, loads, z, chunk, place + 12, sums_out)
    if unknowns == 6:
        add_forces(elements, eight, loads, turn_x, chunk, place + 18, sums_out)
        add_forces(elements, eight, loads, turn_y, chunk, place + 24, sums_out)
        add_forces(elements, eight, loads, turn_z, chunk, place + 30, sums_out)
        add_torques(elements, eight, loads, x, chunk, place, sums_out)
        add_torques(elements, eight, loads, y, chunk, place + 6, sums_out)
        add_torques(elements, eight, loads, z, chunk, place + 12, sums_out)
        add_torques(elements, eight, loads, turn_x, chunk, place + 18, sums_out)
        add_torques(elements, eight, loads, turn_y, chunk, place + 24, sums_out)
        add_torques(elements, eight, loads, turn_z, chunk, place + 30, sums_out)
