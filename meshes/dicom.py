"""The one thing to know of a DICOM folder before VTK opens it: whether its pixels are compressed.

VTK's reader takes uncompressed images only and ends the process on some others, so they are refused before.
"""

from __future__ import annotations

from pathlib import Path

from meshes.errors import InputError

__all__ = ["require_uncompressed"]

_UNCOMPRESSED = {"1.2.840.10008.1.2", "1.2.840.10008.1.2.1", "1.2.840.10008.1.2.2"}
_LONG_LENGTH = {b"OB", b"OW", b"OF", b"SQ", b"UT", b"UN"}
_PREAMBLE, _MAGIC, _HEADER = 128, b"DICM", 4096


def require_uncompressed(folder: Path) -> None:
    """Refuse a folder without DICOM files, or with compressed ones.

    Raises
    ------
    InputError
        If no file starts as DICOM does (PS3.10, section 7.1) or one has a compressed transfer syntax (PS3.5,
        section 10).
    """
    syntaxes = {file.name: _transfer_syntax(file) for file in sorted(folder.iterdir()) if file.is_file()}
    found = {name: syntax for name, syntax in syntaxes.items() if syntax is not None}
    if not found:
        raise InputError(
            f"file must hold images, got the folder {folder.name} without DICOM files or TIFF slices: "
            "give the folder that holds the slices"
        )
    for name, syntax in found.items():
        if syntax not in _UNCOMPRESSED:
            raise InputError(
                f"file must be uncompressed DICOM, got transfer syntax {syntax} in {name}: export the "
                "series uncompressed, or as .nii.gz or .nrrd"
            )


def _transfer_syntax(file: Path) -> str | None:
    """Transfer syntax of a DICOM file (tag 0002,0010), or None if it is not one."""
    with file.open("rb") as stream:
        head = stream.read(_HEADER)
    if head[_PREAMBLE : _PREAMBLE + 4] != _MAGIC:
        return None
    at = _PREAMBLE + 4
    while at + 8 <= len(head) and head[at : at + 2] == b"\x02\x00":
        element, representation = int.from_bytes(head[at + 2 : at + 4], "little"), head[at + 4 : at + 6]
        if representation in _LONG_LENGTH:
            length, start = int.from_bytes(head[at + 8 : at + 12], "little"), at + 12
        else:
            length, start = int.from_bytes(head[at + 6 : at + 8], "little"), at + 8
        if element == 0x0010:
            return head[start : start + length].decode("ascii", "replace").strip("\0 ")
        at = start + length
    return ""
