"""The parts that a scene names, a table for each kind: choices, messages, loops and charts derive from it.

A line in a table makes a part known; a part from elsewhere is made known by `Registry.add`. What lies in a package
above this one is named as ``module:name`` and imported when it is asked for.
"""

import difflib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from meshes.base.errors import InputError

if TYPE_CHECKING:
    from tissue.haptics.loop.sampled_loop import WallLoop
    from tissue.haptics.renderer import Renderer

__all__ = ["RENDERERS", "OneOf", "Registry", "nearest", "unknown_name"]

T = TypeVar("T")


def nearest(word: str, known: Iterable[str]) -> str:
    """The known word that ``word`` may have been meant to be, in brackets, or nothing."""
    close = difflib.get_close_matches(word, list(known), n=1)
    return f" (did you mean {close[0]}?)" if close else ""


def unknown_name(key: str, known: Iterable[str], got: str) -> str:
    """The sentence that refuses a name which is not one of those known."""
    known = list(known)
    return f"{key} must be one of {', '.join(known)}, got {got}{nearest(got, known)}: choose one of these"


class Registry(Generic[T]):
    """Named parts of one kind, in the order in which they are listed.

    Parameters
    ----------
    key
        Key of a scene whose value is a name of this table, as messages have it.
    parts
        The parts by their names, each as it is or as ``module:name``.
    """

    def __init__(self, key: str, parts: Mapping[str, T | str]) -> None:
        self.key = key
        self._parts = dict(parts)

    def __iter__(self) -> Iterator[str]:
        return iter(tuple(self._parts))

    def __len__(self) -> int:
        return len(self._parts)

    def __contains__(self, name: object) -> bool:
        return name in self._parts

    def __getitem__(self, name: str) -> T:
        if name not in self._parts:
            raise InputError(unknown_name(self.key, self, name))
        part = self._parts[name]
        if isinstance(part, str):
            module, _, attribute = part.partition(":")
            loaded: T = getattr(import_module(module), attribute)
            self._parts[name] = part = loaded
        return part

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parts."""
        return tuple(self._parts)

    def add(self, name: str, part: T | str) -> None:
        """Make a part known by a name that no other has.

        Raises
        ------
        InputError
            If the name is taken.
        """
        if name in self._parts:
            raise InputError(
                f"name must be none of {', '.join(self)}, got {name}: choose another name for this {self.key}"
            )
        self._parts[name] = part

    def remove(self, name: str) -> None:
        """Forget a part that was added, so that its name is free again."""
        self[name]
        del self._parts[name]


@dataclass(frozen=True)
class OneOf:
    """Marks a scene's text as a name of a table, or one of some others; it is checked when the scene is."""

    table: Registry[Any]
    others: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """All names that are accepted now."""
        return (*self.others, *self.table)

    def _check(self, name: str) -> str:
        if name not in self.names:
            from pydantic_core import PydanticCustomError

            raise PydanticCustomError(
                "unknown_name", "{sentence}", {"sentence": unknown_name(self.table.key, self.names, name)}
            )
        return name

    def __get_pydantic_core_schema__(self, source: Any, handler: Callable[[Any], Any]) -> Any:
        from pydantic_core import core_schema

        return core_schema.no_info_after_validator_function(self._check, handler(source))

    def __get_pydantic_json_schema__(self, schema: Any, handler: Callable[[Any], Any]) -> dict[str, Any]:
        return {"enum": list(self.names), "type": "string"}


RENDERERS: "Registry[Callable[[WallLoop], Renderer]]" = Registry(
    "renderer",
    {
        "penalty": "tissue.haptics.renderer:penalty",
        "passivity": "tissue.haptics.renderer:passivity",
        "proxy": "tissue.haptics.renderer:proxy",
    },
)
"""Laws by which a device plays what the tool meets: each from the loop of its wall."""
