"""Bone in front of each element of a rotating cutter.

An element is engaged by the share of its width that lies below a surface: the original surface of
the bone or, where a cut lies deeper, the surface that this cut has left. Distance, direction and
width of the surface are stored, so that `kernels.cutting` can evaluate the share at any velocity.

Cuts that are some visits old are taken from the voxels, see `kernels.older_cuts`. The tool's last
poses are known to rounding. At a pose displaced by d, the tool has cut to ::

    d . n - k / 2 |d - (d . n) n|**2

in front of an element with normal n and mean curvature k.
"""

import warp as wp

from kernels.bone_lookup import bone_at
from kernels.bricks import corner8f, voxel_column, voxel_row
from kernels.elements import (
    CHUNK,
    LANES,
    Elements,
    Travel,
    advance_of,
    lanes8,
    may_cut,
    place_of,
    travel_of,
)
from kernels.older_cuts import RAMP, SLOTS, bone_ahead
from kernels.revolution import EDGE_BEND, Revolution

__all__ = ["DENSITIES", "DENSITY", "DISTANCE", "FOUND", "LAYER", "SLOPE", "WIDTH", "find_bone"]

wp.set_module_options({"enable_backward": False})

DISTANCE, SLOPE, WIDTH, LAYER, DENSITY, FOUND = 0, 1, 4, 5, 6, 7
"""Rows of the bone found in front of eight elements.

The signed distance to the surface [m], positive outside the bone; its gradient by the element's
position, along the tool's axes (3 rows); the width over which the share falls from 1 to 0 [m], 0
without bone; layer; and density [kg/m3], an entry of the strength table. Then the number of rows.
"""
DENSITIES = wp.constant(20001)
"""Number of entries of the strength table.

They are for densities of 0 to 20,000 kg/m3, the largest that a bone may have.
"""
# Across the surface, an element is taken as this wide at most [voxel]. Half of it is less than the
# 1.78 voxels within which distances are interpolated, see `kernels.bone_lookup`.
WIDEST = wp.constant(3.5)
# An element parallel to the surface has no width across it [voxel].
NARROWEST = wp.constant(1.0e-3)
EDGE = wp.constant(float(EDGE_BEND))
# Distance in front of a tool held by hand at which bone is found [voxel]. A tool moves less far
# beyond the place at which its bone was found.
NEAR = wp.constant(0.2)
# Gap to the tool's last poses above which it counts, and the width of their surface [m].
CLOSE = wp.constant(2.0e-7)


@wp.kernel
def find_bone(
    # tool
    tool: Revolution,
    elements: Elements,
    # rows: tip [voxel]; tool axes x, y, z; tip's and angular velocity at unit speed, own frame;
    # 1 to find bone around the whole tool, else only in front of elements that advance, -, -
    motion: wp.array2d(dtype=wp.float64),
    # displacements to the tool's last poses and rotations to them, in the tool's frame [m], [rad];
    # the first is the present pose
    recent: wp.array2d(dtype=wp.float32),
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
    found_out: wp.array2d(dtype=lanes8),  # [eight elements, row], see `DISTANCE`
):
    """Find the bone in front of one chunk of elements."""
    chunk = wp.tid() + chunk_offset
    seen_out[chunk, SLOTS] = corner8f()
    travel = travel_of(motion, spacing)
    everywhere = motion[6, 0] != wp.float64(0.0)
    first = chunk * (CHUNK // LANES)
    last = wp.min(first + CHUNK // LANES, elements.lanes.shape[0])
    meets = may_cut(elements, chunk, travel, spacing, everywhere, brick_of, alive)
    for eight in range(first, last):
        width = lanes8()
        if meets:
            advances = advance_of(elements, eight, travel)
            x = place_of(elements, eight, travel, 0)
            y = place_of(elements, eight, travel, 1)
            z = place_of(elements, eight, travel, 2)
            distance = lanes8()
            slope_x = lanes8()
            slope_y = lanes8()
            slope_z = lanes8()
            layer = lanes8()
            density = lanes8()
            cuts = int(0)
            lane = int(0)
            while lane < LANES:
                if everywhere or advances[lane] > travel.least:
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
                        eight * LANES + lane,
                        wp.vec3(x[lane], y[lane], z[lane]),
                        everywhere,
                        recent,
                        seen_out,
                        chunk,
                    )
                    if met.width > 0.0:
                        cuts = 1
                        distance[lane] = met.distance
                        slope_x[lane] = met.slope[0]
                        slope_y[lane] = met.slope[1]
                        slope_z[lane] = met.slope[2]
                        width[lane] = met.width
                        layer[lane] = float(met.layer)
                        density[lane] = met.density
                lane += 1
            if cuts == 1:
                found_out[eight, DISTANCE] = distance
                found_out[eight, SLOPE] = slope_x
                found_out[eight, SLOPE + 1] = slope_y
                found_out[eight, SLOPE + 2] = slope_z
                found_out[eight, LAYER] = layer
                found_out[eight, DENSITY] = density
        found_out[eight, WIDTH] = width


@wp.struct
class Met:
    """Bone in front of an element, see `DISTANCE`."""

    distance: wp.float32
    slope: wp.vec3
    width: wp.float32
    layer: wp.int32
    density: wp.float32


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
    everywhere: bool,
    recent: wp.array2d(dtype=wp.float32),
    seen: wp.array2d(dtype=corner8f),
    chunk: int,
):
    """Find the bone in front of an element at ``at`` [voxel]."""
    met = Met()
    row, column = remaining_voxel(brick_of, alive, at)
    if row >= 0:
        bone = bone_at(brick_of, material, nearby, row, column, at)
        normal = elements.normal[e]
        outward = (normal[0] * travel.ex + normal[1] * travel.ey + normal[2] * travel.ez) * spacing
        met.width = 1.0
        met.distance = -1.0
        # -2 stands for deeper bone, without a slope.
        if bone.distance > -1.9:
            tangent = bone.slope - wp.dot(bone.slope, outward) * outward
            width = wp.min(wp.length(tangent) * wp.sqrt(elements.area[e]) / spacing, WIDEST)
            met.width = wp.max(width, NARROWEST)
            met.distance = bone.distance
            met.slope = wp.vec3(
                wp.dot(bone.slope, travel.ex),
                wp.dot(bone.slope, travel.ey),
                wp.dot(bone.slope, travel.ez),
            )
            met.slope *= spacing
        # Nothing of the element lies below the surface, nor will within this tick.
        margin = wp.where(everywhere, NEAR, 0.0)
        if met.distance < 0.5 * met.width + margin:
            ahead = bone_ahead(
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
            # The surface that lies deeper decides. Bone at the surface itself is engaged.
            passed = -ahead - 0.5 * RAMP
            if passed * met.width > met.distance * RAMP:
                met.distance = passed
                met.slope = -normal
                met.width = RAMP
            cut, present = cut_recently(recent, elements.point[e], normal, elements.bend[e], spacing)
            if cut - present > CLOSE and met.distance < 0.5 * met.width + margin:
                met.distance = cut / spacing
                met.slope = -normal
                met.width = CLOSE / spacing
            if met.distance >= 0.5 * met.width + margin:
                met.width = 0.0
        else:
            met.width = 0.0
        met.distance *= spacing
        met.width *= spacing
        met.layer = bone.layer
        met.density = wp.floor(wp.min(bone.density + 0.5, float(DENSITIES - 1)))
    return met


@wp.func
def cut_recently(
    recent: wp.array2d(dtype=wp.float32),
    point: wp.vec3,
    normal: wp.vec3,
    bend: float,
    spacing: float,
):
    """Return how far the tool has cut in front of an element at its last poses [m].

    The second value is that of the present pose alone.
    """
    present = float(0.0)
    most = float(0.0)
    curvature = wp.where(bend < EDGE, 3.0 * bend / spacing, 0.0)
    for j in range(recent.shape[0]):
        moved = wp.vec3(recent[j, 0], recent[j, 1], recent[j, 2])
        turned = wp.vec3(recent[j, 3], recent[j, 4], recent[j, 5])
        moved += wp.cross(turned, point)
        along = wp.dot(moved, normal)
        ahead = along - 0.5 * curvature * (wp.dot(moved, moved) - along * along)
        if j == 0:
            present = ahead
            most = ahead
        most = wp.max(most, ahead)
    return most, present


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
