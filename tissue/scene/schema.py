"""The JSON schema of scenes, by which an editor completes and checks their keys."""

import json
from contextlib import suppress
from pathlib import Path

from meshes.base.cache import cache_folder
from meshes.base.whole_file import whole_file
from tissue.scene.load import scene_text
from tissue.scene.plugins import OFFERED, ask_packages
from tissue.scene.scene import Scene

__all__ = ["scene_for_editors", "schema_text"]

STATED = {
    "format": {"description": "Version of this file's format.", "minimum": 1, "type": "integer"},
    "tissue": {"description": "Version of tissue that wrote this file.", "type": "string"},
}
"""Entries that a scene's file may hold besides those of `Scene`."""


def schema_text() -> str:
    """JSON schema of a scene's file: keys with descriptions, units in their names, ranges and
    choices.
    """
    for group in OFFERED:
        ask_packages(group)
    schema = Scene.model_json_schema()
    schema["properties"] |= STATED
    return json.dumps(schema, indent=2) + "\n"


def scene_for_editors(name: str) -> str:
    """TOML of a built-in scene; its first line names the schema, which is written to the cache for
    it.

    The line holds a ``file:`` URL, which taplo and editors that use it resolve from any folder and
    without a network. Where the cache cannot be written the scene comes without it.

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
    """Path of the schema in the cache, where it is written unless the same one is there."""
    path = (cache_folder() / "scene.schema.json").absolute()
    text = schema_text()
    if not (path.is_file() and path.read_bytes() == text.encode()):
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as temporary:
            temporary.write_bytes(text.encode())
    return path
