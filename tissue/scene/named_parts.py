"""Tables of named parts, and the marks by which a scene's keys take their choices from them."""

import difflib
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar, get_args

from meshes.base.errors import InputError

if TYPE_CHECKING:
    from pydantic import BaseModel, GetCoreSchemaHandler
    from pydantic_core import CoreSchema

__all__ = ["ByKind", "OneOf", "Registry", "kinds_of", "loaded", "nearest", "shown", "unknown_name"]

T = TypeVar("T")


class OfKind(Protocol):
    """An entry of a table of parts that a scene states, with the class of the part."""

    @property
    def parameters(self) -> "type[BaseModel] | str":
        """The class, or where it lies."""
        ...


K = TypeVar("K", bound=OfKind)
LONGEST = 120
"""Characters of a value that a sentence repeats."""


def nearest(word: str, known: Iterable[str]) -> str:
    """The known word that ``word`` may have been meant to be, in brackets, or nothing."""
    close = difflib.get_close_matches(word, list(known), n=1)
    return f" (did you mean {close[0]}?)" if close else ""


def unknown_name(key: str, known: Iterable[str], got: str) -> str:
    """The sentence that refuses a name which is not one of those known."""
    known = list(known)
    return f"{key} must be one of {', '.join(known)}, got {got}{nearest(got, known)}: choose one of these"


def shown(value: object) -> str:
    """A value as a person would write it."""
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(shown(item) for item in value) + "]"
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, bool):
        return "true" if value else "false"
    text = "".join(each if each.isprintable() else repr(each)[1:-1] for each in str(value))
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}... ({len(text)} characters)"


def loaded(part: T | str) -> T:
    """A part as it is, imported where it is named as ``module:name``."""
    if not isinstance(part, str):
        return part
    module, _, attribute = part.partition(":")
    found: T = getattr(import_module(module), attribute)
    return found


class Registry(Generic[T]):
    """Named parts of one kind, in the order in which they are listed.

    Parameters
    ----------
    key
        Key of a scene whose value is a name of this table, as messages have it.
    parts
        The parts by their names, each as it is or as ``module:name``. A name such as ``observer:FILE`` stands for all
        texts with something else behind the colon.
    """

    def __init__(self, key: str, parts: Mapping[str, T | str]) -> None:
        self.key = key
        self._parts = dict(parts)
        self.on_change: list[Callable[[], object]] = []
        """Called after a part is added or removed."""

    def __iter__(self) -> Iterator[str]:
        return iter(tuple(self._parts))

    def __len__(self) -> int:
        return len(self._parts)

    def __contains__(self, name: object) -> bool:
        return name in self._parts

    def __getitem__(self, name: str) -> T:
        if name not in self._parts:
            raise InputError(unknown_name(self.key, self, name))
        return loaded(self._parts[name])

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parts."""
        return tuple(self._parts)

    def split(self, text: str, *others: str) -> tuple[str, str]:
        """The name of a part that a text stands for, and its argument: observer:FILE and a.json for observer:a.json.

        Raises
        ------
        InputError
            If the text stands for none; the sentence lists `others` beside the names of the table.
        """
        for name in self:
            head, colon, _ = name.partition(":")
            if text == name and not colon:
                return name, ""
            if colon and text.startswith(head + colon) and len(text) > len(head + colon):
                return name, text.removeprefix(head + colon)
        raise InputError(unknown_name(self.key, (*others, *self), text))

    def with_file_at(self, text: str, folder: Path) -> str:
        """A text such as observer:a.json with its file made absolute, a relative one taken from ``folder``."""
        for name in self:
            head = name.removesuffix("FILE")
            if head.endswith(":") and text.startswith(head) and text != head:
                return f"{head}{(folder / text.removeprefix(head)).resolve()}"
        return text

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
        self._changed()

    def remove(self, name: str) -> None:
        """Forget a part that was added, so that its name is free again."""
        self[name]
        del self._parts[name]
        self._changed()

    def _changed(self) -> None:
        for call in self.on_change:
            call()


@dataclass(frozen=True)
class OneOf(Generic[T]):
    """Marks a scene's text as a name of a table, or one of some others; it is checked when the scene is."""

    table: Registry[T]
    others: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """All names that are accepted now."""
        return (*self.others, *self.table)

    def _check(self, name: str) -> str:
        if name not in self.others:
            from pydantic_core import PydanticCustomError

            try:
                self.table.split(name, *self.others)
            except InputError as refusal:
                raise PydanticCustomError("unknown_name", "{sentence}", {"sentence": str(refusal)}) from None
        return name

    def __get_pydantic_core_schema__(self, source: object, handler: "GetCoreSchemaHandler") -> "CoreSchema":
        from pydantic_core import core_schema

        return core_schema.no_info_after_validator_function(self._check, handler(source))

    def __get_pydantic_json_schema__(self, schema: "CoreSchema", handler: object) -> dict[str, object]:
        if not any(":" in name for name in self.names):
            return {"enum": list(self.names), "type": "string"}
        patterns = (re.sub(":.*", ":.+", re.escape(name)) for name in self.names)
        return {"pattern": f"^({'|'.join(patterns)})$", "type": "string"}


def kinds_of(part: "type[BaseModel]") -> tuple[str, ...]:
    """The kinds that a part of a scene describes."""
    field = part.model_fields["kind"]
    return next((each.names for each in field.metadata if isinstance(each, OneOf)), get_args(field.annotation))


@dataclass(frozen=True)
class ByKind(Generic[K]):
    """Marks a union of parts of a scene, of which the key ``kind`` chooses one; with a table, those of its entries.

    An entry of such a table has the class of the part as ``parameters``.
    """

    table: Registry[K] | None = None

    def parts(self, union: object) -> "tuple[type[BaseModel], ...]":
        """The parts now."""
        if self.table is None:
            return get_args(union)
        return tuple(loaded(self.table[name].parameters) for name in self.table)

    def __get_pydantic_core_schema__(self, source: object, handler: "GetCoreSchemaHandler") -> "CoreSchema":
        from pydantic_core import core_schema

        choices = {kind: handler.generate_schema(part) for part in self.parts(source) for kind in kinds_of(part)}
        return core_schema.tagged_union_schema(choices, discriminator="kind")
