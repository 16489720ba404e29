"""Effects of a scene's own file of constants.

Every entry must have an effect, or is named in the run's notes.
"""

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path

from meshes.base.errors import InputError
from meshes.surfaces.glenoid import GLENOID_LAYERS
from meshes.tooth.layers import TOOTH_LAYERS
from meshes.vertebra.lumbar import VERTEBRA_LAYERS
from tissue.materials.constants import listed
from tissue.materials.scene_constants import Materials
from tissue.scene.named_parts import nearest, shown
from tissue.scene.scene import Scene
from tissue.scene.used_constants import Used, used_constants

__all__ = ["given_note", "note_own_constants", "soft_constants"]

LAYERS = (*GLENOID_LAYERS, *VERTEBRA_LAYERS, *TOOTH_LAYERS)
"""Layers of the built-in anatomies.

A file may hold constants of a layer that a scene does not have.
"""


def note_own_constants(scene: Scene, layers: Sequence[str], notes: dict[str, str]) -> None:
    """Note which constants of its file a scene uses, and which it does not use.

    Raises
    ------
    InputError
        If no constant has an effect, the scene itself states one of them, or a layer is unknown.
    """
    notes |= given_note(scene.constants, used_constants(scene, layers), layers=layers, by="scene")


def given_note(
    given: Materials, rests_on: Sequence[Used], *, layers: Sequence[str], by: str
) -> dict[str, str]:
    """Return the note ``materials`` on the given constants that `by` uses.

    The note is empty where all constants are cited.

    Raises
    ------
    InputError
        As for `note_own_constants`.
    """
    if not given.given:
        return {}
    name = Path(given.file).name
    known = dict.fromkeys((*listed("cutting"), *LAYERS, *layers))
    for entry in given.given:
        table, layer, _ = entry.split(".")
        if table == "cutting" and layer not in known:
            raise InputError(
                "materials",
                "name a material of cutting or a layer",
                f"{layer}{nearest(layer, known)} in {name}",
                f"use one of {', '.join(known)}",
            )
    used = {one.full: one for one in rests_on if one.full in given.given}
    for full, one in used.items():
        if one.stated is not None:
            part = (
                "organ.young_kPa"
                if one.name == "modulus_kPa"
                else f"{full.split('.')[0]}.{one.name}"
            )
            part = part.replace("soft.", "organ.")
            raise InputError(
                part,
                f"be left out where materials states {full}",
                shown(one.stated),
                "remove one of them",
            )
    if not used:
        raise InputError(
            "materials",
            f"hold a constant that the {by} rests on",
            f"{', '.join(given.given)} in {name}",
            f"name the materials of this {by}, or leave materials out",
        )
    note = f"of {name}: " + "; ".join(
        f"{full} {one.cited.value:g} ({one.cited.low:g}-{one.cited.high:g}), {one.cited.source}"
        for full, one in used.items()
    )
    if unused := [full for full in given.given if full not in used]:
        note += f". Not used in this {by}: {', '.join(unused)}"
    return {"materials": note}


def soft_constants(
    materials: str | PathLike[str] | Materials | None,
    material: str,
    stated: Mapping[str, float | None],
) -> tuple[dict[str, float], dict[str, str]]:
    """Return constants of an organ's material by name, and the note on their file.

    The names are the keys of `stated`; a stated value takes precedence.

    Raises
    ------
    InputError
        As for `note_own_constants`.
    """
    given = Materials.of(materials)
    known = given.constants("soft", material)
    used = [
        Used(f"soft, {material}", name, known[name], f"soft.{material}.{name}", value)
        for name, value in stated.items()
    ]
    taken = {name: known[name].value if value is None else value for name, value in stated.items()}
    return taken, given_note(given, used, layers=(), by="organ")
