"""Comparison of a label with the grey values under it: a bone that lies where no bone is, a soft organ over air."""

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.ct.threshold import LOWEST_HU
from meshes.images.frame import Image

__all__ = ["bone_label_note", "soft_label_note"]

_NO_BONE, _LITTLE_BONE = 0.1, 0.5
"""Shares of a bone's label above the threshold of bone. The cortex alone is more than a tenth of any bone; where marrow
is the larger part of the label, as in the humeral head of an old person, more than half may lie below."""
_SOFT_HU = (-200.0, 300.0)
"""Where the median of a soft organ lies in any CT, contrast agent included [HU]."""
_CAUSES = "give the labels of this image, and check that they are not flipped, moved or of another organ"


def bone_label_note(image: Image, mask: NDArray[np.bool_], name: str) -> str:
    """Return a warning where most of a bone's label lies below 150 HU; an empty text where it does not.

    Parameters
    ----------
    image
        CT [HU].
    mask
        Voxels of the label, shape of the image, at least one.
    name
        Name of the label.

    Raises
    ------
    InputError
        If less than a tenth of the label is above 150 HU: it does not lie on bone.
    """
    values = image.values[mask]
    share = float(np.count_nonzero(values > LOWEST_HU) / len(values))
    found = f"{share:.0%} of its voxels above {LOWEST_HU:g} HU in {image.source}, median {np.median(values):.0f} HU"
    if share < _NO_BONE:
        raise InputError("region", "be a label on bone", f"{name} with {found}", _CAUSES)
    if share < _LITTLE_BONE:
        return f"warning: most of label {name} is not bone, {found}. If that is not marrow, {_CAUSES}."
    return ""


def soft_label_note(image: Image, mask: NDArray[np.bool_], name: str) -> str:
    """Return a warning where the median of a soft organ's label is no soft tissue's; an empty text where it is.

    Parameters are those of `bone_label_note`.
    """
    low, high = _SOFT_HU
    middle = float(np.median(image.values[mask]))
    if low <= middle <= high:
        return ""
    return f"warning: label {name} does not lie on soft tissue, its median is {middle:.0f} HU: {_CAUSES}."
