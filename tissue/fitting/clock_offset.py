"""The interval of the offset of two clocks, summed numerically: its density may have several maxima.

Where a load jumps between two samples, every offset that leaves the jump between them explains the log equally well, so
that a normal law about the maximum is too narrow.
"""

import numpy as np

from meshes.base.arrays import Array
from tissue.fitting.noise import noise_terms
from tissue.fitting.target import OFFSET_S, Target

__all__ = ["offset_interval_s"]

WIDE = np.linspace(-3.0, 3.0, 121)
"""Offsets about the most probable one at which the density is found, in samples of the log."""
NARROW = np.linspace(-4.0, 4.0, 33)
"""The same in standard deviations of the normal law about it."""
SHARES = (0.05, 0.95)


def offset_interval_s(target: Target, maximum: Array, spread_s: float) -> tuple[float, float]:
    """90 % interval of the offset of the force's clock against that of the poses [s].

    At each offset the constants and biases are the most probable ones there, by one Gauss-Newton step; the noise is
    kept.

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
    logarithms = np.array([_log_density(target, maximum, offset_s) for offset_s in offsets_s])
    density = np.exp(logarithms - logarithms.max())
    summed = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(offsets_s))])
    low, high = np.interp(np.array(SHARES) * summed[-1], summed, offsets_s).tolist()
    return low, high


def _log_density(target: Target, maximum: Array, offset_s: float) -> float:
    """Log density of an offset, everything else summed over by Laplace's approximation."""
    u, at, free = maximum.copy(), target.constants, target.constants + 1 + len(target.log.channels)
    u[at] = offset_s / OFFSET_S
    others = np.delete(np.arange(free), at)
    noise = target.unpacked(u)
    simulated, moved = target.linearised(u)
    terms = noise_terms(target.log.values - simulated, noise.scale, noise.correlation)
    columns = target.whitened(moved, noise)[:, others]
    curvature = columns.T @ columns + np.eye(len(others))
    pull = np.where(np.isfinite(terms.by_residuals), terms.by_residuals, 0.0).ravel()
    gradient = -moved.reshape(-1, free)[:, others].T @ pull - u[others]
    u[others] += np.linalg.solve(curvature, gradient)
    return target.value_and_gradient(u)[0] - 0.5 * float(np.linalg.slogdet(curvature)[1])
