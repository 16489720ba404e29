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
The share is the part of the element's width that lies below the bone's original surface. It
decreases to 0 where an older cut has left no bone in front of the element.

The law is concave in the speed. The kernel returns its tangent at the given speed.
"""

import warp as wp

from kernels.bone_lookup import Bone, bone_at
from kernels.bricks import corner8f, voxel_column, voxel_row
from kernels.elements import (
    CHUNK,
    LANES,
    Elements,
    Travel,
    advance_of,
    lanes8,
    lever16,
    may_cut,
    place_of,
    travel_of,
)
from kernels.older_cuts import SLOTS, bone_left, share_left
from kernels.revolution import Revolution

__all__ = [
    "AREA",
    "CHIP_FORCE",
    "CHIP_TORQUE",
    "DENSITIES",
    "EDGE_FORCE",
    "EDGE_TORQUE",
    "RATE",
    "Coefficients",
    "cutting_forces",
]

wp.set_module_options({"enable_backward": False})

CHIP_FORCE, CHIP_TORQUE, EDGE_FORCE, EDGE_TORQUE, RATE, AREA = 0, 3, 6, 9, 12, 13
"""Places in the sums.

The first six are the derivative by the speed: force [N s/m], torque about the tip [N s]. The next
six are the tangent's value at zero speed: force [N] and torque [N m]. Then the removal rate per
unit of speed [m2] and the engaged area of each layer [m2].
"""
# Across the surface, an element is taken as this wide at most [voxel]. Half of it is less than the
# 1.78 voxels within which distances are interpolated, see `kernels.bone_lookup`.
WIDEST = wp.constant(3.5)
DENSITIES = wp.constant(20001)
"""Number of entries of the strength table.

They are for densities of 0 to 20,000 kg/m3, the largest that a bone may have.
"""
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
    # tool
    tool: Revolution,
    elements: Elements,
    coefficients: Coefficients,
    # rows: tip [voxel]; tool axes x, y, z; tip's and angular velocity, own frame; speed [m/s], -, -
    motion: wp.array2d(dtype=wp.float64),
    chip_per_speed: float,  # 2 pi / (N omega) [s]
    spacing: float,  # [m]
    chunk_offset: int,
    # grid
    brick_of: wp.array3d(dtype=wp.int32),
    material: wp.array2d(dtype=wp.uint32),
    nearby: wp.array2d(dtype=wp.uint16),
    older: wp.array2d(dtype=wp.uint16),
    alive: wp.array(dtype=wp.uint64),
    # out
    seen_out: wp.array2d(dtype=corner8f),  # [chunk, SLOTS + 1], see `kernels.older_cuts.SLOTS`
    sums_out: wp.array2d(dtype=wp.float64),  # [chunk, AREA + layers], tool frame: see CHIP_FORCE
):
    """Sum the forces on one chunk of elements, as a tangent in the speed.

    The velocities are those of unit speed, 1 m/s.
    """
    chunk = wp.tid() + chunk_offset
    for m in range(AREA, sums_out.shape[1]):
        sums_out[chunk, m] = wp.float64(0.0)
    seen_out[chunk, SLOTS] = corner8f()
    travel = travel_of(motion, spacing)
    thickness_per_advance = float(motion[6, 0]) * chip_per_speed
    chip = lever16()
    edge = lever16()
    rate = float(0.0)
    first = chunk * (CHUNK // LANES)
    last = wp.min(first + CHUNK // LANES, elements.lanes.shape[0])
    if not may_cut(elements, chunk, travel, spacing, brick_of, alive):
        last = first
    for eight in range(first, last):
        advances = advance_of(elements, eight, travel)
        x = place_of(elements, eight, travel, 0)
        y = place_of(elements, eight, travel, 1)
        z = place_of(elements, eight, travel, 2)
        # Weights of eight elements: of the chip row in the derivative, of the edge row and of the
        # chip row in the value at zero speed.
        by_speed = lanes8()  # [m]
        by_edge = lanes8()  # [m]
        by_bend = lanes8()  # [m2]
        rows = rows8()
        cuts = int(0)
        lane = int(0)
        while lane < LANES:
            e = eight * LANES + lane
            advance = advances[lane]
            at = wp.vec3(x[lane], y[lane], z[lane])
            if advance > travel.least:
                met = bone_met(
                    tool,
                    elements,
                    motion,
                    travel,
                    spacing,
                    brick_of,
                    material,
                    nearby,
                    older,
                    alive,
                    e,
                    at,
                    seen_out,
                    chunk,
                )
                if met.share > 0.0:
                    cuts = 1
                    m = met.layer
                    strength = coefficients.strength[m, met.density]
                    # of cutting edge in bone, by the bone's strength [m]
                    length = elements.edge_length[e] * met.share * strength
                    tangent = tangent_at(advance * thickness_per_advance, coefficients.size[m])
                    by_speed[lane] = length * advance * tangent.slope
                    by_edge[lane] = length
                    by_bend[lane] = length * tangent.value
                    rows[lane] = 2 * m + tangent.is_below
                    engaged = elements.area[e] * met.share
                    rate += engaged * advance
                    sums_out[chunk, AREA + m] += wp.float64(engaged)
            lane += 1
        # The sums have a loop of their own. The search for bone and the power would push them out
        # of the registers at every element: in one loop the kernel takes 1.2 times as long.
        if cuts == 1:
            for j in range(LANES):
                lever = elements.lever[eight * LANES + j]
                row = rows[j]
                loads = wp.cw_mul(coefficients.chip[row], lever)
                chip += by_speed[j] * loads
                edge += by_edge[j] * wp.cw_mul(coefficients.edge[row], lever)
                edge += by_bend[j] * loads
    chip *= chip_per_speed
    set_loads(chip, chunk, CHIP_FORCE, CHIP_TORQUE, sums_out)
    set_loads(edge, chunk, EDGE_FORCE, EDGE_TORQUE, sums_out)
    sums_out[chunk, RATE] = wp.float64(rate)


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


@wp.struct
class Met:
    """Bone in front of an element."""

    share: wp.float32  # share of the element's width that cuts, 0 without bone
    layer: wp.int32
    density: wp.int32  # [kg/m3], an entry of the strength table


@wp.func
def bone_met(
    tool: Revolution,
    elements: Elements,
    motion: wp.array2d(dtype=wp.float64),
    travel: Travel,
    spacing: float,
    brick_of: wp.array3d(dtype=wp.int32),
    material: wp.array2d(dtype=wp.uint32),
    nearby: wp.array2d(dtype=wp.uint16),
    older: wp.array2d(dtype=wp.uint16),
    alive: wp.array(dtype=wp.uint64),
    e: int,
    at: wp.vec3,
    seen: wp.array2d(dtype=corner8f),
    chunk: int,
):
    """Find the bone in front of an advancing element at ``at`` [voxel]."""
    met = Met()
    row, column = remaining_voxel(brick_of, alive, at)
    if row >= 0:
        bone = bone_at(brick_of, material, nearby, row, column, at)
        normal = elements.normal[e]
        outward = (normal[0] * travel.ex + normal[1] * travel.ey + normal[2] * travel.ez) * spacing
        share = share_below(bone, outward, elements.area[e], spacing)
        if share > 0.0:
            share *= share_left(
                bone_left(
                    tool,
                    motion,
                    travel.axis,
                    brick_of,
                    older,
                    row,
                    column,
                    at,
                    outward,
                    elements.bend[e],
                    seen,
                    chunk,
                )
            )
        met.share = share
        met.layer = bone.layer
        met.density = wp.min(int(bone.density + 0.5), DENSITIES - 1)
    return met


@wp.func
def remaining_voxel(
    brick_of: wp.array3d(dtype=wp.int32), alive: wp.array(dtype=wp.uint64), at: wp.vec3
):
    """Return row and column of the voxel at a point [voxel].

    The row is -1 where the voxel's block of eight has no bone left.
    """
    ix = int(wp.floor(at[0]))
    iy = int(wp.floor(at[1]))
    iz = int(wp.floor(at[2]))
    row = voxel_row(brick_of, ix, iy, iz)
    column = voxel_column(ix, iy, iz)
    if row >= 0:
        left = alive[row] >> wp.uint64(column >> 3)
        if (left & wp.uint64(1)) == wp.uint64(0):
            row = -1
    return row, column


@wp.func
def set_loads(
    sums: lever16, chunk: int, force: int, torque: int, sums_out: wp.array2d(dtype=wp.float64)
):
    """Write a chunk's force and torque at their places."""
    for c in range(3):
        sums_out[chunk, force + c] = wp.float64(force_of(sums)[c])
        sums_out[chunk, torque + c] = wp.float64(torque_of(sums)[c])


@wp.func
def share_below(bone: Bone, outward: wp.vec3, area: float, spacing: float):
    """Compute the share of an element's width that lies below the original surface.

    The width is taken along the slope of that surface.
    """
    share = float(1.0)
    # -2 stands for deeper bone, without a slope.
    if bone.distance > -1.9:
        tangent = bone.slope - wp.dot(bone.slope, outward) * outward
        width = wp.min(wp.length(tangent) * wp.sqrt(area) / spacing, WIDEST)
        # 1e-3: an element parallel to the surface has no width across it.
        share = wp.clamp(0.5 - bone.distance / wp.max(width, 1.0e-3), 0.0, 1.0)
    return share


@wp.func
def force_of(sums: lever16):
    """Return the force on the elements whose loads, with their levers, sum to ``sums``."""
    return -wp.vec3(sums[0] + sums[5], sums[1] + sums[6], sums[7] + sums[11])


@wp.func
def torque_of(sums: lever16):
    """Return the torque about the tip, for the same elements as in `force_of`."""
    return -wp.vec3(sums[2] + sums[8] + sums[12], sums[3] + sums[9] + sums[13], sums[4] + sums[10])
