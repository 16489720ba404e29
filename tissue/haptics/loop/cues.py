"""Short transients that mark what happens at the tool: first contact, another layer, a puncture."""

from math import pi, sin, sqrt

import numpy as np

from meshes.base.arrays import Array
from tissue.haptics.loop.vibration import SLEW_SHARE
from tissue.models.tissue_model import Response

__all__ = ["CUE_HZ", "Cues", "TouchEvents"]

CUE_HZ = 125.0
"""Frequency of a transient [Hz]: within the band of the receptors for vibration, 50 to 500 Hz
(Johansson and Flanagan, 2009), and an eighth of the tick's rate, so that it is played smoothly."""
PERIODS = 5
"""Periods of a transient under a Hann window: 40 ms, with a bandwidth of 50 Hz at half its
height.
"""
APART_S = 0.1
"""Time without contact before a touch counts as the first one, and between two transients [s]."""
SETTLED_S = 0.01
"""Time for which another layer has to be the one that is met most [s]."""


class TouchEvents:
    """Whether something was just touched, or another layer is met: by the areas of layers that the
    tool meets.

    A puncture is a change of layer, from a membrane to what lies behind it.

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
        """Whether an event begins in this tick, for areas by layer [m2], shape (layers,)."""
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
    """The transient of each event, added to the force that a device plays along its direction: a
    burst without a mean.

    It does not depend on the force after it has begun, so that it takes nothing from the loop's
    stability.

    Parameters
    ----------
    amplitude_N
        Greatest force of a transient [N].
    limit_N, slew_N
        Greatest force of the device and its greatest change in a tick [N]: the transient is made
        smaller to fit.
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
        """What is added in a tick in which this force is played [N], both of shape (3,)."""
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
        """No sample came: a transient under way ends."""
        self._left = 0
