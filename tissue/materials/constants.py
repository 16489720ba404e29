"""Cited material constants from the data files of this package, and cutting coefficients."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import ClassVar, TypedDict

from meshes.base.errors import InputError

__all__ = [
    "CUT_AS",
    "Constant",
    "CuttingCoefficients",
    "Entry",
    "add_material",
    "changed_coefficients",
    "constants",
    "cutting_coefficients",
    "listed",
    "remove_material",
]

N_MM2 = 1e6  # [Pa]
N_MM = 1e3  # [N/m]
CUT_AS = {
    "enamel": "enamel",
    "dentin": "dentin",
    "caries": "dentin",
    "pulp": "soft",
    "ligament": "soft",
}
"""Material that provides the cutting coefficients of a tooth layer; other layers use bone."""


@dataclass(frozen=True)
class Constant:
    """Cited constant with value, plausible range and source, in the unit of its name."""

    value: float
    low: float
    high: float
    source: str
    confidence: str


class Entry(TypedDict):
    """Cited constant in the layout of a file."""

    value: float
    range: list[float]
    source: str
    confidence: str


@dataclass(frozen=True)
class CuttingCoefficients:
    """Mechanistic cutting coefficients of a material: chip in [Pa], edge in [N/m]."""

    tangential_chip_Pa: float
    radial_chip_Pa: float
    axial_chip_Pa: float
    tangential_edge_N_m: float
    radial_edge_N_m: float
    axial_edge_N_m: float
    reference_density_kg_m3: float
    density_exponent: float

    CHIP: ClassVar[tuple[str, ...]] = "tangential_chip_Pa", "radial_chip_Pa", "axial_chip_Pa"
    EDGE: ClassVar[tuple[str, ...]] = "tangential_edge_N_m", "radial_edge_N_m", "axial_edge_N_m"


@cache
def constants(table: str, material: str) -> dict[str, Constant]:
    """Return the constants of a material in ``table.toml``, by their names with units.

    Raises
    ------
    InputError
        If the material is not listed.
    """
    entries = _table(table)
    if material not in entries:
        raise InputError(
            "material", f"be one of {', '.join(entries)}", material, "choose a listed one"
        )
    return {
        name: Constant(
            entry["value"],
            entry["range"][0],
            entry["range"][1],
            entry["source"],
            entry["confidence"],
        )
        for name, entry in entries[material].items()
    }


def listed(table: str) -> tuple[str, ...]:
    """Return the materials of ``table.toml``, in the order of the file."""
    return tuple(_table(table))


def add_material(table: str, material: str, entries: dict[str, Entry]) -> None:
    """Add a material to the table of ``table.toml``, until the process ends.

    Raises
    ------
    InputError
        If its name is taken.
    """
    known = _table(table)
    if material in known:
        raise InputError(
            "material", f"be none of {', '.join(known)}", material, "choose another name"
        )
    known[material] = entries


def remove_material(table: str, material: str) -> None:
    """Remove a material that was added."""
    del _table(table)[material]
    constants.cache_clear()


@cache
def _table(table: str) -> dict[str, dict[str, Entry]]:
    return tomllib.loads(files("tissue.materials").joinpath(f"{table}.toml").read_text("utf-8"))


def cutting_coefficients(material: str, **changes: float | None) -> CuttingCoefficients:
    """Return the cutting coefficients of a material in SI units.

    ``changes`` replace single constants, named with their units as in the file.

    Raises
    ------
    InputError
        If the material or a constant's name is not listed.
    """
    return changed_coefficients(constants("cutting", material), changes)


def changed_coefficients(
    cited: Mapping[str, Constant], changes: Mapping[str, float | None]
) -> CuttingCoefficients:
    """Return the cutting coefficients of cutting constants in SI units.

    ``changes`` replace single constants.

    Raises
    ------
    InputError
        If a change names no constant.
    """
    values = {name: constant.value for name, constant in cited.items()}
    for name, value in changes.items():
        if name not in values:
            raise InputError(
                "cutting", f"set one of {', '.join(values)}", name, "choose a listed name"
            )
        if value is not None:
            values[name] = value
    chip, edge = (
        [unit * values[f"{side}_{name}"] for side in ("tangential", "radial", "axial")]
        for name, unit in (("chip_N_mm2", N_MM2), ("edge_N_mm", N_MM))
    )
    return CuttingCoefficients(
        *chip, *edge, values["reference_density_kg_m3"], values["density_exponent"]
    )
