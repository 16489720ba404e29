"""Projection of a tool's shell points onto a triangulated surface.

Shell points represent the tool's surface. Each point is projected along its normal onto the nearest
triangle.
"""

import warp as wp

from kernels.arrays import Int32s, Vectors
from kernels.constants import ONE
from kernels.contact_state import NEARBY, SHELL, Body, Lists, Points, pose_of

wp.set_module_options({"max_unroll": 1})

TWICE = wp.float64(2.0)
"""Upper bound of the distance between two points of a triangle, in radii of its bounding ball."""
GRAZING = wp.float64(0.1)
"""Smallest cosine between a shell point's normal and the inward triangle normal for a contact.

The angle is 84 degrees. At this angle, the distance from the point to the triangle's plane is ten
times as long along the point's normal as along the perpendicular.
"""
EDGE = wp.float64(-1e-9)
"""Smallest barycentric weight at which a point is treated as a point of the triangle.

The value is slightly negative, so a point on an edge belongs to the triangles on both sides of the
edge.
"""


@wp.kernel
def project_shell(
    # tool
    shell_point: Vectors,  # [point], in the tool's frame [m]
    shell_normal: Vectors,
    pose_rows: Vectors,
    reach: wp.float64,  # [m]
    # body
    body: Body,
    lists: Lists,
    offset: int,
    # out
    points_out: Points,
    triangle_out: Int32s,  # [point], -1 if the point meets no triangle
):
    """Project every shell point along its normal onto the nearest triangle on this line.

    The distance along the normal must be less than ``reach`` plus the motion of the shell point
    since the last tick (1 ms step). ``reach`` is the radius [m] of the ball around the largest
    triangle.
    """
    i = wp.tid() + offset
    pose = pose_of(pose_rows, SHELL, wp.vec2d())
    place = pose.tip + pose.turn * shell_point[i]
    direction = pose.turn * shell_normal[i]
    points_out.tool_point[i] = place
    points_out.tool_normal[i] = direction
    best = reach + wp.length(place - pose.last_tip - pose.last_turn * shell_point[i])
    found = int(-1)
    weight = wp.vec3d()
    for k in range(lists.count[NEARBY]):
        triangle = lists.near[k]
        a = body.corners[triangle, 0]
        b = body.corners[triangle, 1]
        c = body.corners[triangle, 2]
        pa = body.free[a] + body.moved[a]
        away = place - pa
        limit = best + TWICE * reach
        if wp.dot(away, away) > limit * limit:
            continue
        ab = body.free[b] + body.moved[b] - pa
        ac = body.free[c] + body.moved[c] - pa
        outward = wp.cross(ab, ac)
        area = wp.length(outward)
        against = -wp.dot(direction, outward)
        if against > GRAZING * area:
            along = -wp.dot(pa - place, outward) / against
            if wp.abs(along) < best:
                hit = place + along * direction - pa
                wb = wp.dot(wp.cross(hit, ac), outward) / (area * area)
                wc = wp.dot(wp.cross(ab, hit), outward) / (area * area)
                if wb >= EDGE and wc >= EDGE and wb + wc <= ONE - EDGE:
                    best = wp.abs(along)
                    found = triangle
                    weight = wp.vec3d(ONE - wb - wc, wb, wc)
    triangle_out[i] = found
    points_out.weight[i] = weight
    points_out.ready[i] = 0


@wp.kernel
def link_points(triangle: Int32s, lists: Lists, points_out: Points):
    """Link each shell point to its triangle; a point without a triangle gets zero force."""
    for k in range(lists.count[NEARBY]):
        points_out.first[lists.near[k]] = -1
    for i in range(triangle.shape[0]):
        home = triangle[i]
        if home < 0:
            points_out.force[i] = wp.vec3d()
        else:
            points_out.following[i] = points_out.first[home]
            points_out.first[home] = i
