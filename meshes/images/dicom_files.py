"""DICOM files of a folder and the headers of their frames.

No data that identifies a patient leaves this module. Only the header elements in `_READ` are read.
These elements state kind, size, position, scale and series of an image. Exporters write patient
names, dates and identifiers into file names. Messages therefore refer to a file by its index in the
sorted list of file names. Messages may contain the name of the folder, because the user chose this
name.
"""

import os
import warnings
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError, counted, enumerated, is_folder
from meshes.base.file_limits import memory_limit_bytes, require_memory

Header = Mapping[str, Any]
"""Header elements of a frame by name; None for an element that the file does not contain."""
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
    "SOPInstanceUID",
    "Modality",
    "ImageType",
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
    "SliceThickness",
    "SpacingBetweenSlices",
    "GantryDetectorTilt",
    "PixelPaddingValue",
    "PixelPaddingRangeLimit",
    "RescaleIntercept",
    "RescaleSlope",
    "ReferencedSegmentNumber",
)
_SHARED = "SharedFunctionalGroupsSequence"
_EACH = "PerFrameFunctionalGroupsSequence"
"""Header sequences of multi-frame files: `_SHARED` for all frames together, `_EACH` per frame."""
_MAGIC = b"DICM"
_PREAMBLE = 128
"""Number of unused bytes at the start of a file, before `_MAGIC` (DICOM PS3.10, 7.1)."""
_FIRST_ELEMENTS = tuple(
    bytes((group, 0, element, 0)) for group in (2, 8) for element in (0, 1, 2, 5, 8, 0x16)
)
"""Little-endian tags with which a file without a preamble starts: groups 0002 and 0008."""
_GROUP_LENGTH_BYTES = 12
"""Size of the element that states the length of its group.

The element consists of a tag (4 bytes), a type (2 bytes), a length (2 bytes) and a value (4 bytes).
"""
_PIECE = 1 << 20
"""Number of bytes of a deflated file that are inflated at once.

A small file that inflates to a very large size is therefore detected when it exceeds the memory
limit.
"""
_UNDEFINED_LENGTH = 0xFFFFFFFF
"""Length that the header states for pixels that are compressed in fragments (DICOM PS3.5, A.4)."""
_MOST_FILES = 50_000
"""Largest number of files. The export of one examination has fewer files."""
_COARSEST_MM = 0.1
"""Upper limit [mm] of the rounding step that is assumed for a position in a header.

The rounding step is one unit of the last decimal. A position in whole millimetres would have a step
of 1 mm, although it is usually exact.
"""
_OTHER_OBJECTS = ("SEG", "RTSTRUCT", "RTPLAN", "RTDOSE", "SR", "PR", "KO", "REG", "DOC")
"""DICOM modalities without grey values. Exporters write such objects next to an image."""


@dataclass(frozen=True, eq=False)
class Frame:
    """Frame (one image plane) in a DICOM file. Most files contain one frame.

    The properties are read from the header when they are first used. A missing or damaged number
    raises an `InputError`.

    Attributes
    ----------
    file, index
        File, and index of the frame in the file.
    header
        Values of the header elements in `_READ`, by element name.
    place
        Text that identifies the frame's file in messages.
    """

    file: Path
    index: int
    header: Header
    place: str

    def numbers(self, key: str, count: int) -> Array:
        """Return the finite numbers in a header element, shape (count,)."""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                found = np.atleast_1d(np.array(self.header[key], dtype=np.float64))
        except (TypeError, ValueError, OverflowError):
            found = np.empty(0)
        if found.shape != (count,) or not np.isfinite(found).all():
            noun = "number" if count == 1 else "numbers"
            got = f"missing or invalid values in {self.place}"
            raise refused(key, f"be {count} finite {noun}", got)
        return found

    def number(self, key: str, absent: float) -> float:
        """Return the number in a header element, or `absent` if the element is missing or empty."""
        missing = self.header[key] in (None, "")
        return absent if missing else float(self.numbers(key, 1)[0])

    @property
    def size(self) -> tuple[int, int]:
        """Number of columns and rows."""
        return int(self.header["Columns"]), int(self.header["Rows"])

    @cached_property
    def position_mm(self) -> Array:
        """Centre of the first pixel [mm, LPS], shape (3,)."""
        return self.numbers("ImagePositionPatient", 3)

    @cached_property
    def axes(self) -> Array:
        """Unit vectors along which column and row numbers increase [LPS], shape (2, 3)."""
        return self.numbers("ImageOrientationPatient", 6).reshape(2, 3)

    @cached_property
    def pixel_mm(self) -> Array:
        """Distances between neighbouring pixels along `axes` [mm], shape (2,)."""
        return self.numbers("PixelSpacing", 2)[::-1]

    @cached_property
    def slope(self) -> float:
        """Slope of the grey values."""
        slope = self.number("RescaleSlope", 1.0)
        if slope == 0.0:
            raise refused("RescaleSlope", "not be 0", f"0 in {self.place}")
        return slope

    @cached_property
    def intercept(self) -> float:
        """Intercept of the grey values."""
        return self.number("RescaleIntercept", 0.0)

    @cached_property
    def rounding_mm(self) -> float:
        """Unit of the last decimal place of the stored position [mm]."""
        return min(_last_decimal(each) for each in self.header["ImagePositionPatient"])


def _last_decimal(number: object) -> float:
    """Return the unit of the last decimal of a written number, for example 0.01 for "3.14"."""
    text = str(getattr(number, "original_string", number)).strip().lower()
    mantissa, _, exponent = text.partition("e")
    decimals = len(mantissa.partition(".")[2]) - int(exponent or 0)
    return min(float(10.0**-decimals), _COARSEST_MM)


def refused(what: str, requirement: str, found: str) -> InputError:
    """Return the error for a DICOM series that cannot be used and must be exported again."""
    return InputError(what, requirement, found, "export the series again")


def damaged(place: str) -> InputError:
    """Return the error for a file that cannot be decoded."""
    return refused("a DICOM slice", "be complete and readable", f"a damaged slice: {place}")


@contextmanager
def reading(place: str) -> Iterator[None]:
    """Convert any error of pydicom in a ``with`` block to the error that `damaged` returns.

    pydicom raises many types of errors for a damaged file. The warnings of pydicom are suppressed,
    because they quote the content of the header.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except InputError:
        raise
    except Exception as problem:
        raise damaged(place) from problem


def is_dicom(file: Path) -> bool:
    """Return whether the first bytes of a file are those of DICOM, with or without a preamble."""
    with file.open("rb") as stream:
        head = stream.read(_PREAMBLE + len(_MAGIC))
    return head[_PREAMBLE:] == _MAGIC or head.startswith(_FIRST_ELEMENTS)


def dicom_files(path: Path) -> tuple[list[tuple[Path, str]], list[str]]:
    """Return the DICOM files of a path with a description of each file, and a list of notes.

    The path is a folder, a folder's DICOMDIR, or one file. Subfolders are searched too.

    Raises
    ------
    InputError
        If there are no DICOM files, or if a file that has the same suffix as the DICOM files is not
        DICOM.
    """
    if not is_folder(path) and path.name.upper() != "DICOMDIR":
        return [(path, path.name)], []
    folder = path if is_folder(path) else path.parent
    files = files_in(folder)
    places = {
        file: f"file {number} of {len(files)} in the order of names in {folder.name}"
        for number, file in enumerate(files, start=1)
    }
    found = {file: place for file, place in places.items() if is_dicom(file)}
    named = {(file.parent, file.suffix.lower()) for file in found if file.suffix}
    for file, place in places.items():
        # A slice that was overwritten or is empty must not be ignored silently.
        if file not in found and (file.parent, file.suffix.lower()) in named:
            raise InputError(
                "a DICOM folder",
                "contain only DICOM files",
                f"other data in {place}",
                "move this file out of the folder",
            )
    if not found:
        raise InputError(
            "file",
            "contain images",
            f"the folder {folder.name} without DICOM files and without TIFF or PNG slices",
            "give the folder that contains the slices",
        )
    others = len(files) - len(found)
    notes = [f"Left out {counted(others, 'file')} of {folder.name} of another kind than DICOM."]
    return list(found.items()), notes if others else []


def files_in(folder: Path) -> list[Path]:
    """Return the sorted files of a folder and its subfolders whose names may denote DICOM files.

    Raises
    ------
    InputError
        If there are more than 50,000 files.
    """
    found = []
    for within, folders, names in os.walk(folder):
        folders[:] = sorted(each for each in folders if not each.startswith("."))
        for name in sorted(names):
            file = Path(within) / name
            known = file.suffix.lower() in _NOT_SLICES or name.startswith(".")
            if not known and name.upper() != "DICOMDIR" and file.is_file():
                found.append(file)
        if len(found) > _MOST_FILES:
            raise InputError(
                "a DICOM folder",
                f"contain at most {_MOST_FILES} files",
                f"more files in {folder.name}",
                "give the folder of one examination",
            )
    return found


def frames_of(files: Sequence[tuple[Path, str]], source: str) -> tuple[list[Frame], list[str]]:
    """Return the frames with grey values in DICOM files, and notes on ignored files.

    Segmentations, plans, reports, localisers and duplicates are ignored.

    Raises
    ------
    InputError
        If no frame is left, or a file is damaged.
    """
    frames: dict[tuple[object, ...], Frame] = {}
    objects: list[str] = []
    localisers = copies = 0
    for file, place in files:
        dataset = read_dataset(file, place)
        modality = modality_of(dataset, place)
        if modality in _OTHER_OBJECTS:
            objects.append(modality)
            continue
        for frame in frames_in(file, dataset, place):
            header = frame.header
            keys = ("SeriesInstanceUID", "SeriesNumber", "SOPInstanceUID", "ImagePositionPatient")
            identity = (*(str(header[key]) for key in keys), frame.index)
            if "LOCALIZER" in (header["ImageType"] or ()):
                localisers += 1
            elif header["SOPInstanceUID"] and identity in frames:
                copies += 1
            else:
                frames[identity] = frame
    notes = []
    if localisers:
        notes.append(f"Left out {counted(localisers, 'localiser')} of {source}.")
    if copies:
        notes.append(f"Left out {counted(copies, 'duplicate')} of slices of {source}.")
    if not frames:
        held = enumerated(sorted(set(objects))) or "localisers"
        remedy = "give the folder of the CT as the image, and SEG or RTSTRUCT files as labels"
        raise InputError(
            "a DICOM folder", "contain slices of an image", f"only {held} in {source}", remedy
        )
    return list(frames.values()), notes


def read_dataset(file: Path, place: str, further: Sequence[str] = ()) -> Any:
    """Read a file with pydicom.

    The dataset contains the functional groups, the pixels, and the elements named in `_READ` and
    `further`.

    Raises
    ------
    InputError
        If the header is damaged.
    """
    import pydicom

    tags = [*_READ, *further, _SHARED, _EACH, "PixelData"]
    with reading(place):
        _require_inflated(file)
        # `force` reads a file without a preamble.
        return pydicom.dcmread(file, specific_tags=tags, force=True)


def modality_of(dataset: Any, place: str) -> str:
    """Return the modality of a DICOM dataset, such as CT or SEG."""
    with reading(place):  # pydicom converts an element when it is first used
        return str(dataset.get("Modality", ""))


def frames_in(file: Path, dataset: Any, place: str) -> list[Frame]:
    """Check the length of the pixel data in a file, and return the file's frames."""
    with reading(place):
        whole = {key: dataset.get(key) for key in _READ}
        shared = _flat(dataset.get(_SHARED))
        each = [_flat([item]) for item in dataset.get(_EACH) or ()]
        count = int(whole["NumberOfFrames"] or 1)
        _require_pixels(dataset, whole, count, place)
    if each and len(each) != count:
        raise damaged(place)
    return [
        Frame(file, index, {**whole, **shared, **(each[index] if each else {})}, place)
        for index in range(count)
    ]


def _flat(items: Sequence[Any] | None) -> dict[str, Any]:
    """Return the elements in `_READ` from the functional groups of one frame or of all frames."""
    found = {}
    for item in items or ():
        for element in item:
            if element.VR == "SQ" and element.value:
                group = element.value[0]
                found.update({key: group.get(key) for key in _READ if key in group})
    return found


def _require_pixels(dataset: Any, header: Header, frames: int, place: str) -> None:
    """Raise an error if the length of the pixel data differs from the length in the header."""
    keys = ("Rows", "Columns", "SamplesPerPixel", "BitsAllocated")
    # One-bit values are packed without padding at the ends of rows and frames.
    needed = -(-int(np.prod([int(header[key]) for key in keys], dtype=object)) * frames // 8)
    pixels = dataset.get_item("PixelData")
    in_parts = getattr(pixels, "length", None) == _UNDEFINED_LENGTH or getattr(
        pixels, "is_undefined_length", False
    )
    found = len(pixels.value)
    syntax = dataset.file_meta.get("TransferSyntaxUID")
    # Compressed pixels are always stored in parts, uncompressed pixels never.
    if (syntax is not None and syntax.is_compressed) != in_parts:
        raise damaged(place)
    # DICOM pads every element to an even number of bytes.
    if not in_parts and found != needed + needed % 2:
        requirement = f"contain the {needed} bytes of pixels that its header states"
        raise refused("a DICOM slice", requirement, f"{found} bytes in {place}")


def _require_inflated(file: Path) -> None:
    """Raise an error for a deflated file that inflates beyond the memory limit.

    pydicom would inflate the whole file without a limit.
    """
    import pydicom

    with file.open("rb") as stream:
        # Without the signature after a preamble, no group can state that the file is deflated.
        if stream.read(_PREAMBLE + len(_MAGIC))[_PREAMBLE:] != _MAGIC:
            return
    meta = pydicom.filereader.read_file_meta_info(file)
    if meta.get("TransferSyntaxUID") != pydicom.uid.DeflatedExplicitVRLittleEndian:
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
