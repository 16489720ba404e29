"""All pairs at once: Tukey's honest significant difference, Games and Howell's, and corrections of p values."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import studentized_range, ttest_rel

from meshes.base.errors import InputError
from tissue.evaluation.statistics.outcome import LEVEL, Effect, Outcome, studied

__all__ = ["CORRECTIONS", "corrected", "games_howell", "tukey_groups", "tukey_levels"]

Array = NDArray[np.float64]
CORRECTIONS = ("bonferroni", "holm")


def tukey_groups(samples: Sequence[ArrayLike], names: Sequence[str], *, metric: str) -> tuple[Outcome, ...]:
    """Every pair of groups by Tukey (1949), Kramer's (1956) form for unequal sizes; each with Games and Howell's.

    Parameters
    ----------
    samples
        Values of each group, one a user, each of shape (users,).
    names
        Names of the groups.
    metric
        What is compared, for the sentence.

    Returns
    -------
    tuple of Outcome
        In the order of pairs (0, 1), (0, 2), ...; effects are differences of means with simultaneous intervals.
    """
    groups = _groups(samples, names)
    counts = np.array([len(each) for each in groups])
    means = np.array([each.mean() for each in groups])
    below = int(counts.sum() - len(counts))
    square = sum(((each - each.mean()) ** 2).sum() for each in groups) / below
    pairs = list(combinations(range(len(groups)), 2))
    errors = [float(np.sqrt(0.5 * square * (1.0 / counts[a] + 1.0 / counts[b]))) for a, b in pairs]
    others = games_howell(groups, names, metric=metric)
    return tuple(
        replace(_pair("Tukey HSD", means, names, pair, error, below, metric), alternatives=(other,))
        for pair, error, other in zip(pairs, errors, others, strict=True)
    )


def games_howell(samples: Sequence[ArrayLike], names: Sequence[str], *, metric: str) -> tuple[Outcome, ...]:
    """Every pair of groups whose variances may differ (Games and Howell 1976); arguments as for tukey_groups."""
    groups = _groups(samples, names)
    means = np.array([each.mean() for each in groups])
    shares = np.array([each.var(ddof=1) / len(each) for each in groups])
    found = []
    for a, b in combinations(range(len(groups)), 2):
        total = shares[a] + shares[b]
        below = total**2 / (shares[a] ** 2 / (len(groups[a]) - 1) + shares[b] ** 2 / (len(groups[b]) - 1))
        found.append(_pair("Games-Howell", means, names, (a, b), float(np.sqrt(0.5 * total)), below, metric))
    return tuple(found)


def tukey_levels(values: Array, names: Sequence[str], groups: NDArray[np.int64], *, metric: str) -> tuple[Outcome, ...]:
    """Every pair of levels that all users met, by Tukey; each with the paired t test, corrected by Holm.

    The error is how differently users take the levels (their interaction), pooled over levels, which needs sphericity;
    the paired test does not.

    Parameters
    ----------
    values
        Cell means, shape (users, levels).
    names
        Names of the levels.
    groups
        Group of every user, shape (users,); effects of groups and how they differ with the level leave the error.
    metric
        What is compared, for the sentence.
    """
    from tissue.evaluation.statistics.strata import strata

    found = strata(values, groups, (values.shape[1],), (0,), between=False)
    counts = np.bincount(groups)
    means = np.stack([values[groups == group].mean(axis=0) for group in range(len(counts))]).mean(axis=0)
    error = float(np.sqrt(float(found.error_square) * (1.0 / counts).sum() / len(counts) ** 2))
    pairs = list(combinations(range(len(names)), 2))
    raw = [ttest_rel(values[:, b], values[:, a]) for a, b in pairs]
    p_values = corrected([float(each.pvalue) for each in raw], "holm")
    others = [
        Outcome("paired t, Holm", _question(metric, names, pair), "t", float(each.statistic), (float(each.df),), p)
        for pair, each, p in zip(pairs, raw, p_values, strict=True)
    ]
    return tuple(
        replace(
            _pair("Tukey HSD within users", means, names, pair, error, found.degrees[1], metric), alternatives=(other,)
        )
        for pair, other in zip(pairs, others, strict=True)
    )


def corrected(p_values: Sequence[float], correction: str = "bonferroni") -> tuple[float, ...]:
    """P values of a family of tests, corrected so that one false alarm in the family stays at the nominal chance.

    Parameters
    ----------
    p_values
        One a test.
    correction
        "bonferroni", or "holm" (1979), which rests on no more and never rejects less.
    """
    if correction not in CORRECTIONS:
        raise InputError(f"correction must be one of {', '.join(CORRECTIONS)}, got {correction}: use holm")
    if not p_values:
        return ()
    studied()
    from statsmodels.stats.multitest import multipletests

    return tuple(float(each) for each in multipletests(p_values, method=correction)[1])


def _pair(
    test: str,
    means: Array,
    names: Sequence[str],
    pair: tuple[int, int],
    error: float,
    below: float,
    metric: str,
) -> Outcome:
    """One pair by the studentized range, with its simultaneous interval."""
    a, b = pair
    difference = float(means[b] - means[a])
    count = len(means)
    half = _critical(count, below) * error
    p = float(studentized_range.sf(abs(difference) / error, count, below))
    effect = Effect("difference", difference, difference - half, difference + half)
    return Outcome(test, _question(metric, names, pair), "q", abs(difference) / error, (count, below), p, effect)


@cache
def _critical(count: int, below: float) -> float:
    """Studentized range that :data:`LEVEL` of families stay under; a third of a second each, so kept."""
    return float(studentized_range.ppf(LEVEL, count, below))


def _question(metric: str, names: Sequence[str], pair: tuple[int, int]) -> str:
    return f"{metric}: {names[pair[1]]} minus {names[pair[0]]}"


def _groups(samples: Sequence[ArrayLike], names: Sequence[str]) -> list[Array]:
    """Values of each group, checked."""
    groups = [np.asarray(each, dtype=float) for each in samples]
    if len(groups) < 2 or len(groups) != len(names):
        raise InputError(f"groups must be at least two, each with a name, got {len(groups)}: add a group")
    for name, group in zip(names, groups, strict=True):
        if group.ndim != 1 or len(group) < 2 or not np.isfinite(group).all():
            raise InputError(f"group {name} must hold at least two finite values, got {group.size}: add users")
    if max(np.ptp(group) for group in groups) == 0.0:
        raise InputError("groups must vary within, got constants: a difference has then no error to be held against")
    return groups
