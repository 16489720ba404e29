"""When a needle's log jumps: punctures, and the moments at which a shaft at rest breaks away."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from meshes.base.arrays import Array, Ints

__all__ = ["Event", "median_jumps", "near_events", "speed_corners", "stroke_numbers"]

FEWEST = 5
"""Samples on either side of a place over which medians are taken: two outliers do not move them."""
WINDOW_S = 0.02
"""Time on either side, where it holds more of them [s]."""
CORNER = 0.3
"""Change of speed over two samples, over the greatest speed, from which viscous friction is taken to jump."""


@dataclass(frozen=True)
class Event:
    """A jump of the force between two samples.

    Attributes
    ----------
    kind
        ``puncture``, or ``slip_in`` and ``slip_out`` where the shaft breaks away.
    sample
        The last one before it.
    seen
        Whether the log shows it to within a sample or so.
    moment_s
        When it happens, on the clock of the poses [s]; None for the middle between the samples.
    span_s
        From when until when it may lie [s]; None for the moment alone.
    """

    kind: str
    sample: int
    seen: bool = True
    moment_s: float | None = None
    span_s: tuple[float, float] | None = None

    def at_s(self, times_s: Array) -> float:
        """Its moment, given the samples' times [s], shape (n,)."""
        if self.moment_s is not None:
            return self.moment_s
        return 0.5 * float(times_s[self.sample] + times_s[self.sample + 1])


def near_events(times_s: Array, wanted_s: Array, events: tuple[Event, ...], within_s: float) -> NDArray[np.bool_]:
    """Which times [s] lie within a time of where an event may be, shape of `wanted_s`."""
    close = np.zeros(np.shape(wanted_s), dtype=bool)
    for event in events:
        first, last = event.span_s or (event.at_s(times_s), event.at_s(times_s))
        close |= (wanted_s >= first - within_s) & (wanted_s <= last + within_s)
    return close


def speed_corners(speed_m_s: Array) -> Ints:
    """Samples at which a needle starts, stops or turns at once, so that a viscous force jumps."""
    change = np.abs(speed_m_s[2:] - speed_m_s[:-2])
    return np.asarray(np.flatnonzero(change > CORNER * np.abs(speed_m_s).max()) + 1)


def median_jumps(times_s: Array, force_N: Array) -> Array:
    """Median of the samples after each less that of those up to it, less what the slope does there, shape (n,)."""
    width = max(round(WINDOW_S / float(np.median(np.diff(times_s)))), FEWEST)
    padded = np.concatenate([np.full(2 * width, force_N[0]), force_N, np.full(2 * width, force_N[-1])])
    middle = np.median(np.lib.stride_tricks.sliding_window_view(padded, width), axis=1)
    at = np.arange(len(force_N)) + width + 1
    before, after = middle[at], middle[at + width]
    slope = 0.5 * (before - middle[at - width] + middle[np.minimum(at + 2 * width, len(middle) - 1)] - after)
    jumps: Array = after - before - slope
    return jumps


def stroke_numbers(travel_m: Array) -> Ints:
    """Number of the stroke, a time of motion in one direction, that each sample begins, shape (n,)."""
    turn = np.sign(np.diff(travel_m, append=travel_m[-1]))
    for sample in range(1, len(turn)):
        if turn[sample] == 0.0:
            turn[sample] = turn[sample - 1]
    return np.concatenate([[0], np.cumsum(np.diff(turn) != 0.0)])
