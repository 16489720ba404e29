"""What a scene's own file of constants does in it: every entry must have an effect, or be named in the run's notes."""

from collections.abc import Sequence
from pathlib import Path

from meshes.base.errors import InputError
from meshes.surfaces.glenoid import GLENOID_LAYERS
from meshes.tooth.layers import TOOTH_LAYERS
from meshes.vertebra.lumbar import VERTEBRA_LAYERS
from tissue.materials.constants import listed
from tissue.scene.named_parts import nearest, shown
from tissue.scene.scene import Scene
from tissue.scene.used_constants import used_constants

__all__ = ["note_own_constants"]

LAYERS = (*GLENOID_LAYERS, *VERTEBRA_LAYERS, *TOOTH_LAYERS)
"""Layers of anatomies that are built in; a file may hold constants of one that a scene does not have."""


def note_own_constants(scene: Scene, layers: Sequence[str], notes: dict[str, str]) -> None:
    """Note which constants a scene takes from its file, and which of the file it does not use.

    Raises
    ------
    InputError
        If none has an effect, the scene states one of them itself, or a layer is none.
    """
    given = scene.constants
    if not given.given:
        return
    name, known = Path(given.file).name, dict.fromkeys((*listed("cutting"), *LAYERS, *layers))
    for entry in given.given:
        table, layer, _ = entry.split(".")
        if table == "cutting" and layer not in known:
            raise InputError(
                f"materials must name a material of cutting or a layer, got {layer}{nearest(layer, known)} in {name}: "
                f"use one of {', '.join(known)}"
            )
    used = {one.full: one for one in used_constants(scene, layers) if one.full in given.given}
    for full, one in used.items():
        if one.stated is not None:
            part = "organ.young_kPa" if one.name == "modulus_kPa" else f"{full.split('.')[0]}.{one.name}"
            part = part.replace("soft.", "organ.")
            raise InputError(
                f"{part} must be left out where materials states {full}, got {shown(one.stated)}: remove one of them"
            )
    if not used:
        raise InputError(
            f"materials must hold a constant that the scene rests on, got {', '.join(given.given)} in {name}: name the "
            "materials of this scene, or leave materials out"
        )
    notes["materials"] = f"of {name}: " + "; ".join(
        f"{full} {one.cited.value:g} ({one.cited.low:g}-{one.cited.high:g}), {one.cited.source}"
        for full, one in used.items()
    )
    if unused := [full for full in given.given if full not in used]:
        notes["materials"] += f". Not used in this scene: {', '.join(unused)}"
