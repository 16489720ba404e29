"""The surface of a label that a tool must keep clear of: of all its pieces, and nowhere far inside its voxels."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, counted
from meshes.images.frame import Image, box_of, part_of
from meshes.images.threshold_surface import image_cuts, image_triangles

__all__ = ["kept_label"]

SMOOTH_VOXELS = 0.8
"""Width (sd) of the smoothing along each axis, in its voxels, as of a bone's label."""
MARGIN = 4
"""Voxels around a piece in which it is smoothed: five deviations."""
_LISTED = 6


def kept_label(
    image: Image, mask: NDArray[np.bool_], name: str
) -> tuple[tuple[NDArray[np.float64], NDArray[np.int64]], tuple[str, ...]]:
    """Vertices [mm, LPS], shape (n, 3), and triangles, shape (m, 3), around a label, and a sentence each on it.

    Every piece is smoothed by itself and keeps its own volume. Where it is so thin that the smooth surface leaves a
    voxel of it by more than its neighbours, the voxel is kept as it is.

    Parameters
    ----------
    image
        Whose voxels the mask has; its values do not matter.
    mask
        Where the label is, shape of the image.
    name
        Of the label.

    Raises
    ------
    InputError
        If the mask is empty.
    """
    from scipy.ndimage import find_objects, label

    if not mask.any():
        raise InputError(
            f"keep_clear must be a label within the image and its crop, got {name}, which is not: widen the crop, or "
            "leave it out"
        )
    box = box_of(mask, MARGIN)
    part, mask = part_of(replace(image, values=mask.view(np.uint8)), box), mask[box]
    pieces, count = label(mask, np.ones((3, 3, 3)))
    field = np.full(mask.shape, -1.0, dtype=np.float32)
    for number, around in enumerate(find_objects(pieces), start=1):
        near = tuple(
            slice(max(each.start - MARGIN, 0), min(each.stop + MARGIN, n))
            for each, n in zip(around, mask.shape, strict=True)
        )
        np.maximum(field[near], _smoothed(pieces[near] == number), out=field[near])
    smooth = replace(part, values=field)
    notes = []
    if count > 1:
        voxel_ml = 1e-3 * float(np.prod(image.spacing_mm))
        sizes = voxel_ml * np.sort(np.bincount(pieces.ravel())[1:])[::-1]
        listed = ", ".join(f"{size:.3g}" for size in sizes[:_LISTED])
        more = "" if count <= _LISTED else f" and {counted(count - _LISTED, 'smaller one')}"
        notes.append(f"{name}: {count} pieces of {listed} ml{more}, all of them kept clear of")
    cuts = len(image_cuts(smooth, threshold=0.0))
    if cuts:
        places = counted(cuts, "place")
        notes.append(f"{name}: it ends at {places} at the edge of the image or of the crop, beyond which it is unknown")
    return image_triangles(smooth, threshold=0.0), tuple(notes)


def _smoothed(piece: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Above 0 in as many voxels as a piece has, smoothly, and nowhere far from any voxel of it."""
    from scipy.ndimage import binary_dilation, gaussian_filter

    field = gaussian_filter(piece.astype(np.float32), SMOOTH_VOXELS, mode="nearest")
    outside = field.size - int(np.count_nonzero(piece))
    below, above = np.partition(field, (outside - 1, outside), axis=None)[[outside - 1, outside]] if outside else (0, 1)
    field -= np.float32(0.5 * (below + above))
    lost = piece & ~binary_dilation(field > 0.0, np.ones((3, 3, 3)))
    field[lost] = 0.5
    return field
