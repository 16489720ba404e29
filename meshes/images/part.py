"""Parts of an image: the box that holds a mask, and the image within a box."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from meshes.images.frame import Image

__all__ = ["box_of", "part_of"]


def box_of(mask: NDArray[np.bool_], margin: int = 0) -> tuple[slice, ...]:
    """Slices that hold all of a mask that is not empty, and so many voxels around as there are."""
    found = []
    for axis, count in enumerate(mask.shape):
        along = np.flatnonzero(mask.any(axis=tuple(k for k in range(mask.ndim) if k != axis)))
        found.append(slice(max(int(along[0]) - margin, 0), min(int(along[-1]) + 1 + margin, count)))
    return tuple(found)


def part_of(image: Image, box: tuple[slice, ...]) -> Image:
    """The image within slices that have a start each, its origin moved along."""
    x, y, z = (o + s * each.start for o, s, each in zip(image.origin_mm, image.spacing_mm, box, strict=True))
    return replace(image, values=np.ascontiguousarray(image.values[box]), origin_mm=(x, y, z))
