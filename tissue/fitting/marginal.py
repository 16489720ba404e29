"""Marginal distribution of one fitted parameter, by Laplace's approximation of the others.

The density of a parameter is evaluated on a grid. At each grid value, the other parameters are
integrated out by Laplace's approximation about their most probable values (Tierney and Kadane
1986). A normal distribution about the most probable value would not be accurate enough in three
cases:

- A constant whose range spans decades, such as a value of 0.01 with a range from 0 to 0.1. The
  likelihood is symmetric in the value, but not in its standard normal number. With a normal
  distribution, the coefficient of a load that is hidden by noise would count as determined
  (``tests/tissue/fitting/test_marginal.py``).
- The offset of the clocks. If a load jumps between two samples of a log, all offsets that keep the
  jump between these samples explain the log equally well. In 100 simulated logs, the interval of
  the normal distribution contained the true offset in 78 %, and the interval of the grid in 83 %
  (``tests/bench/bench_fit_cutting.py block``).
- Constants whose cited value is an end of their range, such as the size exponent 0 of bone. A
  half-normal prior is not suitable, because none of its draws is the cited value. None of its
  intervals would contain the cited value, and other constants that the log cannot separate from
  this constant would be shifted. The prior used here is a normal distribution that is cut off at
  the cited value. The probability of values beyond this end is assigned to the end itself. The
  cited value therefore has half of the probability, and is the median. The other half is spread
  towards the far end of the range, which is the 95 % quantile. The maximum is found with the whole
  normal distribution (`Prior.mirrored`). With ``z`` measured away from the end, Dirac's ``delta``
  and the normal density ``phi``, the ratio of the prior to the normal distribution is::

      0.5 delta(z) / phi(0) + (1 where z > 0)
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
from scipy.integrate import cumulative_trapezoid, trapezoid
from scipy.interpolate import PchipInterpolator
from scipy.special import log_ndtr, logsumexp, ndtri_exp
from scipy.stats.qmc import Sobol

from meshes.base.arrays import Array
from tissue.fitting.target import OFFSET_S, Target
from tissue.materials.constants import Z_95

STEPS = np.cumsum(0.4 * 1.25 ** np.arange(16))
"""Grid points on each side of the maximum.

The unit is the standard deviation of the normal approximation. The last grid point is 55 standard
deviations away, because the density of a constant can be flat over many standard deviations.
"""
WITHIN = np.linspace(0.05, 3.0, 60)
ABOUT = np.linspace(0.25, 4.0, 16)
"""Grid points for the clock offset, in standard deviations of the normal approximation.

`WITHIN` contains further grid points, in sampling intervals of the log.
"""
NEGLIGIBLE = 10.0
"""Decrease of the log density from its maximum at which the grid ends."""
STEEP = 3.0
HALVINGS = 4
"""Largest number of halvings of an interval of the grid.

`STEEP` is the decrease of the log density above which an interval is halved.
"""
FINE = 20
"""Number of quadrature points between two grid points."""
SHARES = np.array([0.05, 0.5, 0.95])
PRIOR_SPREAD = float(np.sqrt(0.5 - 0.5 / np.pi))
"""Standard deviation of a standard normal variable whose negative values are set to 0."""
END = float(0.5 * np.sqrt(2.0 * np.pi))
"""Probability of the cited value under the cut-off prior, divided by the normal density there."""
POINTS = 256
"""Number of points of the quasi-Monte Carlo integral in `log_factor`.

The error of the integral is below 1 % for three correlated constants.
"""


@dataclass(frozen=True)
class Marginal:
    """Marginal distribution of one fitted parameter (constant or clock offset).

    Attributes
    ----------
    quantiles
        Quantiles at 5, 50 and 95 %, shape (3,).
    spread
        Standard deviation of the parameter, divided by the standard deviation of its prior.
    """

    quantiles: Array
    spread: float

    def widened(self, deviation: float) -> "Marginal":
        """Return the distribution after an independent error is added to the parameter."""
        low, middle, high = self.quantiles.tolist()
        reach = Z_95 * deviation
        widest = [
            middle - float(np.hypot(middle - low, reach)),
            middle,
            middle + float(np.hypot(high - middle, reach)),
        ]
        return Marginal(np.array(widest), float(np.hypot(self.spread, deviation)))


def marginal(target: Target, maximum: Array, covariance: Array, at: int) -> Marginal:
    """Compute the marginal distribution of one parameter for fixed noise parameters.

    Parameters
    ----------
    target
        Log density.
    maximum, covariance
        Maximum, shape (size,), and covariance, shape (places, places), of the normal approximation.
    at
        Index of the constant or offset in `maximum`.
    """
    spread = float(np.sqrt(covariance[at, at]))
    along = np.zeros(target.size)
    along[: target.places] = covariance[:, at] / covariance[at, at]
    side = 0.0
    distances = spread * STEPS
    patience = 0.0
    start = maximum
    if at == target.constants:
        # one sample of the log, in standard deviations of the offset's prior
        patience = float(np.median(np.diff(target.log.times_s))) / OFFSET_S
        distances = np.unique(np.concatenate([patience * WITHIN, spread * ABOUT]))
    else:
        side = float(target.sides[at])
        # a maximum beyond the end of a one-sided constant is moved to the end
        start = maximum - min(side * maximum[at], 0.0) * side * along
    first = log_density_at(target, start, at)
    found = {float(start[at]): first}
    for sign in (-1.0, 1.0):
        places = start[at] + sign * distances
        if side:
            places = side * np.maximum(side * places, 0.0)
        found |= _walked(target, at, first, along, places, patience)
    _refine(target, at, found)
    return _law({place: log_density for place, (log_density, _) in found.items()}, side)


def log_density_at(target: Target, start: Array, at: int) -> tuple[float, Array]:
    """Compute the marginal log density of one parameter, and the most probable other values.

    The other constants, the offset and the biases are integrated out by Laplace's approximation.

    Parameters
    ----------
    target
        Log density.
    start
        Start of the search, shape (size,). The parameter with index `at` and the noise parameters
        keep their values.
    at
        Index of the parameter.
    """
    log_density, u = target.climbed(start, held=at)
    others = np.delete(np.arange(target.places), at)
    information = target.information(u)[np.ix_(others, others)]
    log_density -= 0.5 * float(np.linalg.slogdet(information)[1])
    bounded = np.flatnonzero(np.isin(others, np.flatnonzero(target.sides)))
    sides = target.sides[others[bounded]]
    covariance = np.asarray(np.linalg.inv(information), dtype=np.float64)[np.ix_(bounded, bounded)]
    covariance = covariance * np.outer(sides, sides)
    return log_density + log_factor(sides * u[others[bounded]], covariance), u


def log_factor(mean: Array, covariance: Array) -> float:
    """Compute the log ratio of the evidence with one-sided priors to that with normal priors.

    With normal priors, the posterior is normal. The evidence with one-sided priors is an integral
    over the numbers that have these priors. The integral is computed for one number at a time
    (Geweke, Hajivassiliou and Keane). For each conditional distribution, the probabilities of zero
    and of positive values have closed forms.

    Parameters
    ----------
    mean, covariance
        Mean, shape (k,), and covariance, shape (k, k), of the one-sided numbers under the normal
        prior. A positive value lies inside the range of the constant.
    """
    if not len(mean):
        return 0.0
    root = np.linalg.cholesky(covariance)
    uniform = _uniform(len(mean))
    drawn = np.zeros_like(uniform)
    logarithms = np.zeros(len(uniform))
    for at, spread in enumerate(np.diag(root).tolist()):
        ratio = (mean[at] + drawn[:, :at] @ root[at, :at]) / spread
        # half of the prior's probability is at the end, see the module's description
        zero = np.log(0.5) - 0.5 * ratio**2 - np.log(spread)
        above = log_ndtr(ratio)
        both = np.logaddexp(zero, above)
        logarithms += both
        share = np.exp(zero - both)
        # the limits keep the logarithm finite where the end has all of the probability
        rest = np.clip((1.0 - uniform[:, at]) / np.maximum(1.0 - share, 1e-300), 1e-12, 1.0)
        drawn[:, at] = np.where(uniform[:, at] < share, -ratio, -ndtri_exp(np.log(rest) + above))
    return float(logsumexp(logarithms) - np.log(len(logarithms)))


@cache
def _uniform(count: int) -> Array:
    """Return quasi-random points of the unit cube, shape (POINTS, count)."""
    return Sobol(count, scramble=True, rng=0).random(POINTS)


def _walked(
    target: Target,
    at: int,
    first: tuple[float, Array],
    along: Array,
    places: Array,
    patience: float,
) -> dict[float, tuple[float, Array]]:
    """Return log densities, and the best other numbers, at growing distances from a value.

    The search ends when the density has been negligible over a range longer than `patience`. This
    range matters for the clock offset, because the density may rise again within a sampling
    interval of the log.
    """
    found: dict[float, tuple[float, Array]] = {}
    highest, u = first
    last = float(u[at])
    for wanted in places.tolist():
        if wanted == u[at]:  # the end of a one-sided constant
            break
        log_density, place = log_density_at(target, u + (wanted - u[at]) * along, at)
        found[wanted] = (log_density, place)
        along = (place - u) / (wanted - u[at])  # the others follow along a curve
        u = place
        highest = max(highest, log_density)
        if log_density > highest - NEGLIGIBLE:
            last = wanted
        elif abs(wanted - last) > patience:
            break
    return found


def _refine(target: Target, at: int, found: dict[float, tuple[float, Array]]) -> None:
    """Add grid points in the middle of intervals over which the log density changes steeply."""
    highest = max(log_density for log_density, _ in found.values())
    for _ in range(HALVINGS):
        for low, high in pairwise(sorted(found)):
            ends = [found[low][0], found[high][0]]
            if max(ends) - min(ends) > STEEP and max(ends) > highest - NEGLIGIBLE:
                found[0.5 * (low + high)] = log_density_at(
                    target, 0.5 * (found[low][1] + found[high][1]), at
                )


def _law(found: Mapping[float, float], side: float) -> Marginal:
    """Return the distribution of a number from its log density at grid points.

    For a one-sided number, the value 0 itself has a positive probability.
    """
    # a one-sided number is handled as a positive one
    sign = side or 1.0
    logarithms = {sign * place: logarithm for place, logarithm in found.items()}
    places = np.array(sorted(logarithms))
    heights = np.array([logarithms[each] for each in places.tolist()])
    fine = np.interp(
        np.linspace(0.0, len(places) - 1.0, FINE * (len(places) - 1) + 1),
        np.arange(len(places)),
        places,
    )
    density = np.exp(PchipInterpolator(places, heights - heights.max())(fine))
    # the grid reaches the end of a one-sided number, where part of the probability lies
    end = END * float(density[0]) if side and fine[0] == 0.0 else 0.0
    summed = end + cumulative_trapezoid(density, fine, initial=0.0)
    mean = float(trapezoid(density * fine, fine)) / summed[-1]
    square = float(trapezoid(density * fine**2, fine)) / summed[-1]
    spread = float(np.sqrt(square - mean**2)) / (PRIOR_SPREAD if side else 1.0)
    return Marginal(np.sort(sign * np.interp(SHARES * summed[-1], summed, fine)), spread)
