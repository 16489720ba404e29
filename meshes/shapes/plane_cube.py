"""Part of a cube that lies behind a plane.

It is the sub-voxel fraction of a voxel that a smooth surface crosses.
"""

import itertools

import numpy as np

from meshes.base.arrays import Array, Floats

__all__ = ["cube_fraction"]

_SMALLEST_COMPONENT = 1e-5


def cube_fraction(distance: Floats, normal: Floats) -> Array:
    """Compute the volume of the unit cube about the origin where n·x <= -distance.

    With m = |n| / Σ|n| and a = 1/2 - distance / Σ|n| (the plane's height over the cube's lowest
    corner, in units of the cube's extent along n), the volume is Σ_S (-1)^|S| (a - Σ_{i∈S} m_i)₊³ /
    (6 m1 m2 m3) over the subsets S of the three axes (inclusion-exclusion over the cube's corners;
    equivalent to Scardovelli & Zaleski 2000, J. Comput. Phys. 164:228). Components below 1e-5 are
    raised to it, which changes the volume by less than 2e-5.

    Parameters
    ----------
    distance
        Signed distance of the cube's centre from the plane, in cube edges, positive in front of it,
        shape (n,).
    normal
        Outward plane normals, unit length, shape (n, 3).

    Returns
    -------
    Fractions in [0, 1], shape (n,).
    """
    m = np.abs(np.asarray(normal, dtype=np.float64)).T
    total = m.sum(axis=0)
    height = np.clip(0.5 - np.asarray(distance, dtype=np.float64) / total, 0.0, 1.0)
    m = np.maximum(m / total, _SMALLEST_COMPONENT)
    m /= m.sum(axis=0)
    lower_half = np.minimum(height, 1.0 - height)
    volume = np.zeros_like(height)
    for chosen in itertools.product((0, 1), repeat=3):
        rest = lower_half - sum(m[k] for k in range(3) if chosen[k])
        volume += (-1) ** sum(chosen) * np.maximum(rest, 0.0) ** 3
    volume /= 6.0 * m[0] * m[1] * m[2]
    return np.where(height > 0.5, 1.0 - volume, volume)
