"""Stacks of planes, TIFF, PNG, BMP or JPEG: order of the files, and their grey values."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from meshes.base.arrays import Numbers
from meshes.base.errors import InputError, by, is_folder, require_file
from meshes.base.file_limits import require_memory
from meshes.base.text_tables import natural_order
from meshes.images.dicom_files import is_dicom
from meshes.images.frame import StoredImage

__all__ = ["PLANE_SUFFIXES", "plane_files", "read_planes"]

PLANE_SUFFIXES = (".tif", ".tiff", ".png", ".bmp", ".jpg", ".jpeg")
_LOSSY = (".jpg", ".jpeg")
_VOLUMES = (".nii", ".nii.gz", ".nrrd", ".nhdr", ".mha", ".mhd", ".vti", ".dcm")
"""Endings of volumes, next to which a plane is a preview."""
_STARTS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+", b"\x89PNG")
"""First bytes of TIFF in both byte orders, of BigTIFF in both, and of PNG."""
_PATTERN_MARKS = "*?["
_MIN_IS_WHITE = 0
_PALETTE = 3
_UNCOMPRESSED = 1
"""Codes of the tags PhotometricInterpretation and Compression (TIFF 6.0)."""
_GREY = (0.2126, 0.7152, 0.0722)
"""Parts of red, green and blue in the brightness of a colour (ITU-R BT.709)."""
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
"""Type and number of the samples of a pixel by Pillow's modes."""
_EXPORT = "export it as grey values"
_MOST_COLOURS = 1000
"""Colours that count as labels: shades and pictures have more."""


@dataclass(frozen=True, eq=False)
class _Planes:
    """Planes of a file before they are decoded.

    Attributes
    ----------
    shape
        Planes, rows, columns and samples of a pixel.
    axes
        Order of these axes in the decoded array, by letter: planes Q, Y, X, and S for samples.
    photometric
        Meaning of the values: 0 low is white, 1 low is black, 2 colours, 3 numbers of a colour
        table.
    bits
        Bits per value.
    dtype
        Type of the values.
    reduced
        Number of reduced pictures (thumbnails) that the file holds in addition.
    """

    shape: tuple[int, int, int, int]
    axes: str
    photometric: int
    bits: int
    dtype: np.dtype[Any]
    reduced: int


def plane_files(path: Path) -> list[Path]:
    """Return the files of a stack of planes, in the order of their slices.

    The list is empty for other images, and for folders that hold DICOM files or volumes.

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
    if any(mark in path.name for mark in _PATTERN_MARKS) and not path.exists():
        inside = path.parent.iterdir() if path.parent.is_dir() else ()
        pattern = path.name.lower()
        found = [
            file for file in inside if fnmatchcase(file.name.lower(), pattern) and file.is_file()
        ]
        if not found:
            raise InputError(
                "file",
                "exist",
                f"{path}, which matches nothing",
                "check the folder and the pattern",
            )
        other = next((file for file in found if not _kind(file)), None)
        if other is not None:
            raise InputError(
                "a pattern", "match slices of one kind only", other.name, "write for example *.tif"
            )
    elif is_folder(path):
        found = _in_folder(path)
    else:
        require_file(path, "an image")
        return [path] if path.suffix.lower() in PLANE_SUFFIXES else []
    found.sort(key=lambda file: (natural_order(file.stem), file.name))
    _require_numbered(found, path)
    return found


def _in_folder(folder: Path) -> list[Path]:
    """Return the planes of a folder, of the kind that most of its planes have.

    A folder that holds one folder and nothing else stands for that folder.
    """
    held = [each for each in folder.iterdir() if not each.name.startswith(".")]
    if len(held) == 1 and held[0].is_dir() and not held[0].is_symlink():
        return _in_folder(held[0])
    files = [file for file in held if file.is_file()]
    kinds = {file: _kind(file) for file in files}
    counts = Counter(kind for kind in kinds.values() if kind)
    if not counts or any(file.name.lower().endswith(_VOLUMES) for file in files):
        return []
    if any(not kind and is_dicom(file) for file, kind in kinds.items()):
        return []
    usual = counts.most_common(1)[0][0]
    return [file for file, kind in kinds.items() if kind == usual]


def _kind(file: Path) -> str:
    """Return the kind of a plane, and an empty text for other files."""
    suffix = file.suffix.lower()
    if suffix in PLANE_SUFFIXES:
        return suffix[:3]
    if suffix and not suffix[1:].isdigit():
        return ""
    with file.open("rb") as stream:
        is_plane = stream.read(4).startswith(_STARTS)
    # DICOM may start like TIFF, in its preamble.
    return "no ending" if is_plane and not is_dicom(file) else ""


def read_planes(
    files: Sequence[Path], spacing_mm: tuple[float, float, float], *, labels: bool = False
) -> StoredImage:
    """Read planes in the given order, with the axes columns, rows and slices.

    Values that are stored inverted (MinIsWhite) are inverted back. Colours become grey values, or,
    as labels, a number for each colour. Each change is noted.

    Raises
    ------
    InputError
        If a file is damaged, differs in size or type from the others, or all exceed the memory
        limit.
    """
    planes = [_planes(file) for file in files]
    first = planes[0]
    for file, other in zip(files, planes, strict=True):
        if other.shape[1:3] != first.shape[1:3]:
            raise InputError(
                "slices",
                "all have the same size",
                f"{by(other.shape[2:0:-1])} in {file.name} after {by(first.shape[2:0:-1])}",
                "keep other images out of the folder",
            )
        kinds = {(each.photometric, each.shape[3], each.dtype) for each in (other, first)}
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


def _without_colour(
    values: Numbers, where: str, *, labels: bool
) -> tuple[Numbers, dict[int, str], str]:
    """Return one value a pixel, the names of colours that are labels, and a note.

    The last of two or four samples is opacity. Pixels without opacity are black.
    """
    samples = values.shape[-1]
    if samples in (2, 4):
        values = np.where(values[..., -1:] > 0, values[..., :-1], 0).astype(values.dtype)
    if (values == values[..., :1]).all():
        return values[..., 0], {}, f"{where} stores grey values as colours: they are taken as grey."
    if not labels:
        grey = (values @ np.array(_GREY, dtype=np.float32)).round().astype(values.dtype)
        note = (
            f"{where} holds colours: grey values are their brightness. If the colours are labels, "
            "give it as labels."
        )
        return grey, {}, note
    shifts = np.array([1 << 2 * 8 * values.itemsize, 1 << 8 * values.itemsize, 1], dtype=np.uint64)
    found, codes, counts = _distinct(values.astype(np.uint64) @ shifts)
    # The largest label comes first. Black is no label, whether there is any or not.
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
    note = f"Each colour of {where} is a label; black is none."
    return numbers[codes], names, note


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


def _distinct(codes: Numbers) -> tuple[Numbers, Numbers, Numbers]:
    """Return distinct numbers, the index of each element among them, and their counts."""
    if codes.max() < 1 << 24:
        # Colours of 8 bits: counting is ten times faster than sorting.
        counts = np.bincount(codes.ravel().astype(np.int64))
        found = np.flatnonzero(counts)
        index = np.zeros(len(counts), dtype=np.int32)
        index[found] = np.arange(len(found))
        return found, index[codes.astype(np.int64)], counts[found]
    different, at, sizes = np.unique(codes, return_inverse=True, return_counts=True)
    return different, at.reshape(codes.shape), sizes


def _planes(file: Path) -> _Planes:
    """Read the header of a file."""
    try:
        with file.open("rb") as stream:
            is_tiff = stream.read(4).startswith(_STARTS[:4])
        return _tiff_planes(file) if is_tiff else _picture_planes(file)
    except InputError:
        raise
    except Exception as problem:  # the readers raise many undocumented errors for a damaged file
        raise _damaged(file) from problem


def _picture_planes(file: Path) -> _Planes:
    """Read the header of a PNG, BMP or JPEG file."""
    from PIL import Image

    with Image.open(file) as picture:
        kind, samples = _MODES.get(picture.mode, ("", 0))
        if not samples:
            raise InputError(
                "a slice", "hold grey values or colours", f"{picture.mode} in {file.name}", _EXPORT
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
            "hold one grey value or colour per pixel",
            f"{max(channels, samples)} channels in {file.name}",
            "export one channel",
        )
    if photometric > _PALETTE or len(further) > reduced:
        raise InputError(
            "a TIFF slice",
            "hold one stack of grey values",
            f"other content in {file.name}",
            _EXPORT,
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
    order = "".join(axis if axis in "YXS" else "Q" for axis in series.axes)
    return _Planes((count, rows, columns, samples), order, photometric, bits, dtype, reduced)


def _decoded(file: Path, planes: _Planes) -> Numbers:
    """Return the values of a file, shape (planes, rows, columns, samples)."""
    try:
        values = _array(file)
        # The axes of planes come first, and those of samples last.
        order = sorted(range(len(planes.axes)), key=lambda at: "QYXS".index(planes.axes[at]))
        if values.ndim == len(order):
            values = values.transpose(order)
        values = values.reshape(planes.shape)
    except Exception as problem:  # the readers raise many kinds, none documented
        raise _damaged(file) from problem
    # A picture of one bit is read as booleans.
    kind = np.uint8 if values.dtype == bool else values.dtype.newbyteorder("=")
    return values.astype(kind, copy=False)


def _array(file: Path) -> Numbers:
    """Return the array of a file."""
    import tifffile
    from PIL import Image

    if file.suffix.lower() not in (".png", ".bmp", *_LOSSY):
        try:
            return np.asarray(tifffile.TiffFile(file).series[0].asarray())
        except tifffile.TiffFileError:
            pass  # a file without an ending may be PNG
        except ValueError as problem:
            # LZW, JPEG and CCITT need a further package; Pillow reads their usual forms.
            if "imagecodecs" not in str(problem):
                raise
    with Image.open(file) as picture:
        return np.asarray(picture)


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
        "be a readable slice",
        f"{file.name} (it is damaged or cut off)",
        "export it again",
    )
