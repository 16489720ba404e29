"""Tables of named parts, and how a name that is none of them is refused."""

import difflib
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Generic, TypeVar

from meshes.base.errors import InputError
from tissue.scene.plugins import ask_packages, refusal

__all__ = ["Registry", "nearest", "shown", "unknown_name"]

T = TypeVar("T")
LONGEST = 120
"""Characters of a value that a sentence repeats."""


def nearest(word: str, known: Iterable[str]) -> str:
    """The known word that ``word`` may have been meant to be, in brackets, or nothing."""
    close = difflib.get_close_matches(word, list(known), n=1)
    return f" (did you mean {close[0]}?)" if close else ""


def unknown_name(key: str, known: Iterable[str], got: str) -> str:
    """The sentence that refuses a name which is not one of those known."""
    known = list(known)
    return (
        f"{key} must be one of {', '.join(known)}, got {got}{nearest(got, known)}: choose one of "
        "these"
    )


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


class Registry(Generic[T]):
    """Named parts of one kind, in the order in which they are listed.

    Parameters
    ----------
    key
        Key of a scene whose value is a name of this table, as messages have it.
    parts
        The parts by their names. A name such as ``observer:FILE`` stands for all
        texts with something else behind the colon.
    group
        Group of entry points by which installed packages offer more parts. They are asked for a
        name that is not known, and when the names are listed.

    Attributes
    ----------
    built_in
        Names of the parts that it was made with.
    """

    def __init__(self, key: str, parts: Mapping[str, T], *, group: str = "") -> None:
        self.key = key
        self.group = group
        self._parts = dict(parts)
        self.built_in = frozenset(parts)
        self.on_change: list[Callable[[], object]] = []
        """Called after a part is added or removed."""

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __len__(self) -> int:
        return len(self.names)

    def __contains__(self, name: object) -> bool:
        return name in self._parts or name in self.names

    def __getitem__(self, name: str) -> T:
        if name not in self:
            raise InputError(self._why_not(name))
        return self._parts[name]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parts."""
        ask_packages(self.group)
        return self.known

    @property
    def known(self) -> tuple[str, ...]:
        """Names of the parts so far, without asking installed packages."""
        return tuple(self._parts)

    def _why_not(self, name: str, *others: str) -> str:
        """The sentence that refuses a name."""
        return refusal(self.group, name) or unknown_name(self.key, (*others, *self), name)

    def split(self, text: str, *others: str) -> tuple[str, str]:
        """The name of a part that a text stands for, and its argument: observer:FILE and a.json for
        observer:a.json.

        Raises
        ------
        InputError
            If the text stands for none; the sentence lists `others` beside the names of the table.
        """
        if (found := self._split(text)) is not None:
            return found
        ask_packages(self.group)
        if (found := self._split(text)) is not None:
            return found
        raise InputError(self._why_not(text, *others))

    def _split(self, text: str) -> tuple[str, str] | None:
        """The same among the parts so far."""
        for name in self.known:
            head, colon, _ = name.partition(":")
            if text == name and not colon:
                return name, ""
            if colon and text.startswith(head + colon) and len(text) > len(head + colon):
                return name, text.removeprefix(head + colon)
        return None

    def with_file_at(self, text: str, folder: Path) -> str:
        """A text such as observer:a.json with its file made absolute, a relative one taken from
        ``folder``.
        """
        for name in self if ":" in text else ():
            head = name.removesuffix("FILE")
            if head.endswith(":") and text.startswith(head) and text != head:
                return f"{head}{(folder / text.removeprefix(head)).resolve()}"
        return text

    def add(self, name: str, part: T) -> None:
        """Make a part known by a name that no other has.

        Raises
        ------
        InputError
            If the name is taken.
        """
        if name in self._parts:
            raise InputError(
                "name",
                f"be none of {', '.join(self.known)}",
                name,
                f"choose another name for this {self.key}",
            )
        self.put(name, part)

    def put(self, name: str, part: T) -> None:
        """Make a part known by a name, in place of the one that has it."""
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
