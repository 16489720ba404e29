"""Storage of voxels in bricks, access to these voxels, and the volume of a cut voxel.

A voxel grid is divided into bricks of 8 x 8 x 8 voxels. Only bricks that hold material are stored.
``brick_of`` maps a brick's grid position to the brick's row in the stored arrays, or to -1 if the
brick is not stored. A row consists of 64 consecutive blocks of 2 x 2 x 2 voxels. Neighbouring
voxels are therefore close together in memory. Lengths are in voxels: a point at ``x`` metres has
the coordinate ``(x - origin) / spacing``.

The original material of a voxel is stored in one word. The upper 16 bits hold the density [kg/m3],
and the lowest 8 bits hold the index of the layer.
"""

import warp as wp

from kernels.arrays import Bits, Bytes, Int32s3D, Shorts2D, Words2D

BRICK = 8
"""Number of voxels along the edge of a brick, equal to `meshes.base.grid.BLOCK`.

The lowest three bits of a coordinate are the position in a brick.
"""
BRICK_VOXELS = BRICK**3
corner8i = wp.types.vector(length=8, dtype=wp.int32)
corner8f = wp.types.vector(length=8, dtype=wp.float32)
FULL = 65535
"""Stored value of a voxel that is wholly filled."""
LOST, REACHED = 1, 2
"""Flags of a brick: LOST if material was removed, REACHED if a tool may have changed the brick."""


@wp.struct
class Bricks:
    """Voxels of a bone. All arrays except ``brick_of`` have one row for each stored brick."""

    brick_of: Int32s3D  # [brick x, y, z], row of the brick or -1
    material: Words2D
    # distance to the original surface and to the nearest layer boundary, see `kernels.bone_lookup`
    nearby: Shorts2D
    remaining: Shorts2D
    swept: Shorts2D  # distance to the volume that the tool has swept, see `swept_steps`
    middle: Shorts2D  # distance to the cuts up to the last call of `kernels.carving.mark_older`
    older: Shorts2D  # distance to older cuts
    alive: Bits  # one bit for each block of 2 x 2 x 2 voxels that may hold material
    touched: Bytes  # flags LOST and REACHED


@wp.func
def voxel_row(brick_of: Int32s3D, ix: int, iy: int, iz: int):
    """Return the row of the brick that holds voxel (ix, iy, iz).

    The row is -1 outside the grid or where no brick is stored.
    """
    # Bricks have 8 voxels along each edge.
    bx = ix >> 3
    by = iy >> 3
    bz = iz >> 3
    if ix < 0 or iy < 0 or iz < 0:
        return int(-1)
    if bx >= brick_of.shape[0] or by >= brick_of.shape[1] or bz >= brick_of.shape[2]:
        return int(-1)
    return int(brick_of[bx, by, bz])


@wp.func
def voxel_column(ix: int, iy: int, iz: int):
    """Return the position of voxel (ix, iy, iz) in the row that stores the voxel's brick."""
    # A coordinate in a brick has three bits. The upper two bits number the block, and the lowest
    # bit is the position in the block.
    block = ((ix & 6) << 3) | ((iy & 6) << 1) | ((iz & 6) >> 1)
    return (block << 3) | ((ix & 1) << 2) | ((iy & 1) << 1) | (iz & 1)


@wp.func
def layer_of(word: wp.uint32):
    """Return the layer index, the lowest 8 bits of a voxel's material word."""
    return int(word & wp.uint32(255))


@wp.func
def density_of(word: wp.uint32):
    """Return the density [kg/m3], the upper 16 bits of a voxel's material word."""
    return int(word >> wp.uint32(16))


@wp.struct
class Cell:
    """Cube between eight neighbouring voxel centres, and a position in this cube."""

    x: wp.int32  # voxel with the lowest indices in the cell
    y: wp.int32
    z: wp.int32
    inside: wp.vec3  # position in the cell, 0 to 1 along each axis


@wp.func
def cell_of(point: wp.vec3):
    """Return the cell between voxel centres that contains ``point`` [voxel]."""
    from_centre = point - wp.vec3(0.5)
    cell = Cell()
    cell.x = int(wp.floor(from_centre[0]))
    cell.y = int(wp.floor(from_centre[1]))
    cell.z = int(wp.floor(from_centre[2]))
    cell.inside = from_centre - wp.vec3(float(cell.x), float(cell.y), float(cell.z))
    return cell


@wp.struct
class Corners:
    """Storage locations of the eight voxels whose centres are the corners of a cell.

    Corners are numbered from 0 to 7. Bit 2 of the number is 0 at the lower and 1 at the upper
    corners along x. Bit 1 has the same meaning for y, and bit 0 for z.
    """

    row: corner8i  # row of the corner's brick, -1 if no brick is stored
    column: corner8i  # index of the corner in this row


@wp.func
def corners_of(brick_of: Int32s3D, cell: Cell, row: int):
    """Find the storage locations of a cell's corners.

    ``row`` is the storage row of a brick that contains at least one of the corners.
    """
    found = Corners()
    # These are the bits of `voxel_column`. They are computed once per axis and side of the cell,
    # instead of once per corner.
    x0 = ((cell.x & 6) << 6) | ((cell.x & 1) << 2)
    y0 = ((cell.y & 6) << 4) | ((cell.y & 1) << 1)
    z0 = ((cell.z & 6) << 2) | (cell.z & 1)
    x1 = (((cell.x + 1) & 6) << 6) | (((cell.x + 1) & 1) << 2)
    y1 = (((cell.y + 1) & 6) << 4) | (((cell.y + 1) & 1) << 1)
    z1 = (((cell.z + 1) & 6) << 2) | ((cell.z + 1) & 1)
    for c in range(8):
        found.row[c] = row
        part = wp.where((c & 4) != 0, x1, x0) | wp.where((c & 2) != 0, y1, y0)
        found.column[c] = part | wp.where((c & 1) != 0, z1, z0)
    # The cell begins at the last voxel of the brick, so that some corners lie in the next brick.
    if (cell.x & 7) == 7 or (cell.y & 7) == 7 or (cell.z & 7) == 7:
        for c in range(8):
            found.row[c] = voxel_row(
                brick_of, cell.x + (c >> 2), cell.y + ((c >> 1) & 1), cell.z + (c & 1)
            )
    return found


@wp.struct
class Plane:
    """Constants that `cube_behind_plane` uses, computed from the normal of a plane."""

    m1: wp.float32  # |components| of the normal, ascending, scaled to a sum of 1
    m2: wp.float32
    m3: wp.float32
    scale: wp.float32  # 1 / (|nx| + |ny| + |nz|)
    corner: wp.float32  # 1 / (6 m1 m2 m3)
    edge: wp.float32  # 1 / (2 m2 m3)


@wp.func
def plane_of(normal: wp.vec3):
    """Compute the constants of :func:`cube_behind_plane` for a plane with unit ``normal``."""
    x = wp.abs(normal[0])
    y = wp.abs(normal[1])
    z = wp.abs(normal[2])
    plane = Plane()
    # The sum is at least 1e-6, in case the normal is zero. Components below 1e-4 are set to 1e-4 to
    # avoid a division by zero. This changes the volume by less than 2e-4.
    plane.scale = 1.0 / wp.max(x + y + z, 1.0e-6)
    plane.m1 = wp.max(wp.min(x, wp.min(y, z)) * plane.scale, 1.0e-4)
    plane.m3 = wp.max(wp.max(x, wp.max(y, z)) * plane.scale, 1.0e-4)
    plane.m2 = wp.max(1.0 - plane.m1 - plane.m3, plane.m1)
    plane.edge = 0.5 / (plane.m2 * plane.m3)
    plane.corner = plane.edge / (3.0 * plane.m1)
    return plane


@wp.func
def cube_behind_plane(plane: Plane, distance: float):
    """Compute the volume of the part of the unit cube behind a plane.

    The plane is shifted from the cube's centre by ``distance`` in the direction opposite to the
    plane's normal.

    The analytic relation is from Scardovelli and Zaleski (2000), J. Comput. Phys. 164:228.
    """
    whole = 0.5 - distance * plane.scale
    # Compute the volume on the smaller side of the plane. The cases below differ in the number of
    # corners of the cube on this side.
    a = wp.min(whole, 1.0 - whole)
    if a <= 0.0:
        return wp.where(whole > 0.5, 1.0, 0.0)
    m1 = plane.m1
    m2 = plane.m2
    m3 = plane.m3
    m12 = m1 + m2
    volume = float(0.0)
    if a < m1:
        volume = a * a * a * plane.corner
    elif a < m2:
        volume = (a * (a - m1) + m1 * m1 * (1.0 / 3.0)) * plane.edge
    elif a < wp.min(m12, m3):
        volume = (
            a * a * (3.0 * m12 - a) + m1 * m1 * (m1 - 3.0 * a) + m2 * m2 * (m2 - 3.0 * a)
        ) * plane.corner
    elif m3 < m12:
        volume = (
            a * a * (3.0 - 2.0 * a)
            + m1 * m1 * (m1 - 3.0 * a)
            + m2 * m2 * (m2 - 3.0 * a)
            + m3 * m3 * (m3 - 3.0 * a)
        ) * plane.corner
    else:
        volume = (a - 0.5 * m12) / m3
    return wp.where(whole > 0.5, 1.0 - volume, volume)
