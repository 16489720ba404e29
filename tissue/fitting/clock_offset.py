"""The interval of the offset of two clocks, summed numerically: its density may have several maxima.

Where a load jumps between two samples, every offset that leaves the jump between them explains the log equally well, so
that a normal law about the maximum is too narrow.
"""

import numpy as np

from meshes.base.arrays import Array
from tissue.fitting.marginal import log_density_at
from tissue.fitting.target import OFFSET_S, Target

__all__ = ["offset_interval_s"]

WIDE = np.linspace(-3.0, 3.0, 121)
"""Offsets about the most probable one at which the density is found, in samples of the log."""
NEGLIGIBLE = 30.0
"""Fall of the log density which, over a whole sample, ends the search to that side."""
NARROW = np.linspace(-4.0, 4.0, 33)
"""The same in standard deviations of the normal law about it."""
SHARES = (0.05, 0.95)


def offset_interval_s(target: Target, maximum: Array, spread_s: float) -> tuple[float, float]:
    """90 % interval of the offset of the force's clock against that of the poses [s].

    At each offset the constants and biases are the most probable ones there, sought from those of its neighbour; the
    noise is kept.

    Parameters
    ----------
    target
        The density.
    maximum
        Its place, shape (size,).
    spread_s
        Standard deviation of the normal law about it [s].
    """
    rate_s = float(np.median(np.diff(target.log.times_s)))
    middle_s = OFFSET_S * float(maximum[target.constants])
    offsets_s = np.unique(np.concatenate([middle_s + rate_s * WIDE, middle_s + spread_s * NARROW]))
    later = offsets_s >= middle_s
    below = _log_densities(target, maximum, offsets_s[~later][::-1], rate_s)[::-1]
    logarithms = np.concatenate([below, _log_densities(target, maximum, offsets_s[later], rate_s)])
    density = np.exp(logarithms - logarithms.max())
    summed = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(offsets_s))])
    low, high = np.interp(np.array(SHARES) * summed[-1], summed, offsets_s).tolist()
    return low, high


def _log_densities(target: Target, u: Array, offsets_s: Array, rate_s: float) -> Array:
    """Log densities of offsets that go away from that of the place, minus infinity where they are negligible."""
    found, last_s = np.full(len(offsets_s), -np.inf), offsets_s[0]
    for k, offset_s in enumerate(offsets_s.tolist()):
        u = u.copy()
        u[target.constants] = offset_s / OFFSET_S
        found[k], u = log_density_at(target, u, target.constants)
        if found[k] > found.max() - NEGLIGIBLE:
            last_s = offset_s
        elif abs(offset_s - last_s) > rate_s:
            break
    return found
