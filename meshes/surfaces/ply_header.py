"""Whether a PLY file in text holds as many lines as its header states, which its reader does not check."""

from itertools import takewhile
from pathlib import Path

from meshes.base.errors import InputError

__all__ = ["require_whole_ply"]


def require_whole_ply(file: Path) -> None:
    """Refuse a PLY file in text that is not as long as its header states; binary ones are checked as they are read.

    Raises
    ------
    InputError
        If a count is none, or the lines are more or fewer.
    """
    with file.open("rb") as stored:
        head = [line.split() for line in takewhile(lambda line: line.strip() != b"end_header", stored)]
        if not any(line[:2] == [b"format", b"ascii"] for line in head):
            return
        found = sum(bool(line.strip()) for line in stored)
    counts = [line[2:3] for line in head if line[:1] == [b"element"]]
    stated = sum(int(count[0]) if count and count[0].isdigit() else -(10**30) for count in counts)
    if stated != found:
        counted = f"{stated} lines" if stated >= 0 else "a count that is none"
        raise InputError(
            f"file must be a readable PLY surface, got {counted} in the header and {found} after it in {file.name}: "
            "export it again"
        )
