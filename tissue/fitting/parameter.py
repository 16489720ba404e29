"""A constant that a fit leaves free."""

from dataclasses import dataclass

from tissue.materials.prior import Prior

__all__ = ["Parameter"]


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
