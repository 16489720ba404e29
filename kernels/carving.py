"""Carving of the voxels that a moving surface of revolution sweeps.

The smallest distance between a voxel's centre and the tool so far is kept for every voxel. The
remaining volume of a voxel is ``min(remaining, 1 - covered)``, where ``covered`` is the volume of
its cube behind the tool's surface. A minimum is idempotent and commutes, so overlapping cuts give
the same bone in any order. It is exact where an old and a new surface are parallel. Where they
cross at a right angle it leaves a twelfth of a voxel too much on average. All lengths are in
voxels.

Every voxel also keeps its smallest distance to older cuts. When the tool comes within reach of a
block, all cuts so far become older cuts. Behind a moving tool, a cut becomes an older cut after
another 0.25 to 0.5 mm of travel. In front of it, older cuts are updated only after a change of
direction. Older cuts therefore never reach the front of a moving tool. The cuts since then follow
from the tool's last poses, see `kernels.recent_cuts`.

Bricks belong to one of ``PHASES`` groups. A launch visits some of the groups, so that a slow tool
spreads its carving over ticks; every group remembers the pose of its last visit. Inside a brick,
blocks of 2 x 2 x 2 voxels that are empty or that the surface cannot reach are skipped. Each worker
owns whole columns of bricks and its own booking row. There are no atomics, and the results are the
same integers on any number of threads.
"""

import warp as wp

from kernels.bricks import LOST, REACHED, cube_behind_plane, layer_of, plane_of
from kernels.revolution import EDGE_BEND, Nearest, Revolution, nearest_on, offset_from

__all__ = [
    "BINARY",
    "COUNT",
    "EVERY_SIDE",
    "FIRST",
    "MOVED",
    "ORIGIN",
    "PHASES",
    "PLAN",
    "TURNED",
    "carve",
]

wp.set_module_options({"enable_backward": False})

# Number of groups; a power of two, so that the remainder is one instruction.
PHASES = 32
# The group of a brick is the remainder of its indices times these factors. Under a disc of 10
# bricks in any plane of the grid, a group then has at most 5 bricks, with factors of 1 up to 10.
# Neighbours are visited at almost the same pose, which larger factors would not grant.
ALONG_X = 3
ALONG_Y = 2
REMAINDER = wp.constant(PHASES - 1)
OLDER_ROW = wp.constant(1 + PHASES)  # first row of poses at which cuts became older cuts
# Places in the plan of a launch.
FIRST = 0  # first group
COUNT = 1  # number of groups
BINARY = 2  # 1 for binary removal
EVERY_SIDE = 3  # 1 to carve also the bricks and blocks behind a moving tool
ORIGIN = 4  # group of the first brick
MOVED = 5  # one bit a group, 1 where its cuts become older cuts
TURNED = 6  # one bit a group, 1 where its cuts become older cuts also in front of the tool
PLAN = 7  # number of places
BLOCK_REACH = wp.constant(1.7320508)  # half diagonal of a block of 2 voxels [voxel]
LONGEST_STEP = wp.constant(1.0)  # more than the tool moves between two visits of a brick [voxel]
EDGE = wp.constant(float(EDGE_BEND))
# A block lies behind a tool of 8 voxels' radius if the surface in its middle faces away from the
# motion by more than the normal turns over the block.
BEHIND = wp.constant(0.2)
BRICK_REACH = wp.constant(6.9282032)  # half diagonal of a brick of 8 voxels [voxel]


@wp.kernel
def carve(
    # tool
    tool: Revolution,
    # row 0 now, row 1 + g last visit of group g, row OLDER_ROW + g where the cuts of group g last
    # became older cuts: tip xyz [voxel], axis xyz
    pose: wp.array2d(dtype=wp.float64),
    plan: wp.array(dtype=wp.int64),  # see FIRST
    worker_offset: int,
    worker_count: int,
    # grid
    brick_of: wp.array3d(dtype=wp.int32),
    material: wp.array2d(dtype=wp.uint32),
    # out
    remaining_out: wp.array2d(dtype=wp.uint16),
    # distance to the solid that the tool has swept, see `swept_steps`
    swept_out: wp.array2d(dtype=wp.uint16),
    middle_out: wp.array2d(dtype=wp.uint16),  # distance to the cuts up to the last `book`
    older_out: wp.array2d(dtype=wp.uint16),  # distance to older cuts
    # [brick], one bit a block of 2 x 2 x 2 voxels that may hold material
    alive_out: wp.array(dtype=wp.uint64),
    touched_out: wp.array(dtype=wp.uint8),  # [brick], flags LOST and REACHED are added
    removed_out: wp.array2d(dtype=wp.int64),  # [worker, layer], stored steps removed by this launch
):
    """Carve the planned groups.

    Each worker takes every ``worker_count``-th column of bricks under the tool.
    """
    worker = wp.tid() + worker_offset
    for m in range(removed_out.shape[1]):
        removed_out[worker, m] = wp.int64(0)
    axis = wp.vec3(float(pose[0, 3]), float(pose[0, 4]), float(pose[0, 5]))
    low = wp.vec3i(0, 0, 0)
    high = wp.vec3i(0, 0, 0)
    for c in range(3):
        spread = tool.radius * wp.sqrt(wp.max(1.0 - axis[c] * axis[c], 0.0)) + BLOCK_REACH
        first = wp.min(tool.low * axis[c], tool.high * axis[c]) - spread
        last = wp.max(tool.low * axis[c], tool.high * axis[c]) + spread
        # 8: edge of a brick [voxel]
        low[c] = wp.max(int(wp.floor((float(pose[0, c]) + first) / 8.0)), 0)
        high[c] = wp.min(int(wp.floor((float(pose[0, c]) + last) / 8.0)), brick_of.shape[c] - 1)
    columns_y = high[1] - low[1] + 1
    columns = wp.max(high[0] - low[0] + 1, 0) * wp.max(columns_y, 0)
    column = worker
    while column < columns:
        bx = low[0] + column / columns_y
        by = low[1] + column % columns_y
        column += worker_count
        before = int(plan[ORIGIN]) + ALONG_X * bx + ALONG_Y * by + low[2]
        for visit in range(int(plan[COUNT])):
            # The bricks of a group are PHASES apart along z.
            group = (int(plan[FIRST]) + visit) & REMAINDER
            bz = low[2] + ((group - before) & REMAINDER)
            while bz <= high[2]:
                row = int(brick_of[bx, by, bz])
                if row >= 0:
                    carve_brick(
                        tool,
                        pose,
                        plan,
                        axis,
                        group,
                        bx,
                        by,
                        bz,
                        row,
                        worker,
                        material,
                        remaining_out,
                        swept_out,
                        middle_out,
                        older_out,
                        alive_out,
                        touched_out,
                        removed_out,
                    )
                bz += PHASES


@wp.func
def carve_brick(
    tool: Revolution,
    pose: wp.array2d(dtype=wp.float64),
    plan: wp.array(dtype=wp.int64),
    axis: wp.vec3,
    group: int,
    bx: int,
    by: int,
    bz: int,
    row: int,
    worker: int,
    material: wp.array2d(dtype=wp.uint32),
    remaining_out: wp.array2d(dtype=wp.uint16),
    swept_out: wp.array2d(dtype=wp.uint16),
    middle_out: wp.array2d(dtype=wp.uint16),
    older_out: wp.array2d(dtype=wp.uint16),
    alive_out: wp.array(dtype=wp.uint64),
    touched_out: wp.array(dtype=wp.uint8),
    removed_out: wp.array2d(dtype=wp.int64),
):
    """Carve one brick, block by block.

    The direction of the tool's surface is evaluated once a block.
    """
    alive = alive_out[row]
    if alive == wp.uint64(0):
        return
    centre = offset_from(pose, 0, bx * 8 + 4, by * 8 + 4, bz * 8 + 4)
    far = nearest_on(tool, centre, axis)
    if far.distance > BRICK_REACH:
        return
    touched_out[row] = touched_out[row] | wp.uint8(REACHED)
    step = offset_from(pose, 1 + group, bx * 8 + 4, by * 8 + 4, bz * 8 + 4) - centre
    moved = wp.length(step)
    kink = 1.0 / tool.cells_per_voxel  # next to a kink a slope is taken across a cell of the table
    # Blocks behind a moving tool were carved before: skipping them saves time only. Over a block,
    # the normal of a tool of 8 voxels' radius turns by 12 degrees, over a brick that of 24 by 17
    # degrees. The whole block faces backward below -0.25 (104 degrees), the whole brick below -0.7
    # (134 degrees).
    skip_behind = plan[EVERY_SIDE] == wp.int64(0) and tool.round == 1 and tool.radius > 8.0
    has_moved = int((plan[MOVED] >> wp.int64(group)) & wp.int64(1))
    has_turned = int((plan[TURNED] >> wp.int64(group)) & wp.int64(1))
    if skip_behind and tool.radius > 24.0 and wp.dot(step, far.slope) < -0.7 * moved:
        # The whole brick lies behind a tool that leaves it.
        if has_moved == 1:
            for block in range(64):
                book(row, block * 8, 1, 0, swept_out, middle_out, older_out)
        return
    back = centre - offset_from(pose, OLDER_ROW + group, bx * 8 + 4, by * 8 + 4, bz * 8 + 4)
    travel = wp.length(back)
    axis_before = wp.vec3(
        float(pose[1 + group, 3]), float(pose[1 + group, 4]), float(pose[1 + group, 5])
    )
    before = alive
    booked = booked_by(removed_out, worker)
    for block in range(64):
        bit = wp.uint64(1) << wp.uint64(block)
        if (alive & bit) != wp.uint64(0):
            x = (block >> 4) * 2
            y = ((block >> 2) & 3) * 2
            z = (block & 3) * 2
            shift = wp.vec3(float(x) - 3.0, float(y) - 3.0, float(z) - 3.0)
            # The distance to a convex tool lies above its tangent: three products exclude most
            # outer blocks.
            if tool.convex == 0 or far.distance + wp.dot(far.slope, shift) < BLOCK_REACH + kink:
                near = nearest_on(tool, centre + shift, axis)
                # Bone in front of the tool has not been cut, unless the tool returns.
                lies_behind = wp.dot(near.slope, back) > BEHIND * travel
                grows_old = wp.where(lies_behind, has_moved, has_turned)
                enters_reach = int(0)
                if near.distance < BLOCK_REACH and near.distance > BLOCK_REACH - LONGEST_STEP:
                    last = nearest_on(tool, centre + step + shift, axis_before)
                    enters_reach = wp.where(last.distance >= BLOCK_REACH, 1, 0)
                if near.distance < BLOCK_REACH and (has_moved == 1 or enters_reach == 1):
                    book(row, block * 8, grows_old, enters_reach, swept_out, middle_out, older_out)
                if near.distance < -BLOCK_REACH:
                    clear_block(
                        near,
                        row,
                        block * 8,
                        worker,
                        material,
                        remaining_out,
                        swept_out,
                        older_out,
                        removed_out,
                    )
                    alive = alive ^ bit
                elif near.distance < BLOCK_REACH:
                    advance = wp.dot(near.slope, step)
                    if advance >= -0.25 * moved or not skip_behind:
                        flat = flattened(near, centre + shift, axis, step)
                        carve_block(
                            tool,
                            axis,
                            centre + shift,
                            near,
                            flat,
                            int(plan[BINARY]),
                            row,
                            block * 8,
                            worker,
                            material,
                            remaining_out,
                            swept_out,
                            removed_out,
                        )
    if alive != before:
        alive_out[row] = alive
    if booked_by(removed_out, worker) != booked:
        touched_out[row] = touched_out[row] | wp.uint8(LOST)


@wp.func
def book(
    row: int,
    first: int,
    grows_old: int,
    enters_reach: int,
    swept: wp.array2d(dtype=wp.uint16),
    middle_out: wp.array2d(dtype=wp.uint16),
    older_out: wp.array2d(dtype=wp.uint16),
):
    """Turn cuts in a block into older cuts.

    With ``grows_old``, these are the cuts up to the previous call for the block. With
    ``enters_reach``, these are all cuts so far.
    """
    for v in range(8):
        voxel = first + v
        if enters_reach == 1:
            older_out[row, voxel] = swept[row, voxel]
        elif grows_old == 1:
            older_out[row, voxel] = middle_out[row, voxel]
        middle_out[row, voxel] = swept[row, voxel]


@wp.func
def clear_block(
    near: Nearest,
    row: int,
    first: int,
    worker: int,
    material: wp.array2d(dtype=wp.uint32),
    remaining_out: wp.array2d(dtype=wp.uint16),
    swept_out: wp.array2d(dtype=wp.uint16),
    older_out: wp.array2d(dtype=wp.uint16),
    removed_out: wp.array2d(dtype=wp.int64),
):
    """Remove a block that lies inside the tool as a whole."""
    for v in range(8):
        voxel = first + v
        kept = int(remaining_out[row, voxel])
        removed_out[worker, layer_of(material[row, voxel])] += wp.int64(kept)
        remaining_out[row, voxel] = wp.uint16(0)
        swept_out[row, voxel] = wp.uint16(0)
        older_out[row, voxel] = wp.uint16(swept_steps(distance_at(near, corner_offset(v))))


@wp.func
def booked_by(removed: wp.array2d(dtype=wp.int64), worker: int):
    """Return the stored steps that a worker has removed in this launch, over all layers."""
    total = wp.int64(0)
    for m in range(removed.shape[1]):
        total += removed[worker, m]
    return total


@wp.func
def flattened(near: Nearest, offset: wp.vec3, axis: wp.vec3, step: wp.vec3):
    """Compute the part of the tool's `bend` that its swept surface lacks.

    It is the curvature along ``step`` where the tool slides, else 0. The swept volume is straight
    along the path. Its surface touches the tool's where the tool's normal is perpendicular to the
    path, here within a voxel.
    """
    length = wp.length(step)
    if length == 0.0 or near.bend >= EDGE:
        return float(0.0)
    # 6 times `bend` is the sum of both principal curvatures: around the axis and along the profile.
    # Half a voxel bounds the curvature on the axis.
    outward = offset - wp.dot(offset, axis) * axis
    radius = wp.max(wp.length(outward), 0.5)
    around = wp.dot(near.slope, outward) / (radius * radius)
    meridional = wp.max(6.0 * near.bend - around, 0.0)
    part = wp.dot(wp.cross(axis, outward), step) / (radius * length)
    along = meridional + (around - meridional) * part * part
    # The normal is not perpendicular to the path within a voxel.
    if wp.abs(wp.dot(near.slope, step)) > wp.abs(along) * length:
        return float(0.0)
    return along / 6.0


@wp.func
def carve_block(
    tool: Revolution,
    axis: wp.vec3,
    middle: wp.vec3,
    near: Nearest,
    flat: float,
    binary: int,
    row: int,
    first: int,
    worker: int,
    material: wp.array2d(dtype=wp.uint32),
    remaining_out: wp.array2d(dtype=wp.uint16),
    swept_out: wp.array2d(dtype=wp.uint16),
    removed_out: wp.array2d(dtype=wp.int64),
):
    """Carve eight voxels around ``near``, the tool surface nearest to the middle of their block."""
    plane = plane_of(near.slope)
    for v in range(8):
        offset = corner_offset(v)
        distance = distance_at(near, offset)
        facing = plane
        # the mean over a voxel exceeds its centre's distance by this
        curving = 0.25 * (near.bend - flat)
        if near.bend >= EDGE:
            curving = float(0.0)
            exact = nearest_on(tool, middle + offset, axis)
            facing = plane_of(exact.slope)
            distance = exact.distance
        voxel = first + v
        stored = swept_steps(distance)
        if stored < int(swept_out[row, voxel]):
            swept_out[row, voxel] = wp.uint16(stored)
        kept = int(remaining_out[row, voxel])
        if kept > 0:
            target = int(65535)
            if binary == 0:
                # rounded to the nearest stored step
                target = int(65535.5 - 65535.0 * cube_behind_plane(facing, distance + curving))
            elif distance < 0.0:
                target = 0
            if kept > target:
                removed_out[worker, layer_of(material[row, voxel])] += wp.int64(kept - target)
                remaining_out[row, voxel] = wp.uint16(target)


@wp.func
def corner_offset(corner: int):
    """Return the vector [voxel] from the middle of a 2 x 2 x 2 block to a voxel centre."""
    return wp.vec3(
        float(corner >> 2) - 0.5, float((corner >> 1) & 1) - 0.5, float(corner & 1) - 0.5
    )


@wp.func
def distance_at(near: Nearest, offset: wp.vec3):
    """Compute the distance [voxel] to the tool at an offset from the middle of a block.

    The tool is approximated by a tangent sphere.
    """
    along = wp.dot(near.slope, offset)
    # The sphere's curvature is half of 6 bend, and distance grows by half of it times the square of
    # the offset across the normal; voxel centres lie sqrt(0.75) from the middle.
    return near.distance + along + 1.5 * near.bend * (0.75 - along * along)


@wp.func
def swept_steps(distance: float):
    """Convert a distance [voxel] to the stored distance to the swept solid."""
    # 4096 steps a voxel around 32768, up to 8 voxels; 65535 is kept free for a voxel that was never
    # near.
    return wp.clamp(int(32768.5 + 4096.0 * distance), 0, 65534)
