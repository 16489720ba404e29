"""Length of bone in front of the tool's surface that older cuts have not removed.

Older cuts are all cuts except the most recent ones. The error of the length is of second order in
the voxel size.

For every voxel centre, the distance from older cuts is stored (see :mod:`kernels.carving`). The
difference between this distance and the distance to the present tool is interpolated between voxel
centres. Where the surfaces of the older cut and of the tool coincide, the difference is 0 for any
curvature. Where the older cut lies deeper, the difference is negative. Along the path of the tool,
the surface of an older cut is straight, but the tool is curved. The difference is therefore curved
along the path, and linear interpolation underestimates it. This error is corrected. Lengths are in
voxels.
"""

import warp as wp

from kernels.arrays import Vectors
from kernels.bricks import Bricks, Cell, cell_of, corner8f, corner8i, corners_of
from kernels.carving import EDGE, corner_offset, distance_at
from kernels.revolution import Nearest, Revolution, nearest_on, offset_from

NEVER = 65535  # stored if the tool has not been near
# Upper bound of the distance from a voxel's centre to a point in the voxel [voxel].
CLEAR = 0.9
# length of bone up to an older cut at which the whole width of an element cuts [voxel]
RAMP = 0.01
# Upper bound of the sum of RAMP and the errors of tables and tangent spheres [voxel].
ROUGH = 0.05
FARTHEST = 2.0  # upper limit of a difference [voxel]
SLOTS = 64
"""Number of 2 x 2 x 2 blocks whose distances to the tool are stored for a chunk of elements.

Four blocks along each axis are enough, because neighbouring cutting elements use the same blocks.
Each entry holds the indices of a block, and the distance, bend and slope of the tool's surface at
the middle of the block. A further entry at the end is 1 if the block entries are valid.
"""
NOWHERE = -1.0e9  # index of an empty entry


@wp.func
def bone_left(
    tool: Revolution,
    pose: Vectors,
    axis: wp.vec3,
    bricks: Bricks,
    row: int,
    column: int,
    point: wp.vec3,
    outward: wp.vec3,
    bend: float,
    seen: wp.array2d(dtype=corner8f),
    chunk: int,
):
    """Return how far [voxel] the bone extends in front of ``point`` on the tool's surface.

    The length is the distance from the tool's surface to the surface of older cuts, limited to
    `FARTHEST` (2 voxels). The length is negative where an older cut extends beyond the tool's
    surface, and equal to `FARTHEST` if no older cut is near. The point lies in the voxel that is
    stored at ``row`` and ``column`` of ``bricks``. At the point, the tool has the unit normal
    ``outward`` and the curvature ``bend``, see `Revolution`.
    """
    kept = int(bricks.older[row, column])
    distance = kept_distance(kept)
    if kept == NEVER or distance > CLEAR:
        return FARTHEST
    if distance < -CLEAR:
        return -FARTHEST
    cell = cell_of(point)
    part = cell.inside
    corners = corners_of(bricks.brick_of, cell, row)
    stored = corner8i()
    weight = corner8f()
    counted = float(0.0)
    flat = float(0.0)
    for c in range(8):
        stored[c] = NEVER
        if corners.row[c] >= 0:
            stored[c] = int(bricks.older[corners.row[c], corners.column[c]])
        away = wp.vec3(float(c >> 2), float((c >> 1) & 1), float(c & 1)) - part
        weight[c] = (1.0 - wp.abs(away[0])) * (1.0 - wp.abs(away[1])) * (1.0 - wp.abs(away[2]))
        # This corner lies more than a voxel outside older cuts, so only the other corners are used.
        if stored[c] == NEVER:
            weight[c] = 0.0
        flat += weight[c] * wp.clamp(
            kept_distance(stored[c]) - wp.dot(outward, away), -FARTHEST, FARTHEST
        )
        counted += weight[c]
    # Estimate of the length for a tool without curvature. The length computed below is larger by at
    # most 0.75 bend.
    if tool.convex == 1 and bend < EDGE and wp.abs(flat) > (ROUGH + 1.2 * bend) * counted:
        return flat / counted
    now = tool_distances(tool, pose, axis, cell, seen, chunk)
    total = float(0.0)
    least = float(FARTHEST)
    most = float(-FARTHEST)
    for c in range(8):
        if stored[c] != NEVER:
            difference = wp.clamp(kept_distance(stored[c]) - now[c], -FARTHEST, FARTHEST)
            total += weight[c] * difference
            least = wp.min(least, difference)
            most = wp.max(most, difference)
    # The bend is zero if the difference is the same at all corners, for example at the end of an
    # older cut to which the tool has returned.
    bent = wp.min(bend_below(bend, outward, part), 0.5 * (most - least))
    return total / counted + bent


@wp.func
def kept_distance(kept: int):
    """Convert a stored integer of `kernels.carving.swept_steps` to a distance [voxel]."""
    return float(kept - 32768) * (1.0 / 4096.0)


@wp.func
def tool_distances(
    tool: Revolution,
    pose: Vectors,
    axis: wp.vec3,
    cell: Cell,
    seen: wp.array2d(dtype=corner8f),
    chunk: int,
):
    """Return the distances [voxel] from the tool at its present pose to the corners of a cell.

    In each block of 2 x 2 x 2 voxels, the tool is approximated by one tangent sphere, as in
    carving. The spheres are stored in ``seen``, because neighbouring cutting elements use the same
    blocks.
    """
    found = corner8f()
    if seen[chunk, SLOTS][0] == 0.0:
        slots = int(0)
        while slots < SLOTS:
            seen[chunk, slots] = corner8f(NOWHERE)
            slots += 1
        seen[chunk, SLOTS] = corner8f(1.0)
    # bits of the axes along which the cell lies in two blocks
    odd = ((cell.x & 1) << 2) | ((cell.y & 1) << 1) | (cell.z & 1)
    block = int(0)
    # A cell lies in one or two blocks along each axis. The outer loop counts through the bits of
    # `odd`, and the inner loop through the other bits. The carry skips the bits that a loop does
    # not use.
    while block < 8:
        x = (cell.x + (block >> 2)) >> 1
        y = (cell.y + ((block >> 1) & 1)) >> 1
        z = (cell.z + (block & 1)) >> 1
        slot = ((x & 3) << 4) | ((y & 3) << 2) | (z & 3)
        kept = seen[chunk, slot]
        middle = offset_from(pose[0], wp.vec3i(2 * x + 1, 2 * y + 1, 2 * z + 1))
        near = Nearest()
        if kept[0] == float(x) and kept[1] == float(y) and kept[2] == float(z):
            near.distance = kept[3]
            near.bend = kept[4]
            near.slope = wp.vec3(kept[5], kept[6], kept[7])
        else:
            near = nearest_on(tool, middle, axis)
            seen[chunk, slot] = corner8f(
                float(x),
                float(y),
                float(z),
                near.distance,
                near.bend,
                near.slope[0],
                near.slope[1],
                near.slope[2],
            )
        c = block  # corners in this block: same bits as ``block`` where ``odd`` is 1
        while c < 8:
            offset = corner_offset(c ^ odd)
            found[c] = distance_at(near, offset)
            if near.bend >= EDGE:
                exact = nearest_on(tool, middle + offset, axis)
                found[c] = exact.distance
            c = ((c | odd) + 1) & (7 ^ odd | 8) | block
        block = ((block | (7 ^ odd)) + 1) & (odd | 8)
    return found


@wp.func
def bend_below(bend: float, outward: wp.vec3, part: wp.vec3):
    """Estimate the error [voxel] of linearly interpolated distances near a curved tool surface.

    For a convex surface, distances that are interpolated between voxel centres are too small. The
    interpolated distance is curved only along the path of the tool. The direction of the path is
    not known, so the estimate is the mean over all directions perpendicular to ``outward``. The
    estimate differs from the true interpolation error by at most the estimate itself.
    """
    if bend >= EDGE:
        return float(0.0)
    below = float(0.0)
    for k in range(3):
        below += part[k] * (1.0 - part[k]) * (1.0 - outward[k] * outward[k])
    return 0.75 * bend * below
