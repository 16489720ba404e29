"""Cutting elements of a cutter's surface, and their motion.

A cutting element is a small piece of the surface. The functions compute the positions of elements
and their advances (speeds along the normal), and test whether an element may cut bone.
"""

import warp as wp

from kernels.arrays import Singles, SingleVectors, Vectors
from kernels.bricks import Bricks

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
class Lanes3:
    """Vectors of eight elements, by component."""

    x: lanes8
    y: lanes8
    z: lanes8


@wp.func
def lanes3(x: lanes8, y: lanes8, z: lanes8):
    """Return eight vectors, one for each element, with the given components."""
    vectors = Lanes3()
    vectors.x = x
    vectors.y = y
    vectors.z = z
    return vectors


@wp.func
def vectors_in(rows: Lanes2D, eight: int, first: int):
    """Return the vectors of eight elements from the three rows that store their components."""
    return lanes3(rows[eight, first], rows[eight, first + 1], rows[eight, first + 2])


@wp.func
def dot_products(vector: wp.vec3, vectors: Lanes3):
    """Return the scalar products of one vector with eight vectors."""
    return vector[0] * vectors.x + vector[1] * vectors.y + vector[2] * vectors.z


@wp.func
def products(a: Lanes3, b: Lanes3):
    """Return the scalar products of eight pairs of vectors."""
    return wp.cw_mul(a.x, b.x) + wp.cw_mul(a.y, b.y) + wp.cw_mul(a.z, b.z)


@wp.struct
class Elements:
    """Cutting elements in the cutter's frame, with the origin at the tip and z along the axis."""

    point: SingleVectors  # [m]
    lanes: Lanes2D  # [eight elements, 6]: x, y, z of points, then of normals
    normal: SingleVectors  # outward, unit
    # Factors from tangential, radial and axial loads to force and torque, for eight elements. Rows
    # for an element at r [m]: tangent t, r x t, normal n, r x n, axis a, r x a, three each. The
    # tangent is the unit direction in which the spin moves the element.
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
    """Pose of a tool, and velocities per unit of the tool's speed.

    The velocities have components along the tool's axes. The tool's axes are stored as vectors in
    the frame of the voxel grid, with lengths in voxels per metre.
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
def travel_of(motion: Vectors, spacing: float):
    """Return pose and motion of the tool in single precision, from the rows of ``motion``."""
    travel = Travel()
    travel.tip = wp.vec3(motion[0])
    travel.ex = wp.vec3(motion[1]) / spacing
    travel.ey = wp.vec3(motion[2]) / spacing
    travel.ez = wp.vec3(motion[3]) / spacing
    travel.axis = travel.ez * spacing
    travel.velocity = wp.vec3(motion[4])
    travel.turning = wp.vec3(motion[5])
    travel.turns = wp.where(wp.length(travel.turning) > 0.0, 1, 0)
    travel.least = LEAST_ADVANCE * wp.length(travel.velocity)
    return travel


@wp.func
def may_cut(
    elements: Elements,
    chunk: int,
    travel: Travel,
    spacing: float,
    everywhere: bool,
    bricks: Bricks,
):
    """Return whether an element of a chunk may advance into bone.

    The test is quick and conservative: the result may be true although no element advances into
    bone.

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
    return meets_bone(bricks, middle, ball[3] / spacing + 2.0)


@wp.func
def advance_of(elements: Elements, eight: int, travel: Travel):
    """Compute the speeds of eight elements along their normals, divided by the tool's speed."""
    normal = vectors_in(elements.lanes, eight, 3)
    advance = dot_products(travel.velocity, normal)
    if travel.turns == 1:
        point = vectors_in(elements.lanes, eight, 0)
        turning = travel.turning
        turned = lanes3(
            turning[1] * point.z - turning[2] * point.y,
            turning[2] * point.x - turning[0] * point.z,
            turning[0] * point.y - turning[1] * point.x,
        )
        advance += products(turned, normal)
    return advance


@wp.func
def place_of(elements: Elements, eight: int, travel: Travel, axis: int):
    """Compute the coordinates [voxel] of eight elements along one ``axis`` of the voxel grid."""
    row = wp.vec3(travel.ex[axis], travel.ey[axis], travel.ez[axis])
    return dot_products(row, vectors_in(elements.lanes, eight, 0)) + lanes8(travel.tip[axis])


@wp.func
def meets_bone(
    bricks: Bricks,
    middle: wp.vec3,
    radius: float,
):
    """Return whether a brick with remaining bone overlaps the box around a ball [voxel]."""
    low = wp.vec3i(0, 0, 0)
    high = wp.vec3i(0, 0, 0)
    for c in range(3):
        low[c] = wp.max(int(wp.floor((middle[c] - radius) / 8.0)), 0)
        high[c] = wp.min(int(wp.floor((middle[c] + radius) / 8.0)), bricks.brick_of.shape[c] - 1)
    for bx in range(low[0], high[0] + 1):
        for by in range(low[1], high[1] + 1):
            for bz in range(low[2], high[2] + 1):
                row = int(bricks.brick_of[bx, by, bz])
                held = wp.uint64(0)
                if row >= 0:
                    held = bricks.alive[row]
                if held != wp.uint64(0):
                    return True
    return False
