"""Search for points of a tool that may touch obstacles, and for the planes that limit their motion.

Shell points represent the tool's surface. A contact constrains a shell point to stay above a plane.
A shell point that is far from all obstacles sleeps. A sleeping point is not checked until the tool
has travelled the distance from the point to the nearest obstacle. Near bone voxels, up to two
earlier planes of a point are kept in addition to the point's present plane. With only one plane, a
point in an inner corner would alternate between the faces of the corner (Zilles and Salisbury
1995). A kept plane is dropped as soon as it would exclude space that is free according to the
present distance.
"""

import warp as wp

from kernels.arrays import Doubles, Doubles2D, Int32s, Vectors, Vectors2D
from kernels.constants import ZERO
from kernels.voxmap import Field, box_distance, voxel_clearance, voxel_level

wp.set_module_options({"max_unroll": 1})

VOXEL_PLANES = 3
"""Number of planes per shell point near voxels: the present plane and two earlier planes."""
NO_DISTANCE = wp.float64(1.0e30)  # no distance yet [m]
AHEAD = wp.float64(4.0)
"""Largest travel, in step lengths, by which a sleeping point may be checked early.

A sleeping point is a shell point far from all obstacles, which is not checked for some time. The
limit reduces the number of points that are checked on a long path.
"""
LEAST_SLOPE = wp.float64(0.5)
"""Lower limit of the slope in the ratio level / slope, which is the assumed distance of a point.

The level is an approximate signed distance from bone voxels. With this limit, the assumed distance
is at most 0.5 voxels outside the bone and 1.5 voxels inside.
"""
SAME_DIRECTION = wp.float64(0.99999999)
"""Cosine of the angle up to which two planes count as equal.

The angle is 1.4e-4 rad, which is larger than rounding errors.
"""
SLACK = wp.float64(1.0e-3)
"""Depth of free space [voxel] that an earlier contact plane may exclude before it is dropped."""


@wp.struct
class Shell:
    """Tool represented by balls of equal radius, whose centres are the shell points."""

    point: Vectors  # in the tool's frame [m]
    radius: wp.float64  # [m]
    reach: wp.float64  # largest distance of a point from the tool's origin [m]


@wp.struct
class Contacts:
    """Contact state of a tool's shell points, and work arrays of the contact solver.

    The arrays have one entry per slot. A slot is a pair (shell point, box) or a pair (shell
    point, plane near voxels).
    """

    slots: int  # a point
    normal_force: Doubles  # [slot], normal force / coupling's stiffness [m]
    check_travel: Doubles  # [point], travel at which the point must be checked [m]
    plane_normal: Vectors2D  # [point, plane], zero where there is no plane
    plane_offset: Doubles2D  # [m]
    # candidates of the present pose
    slot: Int32s
    arm: Vectors  # from the tool's origin, in world axes [m]
    normal: Vectors
    moment: Vectors  # arm x normal [m]
    gap: Doubles  # [m]
    chosen: Int32s  # 1 for a member of the active set
    # active set
    member: Int32s
    lower: Doubles2D
    side: Doubles2D


@wp.func
def add_candidate(
    contacts: Contacts, count: int, slot: int, arm: wp.vec3d, normal: wp.vec3d, gap: wp.float64
):
    """Add a plane that bounds the motion of a shell point, and return the new number of planes."""
    contacts.slot[count] = slot
    contacts.arm[count] = arm
    contacts.normal[count] = normal
    contacts.moment[count] = wp.cross(arm, normal)
    contacts.gap[count] = gap
    return count + 1


@wp.func
def forget(
    plane_normal_out: Vectors2D,
    press_out: Doubles,
    point: int,
    first: int,
):
    """Drop all contact planes of a shell point that is no longer near voxels."""
    if wp.length_sq(plane_normal_out[point, 0]) > ZERO:
        for k in range(VOXEL_PLANES):
            plane_normal_out[point, k] = wp.vec3d()
            press_out[first + k] = ZERO


@wp.func
def keep_plane(contacts: Contacts, point: int, first: int):
    """Replace the earlier plane that has the smaller force with the present plane of a point."""
    k = int(1)
    if contacts.normal_force[first + 1] > contacts.normal_force[first + 2]:
        k = int(2)
    contacts.plane_normal[point, k] = contacts.plane_normal[point, 0]
    contacts.plane_offset[point, k] = contacts.plane_offset[point, 0]
    contacts.normal_force[first + k] = contacts.normal_force[first]
    contacts.normal_force[first] = ZERO


@wp.func
def collect_voxels(
    field: Field,
    contacts: Contacts,
    point: int,
    first: int,
    arm: wp.vec3d,
    at: wp.vec3d,
    step: wp.float64,
    found: int,
):
    """Find the planes that bound the motion of one shell point near voxels.

    ``found`` is the number of planes so far. Return the new number of planes, the level [m]
    (approximate distance of the point), and the distance [m] over which the point certainly meets
    no obstacle.
    """
    count = found
    far = voxel_clearance(field, at)
    if far > step:
        forget(contacts.plane_normal, contacts.normal_force, point, first)
        return count, far, far
    level, slope = voxel_level(field, at)
    size = wp.length(slope)
    gap = level / wp.max(size, LEAST_SLOPE)
    # If all voxels around the point are equal, there is no outward direction and therefore no
    # plane.
    if size == ZERO:
        forget(contacts.plane_normal, contacts.normal_force, point, first)
        return count, step, ZERO
    normal = slope / size
    held = contacts.plane_normal[point, 0]
    if contacts.normal_force[first] > ZERO and wp.dot(held, normal) < SAME_DIRECTION:
        keep_plane(contacts, point, first)
    contacts.plane_normal[point, 0] = normal
    contacts.plane_offset[point, 0] = wp.dot(normal, at) - gap
    if gap < step:
        count = add_candidate(contacts, count, first, arm, normal, gap)
    else:
        contacts.normal_force[first] = ZERO
    for k in range(1, VOXEL_PLANES):
        held = contacts.plane_normal[point, k]
        above = wp.dot(held, at) - contacts.plane_offset[point, k]
        if wp.length_sq(held) > ZERO:
            cuts = above < gap - SLACK * field.spacing
            if cuts or above > step or wp.dot(held, normal) > SAME_DIRECTION:
                contacts.plane_normal[point, k] = wp.vec3d()
                contacts.normal_force[first + k] = ZERO
            else:
                count = add_candidate(contacts, count, first + k, arm, held, above)
    return count, level, ZERO  # unlike the gap, the level does not jump between cells


@wp.func
def collect(
    field: Field,
    shell: Shell,
    contacts: Contacts,
    position: wp.vec3d,
    turn: wp.mat33d,
    travel: wp.float64,
    wanted: wp.float64,
    step: wp.float64,
):
    """Collect all planes that are closer than ``step`` [m] to a shell point.

    Return the number of planes, the smallest gap [m], and the path length [m] over which no point
    meets an obstacle.

    A point that is far from all obstacles sleeps, that is, it is not checked for some time. A
    sleeping point is checked early, by at most ``AHEAD`` step lengths, if it would otherwise limit
    the free path length to less than ``wanted`` [m].
    """
    early = wp.min(wanted, AHEAD * step)
    count = int(0)
    worst = NO_DISTANCE
    clear = NO_DISTANCE
    boxes = field.centre.shape[0]
    for i in range(shell.point.shape[0]):
        asleep = contacts.check_travel[i] - travel
        if asleep > early:
            clear = wp.min(clear, asleep + step)
        else:
            arm = turn * shell.point[i]
            at = position + arm
            bound = NO_DISTANCE
            first = i * contacts.slots
            for s in range(boxes):
                distance, normal = box_distance(field, s, at)
                gap = distance - shell.radius
                bound = wp.min(bound, gap)
                if gap < step:
                    # The contact point lies on the surface of the ball, which distinguishes rolling
                    # from sliding.
                    count = add_candidate(
                        contacts, count, first + s, arm - shell.radius * normal, normal, gap
                    )
                    worst = wp.min(worst, gap)
                else:
                    contacts.normal_force[first + s] = ZERO
            if field.spacing > ZERO:
                count, gap, far = collect_voxels(
                    field, contacts, i, first + boxes, arm, at, step, count
                )
                bound = wp.min(bound, far)
                worst = wp.min(worst, gap)
            if bound > step:
                contacts.check_travel[i] = travel + bound - step
            clear = wp.min(clear, wp.max(bound, step))
    return count, worst, clear
