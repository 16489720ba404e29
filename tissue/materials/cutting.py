"""Cutting coefficients, read from ``cutting.toml``."""

from dataclasses import dataclass
from typing import ClassVar

from meshes.base.errors import InputError
from tissue.materials.constants import Constant, constants

__all__ = ["CuttingCoefficients", "cutting_coefficients", "cutting_constants"]

N_MM2 = 1e6  # [Pa]
N_MM = 1e3  # [N/m]


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

    KERNEL_NAMES: ClassVar[dict[str, str]] = {
        "tangential_chip": "tangential_chip_Pa",
        "radial_chip": "radial_chip_Pa",
        "axial_chip": "axial_chip_Pa",
        "tangential_edge": "tangential_edge_N_m",
        "radial_edge": "radial_edge_N_m",
        "axial_edge": "axial_edge_N_m",
    }


def cutting_constants(material: str) -> dict[str, Constant]:
    """Cited cutting constants of a material by their names with units.

    Raises
    ------
    InputError
        If the material is not listed.
    """
    return constants("cutting", material)


def cutting_coefficients(material: str, **changes: float | None) -> CuttingCoefficients:
    """Coefficients of a material in SI; ``changes`` replace single constants, named with their units as in the file.

    Raises
    ------
    InputError
        If the material or a constant's name is not listed.
    """
    values = {name: constant.value for name, constant in cutting_constants(material).items()}
    for name, value in changes.items():
        if name not in values:
            raise InputError(f"cutting must set one of {', '.join(values)}, got {name}: choose a listed name")
        if value is not None:
            values[name] = value
    return CuttingCoefficients(
        tangential_chip_Pa=values["tangential_chip_N_mm2"] * N_MM2,
        radial_chip_Pa=values["radial_chip_N_mm2"] * N_MM2,
        axial_chip_Pa=values["axial_chip_N_mm2"] * N_MM2,
        tangential_edge_N_m=values["tangential_edge_N_mm"] * N_MM,
        radial_edge_N_m=values["radial_edge_N_mm"] * N_MM,
        axial_edge_N_m=values["axial_edge_N_mm"] * N_MM,
        reference_density_kg_m3=values["reference_density_kg_m3"],
        density_exponent=values["density_exponent"],
    )
