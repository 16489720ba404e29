"""Distances of points from the obstacles of a rigid tool: bone voxels and solid boxes.

The distance of a point from the surface of the voxels is not stored. It is computed on demand from
the remaining fractions of the eight voxels around the point, so carving does not have to update
distances. F is the trilinearly interpolated fraction and h the voxel spacing. The level at a point
is ``h (SURFACE - F)``. It is zero on the surface, and has a slope of about one in the outward
direction. ``SURFACE`` is less than one half, because a plate that is one voxel thick may half fill
two layers of voxels. The contact surface therefore lies outside the true surface. To compensate,
the shell points, which represent the tool's surface, are moved inward. Away from bone, a lower
bound of the distance from the initial bone is read from the array ``clearance``. The bound remains
valid, because removal of bone can only increase the distance.
"""

import warp as wp

from kernels.arrays import Int32s3D, Matrices, Shorts2D, Singles3D, Vectors
from kernels.bricks import voxel_column, voxel_row
from kernels.constants import HALF, ONE, ZERO

wp.set_module_options({"max_unroll": 1})

CELL = 2
"""Edge length [voxel] of a cell of the grid `Field.clearance`."""
SURFACE = 0.25
"""Trilinearly interpolated voxel fraction on the surface that the tool touches."""
LEVEL = wp.float64(SURFACE)
STEP = wp.float64(1.0 / 65535.0)
"""Filled fraction that one stored step represents, see `kernels.bricks.FULL`."""
CELLS_PER_VOXEL = wp.float64(1.0 / CELL)


@wp.struct
class Field:
    """Obstacles of a tool: solid boxes, and bone as voxels in brick storage."""

    centre: Vectors  # centre of each box [m]
    turn: Matrices  # rotation from each box to world
    size: Vectors  # edge lengths of each box [m]
    brick_of: Int32s3D
    remaining: Shorts2D
    origin: wp.vec3d  # [m]
    spacing: wp.float64  # [m], 0 without voxels
    voxels_per_m: wp.float64  # 1 / spacing
    # [cell of CELL voxels], lower bound of the distance to bone [m]
    clearance: Singles3D


@wp.func
def box_distance(field: Field, box: int, point: wp.vec3d):
    """Compute the signed distance [m], with its unit gradient, of a point from a box.

    The distance is negative inside the box.

    Inside the box, the magnitude of the distance is the distance to the nearest face.
    """
    turn = field.turn[box]
    local = wp.transpose(turn) * (point - field.centre[box])
    outside = wp.vec3d()
    toward = wp.vec3d()
    # -1e30 m stands for no face yet.
    deepest = wp.float64(-1.0e30)
    for c in range(3):
        side = ONE
        if local[c] < ZERO:
            side = -ONE
        beyond = side * local[c] - HALF * field.size[box][c]
        outside[c] = side * wp.max(beyond, ZERO)
        if beyond > deepest:
            deepest = beyond
            toward = wp.vec3d()
            toward[c] = side
    length = wp.length(outside)
    if length > ZERO:
        deepest = length
        toward = outside / length
    return deepest, turn * toward


@wp.func
def voxel_clearance(field: Field, point: wp.vec3d):
    """Return a lower bound of a point's distance [m] from the region that bone voxels affect."""
    place = (point - field.origin) * field.voxels_per_m
    cell = wp.vec3i()
    beyond = wp.vec3d()
    outermost = int(0)
    for c in range(3):
        last = field.clearance.shape[c] - 1
        cell[c] = wp.clamp(int(wp.floor(place[c] * CELLS_PER_VOXEL)), 0, last)
        if place[c] < ZERO or cell[c] == last:
            outermost = 1
        # A voxel has an effect up to half a voxel outside its faces, also outside the grid.
        edge = wp.float64(CELL * (last + 1)) + HALF
        beyond[c] = place[c] - wp.clamp(place[c], -HALF, edge)
    bound = wp.float64(field.clearance[cell[0], cell[1], cell[2]])
    if outermost == 1:
        bound = wp.max(bound, wp.length(beyond) * field.spacing)
    return bound


@wp.func
def held(remaining: Shorts2D, row: int, ix: int, iy: int, iz: int):
    """Return the filled fraction of a voxel in the brick at ``row``, or 0 if ``row`` < 0."""
    fraction = wp.float64(0.0)
    if row >= 0:
        fraction = wp.float64(remaining[row, voxel_column(ix, iy, iz)]) * STEP
    return fraction


@wp.func
def column_pair(
    brick_of: Int32s3D,
    remaining: Shorts2D,
    row: int,
    ix: int,
    iy: int,
    iz: int,
):
    """Return the filled fractions of a voxel and of the next voxel along z.

    ``row`` is the row of the brick that contains both voxels. If ``row`` is -2, the function
    searches for the brick.
    """
    low = row
    if row < 0:
        low = voxel_row(brick_of, ix, iy, iz)
    high = low
    if (iz & 7) == 7:
        high = voxel_row(brick_of, ix, iy, iz + 1)
    return held(remaining, low, ix, iy, iz), held(remaining, high, ix, iy, iz + 1)


@wp.func
def voxel_level(field: Field, point: wp.vec3d):
    """Compute the approximate signed distance (level) [m] of a point from the voxels' surface.

    The level is positive outside and zero on the surface. Also return the gradient of the level,
    which has a length of about one near the surface.
    """
    place = (point - field.origin) * field.voxels_per_m - wp.vec3d(HALF)
    ix = int(wp.floor(place[0]))
    iy = int(wp.floor(place[1]))
    iz = int(wp.floor(place[2]))
    # -2: the eight voxels may lie in several bricks.
    row = int(-2)
    if (ix & 7) < 7 and (iy & 7) < 7 and (iz & 7) < 7:
        row = voxel_row(field.brick_of, ix, iy, iz)
        if row < 0:
            # All eight voxels are empty.
            return LEVEL * field.spacing, wp.vec3d()
    fx = place[0] - wp.float64(ix)
    fy = place[1] - wp.float64(iy)
    fz = place[2] - wp.float64(iz)
    a0, a1 = column_pair(field.brick_of, field.remaining, row, ix, iy, iz)
    b0, b1 = column_pair(field.brick_of, field.remaining, row, ix, iy + 1, iz)
    c0, c1 = column_pair(field.brick_of, field.remaining, row, ix + 1, iy, iz)
    d0, d1 = column_pair(field.brick_of, field.remaining, row, ix + 1, iy + 1, iz)
    a = wp.lerp(a0, a1, fz)
    b = wp.lerp(b0, b1, fz)
    c = wp.lerp(c0, c1, fz)
    d = wp.lerp(d0, d1, fz)
    near = wp.lerp(a, b, fy)
    far = wp.lerp(c, d, fy)
    across = wp.lerp(b - a, d - c, fx)
    along = wp.lerp(wp.lerp(a1 - a0, b1 - b0, fy), wp.lerp(c1 - c0, d1 - d0, fy), fx)
    return (LEVEL - wp.lerp(near, far, fx)) * field.spacing, wp.vec3d(near - far, -across, -along)
