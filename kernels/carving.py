"""Removal of the material in voxels that a moving tool, a surface of revolution, sweeps.

For the centre of each voxel, the smallest distance from the tool so far is stored. A cut reduces
the remaining volume of a voxel to ``min(remaining, 1 - covered)``, where ``covered`` is the part of
the voxel inside the tool. Overlapping cuts leave the same bone in any order, because a minimum does
not depend on the order. The remaining volume is exact where the surfaces of an old and a new cut
are parallel. If these surfaces cross at a right angle, the remaining volume is on average a twelfth
of a voxel too large. All lengths are in voxels.

The smallest distance of each voxel to older cuts is also stored. Older cuts are all cuts except the
most recent ones. When the tool comes within reach of a block of 2 x 2 x 2 voxels, all cuts in the
block become older cuts. Behind a moving tool, a cut becomes an older cut after another 0.25 to 0.5
mm of travel. In front of a moving tool, older cuts are updated only after a change of direction.
The surface of older cuts therefore never touches the front of a moving tool. The most recent cuts
are computed from the tool's last poses, see `kernels.recent_cuts`.

Each brick (block of 8 x 8 x 8 voxels) belongs to one of ``PHASES`` groups. A kernel launch carves
only some of the groups, so that the work for a slow tool is spread over several ticks (1 ms steps).
For every group, the tool pose at the group's last visit is stored. Blocks of 2 x 2 x 2 voxels in a
brick are skipped if they are empty or out of reach of the tool's surface. Each worker (thread)
processes whole columns of bricks. It adds the removed volume to its own row of an array. Atomic
operations are not needed, and the results are the same integers on any number of threads.
"""

import warp as wp

from kernels.arrays import Int64s, Int64s2D, Vectors2D
from kernels.bricks import LOST, REACHED, Bricks, cube_behind_plane, layer_of, plane_of
from kernels.revolution import EDGE_BEND, Nearest, Revolution, nearest_on, offset_from

# Number of groups of bricks. It is a power of two, so that a remainder takes one instruction.
PHASES = 32
# The group of a brick is the remainder of its indices times these factors. With factors of 1 to 10,
# a group has at most 5 bricks under a disc of 10 bricks in any plane of the grid. Larger factors
# are not used, because neighbouring bricks must be visited at almost the same pose.
ALONG_X = 3
ALONG_Y = 2
REMAINDER = PHASES - 1
OLDER_ROW = 1 + PHASES  # first row of the poses at which cuts became older cuts
# Indices into the plan of a kernel launch.
FIRST = 0  # first group
COUNT = 1  # number of groups
BINARY = 2  # 1 for binary removal
EVERY_SIDE = 3  # 1 to carve also the bricks and blocks behind a moving tool
ORIGIN = 4  # group of the first brick
MOVED = 5  # one bit per group, 1 if its cuts become older cuts
TURNED = 6  # one bit per group, 1 if this also holds in front of the tool
PLAN = 7  # number of entries
BLOCK_REACH = 1.7320508  # half diagonal of a block of 2 voxels [voxel]
LONGEST_STEP = 1.0  # upper bound of the motion between two visits of a brick [voxel]
EDGE = float(EDGE_BEND)
# Test whether a block lies behind a tool with a radius of 8 voxels: the surface in the middle of
# the block must face away from the motion by more than the normal turns within the block.
BEHIND = 0.2
BRICK_REACH = 6.9282032  # half diagonal of a brick of 8 voxels [voxel]


@wp.kernel
def carve(
    # tool
    tool: Revolution,
    # Rows of tip [voxel] and axis. Row 0: present pose. Row 1 + g: pose at the last visit
    # of group g. Row OLDER_ROW + g: pose at which cuts of group g last became older cuts.
    pose: Vectors2D,
    plan: Int64s,  # see FIRST
    worker_count: int,
    worker_offset: int,
    # out
    bricks_out: Bricks,
    removed_out: Int64s2D,  # [worker, layer], stored steps removed in this launch
):
    """Carve the groups of voxel bricks that ``plan`` selects.

    Each of ``worker_count`` workers (threads) takes every ``worker_count``-th column of bricks
    under the tool.
    """
    worker = wp.tid() + worker_offset
    for m in range(removed_out.shape[1]):
        removed_out[worker, m] = wp.int64(0)
    tip = wp.vec3(pose[0, 0])
    axis = wp.vec3(pose[0, 1])
    low = wp.vec3i(0, 0, 0)
    high = wp.vec3i(0, 0, 0)
    for c in range(3):
        spread = tool.radius * wp.sqrt(wp.max(1.0 - axis[c] * axis[c], 0.0)) + BLOCK_REACH
        first = wp.min(tool.low * axis[c], tool.high * axis[c]) - spread
        last = wp.max(tool.low * axis[c], tool.high * axis[c]) + spread
        # 8: edge of a brick [voxel]
        low[c] = wp.max(int(wp.floor((tip[c] + first) / 8.0)), 0)
        high[c] = wp.min(int(wp.floor((tip[c] + last) / 8.0)), bricks_out.brick_of.shape[c] - 1)
    columns_y = high[1] - low[1] + 1
    columns = wp.max(high[0] - low[0] + 1, 0) * wp.max(columns_y, 0)
    column = worker
    while column < columns:
        brick = wp.vec3i(low[0] + column / columns_y, low[1] + column % columns_y, 0)
        column += worker_count
        before = int(plan[ORIGIN]) + ALONG_X * brick[0] + ALONG_Y * brick[1] + low[2]
        for visit in range(int(plan[COUNT])):
            # Along z, the distance between two bricks of a group is PHASES bricks.
            group = (int(plan[FIRST]) + visit) & REMAINDER
            brick[2] = low[2] + ((group - before) & REMAINDER)
            while brick[2] <= high[2]:
                row = int(bricks_out.brick_of[brick[0], brick[1], brick[2]])
                if row >= 0:
                    carve_brick(
                        tool,
                        pose,
                        plan,
                        axis,
                        group,
                        brick,
                        row,
                        worker,
                        bricks_out,
                        removed_out,
                    )
                brick[2] += PHASES


@wp.func
def carve_brick(
    tool: Revolution,
    pose: Vectors2D,
    plan: Int64s,
    axis: wp.vec3,
    group: int,
    brick: wp.vec3i,
    row: int,
    worker: int,
    bricks: Bricks,
    removed_out: Int64s2D,
):
    """Carve one brick, block by block.

    The normal of the tool's surface is evaluated once per block of 2 x 2 x 2 voxels.
    """
    alive = bricks.alive[row]
    if alive == wp.uint64(0):
        return
    middle = 8 * brick + wp.vec3i(4)
    centre = offset_from(pose[0, 0], middle)
    far = nearest_on(tool, centre, axis)
    if far.distance > BRICK_REACH:
        return
    bricks.touched[row] = bricks.touched[row] | wp.uint8(REACHED)
    step = offset_from(pose[1 + group, 0], middle) - centre
    moved = wp.length(step)
    kink = 1.0 / tool.cells_per_voxel  # near a kink, the slope spans one cell of the table
    # Blocks behind a moving tool have been carved already, so they are skipped to save time. Within
    # a block, the normal of a tool with a radius of 8 voxels turns by 12 degrees. Within a brick,
    # the normal of a tool with a radius of 24 voxels turns by 17 degrees. The whole block faces
    # backward if the cosine is below -0.25 (104 degrees), and the whole brick if it is below -0.7
    # (134 degrees).
    skip_behind = plan[EVERY_SIDE] == wp.int64(0) and tool.round == 1 and tool.radius > 8.0
    has_moved = int((plan[MOVED] >> wp.int64(group)) & wp.int64(1))
    has_turned = int((plan[TURNED] >> wp.int64(group)) & wp.int64(1))
    if skip_behind and tool.radius > 24.0 and wp.dot(step, far.slope) < -0.7 * moved:
        # The tool moves away, and the whole brick lies behind it.
        if has_moved == 1:
            for block in range(64):
                mark_older(row, block * 8, 1, 0, bricks)
        return
    back = centre - offset_from(pose[OLDER_ROW + group, 0], middle)
    travel = wp.length(back)
    axis_before = wp.vec3(pose[1 + group, 1])
    before = alive
    removed_before = removed_by(removed_out, worker)
    for block in range(64):
        bit = wp.uint64(1) << wp.uint64(block)
        if (alive & bit) != wp.uint64(0):
            x = (block >> 4) * 2
            y = ((block >> 2) & 3) * 2
            z = (block & 3) * 2
            shift = wp.vec3(float(x) - 3.0, float(y) - 3.0, float(z) - 3.0)
            # The distance to a convex tool is larger than its linear approximation. This test takes
            # three products and excludes most outer blocks.
            if tool.convex == 0 or far.distance + wp.dot(far.slope, shift) < BLOCK_REACH + kink:
                near = nearest_on(tool, centre + shift, axis)
                # Bone in front of the tool has not been cut, unless the tool has been here before.
                lies_behind = wp.dot(near.slope, back) > BEHIND * travel
                grows_old = wp.where(lies_behind, has_moved, has_turned)
                enters_reach = int(0)
                if near.distance < BLOCK_REACH and near.distance > BLOCK_REACH - LONGEST_STEP:
                    last = nearest_on(tool, centre + step + shift, axis_before)
                    enters_reach = wp.where(last.distance >= BLOCK_REACH, 1, 0)
                if near.distance < BLOCK_REACH and (has_moved == 1 or enters_reach == 1):
                    mark_older(row, block * 8, grows_old, enters_reach, bricks)
                if near.distance < -BLOCK_REACH:
                    clear_block(
                        near,
                        row,
                        block * 8,
                        worker,
                        bricks,
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
                            bricks,
                            removed_out,
                        )
    if alive != before:
        bricks.alive[row] = alive
    if removed_by(removed_out, worker) != removed_before:
        bricks.touched[row] = bricks.touched[row] | wp.uint8(LOST)


@wp.func
def mark_older(
    row: int,
    first: int,
    grows_old: int,
    enters_reach: int,
    bricks: Bricks,
):
    """Mark the cuts in a block of 2 x 2 x 2 voxels, except the most recent cuts, as older cuts.

    If ``enters_reach`` is 1, all cuts so far are marked. Otherwise, if ``grows_old`` is 1, only the
    cuts made before the previous call for this block are marked.
    """
    for v in range(8):
        voxel = first + v
        if enters_reach == 1:
            bricks.older[row, voxel] = bricks.swept[row, voxel]
        elif grows_old == 1:
            bricks.older[row, voxel] = bricks.middle[row, voxel]
        bricks.middle[row, voxel] = bricks.swept[row, voxel]


@wp.func
def clear_block(
    near: Nearest,
    row: int,
    first: int,
    worker: int,
    bricks: Bricks,
    removed_out: Int64s2D,
):
    """Remove a block of 2 x 2 x 2 voxels that lies completely inside the tool."""
    for v in range(8):
        voxel = first + v
        kept = int(bricks.remaining[row, voxel])
        removed_out[worker, layer_of(bricks.material[row, voxel])] += wp.int64(kept)
        bricks.remaining[row, voxel] = wp.uint16(0)
        bricks.swept[row, voxel] = wp.uint16(0)
        bricks.older[row, voxel] = wp.uint16(swept_steps(distance_at(near, corner_offset(v))))


@wp.func
def removed_by(removed: Int64s2D, worker: int):
    """Return the volume, summed over all layers, that a worker (thread) removed in this launch.

    The unit is the stored step, 1/65535 of a voxel (see `kernels.bricks.FULL`).
    """
    total = wp.int64(0)
    for m in range(removed.shape[1]):
        total += removed[worker, m]
    return total


@wp.func
def flattened(near: Nearest, offset: wp.vec3, axis: wp.vec3, step: wp.vec3):
    """Compute how much more the tool's surface bends than the surface of the swept volume.

    The bend is a sixth of the sum of the principal curvatures (see `Nearest`). The surface of the
    swept volume is straight along the path of the tool. This surface touches the tool where the
    tool's normal is perpendicular to the path. Within one voxel of a point where the surfaces
    touch, the difference is a sixth of the tool's curvature along ``step``. Elsewhere, the
    difference is 0.
    """
    length = wp.length(step)
    if length == 0.0 or near.bend >= EDGE:
        return float(0.0)
    # 6 times `bend` is the sum of the two principal curvatures, around the axis and along the
    # profile. The lower limit of half a voxel for the radius limits the curvature on the axis.
    outward = offset - wp.dot(offset, axis) * axis
    radius = wp.max(wp.length(outward), 0.5)
    around = wp.dot(near.slope, outward) / (radius * radius)
    meridional = wp.max(6.0 * near.bend - around, 0.0)
    part = wp.dot(wp.cross(axis, outward), step) / (radius * length)
    curvature = meridional + (around - meridional) * part * part
    # The normal is not perpendicular to the path, within one voxel.
    if wp.abs(wp.dot(near.slope, step)) > wp.abs(curvature) * length:
        return float(0.0)
    return curvature / 6.0


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
    bricks: Bricks,
    removed_out: Int64s2D,
):
    """Carve a block of eight voxels. ``first`` is the index of its first voxel in the brick.

    ``near`` is the point of the tool's surface nearest to the middle of the block.
    """
    plane = plane_of(near.slope)
    for v in range(8):
        offset = corner_offset(v)
        distance = distance_at(near, offset)
        facing = plane
        # mean distance over a voxel, minus the distance of its centre
        curving = 0.25 * (near.bend - flat)
        if near.bend >= EDGE:
            curving = float(0.0)
            exact = nearest_on(tool, middle + offset, axis)
            facing = plane_of(exact.slope)
            distance = exact.distance
        voxel = first + v
        stored = swept_steps(distance)
        if stored < int(bricks.swept[row, voxel]):
            bricks.swept[row, voxel] = wp.uint16(stored)
        kept = int(bricks.remaining[row, voxel])
        if kept > 0:
            target = int(65535)
            if binary == 0:
                # rounded to the nearest stored step
                target = int(65535.5 - 65535.0 * cube_behind_plane(facing, distance + curving))
            elif distance < 0.0:
                target = 0
            if kept > target:
                removed_out[worker, layer_of(bricks.material[row, voxel])] += wp.int64(
                    kept - target
                )
                bricks.remaining[row, voxel] = wp.uint16(target)


@wp.func
def corner_offset(corner: int):
    """Return the vector [voxel] from the middle of a 2 x 2 x 2 block to the centre of a voxel."""
    return wp.vec3(
        float(corner >> 2) - 0.5, float((corner >> 1) & 1) - 0.5, float(corner & 1) - 0.5
    )


@wp.func
def distance_at(near: Nearest, offset: wp.vec3):
    """Compute the distance [voxel] to the tool at an offset from the middle of a block.

    The tool is approximated by a sphere that touches the tool's surface at the point ``near``.
    """
    along = wp.dot(near.slope, offset)
    # The sphere's curvature is half of 6 bend. The distance grows by half of this curvature times
    # the square of the offset across the normal. Voxel centres lie sqrt(0.75) from the middle.
    return near.distance + along + 1.5 * near.bend * (0.75 - along * along)


@wp.func
def swept_steps(distance: float):
    """Convert the distance [voxel] of a voxel centre from the swept volume to a stored integer."""
    # 4096 steps per voxel, with 32768 for zero, up to 8 voxels. 65535 is reserved for voxels that
    # the tool has never been near.
    return wp.clamp(int(32768.5 + 4096.0 * distance), 0, 65534)
