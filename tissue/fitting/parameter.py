"""A constant that a fit leaves free."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from meshes.base.errors import InputError
from tissue.materials.prior import Prior

__all__ = ["Parameter", "chosen", "fits"]


@dataclass(frozen=True)
class Parameter:
    """A free constant.

    Attributes
    ----------
    name
        ``TABLE.MATERIAL.NAME`` as the files of constants have it, such as ``cutting.bone.radial_chip_N_mm2``, or
        ``density.LAYER``, the factor on the density map of a layer.
    prior
        What is known of it before the log.
    """

    name: str
    prior: Prior


def fits(pattern: str, name: str, tags: Collection[str] = ()) -> bool:
    """Whether a pattern chooses a constant: the table first, then parts of the name, words of it, or tags."""
    table, material, *rest = name.split(".")
    wanted, *parts = pattern.split(".")
    known = {material, *tags, *rest, *(word for full in rest for word in (full, *full.split("_")[:2]))}
    return wanted == table and known.issuperset(parts)


def chosen(free: Sequence[str], possible: Sequence[Parameter]) -> list[Parameter]:
    """The parameters that patterns choose, see `fits`; all without a pattern.

    Raises
    ------
    InputError
        If a pattern chooses none.
    """
    for pattern in free:
        if not any(fits(pattern, each.name) for each in possible):
            names = ", ".join(each.name for each in possible)
            raise InputError(f"free must name constants of this log, got {pattern}: choose among {names}")
    return [each for each in possible if not free or any(fits(pattern, each.name) for pattern in free)]
