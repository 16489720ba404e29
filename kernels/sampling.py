"""Sampling of the brick-stored bone at points."""

import warp as wp

from kernels.bricks import trilinear

__all__ = ["sample"]

wp.set_module_options({"enable_backward": False})


@wp.kernel
def sample(
    # points
    point: wp.array(dtype=wp.vec3),  # [voxel]
    offset: int,
    # grid
    brick_of: wp.array3d(dtype=wp.int32),
    remaining: wp.array2d(dtype=wp.uint16),
    # out
    fraction_out: wp.array(dtype=wp.float32),
):
    """Sample the filled fraction at each point, trilinear between voxel centres.

    The fraction is 0 where no brick is stored.
    """
    i = wp.tid() + offset
    fraction_out[i] = trilinear(brick_of, remaining, point[i])
