"""Cutting coefficients, see `tissue.materials.constants`."""

from tissue.materials.constants import CuttingCoefficients, cutting_coefficients

__all__ = ["CuttingCoefficients", "cutting_coefficients"]
