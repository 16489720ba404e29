"""Search for the files of a stack of image planes (TIFF, PNG, BMP or JPEG), in slice order."""

import re
from collections import Counter
from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from meshes.base.errors import InputError, counted, is_folder, require_file
from meshes.base.text_tables import natural_order
from meshes.images.dicom_files import is_dicom

PLANE_SUFFIXES = (".tif", ".tiff", ".png", ".bmp", ".jpg", ".jpeg")
_VOLUMES = (".nii", ".nii.gz", ".nrrd", ".nhdr", ".mha", ".mhd", ".vti", ".dcm")
"""Suffixes of volume images. Image planes next to a volume image are previews and are ignored."""
TIFF_STARTS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
"""First bytes of TIFF and BigTIFF files, in each of the two byte orders."""
_STARTS = (*TIFF_STARTS, b"\x89PNG")
_PATTERN_MARKS = "*?["


def plane_files(path: Path) -> list[Path]:
    """Return the files of a stack of image planes, in the order of the slices.

    The list is empty for images of other types, and for folders with DICOM files or volume images.

    Files are ordered by the numbers in their names: ``slice_2`` comes before ``slice_10``.

    Parameters
    ----------
    path
        File, folder, or pattern of files such as ``slices/*.tif``.

    Raises
    ------
    InputError
        If the path does not exist, a file name differs in form from the others, or a number is
        missing in the sequence of slices.
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
                "match at least one file",
                f"{path}, which matches none",
                "check the folder and the pattern",
            )
        other = next((file for file in found if not _kind(file)), None)
        if other is not None:
            raise InputError(
                "a pattern", "match only image slices", other.name, "write for example *.tif"
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
    """Return the plane files of the most frequent kind in a folder.

    If the folder contains only one subfolder, return the plane files of this subfolder.
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
    """Return the kind of an image plane file, or an empty string for other files."""
    suffix = file.suffix.lower()
    if suffix in PLANE_SUFFIXES:
        return suffix[:3]
    if suffix and not suffix[1:].isdigit():
        return ""
    with file.open("rb") as stream:
        is_plane = stream.read(4).startswith(_STARTS)
    # The preamble of a DICOM file may start like TIFF.
    return "no ending" if is_plane and not is_dicom(file) else ""


def _require_numbered(files: Sequence[Path], path: Path) -> None:
    """Raise an error for an unusual file name, a missing number, or a number that occurs twice."""
    if len(files) < 2:
        return
    texts = [re.sub(r"\d+", "#", file.stem) for file in files]
    usual, count = Counter(texts).most_common(1)[0]
    if "#" not in usual or 2 * count <= len(files):
        return  # the names do not contain slice numbers
    other = next((file for file, text in zip(files, texts, strict=True) if text != usual), None)
    if other is not None:
        raise InputError(
            "slices",
            "be named alike",
            f"{other.name} among names such as {files[texts.index(usual)].name} in {path.name}",
            "move this file out of the folder, or give a pattern that does not match it",
        )
    numbers = np.array([re.findall(r"\d+", file.stem) for file in files]).astype(object)
    varying = [
        column for column in numbers.T if len({int(number) for number in column.tolist()}) > 1
    ]
    if len(varying) > 1:
        return  # it is unknown which of the numbers is the slice number
    steps = np.diff([int(number) for number in varying[0]]) if varying else np.zeros(1, np.int64)
    if not steps.all():
        raise InputError(
            "slices",
            "have different numbers",
            f"the number of {files[int(np.argmin(steps)) + 1].name} twice in {path.name}",
            "remove one of the two slices",
        )
    wide = int(np.argmax(steps))
    if steps[wide] > steps.min():
        missing = counted(int(steps.sum() // steps.min()) - len(steps), "slice")
        raise InputError(
            "slice numbers",
            "be consecutive",
            f"{files[wide + 1].name} after {files[wide].name} in {path.name}, {missing} missing",
            "export the whole stack",
        )
