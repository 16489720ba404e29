"""Reading of MetaImage and NRRD images, which consist of a text header and an array.

The library ITK is not used. It returns uninitialised memory if compressed voxels are damaged or
their size is missing in the header. ITK also ignores slopes and units, reads invalid numbers as 0,
and prints messages on the terminal.
"""

import re
from collections.abc import Mapping, Sequence
from math import prod
from pathlib import Path

import numpy as np

from meshes.base.arrays import Array, Numbers
from meshes.base.errors import InputError, enumerated
from meshes.base.text_tables import number_in
from meshes.images.data import read_voxels, scaled
from meshes.images.frame import StoredImage

Fields = Mapping[str, str]
_LONGEST_HEADER = 1 << 20
"""Largest length of a header [byte].

3D Slicer writes several header lines for each segment, and a file may have hundreds of segments.
"""
_UNITS_MM = {
    **dict.fromkeys(("", "?", "mm", "millimeter", "millimetre", "millimeters", "millimetres"), 1.0),
    **dict.fromkeys(("um", "µm", "micrometer", "micrometre", "micron", "microns"), 1e-3),
    **dict.fromkeys(("cm", "centimeter", "centimetre"), 10.0),
    **dict.fromkeys(("m", "meter", "metre"), 1000.0),
}


_BYTES = {
    **dict.fromkeys(("char", "int8"), 1),
    **dict.fromkeys(("short", "int16"), 2),
    **dict.fromkeys(("int", "int32", "long"), 4),
    **dict.fromkeys(("longlong", "long long", "int64"), 8),
}
"""Number of bytes of each integer type. In a MetaImage, LONG has four bytes on every machine."""


def header_lines(path: Path, separator: str, last: str) -> tuple[dict[str, str], int]:
    """Read the lines of a header, each of the form `key separator value`.

    Return a dictionary from key to value, and the position of the first byte after the header.

    Keys are converted to lower case.

    Parameters
    ----------
    last
        Key of the line that ends the header. An empty line also ends the header. The first line
        without a separator is returned under the key "first".
    """
    with path.open("rb") as stream:
        data = stream.read(_LONGEST_HEADER)
    fields: dict[str, str] = {}
    at = 0
    while (end := data.find(b"\n", at)) >= 0:
        line = data[at:end].decode("utf-8", "replace").strip()
        at = end + 1
        if not line:
            break
        key, found, value = line.partition(separator)
        key = key.strip().lower()
        if not found:
            fields.setdefault("first", line)
        elif key in fields:
            raise _fault(path, "a header", "state every key once", f"{_short(key)} twice")
        elif not key.startswith("#"):
            fields[key] = value.strip()
        if key == last:
            break
    return fields, at


def numbers(fields: Fields, key: str, path: Path, *, positive: bool = False) -> list[float] | None:
    """Return the finite numbers of a header line, or None if the line is missing.

    Raises
    ------
    InputError
        If a word of the line is not a finite number, or if `positive` is set and a number is not
        above 0.
    """
    if key not in fields:
        return None
    try:
        found = [number_in(word) for word in re.sub("[(),]", " ", fields[key]).split()]
    except ValueError:
        found = [np.nan]
    if not np.isfinite(found).all():
        raise _fault(path, key, "be finite numbers", _short(fields[key]))
    if positive and min(found, default=0.0) <= 0.0:
        raise _fault(path, key, "be above 0", _short(fields[key]))
    return found


def _stated(
    fields: Fields, keys: Sequence[str], absent: Array, path: Path, *, positive: bool = False
) -> Array:
    """Return the numbers of the first key in `keys` that the header has, or else `absent`."""
    key = next((key for key in keys if key in fields), "")
    found = numbers(fields, key, path, positive=positive)
    if found is None:
        return absent
    if len(found) != absent.size:
        raise _fault(path, key, f"be {absent.size} numbers", f"{len(found)} numbers")
    return np.reshape(found, absent.shape)


def _unit_mm(words: Sequence[str], path: Path) -> float:
    """Return the length [mm] of the unit that a header states for the axes.

    All axes must have the same unit. If no unit is stated, it is mm.
    """
    lengths = {_UNITS_MM.get(word.strip('"').lower(), 0.0) for word in words or [""]}
    length = lengths.pop()
    if lengths or not length:
        raise _fault(path, "the unit of the axes", "be mm, um, cm or m", _short(" ".join(words)))
    return length


def _code(name: str) -> str | None:
    """Return the NumPy type code, without byte order, of a type name in a header; None if unknown.

    The type names of MetaImage and NRRD are supported, such as ``unsigned short int``,
    ``uint16_t``, ``ULONG_LONG``.
    """
    name = name.lower().replace("_t", "").replace("_", " ").removeprefix("signed ")
    plain = name.removeprefix("unsigned ").removeprefix("u")
    count = _BYTES.get(plain.removesuffix(" int"))
    if count is None:
        return {"float": "f4", "double": "f8"}.get(name)
    return f"i{count}" if plain == name else f"u{count}"


def _data_file(path: Path, name: str, start: int) -> tuple[Path, int]:
    """Return the file that contains the voxels, and the byte at which the voxels begin."""
    if not name:
        return path, start
    data = path.parent / name
    if not data.is_file():
        raise InputError(
            f"the voxels of {path.name}",
            "be in one file next to the header",
            f"{name[:60]}, which does not exist",
            "copy the file with the voxels into this folder",
        )
    return data, 0


def _voxels(
    data: Path, dtype: str, shape: Sequence[float], start: int, *, skip: int, compressed: bool
) -> Numbers:
    """Read the voxels after `skip` bytes, or from the end of the file if `skip` is -1."""
    kind = np.dtype(dtype)
    count = tuple(int(size) for size in shape)
    # In the two formats, -1 means that the voxels are the last bytes of the file.
    if skip == -1:
        start = max(data.stat().st_size - kind.itemsize * prod(count), 0)
        skip = 0
    return read_voxels(data, kind, count, start=start, skip=skip, compressed=compressed)


def _fault(path: Path, field: str, requirement: str, found: str) -> InputError:
    return InputError(field, requirement, f"{found} in {path.name}", "export it again")


def _short(text: str) -> str:
    # 60 characters: an error message quotes a value, which may have any length in a damaged file.
    return text if len(text) <= 60 else f"{text[:57]}..."


_BYTE_ORDERS = ("binarydatabyteordermsb", "elementbyteordermsb")
_DIRECTIONS = ("transformmatrix", "rotation", "orientation")
_PLACES = ("offset", "position", "origin")
_SPACINGS = ("elementspacing", "elementsize")
_ALONG_LPS = ("RAI", "???")
"""MetaImage codes that mean LPS axes.

The letters of RAI state where the axes start: right, anterior and inferior. Question marks mean
that the code is not stated.
"""


def read_metaimage(path: Path) -> StoredImage:
    """Read a `.mhd` or `.mha` image with three axes, one number per voxel, and one data file.

    Raises
    ------
    InputError
        If the file is truncated or damaged, or if its header contains invalid values.
    """
    fields, start = header_lines(path, "=", "elementdatafile")
    if "ndims" not in fields or "elementdatafile" not in fields:
        raise _fault(path, "file", "be a MetaImage", "no MetaImage header")
    channels = fields.get("elementnumberofchannels", "1")
    if fields["ndims"] != "3" or channels != "1":
        found = f"NDims {fields['ndims']} and {channels} channels"
        raise _fault(path, "file", "contain one number per voxel on three axes", found)
    values = _meta_voxels(fields, path, start)
    notes = []
    if not any(key in fields for key in _DIRECTIONS):
        if fields.get("anatomicalorientation", "???") not in _ALONG_LPS:
            found = "only AnatomicalOrientation"
            raise _fault(path, "directions", "be given as TransformMatrix", found)
        notes.append(
            f"{path.name} states no directions: its axes are taken as left, back and head."
        )
    unit = _unit_mm(fields.get("distanceunits", "").split(), path)
    directions = _stated(fields, _DIRECTIONS, np.eye(3), path).T
    x, y, z = (unit * _stated(fields, _SPACINGS, np.ones(3), path, positive=True)).tolist()
    origin = unit * _stated(fields, _PLACES, np.zeros(3), path)
    slope = numbers(fields, "elementtointensityfunctionslope", path) or [1.0]
    intercept = numbers(fields, "elementtointensityfunctionoffset", path) or [0.0]
    values = scaled(values, slope[0], intercept[0])
    return StoredImage(values, (x, y, z), directions, origin, tuple(notes))


def _meta_voxels(fields: Fields, path: Path, start: int) -> Numbers:
    """Read the voxels of a MetaImage."""
    name = fields["elementdatafile"]
    data, start = _data_file(path, "" if name.upper() == "LOCAL" else name, start)
    if not _is_true(fields, "binarydata", "True"):
        raise _fault(path, "BinaryData", "be True", fields["binarydata"])
    size = numbers(fields, "dimsize", path) or []
    kind = _code(fields.get("elementtype", "").removeprefix("MET_"))
    if len(size) != 3 or any(n < 1 or n != int(n) for n in size) or kind is None:
        found = f"{fields.get('dimsize')} and {fields.get('elementtype')}"
        raise _fault(
            path, "DimSize", "be three positive whole numbers and ElementType a real number", found
        )
    skip = int((numbers(fields, "headersize", path) or [0])[0])
    if skip < -1:
        raise _fault(path, "HeaderSize", "be -1 or more", str(skip))
    order = ">" if any(_is_true(fields, key, "False") for key in _BYTE_ORDERS) else "<"
    compressed = _is_true(fields, "compresseddata", "False")
    # Skip bytes of the file here, because `_voxels` would skip bytes of the inflated data.
    if skip > 0:
        start += skip
        skip = 0
    return _voxels(data, order + kind, size, start, skip=skip, compressed=compressed)


def _is_true(fields: Fields, key: str, absent: str) -> bool:
    """Return whether the value of a header key is true."""
    return fields.get(key, absent).lower() in ("true", "1", "t")


_PATIENT = {
    **dict.fromkeys(("left-posterior-superior", "lps"), (1.0, 1.0, 1.0)),
    **dict.fromkeys(("right-anterior-superior", "ras"), (-1.0, -1.0, 1.0)),
    **dict.fromkeys(("left-anterior-superior", "las"), (1.0, -1.0, 1.0)),
}
"""Signs that convert the axes of a patient frame to LPS."""
_NO_PATIENT = ("", "scanner-xyz", "3d-right-handed")
_IN_SPACE = ("domain", "space", "none", "???")
_SCALED = ("old min", "oldmin", "old max", "oldmax")
_SKIPPED_LINES = ("line skip", "lineskip")
_AXIS_MINS = ("axis mins", "axismins")
_BY_AXIS = ("sizes", "kinds", "space directions", "spacings", "units")
"""Keys with one value per axis."""


def read_nrrd(path: Path) -> StoredImage:
    """Read a `.nrrd` or `.nhdr` image with three spatial axes and one number per voxel.

    The voxels must be in one file, either raw or compressed with gzip. 3D Slicer writes an
    additional layer axis for overlapping segments. This axis becomes the first axis of the values.

    Raises
    ------
    InputError
        If the file is truncated or damaged, or if its header contains invalid values.
    """
    fields, start = header_lines(path, ":", "")
    if not fields.get("first", "").startswith("NRRD"):
        raise _fault(path, "file", "be a NRRD image", "no NRRD header")
    layers, fields = _without_layers(fields)
    kinds = fields.get("kinds", "").lower()
    if fields.get("dimension") != "3" or any(kind not in _IN_SPACE for kind in kinds.split()):
        found = f"dimension {fields.get('dimension')!r} and kinds {_short(kinds)!r}"
        raise _fault(path, "file", "contain one number per voxel on three axes in space", found)
    # These keys state the scale of quantised values, which is not applied here.
    if found := enumerated(key for key in _SCALED if key in fields):
        raise _fault(path, "a NRRD image", "contain unscaled values", f"the key {found}")
    # Lines are not skipped here, so the voxels would be read from a wrong position.
    for key in _SKIPPED_LINES:
        if fields.get(key, "0") != "0":
            raise _fault(path, key, "be 0", _short(fields[key]))
    # It depends on another key whether these positions are the centre or the edge of a voxel.
    for key in _AXIS_MINS:
        if key in fields:
            raise _fault(path, key, "be replaced by space origin", _short(fields[key]))
    unit = _unit_mm((fields.get("space units") or fields.get("units") or "").split(), path)
    space = fields.get("space", "").lower()
    if space not in _PATIENT and space not in _NO_PATIENT:
        raise _fault(path, "space", f"be one of {', '.join(_PATIENT)}", _short(space))
    notes: tuple[str, ...] = ()
    if space in _NO_PATIENT:
        notes = (
            f"{path.name} states no frame of a patient: its axes are taken as left, back and head.",
        )
    _require_axes(fields, space, path)
    signs = np.array(_PATIENT.get(space, (1.0, 1.0, 1.0)))
    spacings = _stated(fields, ("spacings",), np.ones(3), path, positive=True)
    steps = (
        unit * signs[:, None] * _stated(fields, ("space directions",), np.diag(spacings), path).T
    )
    origin = unit * signs * _stated(fields, ("space origin",), np.zeros(3), path)
    lengths = np.linalg.norm(steps, axis=0)
    # 1e-5: headers have six digits or more.
    if "spacings" in fields and not np.allclose(lengths, unit * spacings, rtol=1e-5, atol=0.0):
        found = f"{_short(fields['spacings'])} and {_short(fields['space directions'])}"
        raise _fault(path, "spacings", "agree with the lengths of space directions", found)
    x, y, z = lengths.tolist()
    with np.errstate(divide="ignore", invalid="ignore"):
        directions = steps / lengths
    values = _nrrd_voxels(fields, layers, path, start)
    return StoredImage(values, (x, y, z), directions, origin, notes)


def _without_layers(fields: dict[str, str]) -> tuple[tuple[int, str] | None, dict[str, str]]:
    """Return index and size of the layer axis of a NRRD image, and the header without this axis."""
    kinds = fields.get("kinds", "").lower().split()
    if fields.get("dimension") != "4" or kinds.count("list") != 1:
        return None, fields
    axis = kinds.index("list")
    removed = {}
    kept = {**fields, "dimension": "3"}
    for key in _BY_AXIS:
        words = fields.get(key, "").split()
        if len(words) == 4:
            removed[key] = words.pop(axis)
            kept[key] = " ".join(words)
    return (axis, removed.get("sizes", "")), kept


def _require_axes(fields: Fields, space: str, path: Path) -> None:
    """Raise an error if a header states a patient space or axis directions, but not both.

    The orientation of the image is then unknown, and left and right might be exchanged.
    """
    if space in _PATIENT and "space directions" not in fields:
        raise _fault(path, "space directions", f"be stated with space {space}", "none")
    in_space = next((key for key in ("space directions", "space origin") if key in fields), None)
    if in_space and not space and "space dimension" not in fields:
        raise _fault(path, "space", f"be stated with {in_space}", "none")


def _nrrd_voxels(fields: Fields, layers: tuple[int, str] | None, path: Path, start: int) -> Numbers:
    """Read the voxels of a NRRD image, with the layers as the first axis."""
    size = numbers(fields, "sizes", path, positive=True) or []
    kind = _code(fields.get("type", ""))
    if len(size) != 3 or any(n != int(n) for n in size) or kind is None:
        found = f"{fields.get('sizes', 'nothing')} and {fields.get('type', 'nothing')}"
        raise _fault(path, "sizes", "be three whole numbers and type a real number", found)
    encoding = fields.get("encoding", "").lower()
    if encoding not in ("raw", "gzip", "gz"):
        raise _fault(path, "encoding", "be raw or gzip", _short(encoding) or "none")
    data, start = _data_file(path, fields.get("data file", fields.get("datafile", "")), start)
    skip = int((numbers(fields, "byte skip", path) or numbers(fields, "byteskip", path) or [0])[0])
    if skip < -1:
        raise _fault(path, "byte skip", "be -1 or more", str(skip))
    endian = fields.get("endian", "").lower()
    # One-byte values have no byte order.
    if endian not in ("little", "big") and not kind.endswith("1"):
        raise _fault(path, "endian", "be little or big", _short(endian) or "none")
    order = ">" if endian == "big" else "<"
    compressed = encoding != "raw"
    if layers is None:
        return _voxels(data, order + kind, size, start, skip=skip, compressed=compressed)
    axis, count = layers
    if not count.isdigit() or not int(count):
        raise _fault(path, "sizes", "include the number of layers", _short(count) or "nothing")
    size.insert(axis, float(count))
    values = _voxels(data, order + kind, size, start, skip=skip, compressed=compressed)
    return np.moveaxis(values, axis, 0)
