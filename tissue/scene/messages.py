"""Error messages for invalid scenes: key, requirement, given value and remedy."""

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import UnionType
from typing import Annotated, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from meshes.base.errors import InputError, enumerated
from meshes.base.hints import closest, did_you_mean
from meshes.base.text_tables import shown, unknown_name
from tissue.materials.scene_constants import TABLES
from tissue.scene.anatomy import Tooth
from tissue.scene.part import LONGEST_PATH, ByKind, Idle, OneOf, entries, kinds_of
from tissue.scene.registry import ANATOMIES
from tissue.scene.scene import OR_NONE, Scene
from tissue.scene.tool import Probe, Tool

BOUNDS = (("gt", "greater than"), ("ge", "at least"), ("lt", "below"), ("le", "at most"))
SEE = "see `tissue scenes NAME`"
Table = Mapping[str, object]
Key = tuple[str, ...]


@dataclass(frozen=True)
class _Place:
    """Location of a key in a scene, with the classes of its table.

    Attributes
    ----------
    names
        Names of the tables that contain the key, the outermost table first, then the name of the
        key.
    table
        Table, as given by the user, that contains the key.
    model
        Class for this table, selected by its ``kind``.
    kinds
        Classes for all kinds of this table.
    field
        Pydantic field of the key; None if `model` does not have the key.
    is_inside
        True if the fault is inside the value of the key, such as in an entry of a list.
    """

    names: Key
    table: Table
    model: type[BaseModel]
    kinds: Sequence[type[BaseModel]]
    field: FieldInfo | None
    is_inside: bool = False

    @classmethod
    def of(cls, location: Sequence[int | str], table: Table, model: type[BaseModel]) -> "_Place":
        """Return the location of a key, from the location of a fault that pydantic found.

        Names of classes and types in the location of the fault are skipped.
        """
        names: Key = ()
        kinds: Sequence[type[BaseModel]] = (model,)
        field = None
        steps = list(location)
        while steps:
            names += (str(steps.pop(0)),)
            field = model.model_fields.get(names[-1])
            below = [] if field is None else _parts(field)
            if steps and steps[0] in [part.__name__ for part in below]:
                del steps[0]
            if field is None or not below:
                break
            if steps:
                table = _inner(table, names[-1])
                kinds = below
                model = _chosen(field, table)
        values = None if field is None else _values(field)
        if values is not None and steps:
            table = _inner(table, names[-1])
            names += (str(steps.pop(0)),)
            field = values
        is_inside = bool(steps) and isinstance(steps[0], int)
        return cls(names, table, model, kinds, field, is_inside)

    @property
    def key(self) -> str:
        """Dotted key."""
        return ".".join(map(shown, self.names))

    @property
    def value(self) -> object:
        """Value that the user gave; None for a missing key."""
        return self.table.get(self.names[-1])

    @property
    def holders(self) -> list[type[BaseModel]]:
        """Classes in `kinds` that have the key."""
        return [part for part in self.kinds if self.names[-1] in part.model_fields]


def error_of(fault: ErrorDetails, table: Table, model: type[BaseModel] = Scene) -> InputError:
    """Convert a fault of a table, found by pydantic, to an error with a message for users."""
    place = _Place.of(fault["loc"], table, model)
    key = place.key
    kind = str(fault["type"])
    context = fault.get("ctx", {})
    if isinstance(error := context.get("error"), InputError):
        if kind == "unknown_name" and error.requirement:
            error.argument = key
        return error
    if kind == "value_error":  # raised by the validator of a registered part
        return InputError(str(error))
    if kind == "idle_keys":
        return _idle_error(place.names, context["refused"])
    if kind in ("extra_forbidden", "invalid_key"):
        return _unknown_key(place, table, model)
    if place.names == ("device", "kind") and kind == "missing":
        given = [f"{name} = {shown(value)}" for name, value in entries(place.table)]
        return InputError(
            f"device must be given for {', '.join(given) or 'a table [device]'}. Set "
            "device = touch, or remove the table [device]"
        )
    field = place.field
    assert field is not None
    if kind == "missing" and not place.is_inside:
        return InputError(key, "be given", "nothing", _addition(place.names, field))
    if kind == "union_tag_not_found":
        known = dict.fromkeys(each for part in _parts(field) for each in kinds_of(part))
        return InputError(f"{key}.kind", "be given", "nothing", f"use {enumerated(known, 'or')}")
    if kind == "union_tag_invalid" and isinstance(place.value, Mapping):
        choices = list(dict.fromkeys(each for part in _parts(field) for each in kinds_of(part)))
        return unknown_name(f"{key}.kind", choices, place.value.get("kind"))
    # The fault of one entry of a list: the user sees the whole list.
    got = place.value if place.is_inside else fault["input"]
    choices = choices_of(field)
    # A key that takes a number or a name, such as auto, states both.
    is_number = _alternatives(field.annotation)[0] in (int, float)
    if choices and not is_number:
        return unknown_name(key, choices, got)
    wanted = " or ".join((_requirement(field, kind, place.is_inside), *choices))
    remedy = _corrected(key, got, kind, is_number=is_number) or _remedy(field)
    if is_number and got in NOTHING and not field.is_required():
        remedy += (
            ", or remove the key from the scene file to use its default. If --set changes a "
            "kind or a law, keys that then have no effect are removed automatically"
        )
    if is_number and kind == "less_than_equal" and got == fault["input"]:
        remedy = f"use {context['le']:g} or less"
    elif is_number and kind.startswith(("greater_than", "less_than")):
        remedy = remedy.replace("use a value", "use a value in this range,")
    # a value that is too small may be in metres
    if key.endswith("_mm") and kind.startswith("greater_than"):
        remedy += ", in mm"
    return InputError(key, f"be {wanted}", _shown(got), remedy)


def _idle_error(names: tuple[str, ...], refused: Mapping[str, tuple[object, Idle]]) -> InputError:
    """Return the error for keys without effect.

    The message contains all keys that have no effect for the same reason as the first key.
    """
    first = next(iter(refused.values()))[1]
    given = {
        ".".join((*names, key)): value for key, (value, why) in refused.items() if why == first
    }
    got = ", ".join(shown(value) for value in given.values())
    remove = f"remove {' and '.join(given)}"
    wanted = f"be left out {first.where}"
    return InputError(" and ".join(given), wanted, got, f"{first.remedy}, or {remove}")


def _unknown_key(place: _Place, table: Table, model: type[BaseModel]) -> InputError:
    """Return the error for a key that its table does not have with the chosen kind.

    The message suggests similar keys of this table, of this table with another kind, or of another
    table.
    """
    names = place.names
    if place.holders:
        return _of_another_kind(place, place, table)
    if len(names) == 1 and names[0] in TABLES:
        constant = next((key for key, _ in entries({names[0]: place.value})), names[0])
        return InputError(
            f"{constant} is not a known key of a scene. Write constants into a TOML file, and "
            'name this file by the key materials: materials = "FILE.toml"'
        )
    keys = dict(_keys(table, model, present=names[:-1]))
    meant = _meant(names, keys)
    if meant and not keys.get(meant[0], True):
        other = _Place.of(meant[0], table, model)
        # A misspelt key does not mean that the user wants another kind of tool or tissue.
        if names[0] not in ("tool", "anatomy") or _source(other.model):
            return _of_another_kind(place, other, table)
        meant = []
    known = list(place.model.model_fields)
    if isinstance(place.value, Mapping):
        meant = [(*names[:-1], name) for name in closest(names[-1], known)]
    if meant and meant[0][:-1] != names[:-1]:
        suggested = did_you_mean([".".join(full) for full in meant])
        listed = ""
    else:
        suggested = did_you_mean([full[-1] for full in meant])
        listed = f" {_owner(place, model)} has the keys {enumerated(known)}."
    remedy = _of_density(names, table) or f"Rename or remove {place.key}"
    return InputError(f"{place.key} is not a known key{suggested}.{listed} {remedy}")


def _owner(place: _Place, model: type[BaseModel]) -> str:
    """Return a description of the table that contains a key, for the start of a sentence."""
    if len(place.names) == 1:
        return "A scene" if model is Scene else "This table"
    part = f"The table [{'.'.join(map(shown, place.names[:-1]))}]"
    if "kind" not in place.model.model_fields or len(kinds_of(place.model)) != 1:
        return part
    return f"{part} of kind {kinds_of(place.model)[0]}"


def _of_density(names: Key, table: Table) -> str:
    """Return advice on a density key of a bone with `density_file`, else an empty text."""
    has_image = "density_file" in _inner(table, "anatomy")
    if has_image and names[0] == "anatomy" and "density" in names[-1]:
        return (
            "Import the CT again with --density line:SLOPE,OFFSET to scale its density, or "
            "remove the key"
        )
    return ""


def _meant(names: Key, keys: Mapping[Key, bool]) -> list[Key]:
    """Return the keys that a user most likely meant by an unknown key, best first.

    Keys that the tables of the scene have are preferred to keys that they would have with another
    kind. Keys in the table of the unknown key come first. An unknown key without a table may belong
    to any table.

    Parameters
    ----------
    names
        The unknown key.
    keys
        Candidates; True for a key that the tables of the scene have, False for a key that they
        would have with another kind.
    """
    near = [full for full in keys if full[:-1] == names[:-1]]
    far = [full for full in keys if full[:-1] != names[:-1]]
    for pool in ([*near, *far],) if len(names) == 1 else (near, far):
        by_name: dict[str, list[Key]] = {}
        for full in pool:
            by_name.setdefault(full[-1], []).append(full)
        found = [full for name in closest(names[-1], by_name) for full in by_name[name]]
        if found:
            return [full for full in found if keys[full]] or found
    return []


def _keys(
    table: Table, model: type[BaseModel], inside: Key = (), *, present: Key = ()
) -> Iterator[tuple[Key, bool]]:
    """Yield the keys of all tables, each with True if its table has the key with the chosen kind.

    Keys that a table would have with another kind are yielded only for the table `present` and for
    the motion.
    """
    for name, field in model.model_fields.items():
        full = (*inside, name)
        parts = _parts(field)
        if not parts:
            yield full, True
            continue
        inner = _inner(table, name)
        chosen = _chosen(field, inner)
        yield from _keys(inner, chosen, full, present=present)
        for part in parts:
            if full == present or hasattr(part, "drive"):
                new = part.model_fields.keys() - chosen.model_fields.keys()
                yield from (((*full, key), False) for key in part.model_fields if key in new)


def _of_another_kind(given: _Place, meant: _Place, table: Table) -> InputError:
    """Return the error for a key that its table would have only with another kind.

    Parameters
    ----------
    given
        Key that the user wrote.
    meant
        Key that the user probably meant.
    table
        The table of the scene.
    """
    part = ".".join(meant.names[:-1])
    others = meant.holders
    chosen = meant.model
    kind = kinds_of(chosen)[0]
    where = f"a {kind}"
    remedy = f"set {part}.kind = {kinds_of(others[0])[0]}"
    own = [f"{part}.{name}" for name in closest(given.names[-1], chosen.model_fields)]
    if own and part in ("tool", "anatomy"):
        wanted = f"be left out for {where}{did_you_mean(own)}"
        return InputError(given.key, wanted, shown(given.value), f"rename or remove {given.key}")
    if part == "tool":
        family = next((base for base in (Tool, Probe) if issubclass(chosen, base)), chosen)
        alike = [each for each in others if issubclass(each, family)]
        keys = enumerated([each for each in chosen.model_fields if each != "kind"], "or")
        remedy = f"use a key of {where} ({keys})"
        if alike:
            remedy = f"set tool.kind = {kinds_of(alike[0])[0]}"
    if part == "anatomy":
        usable = [each for each in others if _tool_of(each) is _tool_of(chosen)]
        if usable:
            remedy = f"set anatomy.kind = {kinds_of(usable[0])[0]}"
        elif _tool_of(chosen) not in (Tool, Probe):
            return _of_another_tool(given, table, chosen)
        if issubclass(chosen, Tooth):
            # A user who wants a tooth wants no other anatomy.
            remedy = ""
    sources = [_source(other) for other in others if set(kinds_of(other)) & set(kinds_of(chosen))]
    if sources and _source(chosen) == "procedural":
        where = f"a procedural {kind}"
        remedy = f"set {part}.file"
    elif sources:
        where = f"a {kind} {_source(chosen)}"
        is_plain = "procedural" in sources
        remedy = f"use a {kind} {'without a file' if is_plain else ' or '.join(sources)}"
    elif meant.names[-1] == getattr(others[0], "drive", "") and hasattr(chosen, "drive"):
        remedy = f"use {part}.{chosen.drive} instead, or {remedy}"
    hint = did_you_mean([meant.key]) if given != meant else ""
    remedy = _of_density(given.names, table) or (
        f"{remedy}, or remove {given.key}" if remedy else f"remove {given.key}"
    )
    wanted = f"be left out for {where}{hint}"
    return InputError(given.key, wanted, shown(given.value), remedy)


def _of_another_tool(place: _Place, table: Table, chosen: type[BaseModel]) -> InputError:
    """Return the error for a key of an anatomy that the tool of the scene cannot work on.

    `chosen` is the class of the scene's anatomy. If the tool cannot work on this anatomy either,
    the message suggests the first anatomy that the tool can work on.
    """
    tool = kinds_of(_tool_of(chosen))[0]
    anatomy = kinds_of(chosen)[0]
    written = _inner(table, "tool").get("kind")
    if written not in kinds_of(_tool_of(chosen)):
        for kind in ANATOMIES.known:
            if written in kinds_of(ANATOMIES[kind].tool):
                tool = written
                anatomy = kind
                break
    return InputError(
        place.key,
        f"be left out for a {tool}",
        shown(place.value),
        f"a {tool} needs anatomy.kind = {anatomy}. Remove {place.key}, or press a shaped "
        "organ with a probe: anatomy.kind = liver and tool.kind = sphere-probe",
    )


def _tool_of(anatomy: type[BaseModel]) -> type[BaseModel]:
    """Return the class of the tools that can work on an anatomy."""
    return ANATOMIES[kinds_of(anatomy)[0]].tool


def _source(part: type[BaseModel]) -> str:
    """Return the source of the shape of a table class, such as ``procedural``."""
    return str(getattr(part, "source", ""))


def idle_keys(fault: ErrorDetails, table: Table) -> list[str]:
    """Return the dotted names of the ineffective keys that a pydantic fault reports."""
    place = _Place.of(fault["loc"], table, Scene)
    if fault["type"] == "idle_keys":
        return [".".join((*place.names, key)) for key in fault["ctx"]["refused"]]
    if fault["type"] == "extra_forbidden" and place.holders:
        return [".".join(place.names)]
    return []


def _shown(value: object) -> str:
    """Return an invalid value as text.

    Quotes and decimal point are kept, because they may be the fault.
    """
    if isinstance(value, float) and value.is_integer():
        return repr(value)
    return f'"{shown(value)}"' if isinstance(value, str) and value[:1].isdigit() else shown(value)


def choices_of(field: FieldInfo) -> list[str]:
    """Return the names that a field accepts; empty if the field accepts other kinds of values."""
    literals = [part for part in _alternatives(field.annotation) if get_origin(part) is Literal]
    named = [name for each in field.metadata if isinstance(each, OneOf) for name in each.names]
    return named or [str(choice) for part in literals for choice in get_args(part)]


def _requirement(field: FieldInfo, kind: str, inside: bool) -> str:
    """Return a text that describes the values that a field accepts."""
    part = _alternatives(field.annotation)[0]
    bounds = _bounds([*field.metadata, *_limits(field.annotation)])
    if part in (int, float):
        if bounds and kind not in ("float_type", "int_type"):
            return bounds
        noun = "a finite number" if kind == "finite_number" else "a number"
        noun = "a whole number" if part is int else noun
        return f"{noun} {'of ' * bounds.startswith('at')}{bounds}".strip()
    if part is bool:
        return "true or false"
    if part is str:
        if kind == "string_too_long":
            return f"a path of at most {LONGEST_PATH} characters"
        is_pattern = kind == "string_pattern_mismatch"
        return "lower-case letters, digits, - and _" if is_pattern else "text"
    if get_origin(part) is tuple:
        if get_args(part)[0] is str:
            return "a list of names"
        if get_args(part)[-1] is Ellipsis:
            return "a list of at least two points [x, y, z]"
        limits = _bounds(getattr(get_args(part)[0], "__metadata__", ()))
        return f"three finite numbers [x, y, z]{', each ' if limits else ''}{limits}"
    if (values := _values(field)) is not None:
        return f"a table of names and numbers {_bounds(values.metadata)}"
    keys = enumerated([*_parts(field)[0].model_fields][:3])
    return f"{'none or ' * (OR_NONE in field.metadata)}a table with keys such as {keys}"


def _bounds(metadata: Iterable[object]) -> str:
    """Return the limits of a number, from the annotations of a field, as text."""
    flat = [
        inner
        for each in metadata
        for inner in (each.metadata if isinstance(each, FieldInfo) else [each])
    ]
    words = [
        f"{word} {shown(getattr(limit, name))}"
        for name, word in BOUNDS
        for limit in flat
        if hasattr(limit, name)
    ]
    return " and ".join(words)


MEASURE = re.compile(r"([-+]?\d*\.?\d+(?:[eE][-+]?\d+)?)\s*([^\s\d]+)")
"""Regular expression for a number with a unit, such as 22mm."""


def _corrected(key: str, got: object, kind: str, *, is_number: bool) -> str:
    """Return an instruction with the user's value corrected; empty if no correction is obvious.

    For example, the unit is removed from ``22mm`` if the key takes a number.
    """
    if not isinstance(got, str):
        return ""
    if key == "name" and kind == "string_pattern_mismatch":
        plain = re.sub("[^a-z0-9_-]+", "-", got.lower()).strip("-_")
        return f'use "{plain}"' if plain else ""
    found = MEASURE.fullmatch(got)
    if is_number and found is not None and key.endswith(f"_{found[2].replace('/', '_')}"):
        return f"use {found[1]}, because the key states the unit"
    return ""


def _remedy(field: FieldInfo) -> str:
    """Return an instruction with a valid value: an example or the default of the field."""
    value = field.examples[0] if field.examples else field.default
    if value == "":
        return "put it in quotes"
    return f"use a value such as {_toml(value)}" if isinstance(value, FITTING) else SEE


def _addition(names: tuple[str, ...], field: FieldInfo) -> str:
    """Return an instruction to add a missing entry."""
    if field.examples:
        return f"add it, for example {names[-1]} = {_toml(field.examples[0])}"
    table = f"the table [{'.'.join(names)}]"
    return f"add {table if _parts(field) else names[-1]}, {SEE}"


NOTHING = ("", "none", "None", "null")
"""Values that users write to remove the value of a key."""
FITTING = (str, int, float, list, tuple, Mapping)
"""Types of values that can be written into an instruction for the user."""


def _toml(value: object) -> str:
    """Return a value in the form of a scene file."""
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{name} = {shown(each)}' for name, each in value.items())} }}"
    if isinstance(value, tuple) and all(isinstance(each, str) for each in value):
        return f"[{', '.join(map(_toml, value))}]"
    return f'"{value}"' if isinstance(value, str) else shown(value)


def _values(field: FieldInfo) -> FieldInfo | None:
    """Return a field for the values of a field that is a mapping; None for other fields."""
    part = _alternatives(field.annotation)[0]
    return FieldInfo.from_annotation(get_args(part)[1]) if get_origin(part) is dict else None


def _chosen(field: FieldInfo, table: Table) -> type[BaseModel]:
    """Return the class for a table, selected by its kind; for an unknown kind, the first class."""
    mark = _by_kind(field)
    return (mark and mark.chosen(table)) or _parts(field)[0]


def _by_kind(field: FieldInfo) -> ByKind | None:
    """Return the `ByKind` annotation of a field, or None."""
    return next((each for each in field.metadata if isinstance(each, ByKind)), None)


def _parts(field: FieldInfo) -> list[type[BaseModel]]:
    """Return the table classes that a field accepts; empty if the field is no table."""
    mark = _by_kind(field)
    if mark is not None:
        return list(mark.parts())
    return [
        p
        for p in _alternatives(field.annotation)
        if isinstance(p, type) and issubclass(p, BaseModel)
    ]


def _alternatives(annotation: object) -> list[object]:
    """Return the types that an annotation allows, except None."""
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
    """Return the limits in an annotation that apply to only one of its types."""
    return [limit for each in get_args(annotation) for limit in getattr(each, "__metadata__", ())]


def _inner(table: Table, name: str) -> Table:
    inner = table.get(name, {})
    return inner if isinstance(inner, Mapping) else {}
