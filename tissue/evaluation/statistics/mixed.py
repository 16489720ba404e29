"""Linear mixed models with random users, by statsmodels."""

import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import f, t

from meshes.base.errors import InputError
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
    from statsmodels.regression.mixed_linear_model import MixedLMResults

__all__ = ["Components", "MixedModel", "mixed_model"]

ITERATIONS = 400
"""Number of iterations after which the fit counts as not converged."""
LEAST = 1e-6
"""Share of the variance that must be left over for the likelihood to be bounded."""


@dataclass(frozen=True)
class Components:
    """Variances in the square of the metric's unit.

    Attributes
    ----------
    user
        Variance of users about their group.
    user_method
        Variance of the interaction of users with methods, within a task.
    trial
        Variance of trials of one user, shared by all methods that render that trial.
    residual
        Remaining variance.
    user_task
        Variance of the interaction of users with tasks. Zero for one task.
    """

    user: float
    user_method: float
    trial: float
    residual: float
    user_task: float = 0.0


@dataclass(frozen=True)
class MixedModel:
    """A fitted mixed model.

    Attributes
    ----------
    components
        Variances of users, of users by method, of trials and of the rest.
    coefficients
        Fixed effects as deviations from the grand mean, with intervals from t with the degrees of
        freedom of their stratum.
    tests
        One of each fixed effect: F with the degrees of freedom of the stratum that it is tested in.
    """

    components: Components
    coefficients: tuple[Effect, ...]
    tests: tuple[HypothesisTest, ...]


def mixed_model(table: TrialTable, metric: str) -> MixedModel:
    """Fit a mixed model of a metric by restricted likelihood.

    The model is metric = mean + group x method (x task) + user + user by method + trial + rest.

    The interaction of users with methods is a separate term. Without it, the methods' test would
    count trials of one user as independent (Barr et al. 2013). Trials that several methods render
    are a separate term too. Terms that the table cannot separate (one trial per cell) are left out.
    Wald's statistic is compared with F with the degrees of freedom of its stratum. Chi squared
    would reject too often with few users. In a complete design this is the exact test of
    :func:`tissue.evaluation.statistics.strata.strata`, unless a variance is estimated as zero.

    Raises
    ------
    InputError
        If there is nothing to compare, or a group keeps fewer than two users.
    """
    within = [name for name in ("task", "method") if len(np.unique(getattr(table, name))) > 1]
    cells = table.cells(metric, within=within or ["method"])
    group_count = len(cells.group_names)
    user_count = len(cells.users)
    if not within and group_count < 2:
        raise InputError(
            "table",
            "hold two groups, tasks or methods",
            "one of each",
            "there is nothing to compare",
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
    parts = {name: f"0 + C({name})" for name in within if (cells.counts > 1).any()}
    if {"task", "method"} <= set(parts):
        parts["both"] = "0 + C(task):C(method)"
    if "method" in parts and frame.duplicated(["user", "trial"]).any():
        parts["trial"] = "0 + C(trial)"
    scale = float(frame["value"].std())
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
        fitted = model.fit(reml=True, maxiter=ITERATIONS)
    found = dict(zip(model.exog_vc.names if parts else (), fitted.vcomp, strict=True))
    variances = (
        fitted.cov_re.iloc[0, 0],
        found.get("method", 0.0) + found.get("both", 0.0),
        found.get("trial", 0.0),
        fitted.scale,
        found.get("task", 0.0),
    )
    components = Components(*(scale**2 * float(each) for each in variances))
    assumptions = (
        _convergence(bool(fitted.converged), components, caught),
        normal_residuals(fitted.resid),
        *_normal_users(fitted),
    )
    free = user_count - group_count
    return MixedModel(
        components,
        _coefficients(fitted, scale, free),
        tuple(_tests(fitted, metric, free, assumptions)),
    )


def _convergence(
    reported_convergence: bool, found: Components, caught: list[warnings.WarningMessage]
) -> Assumption:
    """Check whether the optimiser has reached the maximum.

    It has been seen to report convergence wrongly without a residual.
    """
    name = "convergence"
    if not reported_convergence:
        warned = str(caught[-1].message).split("\n")[0] if caught else "no reason given"
        return Assumption(
            name, False, f"restricted likelihood not at its maximum in {ITERATIONS} steps: {warned}"
        )
    if found.residual < LEAST * sum(vars(found).values()):
        return Assumption(
            name,
            False,
            "restricted likelihood has no maximum: nothing varies beside users and trials",
        )
    return Assumption(name, True, "restricted likelihood at its maximum")


def _freedom(fitted: "MixedLMResults", name: str, free: int) -> int:
    """Return the degrees of freedom of the stratum of a term or coefficient.

    They are the users' degrees of freedom times those of the factors within users.
    """
    levels = fitted.model.data.frame.nunique()
    for factor in ("task", "method"):
        free *= int(levels[factor]) - 1 if f"C({factor}" in name else 1
    return free


def _coefficients(fitted: "MixedLMResults", scale: float, free: int) -> tuple[Effect, ...]:
    """Return the fixed effects in the metric's unit."""
    found = []
    for name, value, error in zip(
        fitted.fe_params.index, fitted.fe_params, fitted.bse_fe, strict=True
    ):
        half = float(t.ppf(0.5 * (1.0 + LEVEL), _freedom(fitted, name, free))) * error
        found.append(
            Effect(
                _plain(name), *(scale * float(each) for each in (value, value - half, value + half))
            )
        )
    return tuple(found)


def _tests(
    fitted: "MixedLMResults", metric: str, free: int, assumptions: tuple[Assumption, ...]
) -> list[HypothesisTest]:
    """Return Wald's F of every effect, in its stratum."""
    found = []
    for term, row in fitted.wald_test_terms(scalar=True).table.iterrows():
        if term == "Intercept":
            continue
        above = int(row["df_constraint"])
        below = _freedom(fitted, term, free)
        statistic = float(row["statistic"]) / above
        found.append(
            HypothesisTest(
                "mixed model",
                f"{metric}: {_plain(term)}",
                "F",
                statistic,
                (above, below),
                float(f.sf(statistic, above, below)),
                partial_eta_squared(statistic, above, below),
                assumptions,
            )
        )
    return found


def _normal_users(fitted: "MixedLMResults") -> list[Assumption]:
    """Check normality of the estimated effects of users.

    The check needs enough users whose effects are not all zero.
    """
    users = np.array([float(each.iloc[0]) for each in fitted.random_effects.values()])
    return (
        [normal_residuals(users, name="normal users")]
        if len(users) >= 8 and np.ptp(users) > 1e-9
        else []
    )


def _plain(name: str) -> str:
    """Return a term of the formula in readable form."""
    return (
        name.replace("C(", "")
        .replace(", Sum)", "")
        .replace("[S.", " ")
        .replace("]", "")
        .replace(":", " x ")
    )
