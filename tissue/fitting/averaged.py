"""Logs and recorded cuts averaged over blocks: fewer samples, nothing above their rate folded into them."""

from dataclasses import replace

import numpy as np

from meshes.base.arrays import Array
from tissue.fitting.cutting import CuttingForward
from tissue.fitting.measured import MeasuredLoads
from tissue.models.tissue_model import TICK_S

__all__ = ["averaged_cut", "block_averages", "block_ticks"]

MOST_SAMPLES = 2000
"""Samples of a log that a fit takes: noise that lasts for longer than a block is modelled, not averaged out."""
LEAST_BLOCK = 5
"""Ticks of a block: tooth passing and sensor noise above 100 Hz are not what constants are found from."""


def block_ticks(duration_s: float) -> int:
    """Ticks over which a log is averaged."""
    return max(LEAST_BLOCK, int(np.ceil(duration_s / (MOST_SAMPLES * TICK_S))))


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
    return MeasuredLoads(starts + shift, averages, channels)


def averaged_cut(forward: CuttingForward, ticks: int) -> CuttingForward:
    """A recorded cut averaged as `block_averages` does: exact, since its loads are sums of what was recorded."""
    record = forward.record
    blocks = len(record.times_s) // ticks

    def averaged(values: Array, axis: int) -> Array:
        whole = np.moveaxis(values, axis, 0)[: blocks * ticks]
        return np.moveaxis(whole.reshape(blocks, ticks, *whole.shape[1:]).mean(axis=1), 0, axis)

    layers = {at: replace(each, unit=averaged(each.unit, 2)) for at, each in record.layers.items()}
    engaged = averaged(record.engaged_m2, 0)
    smaller = replace(record, layers=layers, times_s=averaged(record.times_s, 0), engaged_m2=engaged)
    return replace(forward, record=smaller, times_s=averaged(forward.times_s, 0))
