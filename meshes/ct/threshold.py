"""Bone by a threshold: a value suggested from the histogram, and what of the image is the bone."""

from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array, Flags
from meshes.base.errors import InputError
from meshes.ct.inspection import Histogram
from meshes.images.frame import Image

__all__ = ["Suggestion", "filled", "largest_component", "suggest_threshold"]

LOWEST_HU, HIGHEST_HU = 150.0, 600.0
"""Thresholds of bone in use: 150 for osteoporotic, 226 by common programs, 600 for the cortex alone."""
_SOFT = (-50.0, 120.0)
_MOST_HU = 1600.0
CLOSED_MM = 1.5
"""Gaps up to twice as wide in a cortex are closed: trabecular openings, vessels and partial volume."""


@dataclass(frozen=True)
class Suggestion:
    """A threshold and from what it follows.

    Attributes
    ----------
    threshold
        Value above which a voxel is bone.
    soft
        Most frequent value of soft tissue; None for an image of other units.
    note
        A sentence.
    """

    threshold: float
    soft: float | None
    note: str


EQUAL = 1e-9
"""Relative difference of two variances that count as equal: rounding of sums over up to 1e9 voxels."""


def suggest_threshold(histogram: Histogram, *, is_hounsfield: bool) -> Suggestion:
    """Suggest a threshold of bone by Otsu's criterion between soft tissue and bone.

    Of Hounsfield units only what lies above soft tissue counts, and the threshold is held within 150 to 600 HU.
    """
    values, counts = histogram.values.astype(np.float64), histogram.counts.astype(np.float64)
    if not is_hounsfield:
        level = _otsu(values, counts)
        return Suggestion(level, None, f"threshold {level:g} by Otsu's criterion over all values")
    soft = histogram.peak(*_SOFT)
    if soft is None:
        return Suggestion(226.0, None, "threshold 226 HU, as common programs have it: no soft tissue was found")
    part = (values > soft) & (values < _MOST_HU)
    level = _otsu(values[part], counts[part])
    held = min(max(round(level), LOWEST_HU), HIGHEST_HU)
    return Suggestion(held, soft, f"threshold {held:g} HU by Otsu's criterion above soft tissue at {soft:g} HU")


def _otsu(values: Array, counts: Array) -> float:
    """Return the value that parts a histogram with the largest variance between the parts (Otsu 1979).

    Empty bins between two parts all have that variance. The value lies in the middle between the parts.
    """
    weight = np.cumsum(counts)
    mass = np.cumsum(counts * values)
    total, whole = weight[-1], mass[-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        between = (whole * weight / total - mass) ** 2 / (weight * (total - weight))
    between = np.where(np.isfinite(between), between, -1.0)
    first = last = int(between.argmax())
    while last + 2 < len(values) and between[last + 1] >= (1.0 - EQUAL) * between[first]:
        last += 1
    if last == first:
        return float(values[first])
    return float(0.5 * (values[first] + values[min(last + 1, len(values) - 1)]))


def largest_component(mask: Flags, source: str) -> tuple[Flags, float]:
    """The largest piece of a mask, and the share of the next that it is not [0 to 1].

    Raises
    ------
    InputError
        If the mask is empty.
    """
    from scipy.ndimage import label

    pieces, count = label(mask)
    if count == 0:
        raise InputError(f"threshold must leave bone, got none in {source}: use a lower one, or another crop")
    sizes = np.bincount(pieces.ravel())[1:]
    largest = int(np.argmax(sizes))
    others = np.delete(sizes, largest)
    return pieces == largest + 1, float(others.max() / sizes[largest]) if len(others) else 0.0


def filled(mask: Flags, image: Image) -> Flags:
    """The mask with marrow and pores in it: gaps of the cortex closed, then what is enclosed in a plane is filled.

    A bone that the edge of the image cuts off encloses its marrow only in planes; each of the three directions counts.
    """
    from scipy.ndimage import binary_fill_holes, distance_transform_edt

    margin = [int(np.ceil(CLOSED_MM / size)) + 1 for size in image.spacing_mm]
    padded = np.pad(mask, [(m, m) for m in margin])
    grown = distance_transform_edt(~padded, sampling=image.spacing_mm) <= CLOSED_MM
    for axis in range(3):
        for k in range(padded.shape[axis]):
            plane = tuple(slice(None) if a != axis else k for a in range(3))
            if grown[plane].any():
                grown[plane] = binary_fill_holes(grown[plane])
    closed = distance_transform_edt(grown, sampling=image.spacing_mm) > CLOSED_MM
    inner = tuple(slice(m, -m) for m in margin)
    kept: Flags = (closed | padded)[inner]
    return kept
