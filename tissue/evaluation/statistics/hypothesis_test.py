"""Result of a hypothesis test, and functions for effect sizes and checks of assumptions.

The result contains the size of the effect with an interval, the assumptions with their checks, and
other tests of the same question.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import nctdtrinc
from scipy.stats import kurtosis, ncf, shapiro, skew, skewtest

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from meshes.base.extras import install_command

ALPHA = 0.05
"""Significance level: probability that a test rejects if there is no effect."""
LEVEL = 0.95
"""Coverage of the intervals."""
TAILS = (0.5 * (1.0 + LEVEL), 0.5 * (1.0 - LEVEL))
"""Probabilities that define the lower and the upper end of an interval.

If the true value is the lower end, a result below the measured result has the first probability. If
the true value is the upper end, such a result has the second probability.
"""
MOST = 5000
"""Largest sample for which the p value of Shapiro and Wilk's test is known (Royston 1995)."""


@dataclass(frozen=True)
class Assumption:
    """Assumption of a hypothesis test, checked on the data of the test.

    Attributes
    ----------
    name
        Name of the assumption, such as "normal residuals".
    holds
        True if the check did not reject the assumption at the level :data:`ALPHA`. In a small
        sample, a check that does not reject is weak evidence.
    finding
        Name and numerical results of the check, as text.
    """

    name: str
    holds: bool
    finding: str


@dataclass(frozen=True)
class Effect:
    """Size of an effect, with an interval of coverage :data:`LEVEL`.

    The ends of the interval are infinite if the users are too few for an interval.
    """

    name: str
    value: float
    low: float
    high: float

    def __str__(self) -> str:
        if not np.isfinite(self.high - self.low):
            return f"{self.name} {self.value:.3g}, no 95 % interval"
        return f"{self.name} {self.value:.3g} [{self.low:.3g}, {self.high:.3g}]"


@dataclass(frozen=True)
class HypothesisTest:
    """Result of one hypothesis test.

    Attributes
    ----------
    test
        Name of the test.
    question
        Tested metric and effect, such as "force_error: method".
    statistic_name, statistic, degrees
        Name of the test statistic, such as F, its value and its degrees of freedom.
    p
        Probability of a statistic that is at least as large as the measured one, if there is no
        effect.
    effect
        Size of the effect, if the test has one.
    assumptions
        Assumptions of the test.
    alternatives
        Other tests of the same question. They are reported, but do not affect conclusions.
    note
        Remark on the test. May be empty.
    """

    test: str
    question: str
    statistic_name: str
    statistic: float
    degrees: tuple[float, ...]
    p: float
    effect: Effect | None = None
    assumptions: tuple[Assumption, ...] = ()
    alternatives: tuple["HypothesisTest", ...] = ()
    note: str = ""

    @property
    def sound(self) -> bool:
        """True if no assumption of the test was rejected."""
        return all(each.holds for each in self.assumptions)

    @property
    def found(self) -> bool:
        """True if the test is significant at the level :data:`ALPHA`."""
        return self.p <= ALPHA

    @property
    def figures(self) -> str:
        """Statistic, degrees of freedom and p value as text."""
        degrees = f"({', '.join(f'{each:.4g}' for each in self.degrees)})" if self.degrees else ""
        return f"{self.statistic_name}{degrees} = {self.statistic:.4g}, {format_p(self.p)}"


def format_p(p: float) -> str:
    """Return a p value as text, such as "p = 0.0123" or "p < 0.0001"."""
    if not np.isfinite(p):
        return "p unknown"
    # smaller values depend on the tails of the assumed law
    return "p < 0.0001" if p < 1e-4 else f"p = {p:.4f}"


def require_statsmodels() -> None:
    """Raise an error if statsmodels is not installed."""
    try:
        import statsmodels  # noqa: F401
    except ImportError:
        raise InputError(
            "statsmodels must be installed for the statistics of a study. Run "
            f"{install_command('study')}"
        ) from None


def cohens_d(first: ArrayLike, second: ArrayLike, *, paired: bool = False) -> Effect:
    """Return Cohen's d: the difference of two means divided by a standard deviation (Cohen 1988).

    The interval from the noncentral t distribution (Steiger and Fouladi 1997) is exact for normal
    samples of equal variance.

    Parameters
    ----------
    first, second
        Samples of two or more finite values, one per user. In paired samples, entry i of both
        samples belongs to the same user.
    paired
        If true, divide by the standard deviation of the differences ("d of differences"), not by
        the pooled standard deviation of the samples. The name of the returned effect shows the kind
        of d.

    Raises
    ------
    InputError
        If the standard deviation in the denominator is zero.
    """
    one = np.asarray(first, dtype=float)
    other = np.asarray(second, dtype=float)
    if paired:
        degrees = len(one) - 1
        spread = (one - other).std(ddof=1)
        scale = len(one) ** 0.5
    else:
        degrees = len(one) + len(other) - 2
        spread = np.sqrt((one.var() * len(one) + other.var() * len(other)) / degrees)
        scale = (len(one) * len(other) / (len(one) + len(other))) ** 0.5
    if spread == 0.0:
        raise InputError(
            "samples",
            "have values that vary within a sample",
            "a spread of 0",
            "leave this comparison out: the standardised difference needs a spread",
        )
    value = (one.mean() - other.mean()) / spread
    low, high = (nctdtrinc(degrees, chance, value * scale) / scale for chance in TAILS)
    return Effect("Cohen's d of differences" if paired else "Cohen's d", value, low, high)


def partial_eta_squared(statistic: float, above: float, below: float) -> Effect:
    """Compute partial eta squared from an F statistic (Cohen 1973).

    Partial eta squared is the variation that the effect explains, divided by the sum of this
    variation and the variation of the error.

    Each end of the interval is L / (L + above + below + 1), where L is the noncentrality parameter
    of F at this end (Steiger 2004). The interval is for the population value, which is smaller on
    average than the sample value. The value can therefore lie above its interval.

    Parameters
    ----------
    statistic, above, below
        F statistic, and its degrees of freedom in the numerator and in the denominator.
    """
    value = statistic * above / (statistic * above + below)
    ends = (_noncentrality(statistic, above, below, chance) for chance in TAILS)
    low, high = (end / (end + above + below + 1.0) for end in ends)
    return Effect("partial eta squared", value, low, high)


def _noncentrality(statistic: float, above: float, below: float, chance: float) -> float:
    """Return the noncentrality for which F < `statistic` has the probability `chance`.

    The result is zero if the probability is at most `chance` for the central F distribution.
    """

    def excess(shift: float) -> float:
        return chance - ncf.cdf(statistic, above, below, shift)

    if excess(0.0) >= 0.0:
        return 0.0
    # an upper bound is searched by doubling from the noncentrality that F itself suggests
    high = 1.0 + statistic * above
    while excess(high) < 0.0:
        high *= 2.0
    # an effect size is reported with three digits
    return brentq(excess, 0.0, high, xtol=1e-9)


def normal_residuals(residuals: ArrayLike) -> Assumption:
    """Check the assumption of normal residuals by two tests.

    The assumption is rejected if one of the tests rejects it at :data:`ALPHA` divided by the number
    of tests.

    The first test is Shapiro and Wilk's (1965); its p value follows Royston (1995). It is used for
    up to 5,000 values. The second test is Anderson and Darling's test (1952) with estimated mean
    and variance (Stephens 1986). It needs at least 8 values. In a large sample, the tests reject
    even a slight departure from normality. Skewness and excess kurtosis are therefore reported too.
    An absolute skewness below about 1 and an absolute excess kurtosis below about 2 hardly matter
    for a comparison of means (West et al. 1995 give the limits 2 and 7).

    Raises
    ------
    InputError
        If the residuals are constant.
    """
    from statsmodels.stats.diagnostic import normal_ad

    name = "normal residuals"
    values = np.ravel(residuals)
    if np.ptp(values) == 0.0:
        raise InputError(
            name,
            "vary",
            f"{values[0]:g} in all rows",
            "leave this test out: constant values have no distribution to test",
        )
    p_values = {"Shapiro-Wilk": shapiro(values).pvalue} if len(values) <= MOST else {}
    p_values["Anderson-Darling"] = normal_ad(values)[1]
    limit = ALPHA / len(p_values)
    holds = min(p_values.values()) >= limit
    tests_text = ", ".join(f"{test} {format_p(p)}" for test, p in p_values.items())
    return Assumption(
        name,
        holds,
        (
            f"{tests_text}, each to be at least {limit:g}, skewness {skew(values):z.2f}, "
            f"excess kurtosis {kurtosis(values):.2f}"
        ),
    )


def symmetric_residuals(residuals: Array) -> Assumption:
    """Check the assumption of symmetric residuals by D'Agostino's test of skewness (1970).

    Each column is tested. The smallest p is multiplied by the number of columns (Bonferroni).

    Parameters
    ----------
    residuals
        Residuals of at least 8 users, shape (users, columns). Constant columns are ignored; at
        least one column must vary.
    """
    columns = residuals[:, np.ptp(residuals, axis=0) > 0.0]
    p = min(1.0, columns.shape[1] * np.min(skewtest(columns, axis=0).pvalue))
    largest = np.abs(skew(columns, axis=0)).max()
    return Assumption(
        "symmetric residuals",
        p >= ALPHA,
        f"D'Agostino {format_p(p)}, to be at least {ALPHA:g}, largest skewness {largest:.2f}",
    )
