"""MetaImage files, lines of text and an array, read without ITK.

ITK returns uninitialised memory where compressed voxels are damaged or their size is missing from
the header. It ignores slopes and units, reads invalid numbers as 0, and prints on the terminal.
"""

import math
import re
from collections.abc import Sequence
from math import prod
from pathlib import Path

import numpy as np

from meshes.base.arrays import Array, Numbers
from meshes.base.errors import InputError, by
from meshes.base.file_limits import require_memory, require_regular
from meshes.images.data import read_voxels, require_size, scaled
from meshes.images.frame import StoredImage
from meshes.images.itk import header_lines, length_unit_mm, numbers, read_by_itk

__all__ = ["read_metaimage", "read_nrrd"]

_TYPES = {
    "CHAR": "i1",
    "SHORT": "i2",
    "INT": "i4",
    "LONG": "i4",
    "LONG_LONG": "i8",
    "FLOAT": "f4",
    "DOUBLE": "f8",
}
_TYPES |= {f"U{name}": code.replace("i", "u") for name, code in _TYPES.items() if code[0] == "i"}
_BYTE_ORDERS = ("binarydatabyteordermsb", "elementbyteordermsb")
_DIRECTIONS = ("transformmatrix", "rotation", "orientation")
_PLACES = ("offset", "position", "origin")
_SPACINGS = ("elementspacing", "elementsize")
_ALONG_LPS = ("RAI", "???")
"""MetaImage names of axes that run from right, front (anterior) and feet (inferior)."""


def read_metaimage(path: Path) -> StoredImage:
    """Read a `.mhd` or `.mha` image of one number a voxel on three axes, its voxels in one file.

    Raises
    ------
    InputError
        If the file is cut off or damaged, or states values that cannot be applied.
    """
    fields, start = header_lines(path, "=", "elementdatafile")
    if "ndims" not in fields or "elementdatafile" not in fields:
        raise InputError(
            "file", "be a MetaImage", f"{path.name} which lacks the lines of one", "export it again"
        )
    if fields["ndims"] != "3" or fields.get("elementnumberofchannels", "1") != "1":
        raise InputError(
            "file",
            "hold one number per voxel on three axes",
            (
                f"NDims {fields['ndims']} and {fields.get('elementnumberofchannels', '1')} "
                f"channels in {path.name}"
            ),
            "export one of its volumes",
        )
    values = _voxels(fields, path, start)
    notes = []
    if not any(key in fields for key in _DIRECTIONS):
        if fields.get("anatomicalorientation", "???") not in _ALONG_LPS:
            raise InputError(
                "directions",
                "be given as TransformMatrix",
                f"AnatomicalOrientation alone in {path.name}",
                "export it again",
            )
        notes.append(
            f"{path.name} states no directions: its axes are taken as left, back and head."
        )
    unit = length_unit_mm(fields.get("distanceunits", "").split(), path)
    directions = np.reshape(_stated(fields, _DIRECTIONS, np.eye(3).ravel(), path), (3, 3)).T
    x, y, z = (unit * s for s in _stated(fields, _SPACINGS, np.ones(3), path, positive=True))
    origin = unit * np.array(_stated(fields, _PLACES, np.zeros(3), path))
    slope = numbers(fields, "elementtointensityfunctionslope", path) or [1.0]
    intercept = numbers(fields, "elementtointensityfunctionoffset", path) or [0.0]
    return StoredImage(
        scaled(values, slope[0], intercept[0]), (x, y, z), directions, origin, tuple(notes)
    )


def _stated(
    fields: dict[str, str],
    keys: Sequence[str],
    absent: Array,
    path: Path,
    *,
    positive: bool = False,
) -> list[float]:
    """Return the numbers of the first of several synonymous keys in a header.

    If the header has none of the keys, return the default. The number of values must be the same as
    in the default.
    """
    key = next((key for key in keys if key in fields), None)
    found = None if key is None else numbers(fields, key, path, positive=positive)
    if found is None:
        return absent.tolist()
    if len(found) != len(absent):
        raise InputError(
            key, f"be {len(absent)} numbers", f"{len(found)} in {path.name}", "fix the header"
        )
    return found


def _voxels(fields: dict[str, str], path: Path, start: int) -> Numbers:
    """Return the voxels from one file.

    Their number must be as stated in the header, and a checksum must fit if they are compressed.
    """
    name = fields["elementdatafile"]
    local = name.upper() == "LOCAL"
    data = path if local else path.parent / name
    if not data.is_file():
        raise InputError(
            f"the voxels of {path.name}",
            "lie in one file next to it",
            f"{name}, which is not there",
            "copy it there",
        )
    if not _is_true(fields, "binarydata", "True"):
        raise InputError(
            "BinaryData",
            "be True",
            f"{fields.get('binarydata')} in {path.name}",
            "export it binary",
        )
    size = numbers(fields, "dimsize", path) or []
    kind = fields.get("elementtype", "").removeprefix("MET_")
    if len(size) != 3 or any(n < 1 or n != int(n) for n in size) or kind not in _TYPES:
        raise InputError(
            "DimSize",
            "be three counts and ElementType one real number",
            f"{fields.get('dimsize')} and {fields.get('elementtype')} in {path.name}",
            "export it again",
        )
    most_significant_first = any(_is_true(fields, key, "False") for key in _BYTE_ORDERS)
    dtype = np.dtype((">" if most_significant_first else "<") + _TYPES[kind])
    shape = (int(size[0]), int(size[1]), int(size[2]))
    skipped = int((numbers(fields, "headersize", path) or [0])[0])
    first = (start if local else 0) + skipped
    if skipped == -1:  # the voxels end the file
        first = max(data.stat().st_size - dtype.itemsize * math.prod(shape), 0)
    if first < 0:
        raise InputError(
            "HeaderSize", "be -1 or more", f"{skipped} in {path.name}", "export it again"
        )
    return read_voxels(
        data, dtype, shape, start=first, compressed=_is_true(fields, "compresseddata", "False")
    )


def _is_true(fields: dict[str, str], key: str, absent: str) -> bool:
    """Return whether a key of a header is true."""
    return fields.get(key, absent).lower() in ("true", "1", "t")


_PATIENT = (
    "left-posterior-superior",
    "right-anterior-superior",
    "left-anterior-superior",
    "lps",
    "ras",
    "las",
)
_NO_PATIENT = ("", "scanner-xyz", "3d-right-handed")
_IN_SPACE = ("domain", "space", "none", "???")
_CHECKED = ("raw", "gzip", "gz")
_MOST_PER_BYTE = {"raw": 1.0, "gzip": 1100.0, "gz": 1100.0, "hex": 0.5}
_MOST_PER_BYTE |= dict.fromkeys(("ascii", "text", "txt"), 4.0)
"""Bytes of voxels that a byte of a data file can hold.

Deflate makes at most 1032 bytes of one. Text of two characters is one number of at most 8 bytes.
"""
_BYTES = {
    **dict.fromkeys(("char", "uchar", "unsigned char", "int8", "int8_t", "uint8", "uint8_t"), 1),
    **dict.fromkeys(("short", "short int", "int16", "int16_t"), 2),
    **dict.fromkeys(("ushort", "unsigned short", "unsigned short int", "uint16", "uint16_t"), 2),
    **dict.fromkeys(
        ("int", "int32", "int32_t", "uint", "unsigned int", "uint32", "uint32_t", "float"), 4
    ),
    **dict.fromkeys(("longlong", "long long", "long long int", "int64", "int64_t"), 8),
    **dict.fromkeys(
        (
            "ulonglong",
            "unsigned long long",
            "unsigned long long int",
            "uint64",
            "uint64_t",
            "double",
        ),
        8,
    ),
}
"""Bytes of a voxel by its type as NRRD names it."""
_PATTERN = re.compile(r"([^%]*%0?\d?d[^%]*?)\s+(-?\d{1,9})\s+(-?\d{1,9})\s+(-?\d{1,9})(?:\s+\d+)?$")
_MOST_FILES = 100_000
_LONGEST_LIST = 1 << 22
_SCALED = ("old min", "oldmin", "old max", "oldmax")


def read_nrrd(path: Path) -> StoredImage:
    """Read a `.nrrd` or `.nhdr` image of one number a voxel on three axes in space.

    Raises
    ------
    InputError
        If the file is cut off or damaged, or states values that cannot be applied.
    """
    fields, start = header_lines(path, ":", "")
    if not fields.get("first", "").startswith("NRRD"):
        raise InputError(
            "file",
            "be a NRRD image",
            f"{path.name} which does not start as one does",
            "export it again",
        )
    kinds = fields.get("kinds", "").lower()
    if fields.get("dimension") != "3" or any(kind not in _IN_SPACE for kind in kinds.split()):
        raise InputError(
            "file",
            "hold one number per voxel on three axes in space",
            f"dimension {fields.get('dimension')!r} and kinds {kinds!r} in {path.name}",
            "export one of its volumes",
        )
    held = next((key for key in _SCALED if key in fields), None)
    if held is not None:
        raise InputError(
            "a NRRD image",
            "hold its values unscaled",
            f"the key {held} in {path.name}",
            "export it again",
        )
    for key in ("space directions", "space origin", "axis mins"):
        numbers(fields, key, path)
    numbers(fields, "spacings", path, positive=True)
    unit = length_unit_mm((fields.get("space units") or fields.get("units") or "").split(), path)
    notes = _notes(fields, path)
    needed = _require_data(fields, path, start)
    stored = read_by_itk(path, "NrrdImageIO", unit_mm=unit, notes=notes)
    if stored.values.nbytes != needed:
        raise InputError(
            "file", "hold the voxels its header states", f"others in {path.name}", "export it again"
        )
    return stored


def _notes(fields: dict[str, str], path: Path) -> tuple[str, ...]:
    """Return the assumptions about the frame."""
    space = fields.get("space", "").lower()
    if space in _NO_PATIENT:
        return (
            f"{path.name} states no frame of a patient: its axes are taken as left, back and head.",
        )
    if space not in _PATIENT:
        raise InputError(
            "space",
            f"be one of {', '.join(_PATIENT[:3])}",
            f"{space!r} in {path.name}",
            "export it in one",
        )
    return ()


def _stated_bytes(fields: dict[str, str], path: Path) -> tuple[int, str]:
    """Return the bytes of the voxels by the header, and the voxels along the axes in words."""
    sizes = numbers(fields, "sizes", path, positive=True) or []
    kind = fields.get("type", "").lower().removeprefix("signed ")
    if len(sizes) != 3 or any(size != int(size) for size in sizes) or kind not in _BYTES:
        raise InputError(
            "sizes",
            "be three whole numbers and type one real number",
            f"{fields.get('sizes', 'nothing')} and {fields.get('type', 'nothing')} in {path.name}",
            "export it again",
        )
    return _BYTES[kind] * prod(int(size) for size in sizes), by(sizes)


def _data_files(fields: dict[str, str], path: Path) -> list[Path]:
    """Return the files that hold the voxels.

    They are the file itself, the file it names, or the files of a pattern or of a list.
    """
    name = fields.get("data file", fields.get("datafile"))
    if name is None:
        return [path]
    pattern = _PATTERN.match(name)
    if pattern is not None:
        first, last, step = (int(number) for number in pattern.groups()[1:])
        if step == 0 or not 0 <= (last - first) // step < _MOST_FILES:
            raise InputError(
                "data file", "count files", f"{name[:60]} in {path.name}", "export it again"
            )
        names = [
            pattern[1] % number for number in range(first, last + (1 if step > 0 else -1), step)
        ]
    elif name.split()[:1] == ["LIST"]:
        with path.open("rb") as stream:
            lines = stream.read(_LONGEST_LIST).decode("utf-8", "replace").splitlines()
        start = next(
            k for k, line in enumerate(lines) if re.match(r"data ?file:", line, re.IGNORECASE)
        )
        names = [line.strip() for line in lines[start + 1 :] if line.strip()]
    else:
        names = [name]
    return [path.parent / each for each in names]


def _require_data(fields: dict[str, str], path: Path, start: int) -> int:
    """Refuse voxels that are fewer or more than stated in the header, and return their bytes.

    The check comes before ITK, which allocates the stated size. The inflated bytes of compressed
    voxels are counted without being kept. Where bytes are skipped or several files hold the voxels,
    only the possible size is checked here; ITK refuses fewer.
    """
    needed, shape = _stated_bytes(fields, path)
    files = [require_regular(file) for file in _data_files(fields, path)]
    missing = next((file for file in files if not file.is_file()), None)
    if missing is not None:
        raise InputError(
            f"the voxels of {path.name}",
            "lie in the files it names",
            f"{missing.name[:60]}, which is not there",
            "copy it there",
        )
    encoding = fields.get("encoding", "").lower()
    held = sum(file.stat().st_size for file in files)
    if needed > _MOST_PER_BYTE.get(encoding, 0) * held:
        raise InputError(
            "file",
            f"hold the {needed} bytes of voxels its header states",
            f"{held} bytes of encoding {encoding[:20] or 'none'} in {path.name}",
            "export it again",
        )
    require_memory(needed, path.name, f"{shape} voxels")
    skips = any(
        fields.get(key.replace(" ", gap), "0") != "0"
        for key in ("line skip", "byte skip")
        for gap in (" ", "")
    )
    if encoding in _CHECKED and len(files) == 1 and not skips:
        require_size(
            files[0], start if files[0] == path else 0, needed, compressed=encoding != "raw"
        )
    return needed
