"""What an observer discriminates: the share of right answers, and the discrimination threshold."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq, minimize_scalar
from scipy.special import ndtr, ndtri
from scipy.stats import chi2

from meshes.base.errors import InputError, require_range
from tissue.evaluation.statistics.outcome import LEVEL

__all__ = ["Share", "Threshold", "classification_accuracy", "discrimination_threshold"]


@dataclass(frozen=True)
class Share:
    """A share of right answers with its interval, and the number of answers it rests on."""

    value: float
    low: float
    high: float
    count: int


@dataclass(frozen=True)
class Threshold:
    """A noticeable difference with its interval, in the unit of the differences that were shown."""

    value: float
    low: float
    high: float


def classification_accuracy(answers: ArrayLike, truth: ArrayLike, *, level: float = LEVEL) -> Share:
    """Share of trials in which the answer is true, with Wilson's interval (Wilson 1927).

    Parameters
    ----------
    answers, truth
        Labels of any kind, shape (trials,).
    level
        Coverage of the interval.
    """
    given, right = np.asarray(answers), np.asarray(truth)
    if given.ndim != 1 or given.shape != right.shape or not len(given):
        raise InputError(
            f"answers and truth must hold one label a trial, got {given.shape} and {right.shape}: "
            "pass both of one study"
        )
    count = len(given)
    share = float((given == right).mean())
    z = float(ndtri(0.5 * (1.0 + require_range("level", level, 0.5, 0.999, "use 0.95"))))
    middle = (share + z * z / (2 * count)) / (1.0 + z * z / count)
    half = z / (1.0 + z * z / count) * np.sqrt(share * (1.0 - share) / count + z * z / (4.0 * count * count))
    return Share(share, float(max(0.0, middle - half)), float(min(1.0, middle + half)), count)


def discrimination_threshold(
    difference: ArrayLike,
    right: ArrayLike,
    *,
    share: float = 0.75,
    lapse: float = 0.02,
    level: float = LEVEL,
) -> Threshold:
    """Difference at which a given share of two-interval answers is right, by maximum likelihood.

    The share of right answers is 1/2 + (1/2 - lapse)(2 Phi(x / (sqrt(2) s)) - 1) with one unknown, the spread s of what
    is felt (Green and Swets 1966), so that x = 0.954 s gives 75 % without lapses. The interval is where twice the log
    likelihood falls by less than the quantile of chi squared.

    Parameters
    ----------
    difference
        Differences that were shown, positive, in any unit, shape (answers,).
    right
        Whether each answer was right, shape (answers,).
    share
        Share of right answers that defines the threshold, lapses not counted.
    lapse
        Share of strong stimuli that is answered wrongly; 0.02 is usual (Wichmann and Hill 2001).

    Raises
    ------
    InputError
        If all answers are right, or no more than half are: the threshold is then not bounded.
    """
    shown, correct = np.asarray(difference, dtype=float), np.asarray(right, dtype=bool)
    if shown.ndim != 1 or shown.shape != correct.shape or not len(shown):
        raise InputError(
            f"difference and right must hold one entry an answer, got {shown.shape} and {correct.shape}: "
            "pass both of one session"
        )
    if not (np.isfinite(shown).all() and (shown > 0.0).all()):
        raise InputError(f"difference must be positive and finite, got {shown.min():g}: leave out equal pairs")
    if correct.all() or correct.mean() <= 0.5:
        raise InputError(
            f"right must hold some errors and more than half right, got {correct.sum()} of {len(correct)}: "
            "show smaller or larger differences"
        )
    require_range("share", share, 0.51, 0.99, "use 0.75")
    require_range("lapse", lapse, 0.0, 0.2, "use 0.02")

    def misfit(log_spread: float) -> float:
        """Minus twice the log likelihood."""
        felt = 2.0 * ndtr(shown / (np.sqrt(2.0) * np.exp(log_spread))) - 1.0
        chance = np.clip(0.5 + (0.5 - lapse) * felt, 1e-12, 1.0 - 1e-12)
        return -2.0 * float(np.log(np.where(correct, chance, 1.0 - chance)).sum())

    ends = (float(np.log(shown.min() * 1e-2)), float(np.log(shown.max() * 1e3)))
    grid = np.linspace(*ends, 200)
    start = int(np.argmin([misfit(each) for each in grid]))
    bounds = (grid[max(0, start - 1)], grid[min(199, start + 1)])
    best = minimize_scalar(misfit, bounds=bounds, method="bounded", options={"xatol": 1e-10})
    limit = float(best.fun) + float(chi2.ppf(require_range("level", level, 0.5, 0.999, "use 0.95"), 1))
    found = [
        brentq(lambda each: misfit(each) - limit, best.x, end) if misfit(end) > limit else limitless
        for end, limitless in zip(ends, (-np.inf, np.inf), strict=True)
    ]
    scale = np.sqrt(2.0) * float(ndtri(share))
    return Threshold(*(scale * float(np.exp(each)) for each in (best.x, *found)))
