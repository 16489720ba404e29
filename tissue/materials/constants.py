"""Cited constants, read from the data files next to this one."""

import tomllib
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

from meshes.base.errors import InputError

__all__ = ["Constant", "constants", "listed"]


@dataclass(frozen=True)
class Constant:
    """A cited number: value, plausible range and source, in the unit of its name."""

    value: float
    low: float
    high: float
    source: str
    confidence: str


@cache
def constants(table: str, material: str) -> dict[str, Constant]:
    """Constants of a material in ``table.toml``, by their names with units.

    Raises
    ------
    InputError
        If the material is not listed.
    """
    entries = _table(table)
    if material not in entries:
        raise InputError(f"material must be one of {', '.join(entries)}, got {material}: choose a listed one")
    return {
        name: Constant(entry["value"], entry["range"][0], entry["range"][1], entry["source"], entry["confidence"])
        for name, entry in entries[material].items()
    }


def listed(table: str) -> tuple[str, ...]:
    """Materials of ``table.toml``, in its order."""
    return tuple(_table(table))


@cache
def _table(table: str) -> dict[str, dict[str, Any]]:
    return tomllib.loads(files("tissue.materials").joinpath(f"{table}.toml").read_text("utf-8"))
