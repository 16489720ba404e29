"""DICOM series as one image.

Headers are read by pydicom and pixels by GDCM. Slices are sorted by place into an even stack.

No data that identify a patient leave this module. Of the headers only `_READ` is read: size, place,
scale and series. A message counts files in the order of their names instead of naming them, because
exporters write names, dates and identifiers into file names. The folder's name is the user's.
"""

import warnings
import zlib
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError, by
from meshes.base.file_limits import memory_limit_bytes, require_memory
from meshes.images.dicom_stack import (
    INVERTED,
    Header,
    Slice,
    both_ends,
    number,
    numbers,
    replace_padding,
    stack_step,
    upright,
)
from meshes.images.frame import StoredImage
from meshes.images.itk import array_of, itk_reader

__all__ = ["read_dicom"]

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


def _pixels(file: Path, stated: Slice) -> NDArray[np.number]:
    """Return the grey values of a slice, shape (1, rows, columns).

    Slope and intercept are applied.
    """
    try:
        plane = array_of(itk_reader(file, "GDCMImageIO").Execute())
    except (RuntimeError, MemoryError) as problem:
        raise _damaged(stated.place) from problem
    if plane.shape != (*stated.size, 1):
        raise _damaged(stated.place)
    return plane.T
