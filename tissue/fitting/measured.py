"""Measured loads as a fit takes them."""

from dataclasses import dataclass

import numpy as np

from meshes.base.arrays import Array
from meshes.base.errors import InputError

__all__ = ["MeasuredLoads"]

FEWEST = 50
"""Samples of a channel below which its scale and the correlation of its noise cannot be estimated."""


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
        Times, from that of a sample, at which the loads were read of which it is the mean, shape (k,) [s].

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
                f"values must have shape ({len(self.times_s)}, {len(self.channels)}), of times and channels, got "
                f"{self.values.shape}: give one row a sample"
            )
        if not (np.diff(self.times_s) > 0.0).all():
            raise InputError("times_s must increase, got one that does not: sort the samples and drop repeated ones")
        counts = np.isfinite(self.values).sum(axis=0)
        if len(counts) and counts.min() < FEWEST:
            raise InputError(
                f"values must hold {FEWEST} samples of each channel, got {counts.min()} of "
                f"{self.channels[int(np.argmin(counts))]}: leave the channel out or give a longer log"
            )

    def sizes(self) -> Array:
        """Root mean square of each channel's unit [N or N m], shape (channels,), not swayed by outliers.

        Channels of one unit share the largest, since a channel without load has nothing but noise.
        """
        middle = np.nanmedian(self.values, axis=0)
        spread = 1.4826 * np.nanmedian(np.abs(self.values - middle), axis=0)
        cut = np.clip(self.values, middle - 10.0 * spread, middle + 10.0 * spread)
        size = np.sqrt(np.nanmean(np.where(spread > 0.0, cut, self.values) ** 2, axis=0))
        units = np.array([name.rpartition("_")[2] for name in self.channels])
        return np.array([size[units == unit].max() for unit in units])
