"""Cutting elements of a cutter's surface, and their motion.

A cutting element is a small piece of the surface. The functions compute the positions of elements
and their advances (speeds along the normal), and test whether an element may cut bone.
"""

import warp as wp

from kernels.arrays import Bits, Doubles2D, Int32s3D, Singles, SingleVectors

CHUNK = 128
"""Number of cutting elements per chunk. A chunk is the group that one thread processes.

The sums over the elements of each chunk are added in fixed order. The result therefore does not
depend on the number of threads.
"""


LANES = 8
"""Number of elements whose positions and advances are computed at once.

Eight elements at once, with sums outside of branches, reduce the time of the force kernel by a
tenth (see docs/performance.md).
"""
lanes8 = wp.types.vector(length=LANES, dtype=wp.float32)
Lanes2D = wp.array2d(dtype=lanes8)
# Largest advance of an element that does not cut, relative to the speed of the tip. It is more than
# the rounding error of an advance in single precision.
LEAST_ADVANCE = 1.0e-5


@wp.struct
class Elements:
    """Cutting elements in the cutter's frame, with the origin at the tip and z along the axis."""

    point: SingleVectors  # [m]
    lanes: Lanes2D  # [eight elements, 6]: x, y, z of points, then of normals
    normal: SingleVectors  # outward, unit
    # Factors from tangential, radial and axial loads to force and torque, for eight elements. Rows
    # for an element at r [m]: tangent t (x, y), r x t, normal n, r x n, axis a (z), r x a (x, y).
    # The tangent is the unit direction in which the spin moves the element.
    lever: Lanes2D
    area: Singles  # [m2]
    areas: wp.array(dtype=lanes8)  # areas of eight elements [m2], 0 after the last element
    # curvature of the tool at the element, see `kernels.revolution.Revolution`
    bend: Singles
    # mean curvature of the tool [1/m] at eight elements, 0 at an edge
    curvature: wp.array(dtype=lanes8)
    # N A / (2 pi r): mean length of cutting edge in the element [m]
    edge_length: Singles
    # centre and radius of a ball around each chunk's points [m]
    chunk_ball: wp.array(dtype=wp.vec4)
    # axis of a cone around each chunk's normals, sine of its half angle (2: no cone)
    chunk_cone: wp.array(dtype=wp.vec4)


@wp.struct
class Travel:
    """Pose of a tool, and velocities of the tool's motion if its speed is 1.

    The velocities have components along the tool's axes. The tool's axes are stored as vectors in
    the voxel grid [voxel/m].
    """

    tip: wp.vec3  # [voxel]
    ex: wp.vec3
    ey: wp.vec3
    ez: wp.vec3
    axis: wp.vec3  # unit vector, in the grid
    velocity: wp.vec3  # velocity of the tip, per unit of speed
    turning: wp.vec3  # angular velocity, per unit of speed [1/m]
    turns: wp.int32  # 1 if the tool rotates
    least: wp.float32  # largest advance of an element that does not cut, per unit of speed


@wp.func
def travel_of(motion: Doubles2D, spacing: float):
    """Return pose and motion of the tool in single precision, from the rows of ``motion``."""
    travel = Travel()
    travel.tip = wp.vec3(float(motion[0, 0]), float(motion[0, 1]), float(motion[0, 2]))
    travel.ex = wp.vec3(float(motion[1, 0]), float(motion[1, 1]), float(motion[1, 2])) / spacing
    travel.ey = wp.vec3(float(motion[2, 0]), float(motion[2, 1]), float(motion[2, 2])) / spacing
    travel.ez = wp.vec3(float(motion[3, 0]), float(motion[3, 1]), float(motion[3, 2])) / spacing
    travel.axis = travel.ez * spacing
    velocity = wp.vec3(float(motion[4, 0]), float(motion[4, 1]), float(motion[4, 2]))
    travel.velocity = velocity
    travel.turning = wp.vec3(float(motion[5, 0]), float(motion[5, 1]), float(motion[5, 2]))
    travel.turns = wp.where(wp.length(travel.turning) > 0.0, 1, 0)
    travel.least = LEAST_ADVANCE * wp.length(velocity)
    return travel


@wp.func
def may_cut(
    elements: Elements,
    chunk: int,
    travel: Travel,
    spacing: float,
    everywhere: bool,
    brick_of: Int32s3D,
    alive: Bits,
):
    """Return whether an element of a chunk may advance into bone, by a quick, conservative test.

    If `everywhere` is set, the direction of the motion is ignored, and only the distance from bone
    counts.
    """
    cone = elements.chunk_cone[chunk]
    velocity = travel.velocity
    facing = wp.dot(velocity, wp.vec3(cone[0], cone[1], cone[2])) + wp.length(velocity) * cone[3]
    # The cone bounds the advance from the feed, but not the advance from the rotation.
    if facing <= 0.0 and travel.turns == 0 and not everywhere:
        return False
    ball = elements.chunk_ball[chunk]
    middle = travel.tip + ball[0] * travel.ex + ball[1] * travel.ey + ball[2] * travel.ez
    return meets_bone(brick_of, alive, middle, ball[3] / spacing + 2.0)


@wp.func
def advance_of(elements: Elements, eight: int, travel: Travel):
    """Compute the speeds of eight elements along their normals, divided by the tool's speed."""
    nx = elements.lanes[eight, 3]
    ny = elements.lanes[eight, 4]
    nz = elements.lanes[eight, 5]
    advance = travel.velocity[0] * nx + travel.velocity[1] * ny + travel.velocity[2] * nz
    if travel.turns == 1:
        px = elements.lanes[eight, 0]
        py = elements.lanes[eight, 1]
        pz = elements.lanes[eight, 2]
        wx = travel.turning[1] * pz - travel.turning[2] * py
        wy = travel.turning[2] * px - travel.turning[0] * pz
        wz = travel.turning[0] * py - travel.turning[1] * px
        advance += wp.cw_mul(wx, nx) + wp.cw_mul(wy, ny) + wp.cw_mul(wz, nz)
    return advance


@wp.func
def place_of(elements: Elements, eight: int, travel: Travel, axis: int):
    """Compute the coordinates [voxel] of eight elements along one ``axis`` of the voxel grid."""
    along = travel.ex[axis] * elements.lanes[eight, 0] + travel.ey[axis] * elements.lanes[eight, 1]
    return along + travel.ez[axis] * elements.lanes[eight, 2] + lanes8(travel.tip[axis])


@wp.func
def meets_bone(
    brick_of: Int32s3D,
    alive: Bits,
    middle: wp.vec3,
    radius: float,
):
    """Return whether a brick with remaining bone overlaps the box around a ball [voxel]."""
    low = wp.vec3i(0, 0, 0)
    high = wp.vec3i(0, 0, 0)
    for c in range(3):
        low[c] = wp.max(int(wp.floor((middle[c] - radius) / 8.0)), 0)
        high[c] = wp.min(int(wp.floor((middle[c] + radius) / 8.0)), brick_of.shape[c] - 1)
    for bx in range(low[0], high[0] + 1):
        for by in range(low[1], high[1] + 1):
            for bz in range(low[2], high[2] + 1):
                row = int(brick_of[bx, by, bz])
                held = wp.uint64(0)
                if row >= 0:
                    held = alive[row]
                if held != wp.uint64(0):
                    return True
    return False
