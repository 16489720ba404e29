"""Tool as a surface of revolution: a table of signed distance over radius and height.

Lengths are in voxels.
"""

import warp as wp

__all__ = ["EDGE_BEND", "Nearest", "Revolution", "nearest_on", "offset_from"]

EDGE_BEND = 8.0
"""Bend used near an edge of the profile, where no single plane fits a block of voxels.

It marks the edge: a ball of one voxel's radius, smaller than any tool, has a bend of 1/3.
"""


@wp.struct
class Revolution:
    """Signed distance to a body of revolution, tabulated over (radius, height above the tip)."""

    distance: wp.array2d(dtype=wp.float32)  # [radius index, height index], negative inside [voxel]
    slope: wp.array2d(dtype=wp.vec2)  # gradient of the distance along (radius, height)
    # a sixth of the sum of the principal curvatures, or EDGE_BEND [voxel]
    bend: wp.array2d(dtype=wp.float32)
    height_min: wp.float32  # height of index 0 above the tip [voxel]
    cells_per_voxel: wp.float32
    radius: wp.float32  # largest radius of the body [voxel]
    low: wp.float32  # lowest and highest height of the body above the tip [voxel]
    high: wp.float32
    convex: wp.int32  # 1 where the body is convex
    # 1 where it is one smooth piece, so that the volume behind it follows from one normal
    round: wp.int32


@wp.struct
class Nearest:
    """Tool surface nearest to a point."""

    distance: wp.float32  # signed distance [voxel]
    # average contribution of curvature over a block of 2 voxels and inside each voxel [voxel]
    bend: wp.float32
    # gradient of the distance: outward, of length 1, shorter where two sides are equally near
    slope: wp.vec3


@wp.func
def nearest_on(tool: Revolution, offset: wp.vec3, axis: wp.vec3):
    """Return the tool surface at an ``offset`` [voxel] from the tip of a tool along ``axis``.

    It is interpolated bilinearly in the table.

    Over a block of 2 x 2 x 2 voxels the distances at the voxel centres exceed the tangent plane's
    by (k1 + k2) / 8 on average, and the mean over each voxel exceeds its centre's by (k1 + k2) /
    24: together ``bend``.
    """
    height = wp.dot(offset, axis)
    outward = offset - height * axis
    radius = wp.length(outward)
    u = radius * tool.cells_per_voxel
    v = (height - tool.height_min) * tool.cells_per_voxel
    i = wp.clamp(int(u), 0, tool.distance.shape[0] - 2)
    j = wp.clamp(int(wp.max(v, 0.0)), 0, tool.distance.shape[1] - 2)
    fu = u - float(i)
    fv = v - float(j)
    a = tool.distance[i, j]
    b = tool.distance[i + 1, j]
    c = tool.distance[i, j + 1]
    d = tool.distance[i + 1, j + 1]
    slope = (tool.slope[i, j] * (1.0 - fu) + tool.slope[i + 1, j] * fu) * (1.0 - fv)
    slope += (tool.slope[i, j + 1] * (1.0 - fu) + tool.slope[i + 1, j + 1] * fu) * fv
    found = Nearest()
    found.distance = (a * (1.0 - fu) + b * fu) * (1.0 - fv) + (c * (1.0 - fu) + d * fu) * fv
    found.bend = tool.bend[i, j]
    # On the axis `outward` is zero, and so is its slope.
    found.slope = (slope[0] / wp.max(radius, 1.0e-6)) * outward + slope[1] * axis
    return found


@wp.func
def offset_from(pose: wp.array2d(dtype=wp.float64), row: int, ix: int, iy: int, iz: int):
    """Return the vector [voxel] from the tip of a pose to the low corner of voxel (ix, iy, iz).

    It is computed in double precision.
    """
    return wp.vec3(
        float(wp.float64(ix) - pose[row, 0]),
        float(wp.float64(iy) - pose[row, 1]),
        float(wp.float64(iz) - pose[row, 2]),
    )
