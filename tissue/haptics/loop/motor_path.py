"""Path of a force to the motor: low-pass, latency, transport, hold and amplifier."""

from math import exp, inf, pi

import numpy as np
from scipy.signal import lfilter

from meshes.base.arrays import Array
from tissue.haptics.loop.filters import low_pass_gain
from tissue.haptics.loop.sampled_loop import WallLoop

__all__ = ["force_later_N", "mean_over_ticks_N", "motor_force_N", "motor_lag_ticks"]


def motor_lag_ticks(loop: WallLoop) -> float:
    """Return the delay of a linearly increasing force from its sample to the motor [ticks].

    The low-pass y += (1 - p) (u - y) delays by p / (1 - p) ticks, the loop by its delay, the hold
    by half a tick and the amplifier of bandwidth f by 1 / (2 pi f) seconds.
    """
    gain = low_pass_gain(loop.filter_s, loop.tick_s)
    return (1.0 - gain) / gain + loop.delay_s / loop.tick_s + 0.5 + _amplifier_ticks(loop)


def motor_force_N(loop: WallLoop, force_N: Array) -> Array:
    """Return the mean force of the motor over every tick [N], shape (n, 3).

    It is the impulse on the hand divided by the tick. The result is exact even if the delay is not
    a whole number of ticks. Each force is filtered, held for a tick after its delay, and passed
    through the amplifier.

    Parameters
    ----------
    loop
        Loop with tick, low-pass, delay and amplifier.
    force_N
        One force per tick before the low-pass [N], shape (n, 3). Before the first force, it is
        zero.
    """
    gain = low_pass_gain(loop.filter_s, loop.tick_s)
    delay = loop.delay_s / loop.tick_s
    whole = int(delay + 1e-9)
    part = max(delay - whole, 0.0)
    filtered = lfilter([gain], [1.0, gain - 1.0], force_N, axis=0)
    older = _held_back(filtered, whole + 1)
    newer = _held_back(filtered, whole)
    amplifier = _amplifier_ticks(loop)
    if amplifier == 0.0:
        return part * older + (1.0 - part) * newer
    # From m, the motor reaches u + (m - u) exp(-s / a) after s ticks, first towards the older
    # command, then towards the newer one.
    first = exp(-part / amplifier)
    second = exp(-(1.0 - part) / amplifier)
    driven = second * (1.0 - first) * older + (1.0 - second) * newer
    starts = _held_back(lfilter([1.0], [1.0, -first * second], driven, axis=0), 1)
    between = older + first * (starts - older)
    lagging = (1.0 - first) * (starts - older) + (1.0 - second) * (between - newer)
    return np.asarray(part * older + (1.0 - part) * newer + amplifier * lagging)


def mean_over_ticks_N(force_N: Array) -> Array:
    """Return the mean over every tick of a force given at the ticks [N], shape (n - 1, 3).

    The force is linear between the ticks.
    """
    return 0.5 * (force_N[:-1] + force_N[1:])


def force_later_N(force_N: Array, ticks: float) -> Array:
    """Return the force ``ticks`` later, linear between ticks [N], shape (n, 3).

    The last force is kept beyond the end.
    """
    at = np.arange(len(force_N))
    return np.column_stack([np.interp(at + ticks, at, axis) for axis in force_N.T])


def _amplifier_ticks(loop: WallLoop) -> float:
    """Return the time constant of the amplifier [ticks]."""
    return 0.0 if loop.amplifier_Hz == inf else 1.0 / (2.0 * pi * loop.amplifier_Hz * loop.tick_s)


def _held_back(force_N: Array, ticks: int) -> Array:
    """Return the force delayed by ``ticks``, initially zero [N]."""
    return np.concatenate(
        [np.zeros((min(ticks, len(force_N)), 3)), force_N[: max(len(force_N) - ticks, 0)]]
    )
