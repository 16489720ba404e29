"""Hyperelastic laws of isotropic soft tissue: energy, first Piola-Kirchhoff stress and its tangent.

Neo-Hookean, Mooney-Rivlin, Yeoh and Ogden laws form one family here. The principal stretches of the
deformation gradient F are l_i, with J = l_1 l_2 l_3. The isochoric stretches are b_i = l_i
J^(-1/3), with S(alpha) = sum_i b_i^alpha and x = S(2) - 3::

    psi = sum_p (2 mu_p / alpha_p^2) (S(alpha_p) - 3) + sum_k c_k x^k
          + (kappa / 4) (J^2 - 1 - 2 ln J)

The shear modulus at small strains is sum mu_p, and the bulk modulus is kappa. The volumetric part
(Simo and Miehe 1992) is separate from the isochoric part, so that shear does not depend on kappa.
Stress and tangent follow from the derivatives with respect to ln l_i in the frame of the singular
vectors of F.

References: Ogden 1984, Non-Linear Elastic Deformations; Yeoh 1993, Rubber Chemistry and Technology
66.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array
from meshes.base.errors import InputError

__all__ = ["Hyperelastic"]

EQUAL = 1e-5
"""Relative difference below which two stretches count as equal.

The error of the limit is the square of this value, close to rounding.
"""


@dataclass(frozen=True)
class Hyperelastic:
    """Isotropic hyperelastic law.

    Parameters
    ----------
    bulk_Pa
        Bulk modulus kappa at small strains [Pa].
    terms
        Pairs mu_p [Pa], alpha_p of the sum over powers of stretches.
    powers_Pa
        Coefficients c_2, c_3, ... of the powers of I1 - 3 [Pa].

    Raises
    ------
    InputError
        If a constant is not finite, an exponent is zero, or the bulk modulus or the shear modulus
        is not positive.
    """

    bulk_Pa: float
    terms: tuple[tuple[float, float], ...]
    powers_Pa: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if not np.isfinite([self.bulk_Pa, *np.ravel(self.terms), *self.powers_Pa]).all():
            raise InputError("constants of a law", "be finite", self, "give finite numbers")
        if any(alpha == 0.0 for _, alpha in self.terms):
            raise InputError("alpha of terms", "not be 0", self.terms, "leave the term out")
        for name, value in (
            ("bulk_Pa", self.bulk_Pa),
            ("the shear modulus of terms", self.shear_Pa),
        ):
            if value <= 0.0:
                raise InputError(name, "be positive", f"{value:g} Pa", "give a stable material")

    @classmethod
    def neo_hookean(cls, shear_Pa: float, *, bulk_Pa: float) -> "Hyperelastic":
        """Return the law (mu / 2) (I1 - 3), isochoric part."""
        return cls(bulk_Pa, ((shear_Pa, 2.0),))

    @classmethod
    def mooney_rivlin(cls, c10_Pa: float, c01_Pa: float, *, bulk_Pa: float) -> "Hyperelastic":
        """Return the law c10 (I1 - 3) + c01 (I2 - 3), isochoric part."""
        return cls(bulk_Pa, ((2.0 * c10_Pa, 2.0), (2.0 * c01_Pa, -2.0)))

    @classmethod
    def yeoh(cls, c1_Pa: float, c2_Pa: float, c3_Pa: float, *, bulk_Pa: float) -> "Hyperelastic":
        """Return the law c1 (I1 - 3) + c2 (I1 - 3)^2 + c3 (I1 - 3)^3, isochoric part."""
        return cls(bulk_Pa, ((2.0 * c1_Pa, 2.0),), (c2_Pa, c3_Pa))

    @property
    def shear_Pa(self) -> float:
        """Shear modulus at small strains [Pa]."""
        return float(sum(mu for mu, _ in self.terms))

    def energy(self, gradient: ArrayLike) -> Array:
        """Return the energy per undeformed volume [J/m^3], shape (...), of gradients (..., 3, 3).

        The energy is infinite where J <= 0.
        """
        f = np.asarray(gradient, dtype=np.float64)
        upright = np.linalg.det(f) > 0.0
        safe = np.where(upright[..., None, None], f, np.eye(3))
        return np.where(
            upright, self._derivatives(np.linalg.svd(safe, compute_uv=False))[0], np.inf
        )

    def stress(self, gradient: ArrayLike) -> Array:
        """Return the first Piola-Kirchhoff stress [Pa], shape (..., 3, 3).

        The gradients have shape (..., 3, 3) and J > 0.
        """
        u, stretch, v = np.linalg.svd(_upright(gradient))
        return np.asarray((u * (self._derivatives(stretch)[1] / stretch)[..., None, :]) @ v)

    def tangent(self, gradient: ArrayLike) -> Array:
        """Return the derivatives dP_ij / dF_kl [Pa], shape (..., 3, 3, 3, 3).

        The gradients have shape (..., 3, 3) and J > 0.
        """
        u, stretch, v = np.linalg.svd(_upright(gradient))
        _, slope, curvature = self._derivatives(stretch)
        first = slope / stretch
        second = curvature / (stretch[..., :, None] * stretch[..., None, :])
        second = second - np.eye(3) * (first / stretch)[..., None, :]
        local = np.zeros((*stretch.shape[:-1], 3, 3, 3, 3))
        for i in range(3):
            for j in range(3):
                local[..., i, i, j, j] = second[..., i, j]
        for i, j in ((0, 1), (0, 2), (1, 2)):
            a = stretch[..., i]
            b = stretch[..., j]
            equal = np.abs(a - b) < EQUAL * (a + b)
            limit = 0.5 * (second[..., i, i] + second[..., j, j]) - second[..., i, j]
            stretching = np.where(
                equal, limit, (first[..., i] - first[..., j]) / np.where(equal, 1.0, a - b)
            )
            turning = (first[..., i] + first[..., j]) / (a + b)
            for k, n in ((i, j), (j, i)):
                local[..., k, n, k, n] = 0.5 * (stretching + turning)
                local[..., k, n, n, k] = 0.5 * (stretching - turning)
        return np.einsum(
            "...ia,...bj,...abcd,...kc,...dl->...ijkl", u, v, local, u, v, optimize=True
        )

    def _derivatives(self, stretch: Array) -> tuple[Array, Array, Array]:
        """Return energy (...), slope (..., 3) and curvature (..., 3, 3).

        Derivatives are with respect to the logarithms of the stretches.
        """
        volume = stretch.prod(axis=-1)
        isochoric = stretch / np.cbrt(volume)[..., None]
        energy = 0.25 * self.bulk_Pa * (volume**2 - 1.0 - 2.0 * np.log(volume))
        slope = np.repeat(0.5 * self.bulk_Pa * (volume**2 - 1.0)[..., None], 3, axis=-1)
        curvature = np.broadcast_to(
            (self.bulk_Pa * volume**2)[..., None, None], (*stretch.shape, 3)
        ).copy()
        for mu, alpha in self.terms:
            value, first, second = _power_sum(isochoric, alpha)
            scale = 2.0 * mu / alpha**2
            energy = energy + scale * value
            slope = slope + scale * first
            curvature = curvature + scale * second
        value, first, second = _power_sum(isochoric, 2.0)
        for k, c in enumerate(self.powers_Pa, start=2):
            rate = (c * k * value ** (k - 1))[..., None]
            bend = (c * k * (k - 1) * value ** (k - 2))[..., None, None]
            energy = energy + c * value**k
            slope = slope + rate * first
            curvature = (
                curvature
                + rate[..., None] * second
                + bend * first[..., :, None] * first[..., None, :]
            )
        return energy, slope, curvature


def _power_sum(isochoric: Array, alpha: float) -> tuple[Array, Array, Array]:
    """Return S(alpha) - 3 with its first and second derivatives.

    Derivatives are with respect to the logarithms of the stretches.
    """
    power = isochoric**alpha
    mean = power.mean(axis=-1, keepdims=True)
    mixed = (power[..., :, None] + power[..., None, :] - mean[..., None]) / 3.0
    second = alpha**2 * (np.eye(3) * power[..., None, :] - mixed)
    return 3.0 * (mean[..., 0] - 1.0), alpha * (power - mean), second


def _upright(gradient: ArrayLike) -> Array:
    f = np.asarray(gradient, dtype=np.float64)
    if not (np.linalg.det(f) > 0.0).all():
        raise InputError(
            "gradient must have a positive determinant: a cell is turned over, shorten the step"
        )
    return f
