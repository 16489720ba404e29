"""Bone surface of an image volume: where the grey value crosses a threshold."""

from __future__ import annotations

import numpy as np

from meshes.errors import InputError
from meshes.image_file import Image
from meshes.surface import Surface, surface_from_triangles

__all__ = ["image_surface"]


def image_surface(image: Image, *, threshold: float) -> Surface:
    """Surface around what lies above a grey value, in the image's frame: voxel (0, 0, 0) is centred at the origin.

    The frame is that of the indices times the spacing, x, y and z as the array's axes; the file's own origin and
    directions are left out. Bone cut off by the edge of the image is closed there.

    Parameters
    ----------
    image
        Grey values.
    threshold
        Bone is what lies above this grey value.

    Raises
    ------
    InputError
        If nothing lies above the threshold, or what does encloses no solid.
    """
    from skimage.measure import marching_cubes

    values = image.values.astype(np.float32)
    if not values.max() > threshold:
        raise InputError(
            f"anatomy.threshold must leave bone, got {threshold:g} where {image.source} holds "
            f"{values.min():g} to {values.max():g}: use a value between"
        )
    outside = min(float(values.min()), 2.0 * threshold - float(values.max()))
    padded = np.pad(values, 1, constant_values=outside)
    vertices, faces, _, _ = marching_cubes(padded, threshold, spacing=image.spacing_mm)
    shifted = vertices - np.asarray(image.spacing_mm)
    return surface_from_triangles(shifted, faces[:, ::-1], source=image.source, scale_mm=1.0)
