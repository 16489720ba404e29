"""DICOM series as one image.

Headers are read by pydicom and pixels by GDCM. Slices are sorted by place into an even stack, which
may be sheared only by the tilt of the gantry that the slices state.

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

__all__ = ["read_dicom"]

Header = Mapping[str, Any]
"""Elements of a file by name."""
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
_INVERTED = "MONOCHROME1"
"""Photometric interpretation whose low values are displayed as white."""
_GREY = ("MONOCHROME2", _INVERTED)
_MAGIC = b"DICM"
_PREAMBLE = 128
"""Free bytes at the start of a file, before `_MAGIC` (DICOM PS3.10, 7.1)."""
_GROUP_LENGTH_BYTES = 12
"""Element that states the length of the group after it: tag 4, type 2, length 2, value 4 bytes."""
_PIECE = 1 << 20
"""Bytes inflated at once, so that a bomb of zeros is noticed at the memory limit."""
_UNDEFINED_LENGTH = 0xFFFFFFFF
"""Stated length of pixels that are compressed in parts (DICOM PS3.5, A.4)."""
_PARALLEL = 1e-4
"""Largest difference of direction cosines of parallel slices: 0.05 mm over 500 mm."""
_UNIT = 1e-3
"""Tolerance of unit vectors, right angles and, relative, of pixel spacings; headers round them."""
_UNEVEN = 0.05
"""Largest distance of a slice from its place in an even stack, in spacings.

Headers round positions.
"""
_TILT_DEG = 0.5
"""Difference of the stated tilt of the gantry from that of the positions; headers round both."""
_SHEAR_DEG = 0.05
"""Shear from which a note states it: 0.3 mm over 300 mm; less is rounding of positions."""
_AIR_HU = (-1100.0, -900.0)
"""Air is -1000 HU; noise and scatter move it by less than 100 HU."""


@dataclass(frozen=True, eq=False)
class _Slice:
    """A file of a series.

    Attributes
    ----------
    file, header
        File, and its elements.
    place
        Name of the slice in a message.
    position_mm
        Centre of the first pixel [mm, LPS], shape (3,).
    row, column
        Directions of growing column and row number, unit vectors [LPS].
    pixel_mm, size
        Distance [mm] and number of pixels along `row` and `column`.
    slope, intercept
        Scale of the stored values.
    """

    file: Path
    header: Header
    place: str
    position_mm: Array
    row: Array
    column: Array
    pixel_mm: tuple[float, float]
    size: tuple[int, int]
    slope: float
    intercept: float


def read_dicom(folder: Path, *, series: int | None = None) -> StoredImage:
    """Read the only series of a folder, or the series of a given number.

    Each slice has its own slope and intercept. Voxels of the padding value take the lowest other
    value of their slice.

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
    read = []
    for number, file in enumerate(files, start=1):
        place = f"file {number} of {len(files)} in the order of names in {folder.name}"
        read.append((file, _header(file, place), place))
    slices = [_slice(*each) for each in _of_one_series(read, series, folder)]
    kinds = {each.header["PhotometricInterpretation"] for each in slices}
    if len(kinds) > 1:
        raise _refused("slices", "all have one photometric interpretation", f"two in {folder.name}")
    bytes_each = max(int(each.header["BitsAllocated"] or 0) for each in slices) // 8
    require_memory(
        sum(int(np.prod(each.size, dtype=object)) for each in slices) * bytes_each,
        folder.name,
        f"{by((*slices[0].size, len(slices)))} voxels",
    )
    slices, step, notes = _stacked(slices, folder.name)
    planes = [_pixels(each) for each in slices]
    padded = sum(_replace_padding(plane, each) for plane, each in zip(planes, slices, strict=True))
    if padded:
        notes.append(
            f"{padded} voxels of {folder.name} are padding: they take the lowest value of "
            "their slice."
        )
    if any(each.header["RescaleSlope"] is None for each in slices):
        notes.append(
            f"{folder.name} states no rescale slope: its grey values are taken as they are stored."
        )
    values = np.concatenate(planes, axis=0)
    if kinds == {_INVERTED}:
        values, note = _upright(values, slices, folder.name)
        notes.append(note)
    first = slices[0]
    spacing = float(np.linalg.norm(step))
    directions = np.column_stack([first.row, first.column, step / spacing])
    return StoredImage(
        values.T, (*first.pixel_mm, spacing), directions, first.position_mm, tuple(notes)
    )


def _refused(what: str, requirement: str, found: str) -> InputError:
    return InputError(what, requirement, found, "export the series again")


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
                int(header[key]) for key in ("Rows", "Columns", "SamplesPerPixel", "BitsAllocated")
            ]
            frames = int(header["NumberOfFrames"] or 1)
            needed = int(np.prod(counts, dtype=object)) // 8 * frames
    except InputError:
        raise
    except Exception as problem:  # damaged headers raise many kinds
        raise _damaged(place) from problem
    # Compressed pixels always come in parts, others never do.
    if compressed != in_parts:
        raise _damaged(place)
    # DICOM pads every element to an even number of bytes.
    if not compressed and found != needed + needed % 2:
        requirement = f"hold the {needed} bytes of pixels that its header states"
        raise _refused("a DICOM slice", requirement, f"{found} in {place}")
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
    return _refused("a DICOM slice", "be whole and readable", f"a damaged one, {place}")


def _of_one_series(
    read: Sequence[tuple[Path, Header, str]], series: int | None, folder: Path
) -> list[tuple[Path, Header, str]]:
    """Return the files of the only series, or of the series of a number.

    Series are distinguished by identifier and number, but named by number and slices alone.
    """
    names = [(str(header["SeriesInstanceUID"]), _series_number(header)) for _, header, _ in read]
    counts = Counter(names)
    listed = ", ".join(f"number {name} of {n} slices" for (_, name), n in sorted(counts.items()))
    chosen = [at for at, (_, name) in enumerate(names) if series is None or name == str(series)]
    if not chosen:
        raise InputError("series", f"be one that {folder.name} holds", series, f"it holds {listed}")
    if len({names[at] for at in chosen}) > 1:
        raise InputError(
            "a DICOM folder",
            "hold one series",
            f"{len(counts)} in {folder.name} ({listed})",
            "give each a folder of its own, or let `tissue import --series NUMBER` take one",
        )
    return [read[at] for at in chosen]


def _series_number(header: Header) -> str:
    """Return the number of a series.

    Only a short whole number may pass from a header into a message.
    """
    try:
        number = int(header["SeriesNumber"])
    except (TypeError, ValueError):
        return "?"
    return str(number) if abs(number) < 1_000_000 else "?"


def _slice(file: Path, header: Header, place: str) -> _Slice:
    """Return a slice of checked place and size."""
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
    both = _numbers(header, "ImageOrientationPatient", 6, place)
    down, along = _numbers(header, "PixelSpacing", 2, place).tolist()
    return _Slice(
        file,
        header,
        place,
        position_mm=_numbers(header, "ImagePositionPatient", 3, place),
        row=both[:3],
        column=both[3:],
        pixel_mm=(along, down),
        size=(int(header["Columns"]), int(header["Rows"])),
        slope=_number(header, "RescaleSlope", 1.0, place),
        intercept=_number(header, "RescaleIntercept", 0.0, place),
    )


def _numbers(header: Header, key: str, count: int, place: str) -> Array:
    """Return the finite numbers of an element."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = np.atleast_1d(np.array(header[key], dtype=np.float64))
    except (TypeError, ValueError, OverflowError):
        found = np.empty(0)
    if found.shape != (count,) or not np.isfinite(found).all():
        noun = "number" if count == 1 else "numbers"
        raise _refused(key, f"be {count} finite {noun}", f"none or others in {place}")
    return found


def _number(header: Header, key: str, absent: float, place: str) -> float:
    """Return one number of an element, or a default if it is absent or empty."""
    return absent if header[key] in (None, "") else float(_numbers(header, key, 1, place)[0])


def _stacked(slices: Sequence[_Slice], source: str) -> tuple[list[_Slice], Array, list[str]]:
    """Return slices in their order along the normal, the step between them [mm, LPS], and notes."""
    if len(slices) < 2:
        raise InputError(
            "a DICOM folder", "hold two slices or more", f"one in {source}", "give the whole series"
        )
    first = slices[0]
    normal = _normal(first)
    for other in slices[1:]:
        turned = max(np.abs(first.row - other.row).max(), np.abs(first.column - other.column).max())
        pixels_differ = not np.allclose(other.pixel_mm, first.pixel_mm, rtol=_UNIT)
        if other.size != first.size or pixels_differ or turned > _PARALLEL:
            raise InputError(
                "slices",
                "have one size, pixel spacing and orientation",
                f"another in {other.place}",
                "take localisers and reformatted images out of the folder",
            )
    ordered = sorted(slices, key=lambda each: float(each.position_mm @ normal))
    places = np.array([each.position_mm for each in ordered])
    _require_even(places @ normal, source)
    step = (places[-1] - places[0]) / (len(ordered) - 1)
    gap = float(step @ normal)
    strays = np.abs(places - places[0] - np.arange(len(ordered))[:, None] * step).max()
    if strays > _UNEVEN * gap:
        raise InputError(
            "slices",
            "lie on one line",
            f"positions that stray {strays:.3g} mm from it in {source}",
            "export one reconstruction",
        )
    tilts = [_number(each.header, "GantryDetectorTilt", 0.0, each.place) for each in slices]
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


def _normal(first: _Slice) -> Array:
    """Return the unit normal of a slice with valid directions."""
    lengths = np.linalg.norm([first.row, first.column], axis=1)
    if np.abs(lengths - 1.0).max() > _UNIT or abs(float(first.row @ first.column)) > _UNIT:
        requirement = "be two unit vectors at a right angle"
        raise _refused("the orientation of a DICOM slice", requirement, f"other in {first.place}")
    normal: Array = np.cross(first.row, first.column)
    return normal / np.linalg.norm(normal)


def _require_even(heights: Array, source: str) -> None:
    """Refuse slices in one place, missing ones, and uneven spacing."""
    gaps = np.diff(heights)
    usual = float(gaps.min())
    widest = float(gaps.max())
    # 1e-6 mm: the median is 0 if most slices lie in one place.
    if usual <= _UNEVEN * max(float(np.median(gaps)), 1e-6):
        raise InputError(
            "slices",
            "each lie in a place of their own",
            f"two at one place in {source}",
            "leave one phase or reconstruction in the folder",
        )
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
        f"distances of {usual:.4g} to {widest:.4g} mm in {source}",
        "resample the series, or export the part that is even",
    )


def _pixels(stated: _Slice) -> Numbers:
    """Return the scaled grey values of a slice, shape (1, rows, columns)."""
    import SimpleITK

    # its warnings may hold header content, which must not reach the terminal
    SimpleITK.ProcessObject.SetGlobalWarningDisplay(False)
    try:
        image = SimpleITK.ReadImage(str(stated.file), imageIO="GDCMImageIO")
        plane: Numbers = SimpleITK.GetArrayFromImage(image)
    except (RuntimeError, MemoryError) as problem:
        raise _damaged(stated.place) from problem
    if plane.shape != (1, *stated.size[::-1]):
        raise _damaged(stated.place)
    return plane


def _replace_padding(plane: Numbers, stated: _Slice) -> int:
    """Give voxels of the padding value the lowest other value, in place, and count them."""
    header = stated.header
    if header["PixelPaddingValue"] in (None, ""):
        return 0
    first = _number(header, "PixelPaddingValue", 0.0, stated.place)
    last = _number(header, "PixelPaddingRangeLimit", first, stated.place)
    low, high = sorted(stated.slope * end + stated.intercept for end in (first, last))
    # Half a stored step: scaled values carry rounding.
    half = 0.5 * abs(stated.slope)
    padding = (plane > low - half) & (plane < high + half)
    if not padding.any() or padding.all():
        return 0
    plane[padding] = plane[~padding].min()
    return int(np.count_nonzero(padding))


def _upright(values: Numbers, slices: Sequence[_Slice], source: str) -> tuple[Numbers, str]:
    """Return slices of MONOCHROME1 with bone as the highest value, and a note.

    GDCM inverts their stored values before it applies slope and intercept. The rescale leads to
    Hounsfield units for any display (DICOM PS3.3, C.11.1), so it decides if it puts air at -1000.
    Values that were inverted without a change of the rescale are recognised by their air.
    """
    ends = []
    for each in slices:  # the lowest plus the highest value that a slice can hold
        bits = int(_number(each.header, "BitsStored", 16.0, each.place))
        signed = int(_number(each.header, "PixelRepresentation", 0.0, each.place)) == 1
        ends.append(each.slope * (-1.0 if signed else 2.0**bits - 1.0) + 2.0 * each.intercept)
    kind = values.dtype if values.dtype.kind == "f" else np.float32
    stated = (np.array(ends)[:, None, None] - values).astype(kind)
    low, high = _AIR_HU
    air = np.count_nonzero((stated > low) & (stated < high))
    air_inverted = np.count_nonzero((values > low) & (values < high))
    has_slope = slices[0].header["RescaleSlope"] not in (None, "")
    if has_slope and (air > air_inverted or (air == air_inverted and slices[0].slope < 0.0)):
        note = "displays low values as white (MONOCHROME1): its rescale leads to grey values."
        return stated, f"{source} {note}"
    if has_slope and air == air_inverted:
        raise InputError(
            "it",
            f"be known whether values of {_INVERTED} are inverted",
            f"slices without air in {source}",
            "export them as MONOCHROME2",
        )
    note = "are stored inverted (MONOCHROME1): they are inverted back."
    return values, f"The grey values of {source} {note}"
