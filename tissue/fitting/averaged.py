"""Logs averaged over blocks: fewer samples, nothing above their rate folded into them."""

import numpy as np

from meshes.base.arrays import Array
from tissue.fitting.measured import MeasuredLoads
from tissue.models.tissue_model import TICK_S

__all__ = ["block_averages", "block_ticks"]

MOST_SAMPLES = 2000
"""Samples of a log that a fit takes: noise that lasts for longer than a block is modelled, not averaged out."""
LEAST_BLOCK = 5
"""Ticks of a block: tooth passing and sensor noise above 100 Hz are not what constants are found from."""


def block_ticks(duration_s: float, period_s: float) -> int:
    """Ticks over which a log is averaged; a block of a log slower than 200 Hz holds one sample.

    Parameters
    ----------
    duration_s, period_s
        Of the log, and between two of its samples [s].
    """
    return max(LEAST_BLOCK, int(np.ceil(max(duration_s / MOST_SAMPLES, period_s) / TICK_S - 1e-6)))


def block_averages(times_s: Array, values: Array, channels: tuple[str, ...], ticks: int) -> MeasuredLoads:
    """Means over blocks; NaN where a block holds less than half of the samples that it should.

    Parameters
    ----------
    times_s
        Shape (n,), increasing, at any rate [s].
    values
        Shape (n, channels), NaN where missing.
    channels
        Their names.
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
    middles, seen = np.zeros(count), np.maximum(np.bincount(place, minlength=count), 1)
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
