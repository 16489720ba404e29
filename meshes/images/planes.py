"""Reading of grey values or labels from image planes (TIFF, PNG, BMP or JPEG files)."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from meshes.base.arrays import Numbers
from meshes.base.errors import InputError, by
from meshes.base.file_limits import require_memory
from meshes.images.frame import StoredImage
from meshes.images.plane_files import TIFF_STARTS

_LOSSY = (".jpg", ".jpeg")
_MIN_IS_WHITE = 0
_PALETTE = 3
_UNCOMPRESSED = 1
"""Value of the tag Compression in the TIFF 6.0 standard.

`_MIN_IS_WHITE` and `_PALETTE` are values of the tag PhotometricInterpretation.
"""
_GREY = (0.2126, 0.7152, 0.0722)
"""Weights of red, green and blue in the brightness of a colour (ITU-R BT.709)."""
_MODES = {
    "1": ("u1", 1),
    "L": ("u1", 1),
    "P": ("u1", 1),
    "I;16": ("u2", 1),
    "I;16B": ("u2", 1),
    "I": ("i4", 1),
    "F": ("f4", 1),
    "LA": ("u1", 2),
    "RGB": ("u1", 3),
    "RGBA": ("u1", 4),
}
"""Type and number of samples of a pixel, by Pillow mode."""
_EXPORT = "export the slice as grey values"
_MOST_COLOURS = 1000
"""Largest number of colours in an image whose colours can be labels.

Photographs and shaded pictures contain more colours.
"""


@dataclass(frozen=True, eq=False)
class _Planes:
    """Properties of the image planes in a file, known before the planes are decoded.

    Attributes
    ----------
    shape
        Number of planes, rows, columns and samples per pixel.
    axes
        Order of the axes in the decoded array, one letter per axis: Q for planes, Y for rows, X for
        columns, S for samples.
    photometric
        Meaning of the values: 0 if low is white, 1 if low is black, 2 for colours, 3 for indices of
        a colour table.
    bits
        Bits per value.
    dtype
        Type of the values.
    reduced
        Number of additional pictures of reduced size (thumbnails) in the file.
    """

    shape: tuple[int, int, int, int]
    axes: str
    photometric: int
    bits: int
    dtype: np.dtype[Any]
    reduced: int


def read_planes(
    files: Sequence[Path], spacing_mm: tuple[float, float, float], *, labels: bool = False
) -> StoredImage:
    """Read image planes and stack them in the order of `files`.

    The array axes of the result are columns, rows and slices. Values that are stored inverted
    (MinIsWhite) are inverted again. Colours are converted to grey values. If the planes contain
    labels, each colour is converted to a label number instead. Each change is reported in a note.

    Raises
    ------
    InputError
        If a file is damaged or differs in size or type from the other files, or if the stack
        exceeds the memory limit.
    """
    planes = [_planes(file) for file in files]
    _require_alike(files, planes)
    first = planes[0]
    count = sum(other.shape[0] for other in planes)
    where = files[0].name if len(files) == 1 else files[0].parent.name
    needed = count * prod(first.shape[1:]) * first.dtype.itemsize
    require_memory(needed, where, f"{by((*first.shape[2:0:-1], count))} voxels")
    values = np.concatenate(
        [_decoded(file, each) for file, each in zip(files, planes, strict=True)], axis=0
    )
    notes = []
    names: dict[int, str] = {}
    if sum(other.reduced for other in planes):
        notes.append(f"Reduced pictures (thumbnails) in the files of {where} are left out.")
    if files[0].suffix.lower() in _LOSSY:
        notes.append(
            f"JPEG changes the values of {where} near edges: export PNG or TIFF if you can."
        )
    if first.shape[3] > 1:
        grey, names, note = _without_colour(values, where, labels=labels)
        notes.append(note)
    else:
        grey = values[..., 0]
    if first.photometric == _PALETTE:
        notes.append(f"{where} states a colour table: its values are taken as they are stored.")
    if first.photometric == _MIN_IS_WHITE and labels:
        notes.append(f"{where} shows low values as white: labels are taken as they are stored.")
    elif first.photometric == _MIN_IS_WHITE:
        grey = _inverted(grey, first.bits, where)
        notes.append(
            f"The grey values of {where} are stored inverted (MinIsWhite): they are inverted back."
        )
    return StoredImage(grey.T, spacing_mm, np.eye(3), np.zeros(3), tuple(notes), names)


def _require_alike(files: Sequence[Path], planes: Sequence[_Planes]) -> None:
    """Raise an error if a file's planes differ in size or type from those of the first file."""
    first = planes[0]
    for file, other in zip(files, planes, strict=True):
        if other.shape[1:3] != first.shape[1:3]:
            raise InputError(
                "slices",
                "all have the same size",
                f"{by(other.shape[2:0:-1])} pixels in {file.name} after {by(first.shape[2:0:-1])}",
                "keep other images out of the folder",
            )
        kinds = {(each.photometric, each.shape[3], each.dtype) for each in (other, first)}
        if len(kinds) > 1:
            raise InputError(
                "slices",
                "all have the same type of values",
                f"{file.name} with another type than {files[0].name}",
                "export all slices with the same settings",
            )


def _without_colour(
    values: Numbers, where: str, *, labels: bool
) -> tuple[Numbers, dict[int, str], str]:
    """Convert colours to one value per pixel.

    Return the values, the names of the labels, and a note.

    For labels, each colour except black becomes a number with its own name. If a pixel has two or
    four samples, the last sample is the opacity. Transparent pixels become black.
    """
    samples = values.shape[-1]
    if samples in (2, 4):
        values = np.where(values[..., -1:] > 0, values[..., :-1], 0).astype(values.dtype)
    if (values == values[..., :1]).all():
        return values[..., 0], {}, f"{where} stores grey values as colours: they are taken as grey."
    if not labels:
        grey = (values @ np.array(_GREY, dtype=np.float32)).round().astype(values.dtype)
        note = (
            f"{where} has colours: the brightness is used as the grey value. If the colours are "
            "labels, give the file as labels."
        )
        return grey, {}, note
    shifts = np.array([1 << 2 * 8 * values.itemsize, 1 << 8 * values.itemsize, 1], dtype=np.uint64)
    found, codes, counts = np.unique(
        values.astype(np.uint64) @ shifts, return_inverse=True, return_counts=True
    )
    # The most frequent colour has the number 1. Black is the background.
    order = [at for at in np.argsort(-counts, kind="stable").tolist() if found[at]]
    if len(order) > _MOST_COLOURS:
        raise InputError(
            "labels",
            f"have at most {_MOST_COLOURS} colours",
            f"{len(order)} in {where}",
            "export label numbers instead of a picture",
        )
    numbers = np.zeros(len(found), dtype=np.uint16)
    numbers[order] = np.arange(1, len(order) + 1)
    colours = [[int(found[at]) // int(shift) % int(shifts[1]) for shift in shifts] for at in order]
    names = {
        number: "colour_" + "_".join(map(str, colour))
        for number, colour in enumerate(colours, start=1)
    }
    note = f"Each colour of {where} is a label. Black is the background."
    return numbers[codes].reshape(values.shape[:-1]), names, note


def _planes(file: Path) -> _Planes:
    """Read the header of an image file of any supported type."""
    try:
        with file.open("rb") as stream:
            is_tiff = stream.read(4).startswith(TIFF_STARTS)
        return _tiff_planes(file) if is_tiff else _picture_planes(file)
    except InputError:
        raise
    except Exception as problem:  # the libraries raise many types of errors for a damaged file
        raise _damaged(file) from problem


def _picture_planes(file: Path) -> _Planes:
    """Read the header of a PNG, BMP or JPEG file."""
    from PIL import Image

    with Image.open(file) as picture:
        kind, samples = _MODES.get(picture.mode, ("", 0))
        if not samples:
            raise InputError(
                "a slice",
                "contain grey values or colours",
                f"the mode {picture.mode} in {file.name}",
                _EXPORT,
            )
        shape = (1, picture.height, picture.width, samples)
        photometric = _PALETTE if picture.mode == "P" else 1
    dtype = np.dtype(kind)
    axes = "YX" if samples == 1 else "YXS"
    return _Planes(shape, axes, photometric, 8 * dtype.itemsize, dtype, 0)


def _tiff_planes(file: Path) -> _Planes:
    """Read the header of a TIFF file."""
    import tifffile

    with tifffile.TiffFile(file) as stored:
        page = stored.pages.first
        series = stored.series[0]
        axes = dict(zip(series.axes, series.shape, strict=True))
        further = [other.keyframe for other in stored.series[1:]]
        reduced = sum(bool(other.is_reduced) for other in further)
        photometric = int(page.photometric)
        rows = int(axes.pop("Y"))
        columns = int(axes.pop("X"))
        samples = int(axes.pop("S", 1))
        channels = int(axes.get("C", 1))
        bits = int(page.bitspersample)
        dtype = series.dtype
        size = prod(series.shape) * series.dtype.itemsize
        held = sum(page.databytecounts)
        plain = int(page.compression) == _UNCOMPRESSED and len(stored.pages) == prod(
            series.shape
        ) // (rows * columns * samples)
    if channels > 1 or samples > 4:
        raise InputError(
            "a TIFF slice",
            "contain one grey value or colour per pixel",
            f"{max(channels, samples)} channels in {file.name}",
            "export one channel",
        )
    if photometric > _PALETTE or len(further) > reduced:
        raise InputError(
            "a TIFF slice",
            "contain only one grey-value image",
            f"other content in {file.name}",
            _EXPORT,
        )
    stacked = [int(count) for count in axes.values() if count > 1]
    if len(stacked) > 1:
        raise InputError(
            "a TIFF file",
            "contain one stack",
            f"{by(stacked)} planes in {file.name}",
            "export one stack",
        )
    count = prod(stacked)
    # Pixels with fewer bits are packed, so their size is not known. A truncated file is smaller.
    if plain and bits >= 8 and count * held < size:
        raise _damaged(file)
    order = "".join(axis if axis in "YXS" else "Q" for axis in series.axes)
    return _Planes((count, rows, columns, samples), order, photometric, bits, dtype, reduced)


def _decoded(file: Path, planes: _Planes) -> Numbers:
    """Return the values of a file, shape (planes, rows, columns, samples)."""
    try:
        values = _array(file)
        # The axis of planes is first, and the axis of samples is last.
        order = sorted(range(len(planes.axes)), key=lambda at: "QYXS".index(planes.axes[at]))
        if values.ndim == len(order):
            values = values.transpose(order)
        values = values.reshape(planes.shape)
    except Exception as problem:  # the libraries raise many undocumented types of errors
        raise _damaged(file) from problem
    # A one-bit picture is read as booleans.
    kind = np.uint8 if values.dtype == bool else values.dtype.newbyteorder("=")
    return values.astype(kind, copy=False)


def _array(file: Path) -> Numbers:
    """Read the pixel array of an image file."""
    import tifffile
    from PIL import Image

    if file.suffix.lower() not in (".png", ".bmp", *_LOSSY):
        try:
            return np.asarray(tifffile.TiffFile(file).series[0].asarray())
        except tifffile.TiffFileError:
            pass  # a file without a suffix may be PNG
        except ValueError as problem:
            # For LZW, JPEG and CCITT, tifffile needs a further package. Pillow reads the usual
            # variants.
            if "imagecodecs" not in str(problem):
                raise
    with Image.open(file) as picture:
        return np.asarray(picture)


def _inverted(values: Numbers, bits: int, source: str) -> Numbers:
    """Invert values of an image in which the lowest value is white."""
    if values.dtype.kind != "u":
        raise InputError(
            "inverted grey values (MinIsWhite)",
            "be unsigned whole numbers",
            f"{values.dtype} in {source}",
            "export the slices with black as the lowest value",
        )
    return values.dtype.type(2**bits - 1) - values


def _damaged(file: Path) -> InputError:
    return InputError(
        "file",
        "be a readable slice",
        f"{file.name} (it is damaged or cut off)",
        "export it again",
    )
