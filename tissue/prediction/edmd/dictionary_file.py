"""Dictionaries of observables as plain values, for files."""

from collections.abc import Callable, Mapping
from dataclasses import fields

from meshes.base.errors import InputError
from tissue.prediction.edmd.dictionary import Delays, Dictionary, Identity
from tissue.prediction.edmd.gap_products import GapProducts
from tissue.prediction.edmd.overlaps import Overlaps
from tissue.prediction.edmd.polynomials import Polynomials
from tissue.prediction.edmd.radial import Gaussians, ThinPlates

__all__ = ["from_plain", "to_plain"]

KINDS: dict[object, Callable[..., Dictionary]] = {
    kind.__name__: kind for kind in (Identity, Polynomials, Gaussians, ThinPlates, GapProducts, Overlaps, Delays)
}


def to_plain(dictionary: Dictionary) -> dict[str, object]:
    """The dictionary as names, numbers and lists, for a file."""
    given = {field.name: getattr(dictionary, field.name) for field in fields(dictionary)}  # type: ignore[arg-type]
    plain = {name: to_plain(value) if isinstance(value, Dictionary) else value for name, value in given.items()}
    return {"kind": type(dictionary).__name__} | plain


def from_plain(plain: Mapping[str, object]) -> Dictionary:
    """The dictionary that `to_plain` described; empty lists are left at their defaults.

    Raises
    ------
    InputError
        If the kind or one of its fields is unknown, or a value cannot be used.
    """
    given = {name: _frozen(value) for name, value in plain.items() if value != []}
    kind = given.pop("kind", None)
    if kind not in KINDS:
        raise InputError(f"kind must be one of {', '.join(map(str, KINDS))}, got {kind}: train the predictor again")
    try:
        return KINDS[kind](**given)
    except TypeError as problem:
        raise InputError(f"{kind} must have the fields of this version, got {problem}: train it again") from None


def _frozen(value: object) -> object:
    """Lists as tuples, descriptions as dictionaries of observables."""
    if isinstance(value, Mapping):
        return from_plain(value)
    return tuple(_frozen(each) for each in value) if isinstance(value, list) else value
