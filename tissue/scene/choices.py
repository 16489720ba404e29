"""Marks by which a scene's keys take their choices from tables of named parts."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar, get_args

from meshes.base.errors import InputError
from tissue.scene.named_parts import Registry, loaded
from tissue.scene.plugins import ask_packages, refusal

if TYPE_CHECKING:
    from pydantic import BaseModel, GetCoreSchemaHandler, ValidatorFunctionWrapHandler
    from pydantic_core import CoreSchema

__all__ = ["ByKind", "OneOf", "kinds_of"]

T = TypeVar("T")


class OfKind(Protocol):
    """An entry of a table of parts that a scene states, with the class of the part."""

    @property
    def parameters(self) -> "type[BaseModel] | str":
        """The class, or where it lies."""
        ...


K = TypeVar("K", bound=OfKind)


@dataclass(frozen=True)
class OneOf(Generic[T]):
    """Marks a scene's text as a name of a table, or one of some others; it is checked when the scene is."""

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

    def __get_pydantic_core_schema__(self, source: object, handler: "GetCoreSchemaHandler") -> "CoreSchema":
        from pydantic_core import core_schema

        return core_schema.no_info_after_validator_function(self._check, handler(source))

    def __get_pydantic_json_schema__(self, schema: "CoreSchema", handler: object) -> dict[str, object]:
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
    """The kinds that a part of a scene describes, of those known so far."""
    field = part.model_fields["kind"]
    return next((each.known for each in field.metadata if isinstance(each, OneOf)), get_args(field.annotation))


@dataclass(frozen=True)
class ByKind(Generic[K]):
    """Marks a union of parts of a scene, of which the key ``kind`` chooses one; with a table, those of its entries.

    An entry of such a table has the class of the part as ``parameters``.
    """

    table: Registry[K] | None = None

    def parts(self, union: object) -> "tuple[type[BaseModel], ...]":
        """The parts so far."""
        if self.table is None:
            return get_args(union)
        return tuple(loaded(self.table[name].parameters) for name in self.table.known)

    def _choices(self, union: object) -> "dict[str, type[BaseModel]]":
        """The part of each kind so far."""
        return {kind: part for part in self.parts(union) for kind in kinds_of(part)}

    def _groups(self, union: object) -> list[str]:
        """Groups of entry points that offer more kinds."""
        if self.table is not None:
            return [self.table.group]
        marks = [mark for part in get_args(union) for mark in part.model_fields["kind"].metadata]
        return [mark.table.group for mark in marks if isinstance(mark, OneOf)]

    def __get_pydantic_core_schema__(self, source: object, handler: "GetCoreSchemaHandler") -> "CoreSchema":
        from pydantic_core import core_schema

        choices = {kind: handler.generate_schema(part) for kind, part in self._choices(source).items()}

        def check(value: object, validate: "ValidatorFunctionWrapHandler") -> object:
            """Ask installed packages for a kind that is not known; from then on it is."""
            kind = value.get("kind") if isinstance(value, Mapping) else None
            if not isinstance(kind, str) or kind in choices:
                return validate(value)
            for group in self._groups(source):
                ask_packages(group)
                if sentence := refusal(group, kind):
                    raise _fault(group, kind, sentence)
            part = self._choices(source).get(kind)
            return validate(value) if part is None else part.model_validate(value)

        union = core_schema.tagged_union_schema(choices, discriminator="kind")
        return core_schema.no_info_wrap_validator_function(check, union)
