"""A DICOM series as one image: headers by pydicom, pixels by GDCM, slices sorted by place into an even stack.

Nothing that names a patient leaves this module: of the headers only `_READ` is read, size, place, scale and series, and
a message counts files in the order of their names instead of naming them, because exporters write names, dates and
identifiers into those. The folder's name is the user's.
"""

import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, by
from meshes.base.file_limits import require_memory
from meshes.images.dicom_stack import Slice, stack_step
from meshes.images.frame import StoredImage
from meshes.images.itk import array_of, itk_reader

__all__ = ["read_dicom"]

_NOT_SLICES = (".txt", ".xml", ".json", ".csv", ".md", ".htm", ".html", ".pdf", ".jpg", ".jpeg", ".png", ".ini", ".inf")
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
Header = Mapping[str, Any]
"""Elements of a file by name."""

_INVERTED = "MONOCHROME1"
_GREY = ("MONOCHROME2", _INVERTED)
_AIR_HU = (-1100.0, -900.0)
_MAGIC, _PREAMBLE = b"DICM", 128
_UNDEFINED_LENGTH = 0xFFFFFFFF


def read_dicom(folder: Path, *, series: int | None = None) -> StoredImage:
    """Read the one series that a folder holds, or the one of a number, each slice with its own slope and intercept.

    Voxels of the padding value take the lowest other value of their slice.

    Raises
    ------
    InputError
        If the folder holds no series or several, a file is damaged, or the slices are no even stack of grey images.
    """
    files = [file for file in sorted(folder.iterdir()) if _may_be_slice(file)]
    if not files:
        raise InputError(
            f"file must hold images, got the folder {folder.name} without DICOM files or TIFF slices: "
            "give the folder that holds the slices"
        )
    places = [f"file {k + 1} of {len(files)} in the order of names in {folder.name}" for k in range(len(files))]
    headers = [_header(file, place) for file, place in zip(files, places, strict=True)]
    if series is not None:
        chosen = _of_series(headers, series, folder)
        files, places, headers = [files[k] for k in chosen], [places[k] for k in chosen], [headers[k] for k in chosen]
    _require_one_series(headers, folder)
    slices = [_slice(header, place) for header, place in zip(headers, places, strict=True)]
    if len({header["PhotometricInterpretation"] for header in headers}) > 1:
        raise InputError(
            f"slices must all have one photometric interpretation, got {' and '.join(_GREY)} in {folder.name}: export "
            "the series again"
        )
    size = (*slices[0].size, len(slices))
    most_bytes = max(int(header["BitsAllocated"] or 0) for header in headers) // 8
    require_memory(
        sum(int(np.prod(s.size, dtype=object)) for s in slices) * most_bytes, folder.name, f"{by(size)} voxels"
    )
    order, step, notes = stack_step(slices, folder.name)
    planes, padded = [], 0
    for k in order:
        plane = _pixels(files[k], slices[k])
        padded += _replace_padding(plane, headers[k], places[k])
        planes.append(plane)
    if padded:
        notes.append(f"{padded} voxels of {folder.name} are padding: they take the lowest value of their slice.")
    if any(header["RescaleSlope"] is None for header in headers):
        notes.append(f"{folder.name} states no rescale slope: its grey values are taken as they are stored.")
    values = np.concatenate(planes, axis=0)
    if headers[0]["PhotometricInterpretation"] == _INVERTED:
        values, note = _upright(values, [_ends(headers[k], places[k]) for k in order], headers[0], folder.name)
        notes.append(note)
    first = slices[order[0]]
    spacing = float(np.linalg.norm(step))
    directions = np.column_stack([first.row, first.column, step / spacing])
    return StoredImage(values.T, (*first.pixel_mm, spacing), directions, first.position_mm, tuple(notes))


def _may_be_slice(file: Path) -> bool:
    """Whether a file of the folder must be a slice: all but the index and what is plainly something else."""
    known = file.suffix.lower() in _NOT_SLICES or file.name.startswith(".") or file.name.upper() == "DICOMDIR"
    return file.is_file() and not known


def _header(file: Path, place: str) -> Header:
    """The elements `_READ` of a file by name, but for the pixels, of which only the length is checked."""
    import pydicom

    with file.open("rb") as stream:
        head = stream.read(_PREAMBLE + len(_MAGIC))
    if head[_PREAMBLE:] != _MAGIC:
        raise InputError(f"a DICOM folder must hold DICOM files only, got another kind as {place}: take it out")
    try:
        with warnings.catch_warnings():  # they quote what they complain of
            warnings.simplefilter("ignore")
            dataset = pydicom.dcmread(file, specific_tags=list(_READ))
            compressed = dataset.file_meta.TransferSyntaxUID.is_compressed
            pixels = dataset.get_item("PixelData")
            in_parts = getattr(pixels, "length", None) == _UNDEFINED_LENGTH or getattr(
                pixels, "is_undefined_length", False
            )
            found = len(pixels.value)
            del dataset["PixelData"]
            header = {key: dataset.get(key) for key in _READ}
            counts = [header[key] for key in ("Rows", "Columns", "SamplesPerPixel", "BitsAllocated")]
            needed = int(np.prod([int(n) for n in counts], dtype=object)) // 8 * int(header["NumberOfFrames"] or 1)
    except Exception as problem:  # damaged headers raise many kinds
        raise InputError(_damaged(place)) from problem
    if compressed != in_parts:
        raise InputError(_damaged(place))
    if not compressed and found != needed + needed % 2:
        raise InputError(
            f"a DICOM slice must hold the {needed} bytes of pixels that its header states, got {found} in {place}: "
            "export the series again"
        )
    return header


def _damaged(place: str) -> str:
    return f"a DICOM slice must be whole and readable, got a damaged one, {place}: export the series again"


def _require_one_series(headers: Sequence[Header], folder: Path) -> None:
    """Refuse several series, distinguished by identifier and number but named by number and slices alone."""
    found = Counter((str(header["SeriesInstanceUID"]), _whole(header)) for header in headers)
    if len(found) > 1:
        raise InputError(
            f"a DICOM folder must hold one series, got {len(found)} in {folder.name} ({_named(headers)}): "
            "give each a folder of its own, or let `tissue import --series NUMBER` take one"
        )


def _named(headers: Sequence[Header]) -> str:
    """The series of some headers, by number and slices."""
    found = Counter((str(header["SeriesInstanceUID"]), _whole(header)) for header in headers)
    return ", ".join(f"number {number} of {count} slices" for (_, number), count in sorted(found.items()))


def _of_series(headers: Sequence[Header], number: int, folder: Path) -> list[int]:
    """Which files belong to the series of a number."""
    chosen = [k for k, header in enumerate(headers) if _whole(header) == str(number)]
    if not chosen:
        raise InputError(f"series must be one that {folder.name} holds, got {number}: it holds {_named(headers)}")
    return chosen


def _whole(header: Header) -> str:
    """The number of a series; nothing but a short whole number may pass from a header into a message."""
    try:
        number = int(header["SeriesNumber"])
    except (TypeError, ValueError):
        return "?"
    return str(number) if abs(number) < 1_000_000 else "?"


def _slice(header: Header, place: str) -> Slice:
    """Place and size of a slice."""
    if int(header["NumberOfFrames"] or 1) != 1:
        raise InputError(
            f"a DICOM slice must hold one frame, got several in {place}: export one file a slice, or as .nrrd"
        )
    if header["PhotometricInterpretation"] not in _GREY or header["SamplesPerPixel"] != 1:
        raise InputError(
            f"a DICOM slice must hold grey values (MONOCHROME2 or MONOCHROME1), got other values in {place}: take it "
            "out, or export grey values"
        )
    both = _numbers(header, "ImageOrientationPatient", 6, place)
    down, along = _numbers(header, "PixelSpacing", 2, place).tolist()
    return Slice(
        position_mm=_numbers(header, "ImagePositionPatient", 3, place),
        row=both[:3],
        column=both[3:],
        pixel_mm=(along, down),
        size=(int(header["Columns"]), int(header["Rows"])),
        tilt_deg=_number(header, "GantryDetectorTilt", 0.0, place),
        place=place,
    )


def _numbers(header: Header, key: str, count: int, place: str) -> NDArray[np.float64]:
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


def _number(header: Header, key: str, absent: float, place: str) -> float:
    """One number of an element, or what stands for it where it is absent or empty."""
    return absent if header[key] in (None, "") else float(_numbers(header, key, 1, place)[0])


def _pixels(file: Path, stated: Slice) -> NDArray[np.number]:
    """Grey values of a slice, slope and intercept applied, shape (1, rows, columns)."""
    try:
        plane = array_of(itk_reader(file, "GDCMImageIO").Execute())
    except (RuntimeError, MemoryError) as problem:
        raise InputError(_damaged(stated.place)) from problem
    if plane.shape != (*stated.size, 1):
        raise InputError(_damaged(stated.place))
    return plane.T


def _ends(header: Header, place: str) -> float:
    """Return the sum of the lowest and the highest value that a slice can hold, slope and intercept applied."""
    bits = int(_number(header, "BitsStored", 16.0, place))
    signed = int(_number(header, "PixelRepresentation", 0.0, place)) == 1
    both_ends = -1.0 if signed else 2.0**bits - 1.0
    slope, intercept = _number(header, "RescaleSlope", 1.0, place), _number(header, "RescaleIntercept", 0.0, place)
    return slope * both_ends + 2.0 * intercept


def _upright(
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
            f"it must be known whether values of {_INVERTED} are inverted, got slices without air in {source}: export "
            "them as MONOCHROME2"
        )
    return values, f"The grey values of {source} are stored inverted (MONOCHROME1): they are inverted back."


def _replace_padding(plane: NDArray[np.number], header: Header, place: str) -> int:
    """Give voxels of the padding value the lowest other value, in place, and count them."""
    if header["PixelPaddingValue"] in (None, ""):
        return 0
    first = _number(header, "PixelPaddingValue", 0.0, place)
    last = _number(header, "PixelPaddingRangeLimit", first, place)
    slope, intercept = (_number(header, "RescaleSlope", 1.0, place), _number(header, "RescaleIntercept", 0.0, place))
    low, high = sorted((slope * first + intercept, slope * last + intercept))
    half = 0.5 * abs(slope)
    padding = (plane > low - half) & (plane < high + half)
    if not padding.any() or padding.all():
        return 0
    plane[padding] = plane[~padding].min()
    return int(np.count_nonzero(padding))
