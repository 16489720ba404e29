"""As which material each layer of a bone or a tooth is cut, see `tissue.materials.constants`."""

from tissue.materials.constants import CuttingCoefficients, cutting_coefficients

__all__ = ["CUT_AS", "CuttingCoefficients", "cutting_coefficients"]

CUT_AS = {"enamel": "enamel", "dentin": "dentin", "caries": "dentin", "pulp": "soft", "ligament": "soft"}
"""Material whose cutting coefficients a layer has; all others have those of bone."""
