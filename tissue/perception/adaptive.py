"""Estimation of the parameters of one person's force perception.

The threshold for force differences is estimated from adaptive comparisons of two forces (QUEST+).
Stevens' power law is estimated from forces that the person rates with numbers.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import digamma, polygamma
from scipy.stats import beta, norm, t

from meshes.base.arrays import Array, Flags
from meshes.base.errors import InputError, require_positive, require_range
from tissue.perception.laws import two_interval

EDGE_MASS = 0.05
"""Largest accepted posterior mass in the outermost two cells at each bound of the Weber fraction.

With a larger mass, the bound of the prior determines the estimate more than the data.
"""
BASES_N = (0.3, 0.8, 2.0)
STEP_COUNT = 25
"""Number of steps (differences of two forces) for each base force in `BASES_N` [N].

A base force is the smaller force of a pair. With three base forces and 25 steps, the RMS error of
the threshold is 20 % (300 simulated observers, 80 trials). With one base force, or with 12 or 50
steps, the error is between 19 and 21 %.
"""
STEPS = (0.005, 1.5)
"""Smallest and largest step of a pair of forces, divided by (base force + `LOW_FORCE_N`).

The range contains the thresholds of the prior, which are 0.015 to 0.6 in the same ratio.
"""
LOW_FORCE_N = 0.2
"""Median of the prior of the low-force term in Weber's law [N].

The threshold is the Weber fraction times (force + low-force term). The range of the term in
`tissue/materials/perception.toml` is 0.1 to 0.3 N (low confidence).
"""
LARGEST_LAPSE = 0.2
LAPSE_POWER = 2.5
LAPSE_PRIOR = (0.5, 5.0)
"""Parameters of the Beta prior of the lapse rate, the share of accidental wrong answers.

The prior is evaluated on a grid whose cell edges are `LARGEST_LAPSE` times x ** `LAPSE_POWER`, for
equally spaced x from 0 to 1.

With cells of equal width (exponent 1) the bias of the threshold is -4 %. With exponents of 2.5 and
4, and with largest lapse rates of 0.1 and 0.4, the bias is 1.4 % or less (300 simulated observers,
80 trials).
"""


MAGNITUDE_FORCES_N = (0.3, 0.5, 0.8, 1.3, 2.0, 3.2)
"""Forces that the observer rates with numbers [N]; successive forces have about equal ratios."""
PRIOR_MEAN = (0.0, 1.4)
"""Prior means of ln alpha and beta in Stevens' law, intensity = alpha (force / 1 N) ** beta.

The mean of beta is between the published exponents for pressure on the palm (1.1) and for muscle
force (1.7).
"""
PRIOR_WEIGHT = 1.0 / 16.0
"""Prior precision of ln alpha and beta, in units of the precision of one reported number.

If reported numbers have a relative scatter of 0.25, the prior standard deviation is 1.
"""
PRIOR_SHAPE = 2.0
PRIOR_SCALE = 0.12
"""Scale of the inverse-gamma prior of sigma^2, whose shape is `PRIOR_SHAPE`.

Here sigma is the relative scatter of reported numbers. The prior mean of sigma^2 is 0.12, which
corresponds to a scatter of about 0.3.
"""


@dataclass(frozen=True, kw_only=True)
class ThresholdPrior:
    """Joint prior of Weber fraction, low-force term and lapse rate on a grid.

    The Weber fraction has a log-normal prior between two bounds. The low-force term has a
    log-normal prior between 0.05 and 0.8 N, with a median of 0.2 N and a geometric standard
    deviation of 1.65. The lapse rate (share of accidental wrong answers) has the prior Beta(0.5,
    5), limited to at most 0.2. Schuett et al. (2016) use Beta(1, 10), which has the same mean but
    counts as twice as many observations. Grid cells of the Weber fraction have equal width in the
    logarithm. Grid cells of the lapse rate are narrow at small rates. With wide cells at small
    rates, the thresholds of observers with few lapses would be estimated 12 % too low.

    Attributes
    ----------
    weber
        Median of the Weber fraction. Pang, Tan and Durlach (1991) measured 7 %. At low forces, the
        fraction is up to four times larger.
    weber_log_spread
        Standard deviation of the logarithm of the Weber fraction.
    lowest, highest
        Lower and upper bound of the Weber fraction.
    cells, offset_cells, lapse_cells
        Numbers of grid cells of the Weber fraction, the low-force term and the lapse rate.
    """

    weber: float = 0.09
    weber_log_spread: float = 0.6
    lowest: float = 0.015
    highest: float = 0.6
    cells: int = 61
    offset_cells: int = 7
    lapse_cells: int = 4

    def __post_init__(self) -> None:
        require_positive("weber", self.weber, "use a value such as 0.09")
        require_positive("weber_log_spread", self.weber_log_spread, "use a value such as 0.6")
        require_positive("lowest", self.lowest, "use a value such as 0.015")
        # A fraction of 10 or more was probably given in percent.
        if not self.lowest < self.highest < 10.0:
            raise InputError(
                "highest", f"be in ({self.lowest:g}, 10)", self.highest, "use a value such as 0.6"
            )
        # `edge_mass` reads two cells at each bound, and these must be different cells. The limit of
        # 1000 cells bounds the memory of the likelihoods.
        for name, least in (("cells", 5), ("offset_cells", 1), ("lapse_cells", 1)):
            require_range(name, getattr(self, name), least, 1000, "see the defaults")

    @property
    def weber_edges(self) -> Array:
        """Edges of the grid cells of the Weber fraction, shape (cells + 1,)."""
        return np.geomspace(self.lowest, self.highest, self.cells + 1)

    @property
    def webers(self) -> Array:
        """Centres of the grid cells of the Weber fraction, shape (cells,)."""
        edges = self.weber_edges
        return np.sqrt(edges[1:] * edges[:-1])

    def parameters(self) -> tuple[Array, Array, Array, Array]:
        """Return Weber fraction, low-force term [N], lapse rate and prior mass of each grid point.

        Each of the four arrays has shape (n,), for the n grid points.
        """
        offsets = (
            # From LOW_FORCE_N / 4 to 4 LOW_FORCE_N, nearly three standard deviations of the prior.
            np.geomspace(0.05, 0.8, self.offset_cells)
            if self.offset_cells > 1
            else np.array([LOW_FORCE_N])
        )
        lapse_edges = LARGEST_LAPSE * np.linspace(0.0, 1.0, self.lapse_cells + 1) ** LAPSE_POWER
        lapses = 0.5 * (lapse_edges[1:] + lapse_edges[:-1])
        masses = (
            norm.pdf(np.log(self.webers / self.weber), scale=self.weber_log_spread)[:, None, None]
            # ln 1.65 = 0.5. The range 0.1 to 0.3 N of the literature is then about plus and minus
            # one standard deviation.
            * norm.pdf(np.log(offsets / LOW_FORCE_N), scale=0.5)[:, None]
            * np.diff(beta.cdf(lapse_edges, *LAPSE_PRIOR))
        )
        grid = np.meshgrid(self.webers, offsets, lapses, indexing="ij")
        weber, offset, lapse = (values.ravel() for values in grid)
        return weber, offset, lapse, (masses / masses.sum()).ravel()


def comparisons(
    bases_N: tuple[float, ...] = BASES_N, *, force_limit_N: float = 3.3
) -> tuple[Array, Array]:
    """Return base forces and steps [N] of pairs that may be compared, shape (n,) each.

    The two forces of a pair are the base force, and the base force plus the step. At each base
    force, successive steps have equal ratios.

    Parameters
    ----------
    bases_N
        Base forces of the pairs [N].
    force_limit_N
        Largest force that the device can play [N]; pairs with a larger force are left out. The
        default is the limit of the haptic device Touch.
    """
    bases = np.repeat(bases_N, STEP_COUNT)
    steps = np.tile(np.geomspace(*STEPS, STEP_COUNT), len(bases_N)) * (bases + LOW_FORCE_N)
    fits = bases + steps <= force_limit_N
    return bases[fits], steps[fits]


class AdaptiveThreshold:
    """Adaptive estimation of force thresholds, from comparisons of two forces.

    `propose` chooses the comparison that minimises the expected entropy of the posterior after the
    answer. This rule is from QUEST+ (Watson, 2017). It is equivalent to maximising the mutual
    information between answer and parameters. The likelihoods and entropies of all comparisons are
    computed in advance, so each trial needs only two matrix-vector products.

    Parameters
    ----------
    prior
        Prior before the first trial.
    stimuli
        Base forces [N] and steps [N] of the pairs that may be compared; default `comparisons()`.
    observers
        Number of observers that answer in parallel. Each observer has a separate posterior.

    Attributes
    ----------
    base_N, step_N
        Base forces and steps [N] of the pairs that may be compared, each of shape (n,).
    posterior
        Probability masses of the grid points, shape (points, observers).
    """

    def __init__(
        self,
        prior: ThresholdPrior | None = None,
        stimuli: tuple[Array, Array] | None = None,
        *,
        observers: int = 1,
    ) -> None:
        self.prior = prior or ThresholdPrior()
        self.base_N, self.step_N = stimuli or comparisons()
        self._weber, self._offset, self._lapse, masses = self.prior.parameters()
        self.posterior: Array = np.tile(masses[:, None], observers)
        self._right = two_interval(
            self.base_N[:, None], self.step_N[:, None], self._weber, self._offset, self._lapse
        )
        wrong = 1.0 - self._right
        self._entropy = -(self._right * np.log(self._right) + wrong * np.log(wrong))

    def propose(self) -> NDArray[np.intp]:
        """Return the index of the most informative comparison of each observer, shape (observers,).

        The index refers to `base_N` and `step_N`.
        """
        # If rounding made a share equal to 1, its entropy 0 log 0 would be NaN.
        right = np.clip(self._right @ self.posterior, 1e-12, 1.0 - 1e-12)
        marginal = -(right * np.log(right) + (1.0 - right) * np.log1p(-right))
        return np.argmax(marginal - self._entropy @ self.posterior, axis=0)

    def answer(self, asked: NDArray[np.intp], correct: Flags) -> None:
        """Update the posterior with the answer of each observer to a comparison."""
        likelihood = self._right[asked].T
        self.posterior *= np.where(correct, likelihood, 1.0 - likelihood)
        self.posterior /= self.posterior.sum(axis=0)

    def weber_masses(self) -> Array:
        """Return the marginal posterior of the Weber fraction, shape (cells, observers)."""
        return self.posterior.reshape(self.prior.cells, -1, self.posterior.shape[1]).sum(axis=1)

    def weber(self) -> tuple[Array, Array]:
        """Return the geometric mean and the logarithmic spread of the Weber fraction.

        The spread is the standard deviation of the logarithm. Both arrays have shape (observers,).
        """
        return self._log_moments(self._weber)

    def offset_N(self) -> Array:
        """Return the geometric mean of the low-force term [N], shape (observers,)."""
        return self._log_moments(self._offset)[0]

    def _log_moments(self, values: Array) -> tuple[Array, Array]:
        """Return the geometric mean of a quantity, and the standard deviation of its logarithm.

        `values` contains the quantity, which is positive, at the grid points.
        """
        logs = np.log(values)
        mean = logs @ self.posterior
        return np.exp(mean), np.sqrt(np.maximum(logs**2 @ self.posterior - mean**2, 0.0))

    def weber_quantiles(self, shares: Array) -> Array:
        """Return quantiles of the Weber fraction at the probabilities `shares`.

        The result has shape (n, observers) for n probabilities. Within a grid cell, the logarithm
        of the Weber fraction is interpolated linearly.
        """
        edges = np.log(self.prior.weber_edges)
        below = np.vstack(
            [np.zeros(self.posterior.shape[1]), np.cumsum(self.weber_masses(), axis=0)]
        )
        return np.exp(np.column_stack([np.interp(shares, column, edges) for column in below.T]))

    def edge_mass(self) -> tuple[Array, Array]:
        """Return the posterior mass near the lower and near the upper bound of the Weber fraction.

        Each of the two arrays has shape (observers,). It contains the mass in the two grid cells
        next to a bound.
        """
        # Two of the default cells cover 12 % of the Weber fraction.
        masses = self.weber_masses()
        return masses[:2].sum(axis=0), masses[-2:].sum(axis=0)


@dataclass(frozen=True)
class MagnitudePosterior:
    """Posterior of Stevens' law ln S = ln alpha + beta ln F + sigma e, given reported numbers.

    S is the reported number, F the force [N], and e a random number with a standard normal
    distribution. The posterior is a normal-inverse-gamma distribution. Source: Gelman et al., 2013,
    section 14.2.

    Attributes
    ----------
    mean
        Mean of (ln alpha, beta), shape (2,).
    precision
        Precision of (ln alpha, beta) in units of 1 / sigma^2, shape (2, 2).
    shape, scale
        Shape and scale of the inverse-gamma posterior of sigma^2.
    """

    mean: Array
    precision: Array
    shape: float
    scale: float

    @property
    def covariance(self) -> Array:
        """Covariance of (ln alpha, beta), shape (2, 2)."""
        return np.asarray(self.scale / (self.shape - 1.0) * np.linalg.inv(self.precision))

    def log_sigma(self) -> tuple[float, float]:
        """Return the mean and variance of ln sigma."""
        # half of the mean and a quarter of the variance of ln sigma^2
        return 0.5 * float(np.log(self.scale) - digamma(self.shape)), 0.25 * float(
            polygamma(1, self.shape)
        )

    def exponent_at(self, shares: ArrayLike) -> Array:
        """Return the quantiles of the exponent beta at the probabilities in `shares`."""
        width = np.sqrt(self.scale / self.shape * np.linalg.inv(self.precision)[1, 1])
        return self.mean[1] + width * t.ppf(shares, 2.0 * self.shape)


def fit_magnitudes(forces_N: ArrayLike, numbers: ArrayLike) -> MagnitudePosterior:
    """Compute the posterior of Stevens' law from reported numbers.

    For empty arrays, the result is the prior.

    The factor alpha depends on the number scale that the observer has chosen. It is therefore not a
    measure of the perceived intensity alone.

    Parameters
    ----------
    forces_N
        Forces [N], positive, shape (n,).
    numbers
        Numbers with which the observer rated the forces, positive, shape (n,).
    """
    log_forces = np.log(forces_N)
    logarithms = np.log(numbers)
    design = np.column_stack([np.ones(len(log_forces)), log_forces])
    prior = PRIOR_WEIGHT * np.eye(2)
    precision = prior + design.T @ design
    start = np.array(PRIOR_MEAN)
    mean = np.linalg.solve(precision, prior @ start + design.T @ logarithms)
    scale = PRIOR_SCALE + 0.5 * float(
        logarithms @ logarithms + start @ prior @ start - mean @ precision @ mean
    )
    return MagnitudePosterior(mean, precision, PRIOR_SHAPE + 0.5 * len(design), scale)
