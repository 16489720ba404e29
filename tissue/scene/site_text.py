"""The site in the text of a scene: read, and written over its two lines, with all else as a
person wrote it.
"""

import re
import tomllib
from collections.abc import Sequence
from pathlib import Path

from meshes.base.errors import InputError
from meshes.base.file_limits import require_regular
from meshes.base.text_tables import read_toml
from meshes.base.whole_file import whole_file

__all__ = ["anatomy_of", "save_site", "with_site"]

_TABLE = re.compile(r"^\s*\[+[^\]]*\]+\s*(#.*)?$")
_ANATOMY = re.compile(r"^\s*\[\s*anatomy\s*\]\s*(#.*)?$")


def anatomy_of(scene: Path) -> dict[str, object]:
    """Table ``anatomy`` of a scene's file as it stands there.

    Raises
    ------
    InputError
        If the file is no TOML or has no such table.
    """
    require_regular(scene)
    try:
        table = read_toml(scene.read_text("utf-8")).get("anatomy")
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError("scene", "be TOML", f"{error} in {scene}", "fix it") from None
    if not isinstance(table, dict):
        raise InputError(
            "scene", "have a table [anatomy]", f"none in {scene}", "import the bone again"
        )
    return table


def save_site(scene: Path, centre_mm: Sequence[float], normal: Sequence[float]) -> None:
    """Write a site into a scene's file.

    Raises
    ------
    InputError
        If the file cannot be changed so that nothing else in it does.
    """
    with scene.open(encoding="utf-8", newline="") as file:
        text = file.read()
    changed = with_site(text, centre_mm, normal)
    with whole_file(scene) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        file.write(changed)


def with_site(text: str, centre_mm: Sequence[float], normal: Sequence[float]) -> str:
    """Text of a scene with ``anatomy.centre_mm`` and ``anatomy.normal``, comments and all other
    lines as they were.

    Raises
    ------
    InputError
        If the text has no line ``[anatomy]``, or something else would change.
    """
    values = {
        "centre_mm": [round(float(value), 3) + 0.0 for value in centre_mm],
        "normal": [round(float(value), 6) + 0.0 for value in normal],
    }
    end = "\r\n" if "\r\n" in text else "\n"
    lines = text.split(end)
    first = next((number for number, line in enumerate(lines) if _ANATOMY.match(line)), None)
    if first is None:
        raise InputError(
            "scene", "have a line [anatomy]", "none", "write anatomy.centre_mm and normal by hand"
        )
    for key, value in values.items():
        _put(lines, first + 1, key, f"{key} = {value}")
    changed = end.join(lines)
    before = read_toml(text)
    before["anatomy"] |= values
    if read_toml(changed) != before:
        raise InputError(
            "scene",
            "state anatomy.centre_mm and normal on lines of their own",
            "other text",
            "write them by hand",
        )
    return changed


def _put(lines: list[str], first: int, key: str, line: str) -> None:
    """Replace a key's lines in a table that begins at a line, its comment kept, or add one after
    the table's last.
    """
    last = first
    for number in range(first, len(lines)):
        if _TABLE.match(lines[number]):
            break
        if re.match(rf"\s*{key}\s*=", lines[number]):
            stop = number
            while stop < len(lines) - 1 and not _closed(lines[number : stop + 1]):
                stop += 1
            comments = [
                found[0]
                for each in lines[number : stop + 1]
                if (found := re.search(r"\s*#.*$", each))
            ]
            lines[number : stop + 1] = [line + "".join(comments)]
            return
        if lines[number].strip() and not lines[number].lstrip().startswith("#"):
            last = number + 1
    lines.insert(last, line)


def _closed(lines: list[str]) -> bool:
    """Whether an array of numbers that begins in the first line ends in the last."""
    plain = "".join(re.sub(r"#.*", "", line) for line in lines)
    return plain.count("[") == plain.count("]")
