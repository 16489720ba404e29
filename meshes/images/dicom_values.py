"""Grey values of DICOM slices: the numbers of their headers, padding, and values that are displayed inverted."""

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError

__all__ = ["INVERTED", "Header", "both_ends", "number", "numbers", "replace_padding", "upright"]

Header = Mapping[str, Any]
"""Elements of a file by name."""
INVERTED = "MONOCHROME1"
"""Photometric interpretation whose low values are displayed as white."""
_AIR_HU = (-1100.0, -900.0)


def numbers(header: Header, key: str, count: int, place: str) -> NDArray[np.float64]:
    """The finite numbers of an element."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = np.atleast_1d(np.array(header[key], dtype=np.float64))
    except (TypeError, ValueError, OverflowError):
        found = np.empty(0)
    if found.shape != (count,) or not np.isfinite(found).all():
        raise InputError(
            f"{key} must be {count} finite {'number' if count == 1 else 'numbers'}, got none or others in {place}: "
            "export the series again"
        )
    return found


def number(header: Header, key: str, absent: float, place: str) -> float:
    """One number of an element, or what stands for it where it is absent or empty."""
    return absent if header[key] in (None, "") else float(numbers(header, key, 1, place)[0])


def both_ends(header: Header, place: str) -> float:
    """Return the sum of the lowest and the highest value that a slice can hold, slope and intercept applied."""
    bits = int(number(header, "BitsStored", 16.0, place))
    signed = int(number(header, "PixelRepresentation", 0.0, place)) == 1
    ends = -1.0 if signed else 2.0**bits - 1.0
    slope, intercept = number(header, "RescaleSlope", 1.0, place), number(header, "RescaleIntercept", 0.0, place)
    return slope * ends + 2.0 * intercept


def upright(
    values: NDArray[np.number], ends: Sequence[float], first: Header, source: str
) -> tuple[NDArray[np.number], str]:
    """Return slices whose low values are displayed as white (MONOCHROME1) with bone as the highest value, and a note.

    The rescale slope and intercept lead to Hounsfield units whatever the display (DICOM PS3.3, C.11.1), so they decide
    where they put air at -1000. Values that were inverted without a change of the rescale are recognised by their air.

    Parameters
    ----------
    values
        Slices as GDCM returns them, shape (slices, rows, columns): it inverts the stored values of MONOCHROME1 before
        it applies slope and intercept.
    ends
        Lowest plus highest value of each slice.
    first
        Header of a slice.
    source
        Name of the folder.
    """
    kind = values.dtype if values.dtype.kind == "f" else np.float32
    stated = (np.asarray(ends, dtype=np.float64)[:, None, None] - values).astype(kind)
    low, high = _AIR_HU
    air, air_inverted = (np.count_nonzero((each > low) & (each < high)) for each in (stated, values))
    slope = first["RescaleSlope"]
    has_slope = slope not in (None, "")
    if has_slope and (air > air_inverted or (air == air_inverted and float(slope) < 0.0)):
        return stated, f"{source} displays low values as white (MONOCHROME1): its rescale leads to grey values."
    if has_slope and air == air_inverted:
        raise InputError(
            f"it must be known whether values of {INVERTED} are inverted, got slices without air in {source}: export "
            "them as MONOCHROME2"
        )
    return values, f"The grey values of {source} are stored inverted (MONOCHROME1): they are inverted back."


def replace_padding(plane: NDArray[np.number], header: Header, place: str) -> int:
    """Give voxels of the padding value the lowest other value, in place, and count them."""
    if header["PixelPaddingValue"] in (None, ""):
        return 0
    first = number(header, "PixelPaddingValue", 0.0, place)
    last = number(header, "PixelPaddingRangeLimit", first, place)
    slope, intercept = (number(header, "RescaleSlope", 1.0, place), number(header, "RescaleIntercept", 0.0, place))
    low, high = sorted((slope * first + intercept, slope * last + intercept))
    half = 0.5 * abs(slope)
    padding = (plane > low - half) & (plane < high + half)
    if not padding.any() or padding.all():
        return 0
    plane[padding] = plane[~padding].min()
    return int(np.count_nonzero(padding))
