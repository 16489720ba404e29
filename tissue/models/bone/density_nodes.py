"""Loads of bone of many densities, stored at a few node densities, for any density exponent.

Every coefficient of an element is scaled by (density / reference) ** exponent. Summed over elements
of density rho with weights w, f(p) = sum w rho**p is needed for any p. Between nodes rho_j,
Chebyshev points of ln rho, the factor rho**(p - c), c the middle of the exponents, is interpolated
by polynomials L_j of ln rho, so that::

    f(p) = sum_j rho_j**(p - c) M_j,    M_j = sum w rho**c L_j(ln rho)

The interpolation of exp(a x) on [-1, 1] by n points has an error of about 4 I_n(a) (Trefethen 2013,
Approximation Theory and Approximation Practice, ch. 3). n is the smallest number whose error is
below `ERROR` of the smallest value, exp(-a).
"""

from dataclasses import dataclass

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from numpy.typing import NDArray
from scipy.special import iv

from kernels.cutting import DENSITIES
from meshes.base.arrays import Array, Ints

__all__ = ["HIGHEST_EXPONENT", "DensityNodes"]

HIGHEST_EXPONENT = 5.0
"""Largest density exponent that a scene accepts; the smallest is 0."""
MIDDLE = 0.5 * HIGHEST_EXPONENT
ERROR = 1e-8
"""Largest relative error of the factor of an element.

It is a hundredth of the tolerance of reweighed loads.
"""
MOST_NODES = 64


@dataclass(frozen=True, eq=False)
class DensityNodes:
    """Density nodes of one layer.

    Attributes
    ----------
    densities_kg_m3
        Shape (k,).
    shares
        M_j of a unit weight by density, an entry of the strength table, shape (4096, k).
    """

    densities_kg_m3: Array
    shares: Array

    @classmethod
    def of(cls, least_kg_m3: int, most_kg_m3: int) -> "DensityNodes":
        """Return the nodes for densities in a range; one node for a single density."""
        least, most = (min(max(each, 1), DENSITIES - 1) for each in (least_kg_m3, most_kg_m3))
        if least == most:
            return cls(np.array([float(least)]), np.ones((DENSITIES, 1)))
        middle = 0.5 * np.log(most * least)
        half = 0.5 * np.log(most / least)
        count = _count(MIDDLE * half)
        at = np.cos(np.pi * (np.arange(count) + 0.5) / count)
        density = np.clip(np.arange(DENSITIES), least, most)
        x = (np.log(density) - middle) / half
        modes = chebvander(at, count - 1)
        modes[:, 1:] *= 2.0
        polynomials = chebvander(np.clip(x, -1.0, 1.0), count - 1) @ modes.T / count
        return cls(np.exp(middle + half * at), polynomials * (np.exp(half * x) ** MIDDLE)[:, None])

    @property
    def middle_kg_m3(self) -> float:
        """Geometric mean of the smallest and largest density of the range [kg/m3]."""
        return float(np.exp(np.log(self.densities_kg_m3).mean()))

    def strengths(self, exponent: float, *, reference_kg_m3: float, factor: float = 1.0) -> Array:
        """Return weights of the M_j for a density exponent, shape (k,).

        The M_j sum to (factor density / reference) ** exponent.
        """
        tilt = (self.densities_kg_m3 / self.middle_kg_m3) ** -MIDDLE
        return np.asarray((factor * self.densities_kg_m3 / reference_kg_m3) ** exponent * tilt)

    def logarithms(self, *, reference_kg_m3: float, factor: float = 1.0) -> Array:
        """Return ln(factor density / reference) of the nodes, shape (k,).

        It is the factor in the derivative by the exponent.
        """
        return np.asarray(np.log(factor * self.densities_kg_m3 / reference_kg_m3))


def _count(a: float) -> int:
    """Return the number of points that interpolate exp(a x) on [-1, 1].

    The error is at most `ERROR` of the smallest value.
    """
    counts = np.arange(2, MOST_NODES)
    return int(counts[np.argmax(4.0 * iv(counts, a) * np.exp(a) < ERROR)])


def densities_of(material: NDArray[np.uint32], layer: int) -> Ints:
    """Return the smallest and largest density in a layer of stored voxels [kg/m3].

    `material` holds the words of the voxels. Without voxels both densities are zero.
    """
    density = (material[(material & 255) == layer] >> 16).astype(np.int64)
    density = density[density > 0]
    return np.array([density.min(), density.max()]) if len(density) else np.zeros(2, dtype=np.int64)
