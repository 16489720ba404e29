"""Power of the hypothesis tests of a planned study, by simulation."""

from itertools import combinations

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import require_range
from tissue.evaluation.statistics.sign_flips import largest_squared_t
from tissue.evaluation.statistics.strata import pair_differences

EFFECT = 1.0
"""Smallest effect that a study shall detect [standard deviations].

For a comparison of methods, the unit is the standard deviation, over people, of the difference
between two methods. For a comparison of groups, the unit is the standard deviation of the people in
a group. The value is a choice from the range 0.5 to 2. In the published study, the force errors of
the methods penalty and Koopman differ by 2.8 to 2.9 standard deviations.
"""
POWER = 0.8
"""Power for which the number of people in a study is planned (Cohen 1988, section 2.4)."""
MOST_PEOPLE = 200
"""Largest number of people per group that is tried in the search for a planned number.

No effect of a registered plan needs so many people.
"""
POPULATIONS = 20_000
"""Number of simulated studies from which one value of the power is computed.

With this number and a significance level of 5 % / 54, a power of 0.8 has a random error of 0.02
(standard deviation of 12 repetitions). A planned number of 35 people changes by up to 2.
"""


def effect_names(**levels: int) -> list[str]:
    """Return the names of all main effects and interactions of factors, such as "group x method".

    ``levels`` holds the number of levels of each factor. Factors with one level are left out.
    """
    factors = [name for name, count in levels.items() if count > 1]
    return [
        " x ".join(chosen)
        for count in range(1, len(factors) + 1)
        for chosen in combinations(factors, count)
    ]


def planned_power(
    people: int,
    groups: int,
    methods: int,
    *,
    alpha: float,
    rng: np.random.Generator,
    effect: float = EFFECT,
) -> dict[str, float]:
    """Return the power of each test of one metric on one task, for an effect of a given size.

    In the test of methods, one method differs by ``effect`` from all others, which are equal. In
    the test of groups, one group differs. In the test of the interaction, one method differs from
    the others in only one group. The unit of ``effect`` is explained at `EFFECT`. Values are normal
    with equal standard deviations.

    The power is the share of simulated studies whose largest t exceeds the critical value. The
    critical value is the (1 - alpha) quantile of the largest t over simulated studies without an
    effect. A real study uses sign-flip tests, but simulating them would need 20 / alpha flips for
    each study. At alpha = 5 %, the power of sign-flip tests is 0.01 to 0.02 lower than the returned
    power.

    Parameters
    ----------
    people
        Number of people in a group. The number of trials has no influence, because ``effect``
        refers to the mean of each person.
    groups, methods
        Number of groups and number of methods.
    alpha
        Significance level of one test, after the correction for several tests.
    rng
        Random generator of the simulated studies.
    effect
        Size of the effect in standard deviations.

    Returns
    -------
    dict[str, float]
        Power by name of the test. Tests that need more people, groups or methods are left out.

    Raises
    ------
    InputError
        If alpha or the effect is out of range.
    """
    # the critical value rests on alpha * POPULATIONS studies
    require_range("alpha", alpha, 5.0 / POPULATIONS, 1.0, "use a value such as 0.05")
    # beyond this range a typing error: to show 0.01 takes more than 100 000 people
    require_range("effect", effect, 0.01, 10.0, "use a value such as 1")
    # no variation between people
    if people < 2:
        return {}
    return {
        test: _simulated_power(test, people, groups, methods, alpha=alpha, rng=rng, effect=effect)
        for test in effect_names(group=groups, method=methods)
    }


def planned_people(
    groups: int,
    methods: int,
    *,
    alpha: float,
    rng: np.random.Generator,
    effect: float = EFFECT,
) -> dict[str, int]:
    """Return the smallest number of people per group for a power of 0.8, keyed by test name.

    Parameters
    ----------
    groups, methods, alpha, rng, effect
        As in :func:`planned_power`.

    Returns
    -------
    dict[str, int]
        Number of people by name of the test. Tests that need more than 200 people per group are
        left out.
    """
    found = {}
    for test in effect_names(group=groups, method=methods):
        low, high = 1, MOST_PEOPLE + 1
        while high - low > 1:
            middle = (low + high) // 2
            power = _simulated_power(
                test, middle, groups, methods, alpha=alpha, rng=rng, effect=effect
            )
            if power >= POWER:
                high = middle
            else:
                low = middle
        if high <= MOST_PEOPLE:
            found[test] = high
    return found


def _simulated_power(
    test: str,
    people: int,
    groups: int,
    methods: int,
    *,
    alpha: float,
    rng: np.random.Generator,
    effect: float,
) -> float:
    """Return the fraction of simulated studies in which one test detects the effect."""
    between = "group" in test
    # a person's mean is one value of unit variance
    levels = methods if "method" in test else 1
    pairs = pair_differences(levels) if levels > 1 else np.ones((1, 1))
    shift = np.zeros((groups, levels))
    # one standard deviation of differences is sqrt(2) of a value's
    size = effect * (2.0**0.5 if levels > 1 else 1.0)
    shift[0 if between else slice(None), 0] = size
    # means and variances of normal values are independent
    means = rng.standard_normal((POPULATIONS, groups, levels)) / people**0.5 @ pairs.T
    factors = _wishart_factors((POPULATIONS, groups), levels, people - 1, rng)
    variances = ((pairs @ factors) ** 2).sum(axis=-1) / ((people - 1) * people)
    plain = largest_squared_t(means, variances, between=between)
    planted = largest_squared_t(means + shift @ pairs.T, variances, between=between)
    return float(np.mean(planted > np.quantile(plain, 1.0 - alpha)))


def _wishart_factors(
    shape: tuple[int, ...], levels: int, degrees: int, rng: np.random.Generator
) -> Array:
    """Draw random matrices A for which A Aᵀ has a Wishart distribution.

    Parameters
    ----------
    shape
        Shape of the draws.
    levels
        Number of rows of A. A Aᵀ is distributed like the sums of squares and products of this
        number of independent normal variables with unit variance.
    degrees
        Degrees of freedom of the Wishart distribution.

    Returns
    -------
    Array
        Matrices A, shape (*shape, levels, columns).
    """
    if degrees < levels:
        return rng.standard_normal((*shape, levels, degrees))
    # Bartlett (1933): normal below the diagonal, roots of chi squared on it
    factors = np.tril(rng.standard_normal((*shape, levels, levels)), -1)
    for level in range(levels):
        factors[..., level, level] = rng.chisquare(degrees - level, shape) ** 0.5
    return factors
