"""Base class of scene tables, annotations of scene keys, and registries of names.

`Needs` annotates a key that has an effect only together with another key. `OneOf` and `ByKind`
annotate keys whose allowed values come from a registry.
"""

import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Generic, NamedTuple, TypeVar, get_args

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    Strict,
    StringConstraints,
    ValidationInfo,
    model_validator,
)
from pydantic_core import PydanticCustomError

from meshes.base.errors import InputError
from meshes.base.hints import suggests_arguments
from meshes.base.text_tables import shown, unknown_name
from tissue.scene.plugins import ask_packages, refusal

if TYPE_CHECKING:
    from pydantic import GetCoreSchemaHandler, ValidatorFunctionWrapHandler
    from pydantic_core import CoreSchema

SURFACE_SUFFIXES = (".stl", ".obj", ".ply", ".vtk", ".vtp")
"""File name suffixes of surface files.

A path with another suffix, or without a suffix, is an image or a folder of image slices.
"""
LAYERS = ("enamel", "dentin", "pulp", "caries", "ligament")
"""Layers of a tooth; a scene can name a surface file for each layer."""

T = TypeVar("T")


class Registry(Generic[T]):
    """Parts of one kind that scenes select by name, such as all devices.

    Parameters
    ----------
    key
        Scene key whose value is a name in this registry; used in messages.
    parts
        Parts, keyed by name. A name such as ``observer:FILE`` matches ``observer:`` followed by any
        other text.
    group
        Group of entry points through which installed packages offer more parts. The entry points
        are read only if a name is unknown, or if all names are requested.

    Attributes
    ----------
    built_in
        Names of the initial parts, without parts that were added later.
    """

    def __init__(self, key: str, parts: Mapping[str, T], *, group: str = "") -> None:
        self.key = key
        self.group = group
        self._parts = dict(parts)
        self.built_in = frozenset(parts)
        self.on_change: list[Callable[[], object]] = []
        """Functions that are called after a part is added or removed."""

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
        """Names of all parts, including parts of installed packages."""
        ask_packages(self.group)
        return self.known

    @property
    def known(self) -> tuple[str, ...]:
        """Names of the parts that are known without reading entry points of packages."""
        return tuple(self._parts)

    def _why_not(self, name: str, *others: str) -> InputError:
        """Return the error for a name that matches no part."""
        if why := refusal(self.group, name):
            return InputError(why)
        return unknown_name(self.key, (*others, *self), name)

    def split(self, text: str, *others: str) -> tuple[str, str]:
        """Return the name of the registered part in a text, and the text after its first colon.

        For ``observer:a.json``, the result is ``observer:FILE`` and ``a.json``.

        Raises
        ------
        InputError
            If the text matches no part. The message lists the names in the registry and the names
            in `others`.
        """
        if (found := self._split(text)) is not None:
            return found
        ask_packages(self.group)
        if (found := self._split(text)) is not None:
            return found
        raise self._why_not(text, *others)

    def _split(self, text: str) -> tuple[str, str] | None:
        """Return the name of the known part that a text selects, and its argument, or None."""
        for name in self.known:
            head, colon, _ = name.partition(":")
            if text == name and not colon:
                return name, ""
            if colon and text.startswith(head + colon) and len(text) > len(head + colon):
                return name, text.removeprefix(head + colon)
        return None

    def with_file_at(self, text: str, folder: Path) -> str:
        """Return a text such as ``observer:a.json`` with an absolute path of its file.

        A relative path is taken as relative to `folder`.
        """
        for name in self if ":" in text else ():
            head = name.removesuffix("FILE")
            if head.endswith(":") and text.startswith(head) and text != head:
                return f"{head}{(folder / text.removeprefix(head)).resolve()}"
        return text

    def add(self, name: str, part: T) -> None:
        """Add a part under a new name.

        Raises
        ------
        InputError
            If the name is already used.
        """
        if name in self._parts:
            raise InputError(
                "name",
                f"not be one of {', '.join(self.known)}",
                name,
                f"choose another name for this {self.key}",
            )
        self.put(name, part)

    def put(self, name: str, part: T) -> None:
        """Store a part under a name, and replace an existing part with this name."""
        self._parts[name] = part
        self._changed()

    def remove(self, name: str) -> None:
        """Remove a part that was added; its name can be used again."""
        self[name]
        del self._parts[name]
        self._changed()

    def _changed(self) -> None:
        for call in self.on_change:
            call()


@dataclass(frozen=True)
class OneOf(Generic[T]):
    """Annotation for a scene key that accepts the names in a registry and the texts in `others`.

    The value is checked when the scene is validated.
    """

    table: Registry[T]
    others: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """All accepted names, including names of parts of installed packages."""
        return (*self.others, *self.table)

    @property
    def known(self) -> tuple[str, ...]:
        """Names that are known without reading the entry points of installed packages."""
        return (*self.others, *self.table.known)

    def _check(self, name: str) -> str:
        if name not in self.others:
            try:
                self.table.split(name, *self.others)
            except InputError as error:
                raise PydanticCustomError("unknown_name", "{error}", {"error": error}) from None
        return name

    def __get_pydantic_core_schema__(
        self, source: object, handler: "GetCoreSchemaHandler"
    ) -> "CoreSchema":
        from pydantic_core import core_schema

        return core_schema.no_info_after_validator_function(self._check, handler(source))

    def __get_pydantic_json_schema__(
        self, schema: "CoreSchema", handler: object
    ) -> dict[str, object]:
        if not any(":" in name for name in self.names):
            return {"enum": list(self.names), "type": "string"}
        patterns = (re.sub(":.*", ":.+", re.escape(name)) for name in self.names)
        return {"pattern": f"^({'|'.join(patterns)})$", "type": "string"}


def kinds_of(part: "type[BaseModel]") -> tuple[str, ...]:
    """Return the known values that a table class accepts for its key ``kind``."""
    field = part.model_fields["kind"]
    return next(
        (each.known for each in field.metadata if isinstance(each, OneOf)),
        get_args(field.annotation),
    )


SOURCES = {
    "": ("procedural",),
    "layers": ("from surfaces", "procedural"),
    "surface": ("from a surface", "from a file", "from labels"),
    "image": ("from an image", "from labels", "from a file"),
}
"""Names of the source of a shape in messages, keyed by the type of the files in ``anatomy``.

A message uses the first name for which the chosen kind has a table class.
"""


def source_of(table: Mapping[str, object]) -> tuple[str, ...]:
    """Return the possible sources of an anatomy's shape, judged by the file names in its table."""
    file = table.get("file")
    if not isinstance(file, str) or not file:
        has_layers = any(f"{layer}_file" in table for layer in LAYERS)
        return SOURCES["layers" if has_layers else ""]
    return SOURCES["surface" if Path(file).suffix.lower() in SURFACE_SUFFIXES else "image"]


@dataclass(frozen=True)
class ByKind:
    """Annotation for a key with a table as value; the table's key ``kind`` selects its class.

    If a kind has several classes, the source of the shape (procedural, surface, image) selects one.

    Attributes
    ----------
    parts
        Function that returns the known table classes.
    groups
        Groups of entry points through which installed packages offer more table classes.
    """

    parts: "Callable[[], tuple[type[BaseModel], ...]]"
    groups: tuple[str, ...]

    def chosen(self, table: Mapping[str, object]) -> "type[BaseModel] | None":
        """Return the class for a table, selected by its kind; None for an unknown kind."""
        variants = [part for part in self.parts() if table.get("kind") in kinds_of(part)]
        for source in source_of(table):
            for part in variants:
                if getattr(part, "source", "") == source:
                    return part
        return variants[0] if variants else None

    def __get_pydantic_core_schema__(
        self, source: object, handler: "GetCoreSchemaHandler"
    ) -> "CoreSchema":
        from pydantic_core import core_schema

        parts = self.parts()
        choices = {part.__name__: handler.generate_schema(part) for part in parts}

        def tag(value: object) -> str | None:
            """Return the class name for a table; an unknown kind is returned unchanged."""
            if not isinstance(value, Mapping):
                return type(value).__name__
            kind = value.get("kind")
            part = self.chosen(value)
            if part is not None:
                return part.__name__
            return None if kind is None else shown(kind)

        def check(value: object, validate: "ValidatorFunctionWrapHandler") -> object:
            """Validate a value; for an unknown kind, read the entry points of installed packages
            first.
            """
            if not isinstance(value, Mapping):
                return validate(value)
            # An empty name means no file, even if the table has a default file.
            if value.get("file") == "":
                value = {name: each for name, each in value.items() if name != "file"}
            kind = value.get("kind")
            known = {each for part in parts for each in kinds_of(part)}
            if not isinstance(kind, str) or kind in known:
                return validate(value)
            for group in self.groups:
                ask_packages(group)
                if sentence := refusal(group, kind):
                    raise InputError(sentence)
            part = self.chosen(value)
            return validate(value) if part is None else part.model_validate(value)

        union = core_schema.tagged_union_schema(choices, discriminator=tag)
        return core_schema.no_info_wrap_validator_function(check, union)


READ_BACK = {"written by": "tissue"}
"""Context for pydantic with which keys without effect are accepted.

The context is needed because a live run sets ``coupling.roam_mm`` at a wall, where this key has no
effect.
"""
LONGEST_PATH = 1000
"""Largest number of characters of a file path; a longer text is not treated as a path."""
FileName = Annotated[str, StringConstraints(max_length=LONGEST_PATH)]
Length_mm = Annotated[float, Field(ge=0.1, le=500)]
Vector = Annotated[tuple[float, float, float], Strict(False)]

Rule = tuple[str, bool, str, str]
"""Keys (separated by blanks), True if these keys have no effect, reason, and remedy."""


class Idle(NamedTuple):
    """Reason why a key has no effect, such as ``without a nodule``, and advice for a change."""

    where: str
    remedy: str


def removal_of(keys: Collection[str]) -> str:
    """Return a note on keys that were removed because scene changes made them ineffective."""
    names = ", ".join(sorted(keys))
    has, was = ("has", "was") if len(keys) == 1 else ("have", "were")
    return f"{names} of the scene {has} no effect after the changes and {was} removed"


def entries(table: Mapping[str, object], prefix: str = "") -> Iterator[tuple[str, object]]:
    """Yield the dotted keys and the values of nested tables."""
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from entries(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def is_given(part: "Part", name: str) -> bool:
    """Return whether a key of a table was set to a value other than its default."""
    return (
        name in part.model_fields_set
        and getattr(part, name) != type(part).model_fields[name].default
    )


def is_file_key(name: str) -> bool:
    """Return whether the value of a scene key is the name of a file."""
    return name == "file" or name.endswith("_file")


@dataclass(frozen=True)
class Needs:
    """Annotation for a scene key that has an effect only if another key has a certain value.

    The other key is in the same table. The other key must have the value `value`, or any value
    except its default, or it must be absent (`is_absent`).

    Attributes
    ----------
    key
        The other key, with the name of the table, such as ``anatomy.nodule_diameter_mm``.
    value
        Value that the other key must have; None for any value except its default.
    is_absent
        True if the other key must be absent; `value` is then not used.
    """

    key: str
    value: object = None
    is_absent: bool = False

    def why_not(self, part: "Part") -> Idle | None:
        """Return the reason why the annotated key has no effect in `part`; None if it has one."""
        name = self.key.rpartition(".")[2]
        given = getattr(part, name)
        # A default means that nothing was chosen: 0 mm is no hole, and an empty name is no file.
        is_set = bool(given) and given != type(part).model_fields[name].default
        if self.is_absent:
            return Idle(f"with {self.key}", f"remove {self.key}") if is_set else None
        if self.value is not None:
            met = given == self.value
            return (
                None
                if met
                else Idle(f"with {self.key} = {given}", f"set {self.key} = {self.value}")
            )
        if is_set:
            return None
        if isinstance(given, str) and given:
            return Idle(f"with {self.key} = {given}", f"set another {self.key}")
        return Idle(f"without {self.key}", f"set {self.key}")


@suggests_arguments
class Part(BaseModel):
    """Base class of scene tables; a table is immutable and refuses unknown or ineffective keys."""

    model_config = ConfigDict(
        frozen=True,
        extra="forbid",
        strict=True,
        allow_inf_nan=False,
        use_attribute_docstrings=True,
        defer_build=True,
    )

    def rules(self) -> Iterator[Rule]:
        """Yield conditions, in addition to `Needs`, under which keys have no effect."""
        yield from ()

    def idle(self) -> dict[str, Idle]:
        """Return the keys that have no effect, with the reason for each key.

        The result may also contain dotted keys of inner tables, and the names of inner tables in
        which no key has an effect.
        """
        found: dict[str, Idle] = {}
        for keys, is_idle, where, remedy in self.rules():
            if is_idle:
                found = dict.fromkeys(keys.split(), Idle(where, remedy)) | found
        for name, field in type(self).model_fields.items():
            for mark in field.metadata:
                if isinstance(mark, Needs) and (why := mark.why_not(self)):
                    found.setdefault(name, why)
        return found

    def changed_entries(self, prefix: str = "") -> dict[str, object]:
        """Return the values that differ from their defaults, keyed by dotted key.

        Keys with the name ``kind`` are left out.
        """
        found: dict[str, object] = {}
        for name, field in type(self).model_fields.items():
            value = getattr(self, name)
            if isinstance(value, Part):
                inner = value.changed_entries(f"{prefix}{name}.")
                # An optional table has an effect even if it contains only defaults.
                found |= inner or ({f"{prefix}{name}": {}} if field.default is None else {})
            elif name != "kind" and value != field.get_default(call_default_factory=True):
                found[f"{prefix}{name}"] = value
        return found

    def effective_table(self) -> dict[str, Any]:
        """Return the table with defaults, but without keys that have no effect."""
        table = self.model_dump(mode="json", exclude_none=True)
        idle = self.idle()
        for name in type(self).model_fields:
            value = getattr(self, name)
            if isinstance(value, Part) and name not in idle:
                table[name] = value.effective_table()
        for key in idle:
            *outer, name = key.split(".")
            inner: Any = table
            for step in outer:
                inner = inner.get(step, {}) if isinstance(inner, dict) else {}
            if isinstance(inner, dict):
                inner.pop(name, None)
        return {name: value for name, value in table.items() if value != {}}

    def require_valid(self) -> None:
        """Raise an `InputError` if values that depend on each other are inconsistent."""

    @model_validator(mode="after")
    def _fits(self, info: ValidationInfo) -> "Part":
        if info.context != READ_BACK:
            self._require_no_idle_key()
        self.require_valid()
        return self

    def _require_no_idle_key(self) -> None:
        idle = self.idle()
        refused: dict[str, tuple[object, Idle]] = {}
        for key, value in self.changed_entries().items():
            # A whole table may have no effect.
            why = idle.get(key) or idle.get(key.split(".")[0])
            if why is not None:
                refused[key] = value, why
        if refused:
            raise PydanticCustomError("idle_keys", "keys without effect", {"refused": refused})
