"""Carving in Warp as one would write it first, for the benchmark of bone and for the peers."""

import warp as wp

__all__ = ["carve"]


@wp.kernel
def carve(
    centre: wp.array(dtype=wp.vec3),
    low: wp.array(dtype=wp.vec3i),
    radius: float,
    remaining: wp.array3d(dtype=wp.uint16),
    removed: wp.array(dtype=wp.int64),
):
    """Every voxel of the burr's box loses what lies inside the ball by a linear ramp."""
    i, j, k = wp.tid()
    x, y, z = low[0][0] + i, low[0][1] + j, low[0][2] + k
    at = wp.vec3(float(x) + 0.5, float(y) + 0.5, float(z) + 0.5)
    inside = wp.clamp(0.5 - (wp.length(at - centre[0]) - radius), 0.0, 1.0)
    left = int(65535.0 * (1.0 - inside))
    old = int(remaining[x, y, z])
    if left < old:
        remaining[x, y, z] = wp.uint16(left)
        wp.atomic_add(removed, 0, wp.int64(old - left))
