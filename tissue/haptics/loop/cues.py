"""Short force transients for events at the tool: first contact, another layer, a puncture."""

from math import pi, sin, sqrt

import numpy as np

from meshes.base.arrays import Array
from tissue.haptics.loop.vibration import SLEW_SHARE
from tissue.models.tissue_model import Response

__all__ = ["CUE_HZ", "Cues", "TouchEvents"]

CUE_HZ = 125.0
"""Frequency of a transient [Hz].

It lies within the band of vibration receptors, 50 to 500 Hz (Johansson and Flanagan, 2009). It is
an eighth of the tick rate, so that it is played smoothly.
"""
PERIODS = 5
"""Periods of a transient under a Hann window: 40 ms, with a half-height bandwidth of 50 Hz."""
APART_S = 0.1
"""Time without contact before a first contact, and shortest time between two transients [s]."""
SETTLED_S = 0.01
"""Time for which another layer must have the largest contact area [s]."""


class TouchEvents:
    """Detector of first contact and of changes of layer, from the contact area of each layer.

    A puncture is a change of layer, from a membrane to the tissue behind it.

    Parameters
    ----------
    tick_s
        Time between two calls [s].
    """

    def __init__(self, *, tick_s: float) -> None:
        self._apart = round(APART_S / tick_s)
        self._settled = round(SETTLED_S / tick_s)
        self._free = self._quiet = self._apart
        self._layer = -1
        self._for = 0

    def step(self, engaged_m2: Array) -> bool:
        """Return whether an event begins in this tick, for areas by layer [m2], shape (layers,)."""
        self._quiet += 1
        layer = int(engaged_m2.argmax())
        if not engaged_m2[layer] > 0.0:
            self._free += 1
            return False
        first = self._free >= self._apart
        self._free = 0
        self._for = self._for + 1 if layer != self._layer else 0
        changed = self._layer >= 0 and self._for >= self._settled
        if first or changed:
            self._layer = layer
            self._for = 0
        if not (first or changed) or self._quiet < self._apart:
            return False
        self._quiet = 0
        return True


class Cues:
    """Transient of each event, added to the device force along its direction, with zero mean.

    After its start, a transient does not depend on the force. It therefore does not affect the
    stability of the loop.

    Parameters
    ----------
    amplitude_N
        Largest force of a transient [N].
    limit_N, slew_N
        Largest force of the device and its largest change in a tick [N]. The transient is reduced
        to fit.
    tick_s
        Time between two steps [s].
    """

    def __init__(self, amplitude_N: float, *, limit_N: float, slew_N: float, tick_s: float) -> None:
        count = round(PERIODS / (CUE_HZ * tick_s))
        at = (np.arange(count) + 0.5) / count
        burst = np.sin(2.0 * pi * PERIODS * at) * np.sin(pi * at) ** 2
        most = SLEW_SHARE * slew_N / (2.0 * sin(pi * CUE_HZ * tick_s))
        self._burst = (min(amplitude_N, most) * (burst - burst.mean())).tolist()
        self._events = TouchEvents(tick_s=tick_s)
        self._limit = limit_N
        self._left = 0
        self._along = np.zeros(3)

    def step(self, force_N: Array, response: Response) -> Array:
        """Return the force to add in a tick in which ``force_N`` is played [N], shape (3,)."""
        if self._events.step(response.engaged_m2):
            self._left = len(self._burst)
            self._along = np.zeros(3)
        if not self._left:
            return np.zeros(3)
        size = sqrt(force_N.dot(force_N))
        if not self._along.any() and size > 0.0:
            self._along = force_N / size
        if not self._along.any():
            return np.zeros(3)
        left_N = max(self._limit - size, 0.0)
        value = self._burst[-self._left]
        self._left -= 1
        return min(max(value, -left_N), left_N) * self._along

    def pause(self) -> None:
        """End a running transient, because a sample is missing."""
        self._left = 0
