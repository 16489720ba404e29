"""Texts of scenes for editors and reports.

The functions return the folders that a scene contains, and the JSON schema of scenes. They also
read and write the site, where the tool works, in a scene file.
"""

import json
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path, PurePath, PurePosixPath, PureWindowsPath
from typing import Any

from meshes.base.cache import cache_folder
from meshes.base.errors import InputError
from meshes.base.text_tables import read_toml
from meshes.base.whole_file import whole_file
from tissue.scene.load import scene_table, scene_text
from tissue.scene.plugins import OFFERED, ask_packages
from tissue.scene.scene import Scene


def _texts_of(scene: Scene) -> list[str]:
    """Return all values of a scene that are texts, except the name of the scene."""
    return list(_texts(scene.model_dump(mode="json", exclude={"name"})))


def folders_of(scene: Scene) -> list[str]:
    """Return the folders of all absolute file paths in a scene; the longest folder name is first.

    Each folder ends with the path separator. Root folders are left out.
    """
    found = set()
    for text in _texts_of(scene):
        # a file may follow the name of a part, as in observer:FILE
        for each in (text, text.partition(":")[2]):
            kinds: tuple[type[PurePath], ...] = (PurePosixPath, PureWindowsPath)
            path = next((kind(each) for kind in kinds if kind(each).is_absolute()), None)
            # A root folder is part of every path, and shows nothing about a user.
            if path is not None and path.parent != path.parent.parent:
                found.add(each[: len(each.rstrip("/\\")) - len(path.name)])
    return sorted(found, key=len, reverse=True)


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for each in value.values():
            yield from _texts(each)
    elif isinstance(value, list | tuple):
        for each in value:
            yield from _texts(each)


_TABLE = re.compile(r"(?m)^[ \t]*\[+[^\]\n]*\]+[ \t]*(#.*)?\r?$")
_ANATOMY = re.compile(r"(?m)^[ \t]*\[[ \t]*anatomy[ \t]*\][ \t]*(#[^\r\n]*)?")


def anatomy_of(scene: Path) -> dict[str, object]:
    """Return the table ``anatomy`` of a scene file, without validation.

    Raises
    ------
    InputError
        If the file is not valid TOML or has no such table.
    """
    table = scene_table(scene).get("anatomy")
    if not isinstance(table, dict):
        raise InputError(
            "scene", "have a table [anatomy]", f"none in {scene}", "import the bone again"
        )
    return table


def save_site(scene: Path, centre_mm: Sequence[float], normal: Sequence[float]) -> None:
    """Write the site, the place where the tool works, into a scene file.

    Raises
    ------
    InputError
        If the site cannot be written without changing other content of the file.
    """
    with scene.open(encoding="utf-8", newline="") as file:
        text = file.read()
    changed = with_site(text, centre_mm, normal)
    with whole_file(scene) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        file.write(changed)


def with_site(text: str, centre_mm: Sequence[float], normal: Sequence[float]) -> str:
    """Return the text of a scene with new ``anatomy.centre_mm`` and ``anatomy.normal``.

    Comments within the two lists are removed. All other text stays unchanged.

    Raises
    ------
    InputError
        If the text has no line ``[anatomy]``, or if other content would change.
    """
    values = {
        # A micrometre, and a millionth of a unit vector. Adding 0.0 turns -0.0 into 0.0.
        "centre_mm": [round(float(value), 3) + 0.0 for value in centre_mm],
        "normal": [round(float(value), 6) + 0.0 for value in normal],
    }
    head = _ANATOMY.search(text)
    if head is None:
        raise InputError(
            "scene",
            "have a line [anatomy]",
            "none",
            "write anatomy.centre_mm and anatomy.normal into the file by hand",
        )
    following = _TABLE.search(text, head.end())
    end = len(text) if following is None else following.start()
    table = text[head.end() : end]
    line_end = "\r\n" if "\r\n" in text else "\n"
    for key, value in values.items():
        table, count = re.subn(rf"(?m)^(\s*{key}\s*=\s*)\[[^\]]*\]", rf"\g<1>{value}", table)
        if count == 0:
            table = f"{line_end}{key} = {value}{table}"
    changed = text[: head.end()] + table + text[end:]
    before = read_toml(text)
    before["anatomy"] |= values
    try:
        is_same = read_toml(changed) == before
    except tomllib.TOMLDecodeError:
        is_same = False
    if not is_same:
        raise InputError(
            "scene",
            "have anatomy.centre_mm and anatomy.normal on separate lines",
            "a line with other text",
            "write the two keys into the file by hand",
        )
    return changed


STATED = {
    "format": {"description": "Version of this file's format.", "minimum": 1, "type": "integer"},
    "tissue": {"description": "Version of tissue that wrote this file.", "type": "string"},
}
"""JSON schema of the entries of a scene file that are not fields of `Scene`."""


def schema_text() -> str:
    """Return the JSON schema of a scene file as text.

    The schema contains all keys with their descriptions, ranges and choices. The name of each key
    contains its unit.
    """
    for group in OFFERED:
        ask_packages(group)
    schema = Scene.model_json_schema()
    schema["properties"] |= STATED
    return json.dumps(schema, indent=2) + "\n"


def scene_for_editors(name: str) -> str:
    """Return a built-in scene as TOML text; its first line contains the URL of the JSON schema.

    Editors use the schema to complete and check keys. The schema is written to the cache folder,
    and the first line contains the ``file:`` URL of the schema. Taplo, the TOML toolkit of many
    editors, can read this line. If the cache folder cannot be written, the text is returned without
    this line.

    Raises
    ------
    InputError
        If there is no such scene.
    """
    text = scene_text(name)
    with suppress(OSError):
        text = f"#:schema {_written_schema().as_uri()}\n{text}"
    return text


def _written_schema() -> Path:
    """Write the schema to the cache folder unless it is up to date; return the path of its file."""
    path = (cache_folder() / "scene.schema.json").absolute()
    text = schema_text()
    if not (path.is_file() and path.read_bytes() == text.encode()):
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as temporary:
            temporary.write_bytes(text.encode())
    return path
