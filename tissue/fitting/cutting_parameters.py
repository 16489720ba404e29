"""Which constants of a cut are free: names, patterns that choose them, and priors."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from meshes.base.errors import InputError
from tissue.fitting.parameter import Parameter, fits
from tissue.materials.constants import N_MM, N_MM2, Constant, CuttingCoefficients
from tissue.materials.prior import Prior

__all__ = ["DENSITY", "FACTOR", "FreeConstant", "LayerConstants", "free_constants"]

DENSITY = Prior(1.0, 0.85, 1.18)
"""Factor on a layer's density, 10 % (one standard deviation) up and down: laws from CT numbers to density differ by as
much between scanners and authors (from memory of the literature)."""
FIELDS = {
    **{field.removesuffix("_Pa") + "_N_mm2": (field, N_MM2) for field in CuttingCoefficients.CHIP},
    **{field.removesuffix("_N_m") + "_N_mm": (field, N_MM) for field in CuttingCoefficients.EDGE},
    "density_exponent": ("density_exponent", 1.0),
}
"""The constants of a layer: field of `CuttingCoefficients`, and its value for 1."""
FACTOR = "density_factor"
"""Field of a free density."""


@dataclass(frozen=True)
class FreeConstant:
    """A free constant of one layer.

    Attributes
    ----------
    parameter
        Its name and prior.
    layer
        Place of the layer.
    field
        Of `CuttingCoefficients`, or ``density_factor``.
    unit
        What 1 of the parameter is in the field.
    """

    parameter: Parameter
    layer: int
    field: str
    unit: float


@dataclass(frozen=True)
class LayerConstants:
    """What is known of a layer that the tool met.

    Attributes
    ----------
    layer, name, material
        Its place, its name, and what it is cut as.
    constants
        Cited or stated constants by name.
    scaled
        Whether its density is another than that of the coefficients, so that the exponent counts.
    """

    layer: int
    name: str
    material: str
    constants: Mapping[str, Constant]
    scaled: bool


def free_constants(
    layers: Sequence[LayerConstants], free: Sequence[str], stated: Collection[str]
) -> tuple[FreeConstant, ...]:
    """The free constants of a cut, the factor on each layer's density always among them.

    Parameters
    ----------
    layers
        Those that the tool met.
    free
        What is to be free: full names, or a table with what the name is to have, such as ``cutting.trabecular``,
        ``cutting.edge``, ``cutting.trabecular.radial``. Nothing leaves free all that has a range and is
        not stated, so that a band over the fitted constants is that of the log; the exponent where the density is
        another than that of the coefficients.
    stated
        Constants that the scene sets, which stay fixed unless they are named.

    Raises
    ------
    InputError
        If a name fits no constant that can be free.
    """
    possible = [
        FreeConstant(
            Parameter.of(f"cutting.{each.name}.{name}", Prior.of(each.constants[name], name)), each.layer, *field
        )
        for each in layers
        for name, field in FIELDS.items()
        if each.constants[name].low < each.constants[name].high
    ]
    materials = {each.layer: each.material for each in layers}
    factors = [FreeConstant(Parameter(f"density.{each.name}", DENSITY), each.layer, FACTOR, 1.0) for each in layers]

    def named(pattern: str, each: FreeConstant) -> bool:
        return fits(pattern, each.parameter.name, (materials[each.layer],))

    for pattern in free:
        if not any(named(pattern, each) for each in possible + factors):
            names = ", ".join(each.parameter.name for each in possible + factors)
            raise InputError(
                f"free must name constants of layers that the tool meets, got {pattern}: choose among {names}, or "
                "parts of these such as cutting.edge"
            )
    if free:
        chosen = [
            each
            for each in possible
            if any(fits(pattern, each.parameter.name, (materials[each.layer],)) for pattern in free)
        ]
    else:
        scaled = {each.layer for each in layers if each.scaled}
        counts = [each for each in possible if each.field != "density_exponent" or each.layer in scaled]
        chosen = [each for each in counts if _own_name(each) not in stated]
    return (*chosen, *factors)


def _own_name(each: FreeConstant) -> str:
    return each.parameter.name.rpartition(".")[2]
