"""Bayesian regression of one metric on others with random users, by quadrature.

The posterior is computed by quadrature instead of chains.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import gammaln, stdtr

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError
from tissue.evaluation.statistics.hypothesis_test import LEVEL, Effect
from tissue.evaluation.statistics.trials import TrialTable

__all__ = ["Posterior", "regression", "trial_regression"]

NODES = 96
"""Nodes over the intraclass correlation. 48 nodes give the same intervals to four digits."""


SLOPE_SPREAD = 10.0
"""Standard deviation of slopes and intercept in the prior, over the residual standard deviation.

It is almost uninformative.
"""
SHAPE = SCALE = 0.01
"""Parameters of the inverse gamma prior of the residual variance, almost uninformative.

Gelman (2006) advises against this prior for variances between groups. Here, the intraclass
correlation of users has a uniform prior instead.
"""


@dataclass(frozen=True)
class Posterior:
    """Posterior of a regression.

    Attributes
    ----------
    slopes
        Change of the response for one unit of each predictor, median and credible interval, in
        their own units.
    correlation
        Share of the variance about the line that is variance between users, mean over the
        posterior.
    chances
        Probability that each slope is positive.
    sentence
        Result in words.
    """

    slopes: tuple[Effect, ...]
    correlation: float
    chances: tuple[float, ...]
    sentence: str


def trial_regression(table: TrialTable, response: str, predictors: Sequence[str]) -> Posterior:
    """Regress one metric of the trials without failure on others, see :func:`regression`.

    Users are random effects.
    """
    kept = table.complete()
    if not len(kept):
        raise InputError(
            "table",
            "hold trials that did not fail",
            f"{len(table)} failures",
            "fix the study first",
        )
    columns = {name: kept.values(name) for name in predictors}
    return regression(kept.values(response), columns, kept.people(), response=response)


def regression(
    values: ArrayLike,
    predictors: Mapping[str, ArrayLike],
    users: ArrayLike,
    *,
    response: str,
    slope_spread: float = SLOPE_SPREAD,
) -> Posterior:
    """Compute the posterior of a linear regression with random users.

    The model is y = b0 + X b + u(user) + e with e ~ N(0, s^2), u ~ N(0, s^2 r / (1 - r)).

    Given r, the intraclass correlation, the normal-inverse-gamma prior is conjugate (Gelman et al.
    2013, chapter 14). Slopes therefore have a t distribution and the evidence has a closed form. r
    has a uniform prior and is integrated by quadrature. The posterior is a mixture of t
    distributions, exact apart from the quadrature nodes. Chains (NUTS) give the same intervals for
    the same model.

    Parameters
    ----------
    values
        Response, finite, shape (rows,).
    predictors
        Columns by name, finite, each of shape (rows,).
    users
        User of each row, shape (rows,). Without random users, the rows of one user would count as
        independent.
    response
        Name of the response.
    slope_spread
        Standard deviation of slopes and intercept in the prior, over the residual standard
        deviation, in standardised columns.

    Raises
    ------
    InputError
        If a column is constant or repeats another, or there are fewer than two users.
    """
    columns = np.column_stack([np.asarray(each, dtype=float) for each in predictors.values()])
    answers = np.asarray(values, dtype=float)
    names, person = np.unique(np.asarray(users), return_inverse=True)
    for name, column in zip((response, *predictors), (answers, *columns.T), strict=True):
        if np.ptp(column) == 0.0:
            raise InputError(
                name, "vary", f"{column[0]:g} throughout", "leave it out of the regression"
            )
    if len(names) < 2:
        raise InputError(
            "users", "be at least two", len(names), "users cannot be separated from the line"
        )
    spread = columns.std(axis=0)
    size = float(answers.std())
    design = np.column_stack([np.ones(len(answers)), (columns - columns.mean(axis=0)) / spread])
    if np.linalg.matrix_rank(design, tol=1e-8 * len(design)) < design.shape[1]:
        raise InputError("predictors", "not repeat one another", ", ".join(predictors), "drop one")
    standard = (answers - answers.mean()) / size
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    shares = 0.5 * (nodes + 1.0)
    middles, spreads, evidence = _conjugate(
        standard, design, person, shares / (1.0 - shares), slope_spread
    )
    mass = weights * np.exp(evidence - evidence.max())
    mass /= mass.sum()
    degrees = 2.0 * SHAPE + len(answers)
    unit = size / spread
    slopes = []
    chances = []
    for index, name in enumerate(predictors):
        centre = middles[:, index + 1]
        width = spreads[:, index + 1]

        def below(x: float, centre: Array = centre, width: Array = width) -> float:
            return float(mass @ stdtr(degrees, (x - centre) / width))

        ends = float((centre - 40.0 * width).min()), float((centre + 40.0 * width).max())
        median, low, high = (
            float(brentq(lambda x, wanted=wanted: below(x) - wanted, *ends)) * unit[index]
            for wanted in (0.5, 0.5 * (1.0 - LEVEL), 0.5 * (1.0 + LEVEL))
        )
        slopes.append(Effect(f"{response} per {name}", median, low, high))
        chances.append(1.0 - below(0.0))
    slopes_text = "; ".join(
        (
            f"{each}, {100.0 * max(chance, 1.0 - chance):.1f} % likely "
            f"{'above' if chance > 0.5 else 'below'} zero"
        )
        for each, chance in zip(slopes, chances, strict=True)
    )
    correlation = float(mass @ shares)
    sentence = (
        f"{slopes_text}. Of the variance about the line {100.0 * correlation:.0f} % is "
        f"between {len(names)} users. "
        "These are associations over trials, not causes."
    )
    return Posterior(tuple(slopes), correlation, tuple(chances), sentence)


def _conjugate(
    values: Array, design: Array, person: Ints, ratios: Array, slope_spread: float
) -> tuple[Array, Array, Array]:
    """Return centre and width of every coefficient's t distribution, and the log evidence.

    They are returned at each ratio of variances.

    With counts n, the inverse covariance of one user's rows is I - 11' k, k = ratio / (1 + n
    ratio). Only sums over users are therefore needed.
    """
    counts = np.bincount(person).astype(float)
    sums = np.stack([np.bincount(person, column) for column in (*design.T, values)], axis=1)
    both = np.column_stack([design, values])
    shrink = ratios[:, None] / (1.0 + counts * ratios[:, None])
    products = both.T @ both - np.einsum("ru,ui,uj->rij", shrink, sums, sums)
    width = design.shape[1]
    precision = products[:, :width, :width] + np.eye(width) / slope_spread**2
    middle = np.linalg.solve(precision, products[:, :width, width, None])[..., 0]
    shape = SHAPE + 0.5 * len(values)
    scale = SCALE + 0.5 * (
        products[:, width, width] - (middle * products[:, :width, width]).sum(axis=1)
    )
    spread = np.sqrt(
        scale[:, None] / shape * np.diagonal(np.linalg.inv(precision), axis1=1, axis2=2)
    )
    log_size = np.linalg.slogdet(precision)[1] + np.log1p(counts * ratios[:, None]).sum(axis=1)
    return middle, spread, gammaln(shape) - shape * np.log(scale) - 0.5 * log_size
