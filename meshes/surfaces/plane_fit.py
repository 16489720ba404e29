"""The plane that fits a surface around a point of it."""

import numpy as np
from numpy.typing import NDArray

from meshes.surfaces.glenoid_search import SurfaceSamples

__all__ = ["normal_by_plane"]

_AROUND_M = 4e-3
_FEWEST = 12


def normal_by_plane(samples: SurfaceSamples, point_m: NDArray[np.floating]) -> NDArray[np.float64]:
    """Outward unit normal, shape (3,), of the plane through the surface within 4 mm of a point [m].

    Samples on the other side of a thin bone are left out; where few lie around, it is the mean of the nearest ones.
    """
    distance = np.linalg.norm(samples.points - point_m, axis=1)
    nearest = np.argsort(distance)[:_FEWEST]
    facing = samples.normals @ samples.normals[nearest[0]] > 0.3
    around = (distance < _AROUND_M) & facing
    outward = samples.normals[around if around.sum() >= _FEWEST else nearest].sum(axis=0)
    outward /= np.linalg.norm(outward)
    if around.sum() < _FEWEST:
        return np.asarray(outward)
    points = samples.points[around]
    normal = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][2]
    return np.asarray(normal * np.sign(normal @ outward) if abs(normal @ outward) > 0.5 else outward)
