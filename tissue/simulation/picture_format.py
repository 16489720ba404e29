"""The formats that a run's pictures are written in."""

from meshes.base.errors import InputError

__all__ = ["PICTURE_FORMATS", "picture_format"]

PICTURE_FORMATS = ("png", "svg", "pdf")


def picture_format(pictures: bool | str) -> str | None:
    """The format that is meant: PNG where pictures are just asked for, None where they are not.

    Raises
    ------
    InputError
        If it is none of `PICTURE_FORMATS`.
    """
    if isinstance(pictures, bool):
        return PICTURE_FORMATS[0] if pictures else None
    if pictures not in PICTURE_FORMATS:
        raise InputError(f"pictures must be one of {', '.join(PICTURE_FORMATS)}, got {pictures}: choose one of these")
    return pictures
