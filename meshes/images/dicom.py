"""DICOM series as one image.

Slices, one or many a file, are sorted by place into an even stack, which may be sheared only by the
tilt of the gantry that the slices state. Uncompressed pixels are read by pydicom, others by GDCM.
Headers and the rules of privacy are in `meshes.images.dicom_files`.
"""

import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from meshes.base.arrays import Array, Numbers
from meshes.base.errors import InputError, by, counted
from meshes.base.file_limits import require_memory
from meshes.images.dicom_files import (
    Frame,
    damaged,
    dicom_files,
    frames_of,
    read_dataset,
    refused,
)
from meshes.images.frame import StoredImage

__all__ = ["Slice", "normal_of", "read_dicom", "slice_of", "stacked", "stored_pixels"]

_INVERTED = "MONOCHROME1"
"""Photometric interpretation whose low values are displayed as white."""
_GREY = ("MONOCHROME2", _INVERTED)
_PARALLEL = 1e-4
"""Largest difference of direction cosines of parallel slices: 0.05 mm over 500 mm."""
_UNIT = 1e-3
"""Tolerance of unit vectors, right angles and, relative, of pixel spacings; headers round them."""
_UNEVEN = 0.05
"""Largest distance of a slice from its place in an even stack, in spacings."""
_ROUNDED = 0.75
"""Likewise, in units of the last decimal that the positions are written with.

Rounding moves a slice by half a unit, and the line through all slices by less than a quarter.
"""
_COARSEST_MM = 0.1
"""Largest such unit: coarser positions are whole numbers of mm because the slices lie there."""
_MISSING = 0.4
"""Largest such distance in spacings for any rounding: a missing slice moves others by half."""
_TILT_DEG = 0.5
"""Difference of the stated tilt of the gantry from that of the positions; headers round both."""
_SHEAR_DEG = 0.05
"""Shear from which a note states it: 0.3 mm over 300 mm; less is rounding of positions."""
_AIR_HU = (-1100.0, -900.0)
"""Air is -1000 HU; noise and scatter move it by less than 100 HU."""


@dataclass(frozen=True, eq=False)
class Slice:
    """A frame with its place and scale.

    Attributes
    ----------
    frame
        File and header.
    position_mm
        Centre of the first pixel [mm, LPS], shape (3,).
    row, column
        Directions of growing column and row number, unit vectors [LPS].
    pixel_mm, size
        Distance [mm] and number of pixels along `row` and `column`.
    slope, intercept
        Scale of the stored values.
    rounding_mm
        Unit of the last decimal of the position [mm].
    """

    frame: Frame
    position_mm: Array
    row: Array
    column: Array
    pixel_mm: tuple[float, float]
    size: tuple[int, int]
    slope: float
    intercept: float
    rounding_mm: float


def read_dicom(path: Path, *, series: int | None = None) -> StoredImage:
    """Read the only series of a folder and the folders in it, or the series of a given number.

    The path may also be the folder's DICOMDIR or a file of many frames. Each slice has its own
    slope and intercept. Voxels of the padding value take the lowest other value of their slice.

    Raises
    ------
    InputError
        If the folder holds no series or several, a file is damaged, or the slices are no even stack
        of grey images.
    """
    files, notes = dicom_files(path)
    source = path.parent.name if path.name.upper() == "DICOMDIR" else path.name
    frames, left_out = frames_of(files, source)
    frames, other_series = _of_one_series(frames, series, source)
    notes += [*left_out, *other_series]
    slices = [slice_of(frame) for frame in frames]
    kinds = {frame.header["PhotometricInterpretation"] for frame in frames}
    if len(kinds) > 1:
        raise refused("slices", "all have one photometric interpretation", f"two in {source}")
    bits = max(int(frame.header["BitsAllocated"] or 0) for frame in frames)
    require_memory(
        sum(int(np.prod(each.size, dtype=object)) for each in slices) * bits // 8,
        source,
        f"{by((*slices[0].size, len(slices)))} voxels",
    )
    slices, step, remarks = stacked(slices, source)
    stored = stored_pixels(slices)
    if kinds == {_INVERTED}:
        stored, note = _upright(stored, slices, source)
        remarks.append(note)
    values, padded = _scaled(stored, slices)
    if padded:
        remarks.append(
            f"{padded} voxels of {source} are padding: they take the lowest value of their slice."
        )
    if any(frame.header["RescaleSlope"] is None for frame in frames):
        remarks.append(
            f"{source} states no rescale slope: its grey values are taken as they are stored."
        )
    first = slices[0]
    spacing = float(np.linalg.norm(step))
    directions = np.column_stack([first.row, first.column, step / spacing])
    return StoredImage(
        values.T,
        (*first.pixel_mm, spacing),
        directions,
        first.position_mm,
        (*notes, *remarks),
    )


def _of_one_series(
    frames: Sequence[Frame], series: int | None, source: str
) -> tuple[list[Frame], list[str]]:
    """Return the frames of the only series, or of the series of a number, and notes.

    Series of one slice, such as a scout or a dose report, are left out next to one stack. Series
    are distinguished by identifier and number, but named by number and slices alone.
    """
    names = [(str(frame.header["SeriesInstanceUID"]), _series_number(frame)) for frame in frames]
    counts = Counter(names)
    listed = ", ".join(f"number {name} of {n} slices" for (_, name), n in sorted(counts.items()))
    stacks = {name for name, count in counts.items() if count > 1} or set(names)
    wanted = stacks if series is None else {name for name in counts if name[1] == str(series)}
    if not wanted:
        raise InputError("series", f"be one that {source} holds", series, f"it holds {listed}")
    if len(wanted) > 1:
        raise InputError(
            "a DICOM folder",
            "hold one series",
            f"{len(counts)} in {source} ({listed})",
            "take one by `tissue import --series NUMBER`"
            if len({number for _, number in wanted}) > 1
            else "give the folder or the file of one of them",
        )
    notes = []
    if series is None and len(counts) > 1:
        single = counted(len(counts) - 1, "series of one slice")
        notes.append(f"Left out {single.removesuffix('s')} in {source}.")
    return [frame for frame, name in zip(frames, names, strict=True) if name in wanted], notes


def _series_number(frame: Frame) -> str:
    """Return the number of a series.

    Only a short whole number may pass from a header into a message.
    """
    try:
        number = int(frame.header["SeriesNumber"])
    except (TypeError, ValueError):
        return "?"
    return str(number) if abs(number) < 1_000_000 else "?"


def slice_of(frame: Frame, *, labels: bool = False) -> Slice:
    """Return a slice of checked place and size; those of labels may have a colour table.

    Raises
    ------
    InputError
        If a number is missing, or the pixels are no grey values.
    """
    header = frame.header
    is_grey = header["PhotometricInterpretation"] in _GREY or labels
    if not is_grey or header["SamplesPerPixel"] != 1:
        raise InputError(
            "a DICOM slice",
            "hold grey values (MONOCHROME2 or MONOCHROME1)",
            f"other values in {frame.place}",
            "take it out, or export grey values",
        )
    both = _numbers(frame, "ImageOrientationPatient", 6)
    down, along = _numbers(frame, "PixelSpacing", 2).tolist()
    position = _numbers(frame, "ImagePositionPatient", 3)
    slope = _number(frame, "RescaleSlope", 1.0)
    if slope == 0.0:
        raise refused("RescaleSlope", "differ from 0", f"it in {frame.place}")
    return Slice(
        frame,
        position_mm=position,
        row=both[:3],
        column=both[3:],
        pixel_mm=(along, down),
        size=(int(header["Columns"]), int(header["Rows"])),
        slope=slope,
        intercept=_number(frame, "RescaleIntercept", 0.0),
        rounding_mm=min(_last_decimal(each) for each in header["ImagePositionPatient"]),
    )


def _last_decimal(number: object) -> float:
    """Return the unit of the last decimal that a number is written with."""
    text = str(getattr(number, "original_string", number)).strip().lower()
    mantissa, _, exponent = text.partition("e")
    decimals = len(mantissa.partition(".")[2]) - int(exponent or 0)
    return min(float(10.0**-decimals), _COARSEST_MM)


def _numbers(frame: Frame, key: str, count: int) -> Array:
    """Return the finite numbers of an element."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = np.atleast_1d(np.array(frame.header[key], dtype=np.float64))
    except (TypeError, ValueError, OverflowError):
        found = np.empty(0)
    if found.shape != (count,) or not np.isfinite(found).all():
        noun = "number" if count == 1 else "numbers"
        raise refused(key, f"be {count} finite {noun}", f"none or others in {frame.place}")
    return found


def _number(frame: Frame, key: str, absent: float) -> float:
    """Return one number of an element, or a default if it is absent or empty."""
    missing = frame.header[key] in (None, "")
    return absent if missing else float(_numbers(frame, key, 1)[0])


def stacked(slices: Sequence[Slice], source: str) -> tuple[list[Slice], Array, list[str]]:
    """Return slices in their order along the normal, the step between them [mm, LPS], and notes.

    Raises
    ------
    InputError
        If they are no even stack.
    """
    if len(slices) < 2:
        raise InputError(
            "a DICOM folder",
            "hold two slices or more",
            f"one in {source}",
            "give the folder of the series",
        )
    first = slices[0]
    normal = normal_of(first)
    for other in slices[1:]:
        turned = max(np.abs(first.row - other.row).max(), np.abs(first.column - other.column).max())
        pixels_differ = not np.allclose(other.pixel_mm, first.pixel_mm, rtol=_UNIT)
        if other.size != first.size or pixels_differ or turned > _PARALLEL:
            raise InputError(
                "slices",
                "have one size, pixel spacing and orientation",
                f"another in {other.frame.place}",
                "take localisers and reformatted images out of the folder",
            )
    if all(np.array_equal(each.position_mm, first.position_mm) for each in slices):
        return _unplaced(slices, normal, source)
    ordered = sorted(slices, key=lambda each: float(each.position_mm @ normal))
    places = np.array([each.position_mm for each in ordered])
    rounding = min(each.rounding_mm for each in slices)
    _require_even(places @ normal, rounding, source)
    start, step = _line(places)
    gap = float(step @ normal)
    strays = np.abs(places - start - np.arange(len(ordered))[:, None] * step).max()
    if strays > max(_UNEVEN * gap, _ROUNDED * rounding):
        raise InputError(
            "slices",
            "lie on one line",
            f"positions that stray {strays:.3g} mm from it in {source}",
            "export one reconstruction",
        )
    tilts = [_number(each.frame, "GantryDetectorTilt", 0.0) for each in slices]
    tilt_deg = max(tilts, key=abs)
    shear_deg = float(np.degrees(np.arctan2(np.linalg.norm(step - gap * normal), gap)))
    if abs(tilt_deg) > _TILT_DEG and abs(abs(tilt_deg) - shear_deg) > _TILT_DEG:
        raise InputError(
            "positions",
            "show the tilt of the gantry",
            f"{tilt_deg:g} degrees stated and {shear_deg:.2g} shown in {source}",
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
    slices: Sequence[Slice], normal: Array, source: str
) -> tuple[list[Slice], Array, list[str]]:
    """Return the frames of one file that states the place of the first alone, with a note."""
    frame = slices[0].frame
    gap = _number(frame, "SpacingBetweenSlices", _number(frame, "SliceThickness", 0.0))
    if len({each.frame.file for each in slices}) > 1 or not gap > 0.0:
        _require_even(np.zeros(len(slices)), 0.0, source)
    note = (
        f"{source} states the place of its first frame alone: the others follow it {gap:g} mm "
        "apart along their normal."
    )
    return list(slices), gap * normal, [note]


def _line(places: Array) -> tuple[Array, Array]:
    """Return start and step of the even row of points nearest to points, by least squares."""
    at = np.arange(len(places)) - 0.5 * (len(places) - 1)
    step = at @ places / (at @ at)
    return places.mean(axis=0) + at[0] * step, step


def normal_of(first: Slice) -> Array:
    """Return the unit normal of a slice with valid directions."""
    lengths = np.linalg.norm([first.row, first.column], axis=1)
    if np.abs(lengths - 1.0).max() > _UNIT or abs(float(first.row @ first.column)) > _UNIT:
        requirement = "be two unit vectors at a right angle"
        what = "the orientation of a DICOM slice"
        raise refused(what, requirement, f"other in {first.frame.place}")
    normal: Array = np.cross(first.row, first.column)
    return normal / np.linalg.norm(normal)


def _require_even(heights: Array, rounding: float, source: str) -> None:
    """Refuse slices in one place, missing ones, and uneven spacing beyond rounding."""
    gaps = np.diff(heights)
    usual = float(gaps.min())
    widest = float(gaps.max())
    # 1e-6 mm: the median is 0 if most slices lie in one place.
    if usual <= _UNEVEN * max(float(np.median(gaps)), 1e-6):
        raise InputError(
            "slices",
            "each lie in a place of their own",
            f"two at one place in {source}",
            "leave one phase, echo or reconstruction in the folder",
        )
    start, step = _line(heights[:, None])
    away = np.abs(heights - start - np.arange(len(heights)) * step).max()
    even = min(max(_UNEVEN, _ROUNDED * rounding / step[0]), _MISSING)
    if away <= even * step[0]:
        return
    single = float(np.percentile(gaps, 50.0, method="lower"))
    times = gaps / single
    # Rounding moves both ends of a gap by half a unit.
    if (np.abs(times - np.rint(times)) * single <= _UNEVEN * widest + rounding).all():
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
        f"distances of {usual:.4g} to {widest:.4g} mm in {source}",
        "resample the series, or export the part that is even",
    )


def stored_pixels(slices: Sequence[Slice]) -> Numbers:
    """Return the stored values of slices, shape (slices, rows, columns).

    Raises
    ------
    InputError
        If a file cannot be decoded.
    """
    files: dict[Path, Numbers] = {}
    for each in slices:
        frame = each.frame
        if frame.file not in files:
            pixels = _decoded(each)
            if pixels.shape[1:] != each.size[::-1] or frame.number >= len(pixels):
                raise damaged(frame.place)
            files[frame.file] = pixels
    return np.stack([files[each.frame.file][each.frame.number] for each in slices])


def _decoded(first: Slice) -> Numbers:
    """Return the stored values of all frames of a file, shape (frames, rows, columns)."""
    from pydicom.uid import (
        ExplicitVRBigEndian,
        ExplicitVRLittleEndian,
        ImplicitVRLittleEndian,
    )

    frame = first.frame
    dataset = read_dataset(frame.file, frame.place)
    syntax = dataset.file_meta.get("TransferSyntaxUID")
    if syntax is not None and syntax.is_compressed:
        return _decompressed(first)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if syntax is None:  # a file without the group that states it
                is_implicit, is_little = dataset.original_encoding
                explicit = ExplicitVRLittleEndian if is_little else ExplicitVRBigEndian
                dataset.file_meta.TransferSyntaxUID = (
                    ImplicitVRLittleEndian if is_implicit else explicit
                )
            pixels: Numbers = np.asarray(dataset.pixel_array)
    except Exception as problem:  # damaged pixels raise many kinds
        raise damaged(frame.place) from problem
    return pixels.reshape(-1, *pixels.shape[-2:])


def _decompressed(first: Slice) -> Numbers:
    """Return the stored values of a compressed file by GDCM.

    GDCM applies slope and intercept of the first frame to all frames, and inverts MONOCHROME1
    before. Both are undone.
    """
    import SimpleITK

    frame = first.frame
    # its warnings may hold header content, which must not reach the terminal
    SimpleITK.ProcessObject.SetGlobalWarningDisplay(False)
    try:
        image = SimpleITK.ReadImage(str(frame.file), imageIO="GDCMImageIO")
        values = SimpleITK.GetArrayFromImage(image)
    except (RuntimeError, MemoryError) as problem:
        raise damaged(frame.place) from problem
    ours = next(each for each in frames_of([(frame.file, frame.place)], "")[0] if not each.number)
    scale = slice_of(ours)
    stored = np.rint((values - scale.intercept) / scale.slope).astype(np.int32)
    if frame.header["PhotometricInterpretation"] == _INVERTED:
        stored = _ends(first) - stored
    return stored


def _ends(each: Slice) -> int:
    """Return the lowest plus the highest value that a slice can store."""
    bits = int(_number(each.frame, "BitsStored", 16.0))
    is_signed = int(_number(each.frame, "PixelRepresentation", 0.0)) == 1
    return -1 if is_signed else 2**bits - 1


def _scaled(stored: Numbers, slices: Sequence[Slice]) -> tuple[Numbers, int]:
    """Return grey values by the scale of each slice, and the number of voxels of padding.

    Voxels of the padding value take the lowest other value of their slice.
    """
    whole = all(each.slope == 1.0 and each.intercept.is_integer() for each in slices)
    values = np.empty(stored.shape, dtype=np.int32 if whole else np.float32)
    padded = 0
    for plane, found, each in zip(stored, values, slices, strict=True):
        found[:] = each.slope * plane.astype(np.float64) + each.intercept
        frame = each.frame
        if frame.header["PixelPaddingValue"] in (None, ""):
            continue
        first = _number(frame, "PixelPaddingValue", 0.0)
        low, high = sorted((first, _number(frame, "PixelPaddingRangeLimit", first)))
        padding = (plane >= low) & (plane <= high)
        if padding.any() and not padding.all():
            found[padding] = found[~padding].min()
            padded += int(np.count_nonzero(padding))
    return values, padded


def _upright(stored: Numbers, slices: Sequence[Slice], source: str) -> tuple[Numbers, str]:
    """Return stored values of MONOCHROME1 whose rescale leads to bone above air, and a note.

    The rescale leads to Hounsfield units for any display (DICOM PS3.3, C.11.1), so it decides if it
    puts air at -1000. Values that were inverted without a change of the rescale are recognised by
    their air.
    """
    ends = np.array([_ends(each) for each in slices], dtype=np.int32)
    inverted = ends[:, None, None] - stored.astype(np.int32)
    low, high = _AIR_HU

    def air(values: Numbers) -> int:
        """Count the voxels of air."""
        count = 0
        for plane, each in zip(values, slices, strict=True):
            grey = each.slope * plane + each.intercept
            count += int(np.count_nonzero((grey > low) & (grey < high)))
        return count

    has_slope = slices[0].frame.header["RescaleSlope"] not in (None, "")
    as_stated, as_inverted = air(stored), air(inverted)
    if has_slope and (
        as_stated > as_inverted or (as_stated == as_inverted and slices[0].slope < 0.0)
    ):
        note = "displays low values as white (MONOCHROME1): its rescale leads to grey values."
        return stored, f"{source} {note}"
    if has_slope and as_stated == as_inverted:
        raise InputError(
            "it",
            f"be known whether values of {_INVERTED} are inverted",
            f"slices without air in {source}",
            "export them as MONOCHROME2",
        )
    note = "are stored inverted (MONOCHROME1): they are inverted back."
    return inverted, f"The grey values of {source} {note}"
