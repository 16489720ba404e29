"""Texts that a scene states: folders of its files, and names of parts that only this process
knows.
"""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import PurePath, PurePosixPath, PureWindowsPath
from typing import Any

from tissue.scene.plugins import offered_names
from tissue.scene.registry import TABLES
from tissue.scene.scene import Scene

__all__ = ["folders_of", "registered_parts", "unknown_parts"]


def _texts_of(scene: Scene) -> list[str]:
    """Every text in a scene but its name."""
    return list(_texts(scene.model_dump(mode="json", exclude={"name"})))


def folders_of(scene: Scene) -> list[str]:
    """Absolute folders of the files that a scene names, but roots, with the separator behind
    each; longest first.
    """
    found = set()
    for text in _texts_of(scene):
        # a file may follow a part's name, as in observer:FILE
        for each in (text, text.partition(":")[2]):
            kinds: tuple[type[PurePath], ...] = (PurePosixPath, PureWindowsPath)
            path = next((kind(each) for kind in kinds if kind(each).is_absolute()), None)
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


def registered_parts(scenes: Iterable[Scene]) -> list[tuple[str, str]]:
    """Kind and name of the parts that scenes name and neither this package nor an installed one
    offers.
    """
    offered = {name for names in offered_names().values() for name in names}
    named = {text.partition(":")[0] for scene in scenes for text in _texts_of(scene)}
    found = {
        name: kind
        for kind, tables in TABLES.items()
        for table in tables
        for name in table.known
        if name in named and name not in table.built_in and name not in offered
    }
    return [(kind, name) for name, kind in found.items()]


def unknown_parts(parts: Iterable[tuple[str, str]]) -> list[tuple[str, str]]:
    """Those of some parts that this process does not know."""
    return [
        (kind, name) for kind, name in parts if not any(name in table for table in TABLES[kind])
    ]
