"""Hyperelastic laws of isotropic soft tissue, and their first Piola-Kirchhoff stress.

Neo-Hookean, Mooney-Rivlin, Yeoh, Ogden and exponential laws are special cases of one law. The
principal stretches of the deformation gradient F are l_i, and J = l_1 l_2 l_3. The isochoric
stretches are b_i = l_i J^(-1/3). With S(alpha) = sum_i b_i^alpha and x = S(2) - 3, the energy
density is::

    psi = sum_p (2 mu_p / alpha_p^2) (S(alpha_p) - 3) + sum_k c_k x^k
          + sum_e (mu_e / (2 b_e)) (exp(b_e x) - 1) + (kappa / 4) (J^2 - 1 - 2 ln J)

The shear modulus at small strains is sum mu_p + sum mu_e, and the bulk modulus is kappa. The
volumetric part (Simo and Miehe 1992) is separate from the isochoric part, so the response to shear
does not depend on kappa. The stress follows from the derivatives of psi with respect to ln l_i, in
the frame of the singular vectors of F. `kernels.tet_hyperelastic` evaluates the law in the cells of
a mesh.

References: Ogden 1984, Non-Linear Elastic Deformations; Yeoh 1993, Rubber Chemistry and Technology
66; Demiray 1972, J. Biomech. 5:309 (exponential of the first invariant, an isotropic form of Fung).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array
from meshes.base.errors import InputError


@dataclass(frozen=True)
class Hyperelastic:
    """Isotropic hyperelastic law.

    Parameters
    ----------
    bulk_Pa
        Bulk modulus kappa at small strains [Pa].
    terms
        Pairs (mu_p [Pa], alpha_p), one for each Ogden term.
    powers_Pa
        Coefficients c_2, c_3, ... of the powers of I1 - 3 [Pa].
    exponentials
        Pairs (mu_e [Pa], b_e), one for each exponential term in I1 - 3.

    Raises
    ------
    InputError
        If a constant is not finite, an exponent is zero, or b_e, the bulk modulus or the shear
        modulus is not positive.
    """

    bulk_Pa: float
    terms: tuple[tuple[float, float], ...]
    powers_Pa: tuple[float, ...] = ()
    exponentials: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        given = [self.bulk_Pa, *np.ravel(self.terms), *self.powers_Pa, *np.ravel(self.exponentials)]
        if not np.isfinite(given).all():
            raise InputError("constants of a law", "be finite", self, "give finite numbers")
        if any(alpha == 0.0 for _, alpha in self.terms):
            raise InputError("alpha of terms", "not be 0", self.terms, "leave the term out")
        if any(rate <= 0.0 for _, rate in self.exponentials):
            raise InputError(
                "the rate of exponentials",
                "be positive",
                self.exponentials,
                "use a positive rate, or leave the term out",
            )
        for name, value in (
            ("bulk_Pa", self.bulk_Pa),
            ("the shear modulus of terms", self.shear_Pa),
        ):
            if value <= 0.0:
                raise InputError(
                    name, "be positive", f"{value:g} Pa", "use the constants of a stable material"
                )

    @classmethod
    def neo_hookean(cls, shear_Pa: float, *, bulk_Pa: float) -> "Hyperelastic":
        """Return the law with the isochoric energy (mu / 2) (I1 - 3)."""
        return cls(bulk_Pa, ((shear_Pa, 2.0),))

    @classmethod
    def mooney_rivlin(cls, c10_Pa: float, c01_Pa: float, *, bulk_Pa: float) -> "Hyperelastic":
        """Return the law with the isochoric energy c10 (I1 - 3) + c01 (I2 - 3)."""
        return cls(bulk_Pa, ((2.0 * c10_Pa, 2.0), (2.0 * c01_Pa, -2.0)))

    @classmethod
    def yeoh(cls, c1_Pa: float, c2_Pa: float, c3_Pa: float, *, bulk_Pa: float) -> "Hyperelastic":
        """Return the law with the isochoric energy c1 (I1 - 3) + c2 (I1 - 3)^2 + c3 (I1 - 3)^3."""
        return cls(bulk_Pa, ((2.0 * c1_Pa, 2.0),), (c2_Pa, c3_Pa))

    @classmethod
    def exponential(cls, shear_Pa: float, rate: float, *, bulk_Pa: float) -> "Hyperelastic":
        """Return the law with the isochoric energy (mu / (2 b)) (exp(b (I1 - 3)) - 1)."""
        return cls(bulk_Pa, (), exponentials=((shear_Pa, rate),))

    @property
    def shear_Pa(self) -> float:
        """Shear modulus at small strains [Pa]."""
        return float(sum(mu for mu, _ in (*self.terms, *self.exponentials)))

    def stress(self, gradient: ArrayLike) -> Array:
        """Return the first Piola-Kirchhoff stress [Pa], shape (..., 3, 3).

        `gradient` holds deformation gradients F, shape (..., 3, 3), with a positive determinant J.
        """
        f = np.asarray(gradient, np.float64)
        if not (np.linalg.det(f) > 0.0).all():
            raise InputError(
                "gradient must have a positive determinant, got an inverted cell. Use "
                "a shorter step"
            )
        u, stretch, v = np.linalg.svd(f)
        return (u * (self.derivatives(stretch)[1] / stretch)[..., None, :]) @ v

    def derivatives(self, stretch: Array) -> tuple[Array, Array, Array]:
        """Compute the energy density [Pa], and its derivatives with respect to logarithmic strains.

        The logarithmic strains are the logarithms of the principal stretches `stretch`, shape (...,
        3). The energy has the shape (...), the first derivatives have the shape (..., 3), and the
        second derivatives have the shape (..., 3, 3).
        """
        volume = stretch.prod(axis=-1)
        isochoric = stretch / np.cbrt(volume)[..., None]
        energy = 0.25 * self.bulk_Pa * (volume**2 - 1.0 - 2.0 * np.log(volume))
        slope = np.repeat(0.5 * self.bulk_Pa * (volume**2 - 1.0)[..., None], 3, axis=-1)
        curvature = np.tile((self.bulk_Pa * volume**2)[..., None, None], (3, 3))
        for mu, alpha in self.terms:
            value, first, second = _power_sum(isochoric, alpha)
            scale = 2.0 * mu / alpha**2
            energy = energy + scale * value
            slope = slope + scale * first
            curvature = curvature + scale * second
        if not self.powers_Pa and not self.exponentials:
            return energy, slope, curvature
        value, first, second = _power_sum(isochoric, 2.0)
        # First and second derivatives of the terms that only depend on x.
        rise = np.zeros_like(value)
        bend = np.zeros_like(value)
        for k, c in enumerate(self.powers_Pa, start=2):
            energy = energy + c * value**k
            rise = rise + c * k * value ** (k - 1)
            bend = bend + c * k * (k - 1) * value ** (k - 2)
        for mu, rate in self.exponentials:
            growth = 0.5 * mu * np.exp(rate * value)
            energy = energy + 0.5 * mu / rate * np.expm1(rate * value)
            rise = rise + growth
            bend = bend + rate * growth
        slope = slope + rise[..., None] * first
        outer = first[..., :, None] * first[..., None, :]
        curvature = curvature + rise[..., None, None] * second + bend[..., None, None] * outer
        return energy, slope, curvature


def _power_sum(isochoric: Array, alpha: float) -> tuple[Array, Array, Array]:
    """Return S(alpha) - 3, and its first and second derivatives with respect to ln(stretch)."""
    power = isochoric**alpha
    mean = power.mean(axis=-1, keepdims=True)
    mixed = (power[..., :, None] + power[..., None, :] - mean[..., None]) / 3.0
    second = alpha**2 * (np.eye(3) * power[..., None, :] - mixed)
    return 3.0 * (mean[..., 0] - 1.0), alpha * (power - mean), second
