"""What a scene states of a soft organ's capsule, weight and relaxation, as the organ takes it."""

from typing import TYPE_CHECKING

from meshes.base.errors import InputError
from tissue.materials.scene_constants import Materials
from tissue.scene.organ import Organ

if TYPE_CHECKING:
    from tissue.materials.prony import Prony
    from tissue.models.organ.soft_organ import Membrane

__all__ = ["capsule_of", "density_of", "prony_of"]


def capsule_of(organ: Organ, notes: dict[str, str], constants: Materials) -> "Membrane | None":
    """The capsule of the organ's material, where the scene asks for one; it is added to the notes."""
    if not organ.capsule:
        return None
    from tissue.models.organ.soft_organ import Membrane

    table = constants.constants("soft", f"{organ.material}_capsule")
    thickness, young = table["thickness_um"], table["modulus_kPa"]
    notes["capsule"] = (
        f"{thickness.value:g} ({thickness.low:g}-{thickness.high:g}) um of {1e-3 * young.value:g} "
        f"({1e-3 * young.low:g}-{1e-3 * young.high:g}) MPa, confidence {young.confidence}"
    )
    return Membrane(1e-6 * thickness.value, 1e3 * young.value, table["poisson_ratio"].value)


def density_of(organ: Organ, constants: Materials) -> float | None:
    """The density of the organ's material [kg/m3]; None where it does not hang in its own weight."""
    return constants.constants("soft", organ.material)["density_kg_m3"].value if organ.gravity else None


def prony_of(organ: Organ, notes: dict[str, str], constants: Materials) -> "Prony | None":
    """The relaxation of the organ's material, where the scene asks for it.

    Raises
    ------
    InputError
        If the organ's compliance is lazy, or no relaxation is cited for its material.
    """
    if not organ.viscous:
        return None
    if organ.path == "lazy":
        raise InputError("organ.path must not be lazy for a viscous organ, got lazy: use condensed")
    from tissue.materials.prony import Prony

    table = constants.constants("soft", organ.material)
    numbers = [k for k in range(1, 10) if f"prony_g{k}" in table]
    if not numbers:
        raise InputError(f"organ.viscous must be false for {organ.material}, got true: no relaxation is cited for it")
    shares = tuple(table[f"prony_g{k}"].value for k in numbers)
    times = tuple(table[f"prony_tau{k}_s"].value for k in numbers)
    notes["relaxation"] = (
        "; ".join(f"{g:g} in {t:g} s" for g, t in zip(shares, times, strict=True))
        + f"; the modulus is that of the first instant; confidence {table['prony_g1'].confidence}"
    )
    return Prony(shares, times)
