"""Whether an older cut has taken the bone at a point of the tool's surface, to second order in the voxel.

Every voxel keeps its centre's distance to older cuts, without the present pass (see :mod:`kernels.carving`). Between
voxel centres the difference of this distance and that to the tool now is interpolated: it is 0 where both are the same
surface, however they curve, and negative where the older cut lies deeper. What was swept is straight along its path and
the tool is not, so along the path the difference bends as the tool does, and interpolation alone lies below it.
Lengths are in voxels.
"""

import warp as wp

from kernels.bricks import voxel_column, voxel_row
from kernels.carving import EDGE, corner_offset, distance_at
from kernels.revolution import Revolution, nearest_on, offset_from

__all__ = ["taken_before"]

wp.set_module_options({"enable_backward": False})

NEVER = wp.constant(65535)  # stored where the tool has not come near
CLEAR = wp.constant(0.9)  # more than a voxel's centre is from any point in it
SLACK = wp.constant(0.002)  # an older cut this little short of the tool's surface is the same surface
FARTHEST = wp.constant(2.0)  # a difference larger than this counts as this


@wp.func
def taken_before(
    tool: Revolution,
    pose: wp.array2d(dtype=wp.float64),
    axis: wp.vec3,
    heading: wp.vec3,
    brick_of: wp.array3d(dtype=wp.int32),
    older: wp.array2d(dtype=wp.uint16),
    row: int,
    column: int,
    point: wp.vec3,
):
    """Whether an older cut has taken ``point`` on the tool's surface, in the voxel at ``row`` and ``column``."""
    kept = int(older[row, column])
    distance = kept_distance(kept)
    if kept == NEVER or distance > CLEAR:
        return False
    if distance < -CLEAR:
        return True
    low = point - wp.vec3(0.5, 0.5, 0.5)
    ix = int(wp.floor(low[0]))
    iy = int(wp.floor(low[1]))
    iz = int(wp.floor(low[2]))
    part = low - wp.vec3(float(ix), float(iy), float(iz))
    total = float(0.0)
    counted = float(0.0)
    least = float(FARTHEST)
    most = float(-FARTHEST)
    for c in range(8):
        jx = ix + (c >> 2)
        jy = iy + ((c >> 1) & 1)
        jz = iz + (c & 1)
        at = voxel_row(brick_of, jx, jy, jz)
        kept = int(NEVER)
        if at >= 0:
            kept = int(older[at, voxel_column(jx, jy, jz)])
        if kept != NEVER:  # one without lies outside older cuts, more than a voxel off: the others speak for it
            weight = wp.where((c & 4) != 0, part[0], 1.0 - part[0])
            weight *= wp.where((c & 2) != 0, part[1], 1.0 - part[1])
            weight *= wp.where((c & 1) != 0, part[2], 1.0 - part[2])
            difference = kept_distance(kept) - tool_distance(tool, pose, axis, jx, jy, jz)
            difference = wp.clamp(difference, -FARTHEST, FARTHEST)
            counted += weight
            total += weight * difference
            least = wp.min(least, difference)
            most = wp.max(most, difference)
    # Where all corners differ alike, as on an end of an older cut that the tool has come back to, nothing bends.
    bent = wp.min(bend_below(tool, pose, axis, heading, point, part), 0.5 * (most - least))
    return total < (SLACK - bent) * counted


@wp.func
def kept_distance(kept: int):
    """Distance [voxel] of a stored one, see `kernels.carving.swept_steps`."""
    return float(kept - 32768) * (1.0 / 4096.0)


@wp.func
def tool_distance(tool: Revolution, pose: wp.array2d(dtype=wp.float64), axis: wp.vec3, ix: int, iy: int, iz: int):
    """Distance [voxel] of the centre of voxel (ix, iy, iz) to the tool now, as carving takes it."""
    middle = offset_from(pose, 0, (ix & -2) + 1, (iy & -2) + 1, (iz & -2) + 1)
    near = nearest_on(tool, middle, axis)
    offset = corner_offset(((ix & 1) << 2) | ((iy & 1) << 1) | (iz & 1))
    distance = distance_at(near, offset)
    if near.bend >= EDGE:
        exact = nearest_on(tool, middle + offset, axis)
        distance = exact.distance
    return distance


@wp.func
def bend_below(
    tool: Revolution,
    pose: wp.array2d(dtype=wp.float64),
    axis: wp.vec3,
    heading: wp.vec3,
    point: wp.vec3,
    part: wp.vec3,
):
    """How far lines between voxel centres lie below what bends as the tool does along ``heading``, of length 1."""
    tip = wp.vec3(float(pose[0, 0]), float(pose[0, 1]), float(pose[0, 2]))
    near = nearest_on(tool, point - tip, axis)
    if near.bend >= EDGE:
        return float(0.0)
    below = float(0.0)
    for k in range(3):
        below += part[k] * (1.0 - part[k]) * heading[k] * heading[k]
    return 1.5 * near.bend * below
