"""TIFF slices: selection and order of the files, and their grey values."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from meshes.base.arrays import Numbers
from meshes.base.errors import InputError, by, is_folder, require_file
from meshes.base.file_limits import require_memory
from meshes.base.text_tables import natural_order
from meshes.images.frame import StoredImage

__all__ = ["read_tiff_slices", "tiff_slices"]

SUFFIXES = (".tif", ".tiff")
_PATTERN_MARKS = "*?["
_COLOUR_AXES = "SC"
"""Axes of tifffile for samples of a pixel and for channels."""
_MIN_IS_WHITE = 0
_RGB = 2
_PALETTE = 3
_UNCOMPRESSED = 1
"""Codes of the tags PhotometricInterpretation and Compression (TIFF 6.0)."""


@dataclass(frozen=True, eq=False)
class _Planes:
    """Planes of a TIFF file before they are decoded.

    Attributes
    ----------
    shape
        Planes, rows and columns.
    photometric
        Meaning of the values: 0 low is white, 1 low is black, 3 numbers of a colour table.
    bits
        Bits per value.
    dtype
        Type of the values.
    reduced
        Number of reduced pictures (thumbnails) that the file holds in addition.
    """

    shape: tuple[int, int, int]
    photometric: int
    bits: int
    dtype: np.dtype[Any]
    reduced: int


def tiff_slices(path: Path) -> list[Path]:
    """Return the TIFF files of a path, in the order of their slices.

    The list is empty for other images.

    Files are ordered by the numbers in their names: ``slice_2`` comes before ``slice_10``.

    Parameters
    ----------
    path
        File, folder, or pattern of files such as ``slices/*.tif``.

    Raises
    ------
    InputError
        If the path does not exist, a file is named unlike the others, or a slice number is missing.
    """
    if any(mark in path.name for mark in _PATTERN_MARKS):
        found = [file for file in path.parent.glob(path.name) if file.is_file()]
        if not found:
            raise InputError(
                "file",
                "exist",
                f"{path}, which matches nothing",
                "check the folder and the pattern",
            )
        other = next((file for file in found if file.suffix.lower() not in SUFFIXES), None)
        if other is not None:
            raise InputError(
                "a pattern", "match TIFF slices only", other.name, "write for example *.tif"
            )
    elif is_folder(path):
        found = [
            file for file in path.iterdir() if file.suffix.lower() in SUFFIXES and file.is_file()
        ]
        found = [file for file in found if not file.name.startswith(".")]
    else:
        require_file(path, "an image")
        return [path] if path.suffix.lower() in SUFFIXES else []
    found.sort(key=lambda file: (natural_order(file.stem), file.name))
    _require_numbered(found, path)
    return found


def read_tiff_slices(
    files: Sequence[Path], spacing_mm: float, *, labels: bool = False
) -> StoredImage:
    """Read TIFF slices in the given order, with the axes columns, rows and slices.

    Values that are stored inverted (MinIsWhite) are inverted back, with a note.

    Raises
    ------
    InputError
        If a file is damaged, holds colours, differs in size from the others, or all exceed the
        memory limit.
    """
    planes = [_planes(file) for file in files]
    first = planes[0]
    for file, other in zip(files, planes, strict=True):
        if other.shape[1:] != first.shape[1:]:
            raise InputError(
                "slices",
                "all have the same size",
                f"{by(other.shape[:0:-1])} in {file.name} after {by(first.shape[:0:-1])}",
                "keep other images out of the folder",
            )
        kinds = {(each.photometric, each.bits, each.dtype) for each in (other, first)}
        if len(kinds) > 1:
            raise InputError(
                "slices",
                "all have the same type of values",
                f"another in {file.name} than in {files[0].name}",
                "export all slices in one way",
            )
    count = sum(other.shape[0] for other in planes)
    where = files[0].name if len(files) == 1 else files[0].parent.name
    needed = count * prod(first.shape[1:]) * first.dtype.itemsize
    require_memory(needed, where, f"{by((*first.shape[:0:-1], count))} voxels")
    decoded = [_decoded(file, each) for file, each in zip(files, planes, strict=True)]
    values = np.concatenate(decoded, axis=2)
    notes = []
    if sum(other.reduced for other in planes):
        notes.append(f"Reduced pictures (thumbnails) in the TIFF files of {where} are left out.")
    if first.photometric == _PALETTE:
        notes.append(f"{where} states a colour table: its values are taken as they are stored.")
    if first.photometric == _MIN_IS_WHITE and labels:
        notes.append(f"{where} shows low values as white: labels are taken as they are stored.")
    elif first.photometric == _MIN_IS_WHITE:
        values = _inverted(values, first.bits, where)
        notes.append(
            f"The grey values of {where} are stored inverted (MinIsWhite): they are inverted back."
        )
    return StoredImage(values, (spacing_mm,) * 3, np.eye(3), np.zeros(3), tuple(notes))


def _require_numbered(files: Sequence[Path], path: Path) -> None:
    """Refuse a file with an unusual name, a missing number, and a number that occurs twice."""
    if len(files) < 2:
        return
    texts = [re.sub(r"\d+", "#", file.stem) for file in files]
    usual, count = Counter(texts).most_common(1)[0]
    if "#" not in usual or 2 * count <= len(files):
        return  # the names do not count the slices
    other = next((file for file, text in zip(files, texts, strict=True) if text != usual), None)
    if other is not None:
        raise InputError(
            "slices",
            "be named alike",
            f"{other.name} among names such as {files[texts.index(usual)].name} in {path.name}",
            "move it out of the folder, or give a pattern that leaves it out",
        )
    numbers = np.array([re.findall(r"\d+", file.stem) for file in files]).astype(object)
    varying = [
        column for column in numbers.T if len({int(number) for number in column.tolist()}) > 1
    ]
    if len(varying) > 1:
        return  # it is unknown which of the numbers counts the slices
    steps = np.diff([int(number) for number in varying[0]]) if varying else np.zeros(1, np.int64)
    if not steps.all():
        raise InputError(
            "slices",
            "have numbers that differ",
            f"that of {files[int(np.argmin(steps)) + 1].name} twice in {path.name}",
            "remove one",
        )
    wide = int(np.argmax(steps))
    if steps[wide] > steps.min():
        missing = int(steps.sum() // steps.min()) - len(steps)
        raise InputError(
            "slice numbers",
            "follow each other",
            f"{files[wide + 1].name} after {files[wide].name} in {path.name}, {missing} missing",
            "export the whole stack",
        )


def _planes(file: Path) -> _Planes:
    """Read the header of a file."""
    import tifffile

    try:
        with tifffile.TiffFile(file) as stored:
            page = stored.pages.first
            series = stored.series[0]
            axes = dict(zip(series.axes, series.shape, strict=True))
            further = [other.keyframe for other in stored.series[1:]]
            reduced = sum(bool(other.is_reduced) for other in further)
            photometric = int(page.photometric)
            samples = int(page.samplesperpixel)
            rows = int(axes.pop("Y"))
            columns = int(axes.pop("X"))
            bits = int(page.bitspersample)
            dtype = series.dtype
            size = prod(series.shape) * series.dtype.itemsize
            held = sum(page.databytecounts)
            plain = (
                int(page.compression) == _UNCOMPRESSED
                and len(stored.pages) == prod(series.shape) // rows // columns
            )
    except Exception as problem:  # the reader raises many undocumented errors for a damaged file
        raise _damaged(file) from problem
    if samples != 1 or photometric == _RGB or any(axes.get(axis, 1) > 1 for axis in _COLOUR_AXES):
        raise InputError(
            "a TIFF slice",
            "hold one grey value per pixel",
            f"several (colour, or grey with transparency) in {file.name}",
            "export it as grey values",
        )
    if photometric not in (_MIN_IS_WHITE, 1, _PALETTE) or len(further) > reduced:
        raise InputError(
            "a TIFF slice",
            "hold one stack of grey values",
            f"other content in {file.name}",
            "export it as grey values",
        )
    stacked = [int(count) for count in axes.values() if count > 1]
    if len(stacked) > 1:
        raise InputError(
            "a TIFF file",
            "hold one stack",
            f"{by(stacked)} planes in {file.name}",
            "export one stack",
        )
    count = prod(stacked)
    # Pixels of fewer bits are packed, so their size is not known. A cut-off file holds less.
    if plain and bits >= 8 and count * held < size:
        raise _damaged(file)
    return _Planes((count, rows, columns), photometric, bits, dtype, reduced)


def _decoded(file: Path, planes: _Planes) -> Numbers:
    """Return the values of a file, shape (columns, rows, planes)."""
    from skimage.io import imread

    try:
        values = np.asarray(imread(file)).reshape(planes.shape)
    except Exception as problem:  # the readers raise many kinds, none documented
        raise _damaged(file) from problem
    # A picture of one bit is read as booleans.
    return values.astype(np.uint8 if values.dtype == bool else values.dtype, copy=False).T


def _inverted(values: Numbers, bits: int, source: str) -> Numbers:
    """Invert values whose lowest value is white, so that white is the highest."""
    if values.dtype.kind != "u":
        raise InputError(
            "inverted grey values (MinIsWhite)",
            "be whole numbers without a sign",
            f"{values.dtype} in {source}",
            "export it with black as the lowest value",
        )
    return values.dtype.type(2**bits - 1) - values


def _damaged(file: Path) -> InputError:
    return InputError(
        "file",
        "be a readable TIFF slice",
        f"{file.name} (it is damaged or cut off)",
        "export it again",
    )
