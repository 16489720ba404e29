"""Measured loads as a fit takes them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from meshes.base.arrays import Array
from meshes.base.errors import InputError
from tissue.models.tissue_model import TICK_S

__all__ = ["MeasuredLoads", "block_averages", "block_ticks", "shift_operators"]

FEWEST = 50
"""Minimum number of samples of a channel.

With fewer samples, the scale and the correlation of its noise cannot be estimated.
"""


@dataclass(frozen=True)
class MeasuredLoads:
    """Loads on a tool over time.

    Attributes
    ----------
    times_s
        Shape (m,), increasing at one rate, on the clock of the force sensor.
    values
        Shape (m, channels), NaN where missing.
    channels
        Names with units, such as ``force_x_N``.
    within_s
        Times relative to the time of a sample, shape (k,) [s]. A sample is the mean of the loads
        read at these times.

    Raises
    ------
    InputError
        If shapes disagree, times do not rise, or a channel has fewer than 50 samples.
    """

    times_s: Array
    values: Array
    channels: tuple[str, ...]
    within_s: tuple[float, ...] = (0.0,)

    def __post_init__(self) -> None:
        if self.values.shape != (len(self.times_s), len(self.channels)):
            raise InputError(
                "values",
                f"have shape ({len(self.times_s)}, {len(self.channels)}), of times and channels",
                self.values.shape,
                "give one row a sample",
            )
        if not (np.diff(self.times_s) > 0.0).all():
            raise InputError(
                "times_s",
                "increase",
                "one that does not",
                "sort the samples and drop repeated ones",
            )
        counts = np.isfinite(self.values).sum(axis=0)
        if len(counts) and counts.min() < FEWEST:
            raise InputError(
                "values",
                f"hold {FEWEST} samples of each channel",
                f"{counts.min()} of {self.channels[int(np.argmin(counts))]}",
                "leave the channel out or give a longer log",
            )

    def sizes(self) -> Array:
        """Robust root mean square of each channel's unit [N or N m], shape (channels,).

        Outliers have little influence.

        Channels of one unit share the largest, since a channel without load has nothing but noise.
        """
        middle = np.nanmedian(self.values, axis=0)
        spread = 1.4826 * np.nanmedian(np.abs(self.values - middle), axis=0)
        cut = np.clip(self.values, middle - 10.0 * spread, middle + 10.0 * spread)
        size = np.sqrt(np.nanmean(np.where(spread > 0.0, cut, self.values) ** 2, axis=0))
        units = np.array([name.rpartition("_")[2] for name in self.channels])
        return np.array([size[units == unit].max() for unit in units])


MOST_SAMPLES = 2000
"""Samples of a log that a fit takes: noise that lasts for longer than a block is modelled, not
averaged out.
"""
LEAST_BLOCK = 5
"""Ticks of a block.

Constants are not identified from tooth passing and sensor noise above 100 Hz.
"""


def block_ticks(duration_s: float, period_s: float) -> int:
    """Return the ticks over which a log is averaged.

    A block of a log slower than 200 Hz holds one sample.

    Parameters
    ----------
    duration_s, period_s
        Duration of the log, and time between two of its samples [s].
    """
    return max(LEAST_BLOCK, int(np.ceil(max(duration_s / MOST_SAMPLES, period_s) / TICK_S - 1e-6)))


def block_averages(
    times_s: Array, values: Array, channels: tuple[str, ...], ticks: int
) -> MeasuredLoads:
    """Return means over blocks.

    A mean is NaN if its block holds less than half of the expected samples.

    Parameters
    ----------
    times_s
        Increasing times [s], at any rate, shape (n,).
    values
        Values, shape (n, channels), NaN where missing.
    channels
        Names of the channels.
    ticks
        Ticks of a block.
    """
    block_s = ticks * TICK_S
    place = np.floor((times_s - times_s[0]) / block_s + 1e-9).astype(np.int64)
    count = int(place[-1]) + 1
    rate = float(np.median(np.diff(times_s)))
    known = np.isfinite(values)
    sums = np.zeros((count, values.shape[1]))
    counts = np.zeros((count, values.shape[1]))
    middles = np.zeros(count)
    seen = np.maximum(np.bincount(place, minlength=count), 1)
    np.add.at(sums, place, np.where(known, values, 0.0))
    np.add.at(counts, place, known)
    np.add.at(middles, place, times_s)
    enough = counts >= max(0.5 * block_s / rate, 1.0)
    averages = np.where(enough, sums / np.maximum(counts, 1.0), np.nan)
    starts = times_s[0] + block_s * np.arange(count)
    shift = float(np.median((middles / seen - starts)[enough.any(axis=1)]))
    each = max(round(block_s / rate), 1)
    within_s = tuple((rate * (np.arange(each) - 0.5 * (each - 1))).tolist())
    return MeasuredLoads(starts + shift, averages, channels, within_s)


def shift_operators(
    times_s: Array, wanted_s: Array, offset_s: float, within_s: Sequence[float] = (0.0,)
) -> tuple[csr_array, csr_array]:
    """Return matrices that interpolate from `times_s` to the times ``wanted_s - offset_s``.

    The interpolation is a cubic through four neighbours (Catmull and Rom, 1974). Its slope is
    continuous, so that the gradient by the offset is continuous too. Before the first time and
    after the last time, the end value is used.

    Parameters
    ----------
    times_s
        Shape (n,), increasing.
    wanted_s
        Shape (m,), on a clock that is ahead by the offset.
    offset_s
        The offset [s].
    within_s
        Times relative to each wanted time over which the mean is computed [s], shape (k,).

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
    slope_start = width / (end - before)
    slope_end = width / (after - start)
    start_tangent = u * (1.0 - u) ** 2
    end_tangent = u * u * (u - 1.0)
    blend = u * u * (3.0 - 2.0 * u)
    weights = _hermite(1.0 - blend, blend, start_tangent * slope_start, end_tangent * slope_end)
    blend = 6.0 * u * (1.0 - u)
    start_tangent = (1.0 - u) * (1.0 - 3.0 * u)
    end_tangent = u * (3.0 * u - 2.0)
    rates = _hermite(-blend, blend, start_tangent * slope_start, end_tangent * slope_end)
    rates *= np.where(inside, -1.0 / width, 0.0)[:, None]
    count = len(asked) // len(within_s)
    each = 4 * len(within_s)
    shape = (count, last + 1)
    starts = np.arange(0, each * count + 1, each)
    return (
        csr_array((weights.ravel() / len(within_s), places.ravel(), starts), shape=shape),
        csr_array((rates.ravel() / len(within_s), places.ravel(), starts), shape=shape),
    )


def _hermite(at_start: Array, at_end: Array, start_tangent: Array, end_tangent: Array) -> Array:
    """Return the weights of the four neighbours in a cubic's Hermite form, shape (m, 4)."""
    return np.stack(
        [-start_tangent, at_start - end_tangent, at_end + start_tangent, end_tangent], axis=1
    )
