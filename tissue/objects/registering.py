"""Checks of a user-defined part before it is registered."""

import inspect
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from itertools import chain
from pathlib import Path
from typing import Any

from meshes.base.errors import InputError
from meshes.base.file_limits import require_regular
from meshes.base.text_tables import read_toml
from tissue.materials.constants import Entry, add_material, constants, listed
from tissue.materials.scene_constants import checked_constant
from tissue.scene.named_parts import nearest, shown
from tissue.scene.registry import CUTTERS, CUTTING_MATERIALS, ORGAN_MATERIALS, SCENES, TABLES

__all__ = [
    "add_materials",
    "callable_part",
    "looks",
    "name",
    "numbers_of",
    "parameters",
    "profile",
    "scene_name",
]

NAME = "[a-z0-9][a-z0-9_-]*"
SOFT = ("modulus_kPa", "poisson_ratio", "density_kg_m3")
"""Constants that every soft material has."""
CAPSULE = "_capsule"
"""End of the name of a capsule, which lies on an organ and is no organ's material."""


def name(kind: str, given: object, *, argument: bool = False) -> None:
    """Refuse a name that is invalid or taken."""
    pattern = f"{NAME}(:[A-Z]+)?" if argument else NAME
    if not isinstance(given, str) or not re.fullmatch(pattern, given):
        raise InputError(
            "name",
            "be of lower-case letters, digits, - and _",
            shown(given),
            f"choose such a one for the {kind}",
        )
    taken = ["none", *(each for table in TABLES[kind] for each in table.known)]
    if given in taken:
        raise InputError(
            "name", f"be none of {', '.join(taken)}", given, f"choose another name for this {kind}"
        )


def callable_part(kind: str, given: str, part: object, methods: Sequence[str] = ()) -> None:
    """Refuse a part that is not callable, or a class without the required methods."""
    if not callable(part):
        raise InputError(
            f"{kind} {given}", "be a class or a function", shown(part), "give what makes one"
        )
    if not isinstance(part, type):
        return
    missing = [method for method in methods if not callable(getattr(part, method, None))]
    if missing:
        raise InputError(
            f"{kind} {given}",
            f"have {' and '.join(methods)}",
            f"{part.__name__} without {' and '.join(missing)}",
            "add what is missing",
        )


def profile(given: str, part: Any, keys: Sequence[str]) -> None:
    """Refuse a half section that cannot be called with a tool's sizes."""
    known = dict.fromkeys(chain.from_iterable(CUTTERS[each].keys for each in CUTTERS.built_in))
    for key in keys:
        if key not in known:
            raise InputError(
                "keys", f"be of {', '.join(sorted(known))}", shown(key), "use one of a tool's keys"
            )
    sizes = ["diameter_m", *(key.replace("_mm", "_m").replace("_deg", "_rad") for key in keys)]
    try:
        inspect.signature(part).bind(**dict.fromkeys(sizes, 1.0))
    except TypeError as error:
        raise InputError(
            f"tool {given}",
            f"take {' and '.join(sizes)}",
            f"one that does not ({error})",
            "name its arguments so",
        ) from None


def parameters(kind: str, given: str, part: object) -> None:
    """Refuse parameters that are no subclass of `Part` whose kind is the name."""
    from tissue.scene.anatomy import Part
    from tissue.scene.part import kinds_of

    if not (isinstance(part, type) and issubclass(part, Part)):
        raise InputError(
            f"parameters of the {kind} {given}",
            "be a subclass of tissue.scene.anatomy.Part",
            shown(part),
            "derive it from that",
        )
    kinds = kinds_of(part) if "kind" in part.model_fields else ()
    if kinds != (given,):
        raise InputError(
            f"{part.__name__}.kind",
            f"be {given}",
            f"{' or '.join(kinds) or 'none'}: write kind",
            f'Literal["{given}"] = "{given}"',
        )


def numbers_of(kind: Any, numbers: Any, *, needed: Sequence[str] = ()) -> dict[str, float]:
    """Return the values of a class of parameters, from an instance or a checked mapping."""
    if isinstance(numbers, kind):
        return asdict(numbers)
    if not isinstance(numbers, Mapping):
        raise InputError(
            "numbers",
            "be a mapping such as {mass_kg: 0.05}",
            shown(numbers),
            "give names and values",
        )
    known = [field.name for field in fields(kind)]
    for each, value in numbers.items():
        if each not in known:
            raise InputError(
                "numbers",
                f"be of {', '.join(known)}",
                f"{each}{nearest(each, known)}",
                "rename or remove it",
            )
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise InputError(each, "be a number", shown(value), "give it in the unit of its name")
    if missing := [each for each in needed if each not in numbers]:
        raise InputError(
            "numbers", f"have {' and '.join(needed)}", f"none for {' and '.join(missing)}", "add it"
        )
    kind(**numbers)
    return dict(numbers)


def looks(colour: str, marker: str) -> None:
    """Refuse a colour or a marker that matplotlib cannot draw."""
    from matplotlib.colors import is_color_like
    from matplotlib.markers import MarkerStyle

    if not is_color_like(colour):
        raise InputError(
            "colour", "be one of matplotlib's", shown(colour), "use for example #0072B2"
        )
    try:
        MarkerStyle(marker)
    except ValueError:
        raise InputError(
            "marker", "be one of matplotlib's", shown(marker), "use for example o"
        ) from None


def scene_name(path: Path) -> str:
    """Return the name in a scene's file; refuse a name that is taken."""
    from tissue.scene.load import library_names

    found = _table(path, "scene").get("name")
    name("scene", found)
    taken = [*library_names(), *SCENES.known]
    if found in taken:
        raise InputError(
            "name",
            f"be none of {', '.join(taken)}",
            f"{found} in {path}",
            "choose another for this scene",
        )
    return str(found)


def add_materials(path: Path) -> tuple[str, ...]:
    """Add the materials of a file: all of them, or none if one is refused."""
    found = _table(path, "material")
    if not found or any(table not in ("cutting", "soft") for table in found):
        raise InputError(
            "material",
            "have tables cutting and soft",
            f"{', '.join(found) or 'none'} in {path}",
            "use these",
        )
    for table, materials in found.items():
        for material, entries in materials.items():
            _require_material(path, table, material, entries)
    for table, materials in found.items():
        for material, entries in materials.items():
            add_material(table, material, entries)
            if not material.endswith(CAPSULE):
                (CUTTING_MATERIALS if table == "cutting" else ORGAN_MATERIALS).add(
                    material, (table, material)
                )
    return tuple(dict.fromkeys(material for materials in found.values() for material in materials))


def _require_material(path: Path, table: str, material: str, entries: dict[str, Entry]) -> None:
    """Refuse a material whose name is taken, or that lacks a constant or its source."""
    where = f"{table}.{material}"
    if not re.fullmatch(NAME, material) or material in listed(table):
        raise InputError(
            table,
            (
                f"name materials other than {', '.join(listed(table))}, in lower-case letters, "
                "digits, - and _"
            ),
            f"{material} in {path}",
            "choose another name",
        )
    needed = tuple(constants("cutting", "bone")) if table == "cutting" else SOFT
    missing = [each for each in needed if each not in entries]
    extra = [each for each in entries if each not in needed] if table == "cutting" else []
    if missing or extra:
        raise InputError(
            where,
            f"have {', '.join(needed)}",
            f"{('none for' if missing else 'also')} {', '.join(missing or extra)} in {path}",
            f"{('add' if missing else 'remove')} it",
        )
    for constant, entry in entries.items():
        checked_constant(f"{where}.{constant}", entry, str(path))


def _table(path: Path, kind: str) -> dict[str, Any]:
    """Read a TOML file."""
    require_regular(path)
    try:
        return read_toml(path.read_text("utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(
            kind, "be a TOML file", f"{path} ({reason})", "check the path and fix it"
        ) from None
