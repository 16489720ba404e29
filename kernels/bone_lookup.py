"""What bone was there at a point before any cut, to second order in the voxel.

Two static numbers a voxel: the signed distance of its centre to the original surface, and the distance to the nearest
change of layer. Between voxel centres both are interpolated: a point lies in bone where the interpolated surface
distance is negative, and in the layer whose interpolated distance, negative for voxels of other layers, is largest.
Far from the surface and from every change of layer the nearest voxel answers. Lengths are in voxels.
"""

import warp as wp

from kernels.bricks import cell_of, density_of, layer_of, voxel_column, voxel_row

__all__ = ["BEYOND", "SURFACE_STEPS", "Bone", "bone_at"]

SURFACE_STEPS = 63
"""Stored steps of the surface distance in a voxel; held within two voxels, with 128 for the surface itself."""
BEYOND = 128 + 32
"""Least stored surface distance taken where there is no brick: half a voxel outside, as beyond the face of a grid that
is full to its edge; beside a voxel farther out, a voxel farther than that."""
CORNERS = wp.constant(8)
DEEP = wp.constant(128 - 112)  # stored surface distance of 1.78 voxels inside: no corner of a cell lies outside
AIR = wp.constant(128 + 112)  # 1.78 voxels outside: no corner of a cell lies inside
FAR = wp.constant(226)  # stored boundary distance of 1.78 voxels: all corners of a cell lie in one layer
corner8i = wp.types.vector(length=8, dtype=wp.int32)
corner8f = wp.types.vector(length=8, dtype=wp.float32)


@wp.struct
class Bone:
    """The bone at a point before any cut."""

    distance: wp.float32  # signed distance to the original surface [voxel], -2 where it is deeper
    slope: wp.vec3  # gradient of the distance, 0 where it is deeper
    layer: wp.int32
    density: wp.float32  # [kg/m3]


@wp.func
def bone_at(
    brick_of: wp.array3d(dtype=wp.int32),
    material: wp.array2d(dtype=wp.uint32),
    nearby: wp.array2d(dtype=wp.uint16),
    row: int,
    column: int,
    point: wp.vec3,
):
    """The bone at ``point`` [voxel] in the voxel of brick ``row`` and place ``column``."""
    word = material[row, column]
    near = int(nearby[row, column])
    found = Bone()
    found.distance = -2.0
    found.layer = layer_of(word)
    found.density = float(density_of(word))
    if (near & 255) >= AIR:
        found.distance = 2.0
    elif (near & 255) > DEEP or (near >> 8) < FAR:
        cell = cell_of(point)
        beyond = 0xFF00 | wp.clamp((near & 255) + 63, BEYOND, 254)
        stored = corner8i()
        words = corner8i()
        for c in range(CORNERS):
            jx = cell.x + (c >> 2)
            jy = cell.y + ((c >> 1) & 1)
            jz = cell.z + (c & 1)
            at = voxel_row(brick_of, jx, jy, jz)
            stored[c] = beyond
            words[c] = -1
            if at >= 0:
                place = voxel_column(jx, jy, jz)
                stored[c] = int(nearby[at, place])
                words[c] = int(material[at, place])
        found = between(stored, words, cell.inside, found)
    return found


@wp.func
def between(stored: corner8i, words: corner8i, inside: wp.vec3, nearest: Bone):
    """The bone between the eight voxel centres of a cell, at ``inside``, 0 to 1 along each axis."""
    found = nearest
    fx = inside[0]
    fy = inside[1]
    fz = inside[2]
    gx = 1.0 - fx
    gy = 1.0 - fy
    gz = 1.0 - fz
    s = corner8f()
    weight = corner8f()
    mixed = int(0)
    for c in range(CORNERS):
        s[c] = float((stored[c] & 255) - 128) * (1.0 / 63.0)
        wx = wp.where((c & 4) != 0, fx, gx)
        wy = wp.where((c & 2) != 0, fy, gy)
        wz = wp.where((c & 1) != 0, fz, gz)
        weight[c] = wx * wy * wz
        if words[c] >= 0 and (words[c] & 255) != nearest.layer:
            mixed = 1
    x0 = (s[0] * gz + s[1] * fz) * gy + (s[2] * gz + s[3] * fz) * fy
    x1 = (s[4] * gz + s[5] * fz) * gy + (s[6] * gz + s[7] * fz) * fy
    y0 = (s[0] * gz + s[1] * fz) * gx + (s[4] * gz + s[5] * fz) * fx
    y1 = (s[2] * gz + s[3] * fz) * gx + (s[6] * gz + s[7] * fz) * fx
    z0 = (s[0] * gy + s[2] * fy) * gx + (s[4] * gy + s[6] * fy) * fx
    z1 = (s[1] * gy + s[3] * fy) * gx + (s[5] * gy + s[7] * fy) * fx
    found.distance = x0 * gx + x1 * fx
    found.slope = wp.vec3(x1 - x0, y1 - y0, z1 - z0)
    if mixed == 0:
        return found
    best = float(-1.0e6)
    for c in range(CORNERS):
        if words[c] >= 0:
            layer = words[c] & 255
            share = float(0.0)
            total = float(0.0)
            density = float(0.0)
            for d in range(CORNERS):
                if words[d] >= 0:
                    far = float(stored[d] >> 8) * weight[d]
                    if (words[d] & 255) == layer:
                        share += far
                        total += weight[d]
                        density += weight[d] * float(words[d] >> 16)
                    else:
                        share -= far
            if share > best and total > 0.0:
                best = share
                found.layer = layer
                found.density = density / total
    return found
