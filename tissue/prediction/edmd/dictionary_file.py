"""Dictionaries of observables as plain values, for files."""

from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any

from meshes.base.errors import InputError
from tissue.prediction.edmd.dictionary import Delays, Dictionary, DictionarySum, Identity
from tissue.prediction.edmd.gap_products import GapProducts
from tissue.prediction.edmd.overlaps import Overlaps
from tissue.prediction.edmd.polynomials import Polynomials
from tissue.prediction.edmd.radial import Gaussians, ThinPlates

__all__ = ["from_plain", "to_plain"]


def to_plain(dictionary: Dictionary) -> dict[str, Any]:
    """The dictionary as names, numbers and lists, for a file."""
    plain: dict[str, Any] = {"kind": type(dictionary).__name__}
    for field in fields(dictionary):  # type: ignore[arg-type]
        value = getattr(dictionary, field.name)
        if isinstance(value, Dictionary):
            value = to_plain(value)
        elif value and isinstance(value, tuple) and isinstance(value[0], Dictionary):
            value = [to_plain(part) for part in value]
        plain[field.name] = value
    return plain


def from_plain(plain: Mapping[str, Any]) -> Dictionary:
    """The dictionary that `to_plain` described.

    Raises
    ------
    InputError
        If the kind or one of its fields is unknown, or a value cannot be used.
    """
    known = (Identity, Polynomials, Gaussians, ThinPlates, GapProducts, Overlaps, DictionarySum, Delays)
    kinds: dict[Any, Callable[..., Dictionary]] = {kind.__name__: kind for kind in known}
    given = dict(plain)
    kind = given.pop("kind", None)
    if kind not in kinds:
        raise InputError(f"kind must be one of {', '.join(kinds)}, got {kind}: train the predictor again")
    try:
        return kinds[kind](**{name: _frozen(value) for name, value in given.items()})
    except TypeError as problem:
        raise InputError(f"{kind} must have the fields of this version, got {problem}: train it again") from None


def _frozen(value: Any) -> Any:
    """Lists as tuples, descriptions as dictionaries of observables."""
    if isinstance(value, Mapping):
        return from_plain(value)
    return tuple(_frozen(each) for each in value) if isinstance(value, list) else value
