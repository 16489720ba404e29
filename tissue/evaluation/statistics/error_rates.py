"""Error rates of hypothesis tests in a study, estimated by simulated populations."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.stats import binomtest, studentized_range

from meshes.base.arrays import Array, Flags, Ints
from tissue.evaluation.statistics.hypothesis_test import ALPHA, LEVEL, Effect
from tissue.evaluation.statistics.sign_flips import pair_scores, sign_test_p
from tissue.evaluation.statistics.strata import (
    effect_scores,
    group_means,
    pillai,
    strata,
    tukey,
)
from tissue.evaluation.statistics.trials import Cells

POPULATIONS = 2_000
"""Number of simulated populations.

With this number, a rate of 5 % has a standard error of 0.5 %.
"""
QUESTIONS = {"method": ((0,), False), "group": ((), True), "group x method": ((0,), True)}
"""For each question: indices of the tested factors within users; True if groups are compared."""


@dataclass(frozen=True)
class Power:
    """Estimated type I error rate and power of one test.

    Attributes
    ----------
    question
        "method", "group" or "group x method".
    test
        Name of the test, such as "sign flips" or "F of strata".
    users_per_group, populations
        Number of users in a group, and number of simulated populations.
    false_alarms
        Fraction of populations without an effect in which the test rejects the null hypothesis
        (type I error rate), with its interval.
    hits
        Fraction of populations with an effect in which the test rejects the null hypothesis
        (power), with its interval. 1 - hits is the type II error rate.
    """

    question: str
    test: str
    users_per_group: int
    populations: int
    false_alarms: Effect
    hits: Effect

    @property
    def sentence(self) -> str:
        """Type I error rate and power in words."""
        return (
            f"{self.question} by {self.test}: with {self.users_per_group} users a group, false "
            f"alarms {_percent(self.false_alarms)}, "
            f"power {_percent(self.hits)} in {self.populations} populations."
        )


def redrawn_power(
    cells: Sequence[Cells], *, rng: np.random.Generator, populations: int = POPULATIONS
) -> tuple[Power, ...]:
    """Estimate error rates of tests by bootstrap: users are drawn from the data of a study.

    The data may have any distribution. For the null hypothesis, the mean of each group and method
    is subtracted. Users are drawn from a smoothed distribution of the residuals (Silverman and
    Young 1987). A drawn user is a random user of the group plus normal noise, whose covariance is
    proportional to the covariance of the group. Without the noise, the estimated rate of false
    alarms would be too high, because the same few users are drawn repeatedly.

    The estimate was tested in 25 simulated studies with normal data and a true rate of false alarms
    of 5 %. For sign flips, the mean estimate is 5.1 to 5.4 %, depending on the question (3.7 to 6.4
    % in single studies). Without the noise, the mean estimate is 5.6 to 7.8 % (up to 10.8 % in
    single studies). For the F test, the mean estimate is too high, because the covariance of ten
    users is never exactly spherical. The mean estimate is 5.5 % for groups, 5.9 % for methods and
    7.1 % for their interaction (up to 8.4 % in single studies). ``python tests/bench/bench_null.py
    --only redrawn`` measures these rates.

    The returned power is the power for an effect of the measured size. The power is too high if the
    true effect is zero or small, because the measured size contains a random error.

    Parameters
    ----------
    cells
        One `Cells` object for each metric, with exactly one factor within users. Several metrics
        are tested together.
    rng
        Random generator for users and sign flips.
    populations
        Number of populations.
    """
    order = np.argsort(cells[0].groups, kind="stable")
    groups = cells[0].groups[order]
    # metrics are scaled, so that they can share a covariance
    values = np.stack([each.values[order] / each.values.std() for each in cells], axis=1)
    users, metrics, methods = values.shape
    flat = values.reshape(users, metrics * methods)
    means = group_means(flat, groups)[groups]
    null = _drawn(flat - means, groups, populations, rng)
    shape = (populations, users, metrics, methods)
    null = np.moveaxis(null.reshape(shape), 2, 1)
    planted = null + np.moveaxis(means.reshape(shape[1:]), 1, 0)
    return rejection_rates(null, planted, groups, rng=rng)


def _drawn(residuals: Array, groups: Ints, populations: int, rng: np.random.Generator) -> Array:
    """Draw users from the smoothed residuals of each group.

    Parameters
    ----------
    residuals
        Values minus group means, shape (users, columns), sorted by group.
    groups
        Group of every user, shape (users,).
    populations
        Number of populations.
    rng
        Random generator for users and noise.

    Returns
    -------
    Array
        Drawn residuals, shape (populations, users, columns). Their covariance is the unbiased
        estimate of the covariance of each group.
    """
    columns = residuals.shape[1]
    found = []
    for group, count in enumerate(np.bincount(groups)):
        # Silverman (1986, equation 4.14), in standard deviations of the group
        width = (4.0 / ((columns + 2.0) * count)) ** (1.0 / (columns + 4.0))
        drawn = np.eye(count)[rng.integers(count, size=(populations, count))]
        noise = rng.standard_normal((populations, count, count))
        # a drawn residual has the variance (n - 1) / n of the unbiased one, noise needs 1 / (n - 1)
        weights = count**0.5 * drawn + width * noise
        weights = weights / ((count - 1.0) * (1.0 + width**2)) ** 0.5
        found.append(weights @ residuals[groups == group])
    return np.concatenate(found, axis=1)


def rejection_rates(
    null: Array,
    planted: Array,
    groups: Ints,
    *,
    rng: np.random.Generator,
    questions: Sequence[str] = tuple(QUESTIONS),
) -> tuple[Power, ...]:
    """Return, for each test, the fraction of populations in which it rejects the null hypothesis.

    Parameters
    ----------
    null, planted
        Populations without and with an effect, each of shape (populations, metrics, users,
        methods). Several metrics are tested together.
    groups
        Group of every user, shape (users,).
    rng
        Random generator of the sign flips.
    questions
        Keys of `QUESTIONS`. A question that the design cannot answer, such as "group" for a single
        group, is skipped. For several metrics, "group x method" is skipped.
    """
    found: list[Power] = []
    metrics, _, methods = null.shape[1:]
    for question in questions:
        chosen, between = QUESTIONS[question]
        lacks_groups = between and groups.max() == 0
        lacks_methods = bool(chosen) and methods < 2
        if lacks_groups or lacks_methods or (metrics > 1 and chosen and between):
            continue
        name = question if metrics == 1 else f"{question}, {metrics} metrics"
        alarms = _rejections(null, groups, question, rng)
        hits = _rejections(planted, groups, question, rng)
        users = int(np.bincount(groups).min())
        found += [
            Power(name, test, users, len(alarms[test]), _share(alarms[test]), _share(hits[test]))
            for test in alarms
            if test in hits
        ]
    return tuple(found)


def _rejections(
    values: Array, groups: Ints, question: str, rng: np.random.Generator
) -> dict[str, Flags]:
    """Return the flags of the populations in which a test rejects, keyed by the name of the test.

    The values have the shape (populations, metrics, users, methods). A multivariate test is left
    out if there are too few users for it, or a metric is a linear combination of others.
    """
    chosen, between = QUESTIONS[question]
    sizes = values.shape[-1:]
    scores = _joined(pair_scores(values, sizes, chosen))
    found = {"sign flips": sign_test_p(scores, groups, between=between, rng=rng) <= ALPHA}
    if values.shape[1] > 1:
        contrasts = _joined(effect_scores(values, sizes, chosen))
        residuals = contrasts[0] - group_means(contrasts[0], groups)[groups]
        users, width = residuals.shape
        if np.linalg.matrix_rank(residuals) == width < users - groups.max() - 1:
            # With few users, a population may repeat one user of each group.
            with suppress(np.linalg.LinAlgError):
                p_values = pillai(contrasts, groups, between=between).p
                found["MANOVA, Pillai's trace"] = p_values <= ALPHA
        return found
    exact = strata(values[:, 0], groups, sizes, chosen, between=between)
    found["F of strata"] = exact.p <= ALPHA
    if chosen:
        found["Greenhouse-Geisser"] = exact.corrected_p <= ALPHA
    # Tukey's test has pairs of methods or of groups, not pairs of both
    if between and chosen:
        return found
    differences, errors, degrees = tukey(values[:, 0], groups, between=between)
    reaches = np.abs(differences) >= _critical_range(*degrees) * errors
    test = "Tukey HSD" if between else "Tukey HSD within users"
    return found | {test: np.asarray(reaches.any(axis=-1))}


@lru_cache(maxsize=64)
def _critical_range(levels: int, degrees: int) -> float:
    """Return the critical value of the studentised range for a significance level of 5 %.

    The result is cached, because the computation takes 0.3 s.
    """
    return studentized_range.ppf(LEVEL, levels, degrees)


def _joined(scores: Array) -> Array:
    """Join the scores of each user for all metrics into one row.

    The shape (..., metrics, users, scores) becomes (..., users, metrics * scores).
    """
    moved = np.moveaxis(scores, -3, -2)
    return moved.reshape(*moved.shape[:-2], -1)


def _share(rejects: Flags) -> Effect:
    """Return the fraction of populations with a rejection, with its interval by Wilson (1927)."""
    found = binomtest(int(rejects.sum()), len(rejects))
    return Effect("share", found.statistic, *map(float, found.proportion_ci(LEVEL, "wilson")))


def _percent(share: Effect) -> str:
    return f"{100.0 * share.value:.1f} % [{100.0 * share.low:.1f}, {100.0 * share.high:.1f}]"
