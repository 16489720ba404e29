"""Voxels and place of an image file by ITK, and the lines of a text header.

ITK ignores some of those lines.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from meshes.base.arrays import Numbers
from meshes.base.errors import InputError, by
from meshes.base.text_numbers import number_in
from meshes.images.frame import StoredImage

if TYPE_CHECKING:
    import SimpleITK

__all__ = ["array_of", "header_lines", "itk_reader", "length_unit_mm", "numbers", "read_by_itk"]

_LONGEST_HEADER = 1 << 20
_UNITS_MM: Mapping[str, float] = {
    **dict.fromkeys(("", "?", "mm", "millimeter", "millimetre", "millimeters", "millimetres"), 1.0),
    **dict.fromkeys(("um", "µm", "micrometer", "micrometre", "micron", "microns"), 1e-3),
    **dict.fromkeys(("cm", "centimeter", "centimetre"), 10.0),
    **dict.fromkeys(("m", "meter", "metre"), 1000.0),
}


def header_lines(path: Path, separator: str, last: str) -> tuple[dict[str, str], int]:
    """Read the `key separator value` lines of a header, and the byte after it.

    Keys are in small letters.

    Parameters
    ----------
    last
        Key of the header's last line; an empty line ends it as well. The first line without a
        separator is kept under the key "first".
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
            raise InputError(
                "a header", "state every key once", f"{_short(key)} twice in {path.name}", "fix it"
            )
        elif not key.startswith("#"):
            fields[key] = value.strip()
        if key == last:
            break
    return fields, at


def numbers(
    fields: Mapping[str, str], key: str, path: Path, *, positive: bool = False
) -> list[float] | None:
    """Return the finite numbers of a header line, or None if the line is missing.

    Raises
    ------
    InputError
        If a word of the line is not a finite number, or not above 0 where it has to be.
    """
    if key not in fields:
        return None
    try:
        found = [
            number_in(word)
            for word in fields[key].replace("(", " ").replace(")", " ").replace(",", " ").split()
        ]
    except ValueError:
        found = [np.nan]
    if not np.isfinite(found).all():
        raise InputError(
            key, "be finite numbers", f"{_short(fields[key])} in {path.name}", "fix the header"
        )
    if positive and min(found, default=0.0) <= 0.0:
        raise InputError(
            key, "be above 0", f"{_short(fields[key])} in {path.name}", "fix the header"
        )
    return found


def length_unit_mm(words: Sequence[str], path: Path) -> float:
    """Return the length [mm] of the unit that a header states for its axes.

    All axes must have the same unit; without one it is mm.
    """
    units = {word.strip('"').lower() for word in words}
    if not units <= set(_UNITS_MM) or len({_UNITS_MM[unit] for unit in units}) > 1:
        raise InputError(
            "the unit of the axes",
            "be mm, um, cm or m",
            f"{', '.join(sorted(_short(u) for u in units))} in {path.name}",
            "export it in mm",
        )
    return _UNITS_MM[units.pop()] if units else 1.0


def read_by_itk(
    path: Path, reader_name: str, *, unit_mm: float, notes: tuple[str, ...]
) -> StoredImage:
    """Read an image by a named reader of ITK, whose frame is LPS.

    The image has one real number per voxel on three axes.
    """
    import SimpleITK

    reader = itk_reader(path, reader_name)
    try:
        reader.ReadImageInformation()
        size = reader.GetSize()
        kind = SimpleITK.GetPixelIDValueAsString(reader.GetPixelID())
        if len(size) != 3 or reader.GetNumberOfComponents() != 1 or "complex" in kind or 0 in size:
            raise InputError(
                "file",
                "hold one number per voxel on three axes",
                f"{by(size)} of {kind} in {path.name}",
                "export one of its volumes",
            )
        image = reader.Execute()
    except (RuntimeError, MemoryError, OverflowError, UnicodeError) as problem:
        raise InputError(
            "file",
            "be a readable image volume",
            f"{path.name} whose header and voxels do not fit",
            "export it again",
        ) from problem
    x, y, z = (unit_mm * s for s in image.GetSpacing())
    directions = np.array(image.GetDirection(), dtype=np.float64).reshape(3, 3)
    return StoredImage(
        array_of(image), (x, y, z), directions, unit_mm * np.array(image.GetOrigin()), notes
    )


def itk_reader(path: Path, name: str) -> SimpleITK.ImageFileReader:
    """Return a named reader of ITK for a file.

    Its warnings, which may contain header content, are not printed on the terminal.
    """
    import SimpleITK

    SimpleITK.ProcessObject.SetGlobalWarningDisplay(False)
    reader = SimpleITK.ImageFileReader()
    reader.SetFileName(str(path))
    reader.SetImageIO(name)
    return reader


def array_of(image: SimpleITK.Image) -> Numbers:
    """Return values of an ITK image, shape (ni, nj, nk), first index fastest."""
    import SimpleITK

    values: Numbers = SimpleITK.GetArrayFromImage(image)
    return values.T


def _short(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:57]}..."
