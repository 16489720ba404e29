"""Psychophysical laws for intensity and threshold.

They are Stevens' power law, Weber's law with a low-level term, and two-interval psychometric
functions.
"""

from dataclasses import dataclass
from math import exp

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr, ndtri

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_range
from tissue.materials.constants import constants
from tissue.perception.observer import Observer

__all__ = [
    "D_PRIME_75",
    "QUANTITIES",
    "Intensity",
    "Weber",
    "correct_of_d_prime",
    "intensity_of",
    "two_interval",
    "weber",
    "weber_of",
    "with_lapse",
]

D_PRIME_75 = 0.9538725524089894
"""Distance d' of two intervals for 75 % right answers: sqrt(2) Phi^-1(0.75)."""
QUANTITIES = {"force": "offset_N", "torque": "offset_Nm", "stiffness": "offset_N_m"}
"""Quantities with known thresholds, and the name and unit of their low-level term."""


def with_lapse(share: ArrayLike, lapse: ArrayLike) -> Array:
    """Return the share of right answers 1/2 + (1/2 - lapse) share in two intervals.

    Source: Wichmann and Hill, 2001.

    Parameters
    ----------
    share
        Share of stimuli that is felt rightly without guesses and lapses, in [0, 1], any shape.
    lapse
        Share of strong stimuli that is answered wrongly, in [0, 1/2).
    """
    return 0.5 + (0.5 - np.asarray(lapse, dtype=float)) * np.asarray(share, dtype=float)


def correct_of_d_prime(d_prime: ArrayLike) -> Array:
    """Return the share of right answers in two intervals, Phi(d' / sqrt(2)).

    Source: Green and Swets, 1966.
    """
    return ndtr(np.asarray(d_prime, dtype=float) / np.sqrt(2.0))


def two_interval(
    base_N: ArrayLike,
    step_N: ArrayLike,
    weber: ArrayLike,
    offset_N: ArrayLike,
    lapse: ArrayLike = 0.0,
) -> Array:
    """Return the share of right answers when an observer chooses the larger of two forces.

    The forces are `base_N` and `base_N + step_N`. The distance d' increases with the step. It is
    0.954 (75 %) at the threshold weber (base + offset), which is Weber's law with its term for low
    forces. Arguments broadcast.

    Parameters
    ----------
    base_N, step_N
        The smaller force, and the difference to the larger force [N], 0 or more.
    weber
        Weber fraction, positive.
    offset_N
        Low-force term of Weber's law [N].
    lapse
        Share of strong stimuli that is answered wrongly.
    """
    threshold = np.asarray(weber) * (np.asarray(base_N) + np.asarray(offset_N))
    return with_lapse(
        2.0 * correct_of_d_prime(D_PRIME_75 * np.asarray(step_N) / threshold) - 1.0, lapse
    )


@dataclass(frozen=True, kw_only=True)
class Intensity:
    """Intensity S = alpha (F / 1 N)^beta (1 + sigma e) of a person with uncertain parameters.

    The posterior of (ln alpha, beta) is normal. With x = ln F, m = E[ln alpha] + E[beta] x and v =
    Var[ln alpha + beta x], which is quadratic in x, the posterior predictive has closed moments::

        E[S]   = exp(m + v / 2)
        Var[S] = E[S]^2 (exp(v) (1 + E[sigma^2]) - 1)

    The scatter is relative and Gaussian, whereas a fit of reported numbers has it in ln S. Both are
    equal to first order. With sigma squared inverse-gamma over people, the mean of a log-normal
    scatter does not exist. Its contribution to E[S], a factor exp(sigma^2 / 2), is equal for all
    forces, so ratios do not depend on it. The unit of intensity is the reference observer's
    intensity at 1 N.

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
        """Return E[S] for sizes of force [N] of any shape; 0 at 0."""
        x = _logarithm(force_N)
        with np.errstate(invalid="ignore"):
            mean = np.exp(self.log_alpha + self.beta * x + 0.5 * self._variance(x))
        return np.where(np.isfinite(x), mean, 0.0)

    def spread(self, force_N: ArrayLike) -> Array:
        """Return the standard deviation of S for sizes of force [N] of any shape; 0 at 0."""
        x = _logarithm(force_N)
        with np.errstate(invalid="ignore"):
            relative = np.expm1(self._variance(x)) * (1.0 + self.scatter) + self.scatter
            deviation = self.expected(force_N) * np.sqrt(relative)
        return np.where(np.isfinite(x), deviation, 0.0)

    def force_N(self, intensity: ArrayLike) -> Array:
        """Return the force [N] with a given expected intensity, for any shape; 0 for 0.

        ln E[S] is quadratic in ln F with curvature Var[beta] >= 0. The branch that rises with the
        force is used.

        Raises
        ------
        InputError
            If an intensity is negative, or below the smallest expected intensity of any force.
        """
        wanted = np.asarray(intensity, dtype=float)
        if not (wanted >= 0.0).all():
            raise InputError(
                "intensity", "be at least 0", f"{intensity!r}", "intensities are sizes"
            )
        a = self.log_alpha + 0.5 * self.variances[0]
        b = self.beta + self.variances[1]
        c = self.variances[2]
        with np.errstate(divide="ignore", invalid="ignore"):
            above = np.log(wanted) - a
            root = b * b + 2.0 * c * above
            found = np.exp(2.0 * above / (b + np.sqrt(root))) if c > 0.0 else np.exp(above / b)
        if b <= 0.0 or not (root[wanted > 0.0] >= 0.0).all():
            raise InputError(
                "beta",
                "be known well enough to be inverted",
                f"{self.beta:.3g} with standard deviation {c**0.5:.3g}",
                "ask more trials at weak forces",
            )
        return np.where(wanted > 0.0, found, 0.0)

    def _variance(self, x: Array) -> Array:
        """Return v = Var[ln alpha + beta x]."""
        alpha, both, beta = self.variances
        return np.asarray(alpha + 2.0 * both * x + beta * x * x)


def intensity_of(observer: Observer) -> Intensity:
    """Return the intensity law of an observer with its uncertainty."""
    (alpha, both), (_, beta) = observer.covariance[:2, :2].tolist()
    return Intensity(
        log_alpha=float(observer.mean[0]),
        beta=float(observer.mean[1]),
        variances=(max(alpha, 0.0), both, max(beta, 0.0)),
        scatter=exp(min(2.0 * observer.mean[5] + 2.0 * observer.covariance[5, 5], 100.0)),
    )


def _logarithm(force_N: ArrayLike) -> Array:
    """Return ln F for sizes of force; minus infinity for no force."""
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(force_N))


@dataclass(frozen=True, kw_only=True)
class Weber:
    """Threshold kappa (level + offset), discriminated in 75 % of two-interval trials (E6).

    Weber's law alone, kappa level, has a threshold of zero at a level of zero, so every change
    would be felt there. The offset is the level at which the threshold, as a share of the level,
    has doubled. Both are positive, so every threshold is positive.

    Attributes
    ----------
    kappa
        Weber's fraction.
    offset
        Low-level term, in the unit of the level: N, N m or N/m.
    """

    kappa: float
    offset: float

    def __post_init__(self) -> None:
        require_range("kappa", self.kappa, 1e-4, 1.0, "use 0.07 for force")
        require_range("offset", self.offset, 1e-6, 1e6, "use 0.2 for force in N")

    def threshold(self, level: ArrayLike) -> Array:
        """Return the smallest change that is felt at levels of any shape, in their unit.

        Raises
        ------
        InputError
            If a level is negative or no number: levels are sizes.
        """
        levels = np.asarray(level, dtype=float)
        if not (levels >= 0.0).all():
            raise InputError(
                "level", "be a size of at least 0", f"{level!r}", "give the length of the vector"
            )
        return self.kappa * (levels + self.offset)


def weber(quantity: str) -> Weber:
    """Return the population's median threshold of a quantity, from ``perception.toml``.

    The quantities are force [N], torque [N m] and stiffness [N/m].

    Raises
    ------
    InputError
        If the quantity is not one of these.
    """
    if quantity not in QUANTITIES:
        raise InputError(
            "quantity", f"be one of {', '.join(QUANTITIES)}", quantity, "choose one of these"
        )
    known = constants("perception", quantity)
    return Weber(kappa=known["kappa"].value, offset=known[QUANTITIES[quantity]].value)


def weber_of(observer: Observer, *, quantile: float = 0.5) -> Weber:
    """Return an observer's threshold of force [N], at a quantile of the Weber fraction's posterior.

    A quantile below one half gives a threshold that is rather too small than too large. At 0.1 the
    person's own threshold lies above it with a probability of 90 %.
    """
    spread = float(np.sqrt(max(observer.covariance[2, 2], 0.0)))
    return Weber(
        kappa=exp(observer.mean[2] + float(ndtri(quantile)) * spread), offset=observer.offset_N
    )
