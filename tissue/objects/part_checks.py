"""Checks of arguments, and of classes and functions that users register as parts of scenes."""

import inspect
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from itertools import chain
from numbers import Real
from typing import Any

from meshes.base.errors import PRESENT, InputError, enumerated
from meshes.base.hints import nearest
from meshes.base.text_tables import shown
from tissue.scene.registry import CUTTERS, TABLES

NAME = "[a-z0-9][a-z0-9_-]*"
"""Pattern of the name under which a part, such as a tool or a device, can be registered."""


def leave_out(given: Mapping[str, object], when: str, *, remedy: str = "remove it") -> None:
    """Raise an error if an argument is given that would have no effect."""
    for name, value in given.items():
        if value is not None:
            raise InputError(name, f"be left out {when}", PRESENT, remedy)


def check_name(kind: str, given: object, *, argument: bool = False) -> None:
    """Raise an error if a name is invalid or already in use."""
    pattern = f"{NAME}(:[A-Z]+)?" if argument else NAME
    if not isinstance(given, str) or not re.fullmatch(pattern, given):
        raise InputError(
            "name",
            "contain only lower-case letters, digits, - and _",
            shown(given),
            f"choose such a name for the {kind}",
        )
    taken = ["none", *(each for table in TABLES[kind] for each in table.known)]
    if given in taken:
        raise InputError(
            "name",
            f"not be one of {', '.join(taken)}",
            given,
            f"choose another name for this {kind}",
        )


def check_callable(kind: str, given: str, part: object, methods: Sequence[str] = ()) -> None:
    """Raise an error if a part is not callable, or is a class that lacks a required method."""
    if not callable(part):
        raise InputError(
            f"{kind} {given}",
            "be a class or a function",
            shown(part),
            f"give the class or function that makes the {kind}",
        )
    if not isinstance(part, type):
        return
    missing = [method for method in methods if not callable(getattr(part, method, None))]
    if missing:
        raise InputError(
            f"{kind} {given}",
            f"have the methods {enumerated(methods)}",
            f"{part.__name__} without {enumerated(missing)}",
            f"add {enumerated(missing)}",
        )


def check_profile(given: str, part: Any, keys: Sequence[str]) -> None:
    """Raise an error if a tool's profile function does not accept the tool's sizes as arguments."""
    known = dict.fromkeys(chain.from_iterable(CUTTERS[each].keys for each in CUTTERS.built_in))
    for key in keys:
        if key not in known:
            raise InputError(
                "keys",
                f"contain only {enumerated(sorted(known))}",
                shown(key),
                "choose among these keys",
            )
    sizes = ["diameter_m", *(key.replace("_mm", "_m").replace("_deg", "_rad") for key in keys)]
    try:
        inspect.signature(part).bind(**dict.fromkeys(sizes, 1.0))
    except TypeError as error:
        raise InputError(
            f"tool {given}",
            f"accept the arguments {enumerated(sizes)}",
            f"a function with other arguments ({error})",
            "rename its arguments",
        ) from None


def check_parameters(kind: str, given: str, part: Any) -> None:
    """Raise an error if a class is no subclass of `Part`, or if its `kind` is not `given`."""
    from tissue.scene.anatomy import Part
    from tissue.scene.part import kinds_of

    is_part = isinstance(part, type) and issubclass(part, Part)
    if not is_part or "kind" not in part.model_fields or kinds_of(part) != (given,):
        raise InputError(
            f"parameters of the {kind} {given}",
            f"be a subclass of tissue.scene.anatomy.Part with the kind {given}",
            shown(part),
            f'derive the class from Part, with the field kind: Literal["{given}"] = "{given}"',
        )


def checked_numbers(
    kind: Any, numbers: Any, *, needed: Sequence[str] = (), of: str = "numbers"
) -> dict[str, float]:
    """Return the values of `numbers` as a dict; a mapping is validated against `kind` first."""
    if isinstance(numbers, kind):
        return asdict(numbers)
    if not isinstance(numbers, Mapping):
        entries = enumerated(needed) or "names and numbers"
        wanted = f"be {kind.__name__} or a mapping with {entries}"
        raise InputError(of, wanted, shown(numbers), "give a dict of names and values")
    known = [field.name for field in fields(kind)]
    if strange := [each for each in numbers if each not in known]:
        given = f"the entry {shown(strange[0])}{nearest(str(strange[0]), known)}"
        raise InputError(
            of, f"have only the entries {enumerated(known)}", given, "rename or remove it"
        )
    if missing := [each for each in needed if each not in numbers]:
        lacking = enumerated(missing)
        raise InputError(
            of,
            f"have the entries {enumerated(needed)}",
            f"no value for {lacking}",
            f"add {lacking}",
        )
    for each, value in numbers.items():
        if isinstance(value, bool) or not isinstance(value, Real):
            raise InputError(
                each, "be a number", shown(value), "give it in the unit that its name states"
            )
    kind(**numbers)
    return {name: float(value) for name, value in numbers.items()}
