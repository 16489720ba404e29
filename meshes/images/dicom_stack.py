"""Ordering of the slices of a DICOM series into one even stack.

It may be sheared only by the tilt of the gantry that the slices state.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError

__all__ = [
    "INVERTED",
    "Header",
    "Slice",
    "both_ends",
    "number",
    "numbers",
    "replace_padding",
    "stack_step",
    "upright",
]

_PARALLEL = 1e-4
_UNIT = 1e-3
_UNEVEN = 0.05
"""Largest distance of a slice from its place in an even stack, in spacings.

Headers round positions.
"""
_TILT_DEG = 0.5
_SHEAR_DEG = 0.05
Header = Mapping[str, Any]
"""Elements of a file by name."""
INVERTED = "MONOCHROME1"
"""Photometric interpretation whose low values are displayed as white."""
_AIR_HU = (-1100.0, -900.0)


@dataclass(frozen=True, eq=False)
class Slice:
    """Place and size of a slice.

    Attributes
    ----------
    position_mm
        Centre of the first pixel [mm, LPS], shape (3,).
    row, column
        Directions of growing column and row number, unit vectors [LPS].
    pixel_mm
        Distance of pixels along `row` and `column` [mm].
    size
        Pixels along `row` and `column`.
    tilt_deg
        Tilt of the gantry as stated [degrees].
    place
        Name of the slice in a message.
    """

    position_mm: NDArray[np.float64]
    row: NDArray[np.float64]
    column: NDArray[np.float64]
    pixel_mm: tuple[float, float]
    size: tuple[int, ...]
    tilt_deg: float
    place: str


def stack_step(
    slices: Sequence[Slice], source: str
) -> tuple[list[int], NDArray[np.float64], list[str]]:
    """Return the order of slices along their normal, the step between them, and notes.

    The step is in mm, LPS.

    Raises
    ------
    InputError
        If there are fewer than two, they differ in size, pixels or orientation, lie in one place or
        unevenly, or state a tilt that their positions do not show.
    """
    if len(slices) < 2:
        raise InputError(
            "a DICOM folder", "hold two slices or more", f"one in {source}", "give the whole series"
        )
    first = slices[0]
    normal = _normal(first)
    for other in slices[1:]:
        turned = max(np.abs(first.row - other.row).max(), np.abs(first.column - other.column).max())
        if (
            other.size != first.size
            or not np.allclose(other.pixel_mm, first.pixel_mm, rtol=_UNIT)
            or turned > _PARALLEL
        ):
            raise InputError(
                "slices",
                "have one size, pixel spacing and orientation",
                f"another in {other.place}",
                "take localisers and reformatted images out of the folder",
            )
    heights = np.array([other.position_mm @ normal for other in slices])
    order = [int(k) for k in np.argsort(heights, kind="stable")]
    _require_even(heights[order], source)
    places = np.array([slices[k].position_mm for k in order])
    step = (places[-1] - places[0]) / (len(slices) - 1)
    even = places[0] + np.arange(len(slices))[:, None] * step
    gap = float(step @ normal)
    if np.abs(places - even).max() > _UNEVEN * gap:
        raise InputError(
            "slices",
            "lie on one line",
            f"positions that stray {np.abs(places - even).max():.3g} mm from it in {source}",
            "export one reconstruction",
        )
    return (
        order,
        step,
        _shear_notes(step, normal, max((s.tilt_deg for s in slices), key=abs), source),
    )


def _normal(first: Slice) -> NDArray[np.float64]:
    """Return the unit normal of a slice with valid directions."""
    lengths = np.linalg.norm([first.row, first.column], axis=1)
    if np.abs(lengths - 1.0).max() > _UNIT or abs(float(first.row @ first.column)) > _UNIT:
        raise InputError(
            "the orientation of a DICOM slice",
            "be two unit vectors at a right angle",
            f"other in {first.place}",
            "export the series again",
        )
    normal: NDArray[np.float64] = np.cross(first.row, first.column)
    return normal / np.linalg.norm(normal)


def _require_even(heights: NDArray[np.float64], source: str) -> None:
    """Refuse slices in one place, missing ones, and uneven spacing."""
    gaps = np.diff(heights)
    usual = float(gaps.min())
    if usual <= _UNEVEN * max(float(np.median(gaps)), 1e-6):
        raise InputError(
            "slices",
            "each lie in a place of their own",
            f"two at one place in {source}",
            "leave one phase or reconstruction in the folder",
        )
    widest = float(gaps.max())
    if widest - usual <= _UNEVEN * widest:
        return
    times = gaps / usual
    if (np.abs(times - np.rint(times)) <= _UNEVEN * times).all():
        missing = int(np.rint(times).sum()) - len(gaps)
        raise InputError(
            "slices",
            "follow each other without a gap",
            f"{widest:.4g} mm where others are {usual:.4g} mm apart in {source}, {missing} missing",
            "export the whole series",
        )
    raise InputError(
        "slices",
        "be evenly spaced",
        f"distances of {gaps.min():.4g} to {widest:.4g} mm in {source}",
        "resample the series, or export the part that is even",
    )


def _shear_notes(
    step: NDArray[np.float64], normal: NDArray[np.float64], tilt_deg: float, source: str
) -> list[str]:
    """Return notes that a tilted gantry is undone; refuse a tilt that the positions do not show."""
    along = float(step @ normal)
    shear_deg = float(np.degrees(np.arctan2(np.linalg.norm(step - along * normal), along)))
    if abs(tilt_deg) > _TILT_DEG and abs(abs(tilt_deg) - shear_deg) > _TILT_DEG:
        raise InputError(
            "positions",
            "show the tilt of the gantry",
            f"{tilt_deg:g} degrees stated and {shear_deg:.2g} shown in {source}",
            "export the series resampled to straight slices",
        )
    if shear_deg <= _SHEAR_DEG:
        return []
    return [
        (
            f"The slices of {source} are sheared by {shear_deg:.3g} degrees, as a tilted gantry "
            "leaves them."
        )
    ]


def numbers(header: Header, key: str, count: int, place: str) -> NDArray[np.float64]:
    """Return the finite numbers of an element."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = np.atleast_1d(np.array(header[key], dtype=np.float64))
    except (TypeError, ValueError, OverflowError):
        found = np.empty(0)
    if found.shape != (count,) or not np.isfinite(found).all():
        raise InputError(
            key,
            f"be {count} finite {('number' if count == 1 else 'numbers')}",
            f"none or others in {place}",
            "export the series again",
        )
    return found


def number(header: Header, key: str, absent: float, place: str) -> float:
    """Return one number of an element, or a default if it is absent or empty."""
    return absent if header[key] in (None, "") else float(numbers(header, key, 1, place)[0])


def both_ends(header: Header, place: str) -> float:
    """Return the sum of the lowest and the highest value that a slice can hold.

    Slope and intercept are applied.
    """
    bits = int(number(header, "BitsStored", 16.0, place))
    signed = int(number(header, "PixelRepresentation", 0.0, place)) == 1
    ends = -1.0 if signed else 2.0**bits - 1.0
    slope = number(header, "RescaleSlope", 1.0, place)
    intercept = number(header, "RescaleIntercept", 0.0, place)
    return slope * ends + 2.0 * intercept


def upright(
    values: NDArray[np.number], ends: Sequence[float], first: Header, source: str
) -> tuple[NDArray[np.number], str]:
    """Return slices with bone as the highest value, and a note.

    The input may hold slices whose low values are displayed as white (MONOCHROME1).

    The rescale slope and intercept lead to Hounsfield units for any display (DICOM PS3.3, C.11.1),
    so they decide if they put air at -1000. Values that were inverted without a change of the
    rescale are recognised by their air.

    Parameters
    ----------
    values
        Slices as GDCM returns them, shape (slices, rows, columns): it inverts the stored values of
        MONOCHROME1 before it applies slope and intercept.
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
    air, air_inverted = (
        np.count_nonzero((each > low) & (each < high)) for each in (stated, values)
    )
    slope = first["RescaleSlope"]
    has_slope = slope not in (None, "")
    if has_slope and (air > air_inverted or (air == air_inverted and float(slope) < 0.0)):
        return (
            stated,
            (
                f"{source} displays low values as white (MONOCHROME1): its rescale leads to grey "
                "values."
            ),
        )
    if has_slope and air == air_inverted:
        raise InputError(
            "it",
            f"be known whether values of {INVERTED} are inverted",
            f"slices without air in {source}",
            "export them as MONOCHROME2",
        )
    return (
        values,
        f"The grey values of {source} are stored inverted (MONOCHROME1): they are inverted back.",
    )


def replace_padding(plane: NDArray[np.number], header: Header, place: str) -> int:
    """Give voxels of the padding value the lowest other value, in place, and count them."""
    if header["PixelPaddingValue"] in (None, ""):
        return 0
    first = number(header, "PixelPaddingValue", 0.0, place)
    last = number(header, "PixelPaddingRangeLimit", first, place)
    slope = number(header, "RescaleSlope", 1.0, place)
    intercept = number(header, "RescaleIntercept", 0.0, place)
    low, high = sorted((slope * first + intercept, slope * last + intercept))
    half = 0.5 * abs(slope)
    padding = (plane > low - half) & (plane < high + half)
    if not padding.any() or padding.all():
        return 0
    plane[padding] = plane[~padding].min()
    return int(np.count_nonzero(padding))
