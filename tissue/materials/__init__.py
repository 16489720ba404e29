"""Cited material constants."""

from tissue.materials.cutting import Constant, CuttingCoefficients, cutting_coefficients, cutting_constants

__all__ = ["Constant", "CuttingCoefficients", "cutting_coefficients", "cutting_constants"]
