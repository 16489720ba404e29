"""What a bone is cut as: cited coefficients, a caller's own, and those of a person's file."""

from collections.abc import Mapping, Sequence
from os import PathLike
from typing import TypedDict

from tissue.builders.own_constants import given_note
from tissue.materials.constants import CuttingCoefficients
from tissue.materials.scene_constants import Materials
from tissue.scene.registry import CUTTING_MATERIALS
from tissue.scene.used_constants import used_of_cutting

__all__ = ["BoneOptions", "cut_as"]


class BoneOptions(TypedDict, total=False):
    """Options that every bone takes; `tissue.Bone.from_file` states what they are."""

    material: str
    cutting: Mapping[str, float] | None
    materials: str | PathLike[str] | Materials | None


def cut_as(
    options: BoneOptions, layers: Sequence[str], density_kg_m3: float | None
) -> tuple[tuple[CuttingCoefficients, ...], dict[str, str]]:
    """Coefficients of layers and a note on a file of constants; `density_kg_m3` where all of the bone has one.

    Raises
    ------
    InputError
        If the file cannot be used, or holds nothing that counts in this bone.
    """
    given, changes = Materials.of(options.get("materials")), options.get("cutting") or {}
    bone = CUTTING_MATERIALS[options.get("material", "bone")][1]
    coefficients = given.coefficients(layers, changes, bone=bone)
    even = all(density_kg_m3 == each.reference_density_kg_m3 for each in coefficients)
    used = used_of_cutting(given, layers, bone=bone, stated=changes, has_reference_density=even)
    return coefficients, given_note(given, used, layers=layers, by="bone")
