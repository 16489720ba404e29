"""Whether residuals are normal: Shapiro and Wilk, Anderson and Darling, Mardia."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2, kurtosis, norm, shapiro, skew

from meshes.base.errors import InputError
from tissue.evaluation.statistics.hypothesis_test import ALPHA, Assumption, format_p

__all__ = ["mardia", "normal_residuals"]

MOST = 5000
"""Largest sample for which the p value of Shapiro and Wilk's test is known (Royston 1995)."""


def normal_residuals(residuals: ArrayLike, *, name: str = "normal residuals") -> Assumption:
    """Normality as an assumption of another test: refused where a test refuses it at half the usual chance.

    The tests are Shapiro and Wilk's (1965), p by Royston (1995), for up to 5,000 values, and Anderson and Darling's
    (1952) with estimated mean and variance (Stephens 1986), for 8 or more. In a large sample the slightest departure is
    refused, so skewness and excess kurtosis are reported too: below about 1 and 2 in size they hardly matter to a
    comparison of means (West et al. 1995 warn from 2 and 7).

    Raises
    ------
    InputError
        If the residuals are constant.
    """
    from statsmodels.stats.diagnostic import normal_ad

    values = np.ravel(residuals)
    if np.ptp(values) == 0.0:
        raise InputError(f"{name} must vary, got {values[0]:g} throughout: a constant has no distribution to test")
    p_values = {"Shapiro-Wilk": float(shapiro(values).pvalue)} if len(values) <= MOST else {}
    p_values["Anderson-Darling"] = float(normal_ad(values)[1])
    holds = min(p_values.values()) >= ALPHA / len(p_values)
    tests_text = ", ".join(f"{test} {format_p(p)}" for test, p in p_values.items())
    return Assumption(
        name, holds, f"{tests_text}, skewness {float(skew(values)):.2f}, excess kurtosis {float(kurtosis(values)):.2f}"
    )


def mardia(residuals: ArrayLike) -> Assumption:
    """Joint normality of several columns by Mardia's (1970, 1974) skewness and kurtosis, each at half the usual chance.

    Parameters
    ----------
    residuals
        Shape (users, columns), more rows than columns.
    """
    rows = np.asarray(residuals, dtype=float)
    count, width = rows.shape
    centred = rows - rows.mean(axis=0)
    distances = centred @ np.linalg.solve(centred.T @ centred / count, centred.T)
    small = (width + 1) * (count + 1) * (count + 3) / (count * ((count + 1) * (width + 1) - 6.0))
    skewed = chi2.sf(small * count / 6.0 * (distances**3).mean(), width * (width + 1) * (width + 2) / 6)
    tails = (np.diag(distances) ** 2).mean() - width * (width + 2)
    tailed = 2.0 * norm.sf(abs(tails) / np.sqrt(8.0 * width * (width + 2) / count))
    holds = bool(min(skewed, tailed) >= 0.5 * ALPHA)
    return Assumption("joint normality", holds, f"Mardia's skewness {format_p(skewed)}, kurtosis {format_p(tailed)}")
