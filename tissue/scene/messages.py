"""Faults of a scene, each in one sentence: key, requirement, value and remedy."""

from collections.abc import Iterable, Iterator, Mapping
from types import UnionType
from typing import Annotated, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from tissue.scene.named_parts import nearest, shown, unknown_name
from tissue.scene.part import LONGEST_PATH, ByKind, Idle, OneOf, kinds_of
from tissue.scene.scene import Scene

__all__ = ["choices_of", "idle_keys", "sentence"]

BOUNDS = (("gt", "greater than"), ("ge", "at least"), ("lt", "below"), ("le", "at most"))
SEE = "see `tissue scenes NAME`"
Table = Mapping[str, object]


def sentence(fault: ErrorDetails, table: Table, model: type[BaseModel] = Scene) -> str:
    """Return one sentence for a fault that pydantic found in the table of a model."""
    path = _without_tags(fault["loc"], table, model)
    numbers = [place for place, step in enumerate(path) if isinstance(step, int)]
    names = tuple(str(step) for step in path[: numbers[0] if numbers else len(path)])
    key = ".".join(map(shown, names))
    kind = str(fault["type"])
    context = fault.get("ctx", {})
    if kind == "value_error":
        return str(context["error"])
    if kind == "refused_part":
        return str(context["sentence"])
    if kind == "idle_keys":
        return _idle_sentence(names, context["refused"])
    if kind == "extra_forbidden":
        return _unknown_key(names, table, model)
    if names == ("device", "kind") and kind == "missing":
        given = [f"{name} = {shown(value)}" for name, value in _entries(_inner(table, "device"))]
        return (
            f"device must be given for {', '.join(given) or 'a table [device]'}: set device = "
            "touch, or remove it"
        )
    field = _field_at(names, table, model)
    if kind == "missing" and len(path) == len(names):
        return f"{key} must be given, got nothing: {_addition(names, field)}"
    if kind == "union_tag_not_found":
        return f"{key}.kind must be given, got nothing: {SEE}"
    if kind == "union_tag_invalid" and isinstance(_value_at(names, table), Mapping):
        choices = list(dict.fromkeys(each for part in _parts(field) for each in kinds_of(part)))
        return unknown_name(f"{key}.kind", choices, shown(_value_at((*names, "kind"), table)))
    got = fault["input"] if len(path) == len(names) else _value_at(names, table)
    choices = choices_of(field)
    number = _alternatives(field.annotation)[0] in (int, float)
    if choices and not number:
        return unknown_name(key, choices, shown(got))
    wanted = " or ".join((_requirement(field, kind, len(path) > len(names)), *choices))
    return f"{key} must be {wanted}, got {_shown(got)}: {_remedy(field)}"


def _idle_sentence(names: tuple[str, ...], refused: Mapping[str, tuple[object, Idle]]) -> str:
    """Return the sentence for keys without effect; it names all that have none for the same
    reason.
    """
    prefix = "".join(f"{name}." for name in names)
    first = next(iter(refused.values()))[1]
    given = {f"{prefix}{key}": value for key, (value, why) in refused.items() if why == first}
    if len(given) == 1:
        got = shown(next(iter(given.values())))
        them = "it"
    else:
        got = ", ".join(f"{key} = {shown(value)}" for key, value in given.items())
        them = "them"
    return (
        f"{' and '.join(given)} must be left out {first.where}, got {got}: {first.remedy}, or "
        f"remove {them}"
    )


def _unknown_key(names: tuple[str, ...], table: Table, model: type[BaseModel]) -> str:
    """Return the sentence for a key that the chosen table does not have: another has it, or
    none.
    """
    key = ".".join(map(shown, names))
    word = names[-1]
    others = _holders(names, table, model)
    chosen = _model_at(names[:-1], table, model)
    if not others:
        known = list(chosen.model_fields)
        return (
            f"{key} must be one of {', '.join(known)}, got {shown(word)}{nearest(word, known)}: "
            "rename or remove it"
        )
    part = ".".join(names[:-1])
    kinds = kinds_of(chosen)
    got = shown(_value_at(names, table))
    same = [other for other in others if set(kinds_of(other)) & set(kinds)]
    if same:
        source = str(getattr(chosen, "source", ""))
        sources = [str(getattr(other, "source", "")) for other in same]
        if source == "procedural":
            where = f"a procedural {kinds[0]}"
            remedy = f"set {part}.file"
        elif "procedural" in sources:
            where = f"a {kinds[0]} {source}"
            remedy = "leave its file out"
        else:
            where = f"a {kinds[0]} {source}"
            remedy = f"use one {' or '.join(sources)}"
        return f"{key} must be left out for {where}, got {got}: {remedy}, or remove it"
    other_kind = kinds_of(others[0])[0]
    return (
        f"{key} must be left out for a {kinds[0]}, got {got}: set {part}.kind = {other_kind}, or "
        "remove it"
    )


def idle_keys(fault: ErrorDetails, table: Table) -> list[str]:
    """Return the dotted keys of a scene's table that a fault refuses because they have no effect
    in it.
    """
    names = tuple(str(step) for step in _without_tags(fault["loc"], table, Scene))
    if fault["type"] == "idle_keys":
        return [".".join((*names, key)) for key in fault["ctx"]["refused"]]
    if fault["type"] == "extra_forbidden" and _holders(names, table, Scene):
        return [".".join(names)]
    return []


def _holders(names: tuple[str, ...], table: Table, model: type[BaseModel]) -> list[type[BaseModel]]:
    """Return the other tables of a union that have a key, those for the same tool or tissue
    first.
    """
    if len(names) < 2:
        return []
    outer = _model_at(names[:-2], table, model)
    if names[-2] not in outer.model_fields:
        return []
    return [
        part for part in _parts(outer.model_fields[names[-2]]) if names[-1] in part.model_fields
    ]


def _entries(table: Table, prefix: str = "") -> Iterator[tuple[str, object]]:
    """Yield the dotted keys and the values of nested tables."""
    for name, value in table.items():
        if isinstance(value, Mapping):
            yield from _entries(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


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
        noun = (
            "a whole number"
            if part is int
            else "a number"
            if kind != "finite_number"
            else "a finite number"
        )
        if kind in ("float_type", "int_type") or not bounds:
            return f"{noun} {bounds}".strip()
        return bounds
    if part is bool:
        return "true or false"
    if part is str:
        if kind == "string_too_long":
            return f"a path of at most {LONGEST_PATH} characters"
        return (
            "lower-case letters, digits, - and _" if kind == "string_pattern_mismatch" else "text"
        )
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
    flat = [
        inner
        for each in metadata
        for inner in (each.metadata if isinstance(each, FieldInfo) else [each])
    ]
    words = [
        f"{word} {shown(getattr(m, name))}"
        for name, word in BOUNDS
        for m in flat
        if hasattr(m, name)
    ]
    return " and ".join(words)


def _remedy(field: FieldInfo) -> str:
    """A value that would do: the field's example or default."""
    value = field.examples[0] if field.examples else field.default
    if isinstance(value, str):
        return f'use "{value}"' if value else "put it in quotes"
    if isinstance(value, Mapping):
        return (
            "use { " + ", ".join(f"{name} = {shown(each)}" for name, each in value.items()) + " }"
        )
    return f"use {shown(value)}" if isinstance(value, int | float | list | tuple) else SEE


def _addition(names: tuple[str, ...], field: FieldInfo) -> str:
    """How to give what is missing."""
    if not field.examples:
        return (
            f"add [{'.'.join(names)}] with its entries, {SEE}"
            if _parts(field)
            else f"add {names[-1]}, {SEE}"
        )
    example = field.examples[0]
    return f"add {names[-1]} = " + (f'"{example}"' if isinstance(example, str) else shown(example))


def _field_at(names: tuple[str, ...], table: Table, model: type[BaseModel]) -> FieldInfo:
    """Return what the last of some keys may hold, an entry of a scene or of a table of values in
    it.
    """
    if len(names) > 2:
        values = _values(_model_at(names[:-2], table, model).model_fields[names[-2]])
        if values is not None:
            return values
    return _model_at(names[:-1], table, model).model_fields[names[-1]]


def _values(field: FieldInfo) -> FieldInfo | None:
    """What the values of a table by name may be; None for a field that holds no such table."""
    part = _alternatives(field.annotation)[0]
    return FieldInfo.from_annotation(get_args(part)[1]) if get_origin(part) is dict else None


def _model_at(names: tuple[str, ...], table: Table, model: type[BaseModel]) -> type[BaseModel]:
    """Return the table of a model that holds the keys under ``names``."""
    for name in names:
        field = model.model_fields[name]
        table = _inner(table, name)
        mark = _by_kind(field)
        chosen = mark.chosen(table) if mark is not None else None
        model = chosen or _parts(field)[0]
    return model


def _by_kind(field: FieldInfo) -> ByKind | None:
    """Return the mark of a union of tables; None for any other field."""
    return next((each for each in field.metadata if isinstance(each, ByKind)), None)


def _parts(field: FieldInfo) -> list[type[BaseModel]]:
    """The parts that a field may hold; none for a value."""
    mark = _by_kind(field)
    if mark is not None:
        return list(mark.parts())
    return [
        p
        for p in _alternatives(field.annotation)
        if isinstance(p, type) and issubclass(p, BaseModel)
    ]


def _alternatives(annotation: object) -> list[object]:
    """Types that an annotation allows, besides None."""
    if get_origin(annotation) is Annotated:
        return _alternatives(get_args(annotation)[0])
    if get_origin(annotation) in (Union, UnionType):
        return [
            part
            for each in get_args(annotation)
            if each is not type(None)
            for part in _alternatives(each)
        ]
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


def _without_tags(
    location: tuple[int | str, ...], table: Table, model: type[BaseModel]
) -> list[int | str]:
    """Return a fault's location without what pydantic adds: a part's class, or which type of
    several a value is not.
    """
    path = list(location)
    inner: type[BaseModel] | None = model
    place = 0
    while inner is not None and place < len(path) and isinstance(path[place], str):
        field = inner.model_fields.get(str(path[place]))
        if field is None:
            break
        place += 1
        parts = _parts(field)
        if not parts:
            is_number = place < len(path) and isinstance(path[place], int)
            return path if is_number else path[: place + (_values(field) is not None)]
        tag = path[place] if place < len(path) else None
        if _by_kind(field) is not None:
            inner = next((part for part in parts if part.__name__ == tag), None)
            if inner is not None:
                del path[place]
        else:
            inner = parts[0]
    return path
