"""Lookup of the uncut bone at a point, with an error of second order in the voxel size.

For the centre of each voxel, two distances are stored, which cutting does not change. The first is
the signed distance to the bone's original surface. The second is the distance to the nearest
boundary between layers. These distances are interpolated between voxel centres. A point lies in
bone if the interpolated surface distance is negative. To find the layer of a point, the boundary
distance is interpolated once for each layer, with a negative sign in voxels that belong to a
different layer. The layer with the largest interpolated value is chosen. At a point far from the
surface and from every layer boundary, the layer and density of the nearest voxel are used. The
surface distance of such a point is -2 inside and 2 outside. Lengths are in voxels.
"""

import warp as wp

from kernels.bricks import Bricks, cell_of, corner8f, corner8i, corners_of, density_of, layer_of

SURFACE_STEPS = 63
"""Number of stored steps per voxel of surface distance. A stored distance is an 8-bit integer.

The stored distance is limited to two voxels. The stored value 128 is a distance of zero.
"""
BEYOND = 128 + 32
"""Smallest surface distance that is assumed for a voxel outside the stored bricks, in stored steps.

A brick is a block of 8 x 8 x 8 voxels. The assumed distance is the larger of this limit and d plus
one voxel, where d is the distance at a neighbouring voxel. The limit is half a voxel. This is the
true distance next to a grid whose outermost voxels are full.
"""
CORNERS = 8
# stored surface distance of 1.78 voxels inside: all corners of a cell lie inside the bone
DEEP = 128 - 112
AIR = 128 + 112  # 1.78 voxels outside: no corner lies in bone
# stored boundary distance of 1.78 voxels: all corners of a cell lie in one layer
ONE_LAYER = 226


@wp.struct
class Bone:
    """Properties of the uncut bone at a point."""

    distance: wp.float32  # signed distance to the original surface [voxel], -2 for deeper points
    slope: wp.vec3  # gradient of the distance, 0 for deeper points
    layer: wp.int32
    density: wp.float32  # [kg/m3]


@wp.func
def bone_at(
    bricks: Bricks,
    row: int,
    column: int,
    point: wp.vec3,
):
    """Return surface distance, layer and density of the uncut bone at ``point`` [voxel].

    The point lies in voxel ``column`` of the brick that is stored in ``row``.
    """
    word = bricks.material[row, column]
    near = int(bricks.nearby[row, column])
    found = Bone()
    found.distance = -2.0
    found.layer = layer_of(word)
    found.density = float(density_of(word))
    if (near & 255) >= AIR:
        found.distance = 2.0
    elif (near & 255) > DEEP or (near >> 8) < ONE_LAYER:
        cell = cell_of(point)
        corners = corners_of(bricks.brick_of, cell, row)
        # No change of layer (255), and a surface distance one voxel (63 steps) farther out.
        beyond = 0xFF00 | wp.clamp((near & 255) + 63, BEYOND, 254)
        stored = corner8i()
        for c in range(CORNERS):
            stored[c] = beyond
            if corners.row[c] >= 0:
                stored[c] = int(bricks.nearby[corners.row[c], corners.column[c]])
        found = distance_between(stored, cell.inside, found)
        if (near >> 8) < ONE_LAYER:
            words = corner8i()
            mixed = int(0)
            for c in range(CORNERS):
                words[c] = -1
                if corners.row[c] >= 0:
                    words[c] = int(bricks.material[corners.row[c], corners.column[c]])
                    if (words[c] & 255) != found.layer:
                        mixed = 1
            if mixed == 1:
                found = layer_between(stored, words, cell.inside, found)
    return found


@wp.func
def distance_between(stored: corner8i, inside: wp.vec3, nearest: Bone):
    """Interpolate the surface distance and its gradient between the eight voxel centres of a cell.

    ``inside`` is the position in the cell, with components from 0 to 1. ``nearest`` describes the
    nearest voxel. The result is a copy of ``nearest`` with the interpolated distance and gradient.
    """
    found = nearest
    fx = inside[0]
    fy = inside[1]
    fz = inside[2]
    gx = 1.0 - fx
    gy = 1.0 - fy
    gz = 1.0 - fz
    s = corner8f()
    for c in range(CORNERS):
        # from steps to voxels, see SURFACE_STEPS
        s[c] = float((stored[c] & 255) - 128) * (1.0 / 63.0)
    x0 = (s[0] * gz + s[1] * fz) * gy + (s[2] * gz + s[3] * fz) * fy
    x1 = (s[4] * gz + s[5] * fz) * gy + (s[6] * gz + s[7] * fz) * fy
    y0 = (s[0] * gz + s[1] * fz) * gx + (s[4] * gz + s[5] * fz) * fx
    y1 = (s[2] * gz + s[3] * fz) * gx + (s[6] * gz + s[7] * fz) * fx
    z0 = (s[0] * gy + s[2] * fy) * gx + (s[4] * gy + s[6] * fy) * fx
    z1 = (s[1] * gy + s[3] * fy) * gx + (s[5] * gy + s[7] * fy) * fx
    found.distance = x0 * gx + x1 * fx
    found.slope = wp.vec3(x1 - x0, y1 - y0, z1 - z0)
    return found


@wp.func
def layer_between(stored: corner8i, words: corner8i, inside: wp.vec3, nearest: Bone):
    """Return layer and density at a point between eight voxels that belong to several layers.

    ``stored`` holds the distances of each voxel to the nearest boundary between layers (upper byte)
    and to the surface (lower byte). ``words`` holds the density (upper 16 bits) and the layer
    (lowest 8 bits) of each voxel, or -1 where no brick is stored. The function reads the layers
    directly, because 64 calls of `layer_of` would take too long.
    """
    found = nearest
    far = corner8f()
    weight = corner8f()
    whole = float(0.0)
    for c in range(CORNERS):
        weight[c] = wp.where((c & 4) != 0, inside[0], 1.0 - inside[0])
        weight[c] *= wp.where((c & 2) != 0, inside[1], 1.0 - inside[1])
        weight[c] *= wp.where((c & 1) != 0, inside[2], 1.0 - inside[2])
        far[c] = wp.where(words[c] >= 0, float(stored[c] >> 8) * weight[c], 0.0)
        whole += far[c]
    # Below any share: distances are at most 255 each.
    best = float(-1.0e6)
    done = int(0)  # one bit for each corner whose layer has been checked
    for c in range(CORNERS):
        if words[c] >= 0 and (done & (1 << c)) == 0:
            layer = words[c] & 255
            share = float(0.0)
            total = float(0.0)
            density = float(0.0)
            for d in range(CORNERS):
                if words[d] >= 0 and (words[d] & 255) == layer:
                    done = done | (1 << d)
                    share += far[d]
                    total += weight[d]
                    density += weight[d] * float(words[d] >> 16)
            share = 2.0 * share - whole
            if share > best and total > 0.0:
                best = share
                found.layer = layer
                found.density = density / total
    return found
