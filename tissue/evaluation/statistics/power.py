"""Error rates of the tests of a study: thousands of simulated or redrawn populations at once."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from meshes.base.arrays import Array, Ints
from tissue.evaluation.statistics.hypothesis_test import ALPHA, LEVEL, Effect
from tissue.evaluation.statistics.strata import group_means, strata
from tissue.evaluation.statistics.trials import Cells

__all__ = ["Power", "drawn_users", "redrawn_power", "rejection_rates"]

POPULATIONS = 10_000
"""Number of populations. It resolves an error rate of 5 % to 0.4 %."""
TESTS = {"method": ((0,), False), "group": ((), True), "group x method": ((0,), True)}


@dataclass(frozen=True)
class Power:
    """Rejection rates of one test.

    Attributes
    ----------
    test
        "method", "group" or "group x method".
    users_per_group, populations
        Size of the study and number of populations.
    false_alarms
        Share of rejections without a difference (type I), with its interval.
    hits
        Share of rejections with the effect (power), with its interval. 1 - hits is the type II
        error rate.
    """

    test: str
    users_per_group: int
    populations: int
    false_alarms: Effect
    hits: Effect

    @property
    def sentence(self) -> str:
        """Both error rates in words."""
        return (
            f"{self.test}: with {self.users_per_group} users a group, false alarms "
            f"{_percent(self.false_alarms)}, "
            f"power {_percent(self.hits)} in {self.populations} populations."
        )


def drawn_users(groups: Ints, count: int, rng: np.random.Generator) -> Ints:
    """Draw users with replacement within each group, in the order of groups.

    Parameters
    ----------
    groups
        Group of every user, 0 to G - 1, shape (users,).
    count
        Number of populations. Each has the size of the original groups.

    Returns
    -------
    Ints
        Indices of users, shape (count, users).
    """
    members = (np.flatnonzero(groups == group) for group in range(int(groups.max()) + 1))
    return np.concatenate(
        [each[rng.integers(len(each), size=(count, len(each)))] for each in members], axis=1
    )


def redrawn_power(
    cells: Cells, *, rng: np.random.Generator, populations: int = POPULATIONS
) -> tuple[Power, ...]:
    """Estimate the error rates with users redrawn from a study of any distribution.

    The null hypothesis is made true by subtracting the means of each group and method. The
    residuals of n users are scaled by sqrt(n / (n - 1)), since redrawn users vary less than new
    ones by this factor. Power refers to an effect of the measured size, which includes the error of
    the measurement. The power is too high if the true effect is zero or small.

    Parameters
    ----------
    cells
        Means of a metric by one factor within users.
    rng
        Generator that draws the users.
    populations
        Number of populations.
    """
    order = np.argsort(cells.groups, kind="stable")
    values = cells.values[order]
    groups = cells.groups[order]
    means = group_means(values, groups)[groups]
    counts = np.bincount(groups)[groups][:, None]
    null = (values - means) * np.sqrt(counts / (counts - 1.0))
    drawn = drawn_users(groups, populations, rng)
    return rejection_rates(null[drawn], (means + null)[drawn], groups)


def rejection_rates(null: Array, planted: Array, groups: Ints) -> tuple[Power, ...]:
    """Return the shares of populations in which each test rejects.

    Parameters
    ----------
    null, planted
        Populations without and with an effect, each of shape (populations, users, methods).
    groups
        Group of every user, shape (users,).
    """
    found = []
    for name, (chosen, between) in TESTS.items():
        if (between and groups.max() == 0) or (chosen and null.shape[-1] < 2):
            continue
        false_alarms, hits = (
            _share(strata(values, groups, (values.shape[-1],), chosen, between=between).p < ALPHA)
            for values in (null, planted)
        )
        found.append(Power(name, int(np.bincount(groups).min()), len(null), false_alarms, hits))
    return tuple(found)


def _share(rejects: NDArray[np.bool_]) -> Effect:
    """Return the share of populations with Wilson's interval (Wilson 1927)."""
    found = binomtest(int(rejects.sum()), len(rejects))
    return Effect("share", found.statistic, *map(float, found.proportion_ci(LEVEL, "wilson")))


def _percent(share: Effect) -> str:
    return f"{100.0 * share.value:.1f} % [{100.0 * share.low:.1f}, {100.0 * share.high:.1f}]"
