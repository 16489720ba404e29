"""Cited material constants."""

from tissue.materials.constants import Constant, constants
from tissue.materials.cutting import CuttingCoefficients, cutting_coefficients, cutting_constants

__all__ = ["Constant", "CuttingCoefficients", "constants", "cutting_coefficients", "cutting_constants"]
