"""A label image of one tooth made ready: cropped, its labels checked and turned into layers, islands dropped."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.tooth.layers import TOOTH_LAYERS

__all__ = ["EMPTY", "LayerImage", "layer_image"]

EMPTY = 255
"""Layer index of a voxel outside the tooth."""
_FEW_LABELS = 4096


@dataclass(frozen=True, eq=False)
class LayerImage:
    """Layers of the voxels of an image, cropped to the tooth.

    Attributes
    ----------
    layer
        Layer index, `EMPTY` outside the tooth, uint8, shape (nx, ny, nz).
    counts
        Voxels by layer name.
    island_count, island_voxels
        Loose pieces that were dropped, and voxels in them.
    first
        Voxel of the image that is the first of `layer`.
    """

    layer: NDArray[np.uint8]
    counts: Mapping[str, int]
    island_count: int
    island_voxels: int
    first: tuple[int, int, int]


def layer_image(values: NDArray[np.number], labels: Mapping[int, str], source: str) -> LayerImage:
    """Crop a label image to its tooth, name its labels and drop what does not hang on the largest piece by faces.

    Parameters
    ----------
    values
        Labels, 0 outside, shape (nx, ny, nz).
    labels
        Layer name by label.

    Raises
    ------
    InputError
        If there is nothing but 0, a value is not a whole number, or a label has no name.
    """
    from scipy.ndimage import find_objects
    from scipy.ndimage import label as label_pieces

    filled = values != 0
    boxes = find_objects(filled.view(np.uint8))
    if not boxes:
        raise InputError("labels", "mark a tooth", f"nothing but 0 in {source}", "check the file")
    crop = boxes[0]
    cropped, filled = values[crop], filled[crop]
    found = _label_counts(cropped, source)
    unknown = {label: count for label, count in found.items() if label not in labels}
    if unknown:
        raise InputError(
            "labels",
            f"name every label of {source}",
            f"unnamed {', '.join((f'{label} ({count} voxels)' for label, count in unknown.items()))}",
            "add them, or set them to 0 in the file",
        )
    pieces = np.empty(filled.shape, dtype=np.int32, order="F" if filled.flags.f_contiguous else "C")
    label_pieces(filled, output=pieces)  # those that hang together by faces; 0 is outside
    sizes = np.bincount(pieces.ravel(order="K"))
    sizes[0] = 0
    main = int(np.argmax(sizes))
    lowest = min(0, *found)
    layer_of = np.full(max(found) - lowest + 1, EMPTY, dtype=np.uint8)
    for label in found:
        layer_of[label - lowest] = TOOTH_LAYERS.index(labels[label])
    layer = layer_of[cropped.astype(np.int64) - lowest if lowest or cropped.dtype.kind == "f" else cropped]
    layer[pieces != main] = EMPTY
    counts = np.bincount(layer.ravel(order="K"), minlength=EMPTY + 1)
    dropped = int(sizes.sum() - sizes[main])
    return LayerImage(
        layer,
        {name: int(counts[k]) for k, name in enumerate(TOOTH_LAYERS) if counts[k]},
        len(sizes) - 2,
        dropped,
        (crop[0].start, crop[1].start, crop[2].start),
    )


def _label_counts(values: NDArray[np.number], source: str) -> dict[int, int]:
    """Voxels of each label but 0, slice by slice along the last axis to spare memory."""
    found = Counter[int]()
    for k in range(values.shape[2]):
        numbers, counts = _distinct(values[:, :, k])
        if (numbers != np.rint(numbers)).any():
            part = numbers[numbers != np.rint(numbers)][0]
            raise InputError("labels", "be whole numbers", f"{part:g} in {source}", "use a label image")
        found.update(dict(zip(numbers.astype(np.int64).tolist(), counts.tolist(), strict=True)))
    del found[0]
    return dict(sorted(found.items()))


def _distinct(plane: NDArray[np.number]) -> tuple[NDArray[np.number], NDArray[np.int64]]:
    """Numbers in an array and how often each is there; without a sort where they are whole and few."""
    if plane.dtype.kind in "iu":
        lowest = int(plane.min())
        if int(plane.max()) - lowest < _FEW_LABELS:
            counts = np.bincount(plane.ravel(order="K").astype(np.int64) - lowest)
            numbers = np.flatnonzero(counts)
            return numbers + lowest, counts[numbers]
    return np.unique(plane, return_counts=True)
