"""Linear mixed models with random users (by statsmodels), and Bayesian regression."""

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import gammaln, stdtr
from scipy.stats import f

from meshes.base.arrays import Array, Ints
from meshes.base.errors import InputError, counted, enumerated
from tissue.evaluation.statistics.hypothesis_test import (
    LEVEL,
    Assumption,
    Effect,
    HypothesisTest,
    normal_residuals,
    partial_eta_squared,
    require_statsmodels,
)
from tissue.evaluation.statistics.trials import TrialTable

if TYPE_CHECKING:
    from pandas import DataFrame
    from statsmodels.regression.mixed_linear_model import MixedLMResults

ITERATIONS = 400
"""Number of iterations after which a mixed-model fit counts as not converged.

Fits of simulated studies with 45 people converge within 25 iterations.
"""
SMALLEST_RESIDUAL_SHARE = 1e-6
"""Ratio of residual to total variance below which the likelihood counts as unbounded."""


def mixed_model(table: TrialTable, metric: str) -> list[HypothesisTest]:
    """Fit a mixed model of a metric by restricted likelihood; return F tests of its fixed effects.

    The model is metric = mean + group x method (x task) + user + user x method + trial + residual.

    The interaction of users with methods is a separate random term. Without this term, the test of
    the methods would treat the trials of one user as independent (Barr et al. 2013). If several
    methods are run in the same trial, the trial is a random term too. If each user has only one
    trial per method, the interaction of users with methods cannot be separated from the residual
    and is omitted. Wald's statistic is compared with an F distribution with the degrees of freedom
    of the error term (stratum). With few users, a comparison with the chi-squared distribution
    would reject too often. In a complete design, this test equals the exact test of
    :func:`tissue.evaluation.statistics.strata.strata`, unless a variance is estimated as zero.

    Raises
    ------
    InputError
        If there is only one group, task and method, if a group has fewer than two complete users,
        or if there are too few trials to separate users from the residual.
    """
    within = [name for name in ("task", "method") if len(np.unique(getattr(table, name))) > 1]
    cells = table.cells(metric, within=within or ["method"])
    group_count = len(cells.group_names)
    user_count = len(cells.users)
    if not within and group_count < 2:
        raise InputError(
            "table",
            "have at least two groups, tasks or methods",
            "one of each",
            "add a second group, task or method",
        )
    require_statsmodels()
    import pandas as pd
    from statsmodels.formula.api import mixedlm

    kept = table.complete()
    frame = pd.DataFrame(
        {
            "value": kept.values(metric),
            **{name: getattr(kept, name) for name in ("group", "task", "method")},
            "user": kept.people(),
            "trial": np.char.add(np.char.add(kept.task, "/"), kept.trial.astype(str)),
        }
    )
    frame = frame[frame["user"].isin(cells.users)]
    factors = [*(["group"] if group_count > 1 else []), *within]
    # with one trial a cell, the interaction of users and factor is the residual
    parts = {name: f"0 + C({name})" for name in within if (cells.counts > 1).any()}
    if {"task", "method"} <= set(parts):
        parts["both"] = "0 + C(task):C(method)"
    if "method" in parts and frame.duplicated(["user", "trial"]).any():
        parts["trial"] = "0 + C(trial)"
    scale = frame["value"].std()
    frame["value"] = frame["value"] / scale
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        model = mixedlm(
            "value ~ " + " * ".join(f"C({name}, Sum)" for name in factors),
            frame,
            groups="user",
            re_formula="1",
            vc_formula=parts or None,
        )
        try:
            fitted = model.fit(reml=True, maxiter=ITERATIONS)
            wald = fitted.wald_test_terms(scalar=True).table
        except np.linalg.LinAlgError:
            wald = None
    if wald is None or (wald["df_constraint"] < 1).any():
        raise InputError(
            f"the mixed model of {metric} cannot separate users from the residual with "
            f"{counted(len(frame), 'value')}. Add trials"
        )
    variances = [fitted.cov_re.iloc[0, 0], *fitted.vcomp, fitted.scale]
    assumptions = (
        _convergence(fitted.converged, fitted.scale / sum(variances), caught),
        normal_residuals(fitted.resid),
    )
    free = user_count - group_count
    return _tests(fitted, wald, metric, free, assumptions)


def _convergence(
    reported_convergence: bool, residual_share: float, caught: list[warnings.WarningMessage]
) -> Assumption:
    """Check whether the optimiser has reached the maximum of the restricted likelihood.

    `residual_share` is the residual variance divided by the sum of all variances. If it is zero,
    the optimiser may wrongly report convergence.
    """
    name = "convergence"
    if not reported_convergence:
        warned = str(caught[-1].message).split("\n")[0] if caught else "no reason given"
        return Assumption(
            name, False, f"restricted likelihood not at its maximum in {ITERATIONS} steps: {warned}"
        )
    if residual_share < SMALLEST_RESIDUAL_SHARE:
        return Assumption(
            name,
            False,
            "restricted likelihood has no maximum: nothing varies apart from users and trials",
        )
    return Assumption(name, True, "restricted likelihood at its maximum")


def _freedom(fitted: "MixedLMResults", name: str, free: int) -> int:
    """Return the degrees of freedom of a fixed effect's error term.

    The result is `free`, the degrees of freedom of users within groups, multiplied by the degrees
    of freedom of the effect's factors within users.
    """
    levels = fitted.model.data.frame.nunique()
    for factor in ("task", "method"):
        free *= levels[factor] - 1 if f"C({factor}" in name else 1
    return free


def _tests(
    fitted: "MixedLMResults",
    wald: "DataFrame",
    metric: str,
    free: int,
    assumptions: tuple[Assumption, ...],
) -> list[HypothesisTest]:
    """Return Wald's F test of every fixed effect from the table of its statistics."""
    found = []
    for name, row in wald.iterrows():
        term = str(name)
        # the mean of all trials is no effect
        if term == "Intercept":
            continue
        above = int(row["df_constraint"])
        below = _freedom(fitted, term, free)
        statistic = row["statistic"] / above
        found.append(
            HypothesisTest(
                "mixed model",
                f"{metric}: {_plain(term)}",
                "F",
                statistic,
                (above, below),
                f.sf(statistic, above, below),
                partial_eta_squared(statistic, above, below),
                assumptions,
            )
        )
    return found


def _plain(name: str) -> str:
    """Return a term of the formula in readable form, such as "group x method"."""
    return (
        name.replace("C(", "")
        .replace(", Sum)", "")
        .replace("[S.", " ")
        .replace("]", "")
        .replace(":", " x ")
    )


NODES = 96
"""Number of quadrature nodes for the integral over the intraclass correlation.

With half as many nodes, the intervals agree to four digits.
"""


SLOPE_SPREAD = 10.0
"""Prior standard deviation of slopes and intercept, divided by the residual standard deviation.

Response and predictors are standardised. The prior is almost uninformative.
"""
SHAPE = SCALE = 0.01
"""Shape and scale of the inverse gamma prior of the residual variance, almost uninformative.

Gelman (2006) advises against this prior for variances between groups. Here, the intraclass
correlation of users has a uniform prior instead.
"""


@dataclass(frozen=True)
class Posterior:
    """Posterior distribution of a regression.

    Attributes
    ----------
    slopes
        Slope of each predictor: median and credible interval, in units of the response per unit of
        the predictor.
    correlation
        Posterior mean of the intraclass correlation: variance between users divided by the variance
        about the regression line.
    chances
        Probability that each slope is positive.
    sentence
        Result in words.
    """

    slopes: tuple[Effect, ...]
    correlation: float
    chances: tuple[float, ...]
    sentence: str


def regression(
    values: ArrayLike,
    predictors: Mapping[str, ArrayLike],
    users: ArrayLike,
    *,
    response: str,
) -> Posterior:
    """Compute the posterior of a linear regression with random users.

    The model is y = b0 + X b + u(user) + e with e ~ N(0, s^2), u ~ N(0, s^2 r / (1 - r)).

    r is the intraclass correlation. For a given r, the normal-inverse-gamma prior is conjugate
    (Gelman et al. 2013, chapter 14). The slopes then have a t distribution, and the evidence has a
    closed form. r has a uniform prior and is integrated by quadrature. The posterior is therefore a
    mixture of t distributions, and is exact except for the quadrature error. Markov chains (NUTS)
    give the same intervals for the same model.

    Parameters
    ----------
    values
        Response, finite, shape (rows,).
    predictors
        Predictors by name, finite, each of shape (rows,).
    users
        User of each row, shape (rows,). Rows of one user are correlated.
    response
        Name of the response.

    Raises
    ------
    InputError
        If the response or a predictor is constant, a predictor is a linear combination of others,
        or there are fewer than two users.
    """
    columns = np.column_stack([np.asarray(each, dtype=float) for each in predictors.values()])
    answers = np.asarray(values, dtype=float)
    names, person = np.unique(np.asarray(users), return_inverse=True)
    for name, column in zip((response, *predictors), (answers, *columns.T), strict=True):
        if np.ptp(column) == 0.0:
            raise InputError(
                name, "vary", f"{column[0]:g} in all rows", "leave it out of the regression"
            )
    if len(names) < 2:
        raise InputError(
            "users",
            "be at least two",
            len(names),
            "add users: the scatter between users needs at least two",
        )
    spread = columns.std(axis=0)
    size = float(answers.std())
    design = np.column_stack([np.ones(len(answers)), (columns - columns.mean(axis=0)) / spread])
    # rounding of standardised columns, whose singular values grow with the number of rows
    if np.linalg.matrix_rank(design, tol=1e-8 * len(design)) < design.shape[1]:
        raise InputError(
            "predictors", "not repeat one another", enumerated(predictors), "leave one of them out"
        )
    standard = (answers - answers.mean()) / size
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    # from the nodes' interval of -1 to 1 to correlations of 0 to 1
    shares = 0.5 * (nodes + 1.0)
    middles, spreads, evidence = _conjugate(standard, design, person, shares / (1.0 - shares))
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
            return mass @ stdtr(degrees, (x - centre) / width)

        # the 2.5 and 97.5 % quantiles of Student's t are within 13 scales at any degrees of freedom
        ends = (centre - 40.0 * width).min(), (centre + 40.0 * width).max()
        median, low, high = (
            brentq(lambda x, wanted=wanted: below(x) - wanted, *ends) * unit[index]
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
    correlation = mass @ shares
    sentence = (
        f"{slopes_text}. Of the variance about the line {100.0 * correlation:.0f} % is "
        f"between {len(names)} users. "
        "These are associations over trials, not causes."
    )
    return Posterior(tuple(slopes), correlation, tuple(chances), sentence)


def _conjugate(
    values: Array, design: Array, person: Ints, ratios: Array
) -> tuple[Array, Array, Array]:
    """Return centre and scale of each coefficient's t distribution, and the log evidence.

    All three arrays have one entry for each ratio in `ratios`: variance between users divided by
    residual variance.

    For the n rows of one user, the inverse covariance is I - k J, where J is a matrix of ones and
    k = ratio / (1 + n ratio). Only sums over the rows of each user are therefore needed.
    """
    counts = np.bincount(person).astype(float)
    sums = np.stack([np.bincount(person, column) for column in (*design.T, values)], axis=1)
    both = np.column_stack([design, values])
    shrink = ratios[:, None] / (1.0 + counts * ratios[:, None])
    products = both.T @ both - np.einsum("ru,ui,uj->rij", shrink, sums, sums)
    width = design.shape[1]
    precision = products[:, :width, :width] + np.eye(width) / SLOPE_SPREAD**2
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
