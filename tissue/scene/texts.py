"""All texts that a scene states: names of parts, files."""

from collections.abc import Iterator, Mapping
from pathlib import PurePath, PurePosixPath, PureWindowsPath
from typing import Any

from tissue.scene.scene import Scene

__all__ = ["folders_of", "texts_of"]


def texts_of(scene: Scene) -> list[str]:
    """Every text in a scene but its name."""
    return list(_texts(scene.model_dump(mode="json", exclude={"name"})))


def folders_of(scene: Scene) -> list[str]:
    """Absolute folders of the files that a scene names, but roots, with the separator behind each; longest first."""
    found = set()
    for text in texts_of(scene):
        for each in (text, text.partition(":")[2]):  # a file may follow a part's name, as in observer:FILE
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
