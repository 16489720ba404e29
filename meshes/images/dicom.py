"""DICOM series as one image.

Headers are read by pydicom and pixels by GDCM. Slices are sorted by place into an even stack.

No data that identify a patient leave this module. Of the headers only `_READ` is read: size, place,
scale and series. A message counts files in the order of their names instead of naming them, because
exporters write names, dates and identifiers into file names. The folder's name is the user's.
"""

import warnings
import zlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from meshes.base.arrays import Array, Numbers
from meshes.base.errors import InputError, by
from meshes.base.file_limits import memory_limit_bytes, require_memory
from meshes.images.frame import StoredImage

__all__ = [
    "INVERTED",
    "Header",
    "Slice",
    "both_ends",
    "number",
    "numbers",
    "read_dicom",
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

    position_mm: Array
    row: Array
    column: Array
    pixel_mm: tuple[float, float]
    size: tuple[int, ...]
    tilt_deg: float
    place: str


def stack_step(slices: Sequence[Slice], source: str) -> tuple[list[int], Array, list[str]]:
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


def _normal(first: Slice) -> Array:
    """Return the unit normal of a slice with valid directions."""
    lengths = np.linalg.norm([first.row, first.column], axis=1)
    if np.abs(lengths - 1.0).max() > _UNIT or abs(float(first.row @ first.column)) > _UNIT:
        raise InputError(
            "the orientation of a DICOM slice",
            "be two unit vectors at a right angle",
            f"other in {first.place}",
            "export the series again",
        )
    normal: Array = np.cross(first.row, first.column)
    return normal / np.linalg.norm(normal)


def _require_even(heights: Array, source: str) -> None:
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


def _shear_notes(step: Array, normal: Array, tilt_deg: float, source: str) -> list[str]:
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


def numbers(header: Header, key: str, count: int, place: str) -> Array:
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
    values: Numbers, ends: Sequence[float], first: Header, source: str
) -> tuple[Numbers, str]:
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


def replace_padding(plane: Numbers, header: Header, place: str) -> int:
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


_NOT_SLICES = (
    ".txt",
    ".xml",
    ".json",
    ".csv",
    ".md",
    ".htm",
    ".html",
    ".pdf",
    ".jpg",
    ".jpeg",
    ".png",
    ".ini",
    ".inf",
)
_READ = (
    "SeriesInstanceUID",
    "SeriesNumber",
    "NumberOfFrames",
    "SamplesPerPixel",
    "PhotometricInterpretation",
    "Rows",
    "Columns",
    "BitsAllocated",
    "BitsStored",
    "PixelRepresentation",
    "ImagePositionPatient",
    "ImageOrientationPatient",
    "PixelSpacing",
    "GantryDetectorTilt",
    "PixelPaddingValue",
    "PixelPaddingRangeLimit",
    "RescaleIntercept",
    "RescaleSlope",
    "PixelData",
)
_GREY = ("MONOCHROME2", INVERTED)
_MAGIC = b"DICM"
_PREAMBLE = 128
_GROUP_LENGTH_BYTES = 12
_PIECE = 1 << 20
_UNDEFINED_LENGTH = 0xFFFFFFFF


def read_dicom(folder: Path, *, series: int | None = None) -> StoredImage:
    """Read the only series of a folder, or the series of a given number.

    Each slice has its own slope and intercept.

    Voxels of the padding value take the lowest other value of their slice.

    Raises
    ------
    InputError
        If the folder holds no series or several, a file is damaged, or the slices are no even stack
        of grey images.
    """
    files = [file for file in sorted(folder.iterdir()) if _may_be_slice(file)]
    if not files:
        raise InputError(
            "file",
            "hold images",
            f"the folder {folder.name} without DICOM files or TIFF slices",
            "give the folder that holds the slices",
        )
    places = [
        f"file {k + 1} of {len(files)} in the order of names in {folder.name}"
        for k in range(len(files))
    ]
    headers = [_header(file, place) for file, place in zip(files, places, strict=True)]
    if series is not None:
        chosen = _of_series(headers, series, folder)
        files = [files[k] for k in chosen]
        places = [places[k] for k in chosen]
        headers = [headers[k] for k in chosen]
    _require_one_series(headers, folder)
    slices = [_slice(header, place) for header, place in zip(headers, places, strict=True)]
    if len({header["PhotometricInterpretation"] for header in headers}) > 1:
        raise InputError(
            "slices",
            "all have one photometric interpretation",
            f"{' and '.join(_GREY)} in {folder.name}",
            "export the series again",
        )
    size = (*slices[0].size, len(slices))
    most_bytes = max(int(header["BitsAllocated"] or 0) for header in headers) // 8
    require_memory(
        sum(int(np.prod(s.size, dtype=object)) for s in slices) * most_bytes,
        folder.name,
        f"{by(size)} voxels",
    )
    order, step, notes = stack_step(slices, folder.name)
    planes = []
    padded = 0
    for k in order:
        plane = _pixels(files[k], slices[k])
        padded += replace_padding(plane, headers[k], places[k])
        planes.append(plane)
    if padded:
        notes.append(
            f"{padded} voxels of {folder.name} are padding: they take the lowest value of "
            "their slice."
        )
    if any(header["RescaleSlope"] is None for header in headers):
        notes.append(
            f"{folder.name} states no rescale slope: its grey values are taken as they are stored."
        )
    values = np.concatenate(planes, axis=0)
    if headers[0]["PhotometricInterpretation"] == INVERTED:
        values, note = upright(
            values, [both_ends(headers[k], places[k]) for k in order], headers[0], folder.name
        )
        notes.append(note)
    first = slices[order[0]]
    spacing = float(np.linalg.norm(step))
    directions = np.column_stack([first.row, first.column, step / spacing])
    return StoredImage(
        values.T, (*first.pixel_mm, spacing), directions, first.position_mm, tuple(notes)
    )


def _may_be_slice(file: Path) -> bool:
    """Return whether a file of the folder must be a slice.

    These are all files except the index and files that are clearly of another kind.
    """
    known = (
        file.suffix.lower() in _NOT_SLICES
        or file.name.startswith(".")
        or file.name.upper() == "DICOMDIR"
    )
    return file.is_file() and not known


def _header(file: Path, place: str) -> Header:
    """Return the elements `_READ` of a file by name.

    Only the length of the pixels is checked; they are not returned.
    """
    import pydicom

    with file.open("rb") as stream:
        head = stream.read(_PREAMBLE + len(_MAGIC))
    if head[_PREAMBLE:] != _MAGIC:
        raise InputError(
            "a DICOM folder", "hold DICOM files only", f"another kind as {place}", "take it out"
        )
    try:
        with warnings.catch_warnings():  # the warnings quote header content
            warnings.simplefilter("ignore")
            _require_inflated(file)
            dataset = pydicom.dcmread(file, specific_tags=list(_READ))
            compressed = dataset.file_meta.TransferSyntaxUID.is_compressed
            pixels = dataset.get_item("PixelData")
            in_parts = getattr(pixels, "length", None) == _UNDEFINED_LENGTH or getattr(
                pixels, "is_undefined_length", False
            )
            found = len(pixels.value)
            del dataset["PixelData"]
            header = {key: dataset.get(key) for key in _READ}
            counts = [
                header[key] for key in ("Rows", "Columns", "SamplesPerPixel", "BitsAllocated")
            ]
            needed = (
                int(np.prod([int(n) for n in counts], dtype=object))
                // 8
                * int(header["NumberOfFrames"] or 1)
            )
    except InputError:
        raise
    except Exception as problem:  # damaged headers raise many kinds
        raise _damaged(place) from problem
    if compressed != in_parts:
        raise _damaged(place)
    if not compressed and found != needed + needed % 2:
        raise InputError(
            "a DICOM slice",
            f"hold the {needed} bytes of pixels that its header states",
            f"{found} in {place}",
            "export the series again",
        )
    return header


def _require_inflated(file: Path) -> None:
    """Refuse a deflated file that inflates beyond the memory limit: pydicom inflates it at once."""
    import pydicom

    meta = pydicom.filereader.read_file_meta_info(file)
    if meta.TransferSyntaxUID != pydicom.uid.DeflatedExplicitVRLittleEndian:
        return
    start = _PREAMBLE + len(_MAGIC) + _GROUP_LENGTH_BYTES + int(meta.FileMetaInformationGroupLength)
    limit = memory_limit_bytes()
    found = 0
    inflate = zlib.decompressobj(-zlib.MAX_WBITS)
    packed = file.read_bytes()[start:]
    while packed and not inflate.eof and found <= limit:
        found += len(inflate.decompress(packed, _PIECE))
        packed = inflate.unconsumed_tail
    require_memory(found, file.parent.name, "a deflated slice")


def _damaged(place: str) -> InputError:
    return InputError(
        "a DICOM slice",
        "be whole and readable",
        f"a damaged one, {place}",
        "export the series again",
    )


def _require_one_series(headers: Sequence[Header], folder: Path) -> None:
    """Refuse several series.

    Series are distinguished by identifier and number, but named by number and slices alone.
    """
    found = Counter((str(header["SeriesInstanceUID"]), _whole(header)) for header in headers)
    if len(found) > 1:
        raise InputError(
            "a DICOM folder",
            "hold one series",
            f"{len(found)} in {folder.name} ({_named(headers)})",
            "give each a folder of its own, or let `tissue import --series NUMBER` take one",
        )


def _named(headers: Sequence[Header]) -> str:
    """Describe the series of some headers, by number and slices."""
    found = Counter((str(header["SeriesInstanceUID"]), _whole(header)) for header in headers)
    return ", ".join(
        f"number {number} of {count} slices" for (_, number), count in sorted(found.items())
    )


def _of_series(headers: Sequence[Header], number: int, folder: Path) -> list[int]:
    """Return the indices of the files that belong to the series of a number."""
    chosen = [k for k, header in enumerate(headers) if _whole(header) == str(number)]
    if not chosen:
        raise InputError(
            "series", f"be one that {folder.name} holds", number, f"it holds {_named(headers)}"
        )
    return chosen


def _whole(header: Header) -> str:
    """Return the number of a series.

    Only a short whole number may pass from a header into a message.
    """
    try:
        number = int(header["SeriesNumber"])
    except (TypeError, ValueError):
        return "?"
    return str(number) if abs(number) < 1_000_000 else "?"


def _slice(header: Header, place: str) -> Slice:
    """Return place and size of a slice."""
    if int(header["NumberOfFrames"] or 1) != 1:
        raise InputError(
            "a DICOM slice",
            "hold one frame",
            f"several in {place}",
            "export one file a slice, or as .nrrd",
        )
    if header["PhotometricInterpretation"] not in _GREY or header["SamplesPerPixel"] != 1:
        raise InputError(
            "a DICOM slice",
            "hold grey values (MONOCHROME2 or MONOCHROME1)",
            f"other values in {place}",
            "take it out, or export grey values",
        )
    both = numbers(header, "ImageOrientationPatient", 6, place)
    down, along = numbers(header, "PixelSpacing", 2, place).tolist()
    return Slice(
        position_mm=numbers(header, "ImagePositionPatient", 3, place),
        row=both[:3],
        column=both[3:],
        pixel_mm=(along, down),
        size=(int(header["Columns"]), int(header["Rows"])),
        tilt_deg=number(header, "GantryDetectorTilt", 0.0, place),
        place=place,
    )


def _pixels(file: Path, stated: Slice) -> Numbers:
    """Return the grey values of a slice, shape (1, rows, columns).

    Slope and intercept are applied.
    """
    import SimpleITK

    # its warnings may hold header content, which must not reach the terminal
    SimpleITK.ProcessObject.SetGlobalWarningDisplay(False)
    try:
        image = SimpleITK.ReadImage(str(file), imageIO="GDCMImageIO")
        plane: Numbers = SimpleITK.GetArrayFromImage(image)
    except (RuntimeError, MemoryError) as problem:
        raise _damaged(stated.place) from problem
    if plane.shape != (1, *stated.size[::-1]):
        raise _damaged(stated.place)
    return plane
