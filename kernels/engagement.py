"""Bone in front of each cutting element of a rotating cutter.

A cutting element is a small piece of the cutter's surface. The engaged share of an element is the
part of its width that lies below the surface of the bone. This surface is the original surface or,
if a cut lies deeper, the surface of the cut. The kernel stores each element's distance from the
surface, the gradient of the distance, and the element's width. From these values, `kernels.cutting`
computes the engaged share at any velocity.

Older cuts are stored in the voxels, see `kernels.older_cuts`. The most recent cuts are not stored
yet, and are computed from the tool's last poses, see `kernels.recent_cuts`.
"""

import warp as wp

from kernels.arrays import (
    Doubles,
    Singles2D,
    Singles3D,
    SingleVectors,
    Vectors,
)
from kernels.bone_lookup import bone_at
from kernels.bricks import Bricks, corner8f, voxel_column, voxel_row
from kernels.constants import ZERO
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
from kernels.older_cuts import RAMP, SLOTS, bone_left
from kernels.recent_cuts import CLOSE, Poses, Poses2D, poses_in_front, recently_cut
from kernels.revolution import Revolution

# Indices of the rows that describe the bone in front of eight elements.
DISTANCE = 0  # signed distance to the surface [m], positive outside the bone
SLOPE = 1  # gradient of the distance by the element's position, in the tool's axes, 3 rows
WIDTH = 4  # width over which the share falls from 1 to 0 [m], 0 if there is no bone
LAYER = 5
DENSITY = 6  # [kg/m3], an entry of the strength table
MINIMUM = 7  # minimum chip thickness [m]
CHIP = 8  # forces of the whole element per chip thickness [N/m]: tangential, radial, axial
EDGE = 11  # edge forces of the whole element [N]: tangential, radial, axial
FOUND = 14  # number of rows
POSE_ROWS = 7
"""Number of rows of the array ``motion`` (pose and motion) that `find_bone` reads."""
DENSITIES = 20001
"""Number of entries per layer in the table `Coefficients.strength`.

There is one entry for each density from 0 to 20,000 kg/m3, the largest density of bone that the
library accepts.
"""
# Largest width of an element across the surface [voxel]. Half of this width is less than 1.78
# voxels, the range in which distances are interpolated, see `kernels.bone_lookup`.
WIDEST = 3.5
# Smallest width of an element across the surface [voxel]. The width of an element parallel to the
# surface would be zero.
NARROWEST = 1.0e-3
# Distance in front of a hand-held tool within which bone is found [voxel]. After a search, the tool
# moves by less than this distance before the next search.
NEAR = 0.2


@wp.struct
class Coefficients:
    """Tangential, radial and axial cutting coefficients of each layer at its reference density."""

    chip: SingleVectors  # [Pa]
    edge: SingleVectors  # [N/m]
    # [layer, density in kg/m3]: (density / reference) ** exponent
    strength: Singles2D
    # exponent m of the size effect, minimum and reference chip thickness [m]
    size: SingleVectors
    has_size_effect: wp.int32  # 1 if an exponent is not 0


@wp.kernel
def find_bone(
    # tool
    tool: Revolution,
    elements: Elements,
    coefficients: Coefficients,
    # Rows: tip [voxel]; tool axes x, y, z; velocity of the tip and angular velocity at speed 1, in
    # the tool's frame. Last row: 1 to find bone around the whole tool, 0 to find bone only in front
    # of elements that advance; 1 if the tool has turned recently; lower limit of the minimum chip
    # thickness [m].
    motion: Vectors,
    # Displacements and rotations to the tool's last poses, in the tool's frame. The first row is
    # the present pose.
    recent: Poses2D,
    spacing: float,  # [m]
    bricks: Bricks,
    chunk_offset: int,
    # out
    seen_out: wp.array2d(dtype=corner8f),  # [chunk, SLOTS + 1], see `kernels.older_cuts.SLOTS`
    # [eight elements, row, element], see `DISTANCE`; rows of elements with width 0 are not valid
    found_out: Singles3D,
    engaged_out: Doubles,  # [chunk], 1 with bone; 1 at the first launch
):
    """Find the bone in front of each cutting element of one chunk (group of elements)."""
    chunk = wp.tid() + chunk_offset
    seen_out[chunk, SLOTS] = corner8f()
    travel = travel_of(motion, spacing)
    everywhere = motion[6][0] != ZERO
    first = chunk * (CHUNK // LANES)
    last = wp.min(first + CHUNK // LANES, elements.lanes.shape[0])
    turns = motion[6][1] != ZERO
    count = elements.edge_length.shape[0]
    meets = may_cut(elements, chunk, travel, spacing, everywhere, bricks)
    poses = Poses()
    has_poses = int(0)
    enough = wp.where(everywhere, NEAR, 0.0) * spacing + CLOSE
    # If there is no bone now and there was no bone before, all widths are already 0.
    if not meets and engaged_out[chunk] == ZERO:
        last = first
    engaged = int(0)
    for eight in range(first, last):
        for lane in range(LANES):
            found_out[eight, WIDTH, lane] = 0.0
        if meets:
            gap = lanes8()
            advances = lanes8()
            if not everywhere:
                advances = advance_of(elements, eight, travel)
            x = place_of(elements, eight, travel, 0)
            y = place_of(elements, eight, travel, 1)
            z = place_of(elements, eight, travel, 2)
            near = int(0)
            probed = int(0)
            while probed < LANES and near == 0:
                at = wp.vec3(x[probed], y[probed], z[probed])
                row, _ = remaining_voxel(bricks, at)
                if row >= 0 and (everywhere or advances[probed] > travel.least):
                    near = 1
                probed += 1
            if near == 1:
                if has_poses == 0:
                    poses = poses_in_front(recent, elements, chunk, first, last, turns)
                    has_poses = 1
                gap = recently_cut(recent, elements, eight, turns, poses, enough)
            lane = int(LANES) * (1 - near)
            # The last group may have fewer than eight elements. A `for` loop up to this limit would
            # take 2 % longer.
            while lane < LANES and eight * LANES + lane < count:
                if everywhere or advances[lane] > travel.least:
                    is_met = find_bone_at(
                        tool,
                        elements,
                        coefficients,
                        motion,
                        travel,
                        spacing,
                        bricks,
                        eight,
                        lane,
                        wp.vec3(x[lane], y[lane], z[lane]),
                        gap[lane],
                        everywhere,
                        chunk,
                        seen_out,
                        found_out,
                    )
                    if is_met:
                        engaged = 1
                lane += 1
    engaged_out[chunk] = wp.float64(engaged)


@wp.func
def set_strengths(
    elements: Elements,
    coefficients: Coefficients,
    least: float,
    eight: int,
    lane: int,
    layer: int,
    density: float,
    found_out: Singles3D,
):
    """Write the cutting coefficients of an element, scaled by edge length and bone strength."""
    # length of cutting edge, multiplied by the strength factor of the bone [m]
    edge_length = elements.edge_length[eight * LANES + lane]
    length = edge_length * coefficients.strength[layer, int(density)]
    chip = length * coefficients.chip[layer]
    edge = length * coefficients.edge[layer]
    for k in range(3):
        found_out[eight, CHIP + k, lane] = chip[k]
        found_out[eight, EDGE + k, lane] = edge[k]
    found_out[eight, MINIMUM, lane] = wp.max(coefficients.size[layer][1], least)


@wp.func
def find_bone_at(
    tool: Revolution,
    elements: Elements,
    coefficients: Coefficients,
    motion: Vectors,
    travel: Travel,
    spacing: float,
    bricks: Bricks,
    eight: int,
    lane: int,
    at: wp.vec3,
    gap: float,
    everywhere: bool,
    chunk: int,
    seen_out: wp.array2d(dtype=corner8f),
    found_out: Singles3D,
):
    """Find the bone in front of an element at the position ``at`` [voxel], and write the result.

    Return whether there is bone.
    """
    e = eight * LANES + lane
    row, column = remaining_voxel(bricks, at)
    # An element that cannot reach the bone within this tick is skipped.
    margin = wp.where(everywhere, NEAR, 0.0)
    if row >= 0 and gap < margin * spacing + CLOSE:
        bone = bone_at(bricks, row, column, at)
        normal = elements.normal[e]
        outward = (normal[0] * travel.ex + normal[1] * travel.ey + normal[2] * travel.ez) * spacing
        width = float(1.0)
        distance = float(-1.0)
        slope = wp.vec3()
        # `bone_at` returns a distance of -2 and a slope of 0 deep inside the bone.
        if bone.distance > -1.9:
            tangent = bone.slope - wp.dot(bone.slope, outward) * outward
            width = wp.min(wp.length(tangent) * wp.sqrt(elements.area[e]) / spacing, WIDEST)
            width = wp.max(width, NARROWEST)
            distance = bone.distance
            slope = spacing * wp.vec3(
                wp.dot(bone.slope, travel.ex),
                wp.dot(bone.slope, travel.ey),
                wp.dot(bone.slope, travel.ez),
            )
        if distance < 0.5 * width + margin:
            left = bone_left(
                tool,
                motion,
                travel.axis,
                bricks,
                row,
                column,
                at,
                outward,
                elements.bend[e],
                seen_out,
                chunk,
            )
            # The deeper surface is used. Half of the element is engaged where older cuts have left
            # a bone length of a quarter of `RAMP`, so that rounding errors do not appear as bone.
            passed = 0.25 * RAMP - left
            if passed * width > distance * RAMP:
                distance = passed
                slope = -normal
                width = RAMP
            if gap > CLOSE and gap > distance * spacing:
                distance = gap / spacing
                slope = -normal
                width = CLOSE / spacing
            if distance < 0.5 * width + margin:
                density = wp.floor(wp.min(bone.density + 0.5, float(DENSITIES - 1)))
                found_out[eight, DISTANCE, lane] = distance * spacing
                for c in range(3):
                    found_out[eight, SLOPE + c, lane] = slope[c]
                found_out[eight, WIDTH, lane] = width * spacing
                found_out[eight, LAYER, lane] = float(bone.layer)
                found_out[eight, DENSITY, lane] = density
                least = float(motion[6][2])
                set_strengths(
                    elements, coefficients, least, eight, lane, bone.layer, density, found_out
                )
                return True
    return False


@wp.func
def remaining_voxel(bricks: Bricks, at: wp.vec3):
    """Return the storage location (row and column) of the voxel at a point [voxel].

    The row belongs to the voxel's brick. It is -1 if no bone is left in the block of 2 x 2 x 2
    voxels that contains the voxel.
    """
    ix = int(wp.floor(at[0]))
    iy = int(wp.floor(at[1]))
    iz = int(wp.floor(at[2]))
    row = voxel_row(bricks.brick_of, ix, iy, iz)
    column = voxel_column(ix, iy, iz)
    if row >= 0:
        left = bricks.alive[row] >> wp.uint64(column >> 3)
        if (left & wp.uint64(1)) == wp.uint64(0):
            row = -1
    return row, column
