"""How strong a force feels: Stevens' power law with what is not known of a person carried through."""

from dataclasses import dataclass
from math import exp

import numpy as np
from numpy.typing import ArrayLike

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.perception.observer import Observer

__all__ = ["Intensity", "intensity_of"]


@dataclass(frozen=True, kw_only=True)
class Intensity:
    """Intensity S = alpha (F / 1 N)^beta (1 + sigma e) of a person of whom (ln alpha, beta) is known as a normal law.

    With x = ln F, m = E[ln alpha] + E[beta] x and v = Var[ln alpha + beta x], which is quadratic in x, the posterior
    predictive has closed moments::

        E[S]   = exp(m + v / 2)
        Var[S] = E[S]^2 (exp(v) (1 + E[sigma^2]) - 1)

    The scatter is relative and Gaussian, where a fit of reported numbers has it in ln S: to first order the same, and
    with sigma squared inverse-gamma over people the mean of a log-normal scatter does not exist. What it would add to
    E[S], a factor exp(sigma^2 / 2), is alike for all forces, so ratios do not depend on it. The unit of intensity is
    what the reference observer feels at 1 N.

    Attributes
    ----------
    log_alpha, beta
        Means of ln alpha and beta.
    variances
        Var[ln alpha], Cov[ln alpha, beta] and Var[beta].
    scatter
        E[sigma^2].
    """

    log_alpha: float
    beta: float
    variances: tuple[float, float, float] = (0.0, 0.0, 0.0)
    scatter: float = 0.0

    def expected(self, force_N: ArrayLike) -> Array:
        """E[S] for sizes of force [N] of any shape; 0 at 0."""
        x = _logarithm(force_N)
        with np.errstate(invalid="ignore"):
            mean = np.exp(self.log_alpha + self.beta * x + 0.5 * self._variance(x))
        return np.where(np.isfinite(x), mean, 0.0)

    def spread(self, force_N: ArrayLike) -> Array:
        """Standard deviation of S for sizes of force [N] of any shape; 0 at 0."""
        x = _logarithm(force_N)
        with np.errstate(invalid="ignore"):
            relative = np.expm1(self._variance(x)) * (1.0 + self.scatter) + self.scatter
            deviation = self.expected(force_N) * np.sqrt(relative)
        return np.where(np.isfinite(x), deviation, 0.0)

    def force_N(self, intensity: ArrayLike) -> Array:
        """Force [N] whose expected intensity is the one given, for intensities of any shape; 0 for 0.

        ln E[S] is quadratic in ln F with curvature Var[beta] >= 0; the branch that rises with the force is taken.

        Raises
        ------
        InputError
            If an intensity is negative, or below what any force is expected to evoke.
        """
        wanted = np.asarray(intensity, dtype=float)
        if not (wanted >= 0.0).all():
            raise InputError(f"intensity must be at least 0, got {intensity!r}: intensities are sizes")
        a, b, c = self.log_alpha + 0.5 * self.variances[0], self.beta + self.variances[1], self.variances[2]
        with np.errstate(divide="ignore", invalid="ignore"):
            above = np.log(wanted) - a
            root = b * b + 2.0 * c * above
            found = np.exp(2.0 * above / (b + np.sqrt(root))) if c > 0.0 else np.exp(above / b)
        if b <= 0.0 or not (root[wanted > 0.0] >= 0.0).all():
            raise InputError(
                f"beta must be known well enough to be inverted, got {self.beta:.3g} with standard deviation "
                f"{c**0.5:.3g}: ask more trials at weak forces"
            )
        return np.where(wanted > 0.0, found, 0.0)

    def _variance(self, x: Array) -> Array:
        """v = Var[ln alpha + beta x]."""
        alpha, both, beta = self.variances
        return np.asarray(alpha + 2.0 * both * x + beta * x * x)


def intensity_of(observer: Observer) -> Intensity:
    """What is known of an observer's intensities."""
    (alpha, both), (_, beta) = observer.covariance[:2, :2].tolist()
    return Intensity(
        log_alpha=float(observer.mean[0]),
        beta=float(observer.mean[1]),
        variances=(max(alpha, 0.0), both, max(beta, 0.0)),
        scatter=exp(min(2.0 * observer.mean[5] + 2.0 * observer.covariance[5, 5], 100.0)),
    )


def _logarithm(force_N: ArrayLike) -> Array:
    """ln F for sizes of force; minus infinity for no force."""
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(force_N))
