"""Psychophysical laws for the perceived intensity of force and the threshold of force differences.

The laws are Stevens' power law, Weber's law with a low-force term, and psychometric functions. In a
two-interval trial, an observer feels two forces one after the other and chooses the larger.
"""

from dataclasses import dataclass
from math import exp, log

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtr, ndtri

from meshes.base.arrays import Array
from meshes.base.errors import InputError, require_range
from tissue.perception.observer import Observer

D_PRIME_75 = 0.9538725524089894
"""Sensitivity d' with 75 % right answers in two-interval trials: sqrt(2) Phi^-1(0.75)."""


def with_lapse(share: ArrayLike, lapse: ArrayLike) -> Array:
    """Return the share of right answers in two-interval trials with lapses.

    The result is 1/2 + (1/2 - lapse) share.

    Source: Wichmann and Hill, 2001.

    Parameters
    ----------
    share
        Share of trials in which the observer feels the difference, in [0, 1], any shape. In the
        other trials, the observer guesses.
    lapse
        Share of wrong answers if the difference is large, in [0, 1/2).
    """
    return 0.5 + (0.5 - np.asarray(lapse, dtype=float)) * np.asarray(share, dtype=float)


def correct_of_d_prime(d_prime: ArrayLike) -> Array:
    """Return the share of right answers in two-interval trials, Phi(d' / sqrt(2)).

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
    """Return the share of right answers of an observer who chooses the larger of two forces.

    The forces are `base_N` and `base_N + step_N`. The sensitivity d' increases with the step. If
    the step equals the threshold ``weber * (base_N + offset_N)``, d' is 0.954 and 75 % of the
    answers are right, apart from lapses. The arguments are broadcast.

    Parameters
    ----------
    base_N, step_N
        Smaller force, and step from it to the larger force [N], both 0 or more.
    weber
        Weber fraction, positive.
    offset_N
        Low-force term of Weber's law [N].
    lapse
        Share of wrong answers if the step is large.
    """
    threshold = np.asarray(weber) * (np.asarray(base_N) + np.asarray(offset_N))
    return with_lapse(
        2.0 * correct_of_d_prime(D_PRIME_75 * np.asarray(step_N) / threshold) - 1.0, lapse
    )


@dataclass(frozen=True, kw_only=True)
class Intensity:
    """Perceived intensity of a force, with uncertain parameters.

    The intensity is S = alpha (F / 1 N)^beta (1 + sigma e). The parameters alpha, beta and sigma of
    a person are uncertain, and e is a random number with mean 0 and variance 1. The posterior of
    (ln alpha, beta) is normal. Let x = ln F, m = E[ln alpha] + E[beta] x, and v = Var[ln alpha +
    beta x], a quadratic function of x. The moments of the posterior predictive distribution are::

        E[S]   = exp(m + v / 2)
        Var[S] = E[S]^2 (exp(v) (1 + E[sigma^2]) - 1)

    Here the scatter multiplies the intensity, whereas in a fit of reported numbers it is added to
    ln S. The two forms are equal to first order. Scatter in ln S is not used here: with the
    inverse-gamma distribution of sigma squared, the mean of S would not exist. The unit of
    intensity is the intensity that the reference observer perceives at 1 N.

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
        """Return E[S] for force magnitudes [N] in an array of any shape, and 0 for zero force."""
        x = _logarithm(force_N)
        with np.errstate(invalid="ignore"):
            mean = np.exp(self.log_alpha + self.beta * x + 0.5 * self._variance(x))
        return np.where(np.isfinite(x), mean, 0.0)

    def spread(self, force_N: ArrayLike) -> Array:
        """Return the standard deviation of S for force magnitudes [N] in an array of any shape."""
        x = _logarithm(force_N)
        with np.errstate(invalid="ignore"):
            relative = np.expm1(self._variance(x)) * (1.0 + self.scatter) + self.scatter
            deviation = self.expected(force_N) * np.sqrt(relative)
        return np.where(np.isfinite(x), deviation, 0.0)

    def force_N(self, intensity: ArrayLike) -> Array:
        """Return the forces [N] for which S has given expected values, in arrays of any shape.

        Because ln E[S] is quadratic in ln F, two forces may have the same expected intensity. The
        larger force is returned, because only at this force the intensity increases with the force.
        The force is 0 for zero intensity.

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
            # Root of c x^2 / 2 + b x = above, in a form without cancellation for small c.
            found = np.exp(2.0 * above / (b + np.sqrt(root))) if c > 0.0 else np.exp(above / b)
        # No force has an intensity below the minimum of the parabola ln E[S].
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
        return alpha + 2.0 * both * x + beta * x * x


def intensity_of(observer: Observer) -> Intensity:
    """Return Stevens' law of an observer, with the uncertainty of the law's parameters."""
    (alpha, both), (_, beta) = observer.covariance[:2, :2].tolist()
    return Intensity(
        log_alpha=float(observer.mean[0]),
        beta=float(observer.mean[1]),
        variances=(max(alpha, 0.0), both, max(beta, 0.0)),
        # Mean of a log-normal sigma^2. It is limited to e^100, so that the moments are finite for a
        # wide posterior with an unknown scatter.
        scatter=exp(min(2.0 * observer.mean[5] + 2.0 * observer.covariance[5, 5], 100.0)),
    )


def _logarithm(force_N: ArrayLike) -> Array:
    """Return ln F for force magnitudes; minus infinity for zero force."""
    with np.errstate(divide="ignore"):
        return np.log(force_N)


@dataclass(frozen=True, kw_only=True)
class Weber:
    """Weber's law with an offset: threshold = kappa (level + offset).

    The threshold is the change of a level (such as a force) at which an observer answers 75 % of
    two-interval trials right. Because the offset is positive, the threshold is positive even at
    zero level.

    Attributes
    ----------
    kappa
        Weber fraction.
    offset
        Constant that is added to the level, positive, in the unit of the level: N, N m or N/m.
    """

    kappa: float
    offset: float

    def __post_init__(self) -> None:
        # The bounds reject a fraction in percent and a wrong unit of the offset. Values of people
        # are 0.05 to 0.23 for the fraction, and from 0.006 N m to 10 N/m for the offset
        # (perception.toml).
        require_range("kappa", self.kappa, 1e-4, 1.0, "use 0.07 for force")
        require_range("offset", self.offset, 1e-6, 1e6, "use 0.2 for force in N")

    def threshold(self, level: ArrayLike) -> Array:
        """Return the thresholds at given levels, in the unit and the shape of the levels."""
        return self.kappa * (np.asarray(level, dtype=float) + self.offset)


def weber_of(observer: Observer, *, quantile: float = 0.5) -> Weber:
    """Return Weber's law for an observer's force threshold [N].

    The Weber fraction of the law is the quantile of the observer's posterior at `quantile`. With
    0.1, for example, the person's true threshold exceeds the returned threshold with a probability
    of 90 %.
    """
    spread = float(np.sqrt(max(observer.covariance[2, 2], 0.0)))
    return Weber(
        kappa=exp(observer.mean[2] + float(ndtri(quantile)) * spread), offset=observer.offset_N
    )


NODES = 4097
"""Number of nodes of a `LogTable`.

For tables over five decades of force, the relative interpolation error is below 1e-6. This holds
for observers whose exponent has a standard deviation of at most 0.5.
"""


class LogTable:
    """Table of a positive function of force, with linear interpolation in log-log scale.

    The interpolation is exact for a power law. Below the first node the function decreases linearly
    to zero. Above the last node the function is proportional to the force.

    Parameters
    ----------
    forces_N
        Forces at the nodes [N], increasing in equal ratios.
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
        """Return the value of the function at a force [N], 0 or more."""
        if force_N < self._first:
            return self._below * force_N
        if force_N >= self._last:
            return self._above * force_N
        place = (log(force_N) - self._start) * self._per_log
        node = int(place)
        here = self._logs[node]
        return exp(here + (place - node) * (self._logs[node + 1] - here))


class ForceMap:
    """Map from a simulated force to the force that a device must play for an observer.

    The played force is called the command. The observer perceives the command as strongly as the
    reference observer perceives ``gain`` times the force.

    The common factor ``gain`` fits the commands into the range of the device. Under Stevens' law, a
    common factor does not change ratios of intensities. ``gain`` is 1 if the command for the force
    ``knee_N`` does not exceed ``knee_N`` with this value. Otherwise ``gain`` is below 1, such that
    the command for ``knee_N`` is ``knee_N``. For two forces F1 and F2 up to ``knee_N``::

        E[S | command(F1)] / E[S | command(F2)] = (F1 / F2)^beta of the reference

    Above ``knee_N``, `tissue.haptics.loop.filters.ForceRange` compresses the force and reports the
    compression.

    Below ``lowest_N``, where the intensity laws were not measured, the map is a straight line to
    zero. The line also bounds the slope of the map, so that the stiffness at the start of a contact
    is finite.

    Parameters
    ----------
    reference, observer
        Intensity laws of the reference observer, and of the observer that feels the command.
    lowest_N
        Positive force below which the map is a straight line [N].
    knee_N
        Largest command that the device plays uncompressed [N]; larger than `lowest_N`.

    Attributes
    ----------
    gain
        Common factor of all forces, at most 1.
    table
        Table of the command [N] as a function of the force.
    intensity, spread
        Tables of the mean and the standard deviation of the perceived intensity, as functions of
        the command.
    steepest
        Largest slope of the map. It is the largest factor by which the map increases the stiffness
        of a contact.

    Raises
    ------
    InputError
        If the map does not increase with the force, because the observer's posterior is too wide.
    """

    def __init__(
        self, reference: Intensity, observer: Intensity, *, lowest_N: float, knee_N: float
    ) -> None:
        self._reference = reference
        self._observer = observer
        need = float(observer.force_N(reference.expected(knee_N)))
        most = float(reference.force_N(observer.expected(knee_N)))
        self.gain = 1.0 if need <= knee_N else most / knee_N
        # Above a hundred times the knee, the table continues in a straight line. Such forces are
        # compressed to the device's limit in any case.
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
        # A thousandth of the knee, a few mN, is below the threshold at zero, kappa offset = 14 mN.
        felt = np.geomspace(1e-3 * knee_N, 100.0 * knee_N, NODES)
        self.intensity = LogTable(felt, observer.expected(felt))
        # For an observer who is known exactly and has no scatter, the spread is 0. The table cannot
        # store the logarithm of 0.
        self.spread = LogTable(felt, np.maximum(observer.spread(felt), 1e-12))

    def command_N(self, force_N: ArrayLike) -> Array:
        """Return the exact commands [N] for force magnitudes [N], without using the table.

        Arrays of any shape are accepted.
        """
        forces = np.asarray(force_N, dtype=float)
        first = self.forces_N[0]
        straight = forces * float(self._exact(first)) / first
        return np.where(forces < first, straight, self._exact(np.maximum(forces, first)))

    def _exact(self, force_N: ArrayLike) -> Array:
        """Return the commands [N] in closed form, without the straight line at low forces."""
        return self._observer.force_N(
            self._reference.expected(self.gain * np.asarray(force_N, dtype=float))
        )
