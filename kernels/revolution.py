"""Tool as a body of revolution, stored as a table of signed distances by radius and height.

Lengths are in voxels.
"""

import warp as wp

from kernels.arrays import Singles2D

EDGE_BEND = 8.0
"""Value of `Revolution.bend` that marks an edge of the tool's profile.

The bend is a sixth of the sum of the principal curvatures. Near an edge, the tool's surface in a
block of voxels cannot be approximated by one plane.

The bend of a smooth surface is always smaller. Even a ball with a radius of one voxel, which is
smaller than any tool, has a bend of 1/3.
"""


@wp.struct
class Revolution:
    """Signed distance to a body of revolution as a table over radius and height above the tip."""

    distance: Singles2D  # [radius index, height index], negative inside [voxel]
    slope: wp.array2d(dtype=wp.vec2)  # gradient of the distance along (radius, height)
    # a sixth of the sum of the principal curvatures, or EDGE_BEND [voxel]
    bend: Singles2D
    height_min: wp.float32  # height of index 0 above the tip [voxel]
    cells_per_voxel: wp.float32
    radius: wp.float32  # largest radius of the body [voxel]
    low: wp.float32  # lowest and highest point of the body above the tip [voxel]
    high: wp.float32
    convex: wp.int32  # 1 where the body is convex
    # 1 if the body is one smooth piece, so that one normal gives the volume behind its surface
    round: wp.int32


@wp.struct
class Nearest:
    """Distance of a point from the tool, distance gradient, and bend of the tool's surface."""

    distance: wp.float32  # signed distance [voxel]
    # average contribution of curvature in a block of 2 voxels and inside each voxel [voxel]
    bend: wp.float32
    # Gradient of the distance. It points outward and has length 1, or less where two sides are
    # equally near.
    slope: wp.vec3


@wp.func
def nearest_on(tool: Revolution, offset: wp.vec3, axis: wp.vec3):
    """Return the distance of a point from the tool, the gradient, and the bend of the surface.

    ``offset`` [voxel] is the vector from the tool's tip to the point, and ``axis`` is the direction
    of the tool's axis.

    The distance and the gradient are interpolated bilinearly in the tool's table. The bend is not
    interpolated.

    The bend is (k1 + k2) / 6, with the principal curvatures k1 and k2 of the tool's surface. It is
    the sum of two corrections. First, in a block of 2 x 2 x 2 voxels, a voxel centre is on average
    (k1 + k2) / 8 farther from the tool than from the tangent plane. Second, the mean distance over
    a voxel exceeds the distance at the voxel's centre by (k1 + k2) / 24.
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
    # On the axis, `outward` and the radial slope are zero.
    found.slope = (slope[0] / wp.max(radius, 1.0e-6)) * outward + slope[1] * axis
    return found


@wp.func
def offset_from(tip: wp.vec3d, voxel: wp.vec3i):
    """Return the vector [voxel] from the tool's tip to the lowest corner of a voxel.

    The lowest corner has the smallest x, y and z. The difference is computed in double precision
    and returned in single precision.
    """
    return wp.vec3(wp.vec3d(voxel) - tip)
