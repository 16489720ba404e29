"""Cited material constants."""

from tissue.materials.constants import Constant, CuttingCoefficients, constants, cutting_coefficients

__all__ = ["Constant", "CuttingCoefficients", "constants", "cutting_coefficients"]
