"""Tables of named parts, and the parts that installed packages add to them by entry points.

Entry points are read once, when a table is asked for more than it knows.
"""

import difflib
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Generic, TypeVar

from meshes.base.errors import InputError

__all__ = [
    "OFFERED",
    "PluginWarning",
    "Registry",
    "ask_packages",
    "nearest",
    "offered_names",
    "refusal",
    "shown",
    "unknown_name",
]

OFFERED = {
    f"tissue.{kind}s": kind
    for kind in (
        "tool",
        "probe",
        "needle",
        "motion",
        "tissue",
        "device",
        "hand",
        "renderer",
        "predictor",
        "perception",
        "material",
        "scene",
    )
}
"""Groups of entry points, by the function of `tissue.register` that takes what one names."""
_asked: set[str] = set()
_refused: dict[tuple[str, str], str] = {}


class PluginWarning(UserWarning):
    """A part that an installed package offers cannot be used; all else goes on without it."""


def ask_packages(group: str) -> None:
    """Make known what installed packages offer in a group of entry points; once for each group.

    A part that cannot be had is left out with a `PluginWarning`, see `refusal`. Its name stays with
    who had it before: with what is built in, or was registered by a call.
    """
    if not group or group in _asked:
        return
    _asked.add(group)  # before any is imported, which may ask in its turn
    first: dict[str, EntryPoint] = {}
    for offer in _offers().get(group, ()):
        other = first.setdefault(offer.name, offer)
        if other is not offer:
            _refuse(
                offer, f"the package {_package(other)} offers one by that name, too, which is used"
            )
            continue
        try:
            from tissue import register

            register.offered(OFFERED[group], offer.name, offer.load)
        except (Exception, SystemExit) as error:
            reason = (str(error).splitlines() or [""])[0]
            cause = (
                reason
                if type(error).__name__ == "InputError"
                else f"{type(error).__name__}: {reason}"
            )
            _refused[group, offer.name] = _refuse(offer, cause)


def refusal(group: str, name: str) -> str | None:
    """Why a part that a package offers cannot be used; None where none by that name was refused."""
    return _refused.get((group, name))


def offered_names() -> dict[str, list[str]]:
    """Names of what installed packages offer, by kind, without importing any of them."""
    return {OFFERED[group]: [offer.name for offer in offers] for group, offers in _offers().items()}


def _refuse(offer: EntryPoint, cause: str) -> str:
    """Warn of an offer that is left out; the sentence."""
    what = f"{OFFERED[offer.group]} {offer.name} of the package {_package(offer)}"
    sentence = f"{what} cannot be used ({cause}): update or uninstall that package"
    warnings.warn(sentence, PluginWarning, stacklevel=4)
    return sentence


def _package(offer: EntryPoint) -> str:
    """Name and version of the package that offers it."""
    return offer.value if offer.dist is None else f"{offer.dist.name} {offer.dist.version}"


@cache
def _offers() -> dict[str, list[EntryPoint]]:
    """Entry points of all groups that are there."""
    installed = entry_points()
    found = {group: list(installed.select(group=group)) for group in OFFERED}
    return {group: offers for group, offers in found.items() if offers}


T = TypeVar("T")
LONGEST = 120
"""Characters of a value that a sentence repeats."""


def nearest(word: str, known: Iterable[str]) -> str:
    """The known word that ``word`` may have been meant to be, in brackets, or nothing."""
    close = difflib.get_close_matches(word, list(known), n=1)
    return f" (did you mean {close[0]}?)" if close else ""


def unknown_name(key: str, known: Iterable[str], got: object) -> InputError:
    """Return the error for a name that is not one of those known."""
    known = list(known)
    word = shown(got)
    return InputError(
        key, f"be one of {', '.join(known)}", f"{word}{nearest(word, known)}", "choose one of these"
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
            raise self._why_not(name)
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

    def _why_not(self, name: str, *others: str) -> InputError:
        """Return the error for a name that stands for no part."""
        if why := refusal(self.group, name):
            return InputError(why)
        return unknown_name(self.key, (*others, *self), name)

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
        raise self._why_not(text, *others)

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
