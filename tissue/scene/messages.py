"""Faults of a scene, each in one sentence: key, requirement, value and remedy."""

from collections.abc import Iterable, Mapping
from types import UnionType
from typing import Annotated, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from tissue.scene.choices import ByKind, OneOf, kinds_of
from tissue.scene.named_parts import nearest, shown, unknown_name
from tissue.scene.scene import Scene

__all__ = ["choices_of", "sentence"]

BOUNDS = (("gt", "greater than"), ("ge", "at least"), ("lt", "below"), ("le", "at most"))
SEE = "see `tissue scenes NAME`"
Table = Mapping[str, object]


def sentence(fault: ErrorDetails, table: Table) -> str:
    """One sentence for a fault that pydantic found in a scene's table."""
    path = _without_tags(fault["loc"], table)
    names = tuple(str(step) for step in path[: next((i for i, s in enumerate(path) if isinstance(s, int)), len(path))])
    key, kind, context = ".".join(map(shown, names)), str(fault["type"]), fault.get("ctx", {})
    if kind == "value_error":
        return str(context["error"])
    if kind == "refused_part":
        return str(context["sentence"])
    if kind == "extra_forbidden":
        known, word = list(_model_at(names[:-1], table).model_fields), names[-1]
        return f"{key} must be one of {', '.join(known)}, got {shown(word)}{nearest(word, known)}: rename or remove it"
    field = _field_at(names, table)
    if kind == "missing" and len(path) == len(names):
        return f"{key} must be given, got nothing: {_addition(names, field)}"
    if kind == "union_tag_not_found":
        return f"{key}.kind must be given, got nothing: {SEE}"
    if kind == "union_tag_invalid":
        choices = [each for part in _parts(field) for each in kinds_of(part)]
        return unknown_name(
            f"{key}.kind",
            choices,
            shown(context["tag"] if isinstance(context["tag"], str) else _value_at((*names, "kind"), table)),
        )
    got = fault["input"] if len(path) == len(names) else _value_at(names, table)
    choices, number = choices_of(field), _alternatives(field.annotation)[0] in (int, float)
    if choices and not number:
        return unknown_name(key, choices, shown(got))
    wanted = " or ".join((_requirement(field, kind, len(path) > len(names)), *choices))
    return f"{key} must be {wanted}, got {_shown(got)}: {_remedy(field)}"


def _shown(value: object) -> str:
    """A value that was refused, with the point or the quotes that may be what is wrong."""
    if isinstance(value, float) and value.is_integer():
        return repr(value)
    return f'"{shown(value)}"' if isinstance(value, str) and value[:1].isdigit() else shown(value)


def choices_of(field: FieldInfo) -> list[str]:
    """All values of a field that takes one of some names; none for any other."""
    literals = [part for part in _alternatives(field.annotation) if get_origin(part) is Literal]
    named = [name for each in field.metadata if isinstance(each, OneOf) for name in each.names]
    return named or [str(choice) for part in literals for choice in get_args(part)]


def _requirement(field: FieldInfo, kind: str, inside: bool) -> str:
    """What a field holds."""
    part = _alternatives(field.annotation)[0]
    bounds = _bounds([*field.metadata, *_limits(field.annotation)])
    if part in (int, float):
        noun = "a whole number" if part is int else "a number" if kind != "finite_number" else "a finite number"
        if kind in ("float_type", "int_type") or not bounds:
            return f"{noun} {bounds}".strip()
        return bounds
    if part is bool:
        return "true or false"
    if part is str:
        return "lower-case letters, digits, - and _" if kind == "string_pattern_mismatch" else "text"
    if get_origin(part) is tuple:
        item = get_args(part)[0]
        if get_args(part)[-1] is Ellipsis:
            return "a list of at least two points [x, y, z]"
        limits = _bounds(getattr(item, "__metadata__", ()))
        return f"three finite numbers [x, y, z]{', each ' if limits else ''}{limits}"
    if (values := _values(field)) is not None:
        return f"a table of names and numbers {_bounds(values.metadata)}"
    entries = [*_parts(field)[0].model_fields][:3]
    return f"a table with entries such as {', '.join(entries)}"


def _bounds(metadata: Iterable[object]) -> str:
    """Limits as words, from annotations."""
    flat = [inner for each in metadata for inner in (each.metadata if isinstance(each, FieldInfo) else [each])]
    words = [f"{word} {shown(getattr(m, name))}" for name, word in BOUNDS for m in flat if hasattr(m, name)]
    return " and ".join(words)


def _remedy(field: FieldInfo) -> str:
    """A value that would do: the field's example or default."""
    value = field.examples[0] if field.examples else field.default
    if isinstance(value, str):
        return f'use "{value}"' if value else "put it in quotes"
    if isinstance(value, Mapping):
        return "use { " + ", ".join(f"{name} = {shown(each)}" for name, each in value.items()) + " }"
    return f"use {shown(value)}" if isinstance(value, int | float | list | tuple) else SEE


def _addition(names: tuple[str, ...], field: FieldInfo) -> str:
    """How to give what is missing."""
    if not field.examples:
        return f"add [{'.'.join(names)}] with its entries, {SEE}" if _parts(field) else f"add {names[-1]}, {SEE}"
    example = field.examples[0]
    return f"add {names[-1]} = " + (f'"{example}"' if isinstance(example, str) else shown(example))


def _field_at(names: tuple[str, ...], table: Table) -> FieldInfo:
    """What the last of some keys may hold, an entry of a scene or of a table of values in it."""
    if len(names) > 2 and (values := _values(_model_at(names[:-2], table).model_fields[names[-2]])) is not None:
        return values
    return _model_at(names[:-1], table).model_fields[names[-1]]


def _values(field: FieldInfo) -> FieldInfo | None:
    """What the values of a table by name may be; None for a field that holds no such table."""
    part = _alternatives(field.annotation)[0]
    return FieldInfo.from_annotation(get_args(part)[1]) if get_origin(part) is dict else None


def _model_at(names: tuple[str, ...], table: Table) -> type[BaseModel]:
    """The part of a scene that holds the keys under ``names``."""
    model: type[BaseModel] = Scene
    for name in names:
        parts, table = _parts(model.model_fields[name]), _inner(table, name)
        kinds = {kind: p for p in parts if "kind" in p.model_fields for kind in kinds_of(p)}
        model = kinds.get(str(table.get("kind")), parts[0])
    return model


def _parts(field: FieldInfo) -> list[type[BaseModel]]:
    """The parts that a field may hold; none for a value."""
    marked = next((each for each in field.metadata if isinstance(each, ByKind)), None)
    if marked is not None:
        return list(marked.parts(field.annotation))
    return [p for p in _alternatives(field.annotation) if isinstance(p, type) and issubclass(p, BaseModel)]


def _alternatives(annotation: object) -> list[object]:
    """Types that an annotation allows, besides None."""
    if get_origin(annotation) is Annotated:
        return _alternatives(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return [part for each in get_args(annotation) if each is not type(None) for part in _alternatives(each)]
    return [annotation]


def _limits(annotation: object) -> list[object]:
    """What binds one of several types alone."""
    return [limit for each in get_args(annotation) for limit in getattr(each, "__metadata__", ())]


def _inner(table: Table, name: str) -> Table:
    inner = table.get(name, {})
    return inner if isinstance(inner, Mapping) else {}


def _value_at(names: tuple[str, ...], table: Table) -> object:
    for name in names[:-1]:
        table = _inner(table, name)
    return table.get(names[-1])


def _without_tags(location: tuple[int | str, ...], table: Table) -> list[int | str]:
    """A fault's location without what pydantic adds: a part's kind, or which type of several a value is not."""
    tagged = len(location) > 1 and _inner(table, str(location[0])).get("kind") == location[1]
    path = [location[0], *location[2:]] if tagged else list(location)
    for count in range(1, len(path)):
        found = _model_at(tuple(map(str, path[: count - 1])), table).model_fields.get(str(path[count - 1]))
        if found is None or isinstance(path[count], int):
            break
        if not _parts(found):
            return path[: count + (_values(found) is not None)]
    return path
