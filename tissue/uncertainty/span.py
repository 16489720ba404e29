"""The loads of runs of different length over time: their quantiles as far as nearly all of them reach."""

import numpy as np

from meshes.base.arrays import Array
from tissue.simulation.run_summary import Summary
from tissue.uncertainty.figures import LEVELS

__all__ = ["over_time"]

REACH = 0.9
"""Least share of the runs that a quantile over time is of: the 5 and 95 % quantiles of fewer are those of a part."""


def over_time(loads: list[Array], times_s: Array) -> tuple[Array, Summary]:
    """Quantiles `LEVELS` of loads at each tick, of the runs that reach it, as long as nine in ten do.

    Parameters
    ----------
    loads
        Of each run, shape (ticks of it, channels).
    times_s
        Times of the run at nominal constants, shape (n,); beyond its end there are none.

    Returns
    -------
    Quantiles, shape (5, ticks, channels), and over which span they hold.
    """
    lengths = np.sort([len(each) for each in loads])
    reached = len(lengths) - np.searchsorted(lengths, np.arange(len(times_s)), side="right")
    last = int((reached >= REACH * len(lengths)).sum())
    shortest = min(int(lengths[0]), last)
    levels = tuple(LEVELS.values())
    quantiles = np.empty((len(levels), last, loads[0].shape[1]))
    quantiles[:, :shortest] = np.quantile(np.stack([each[:shortest] for each in loads]), levels, axis=0)
    for tick in range(shortest, last):
        quantiles[:, tick] = np.quantile([each[tick] for each in loads if len(each) > tick], levels, axis=0)
    step_s = times_s[0] if len(times_s) == 1 else times_s[1] - times_s[0]
    return quantiles, {
        "ticks": last,
        "ends_s": float(times_s[last - 1]) if last else 0.0,
        "run_ends_s": float(times_s[-1]),
        "shortest_sample_s": float(step_s * lengths[0]),
        "samples_at_end": int(reached[last - 1]) if last else 0,
    }
