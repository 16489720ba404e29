"""Parts that a call of `tissue.register` made known, in this process alone."""

from collections.abc import Iterable

from tissue.scene.plugins import offered_names
from tissue.scene.registry import TABLES
from tissue.scene.scene import Scene
from tissue.scene.texts import texts_of

__all__ = ["registered_parts", "unknown_parts"]


def registered_parts(scenes: Iterable[Scene]) -> list[tuple[str, str]]:
    """Kind and name of the parts that scenes name and neither this package nor an installed one offers."""
    offered = {name for names in offered_names().values() for name in names}
    named = {text.partition(":")[0] for scene in scenes for text in texts_of(scene)}
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
    return [(kind, name) for kind, name in parts if not any(name in table for table in TABLES[kind])]
