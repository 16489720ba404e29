"""95 % intervals of a mean over independent units, such as runs or people."""

from math import exp
from typing import NamedTuple

import numpy as np

from meshes.base.arrays import Array


class Interval(NamedTuple):
    """Mean over independent units, such as people, and the ends of its 95 % interval."""

    mean: float
    low: float
    high: float


def mean_interval(values: Array) -> Interval:
    """Return the mean of values, shape (n,), with a symmetric interval by Student's t.

    The values are independent, such as one per person. Use this interval for values that may be
    positive or negative, such as differences. For a single value, the interval has zero width.
    """
    mean = float(values.mean())
    half = _half_width(values)
    return Interval(mean, mean - half, mean + half)


def signed_interval(values: Array) -> Interval:
    """Return the mean of values, shape (n,), with an interval of the same sign as the values.

    Errors and times are positive, but a symmetric interval from a few skewed values can extend
    below zero. The t interval is therefore computed for the logarithm of the mean. The standard
    error of this logarithm is the standard error of the mean divided by the mean (delta method). If
    the values do not all have the same sign, the symmetric interval is returned.
    """
    mean = float(values.mean())
    if not ((values > 0.0).all() or (values < 0.0).all()):
        return mean_interval(values)
    # A half width of a hundred times the mean means that nothing is known.
    factor = exp(min(_half_width(values) / abs(mean), 100.0))
    low, high = sorted((mean / factor, mean * factor))
    return Interval(mean, low, high)


def _half_width(values: Array) -> float:
    """Return half of the width of the 95 % interval by Student's t, zero for a single value."""
    from scipy.stats import t

    count = len(values)
    if count < 2:
        return 0.0
    # two-sided 95 % interval of a mean
    return float(t.ppf(0.975, count - 1) * values.std(ddof=1) / np.sqrt(count))
