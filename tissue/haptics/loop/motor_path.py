"""The path of a force to the motor, through low-pass, latency, transport, hold and amplifier:
delay and force.
"""

from math import exp, inf, pi

import numpy as np
from scipy.signal import lfilter

from meshes.base.arrays import Array
from tissue.haptics.loop.filters import low_pass_gain
from tissue.haptics.loop.sampled_loop import WallLoop

__all__ = ["force_later_N", "mean_over_ticks_N", "motor_force_N", "motor_lag_ticks"]


def motor_lag_ticks(loop: WallLoop) -> float:
    """Delay of a force from its sample to the motor [ticks], that of a force which rises along a
    straight line.

    The low-pass y += (1 - p) (u - y) delays by p / (1 - p) ticks, the loop by its delay, the hold
    by half a tick and the amplifier of bandwidth f by 1 / (2 pi f) seconds.
    """
    gain = low_pass_gain(loop.filter_s, loop.tick_s)
    return (1.0 - gain) / gain + loop.delay_s / loop.tick_s + 0.5 + _amplifier_ticks(loop)


def motor_force_N(loop: WallLoop, force_N: Array) -> Array:
    """Mean force of the motor over every tick [N], shape (n, 3): the impulse that a hand receives,
    over the tick.

    Exact, also where the delay is no whole number of ticks: each force is filtered, held for a tick
    from its delay on, and followed by the amplifier.

    Parameters
    ----------
    loop
        Gives tick, low-pass, delay and amplifier.
    force_N
        A force a tick before the low-pass [N], shape (n, 3); before the first one there was none.
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
    # From m the motor goes to u + (m - u) exp(-s / a) in s ticks; first towards the older command,
    # then the newer one.
    first = exp(-part / amplifier)
    second = exp(-(1.0 - part) / amplifier)
    driven = second * (1.0 - first) * older + (1.0 - second) * newer
    starts = _held_back(lfilter([1.0], [1.0, -first * second], driven, axis=0), 1)
    between = older + first * (starts - older)
    lagging = (1.0 - first) * (starts - older) + (1.0 - second) * (between - newer)
    return np.asarray(part * older + (1.0 - part) * newer + amplifier * lagging)


def mean_over_ticks_N(force_N: Array) -> Array:
    """Mean over every tick of a force that is known at its ends and straight between them [N],
    shape (n - 1, 3).
    """
    return 0.5 * (force_N[:-1] + force_N[1:])


def force_later_N(force_N: Array, ticks: float) -> Array:
    """The force so many ticks later [N], shape (n, 3): straight between ticks, the last one
    beyond the end.
    """
    at = np.arange(len(force_N))
    return np.column_stack([np.interp(at + ticks, at, axis) for axis in force_N.T])


def _amplifier_ticks(loop: WallLoop) -> float:
    """Time constant of the amplifier [ticks]."""
    return 0.0 if loop.amplifier_Hz == inf else 1.0 / (2.0 * pi * loop.amplifier_Hz * loop.tick_s)


def _held_back(force_N: Array, ticks: int) -> Array:
    """The force so many ticks before, none at first [N]."""
    return np.concatenate(
        [np.zeros((min(ticks, len(force_N)), 3)), force_N[: max(len(force_N) - ticks, 0)]]
    )
