"""Registries of named parts, with the parts of installed packages from entry points.

Entry points are read once, when a name is unknown or the names are listed.
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
"""Function of `tissue.register` for the parts of each group of entry points."""
_asked: set[str] = set()
_refused: dict[tuple[str, str], str] = {}


class PluginWarning(UserWarning):
    """Warning about a part of an installed package that cannot be used and is left out."""


def ask_packages(group: str) -> None:
    """Register the parts that installed packages offer in a group of entry points.

    Each group is read once. A part that cannot be used is left out with a `PluginWarning`, see
    `refusal`. Its name then keeps its earlier part, which is built in or was registered by a call.
    """
    if not group or group in _asked:
        return
    _asked.add(group)  # before an import that may call this function
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
    """Return the reason why an offered part cannot be used; None if it was not refused."""
    return _refused.get((group, name))


def offered_names() -> dict[str, list[str]]:
    """Return the names of the parts of installed packages by kind, without importing them."""
    return {OFFERED[group]: [offer.name for offer in offers] for group, offers in _offers().items()}


def _refuse(offer: EntryPoint, cause: str) -> str:
    """Warn about an offered part that is left out, and return the warning text."""
    what = f"{OFFERED[offer.group]} {offer.name} of the package {_package(offer)}"
    sentence = f"{what} cannot be used ({cause}): update or uninstall that package"
    # 4: the code that used the name, behind `Registry`.
    warnings.warn(sentence, PluginWarning, stacklevel=4)
    return sentence


def _package(offer: EntryPoint) -> str:
    """Return the name and version of the package that offers a part."""
    return offer.value if offer.dist is None else f"{offer.dist.name} {offer.dist.version}"


@cache
def _offers() -> dict[str, list[EntryPoint]]:
    """Return the installed entry points by group, for groups with any."""
    installed = entry_points()
    found = {group: list(installed.select(group=group)) for group in OFFERED}
    return {group: offers for group, offers in found.items() if offers}


T = TypeVar("T")
LONGEST = 120
"""Largest number of characters of a value in a message."""


def nearest(word: str, known: Iterable[str]) -> str:
    """Return the most similar known word as a question in brackets, or an empty text."""
    close = difflib.get_close_matches(word, list(known), n=1)
    return f" (did you mean {close[0]}?)" if close else ""


def unknown_name(key: str, known: Iterable[str], got: object) -> InputError:
    """Return the error for an unknown name."""
    known = list(known)
    word = shown(got)
    return InputError(
        key, f"be one of {', '.join(known)}", f"{word}{nearest(word, known)}", "choose one of these"
    )


def shown(value: object) -> str:
    """Return a value as a user would write it."""
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
    """Registry of named parts of one kind, in listing order.

    Parameters
    ----------
    key
        Scene key whose value is a name in this registry, as used in messages.
    parts
        Parts by name. A name such as ``observer:FILE`` matches all texts with another argument
        after the colon.
    group
        Group of entry points by which installed packages offer more parts. The packages are asked
        for an unknown name, and when the names are listed.

    Attributes
    ----------
    built_in
        Names of the parts given at construction.
    """

    def __init__(self, key: str, parts: Mapping[str, T], *, group: str = "") -> None:
        self.key = key
        self.group = group
        self._parts = dict(parts)
        self.built_in = frozenset(parts)
        self.on_change: list[Callable[[], object]] = []
        """Functions called after a part is added or removed."""

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
        """Names of the parts known so far, without asking installed packages."""
        return tuple(self._parts)

    def _why_not(self, name: str, *others: str) -> InputError:
        """Return the error for a name that matches no part."""
        if why := refusal(self.group, name):
            return InputError(why)
        return unknown_name(self.key, (*others, *self), name)

    def split(self, text: str, *others: str) -> tuple[str, str]:
        """Return the name of the part that a text names, and its argument.

        For ``observer:a.json`` these are ``observer:FILE`` and ``a.json``.

        Raises
        ------
        InputError
            If the text matches no part. The message lists `others` and the names of the registry.
        """
        if (found := self._split(text)) is not None:
            return found
        ask_packages(self.group)
        if (found := self._split(text)) is not None:
            return found
        raise self._why_not(text, *others)

    def _split(self, text: str) -> tuple[str, str] | None:
        """Return name and argument of a text among the parts known so far; None without a match."""
        for name in self.known:
            head, colon, _ = name.partition(":")
            if text == name and not colon:
                return name, ""
            if colon and text.startswith(head + colon) and len(text) > len(head + colon):
                return name, text.removeprefix(head + colon)
        return None

    def with_file_at(self, text: str, folder: Path) -> str:
        """Return a text such as observer:a.json with an absolute file path.

        A relative path starts at ``folder``.
        """
        for name in self if ":" in text else ():
            head = name.removesuffix("FILE")
            if head.endswith(":") and text.startswith(head) and text != head:
                return f"{head}{(folder / text.removeprefix(head)).resolve()}"
        return text

    def add(self, name: str, part: T) -> None:
        """Add a part by a new name.

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
        """Set the part of a name, in place of an existing one."""
        self._parts[name] = part
        self._changed()

    def remove(self, name: str) -> None:
        """Remove a part that was added, and free its name."""
        self[name]
        del self._parts[name]
        self._changed()

    def _changed(self) -> None:
        for call in self.on_change:
            call()
