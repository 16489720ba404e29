"""What a run notes of its specific cutting energy."""

from pathlib import Path

from tissue.materials.cutting import CUT_AS
from tissue.materials.scene_constants import Materials

__all__ = ["energy_note"]

NAME = "tangential_chip_N_mm2"


def energy_note(
    layer_names: tuple[str, ...], constants: Materials, *, bone: str = "bone", stated: float | None = None
) -> str:
    """The tangential chip coefficient in effect in each layer, which is its specific energy, with range and origin.

    Parameters
    ----------
    layer_names
        Layers that are there.
    constants
        Of the scene.
    bone
        Material of bone.
    stated
        What the scene states in place of all of them [N/mm2].
    """
    if stated is not None:
        return f"{1e-3 * stated:g} J/mm3, as the scene states"
    remarks = []
    for layer in layer_names:
        material = CUT_AS.get(layer, bone)
        energy = constants.layer_constants(layer, bone=bone)[NAME]
        known = [name for name in (layer, material) if f"cutting.{name}.{NAME}" in constants.given]
        origin = f" of {Path(constants.file).name}" if known else ""
        remarks.append(
            f"{[*known, material][0]} {1e-3 * energy.value:g} ({1e-3 * energy.low:g}-{1e-3 * energy.high:g}) J/mm3"
            f"{origin}, confidence {energy.confidence}"
        )
    return "; ".join(sorted(set(remarks)))
