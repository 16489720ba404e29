"""Distance between a tool's surface and another body, from a field of distances to the body."""

import warp as wp

from kernels.elements import CHUNK, Elements

__all__ = ["clearance"]

wp.set_module_options({"enable_backward": False})


@wp.func
def clipped(distance: wp.array3d(dtype=wp.float32), i: int, j: int, k: int):
    """Return the distance [m] at a voxel; outside the grid, at the nearest voxel in the grid."""
    return distance[
        wp.clamp(i, 0, distance.shape[0] - 1),
        wp.clamp(j, 0, distance.shape[1] - 1),
        wp.clamp(k, 0, distance.shape[2] - 1),
    ]


@wp.kernel
def clearance(
    # tool
    elements: Elements,
    motion: wp.array2d(dtype=wp.float64),  # rows: tip [voxel]; tool axes x, y, z
    spacing: float,  # [m]
    chunk_offset: int,
    # field
    distance: wp.array3d(dtype=wp.float32),  # at voxel centres [m]
    # out
    least_out: wp.array(dtype=wp.float32),  # [chunk], smallest distance of the chunk's elements [m]
):
    """Compute the smallest distance over each chunk of elements.

    Distances are trilinear between voxel centres.
    """
    chunk = wp.tid() + chunk_offset
    least = float(1.0e9)
    for e in range(chunk * CHUNK, wp.min(chunk * CHUNK + CHUNK, elements.point.shape[0])):
        arm = elements.point[e] / spacing
        x = float(motion[0, 0]) + arm[0] * float(motion[1, 0]) + arm[1] * float(motion[2, 0])
        y = float(motion[0, 1]) + arm[0] * float(motion[1, 1]) + arm[1] * float(motion[2, 1])
        z = float(motion[0, 2]) + arm[0] * float(motion[1, 2]) + arm[1] * float(motion[2, 2])
        x += arm[2] * float(motion[3, 0]) - 0.5
        y += arm[2] * float(motion[3, 1]) - 0.5
        z += arm[2] * float(motion[3, 2]) - 0.5
        i = int(wp.floor(x))
        j = int(wp.floor(y))
        k = int(wp.floor(z))
        fx = x - float(i)
        fy = y - float(j)
        fz = z - float(k)
        near = wp.lerp(
            wp.lerp(clipped(distance, i, j, k), clipped(distance, i, j, k + 1), fz),
            wp.lerp(clipped(distance, i, j + 1, k), clipped(distance, i, j + 1, k + 1), fz),
            fy,
        )
        far = wp.lerp(
            wp.lerp(clipped(distance, i + 1, j, k), clipped(distance, i + 1, j, k + 1), fz),
            wp.lerp(clipped(distance, i + 1, j + 1, k), clipped(distance, i + 1, j + 1, k + 1), fz),
            fy,
        )
        least = wp.min(least, wp.lerp(near, far, fx))
    least_out[chunk] = least
