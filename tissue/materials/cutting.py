"""Cutting coefficients of the layers of a bone or a tooth, see `tissue.materials.constants`."""

from collections.abc import Mapping

from tissue.materials.constants import CuttingCoefficients, constants, cutting_coefficients

__all__ = ["CUT_AS", "CuttingCoefficients", "coefficients_of", "cutting_coefficients", "energy_note"]

CUT_AS = {"enamel": "enamel", "dentin": "dentin", "caries": "dentin", "pulp": "soft", "ligament": "soft"}
"""Material whose cutting coefficients a layer has; all others have those of bone."""


def coefficients_of(
    layer_names: tuple[str, ...], changes: Mapping[str, float | None], *, bone: str = "bone"
) -> tuple[CuttingCoefficients, ...]:
    """Cutting coefficients of layers.

    Parameters
    ----------
    layer_names
        Enamel, dentin, caries, pulp and ligament are cut as such, all others as `bone`.
    changes
        Single constants in place of the cited ones, in all layers.
    bone
        Material of bone.

    Raises
    ------
    InputError
        If there is no such material, or a change names no constant.
    """
    return tuple(cutting_coefficients(CUT_AS.get(name, bone), **changes) for name in layer_names)


def energy_note(layer_names: tuple[str, ...], *, bone: str = "bone") -> str:
    """The cited tangential chip coefficient of the material of each layer, which is its specific energy."""
    remarks = []
    for material in sorted({CUT_AS.get(name, bone) for name in layer_names}):
        energy = constants("cutting", material)["tangential_chip_N_mm2"]
        remarks.append(
            f"{material} {1e-3 * energy.value:g} ({1e-3 * energy.low:g}-{1e-3 * energy.high:g}) J/mm3, "
            f"confidence {energy.confidence}"
        )
    return "; ".join(remarks)
