"""Whether a PLY file in text holds as many lines as its header states, which its reader does not check."""

from pathlib import Path

from meshes.errors import InputError

__all__ = ["require_whole_ply"]


def require_whole_ply(file: Path) -> None:
    """Refuse a PLY file in text that is not as long as its header states; binary ones are checked as they are read.

    Raises
    ------
    InputError
        If a count is none, or the lines are more or fewer.
    """
    lines = file.read_bytes().decode("latin-1").splitlines()
    head = next((number for number, line in enumerate(lines) if line.strip() == "end_header"), len(lines))
    if not any(line.split()[:2] == ["format", "ascii"] for line in lines[:head]):
        return
    counts = [line.split()[2:3] for line in lines[:head] if line.split()[:1] == ["element"]]
    stated = sum(int(count[0]) if count and count[0].isdecimal() else -(10**30) for count in counts)
    found = sum(bool(line.strip()) for line in lines[head + 1 :])
    if stated != found:
        counted = f"{stated} lines" if stated >= 0 else "a count that is none"
        raise InputError(
            f"file must be a readable PLY surface, got {counted} in the header and {found} after it in {file.name}: "
            "export it again"
        )
