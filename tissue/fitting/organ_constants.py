"""Constants of an organ and of its contact that a log may determine."""

from collections.abc import Sequence

from tissue.builders.organ import NODULE_KPA, PART_NODULE
from tissue.fitting.parameter import Parameter, chosen
from tissue.materials.prior import Prior
from tissue.scene.organ import SoftAnatomy
from tissue.scene.scene import Scene
from tissue.scene.used_constants import used_constants

__all__ = ["KEYS", "PART", "organ_parameters"]

KEYS, PART = "organ.", "organ.parts."
"""Beginning of the names of what is a key of the scene and no constant of a material, and of moduli of parts."""
FRICTION = (0.25, 2.5)
"""5 and 95 % of friction between tool and organ, over the scene's: wet tissue on metal 0.1 to 0.6 (from memory of the
literature)."""
MODULUS = (1.0 / 3.0, 3.0)
"""Likewise of a modulus that the scene states: as liver scatters in tissue/materials/soft.toml."""
SHAPE = (0.4, 2.5)
"""Likewise of what gives a hyperelastic law its shape, of which none is cited for an organ: assumed."""
SHAPES = ("second_share", "square_ratio", "cube_ratio", "exponent")
"""Keys of the organ that do so."""
SHARE, NEAREST = "second_share", 0.1
"""The one of them that is a share, and the distance of its prior's 95 % quantile from 1, over that of the scene's
value, at least: assumed. Limits of the others are those of input, and no bounds."""


def organ_parameters(scene: Scene, free: Sequence[str]) -> tuple[tuple[Parameter, ...], tuple[int, ...]]:
    """What is free, and the places of the moduli to which loads are proportional together.

    There are no such moduli where the organ hangs in its own weight, or a modulus beside the free ones is fixed.

    Raises
    ------
    InputError
        If `free` names something else.
    """
    cited, stiffnesses = _cited(scene)
    stated = _stated(scene)
    shapes = {"organ.friction", *(f"organ.{name}" for name in SHAPES)}
    stiffnesses |= {each.name for each in stated if each.name not in shapes}
    parameters = tuple(chosen(free, [*cited, *stated]))
    places = tuple(at for at, each in enumerate(parameters) if each.name in stiffnesses)
    together = len(places) == len(stiffnesses) and not scene.organ.gravity
    return parameters, places if together else ()


def _cited(scene: Scene) -> tuple[list[Parameter], set[str]]:
    """Constants of the organ's material that the scene does not state, and the names of all moduli among them."""
    used = [each for each in used_constants(scene, ()) if each.full.startswith("soft.") and each.stated is None]
    free = [Parameter(each.full, Prior.of(each.cited, each.full)) for each in used if each.cited.low < each.cited.high]
    return free, {each.full for each in used if each.name == "modulus_kPa"}


def _stated(scene: Scene) -> list[Parameter]:
    """Moduli, friction and the shape of a law that are keys of the scene; a stiffer or softer ball has a modulus too.

    What is 0 or negative stays as it is, and so does a share of 1: it has no range.
    """
    organ, anatomy = scene.organ, scene.anatomy
    assert isinstance(anatomy, SoftAnatomy)
    parts = dict(organ.parts or {})
    if anatomy.nodule_mm > 0.0:
        parts.setdefault(PART_NODULE, NODULE_KPA)
    found = {"organ.young_kPa": organ.young_kPa, "organ.young_end_kPa": organ.young_end_kPa}
    found |= {f"{PART}{name}": modulus for name, modulus in parts.items()}
    moduli = [
        Parameter(name, Prior(value, MODULUS[0] * value, MODULUS[1] * value))
        for name, value in found.items()
        if value is not None
    ]
    shapes = [
        Parameter(f"organ.{name}", prior)
        for name in SHAPES
        if (value := getattr(organ, name)) is not None and (prior := _shape_prior(name, value)) is not None
    ]
    if (friction := organ.friction) == 0.0:
        return [*moduli, *shapes]
    low, high = FRICTION
    return [*moduli, Parameter("organ.friction", Prior(friction, low * friction, high * friction)), *shapes]


def _shape_prior(name: str, value: float) -> Prior | None:
    """Prior of what gives a law its shape; None where it has no range."""
    low, high = SHAPE
    if value <= 0.0 or (name == SHARE and value >= 1.0):
        return None
    if name == SHARE:
        return Prior(value, low * value, min(high * value, 1.0 - NEAREST * (1.0 - value)), (0.0, 1.0))
    return Prior(value, low * value, high * value)
