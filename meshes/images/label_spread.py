"""Spreading of labels into a smooth share that is one half at their surface, curved or not.

A Gaussian less its Laplacian times its variance, ``G - s^2 div grad G``, has no second moment in a
plane through its centre, so a curved boundary stays in place to first order in the curvature. The
same holds for different deviations along the axes, since an affine map takes curved surfaces to
curved surfaces.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["spread_labels"]


def spread_labels(values: NDArray[np.float32], deviation_voxels: ArrayLike) -> NDArray[np.float32]:
    """Spread values, 1 inside and 0 outside, by the kernel; they are 0 outside the array.

    Parameters
    ----------
    values
        Shape (nx, ny, nz).
    deviation_voxels
        Standard deviation along each axis [voxel], one number or shape (3,).
    """
    from scipy.ndimage import correlate1d, gaussian_filter

    deviations = np.broadcast_to(np.asarray(deviation_voxels, dtype=np.float64), (3,))
    smooth = gaussian_filter(values, deviations, mode="constant")
    result = smooth.copy()
    for axis, deviation in enumerate(deviations):
        second = np.array([1.0, -2.0, 1.0]) * deviation**2
        result -= correlate1d(smooth, second, axis=axis, mode="constant")
    return np.asarray(result, dtype=np.float32)
