"""Whether residuals are normal: Shapiro and Wilk, Anderson and Darling."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2, kurtosis, norm, shapiro, skew

from meshes.base.errors import InputError
from tissue.evaluation.statistics.outcome import ALPHA, Assumption, Outcome, format_p, studied

__all__ = ["anderson_darling", "mardia", "normal_residuals", "shapiro_wilk"]

MOST = 5000
"""Largest sample for which the p value of Shapiro and Wilk's test is known (Royston 1995)."""


def shapiro_wilk(residuals: ArrayLike, *, name: str = "residuals") -> Outcome:
    """Test residuals for normality by Shapiro and Wilk (1965), p by Royston (1995); 3 to 5,000 values."""
    values = _sample(residuals, name, 3)
    if len(values) > MOST:
        raise InputError(f"{name} must be at most {MOST} for this test, got {len(values)}: use Anderson and Darling's")
    found = shapiro(values)
    return Outcome("Shapiro-Wilk", f"{name}: normal", "W", float(found.statistic), (), float(found.pvalue))


def anderson_darling(residuals: ArrayLike, *, name: str = "residuals") -> Outcome:
    """Test residuals for normality by Anderson and Darling (1952), mean and variance estimated (Stephens 1986)."""
    values = _sample(residuals, name, 8)
    studied()
    from statsmodels.stats.diagnostic import normal_ad

    statistic, p = normal_ad(values)
    return Outcome("Anderson-Darling", f"{name}: normal", "A2", float(statistic), (), float(p))


def normal_residuals(residuals: ArrayLike, *, name: str = "normal residuals") -> Assumption:
    """Normality as an assumption of another test: refused where either test refuses it at half the usual chance.

    In a large sample the slightest departure is refused, so skewness and excess kurtosis are reported too: below about
    1 and 2 in size they hardly matter to a comparison of means (West et al. 1995 warn from 2 and 7).
    """
    values = _sample(residuals, name, 8)
    tests = [anderson_darling(values)]
    if len(values) <= MOST:
        tests.insert(0, shapiro_wilk(values))
    holds = all(each.p >= ALPHA / len(tests) for each in tests)
    tests_text = ", ".join(f"{each.test} {format_p(each.p)}" for each in tests)
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
    rows = np.atleast_2d(np.asarray(residuals, dtype=float))
    count, width = rows.shape
    if count <= width + 1:
        raise InputError(f"residuals must have more rows than columns, got {rows.shape}: add users or drop metrics")
    centred = rows - rows.mean(axis=0)
    distances = centred @ np.linalg.solve(centred.T @ centred / count, centred.T)
    small = (width + 1) * (count + 1) * (count + 3) / (count * ((count + 1) * (width + 1) - 6.0))
    skewed = chi2.sf(small * count / 6.0 * (distances**3).mean(), width * (width + 1) * (width + 2) / 6)
    tails = (np.diag(distances) ** 2).mean() - width * (width + 2)
    tailed = 2.0 * norm.sf(abs(tails) / np.sqrt(8.0 * width * (width + 2) / count))
    holds = bool(min(skewed, tailed) >= 0.5 * ALPHA)
    return Assumption("joint normality", holds, f"Mardia's skewness {format_p(skewed)}, kurtosis {format_p(tailed)}")


def _sample(values: ArrayLike, name: str, at_least: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Finite values that vary."""
    sample = np.asarray(values, dtype=float).ravel()
    if len(sample) < at_least or not np.isfinite(sample).all():
        raise InputError(
            f"{name} must be at least {at_least} finite values, got {len(sample)}: leave failed trials out"
        )
    if np.ptp(sample) == 0.0:
        raise InputError(f"{name} must vary, got {sample[0]:g} throughout: a constant has no distribution to test")
    return sample
