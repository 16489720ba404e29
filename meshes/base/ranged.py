"""Frozen dataclasses of numbers that have a default and a range each."""

from dataclasses import dataclass, field, fields
from typing import Any

from meshes.base.errors import require_range

__all__ = ["Ranged", "ranged"]


def ranged(default: float, lowest: float, highest: float, remedy: str = "") -> Any:
    """Declare a number of a `Ranged` with its default and its closed range."""
    return field(
        default=default, metadata={"range": (lowest, highest, remedy or f"use {default:g}")}
    )


@dataclass(frozen=True)
class Ranged:
    """Base of dataclasses whose numbers are declared by `ranged`.

    Raises
    ------
    InputError
        If a number is not finite or out of its range.
    """

    def __post_init__(self) -> None:
        for each in fields(self):
            require_range(each.name, getattr(self, each.name), *each.metadata["range"])
