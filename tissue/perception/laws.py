"""Psychophysical laws for intensity and threshold.

They are Stevens' power law, Weber's law with a low-level term, and two-interval psychometric
functions.
"""

from dataclasses import dataclass
from math import exp, log

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr, ndtri

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_range
from tissue.perception.observer import Observer

__all__ = [
    "D_PRIME_75",
    "ForceMap",
    "Intensity",
    "LogTable",
    "Weber",
    "correct_of_d_prime",
    "intensity_of",
    "two_interval",
    "weber_of",
    "with_lapse",
]

D_PRIME_75 = 0.9538725524089894
"""Distance d' of two intervals for 75 % right answers: sqrt(2) Phi^-1(0.75)."""


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
            If an intensity is below the smallest expected intensity of any force.
        """
        wanted = np.asarray(intensity, dtype=float)
        a = self.log_alpha + 0.5 * self.variances[0]
        b = self.beta + self.variances[1]
        c = self.variances[2]
        with np.errstate(divide="ignore", invalid="ignore"):
            above = np.log(wanted) - a
            root = b * b + 2.0 * c * above
            # Root of c x^2 / 2 + b x = above, in the form that does not cancel for a small c.
            found = np.exp(2.0 * above / (b + np.sqrt(root))) if c > 0.0 else np.exp(above / b)
        # Below the minimum of the parabola ln E[S] no force has this intensity.
        if b <= 0.0 or not (root[wanted > 0.0] >= 0.0).all():
            raise InputError(
                "beta",
                "be known well enough to be inverted",
                f"{self.beta:.3g} with standard deviation {c**0.5:.3g}",
                "run more trials with weak forces",
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
        # Mean of a log-normal sigma^2, limited to e^100, so that the moments stay finite where a
        # wide posterior leaves the scatter unknown.
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
        # Bounds that reject a fraction in percent and a wrong unit of the offset; people have 0.05
        # to 0.23, and 0.006 N m to 10 N/m (perception.toml).
        require_range("kappa", self.kappa, 1e-4, 1.0, "use 0.07 for force")
        require_range("offset", self.offset, 1e-6, 1e6, "use 0.2 for force in N")

    def threshold(self, level: ArrayLike) -> Array:
        """Return the smallest change that is felt at sizes of any shape, in their unit."""
        return self.kappa * (np.asarray(level, dtype=float) + self.offset)


def weber_of(observer: Observer, *, quantile: float = 0.5) -> Weber:
    """Return an observer's threshold of force [N], at a quantile of the Weber fraction's posterior.

    A quantile below one half gives a threshold that is rather too small than too large. At 0.1 the
    person's own threshold lies above it with a probability of 90 %.
    """
    spread = float(np.sqrt(max(observer.covariance[2, 2], 0.0)))
    return Weber(
        kappa=exp(observer.mean[2] + float(ndtri(quantile)) * spread), offset=observer.offset_N
    )


NODES = 4097
"""Nodes of a table.

Over five decades the error of log-linear interpolation is below 1e-6 for every observer whose
exponent is known to 0.5.
"""


class LogTable:
    """Positive function of force, tabulated over ln F and interpolated linearly in its logarithm.

    Exact for a power law. Below the first node it falls linearly to zero; above the last it
    continues linearly.

    Parameters
    ----------
    forces_N
        Nodes [N], rising in equal ratios.
    values
        Values of the function at the nodes, positive.
    """

    def __init__(self, forces_N: Array, values: Array) -> None:
        self._first = float(forces_N[0])
        self._last = float(forces_N[-1])
        self._start = log(self._first)
        self._per_log = (len(forces_N) - 1) / log(self._last / self._first)
        self._logs = np.log(values).tolist()
        self._below = float(values[0]) / self._first
        self._above = float(values[-1]) / self._last

    def at(self, force_N: float) -> float:
        """Return the function at a force [N], 0 or more."""
        if force_N < self._first:
            return self._below * force_N
        if force_N >= self._last:
            return self._above * force_N
        place = (log(force_N) - self._start) * self._per_log
        node = int(place)
        here = self._logs[node]
        return exp(here + (place - node) * (self._logs[node + 1] - here))


class ForceMap:
    """Command by E5: the force whose expected intensity for this observer matches the reference.

    The reference is the reference observer's intensity at gain x force.

    Stevens' law is homogeneous, so a common factor on all forces keeps every ratio of intensities.
    No other law does. The stated law for a device's range is therefore a factor. ``knee_N`` is the
    strongest force that the device plays uncompressed. The factor is 1 where the observer needs no
    more force than the reference at ``knee_N``. Where the observer needs more force, the factor is
    below 1, so that exactly ``knee_N`` is commanded there. Up to the knee then

        E[S | command(F1)] / E[S | command(F2)] = (F1 / F2)^beta of the reference

    Beyond it `tissue.haptics.loop.filters.ForceRange` compresses, and reports it.

    Neither law has been measured far below the observer's low-force term. Below this term the map
    continues in a straight line to zero. The line also bounds the slope of the map there, so that
    the stiffness at the start of a contact is finite.

    Parameters
    ----------
    reference, observer
        Observer whose intensity is matched, and observer who feels the command.
    lowest_N, knee_N
        Upper end of the straight line [N], above 0, and the strongest force that the device plays
        uncompressed [N], above that end.

    Attributes
    ----------
    gain
        The common factor.
    table, intensity, spread
        Command [N] over force, and mean and standard deviation of intensity over command.
    steepest
        Largest slope of the map: the largest factor on a contact's stiffness in the loop.

    Raises
    ------
    InputError
        If the observer's posterior is too wide for the map to rise with the force.
    """

    def __init__(
        self, reference: Intensity, observer: Intensity, *, lowest_N: float, knee_N: float
    ) -> None:
        self._reference = reference
        self._observer = observer
        need = float(observer.force_N(reference.expected(knee_N)))
        most = float(reference.force_N(observer.expected(knee_N)))
        self.gain = 1.0 if need <= knee_N else most / knee_N
        # Forces a hundred times the knee are left to the straight line: they are compressed to the
        # device's limit in any case.
        self.forces_N: Array = np.geomspace(lowest_N, 100.0 * knee_N, NODES)
        commands = self._exact(self.forces_N)
        slopes = np.diff(commands) / np.diff(self.forces_N)
        if not (slopes > 0.0).all():
            raise InputError(
                "observer",
                "perceive a larger force as more intense",
                "an observer who does not",
                "run more trials",
            )
        within = int(np.searchsorted(self.forces_N, knee_N))
        self.steepest = float(max(slopes[:within].max(), commands[0] / lowest_N))
        self.table = LogTable(self.forces_N, commands)
        # A thousandth of the knee, some mN, is below the threshold at zero, kappa offset = 14 mN.
        felt = np.geomspace(1e-3 * knee_N, 100.0 * knee_N, NODES)
        self.intensity = LogTable(felt, observer.expected(felt))
        # An observer known exactly, without scatter, has a spread of 0, whose logarithm the table
        # cannot hold.
        self.spread = LogTable(felt, np.maximum(observer.spread(felt), 1e-12))

    def command_N(self, force_N: ArrayLike) -> Array:
        """Return the force sizes to command [N] for force sizes at the device [N].

        The result is exact, for arrays of any shape.
        """
        forces = np.asarray(force_N, dtype=float)
        first = self.forces_N[0]
        straight = forces * float(self._exact(first)) / first
        return np.where(forces < first, straight, self._exact(np.maximum(forces, first)))

    def _exact(self, force_N: ArrayLike) -> Array:
        """Return the inverse by closed form, without the straight line."""
        return self._observer.force_N(
            self._reference.expected(self.gain * np.asarray(force_N, dtype=float))
        )
