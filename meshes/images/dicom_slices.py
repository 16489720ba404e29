"""Positions of DICOM slices, and their order as an evenly spaced stack."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array
from meshes.base.errors import InputError, counted
from meshes.images.dicom_files import Frame, refused

_PARALLEL = 1e-4
"""Largest difference between direction cosines of parallel slices.

This difference moves a point at a distance of 500 mm by 0.05 mm.
"""
_UNIT = 1e-3
"""Tolerance for unit lengths and right angles, and relative tolerance of pixel spacings.

Values in headers are rounded.
"""
_UNEVEN = 0.05
"""Largest distance of a slice from its expected position, in slice spacings.

If `_ROUNDED` gives a larger distance, that distance is used.
"""
_ROUNDED = 0.75
"""Largest distance of a slice from its expected position, in units of the position's last decimal.

Rounding moves a slice by up to half a unit, and moves the line that is fitted to all slices by less
than a quarter of a unit.
"""
_MISSING = 0.4
"""Upper limit of the position tolerance that is derived from rounding, in slice spacings.

The limit is below one half, because a missing slice can move its neighbours by half a spacing from
their expected positions.
"""
_TILT_DEG = 0.5
"""Tolerance between the stated tilt of the gantry and the tilt computed from positions [degrees].

Values in headers are rounded.
"""
_SHEAR_DEG = 0.05
"""Shear angle above which a note is written. This angle is a shift of 0.3 mm over 300 mm.

A smaller shear is a rounding error of positions.
"""


def stacked(slices: Sequence[Frame], source: str) -> tuple[list[Frame], Array, list[str]]:
    """Sort slices along their common normal.

    Return the sorted slices, the step between slices [mm, LPS], and notes.

    Raises
    ------
    InputError
        If the slices differ in size, pixel spacing or orientation, or are not evenly spaced.
    """
    if len(slices) < 2:
        raise InputError(
            "a DICOM folder",
            "contain at least two slices",
            f"one slice in {source}",
            "give the folder of the series",
        )
    first = slices[0]
    normal = normal_of(first)
    for other in slices[1:]:
        if not fit_together(first, other):
            raise InputError(
                "slices",
                "all have the same size, pixel spacing and orientation",
                f"a different one in {other.place}",
                "take localisers and reformatted images out of the folder",
            )
    if all(np.array_equal(each.position_mm, first.position_mm) for each in slices):
        return _unplaced(slices, normal, source)
    ordered = sorted(slices, key=lambda each: float(each.position_mm @ normal))
    places = np.array([each.position_mm for each in ordered])
    rounding = min(each.rounding_mm for each in slices)
    _require_even(places @ normal, rounding, source)
    start, step = even_row(places, np.arange(len(places)))
    gap = float(step @ normal)
    strays = np.abs(places - start - np.arange(len(ordered))[:, None] * step).max()
    if strays > max(_UNEVEN * gap, _ROUNDED * rounding):
        raise InputError(
            "slices",
            "lie on a straight line",
            f"deviations of {strays:.3g} mm in {source}",
            "export only one reconstruction",
        )
    tilts = [each.number("GantryDetectorTilt", 0.0) for each in slices]
    tilt_deg = max(tilts, key=abs)
    shear_deg = float(np.degrees(np.arctan2(np.linalg.norm(step - gap * normal), gap)))
    if abs(tilt_deg) > _TILT_DEG and abs(abs(tilt_deg) - shear_deg) > _TILT_DEG:
        raise InputError(
            "slice positions",
            f"agree with the gantry tilt of {tilt_deg:g} degrees in the header",
            f"a tilt of {shear_deg:.2g} degrees in {source}",
            "export the series resampled to straight slices",
        )
    notes = []
    if shear_deg > _SHEAR_DEG:
        notes.append(
            f"The slices of {source} are sheared by {shear_deg:.3g} degrees, as a tilted gantry "
            "leaves them."
        )
    return ordered, step, notes


def _unplaced(
    slices: Sequence[Frame], normal: Array, source: str
) -> tuple[list[Frame], Array, list[str]]:
    """Stack the frames of a file that only states the position of the first frame.

    Return the frames, the step between frames [mm, LPS], and a note.
    """
    first = slices[0]
    gap = first.number("SpacingBetweenSlices", first.number("SliceThickness", 0.0))
    if len({each.file for each in slices}) > 1 or not gap > 0.0:
        _require_even(np.zeros(len(slices)), 0.0, source)
    note = (
        f"{source} states only the position of its first frame: the other frames follow "
        f"{gap:g} mm apart along their normal."
    )
    return list(slices), gap * normal, [note]


def fit_together(one: Frame, other: Frame) -> bool:
    """Return whether two slices agree in size, pixel spacing and orientation."""
    turned = np.abs(one.axes - other.axes).max()
    pixels_agree = np.allclose(other.pixel_mm, one.pixel_mm, rtol=_UNIT)
    return other.size == one.size and pixels_agree and bool(turned <= _PARALLEL)


def even_row(points: Array, indices: NDArray[np.integer]) -> tuple[Array, Array]:
    """Fit evenly spaced points on a line to `points`, shape (n, k), by least squares.

    Point i is approximated by ``start + indices[i] * step``. The function returns `start` and
    `step`. At least two indices must differ.
    """
    middle = indices.mean()
    away = indices - middle
    step = away @ points / (away @ away)
    return points.mean(axis=0) - middle * step, step


def normal_of(first: Frame) -> Array:
    """Return the unit normal of a slice, whose axes must be valid."""
    row, column = first.axes
    lengths = np.linalg.norm(first.axes, axis=1)
    if np.abs(lengths - 1.0).max() > _UNIT or abs(float(row @ column)) > _UNIT:
        requirement = "be two unit vectors at a right angle"
        what = "the orientation of a DICOM slice"
        raise refused(what, requirement, f"other vectors in {first.place}")
    normal: Array = np.cross(row, column)
    return normal / np.linalg.norm(normal)


def _require_even(heights: Array, rounding: float, source: str) -> None:
    """Raise an error for slices at the same position, missing slices, and uneven spacing.

    Rounding errors of the positions are allowed.
    """
    gaps = np.diff(heights)
    usual = float(gaps.min())
    widest = float(gaps.max())
    # 1e-6 mm: the median is 0 if most slices lie at the same position.
    if usual <= _UNEVEN * max(float(np.median(gaps)), 1e-6):
        raise InputError(
            "slices",
            "have different positions",
            f"two slices at the same position in {source}",
            "keep only one phase, echo or reconstruction in the folder",
        )
    start, step = even_row(heights[:, None], np.arange(len(heights)))
    away = np.abs(heights - start - np.arange(len(heights)) * step).max()
    even = min(max(_UNEVEN, _ROUNDED * rounding / step[0]), _MISSING)
    if away <= even * step[0]:
        return
    single = float(np.percentile(gaps, 50.0, method="lower"))
    times = gaps / single
    # Rounding moves each of two neighbouring slices by up to half a unit.
    if (np.abs(times - np.rint(times)) * single <= _UNEVEN * widest + rounding).all():
        missing = int(np.rint(times).sum()) - len(gaps)
        raise InputError(
            "slices",
            "follow each other without a gap",
            (
                f"a step of {widest:.4g} mm among steps of {usual:.4g} mm in {source} "
                f"({counted(missing, 'slice')} missing)"
            ),
            "export the whole series",
        )
    raise InputError(
        "slices",
        "be evenly spaced",
        f"distances of {usual:.4g} to {widest:.4g} mm in {source}",
        "resample the series, or export the part that is even",
    )
