"""Identifiability of constants from a log.

The module finds constants whose interval is narrower after the fit than before, and combinations of
constants that the log cannot separate.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array
from tissue.fitting.posterior import Posterior
from tissue.fitting.problem import Forward, MeasuredLoads
from tissue.fitting.target import Target, Unpacked
from tissue.materials.constants import Z_95

AT_PRIOR = 0.9
"""Ratio of standard deviations above which a constant counts as unchanged from its prior.

The ratio is the standard deviation after the fit divided by the standard deviation of the prior.

The log narrows the interval of such a constant by less than 10 %.
"""
DETERMINED_CONTRACTION = 0.5
"""Ratio of standard deviations, as for `AT_PRIOR`, below which a constant is determined.

The log then holds more than three times the information of the prior: 1 / 0.5**2 - 1 = 3.
"""
LEAST_SHARE = 0.1
"""Component of an eigenvector below which its constant is not named in a combination.

The eigenvectors are those of the log's information. Each one has length 1 and a component for each
constant. A component below 0.1 adds less than 1 % to the squared length.
"""
ALONE = 0.95
"""Squared component above which an eigenvector is reported as the constant of this component.

The eigenvectors are those of the log's information. If no component exceeds the limit, a determined
eigenvector is reported as a combination of constants.
"""
BETTER = 0.5
"""Ratio of standard deviations below which a combination counts as better known than its constants.

The ratio is the standard deviation of the combination divided by the standard deviation of its
best known constant. Each of these standard deviations is relative to the standard deviation of the
prior.
"""


@dataclass(frozen=True)
class Combination:
    """Weighted sum of constants that a log determines better than each single constant.

    An example is the sum of a chip and an edge coefficient at one feed. The sum approximates a
    weighted mean of the loads if the constants are near the fitted values.

    Attributes
    ----------
    weights
        Weights, keyed by the name of the constant. Each constant is divided by the median of its
        prior before it is weighted. The absolute weights sum to 1.
    value, low, high
        Median, 5 % quantile and 95 % quantile of the combination.
    contraction
        Standard deviation of the combination after the fit, divided by its standard deviation
        before the fit.
    exact_value
        Function that returns the exact value of the combination. The weighted sum is an
        approximation of this value. The argument of the function holds all constants in their own
        units, shape (p,). Only the constants in `weights` change the value.
    """

    weights: dict[str, float]
    value: float
    low: float
    high: float
    contraction: float
    exact_value: Callable[[Array], float]


@dataclass(frozen=True)
class Identified:
    """Constants and combinations that a log determines.

    Attributes
    ----------
    contraction
        Posterior standard deviation of each constant after transformation to a standard normal
        prior, shape (p,). Before the fit, this standard deviation is 1.
    eigenvalues
        Eigenvalues of the log's information relative to the prior's information, shape (p,),
        largest first.
    combinations
        Combinations that are known better than each of their constants.
    """

    names: tuple[str, ...]
    contraction: Array
    eigenvalues: Array
    combinations: tuple[Combination, ...]

    @property
    def determined(self) -> tuple[str, ...]:
        """Single constants that the log determines."""
        return tuple(np.array(self.names)[self.contraction < DETERMINED_CONTRACTION].tolist())

    @property
    def at_prior(self) -> tuple[str, ...]:
        """Constants whose interval the log narrows by less than 10 %."""
        return tuple(np.array(self.names)[self.contraction > AT_PRIOR].tolist())

    @property
    def is_empty(self) -> bool:
        """True if the log determines no constant and no combination."""
        return not self.determined and not self.combinations


def identified(posterior: Posterior) -> Identified:
    """Return the constants and the combinations that a log determines.

    Let z be the constants transformed so that their prior is standard normal. The combinations
    follow from the eigenvectors of the Fisher information about z. The nuisance parameters are
    treated as unknown. Each eigenvector is the gradient of a weighted mean of the loads with
    respect to z. A combination is this mean and not a weighted sum of z. The reason is that the
    gradient may change along a curve of constant mean.
    """
    target = posterior.target
    contraction = posterior.spreads
    of_z, measured = _separated(target, posterior.maximum, posterior.nuisances)
    values, vectors = np.linalg.eigh(of_z.T @ measured)
    eigenvalues = np.maximum(values, 0.0)[::-1]
    directions = [
        (value, vector)
        for value, vector in zip(eigenvalues, vectors.T[::-1], strict=True)
        if 1.0 / (1.0 + value) < DETERMINED_CONTRACTION**2 and np.max(vector**2) < ALONE
    ]
    found = [
        _combination(posterior, measured @ vector, vector, value) for value, vector in directions
    ]
    alone = dict(zip(posterior.names, contraction.tolist(), strict=True))
    better = [
        each
        for each in found
        if each.contraction < BETTER * min(alone[name] for name in each.weights)
    ]
    return Identified(posterior.names, contraction, eigenvalues, tuple(better))


def _separated(target: Target, u: Array, noise: Unpacked) -> tuple[Array, Array]:
    """Return the whitened derivatives dL/dz of the loads L, and the part that only z can explain.

    This part excludes load changes that the clock offset and the biases can also explain, within
    their priors. Both results have the shape (m * channels, p).
    """
    columns = target.whitened(target.linearised(u)[1], noise)
    of_z = columns[:, : target.constants]
    others = columns[:, target.constants :]
    free = others.T @ others + np.eye(others.shape[1])
    return of_z, of_z - others @ np.linalg.solve(free, others.T @ of_z)


def _combination(
    posterior: Posterior, mean: Array, direction: Array, information: float
) -> Combination:
    """Return the combination for an eigenvector of the information about z.

    Here z are the standard normal numbers of the constants. The combination is the sum of the
    whitened loads with the weights `mean`, shape (m * channels,). The derivative of this sum with
    respect to z is `information` times `direction`. Constants with little influence are not named,
    but their uncertainty widens the interval.
    """
    target = posterior.target
    noise = posterior.nuisances
    x = target.x(posterior.mean_z)

    def measure(constants: Array) -> float:
        loads = target.loads(constants, noise.offset_s)[:, :, None]
        return float(mean @ target.whitened(loads, noise)[:, 0])

    median = np.array([prior.x(0.0) for prior in posterior.priors])
    named = np.abs(direction) >= LEAST_SHARE
    direction = np.where(named, direction, 0.0)
    deviation = np.sqrt(float(direction @ posterior.covariance_z @ direction))
    slopes = information * direction / target.slopes(posterior.mean_z)
    # A constant whose prior has the median 0 has no weight over that median.
    weights = slopes * median
    total = float(slopes @ x)
    unit = float(np.sign(total) * np.abs(weights).sum()) or 1.0
    constant = measure(x) - total
    value = total / unit
    half = Z_95 * information * deviation / abs(unit)
    order = np.argsort(-np.abs(direction)).tolist()
    return Combination(
        {posterior.names[at]: float(weights[at] / unit) for at in order if named[at]},
        value,
        value - half,
        value + half,
        float(deviation / np.linalg.norm(direction)),
        lambda constants: (measure(np.where(named, constants, x)) - constant) / unit,
    )


@dataclass(frozen=True)
class Gain:
    """Information that a log is expected to add if it is measured next.

    Attributes
    ----------
    label
        Description of the candidate log.
    nats
        Expected information gain about all constants [nats].
    widest
        Constant whose interval is the widest before the candidate log.
    shrinks_to
        Interval width of the constant `widest` after the candidate log, divided by the width before
        the candidate log.
    """

    label: str
    nats: float
    widest: str
    shrinks_to: float


def expected_information(
    posterior: Posterior, candidates: Mapping[str, Forward], *, among: Sequence[int] = ()
) -> list[Gain]:
    """Return the expected information gains of candidate logs, largest first.

    The candidates are assumed to have the same noise as the measured log. The information gain is
    0.5 ln det(I + C M). I is the identity, and C is the present covariance of z, the constants
    transformed to standard normal numbers. M is the Fisher information of the candidate with an
    unknown bias (Chaloner and Verdinelli 1995, linearised at the maximum).

    Parameters
    ----------
    posterior
        Posterior of the measured log.
    candidates
        Forward model of each candidate log, keyed by name. Each model has the constants of
        `posterior`.
    among
        Indices of the constants that are candidates for `Gain.widest`. Default: all constants.
        Default: all constants.
    """
    now = posterior.covariance_z
    places = list(among) or list(range(len(now)))
    at = places[int(np.argmax(np.diag(now)[places]))]
    values, vectors = np.linalg.eigh(now)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    gains = []
    for label, forward in candidates.items():
        grown, axes = np.linalg.eigh(
            np.eye(len(now)) + root.T @ _information(posterior, forward) @ root
        )
        # eigenvalues of the identity plus information are at least 1; smaller ones are rounding
        grown = np.maximum(grown, 1.0)
        nats = 0.5 * float(np.log(grown).sum())
        after = float(np.sum((root[at] @ axes) ** 2 / grown))
        gains.append(Gain(label, nats, posterior.names[at], float(np.sqrt(after / now[at, at]))))
    return sorted(gains, key=lambda each: -each.nats)


def _information(posterior: Posterior, forward: Forward) -> Array:
    """Return the Fisher information, shape (p, p), of a candidate log about z.

    Here z are the standard normal numbers of the constants. The biases and the clock offset of the
    candidate are free. The candidate is evaluated at the rate of the measured log, because the
    noise depends on the rate.
    """
    measured = posterior.target.log
    rate_s = float(np.median(np.diff(measured.times_s)))
    every = max(round(rate_s / float(np.median(np.diff(forward.times_s)))), 1)
    times_s = forward.times_s[::every]
    loads = np.zeros((len(times_s), len(measured.channels)))
    log = MeasuredLoads(times_s, loads, measured.channels)
    target = Target(forward, log, sizes=measured.sizes())
    u = posterior.maximum.copy()
    u[target.constants] = 0.0
    of_z, separated = _separated(target, u, posterior.nuisances)
    return of_z.T @ separated
