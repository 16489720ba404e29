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
    cited
        The prior of a constant whose cited value is an end of its range, such as an axial coefficient of 0. The fit
        uses the `mirrored` prior in its linear algebra and counts what lies beyond the end as the end itself, see
        `tissue.fitting.one_sided`. None for a constant whose value lies inside its range.
    """

    name: str
    prior: Prior
    cited: Prior | None = None

    @classmethod
    def of(cls, name: str, cited: Prior) -> "Parameter":
        """Return the parameter of a cited constant, its value inside its range or at an end."""
        return cls(name, cited.mirrored(), cited) if cited.is_one_sided else cls(name, cited)

    @property
    def side(self) -> float:
        """1 where only values above the cited one are possible, -1 where only those below, 0 where both are."""
        if self.cited is None:
            return 0.0
        return 1.0 if self.cited.value == self.cited.low else -1.0


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
