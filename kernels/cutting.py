"""Forces on the cutting elements of a rotating cutter, averaged over a revolution.

A cutting element is a small piece of the cutter's surface. The mechanistic model has chip and edge
coefficients (Altintas 2012, Manufacturing Automation, ch. 2) and a size effect. Per element::

    h  = (v . n) 2 pi / (N omega)                      chip thickness
    c  = h (max(h, h_min) / h_0) ** -m                 effective chip thickness
    e  = min(h / h_min, 1)                             share of the edge force
    dF = -(N A / (2 pi r)) [(K_tc c + K_te e) t + (K_rc c + K_re e) n + (K_ac c + K_ae e) a] share

For each element, v is the velocity, A the area, r the distance from the axis, and t, n and a are
the tangential, normal and axial directions. N is the number of teeth, and omega is the angular
speed of the spindle. m and h_0 are the exponent and the reference thickness of the size effect.
Every coefficient K is scaled by (density / reference density) ** exponent, with the reference
density and the exponent of the bone layer. Below the minimum chip thickness h_min the force is
proportional to h, so the force is a Lipschitz function of the velocity. With m = 0 and h_min = 0,
the force is linear in h. An element that does not advance along its outward normal does not cut.

The factor ``share`` is the part of the element's width that lies below the surface of the bone, see
`kernels.engagement`. In each tick (1 ms step), the share is evaluated at the middle of the
element's motion. With increasing distance from the surface, the share falls from 1 to 0. The length
of this transition is the element's width or, if larger, the element's motion through the surface in
the tick. An element that reaches the bone within the tick therefore cuts for the rest of the tick.

The kernel computes the force at a given velocity, and the derivatives of the force with respect to
the velocity (the tangent). The kernel processes eight elements at once.
"""

import warp as wp

from kernels.arrays import Doubles, Doubles2D, Vectors
from kernels.constants import ZERO
from kernels.elements import (
    CHUNK,
    LANES,
    LEAST_ADVANCE,
    Elements,
    Lanes2D,
    Lanes3,
    dot_products,
    lanes3,
    lanes8,
    vectors_in,
)
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


@wp.struct
class Rates:
    """Content of the argument ``motion`` of `cutting_forces`, in single precision."""

    velocity: wp.vec3
    turning: wp.vec3
    velocity_before: wp.vec3
    turning_before: wp.vec3
    unknowns: int
    tick: float
    speed: float
    least: float  # advance above which an element cuts


@wp.kernel
def cutting_forces(
    elements: Elements,
    coefficients: Coefficients,
    found: Lanes2D,  # [eight elements, row], see `kernels.engagement.DISTANCE`
    engaged: Doubles,  # [chunk], 1 where an element has bone
    # Rows, in the tool's frame: velocity of the tip [m/s], angular velocity [rad/s]; the velocity
    # and the angular velocity with which a tick would end at the pose of `found`; number of
    # unknowns, length of the tick [s] and speed.
    motion: Vectors,
    chip_per_speed: float,  # 2 pi / (N omega) [s]
    chunk_offset: int,
    # out
    # scratch: the sums of each of the eight lanes
    lanes_out: Lanes2D,
    # [chunk, AREA + layers + 36], tool frame, see VALUE; not written for chunks without bone
    sums_out: Doubles2D,
):
    """Sum the forces, the torques and their derivatives over one chunk of cutting elements.

    The derivatives are with respect to 1, 3 or 6 unknowns: the tool's speed; the velocity of the
    tip; or the velocity of the tip and the angular velocity. If the speed is the unknown,
    ``motion`` contains the velocities per unit of speed.
    """
    chunk = wp.tid() + chunk_offset
    if engaged[chunk] == ZERO:
        return
    rates = rates_of(motion)
    rows = AREA + coefficients.size.shape[0] + 6 * rates.unknowns
    for m in range(rows):
        lanes_out[chunk, m] = lanes8()
    first = chunk * (CHUNK // LANES)
    last = wp.min(first + CHUNK // LANES, elements.lanes.shape[0])
    for eight in range(first, last):
        if wp.max(found[eight, WIDTH]) > 0.0:
            add_eight(elements, coefficients, found, rates, chip_per_speed, eight, chunk, lanes_out)
    for m in range(rows):
        total = wp.float64(0.0)
        for lane in range(LANES):
            total += wp.float64(lanes_out[chunk, m][lane])
        sums_out[chunk, m] = total


@wp.func
def rates_of(motion: Vectors):
    """Convert the argument ``motion`` of `cutting_forces` to `Rates`."""
    rates = Rates()
    rates.velocity = wp.vec3(motion[0])
    rates.turning = wp.vec3(motion[1])
    rates.velocity_before = wp.vec3(motion[2])
    rates.turning_before = wp.vec3(motion[3])
    rates.unknowns = int(motion[4][0])
    rates.tick = float(motion[4][1])
    rates.speed = float(motion[4][2])
    # If the speed is the unknown, only elements whose advance is larger than its rounding error
    # cut. If the velocity is the unknown, there is no such limit, because the force must not jump.
    if rates.unknowns == 1:
        rates.least = LEAST_ADVANCE * wp.length(rates.velocity)
    return rates


@wp.func
def add_eight(
    elements: Elements,
    coefficients: Coefficients,
    found: Lanes2D,
    rates: Rates,
    chip_per_speed: float,
    eight: int,
    chunk: int,
    sums_out: Lanes2D,
):
    """Add loads, removal rates and areas of eight cutting elements to their chunk's sums."""
    unknowns = rates.unknowns
    width = found[eight, WIDTH]
    point = vectors_in(elements.lanes, eight, 0)
    normal = vectors_in(elements.lanes, eight, 3)
    slope = vectors_in(found, eight, SLOPE)
    # derivatives of advance and shift by the angular velocity
    advance_by_turn = crosses(point, normal)
    shift_by_turn = crosses(point, slope)
    turn_advance = dot_products(rates.turning, advance_by_turn)
    turn_shift = dot_products(rates.turning, shift_by_turn)
    advance = dot_products(rates.velocity, normal) + turn_advance
    passing = dot_products(rates.velocity, slope) + turn_shift
    before = dot_products(rates.velocity_before, slope) + dot_products(
        rates.turning_before, shift_by_turn
    )
    cuts = wp.cw_mul(above(advance - rates.least * lanes8(1.0)), above(width - lanes8(TINY)))
    distance = found[eight, DISTANCE] - rates.tick * before
    share, partly, by_shift = share_below(distance, width, rates.tick, passing, cuts)
    made = rates.speed * advance
    chip, chip_slope, edge, edge_slope = chip_law(coefficients, found, eight, chip_per_speed, made)
    # The value at zero velocity is the force minus the contribution of the unknowns.
    made_shift = passing
    if unknowns == 3:
        made = made - rates.speed * turn_advance
        made_shift = made_shift - turn_shift
    chip_by_shift = wp.cw_mul(by_shift, chip)
    edge_by_shift = wp.cw_mul(by_shift, edge)
    chip_value = wp.cw_mul(share, chip - wp.cw_mul(chip_slope, made))
    edge_value = wp.cw_mul(share, edge - wp.cw_mul(edge_slope, made))
    chip_value -= wp.cw_mul(chip_by_shift, made_shift)
    edge_value -= wp.cw_mul(edge_by_shift, made_shift)
    value = loads_of(found, eight, chip_value, edge_value)
    one = lanes8(1.0)
    add_wrench(elements, eight, value, one, 0, 3, chunk, VALUE, sums_out)
    if unknowns == 3:
        value = loads_of(found, eight, wp.cw_mul(share, chip), wp.cw_mul(share, edge))
    add_wrench(elements, eight, value, one, 3, 6, chunk, VALUE, sums_out)
    slopes = AREA + coefficients.size.shape[0]
    by_advance = loads_of(found, eight, wp.cw_mul(share, chip_slope), wp.cw_mul(share, edge_slope))
    if unknowns == 1:
        add_wrench(elements, eight, by_advance, advance, 0, 6, chunk, slopes, sums_out)
    else:
        add_derivatives(
            elements, eight, by_advance, normal, advance_by_turn, unknowns, chunk, slopes, sums_out
        )
        if wp.max(partly) > 0.0:
            moving = loads_of(found, eight, chip_by_shift, edge_by_shift)
            add_derivatives(
                elements, eight, moving, slope, shift_by_turn, unknowns, chunk, slopes, sums_out
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
    """Compute the part of each of eight elements below the bone surface, averaged over a tick.

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
    """Compute the effective chip thickness and the edge-force share of eight elements.

    ``advance`` is the speed of each element along its normal [m/s]. Without a size effect, an
    advance of 0 gives a chip thickness of exactly 0.

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
def crosses(a: Lanes3, b: Lanes3):
    """Return the vector products of eight pairs of vectors."""
    return lanes3(
        wp.cw_mul(a.y, b.z) - wp.cw_mul(a.z, b.y),
        wp.cw_mul(a.z, b.x) - wp.cw_mul(a.x, b.z),
        wp.cw_mul(a.x, b.y) - wp.cw_mul(a.y, b.x),
    )


@wp.func
def above(values: lanes8):
    """Return 1 where a value is positive, 0.5 where it is 0, and 0 where it is negative."""
    return 0.5 * lanes8(1.0) + 0.5 * wp.sign(values)


@wp.func
def loads_of(found: Lanes2D, eight: int, chip: lanes8, edge: lanes8):
    """Return the loads on eight cutting elements [N].

    ``chip`` is the effective chip thickness [m], which multiplies the chip coefficients. ``edge``
    is the share of the edge force, which multiplies the edge coefficients.
    """
    loads = Loads()
    loads.tangential = wp.cw_mul(chip, found[eight, CHIP]) + wp.cw_mul(edge, found[eight, EDGE])
    loads.radial = wp.cw_mul(chip, found[eight, CHIP + 1]) + wp.cw_mul(edge, found[eight, EDGE + 1])
    loads.axial = wp.cw_mul(chip, found[eight, CHIP + 2]) + wp.cw_mul(edge, found[eight, EDGE + 2])
    return loads


@wp.func
def add_wrench(
    elements: Elements,
    eight: int,
    loads: Loads,
    factor: lanes8,
    first: int,
    last: int,
    chunk: int,
    place: int,
    sums_out: Lanes2D,
):
    """Multiply the loads of eight elements by ``factor``, and add force and torque to the sums.

    The components ``first`` to ``last`` - 1 of force (0 to 2) and torque (3 to 5) are added. The
    sums of the chunk begin at the entry ``place``. The loads act on the bone, so the force on the
    tool has the opposite sign.
    """
    tangential = wp.cw_mul(loads.tangential, factor)
    radial = wp.cw_mul(loads.radial, factor)
    axial = wp.cw_mul(loads.axial, factor)
    # An unrolled loop takes 5 % less time than a loop from ``first`` to ``last``.
    for k in range(6):
        if k >= first and k < last:
            sums_out[chunk, place + k] -= (
                wp.cw_mul(tangential, elements.lever[eight, k])
                + wp.cw_mul(radial, elements.lever[eight, 6 + k])
                + wp.cw_mul(axial, elements.lever[eight, 12 + k])
            )


@wp.func
def add_derivatives(
    elements: Elements,
    eight: int,
    loads: Loads,
    rate: Lanes3,
    turn_rate: Lanes3,
    unknowns: int,
    chunk: int,
    place: int,
    sums_out: Lanes2D,
):
    """Add the derivatives of force and torque with respect to velocities to a chunk's sums.

    ``loads`` contains derivatives of the loads with respect to a speed of each element, for example
    the speed along the normal. ``rate`` is the derivative of this speed with respect to the tip's
    velocity. ``turn_rate`` is the derivative with respect to the angular velocity. The products of
    ``loads`` and these derivatives are added to the sums. With three unknowns, only the derivatives
    of the force are added.
    """
    last = wp.where(unknowns == 6, 6, 3)
    add_wrench(elements, eight, loads, rate.x, 0, last, chunk, place, sums_out)
    add_wrench(elements, eight, loads, rate.y, 0, last, chunk, place + 6, sums_out)
    add_wrench(elements, eight, loads, rate.z, 0, last, chunk, place + 12, sums_out)
    if unknowns == 6:
        add_wrench(elements, eight, loads, turn_rate.x, 0, 6, chunk, place + 18, sums_out)
        add_wrench(elements, eight, loads, turn_rate.y, 0, 6, chunk, place + 24, sums_out)
        add_wrench(elements, eight, loads, turn_rate.z, 0, 6, chunk, place + 30, sums_out)
