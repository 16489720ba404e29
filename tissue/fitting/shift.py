"""Loads at the times of a log: interpolated, shifted in time, with the derivative by the shift."""

from collections.abc import Sequence

import numpy as np
from scipy.sparse import csr_array

from meshes.base.arrays import Array

__all__ = ["shift_operators"]


def shift_operators(
    times_s: Array, wanted_s: Array, offset_s: float, within_s: Sequence[float] = (0.0,)
) -> tuple[csr_array, csr_array]:
    """Interpolate what is known at `times_s` at the times ``wanted_s - offset_s``, as matrices.

    Cubic through four neighbours (Catmull and Rom, 1974), whose slope is continuous, so that a gradient by the offset
    is; before the first and after the last time it is the value there.

    Parameters
    ----------
    times_s
        Shape (n,), increasing.
    wanted_s
        Shape (m,), on a clock that is ahead by the offset.
    offset_s
        The offset [s].
    within_s
        Times about each wanted one over which the mean is taken [s], k of them.

    Returns
    -------
    tuple
        Values, and their derivative by `offset_s` [1/s]: matrices of shape (m, n).
    """
    last = len(times_s) - 1
    asked = (np.asarray(wanted_s)[:, None] + np.asarray(within_s)).ravel() - offset_s
    inside = (asked > times_s[0]) & (asked < times_s[-1])
    asked = np.clip(asked, times_s[0], times_s[-1])
    left = np.clip(np.searchsorted(times_s, asked, side="right") - 1, 0, last - 1)
    places = np.clip(left[:, None] + np.arange(-1, 3), 0, last)
    before, start, end, after = times_s[places].T
    width = end - start
    u = (asked - start) / width
    slope_start, slope_end = width / (end - before), width / (after - start)
    start_tangent, end_tangent = u * (1.0 - u) ** 2, u * u * (u - 1.0)
    blend = u * u * (3.0 - 2.0 * u)
    weights = _rows(1.0 - blend, blend, start_tangent * slope_start, end_tangent * slope_end)
    blend = 6.0 * u * (1.0 - u)
    start_tangent, end_tangent = (1.0 - u) * (1.0 - 3.0 * u), u * (3.0 * u - 2.0)
    rates = _rows(-blend, blend, start_tangent * slope_start, end_tangent * slope_end)
    rates *= np.where(inside, -1.0 / width, 0.0)[:, None]
    count, each = len(asked) // len(within_s), 4 * len(within_s)
    shape, starts = (count, last + 1), np.arange(0, each * count + 1, each)
    return (
        csr_array((weights.ravel() / len(within_s), places.ravel(), starts), shape=shape),
        csr_array((rates.ravel() / len(within_s), places.ravel(), starts), shape=shape),
    )


def _rows(at_start: Array, at_end: Array, start_tangent: Array, end_tangent: Array) -> Array:
    """Weights of the four neighbours, shape (m, 4), of the Hermite form of a cubic."""
    return np.stack([-start_tangent, at_start - end_tangent, at_end + start_tangent, end_tangent], axis=1)
