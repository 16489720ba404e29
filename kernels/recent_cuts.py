"""Most recent cuts, computed from the tool's last poses.

The tool's last poses are exact up to rounding errors, so the computed surface of the most recent
cuts is more accurate than a surface from voxels. Let d be the displacement from the present pose to
an earlier pose. In front of a cutting element with the normal n and the mean curvature k, the tool
at the earlier pose has removed the bone up to this distance::

    d . n - k / 2 |d - (d . n) n|**2

Rotations of the tool are included to second order.
"""

import warp as wp

from kernels.arrays import Singles2D
from kernels.elements import LANES, Elements, lanes8

# Number of poses between two checks whether the remaining poses can be skipped; chosen.
CHECKED = 8
# Smallest distance to the surface of the most recent cuts at which bone counts as cut [m]. It is
# also the width over which an element's share falls to 0 at this surface.
CLOSE = 2.0e-8


@wp.struct
class Poses:
    """Range of indices of the tool's last poses: from ``first`` to ``last`` - 1."""

    first: wp.int32
    last: wp.int32


@wp.func
def poses_in_front(
    recent: Singles2D,
    elements: Elements,
    chunk: int,
    first: int,
    last: int,
    turns: bool,
):
    """Return the range of earlier poses at which the tool may have cut farther than now.

    A pose is included if an element of the chunk may have been farther along its normal than at the
    present pose. If the tool has turned, all poses are included. If the tool only advances, the
    range is empty.
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
        present = wp.vec3(recent[0, 0], recent[0, 1], recent[0, 2])
        curved = half * wp.dot(present, present)
        poses.first = recent.shape[0]
        poses.last = 0
        for j in range(recent.shape[0]):
            moved = wp.vec3(recent[j, 0], recent[j, 1], recent[j, 2]) - present
            reached = wp.dot(moved, axis) + wp.length(moved) * differ + curved
            if reached > 0.5 * CLOSE:
                poses.first = wp.min(poses.first, j)
                poses.last = j + 1
    return poses


@wp.func
def recently_cut(
    recent: Singles2D,
    elements: Elements,
    eight: int,
    turns: bool,
    poses: Poses,
    enough: float,
):
    """Compute how far [m] in front of eight elements the tool has cut at earlier poses.

    If the tool cuts farthest at the present pose, the result for the element is 0. When the results
    for all eight elements exceed ``enough`` [m], the remaining poses are skipped.
    """
    gap = lanes8()
    if poses.first >= poses.last:
        return gap
    nx = elements.lanes[eight, 3]
    ny = elements.lanes[eight, 4]
    nz = elements.lanes[eight, 5]
    half = 0.5 * elements.curvature[eight]
    present = cut_straight(recent, 0, nx, ny, nz, half)
    if turns:
        present = cut_turned(recent, elements, eight, 0, nx, ny, nz, half)
    most = present
    j = poses.first
    while j < poses.last:
        end = wp.min(j + CHECKED, poses.last)
        if turns:
            while j < end:
                most = wp.max(most, cut_turned(recent, elements, eight, j, nx, ny, nz, half))
                j += 1
        else:
            while j < end:
                most = wp.max(most, cut_straight(recent, j, nx, ny, nz, half))
                j += 1
        # The remaining poses cannot change which elements have bone within reach.
        if wp.min(most - present) > CLOSE and wp.min(most) > enough:
            j = poses.last
    for lane in range(LANES):
        if most[lane] - present[lane] > CLOSE:
            gap[lane] = most[lane]
    return gap


@wp.func
def cut_straight(recent: Singles2D, j: int, nx: lanes8, ny: lanes8, nz: lanes8, half: lanes8):
    """Compute how far [m] in front of eight elements a tool without rotation cut at pose ``j``."""
    mx = recent[j, 0]
    my = recent[j, 1]
    mz = recent[j, 2]
    across = mx * nx + my * ny + mz * nz
    square = lanes8(mx * mx + my * my + mz * mz)
    return across - wp.cw_mul(half, square - wp.cw_mul(across, across))


@wp.func
def cut_turned(
    recent: Singles2D,
    elements: Elements,
    eight: int,
    j: int,
    nx: lanes8,
    ny: lanes8,
    nz: lanes8,
    half: lanes8,
):
    """Compute how far [m] in front of eight elements a tool with rotation cut at pose ``j``."""
    mx = recent[j, 0]
    my = recent[j, 1]
    mz = recent[j, 2]
    # To second order in the rotation w, an element at p with normal n moves by w x p, and the
    # surface at its new position rises by (w x n) . (w x p / 2 + moved). The rotation about the
    # tool's axis is omitted.
    px = elements.lanes[eight, 0]
    py = elements.lanes[eight, 1]
    pz = elements.lanes[eight, 2]
    wx = recent[j, 3]
    wy = recent[j, 4]
    x = wy * pz
    y = -wx * pz
    z = wx * py - wy * px
    risen = wp.cw_mul(wy * nz, 0.5 * x + lanes8(mx)) - wp.cw_mul(wx * nz, 0.5 * y + lanes8(my))
    risen += wp.cw_mul(wx * ny - wy * nx, 0.5 * z + lanes8(mz))
    x += lanes8(mx)
    y += lanes8(my)
    z += lanes8(mz)
    across = wp.cw_mul(x, nx) + wp.cw_mul(y, ny) + wp.cw_mul(z, nz)
    square = wp.cw_mul(x, x) + wp.cw_mul(y, y) + wp.cw_mul(z, z)
    return across - wp.cw_mul(half, square - wp.cw_mul(across, across)) + risen
