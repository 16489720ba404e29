"""Base class of a scene's tables, and marks for keys that have an effect only together with
another key.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

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

__all__ = [
    "LONGEST_PATH",
    "READ_BACK",
    "FileName",
    "Idle",
    "Length_mm",
    "Needs",
    "Part",
    "Rule",
    "Vector",
    "is_file_key",
    "is_given",
]

READ_BACK = {"written by": "tissue"}
"""Context in which keys without effect pass: a live run gives a wall's tool its reach."""
LONGEST_PATH = 1000
"""Characters of a file's path. Longer texts are no paths that a user wrote."""
FileName = Annotated[str, StringConstraints(max_length=LONGEST_PATH)]
Length_mm = Annotated[float, Field(ge=0.1, le=500)]
Vector = Annotated[tuple[float, float, float], Strict(False)]

Rule = tuple[str, bool, str, str]
"""Keys separated by blanks, whether they have no effect, in which case that is so, and what to
set instead.
"""


class Idle(NamedTuple):
    """Reason why a key has no effect, such as ``without a nodule``, and what to set instead."""

    where: str
    remedy: str


def is_given(part: "Part", name: str) -> bool:
    """Return whether an entry was set to other than its default: what a build asks that finds it
    without effect.
    """
    return (
        name in part.model_fields_set
        and getattr(part, name) != type(part).model_fields[name].default
    )


def is_file_key(name: str) -> bool:
    """Return whether a key of an anatomy, motion, tool or device names a file."""
    return name == "file" or name.endswith("_file")


@dataclass(frozen=True)
class Needs:
    """Mark of a key that has an effect only where another key of its part differs from its default,
    or has a value.

    Attributes
    ----------
    key
        The other key, with the name of the part, such as ``anatomy.nodule_diameter_mm``.
    value
        Value that the other key must have; None for any but its default.
    is_absent
        Whether the other key must be absent instead.
    """

    key: str
    value: object = None
    is_absent: bool = False

    def why_not(self, part: "Part") -> Idle | None:
        """Return why the marked key has no effect in a part; None where it has one."""
        name = self.key.rpartition(".")[2]
        given = getattr(part, name)
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


class Part(BaseModel):
    """Frozen table of a scene. A key that it does not know, or that has no effect in it, is
    refused.
    """

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, use_attribute_docstrings=True
    )

    def rules(self) -> Iterator[Rule]:
        """Yield the rules about keys without effect that no single mark states."""
        yield from ()

    def idle(self) -> dict[str, Idle]:
        """Return the keys that have no effect, and why; keys of inner tables and whole inner
        tables are dotted.
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
        """Return the dotted keys and values that differ from their defaults; kinds are left out."""
        found: dict[str, object] = {}
        for name, field in type(self).model_fields.items():
            value = getattr(self, name)
            if isinstance(value, Part):
                inner = value.changed_entries(f"{prefix}{name}.")
                # An optional table asks for something even where it holds defaults alone.
                found |= inner or ({f"{prefix}{name}": {}} if field.default is None else {})
            elif name != "kind" and value != field.get_default(call_default_factory=True):
                found[f"{prefix}{name}"] = value
        return found

    def effective_table(self) -> dict[str, Any]:
        """Return the table with its defaults as TOML holds it, without keys that have no effect."""
        table = self.model_dump(mode="json", exclude_none=True)
        for name in type(self).model_fields:
            value = getattr(self, name)
            if isinstance(value, Part):
                table[name] = value.effective_table()
        for key in self.idle():
            *outer, name = key.split(".")
            inner: Any = table
            for step in outer:
                inner = inner.get(step, {}) if isinstance(inner, dict) else {}
            if isinstance(inner, dict):
                inner.pop(name, None)
        return {name: value for name, value in table.items() if value != {}}

    @model_validator(mode="after")
    def _has_no_idle_key(self, info: ValidationInfo) -> "Part":
        if info.context == READ_BACK:
            return self
        idle = self.idle()
        if not idle:
            return self
        refused: dict[str, tuple[object, Idle]] = {}
        for key, value in self.changed_entries().items():
            why = idle.get(key) or idle.get(key.split(".")[0])
            if why is not None:
                refused[key] = value, why
        if refused:
            raise PydanticCustomError("idle_keys", "keys without effect", {"refused": refused})
        return self
