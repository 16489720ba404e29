"""Composite performance index: weighted sum of standardised metrics (higher is better).

The weights are the squared loadings of the metrics on their first principal component.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError
from tissue.evaluation.statistics.hypothesis_test import LEVEL, Assumption, Effect
from tissue.evaluation.statistics.trials import TrialTable


def drawn_users(groups: Ints, count: int, rng: np.random.Generator) -> Ints:
    """Draw users of each group with replacement.

    Parameters
    ----------
    groups
        Group of every user, 0 to G - 1, shape (users,).
    count
        Number of draws. In each draw, every group keeps its size.

    Returns
    -------
    Ints
        Indices of the drawn users, sorted by group, shape (count, users).
    """
    members = (np.flatnonzero(groups == group) for group in range(groups.max() + 1))
    return np.concatenate(
        [each[rng.integers(len(each), size=(count, len(each)))] for each in members], axis=1
    )


SMALLEST_GAP = 1.25
"""Variance ratio of the first two principal components above which the first is distinct.

The value is a convention.
"""


@dataclass(frozen=True)
class Index:
    """Composite index of a study: mean index of each method, and weights of the metrics.

    Attributes
    ----------
    metrics, weights
        Names of the metrics, and their weights with bootstrap intervals. The weights sum to one.
    means
        Mean index of each method, with its bootstrap interval. For each bootstrap sample of users,
        the weights are computed again.
    assumptions
        Results of three checks: all loadings on the first principal component have the same sign,
        its variance is clearly the largest, and the weights are stable.
    """

    metrics: tuple[str, ...]
    weights: tuple[Effect, ...]
    means: tuple[Effect, ...]
    assumptions: tuple[Assumption, ...]

    @property
    def sentence(self) -> str:
        """Weights, means and failed assumptions in words."""
        weights_text = ", ".join(f"{each.name} {each.value:.2f}" for each in self.weights)
        means = ", ".join(
            f"{each.name} {each.value:+z.2f} [{each.low:z.2f}, {each.high:z.2f}]"
            for each in self.means
        )
        failed = "; ".join(each.finding for each in self.assumptions if not each.holds)
        return f"Index by method, in standard deviations: {means}. Weights: {weights_text}." + (
            f" But {failed}." * bool(failed)
        )


def weights_of(standard: Array) -> tuple[Array, Array, Array]:
    """Return the squared loadings of the first principal component.

    Parameters
    ----------
    standard
        Correlation matrices, shape (..., metrics, metrics).

    Returns
    -------
    weights, loadings, variances
        Squared loadings, loadings, and variances of the principal components, each of shape (...,
        metrics). The weights sum to one. The sign of the loadings is chosen so that their sum is
        positive. The variances are in decreasing order.
    """
    variances, vectors = np.linalg.eigh(standard)
    first = vectors[..., -1]
    first = first * np.where(first.sum(axis=-1, keepdims=True) < 0.0, -1.0, 1.0)
    return first**2, first, variances[..., ::-1]


def composite_index(
    table: TrialTable, directions: Mapping[str, int], *, rng: np.random.Generator, count: int = 2000
) -> Index:
    """Compute the composite index with weights from the first principal component.

    The sign of each metric is chosen so that higher is better. The metrics are standardised within
    each task, because tasks have different scales. The weights are the squared loadings of the
    first principal component of the correlation matrix. The weights in the published study are
    computed from raw metrics; they have mixed signs and depend on the units. The weights of this
    function are not negative and do not depend on the units.

    Parameters
    ----------
    table
        Trials of a study.
    directions
        Direction of each metric, by name, for at least two metrics: +1 if higher is better, -1 if
        lower is better.
    rng
        Random generator that draws users for the intervals.
    count
        Number of bootstrap samples. With 2000 samples, the tail probability of 2.5 % at each end of
        the interval has a standard error of 0.35 %.

    Raises
    ------
    InputError
        If a metric is constant within a task or in a bootstrap sample, or if a group has fewer than
        two users.
    """
    names = tuple(directions)
    kept = table.failure == ""
    raw = np.column_stack([sign * table.values(name) for name, sign in directions.items()])[kept]
    tasks = np.unique(table.task[kept], return_inverse=True)[1]
    scaled = np.empty_like(raw)
    for task in range(tasks.max(initial=-1) + 1):
        chosen = raw[tasks == task]
        spread = chosen.std(axis=0)
        # Equal numbers leave a rounding error in proportion to their size, which is not a spread.
        flat = spread <= 1e-12 * np.abs(chosen).max(axis=0)
        if flat.any():
            raise InputError(
                names[flat.argmax()], "vary within a task", "a constant value", "leave it out"
            )
        scaled[tasks == task] = (chosen - chosen.mean(axis=0)) / spread
    people, person = np.unique(table.people()[kept], return_inverse=True)
    _, first_rows = np.unique(person, return_index=True)
    groups = np.unique(table.group[kept][first_rows], return_inverse=True)[1].astype(np.int64)
    smallest = np.bincount(groups).min(initial=len(people))
    if smallest < 2:
        raise InputError(
            "users",
            "be at least two in each group",
            smallest,
            "add users: the weights of one user do not apply to others",
        )
    weights, loadings, variances = weights_of(scaled.T @ scaled / len(scaled))
    methods = np.unique(table.method[kept]).tolist()
    member = np.stack([table.method[kept] == method for method in methods]).astype(float)
    drawn_weights = []
    drawn_means = []
    for drawn in drawn_users(groups, count, rng):
        times = np.bincount(drawn, minlength=len(people))[person].astype(float)
        again, _, _ = weights_of(_correlation(scaled, times, names))
        drawn_weights.append(again)
        drawn_means.append(_means(scaled @ again, member * times))
    # percentiles of a two-sided interval
    tails = [50.0 * (1.0 - LEVEL), 50.0 * (1.0 + LEVEL)]
    spread = np.percentile(drawn_weights, tails, axis=0)
    reach = np.percentile(drawn_means, tails, axis=0)
    return Index(
        names,
        _effects(names, weights, spread),
        _effects(methods, _means(scaled @ weights, member), reach),
        _checks(loadings, variances, spread),
    )


def _correlation(rows: Array, times: Array, names: tuple[str, ...]) -> Array:
    """Return the correlation matrix of rows; row i counts ``times[i]`` times."""
    covariance = np.atleast_2d(np.cov(rows.T, aweights=times, ddof=0))
    size = np.sqrt(np.diag(covariance))
    # The rows have unit variance, so a smaller size is a rounding error.
    flat = size <= 1e-9
    if flat.any():
        raise InputError(
            names[flat.argmax()],
            "vary in every bootstrap sample of the users",
            "a sample in which it is constant",
            "add users",
        )
    return covariance / size / size[:, None]


def _means(values: Array, shares: Array) -> Array:
    """Return k weighted means of values, shape (k,).

    ``shares`` holds k sets of weights, shape (k, rows).

    If all weights of a set are zero, the mean is zero, not NaN.
    """
    return shares @ values / np.maximum(shares.sum(axis=1), 1.0)


def _checks(loadings: Array, variances: Array, spread: Array) -> tuple[Assumption, ...]:
    """Check whether one number can represent all metrics; see `Index.assumptions`."""
    # a loading of zero may be negative by rounding
    agree = bool((loadings > -1e-9).all())
    # of two metrics that agree entirely, the second variance is zero
    gap = variances[0] / max(variances[1], 1e-300)
    widest = (spread[1] - spread[0]).max()
    return (
        Assumption(
            "metrics agree",
            agree,
            "methods that are better by one metric are worse by another, so the weights mix both"
            if not agree
            else "all loadings have one sign",
        ),
        Assumption(
            "first component stands out",
            gap >= SMALLEST_GAP,
            f"the first component has {gap:.2f} times the variance of the second",
        ),
        Assumption(
            "weights are stable",
            # a weight that varies by half of the sum of all weights is not determined; a convention
            widest <= 0.5,
            f"weights move by up to {widest:.2f} with the users drawn",
        ),
    )


def _effects(names: Sequence[str], values: Array, limits: Array) -> tuple[Effect, ...]:
    """Return named values with their intervals, whose ends ``limits`` have shape (2, values)."""
    return tuple(
        Effect(*each) for each in zip(names, values.tolist(), *limits.tolist(), strict=True)
    )
