"""Cutting coefficients of a bone: cited ones, a caller's own, and ones from a file."""

from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from os import PathLike
from typing import TypedDict

from meshes.base.errors import InputError, require_range
from tissue.materials.constants import CuttingCoefficients
from tissue.materials.scene_constants import Materials
from tissue.scene.registry import CUTTING_MATERIALS
from tissue.scene.used_constants import used_of_cutting
from tissue.simulation.builders.own_constants import given_note

__all__ = ["BoneOptions", "cut_as", "require_known"]

BOUNDS = {
    "_N_mm2": (0.0, 5000.0),
    "_N_mm": (0.0, 500.0),
    "_exponent": (0.0, 5.0),
    "_kg_m3": (50.0, 20000.0),
}
"""Range of a cutting coefficient, by the end of its name, as for a scene's keys."""


class BoneOptions(TypedDict, total=False):
    """Options that every bone takes; see `tissue.Bone.from_file`."""

    material: str
    cutting: Mapping[str, float] | None
    materials: str | PathLike[str] | Materials | None


def require_known(options: Mapping[str, object], *, maker: str) -> None:
    """Refuse an argument that no bone takes, as Python does for a listed signature."""
    known = list(BoneOptions.__annotations__)
    for name in options:
        if name not in known:
            close = get_close_matches(name, known, n=1)
            hint = f"Did you mean {close[0]}? " if close else ""
            raise TypeError(
                f"{maker} got an unexpected keyword argument {name!r}. {hint}Beyond its own "
                "arguments it takes "
                f"{', '.join(known)}."
            )


def _require_coefficients(cutting: object) -> Mapping[str, float]:
    """Check that coefficients are finite numbers in range."""
    if cutting is None:
        return {}
    if not isinstance(cutting, Mapping):
        raise InputError(
            "cutting",
            "be a mapping of coefficients",
            f'{type(cutting).__name__}: give {{"tangential_chip_N_mm2"',
            "150}",
        )
    checked = dict(cutting)
    for name, value in cutting.items():
        for ending, (low, high) in BOUNDS.items():
            if str(name).endswith(ending):
                checked[name] = require_range(
                    f"cutting[{name}]", value, low, high, "leave it out for the cited value"
                )
                break
    return checked


def cut_as(
    options: BoneOptions, layers: Sequence[str], density_kg_m3: float | None
) -> tuple[tuple[CuttingCoefficients, ...], dict[str, str]]:
    """Return the coefficients of layers, and a note on a file of constants.

    `density_kg_m3` is the density of a bone with one density, else None.

    Raises
    ------
    InputError
        If the file cannot be used, or holds no constant that affects this bone.
    """
    given = Materials.of(options.get("materials"))
    changes = _require_coefficients(options.get("cutting"))
    bone = CUTTING_MATERIALS[options.get("material", "bone")][1]
    coefficients = given.coefficients(layers, changes, bone=bone)
    even = all(density_kg_m3 == each.reference_density_kg_m3 for each in coefficients)
    used = used_of_cutting(given, layers, bone=bone, stated=changes, has_reference_density=even)
    return coefficients, given_note(given, used, layers=layers, by="bone")
