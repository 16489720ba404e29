"""MetaImage files, lines of text and an array, read without ITK.

ITK returns uninitialised memory where compressed voxels are damaged or their size is missing from
the header. It ignores slopes and units, reads invalid numbers as 0, and prints on the terminal.
"""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshes.base.errors import InputError
from meshes.images.data import read_voxels, scaled
from meshes.images.frame import StoredImage
from meshes.images.itk import header_lines, length_unit_mm, numbers

__all__ = ["read_metaimage"]

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
    absent: NDArray[np.float64],
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


def _voxels(fields: dict[str, str], path: Path, start: int) -> NDArray[np.number]:
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
