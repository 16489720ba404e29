"""Most recent cuts, computed from the tool's last poses.

The tool's last poses are exact up to rounding errors, so the computed surface of the most recent
cuts is more accurate than a surface from voxels. Let d be the displacement from the present pose to
an earlier pose. In front of a cutting element with the normal n and the mean curvature k, the tool
at the earlier pose has removed the bone up to this distance::

    d . n - k / 2 |d - (d . n) n|**2

Rotations of the tool are included to second order.
"""

import warp as wp

from kernels.elements import (
    LANES,
    Elements,
    Lanes3,
    dot_products,
    lanes3,
    lanes8,
    products,
    vectors_in,
)

# Number of poses between two checks whether the remaining poses can be skipped; chosen.
CHECKED = 8
# Smallest distance to the surface of the most recent cuts at which bone counts as cut [m]. It is
# also the width over which an element's share falls to 0 at this surface.
CLOSE = 2.0e-8

Poses2D = wp.array2d(dtype=wp.vec3)
"""Displacements [m] and rotations [rad] from the present pose, shape (poses, 2)."""


@wp.struct
class Poses:
    """Range of indices of the tool's last poses: from ``first`` to ``last`` - 1."""

    first: wp.int32
    last: wp.int32


@wp.func
def poses_in_front(
    recent: Poses2D,
    elements: Elements,
    chunk: int,
    first: int,
    last: int,
    turns: bool,
):
    """Return the range of earlier poses at which the tool may have cut beyond its present pose.

    A pose is included if, at that pose, an element of the chunk may have been farther forward along
    its normal than at the present pose. If the tool has turned, all poses are included. If the tool
    only advances, the range is empty.
    """
    poses = Poses()
    poses.last = recent.shape[0]
    if not turns:
        cone = elements.chunk_cone[chunk]
        axis = wp.vec3(cone[0], cone[1], cone[2])
        # Upper bound for the length of the difference between a normal and the cone's axis.
        differ = float(2.0)
        if cone[3] <= 1.0:
            differ = wp.sqrt(2.0 - 2.0 * wp.sqrt(1.0 - cone[3] * cone[3])) + 1.0e-5
        half = float(0.0)
        for eight in range(first, last):
            half = wp.max(half, 0.5 * wp.max(elements.curvature[eight]))
        present = recent[0, 0]
        curved = half * wp.dot(present, present)
        poses.first = recent.shape[0]
        poses.last = 0
        for j in range(recent.shape[0]):
            moved = recent[j, 0] - present
            reached = wp.dot(moved, axis) + wp.length(moved) * differ + curved
            if reached > 0.5 * CLOSE:
                poses.first = wp.min(poses.first, j)
                poses.last = j + 1
    return poses


@wp.func
def recently_cut(
    recent: Poses2D,
    elements: Elements,
    eight: int,
    turns: bool,
    poses: Poses,
    enough: float,
):
    """Compute how far [m] the tool has cut in front of each of eight elements at earlier poses.

    The result for an element is 0 if the tool cuts farthest at the present pose. When the results
    for all eight elements exceed ``enough`` [m], the remaining poses are skipped.
    """
    gap = lanes8()
    if poses.first >= poses.last:
        return gap
    normal = vectors_in(elements.lanes, eight, 3)
    half = 0.5 * elements.curvature[eight]
    present = cut_straight(recent[0, 0], normal, half)
    if turns:
        present = cut_turned(recent[0, 0], recent[0, 1], elements, eight, normal, half)
    most = present
    j = poses.first
    while j < poses.last:
        end = wp.min(j + CHECKED, poses.last)
        if turns:
            while j < end:
                cut = cut_turned(recent[j, 0], recent[j, 1], elements, eight, normal, half)
                most = wp.max(most, cut)
                j += 1
        else:
            while j < end:
                most = wp.max(most, cut_straight(recent[j, 0], normal, half))
                j += 1
        # The remaining poses cannot change which elements have bone within reach.
        if wp.min(most - present) > CLOSE and wp.min(most) > enough:
            j = poses.last
    for lane in range(LANES):
        if most[lane] - present[lane] > CLOSE:
            gap[lane] = most[lane]
    return gap


@wp.func
def cut_straight(moved: wp.vec3, normal: Lanes3, half: lanes8):
    """Compute the depth [m] that a displaced tool has cut in front of eight elements.

    The tool was displaced by ``moved`` [m], without rotation.
    """
    across = dot_products(moved, normal)
    square = lanes8(moved[0] * moved[0] + moved[1] * moved[1] + moved[2] * moved[2])
    return across - wp.cw_mul(half, square - wp.cw_mul(across, across))


@wp.func
def cut_turned(
    moved: wp.vec3, turn: wp.vec3, elements: Elements, eight: int, normal: Lanes3, half: lanes8
):
    """Compute the depth [m] that a displaced, rotated tool has cut in front of eight elements.

    The tool was displaced by ``moved`` [m], and rotated by ``turn`` [rad].
    """
    # To second order in the rotation w, an element at p with normal n moves by w x p, and the
    # surface at its new position rises by (w x n) . (w x p / 2 + moved). The rotation about the
    # tool's axis is omitted.
    point = vectors_in(elements.lanes, eight, 0)
    wx = turn[0]
    wy = turn[1]
    mx = lanes8(moved[0])
    my = lanes8(moved[1])
    mz = lanes8(moved[2])
    x = wy * point.z
    y = -wx * point.z
    z = wx * point.y - wy * point.x
    risen = wp.cw_mul(wy * normal.z, 0.5 * x + mx) - wp.cw_mul(wx * normal.z, 0.5 * y + my)
    risen += wp.cw_mul(wx * normal.y - wy * normal.x, 0.5 * z + mz)
    new = lanes3(x + mx, y + my, z + mz)
    across = products(new, normal)
    square = products(new, new)
    return across - wp.cw_mul(half, square - wp.cw_mul(across, across)) + risen
