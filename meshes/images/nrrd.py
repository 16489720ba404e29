"""NRRD images: read by ITK, after what it passes over in silence has been checked."""

from pathlib import Path

from meshes.base.errors import InputError
from meshes.images.data import require_size
from meshes.images.frame import StoredImage
from meshes.images.itk import header_lines, length_unit_mm, numbers, read_by_itk

__all__ = ["read_nrrd"]

_PATIENT = ("left-posterior-superior", "right-anterior-superior", "left-anterior-superior", "lps", "ras", "las")
_NO_PATIENT = ("", "scanner-xyz", "3d-right-handed")
_IN_SPACE = ("domain", "space", "none", "???")
_CHECKED = ("raw", "gzip", "gz")
_SCALED = ("old min", "oldmin", "old max", "oldmax")


def read_nrrd(path: Path) -> StoredImage:
    """Read a `.nrrd` or `.nhdr` image of one number a voxel on three axes in space.

    Raises
    ------
    InputError
        If the file is cut off or damaged, or states what cannot be honoured.
    """
    fields, start = header_lines(path, ":", "")
    if not fields.get("first", "").startswith("NRRD"):
        raise InputError(
            f"file must be a NRRD image, got {path.name} which does not start as one does: export it again"
        )
    kinds = fields.get("kinds", "").lower()
    if fields.get("dimension") != "3" or any(kind not in _IN_SPACE for kind in kinds.split()):
        raise InputError(
            f"file must hold one number per voxel on three axes in space, got dimension {fields.get('dimension')!r} "
            f"and kinds {kinds!r} in {path.name}: export one of its volumes"
        )
    held = next((key for key in _SCALED if key in fields), None)
    if held is not None:
        raise InputError(
            f"a NRRD image must hold its values unscaled, got the key {held} in {path.name}: export it again"
        )
    for key in ("space directions", "space origin", "axis mins"):
        numbers(fields, key, path)
    numbers(fields, "spacings", path, positive=True)
    unit = length_unit_mm((fields.get("space units") or fields.get("units") or "").split(), path)
    stored = read_by_itk(path, "NrrdImageIO", unit_mm=unit, notes=_notes(fields, path))
    _require_data(fields, path, start, stored.values.nbytes)
    return stored


def _notes(fields: dict[str, str], path: Path) -> tuple[str, ...]:
    """What has to be assumed on the frame."""
    space = fields.get("space", "").lower()
    if space in _NO_PATIENT:
        return (f"{path.name} states no frame of a patient: its axes are taken as left, back and head.",)
    if space not in _PATIENT:
        raise InputError(
            f"space must be one of {', '.join(_PATIENT[:3])}, got {space!r} in {path.name}: export it in one"
        )
    return ()


def _require_data(fields: dict[str, str], path: Path, start: int, needed: int) -> None:
    """Refuse a data file that holds more than the header states, or does not fit its checksum; ITK refuses less."""
    name = fields.get("data file", fields.get("datafile"))
    skips = any(
        fields.get(key.replace(" ", gap), "0") != "0" for key in ("line skip", "byte skip") for gap in (" ", "")
    )
    if skips or (name is not None and not (path.parent / name).is_file()):
        return
    data, first = (path, start) if name is None else (path.parent / name, 0)
    encoding = fields.get("encoding", "").lower()
    if encoding in _CHECKED:
        require_size(data, first, needed, compressed=encoding != "raw")
