"""Marks by which a scene's keys take their choices from tables of named parts."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Generic, TypeVar, get_args

from meshes.base.errors import InputError
from tissue.scene.named_parts import Registry, shown
from tissue.scene.plugins import ask_packages, refusal

if TYPE_CHECKING:
    from pydantic import BaseModel, GetCoreSchemaHandler, ValidatorFunctionWrapHandler
    from pydantic_core import CoreSchema

__all__ = ["LAYERS", "SURFACE_SUFFIXES", "ByKind", "OneOf", "kinds_of"]

SURFACE_SUFFIXES = (".stl", ".obj", ".ply", ".vtk", ".vtp")
"""Ends of the names of surface files; a file of any other name is an image, or a folder of its
slices.
"""
LAYERS = ("enamel", "dentin", "pulp", "caries", "ligament")
"""Layers of a tooth that have a surface of their own."""

T = TypeVar("T")


@dataclass(frozen=True)
class OneOf(Generic[T]):
    """Marks a scene's text as a name of a table, or one of some others; it is checked when the
    scene is.
    """

    table: Registry[T]
    others: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """All names that are accepted now."""
        return (*self.others, *self.table)

    @property
    def known(self) -> tuple[str, ...]:
        """Those so far, without asking installed packages."""
        return (*self.others, *self.table.known)

    def _check(self, name: str) -> str:
        if name not in self.others:
            try:
                self.table.split(name, *self.others)
            except InputError as error:
                raise _fault(self.table.group, name, str(error)) from None
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


def _fault(group: str, name: str, sentence: str) -> Exception:
    """The fault of a name that is not known, or whose package cannot be used."""
    from pydantic_core import PydanticCustomError

    kind = "unknown_name" if refusal(group, name) is None else "refused_part"
    return PydanticCustomError(kind, "{sentence}", {"sentence": sentence})


def kinds_of(part: "type[BaseModel]") -> tuple[str, ...]:
    """Return the kinds that a part of a scene describes, of those known so far."""
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
"""Sources of a shape by what a table of it holds, the first that its kind knows is meant."""


def source_of(table: Mapping[str, object]) -> tuple[str, ...]:
    """Return the sources that a table of a shape can mean, by its files."""
    file = table.get("file")
    if not isinstance(file, str) or not file:
        has_layers = any(f"{layer}_file" in table for layer in LAYERS)
        return SOURCES["layers" if has_layers else ""]
    return SOURCES["surface" if Path(file).suffix.lower() in SURFACE_SUFFIXES else "image"]


@dataclass(frozen=True)
class ByKind:
    """Mark of a union of tables, of which the key ``kind`` chooses one, and of those with several
    the source.

    Attributes
    ----------
    parts
        Returns the tables that are known so far.
    groups
        Groups of entry points that offer more of them.
    """

    parts: "Callable[[], tuple[type[BaseModel], ...]]"
    groups: tuple[str, ...]

    def chosen(self, table: Mapping[str, object]) -> "type[BaseModel] | None":
        """Return the table class that entries with a kind mean; None for an unknown kind."""
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
            """Return the name of the class that a table means; an unknown kind as it is."""
            if not isinstance(value, Mapping):
                return type(value).__name__
            kind = value.get("kind")
            part = self.chosen(value)
            if part is not None:
                return part.__name__
            return None if kind is None else shown(kind)

        def check(value: object, validate: "ValidatorFunctionWrapHandler") -> object:
            """Ask installed packages for a kind that is not known; from then on it is."""
            if not isinstance(value, Mapping):
                return validate(value)
            if value.get("file") == "":
                value = {name: each for name, each in value.items() if name != "file"}
            kind = value.get("kind")
            known = {each for part in parts for each in kinds_of(part)}
            if not isinstance(kind, str) or kind in known:
                return validate(value)
            for group in self.groups:
                ask_packages(group)
                if sentence := refusal(group, kind):
                    raise _fault(group, kind, sentence)
            part = self.chosen(value)
            return validate(value) if part is None else part.model_validate(value)

        union = core_schema.tagged_union_schema(choices, discriminator=tag)
        return core_schema.no_info_wrap_validator_function(check, union)
