"""Smoothing of label masks, and conversion of smoothed values (shares) to distances."""

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array, Singles

_FARTHEST = 1.0
"""Distance [standard deviations] from a plane up to which a smoothed mask is monotonic.

Up to this distance, a distance from the plane can be computed from the smoothed value (share).
"""


def spread_labels(values: Singles, deviation_voxels: ArrayLike) -> Singles:
    """Smooth a mask (1 inside, 0 outside) with a kernel that does not shift curved surfaces.

    Values outside the array are 0.

    The kernel is a Gaussian minus the product of the Gaussian's variance and the Gaussian's
    Laplacian. In a plane through its centre, the second moment of the kernel is zero. On a plane
    boundary of the mask, the smoothed value is one half. On a curved boundary, the smoothed value
    is therefore also one half, to first order in the curvature.

    Parameters
    ----------
    values
        Mask, shape (nx, ny, nz).
    deviation_voxels
        Standard deviation of the smoothing [voxel]: one number, or one for each axis with shape
        (3,).
    """
    from scipy.ndimage import correlate1d, gaussian_filter

    deviations = np.broadcast_to(np.asarray(deviation_voxels, dtype=np.float64), (3,))
    smooth = gaussian_filter(values, deviations, mode="constant")
    result = smooth.copy()
    for axis, deviation in enumerate(deviations):
        second = np.array([1.0, -2.0, 1.0]) * deviation**2
        result -= correlate1d(smooth, second, axis=axis, mode="constant")
    return np.asarray(result, dtype=np.float32)


def depth_of_share(share: Singles) -> Array:
    """Return the depth behind a plane at which a smoothed mask has the value `share`.

    The unit of the depth is the standard deviation of the smoothing. The depth is limited to the
    range -1 to 1.
    """
    from scipy.special import ndtr

    # With steps of 1/400 of a standard deviation, the error of linear interpolation is 2e-6
    # standard deviations.
    depth = np.linspace(-_FARTHEST, _FARTHEST, 801)
    at_depth = ndtr(depth) + depth * np.exp(-0.5 * depth**2) / np.sqrt(2.0 * np.pi)
    return np.interp(share, at_depth, depth)
