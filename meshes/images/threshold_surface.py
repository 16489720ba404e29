"""Bone surface of an image volume, at a threshold of the grey value."""

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.images.frame import Image

__all__ = ["image_cuts", "image_triangles"]


def image_triangles(
    image: Image, *, threshold: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return vertices [mm] and triangles around the region above a grey value.

    They have the shapes (n, 3) and (m, 3).

    Raises
    ------
    InputError
        If no voxel lies above the threshold.
    """
    from skimage.measure import marching_cubes

    values = image.values.astype(np.float32)
    if not values.max() > threshold:
        raise InputError(
            "anatomy.threshold",
            "leave bone",
            f"{threshold:g} where {image.source} holds {values.min():g} to {values.max():g}",
            "use a value between",
        )
    outside = min(float(values.min()), 2.0 * threshold - float(values.max()))
    padded = np.pad(values, 1, constant_values=outside)
    vertices, faces, _, _ = marching_cubes(padded, threshold, spacing=image.spacing_mm)
    return vertices - np.asarray(image.spacing_mm) + np.asarray(image.origin_mm), faces[
        :, ::-1
    ].astype(np.int64)


def image_cuts(image: Image, *, threshold: float) -> tuple[NDArray[np.float64], ...]:
    """Return points on each face where the edge of an image cuts off the region above a grey value.

    The points are in m, shape (k, 3).
    """
    from scipy.ndimage import find_objects, label

    cuts = []
    for axis in range(3):
        for end in (0, image.values.shape[axis] - 1):
            pieces, _ = label(np.take(image.values, end, axis=axis) > threshold)
            for number, box in enumerate(find_objects(pieces), start=1):
                first = [each.start for each in box]
                index = np.insert(np.argwhere(pieces[box] == number) + first, axis, end, axis=1)
                cuts.append(
                    1e-3 * (index * np.asarray(image.spacing_mm) + np.asarray(image.origin_mm))
                )
    return tuple(cuts)
